//! `modelDescription.xml` of the engine.

use std::fmt::Write;

use dynocal_ident::plant::Causality;

use crate::engine::Engine;

/// Name of the model and of its library.
pub const IDENTIFIER: &str = "dynocal_engine";
/// Identifier that both interfaces check.
pub const TOKEN: &str = concat!("dynocal-engine-", env!("CARGO_PKG_VERSION"));

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The description for FMI `version` (2 or 3), with `about` as its text and `step_s` as the step that is proposed.
pub fn xml(engine: &Engine, version: u32, about: &str, step_s: f64) -> String {
    let two = version == 2;
    let mut s = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let (number, key) = if two { ("2.0", "guid") } else { ("3.0", "instantiationToken") };
    let events = if two { " numberOfEventIndicators=\"0\"" } else { "" };
    let _ = writeln!(
        s,
        "<fmiModelDescription fmiVersion=\"{number}\" modelName=\"{IDENTIFIER}\" {key}=\"{TOKEN}\" description=\"{}\" generationTool=\"dynocal {}\" variableNamingConvention=\"structured\"{events}>",
        escape(about),
        env!("CARGO_PKG_VERSION")
    );
    let state = if two { "FMUstate" } else { "FMUState" };
    // All memory is the unit's own.
    let own = if two { " canNotUseMemoryManagementFunctions=\"true\"" } else { "" };
    let _ = writeln!(
        s,
        "  <CoSimulation modelIdentifier=\"{IDENTIFIER}\" canHandleVariableCommunicationStepSize=\"true\" canGetAndSet{state}=\"true\" canSerialize{state}=\"true\"{own}/>"
    );
    let mut units: Vec<&str> =
        engine.variables().iter().map(|v| v.unit.as_str()).filter(|u| *u != "-").collect();
    units.push("s");
    units.sort_unstable();
    units.dedup();
    let units: String = units.iter().map(|u| format!("<Unit name=\"{}\"/>", escape(u))).collect();
    let _ = writeln!(s, "  <UnitDefinitions>{units}</UnitDefinitions>");
    let _ = writeln!(
        s,
        "  <DefaultExperiment startTime=\"0\" stopTime=\"60\" stepSize=\"{step_s:?}\"/>\n  <ModelVariables>"
    );
    variable(&mut s, two, 0, "time", "causality=\"independent\" variability=\"continuous\"", " unit=\"s\"");
    let (mut outputs, mut reference) = (Vec::new(), 0);
    for v in engine.variables() {
        reference += 1;
        let mut real = if v.unit == "-" { String::new() } else { format!(" unit=\"{}\"", escape(&v.unit)) };
        let kind = if v.causality == Causality::Input {
            let _ = write!(real, " min=\"{:?}\" max=\"{:?}\" start=\"{:?}\"", v.min, v.max, v.start);
            "causality=\"input\" variability=\"continuous\""
        } else {
            outputs.push(reference);
            "causality=\"output\" variability=\"continuous\" initial=\"calculated\""
        };
        variable(&mut s, two, reference, &v.name, kind, &real);
    }
    for p in &engine.setup().parameters {
        reference += 1;
        let kind = "causality=\"parameter\" variability=\"fixed\" initial=\"exact\"";
        variable(
            &mut s,
            two,
            reference,
            &format!("parameters.{}", p.name),
            kind,
            &format!(" start=\"{:?}\"", p.value),
        );
    }
    s.push_str("  </ModelVariables>\n  <ModelStructure>\n");
    // Outputs before the first step are start values: they depend on nothing.
    if two {
        let list: String =
            outputs.iter().map(|o| format!("<Unknown index=\"{}\" dependencies=\"\"/>", o + 1)).collect();
        let _ = writeln!(s, "    <Outputs>{list}</Outputs>\n    <InitialUnknowns>{list}</InitialUnknowns>");
    } else {
        for kind in ["Output", "InitialUnknown"] {
            outputs.iter().for_each(|o| {
                let _ = writeln!(s, "    <{kind} valueReference=\"{o}\" dependencies=\"\"/>");
            });
        }
    }
    s.push_str("  </ModelStructure>\n</fmiModelDescription>\n");
    s
}

fn variable(s: &mut String, two: bool, reference: u32, name: &str, kind: &str, real: &str) {
    let name = escape(name);
    let _ = if two {
        writeln!(
            s,
            "    <ScalarVariable name=\"{name}\" valueReference=\"{reference}\" {kind}><Real{real}/></ScalarVariable>"
        )
    } else {
        writeln!(s, "    <Float64 name=\"{name}\" valueReference=\"{reference}\" {kind}{real}/>")
    };
}
