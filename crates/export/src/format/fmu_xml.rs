//! The description of an FMU.

use std::fmt::Write;

use dynocal_numerics::interval::Interval;

use crate::characteristic::identifier;
use crate::format::cdfx::escape;
use crate::format::fmu::Version;
use crate::package::Package;
use crate::program::Program;

/// A variable of an FMU.
struct Variable<'a> {
    name: &'a str,
    unit: &'a str,
    description: &'a str,
    causality: &'a str,
    start: Option<f64>,
    range: Option<Interval>,
}

fn variables(p: &Program) -> Vec<Variable<'_>> {
    let time = Variable {
        name: "time",
        unit: "s",
        description: "",
        causality: "independent",
        start: None,
        range: None,
    };
    let inputs = p.inputs.iter().map(|i| Variable {
        name: &i.name,
        unit: &i.unit,
        description: &i.description,
        causality: "input",
        start: Some(i.start),
        range: i.range,
    });
    let outputs = p.outputs.iter().map(|o| Variable {
        name: &o.name,
        unit: &o.unit,
        description: &o.description,
        causality: "output",
        start: None,
        range: None,
    });
    std::iter::once(time).chain(inputs).chain(outputs).collect()
}

/// `modelDescription.xml`.
pub(crate) fn description(package: &Package, p: &Program, token: &str, version: Version) -> String {
    let name = identifier(&package.name);
    let two = version == Version::Two;
    let what = escape(&format!("{} {}", package.description, package.provenance.lines().join("; ")));
    let all = variables(p);
    let mut s = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let (number, key) = if two { ("2.0", "guid") } else { ("3.0", "instantiationToken") };
    let tool = escape(&format!("dynocal {}", package.provenance.version));
    let events = if two { " numberOfEventIndicators=\"0\"" } else { "" };
    let _ = writeln!(
        s,
        "<fmiModelDescription fmiVersion=\"{number}\" modelName=\"{name}\" {key}=\"{token}\" description=\"{what}\" generationTool=\"{}\" variableNamingConvention=\"flat\"{events}>",
        tool.trim()
    );
    let dt = p.sample_time_s;
    if two {
        let _ = writeln!(
            s,
            "  <CoSimulation modelIdentifier=\"{name}\" canHandleVariableCommunicationStepSize=\"false\" canGetAndSetFMUstate=\"true\" canSerializeFMUstate=\"true\">\n    \
<SourceFiles><File name=\"fmu.c\"/><File name=\"{name}.c\"/></SourceFiles>\n  </CoSimulation>"
        );
    } else {
        let _ = writeln!(
            s,
            "  <CoSimulation modelIdentifier=\"{name}\" canHandleVariableCommunicationStepSize=\"false\" fixedInternalStepSize=\"{dt:?}\" canGetAndSetFMUState=\"true\" canSerializeFMUState=\"true\"/>"
        );
    }
    let mut units: Vec<&str> = all.iter().map(|v| v.unit).filter(|u| !bare(u)).collect();
    units.sort_unstable();
    units.dedup();
    let units: Vec<String> = units.iter().map(|u| format!("<Unit name=\"{}\"/>", escape(u))).collect();
    let _ = writeln!(s, "  <UnitDefinitions>{}</UnitDefinitions>", units.join(""));
    let _ = writeln!(
        s,
        "  <DefaultExperiment startTime=\"0\" stopTime=\"{:?}\" stepSize=\"{dt:?}\"/>",
        1000.0 * dt
    );
    s.push_str("  <ModelVariables>\n");
    for (k, v) in all.iter().enumerate() {
        variable(&mut s, k, v, two);
    }
    s.push_str("  </ModelVariables>\n  <ModelStructure>\n");
    structure(&mut s, p, two);
    s.push_str("  </ModelStructure>\n</fmiModelDescription>\n");
    s
}

fn bare(unit: &str) -> bool {
    unit.is_empty() || unit == "-"
}

fn variable(s: &mut String, k: usize, v: &Variable, two: bool) {
    let name = escape(v.name);
    let what = if v.description.is_empty() {
        String::new()
    } else {
        format!(" description=\"{}\"", escape(v.description))
    };
    let initial = if v.causality == "output" { " initial=\"calculated\"" } else { "" };
    let mut real = String::new();
    if !bare(v.unit) {
        let _ = write!(real, " unit=\"{}\"", escape(v.unit));
    }
    if let Some(Interval { lower, upper }) = v.range {
        let _ = write!(real, " min=\"{lower:?}\" max=\"{upper:?}\"");
    }
    if let Some(start) = v.start {
        let _ = write!(real, " start=\"{start:?}\"");
    }
    let head = format!(
        "name=\"{name}\" valueReference=\"{k}\" causality=\"{}\" variability=\"continuous\"{initial}{what}",
        v.causality
    );
    let _ = if two {
        writeln!(s, "    <ScalarVariable {head}><Real{real}/></ScalarVariable>")
    } else {
        writeln!(s, "    <Float64 {head}{real}/>")
    };
}

/// Outputs depend on no input of the same point; before the first step they do on those that feed through.
fn structure(s: &mut String, p: &Program, two: bool) {
    let m = p.inputs.len();
    // FMI 2 counts variables from 1 (time is the first), FMI 3 names value references.
    let shift = if two { 1 } else { 0 };
    let dependencies = |o: usize| {
        let list: Vec<String> = p.feedthrough(o).iter().map(|i| (i + 1 + shift).to_string()).collect();
        list.join(" ")
    };
    let outputs = 0..p.outputs.len();
    if two {
        let line = |o: usize, d: &str| format!("<Unknown index=\"{}\" dependencies=\"{d}\"/>", o + m + 2);
        let known: String = outputs.clone().map(|o| line(o, "")).collect();
        let initial: String = outputs.map(|o| line(o, &dependencies(o))).collect();
        let _ =
            writeln!(s, "    <Outputs>{known}</Outputs>\n    <InitialUnknowns>{initial}</InitialUnknowns>");
    } else {
        for o in outputs.clone() {
            let _ = writeln!(s, "    <Output valueReference=\"{}\" dependencies=\"\"/>", o + m + 1);
        }
        for o in outputs {
            let _ = writeln!(
                s,
                "    <InitialUnknown valueReference=\"{}\" dependencies=\"{}\"/>",
                o + m + 1,
                dependencies(o)
            );
        }
    }
}

/// `sources/buildDescription.xml` of FMI 3.0.
pub(crate) fn build(name: &str) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiBuildDescription fmiVersion=\"3.0\">\n  <BuildConfiguration modelIdentifier=\"{name}\">\n    \
<SourceFileSet language=\"C99\"><SourceFile name=\"fmu.c\"/><SourceFile name=\"{name}.c\"/></SourceFileSet>\n  </BuildConfiguration>\n</fmiBuildDescription>\n"
    )
}
