//! Faults of a calibration spec that its types cannot show.

use super::channels;
use super::spec::{AUTO, CalibrateSpec, INFORMATIVE, NEURAL, RICHEST};
use dynocal_calib::map::structures::{self, MAP_STRUCTURES};
use dynocal_design::criterion::CRITERIA;
use dynocal_files::spec::Faults;
use dynocal_plant::plants;

/// Reports every fault of `s`.
pub(crate) fn check(s: &CalibrateSpec, faults: &mut Faults) {
    faults.range("sample_time_s", s.sample_time_s, 0.005, 0.5, "s");
    faults.range("longest_delay_s", s.longest_delay_s, 0.01, 100.0, "s");
    for f in plants::check(&s.plant) {
        if f.known.is_empty() {
            faults.push(&f.key, f.found, f.expected);
        } else {
            faults.unknown(&f.key, &f.found, &f.known);
        }
    }
    if let Some(only_s) = plants::find(&s.plant.name).and_then(|p| p.sample_time_s)
        && (s.sample_time_s - only_s).abs() > 1e-9
    {
        faults.push("sample_time_s", s.sample_time_s, format!("{only_s} s, that of `{}`", s.plant.name));
    }
    s.problem.check("problem", faults);
    loops(s, faults);
    names(s, faults);
    if s.optimise.start_maps.as_ref().is_some_and(|m| m.files.is_empty() || m.maps.is_empty()) {
        faults.push(
            "optimise.start_maps",
            "no files or no maps",
            "`files`, and under `maps` a characteristic for an input",
        );
    }
    let mut known: Vec<String> = CRITERIA.iter().map(|m| m.doc.name.to_string()).collect();
    known.push(AUTO.into());
    if !known.contains(&s.design.criterion) {
        faults.unknown("design.criterion", &s.design.criterion, &known);
    }
    for (key, found, known) in [
        ("design.model", &s.design.model, ["chosen", RICHEST]),
        ("excite.signal", &s.excite.signal, ["aprbs", INFORMATIVE]),
    ] {
        if !known.contains(&found.as_str()) {
            faults.unknown(key, found, &known.map(str::to_string));
        }
    }
    for family in s.identify.families.iter().filter(|f| *f != NEURAL) {
        faults.unknown("identify.families", family, &[NEURAL.to_string()]);
    }
    const PAIRS: [&str; 3] = ["auto", "measured", "simulated"];
    if !PAIRS.contains(&s.invert.pairs.as_str()) {
        faults.unknown("invert.pairs", &s.invert.pairs, &PAIRS.map(str::to_string));
    }
    // NaN and infinity are numbers of TOML: they reach this point as well.
    if let Ok(table) = toml::Table::try_from(s) {
        numbers(&table, "", faults);
    }
    s.export.iter().for_each(|e| e.check(faults));
    fuelling(s, faults);
    shape(s, faults);
    lengths(s, faults);
    counts(s, faults);
}

/// Reports what a spec lacks as that of engine and fuelling as one plant, whose channels are others than those that were written.
pub(super) fn one_plant(s: &CalibrateSpec, faults: &mut Faults) {
    s.problem.check("problem", faults);
    names(s, faults);
}

/// Every demand has a loop, every loop an input of its own.
fn loops(s: &CalibrateSpec, faults: &mut Faults) {
    let inputs = s.problem.input_names();
    let demands = s.problem.demand_names();
    if demands.is_empty() {
        faults.push("problem.demands", "none", "at least one output that follows a demand");
    }
    let mut driven: Vec<&str> = Vec::new();
    for (k, l) in s.loops.iter().enumerate() {
        if !demands.contains(&l.output) {
            faults.unknown(&format!("loops[{k}].output"), &l.output, &demands);
        }
        if !inputs.contains(&l.input) {
            faults.unknown(&format!("loops[{k}].input"), &l.input, &inputs);
        }
        if driven.contains(&l.input.as_str()) {
            faults.push(
                &format!("loops[{k}].input"),
                format!("`{}`", l.input),
                "an input that no other loop drives",
            );
        }
        driven.push(&l.input);
        for (key, gains) in [("gains", l.gains), ("trim", l.trim)] {
            let Some(g) = gains else { continue };
            if [g.ki, g.kp].iter().any(|v| !v.is_finite() || v.abs() > 1e6) || g.ki == 0.0 {
                let found = format!("ki = {}, kp = {}", g.ki, g.kp);
                faults.push(&format!("loops[{k}].{key}"), found, "finite gains, ki not 0");
            }
        }
        if l.gains.is_some() != s.loops[0].gains.is_some() {
            let expected = "gains for all loops or for none: those that are found are found together";
            faults.push(&format!("loops[{k}].gains"), "gains for some of the loops", expected);
        }
    }
    s.tune.check("tune", s.sample_time_s, faults);
    for d in demands.iter().filter(|d| !s.loops.iter().any(|l| l.output == **d)) {
        faults.push("loops", format!("none for `{d}`"), format!("a loop for every demand, e.g. {{ output = \"{d}\", input = .., gains = {{ ki = .., kp = .. }} }}"));
    }
}

/// Channels that tables are keyed by.
fn names(s: &CalibrateSpec, faults: &mut Faults) {
    let inputs = s.problem.input_names();
    let demands = s.problem.demand_names();
    let given = s.problem.given_names();
    let outputs: Vec<String> = demands.iter().cloned().chain(s.problem.other_outputs()).collect();
    let all = |parts: &[&Vec<String>]| parts.iter().flat_map(|p| p.iter().cloned()).collect::<Vec<_>>();
    let mut each = |key: &str, found: Vec<&String>, known: Vec<String>| {
        for name in found.into_iter().filter(|n| !known.contains(n)) {
            faults.unknown(key, name, &known);
        }
    };
    each("excite.ranges", s.excite.ranges.keys().collect(), all(&[&inputs, &given, &demands]));
    each("excite.start", s.excite.start.keys().collect(), inputs.clone());
    each("optimise.ranges", s.optimise.ranges.keys().collect(), demands.clone());
    if let Some(m) = &s.optimise.start_maps {
        each("optimise.start_maps.maps", m.maps.keys().collect(), inputs.clone());
        each("optimise.start_maps.axes", m.axes.values().collect(), all(&[&demands, &given]));
    }
    // The injection is modelled where engine and fuelling are one plant; which input that is its spec says.
    let injected = if s.fuelling.as_ref().is_some_and(|f| f.plant) { inputs.clone() } else { Vec::new() };
    each("identify.models", s.identify.models.keys().collect(), all(&[&outputs, &injected]));
    each("identify.files", s.identify.files.keys().collect(), outputs.clone());
    each("validate.scenario.bands", s.validate.scenario.bands.keys().collect(), demands.clone());
    for (key, ranges) in [("excite", &s.excite.ranges), ("optimise", &s.optimise.ranges)] {
        for (name, r) in ranges {
            if !(r.0.is_finite() && r.1.is_finite() && r.0 < r.1) {
                faults.push(
                    &format!("{key}.ranges.{name}"),
                    format!("{r:?}"),
                    "two numbers, lower before upper",
                );
            }
            let bounds = s.problem.inputs.iter().find(|i| i.name == *name);
            if let Some(i) = bounds.filter(|i| r.0 < i.lower || r.1 > i.upper) {
                let expected = format!("inside problem.inputs, {} to {} {}", i.lower, i.upper, i.unit);
                faults.push(&format!("{key}.ranges.{name}"), format!("{r:?}"), expected);
            }
        }
    }
}

/// The structure of the map: its name, its keys, and whether it is made for the problem.
fn shape(s: &CalibrateSpec, faults: &mut Faults) {
    let ports = channels::ports(&s.problem);
    let known: Vec<String> = MAP_STRUCTURES.iter().map(|r| r.doc.name.to_string()).collect();
    let find = |key: &str, name: &str, faults: &mut Faults| {
        let row = structures::row(name);
        if row.is_err() {
            faults.unknown(key, name, &known);
        }
        row.ok()
    };
    for name in &s.invert.rivals {
        find("invert.rivals", name, faults);
    }
    let Some(row) = find("invert.structure", &s.invert.structure, faults) else { return };
    if !(row.fits)(&ports) {
        let structure = s.invert.structure.clone();
        let names = [ports.reference_names(), ports.actuator_names()].concat().join(", ");
        faults.push("invert.structure", &structure, format!("one that is made for {names}"));
    }
    match (row.build)(&s.invert.shape) {
        Ok(built) => built.check(&ports, "invert.shape", faults),
        Err(e) => {
            let found: Vec<&str> = s.invert.shape.keys().map(String::as_str).collect();
            faults.push("invert.shape", found.join(", "), format!("the keys of `{}` ({e})", row.doc.name));
        }
    }
}

/// Fuel by measured states: from a file or from a spec.
fn fuelling(s: &CalibrateSpec, faults: &mut Faults) {
    let Some(f) = &s.fuelling else { return };
    f.channels.iter().for_each(|c| c.check("fuelling.channels", faults));
    match (&f.file, &f.spec) {
        (None, None) => faults.push(
            "fuelling",
            "neither",
            "`file`, the fuelling.json of a run of `dynocal fuelling`, or `spec`, a spec of it",
        ),
        (Some(_), Some(_)) => faults.push("fuelling", "`file` and `spec`", "one of them"),
        _ if f.plant && !f.excite => faults.push(
            "fuelling.plant",
            "`plant` without `excite`",
            "both: records of engine and fuelling as one plant are those in which it injects",
        ),
        _ if f.plant && s.invert.refine > 0 => faults.push(
            "invert.refine",
            s.invert.refine,
            "0 with `fuelling.plant`: loops of the engine alone would teach the map",
        ),
        _ if f.plant
            && !(s.excite.identification_files.is_empty()
                && s.excite.validation_files.is_empty()
                && s.design.record.is_none()
                && s.identify.files.is_empty()) =>
        {
            faults.push(
                "fuelling.plant",
                "records or models from files",
                "none with `plant`: those of the engine alone have another injection, a sample apart",
            );
        }
        _ if plants::find(&s.plant.name).is_some_and(|p| p.make.is_none()) => {
            faults.push("fuelling", "a plant that does not answer", "none: on a bed its ECU injects");
        }
        (None, Some(_)) if f.channels.is_some() => {
            faults.push("fuelling.channels", "names beside a spec", "none: a spec has its own");
        }
        _ => {}
    }
}

/// Most samples of one record.
const MOST_SAMPLES: f64 = 2e5;

/// Records that are long enough for what is done with them, and not too long for memory.
fn lengths(s: &CalibrateSpec, faults: &mut Faults) {
    for (key, value, least) in [
        ("excite.record_s", s.excite.record_s, 3.0),
        ("design.record_s", s.design.record_s, 3.0),
        ("optimise.record_s", s.optimise.record_s, 3.0),
        ("validate.scenario.point_s", s.validate.scenario.point_s, 1.0),
        ("validate.scenario.step_s", s.validate.scenario.step_s, 1.0),
    ] {
        let most = MOST_SAMPLES * s.sample_time_s;
        if !(value >= least && value <= most) {
            faults.push(key, value, format!("{least} to {most} s"));
        }
    }
}

/// Times that may be zero.
const MAY_BE_ZERO: [&str; 4] = ["dwell_s", "ramp_s", "lead_in_s", "lag_resolution_s"];

/// Durations, recognised by their names, so that a new key of any step is checked too.
fn numbers(table: &toml::Table, path: &str, faults: &mut Faults) {
    for (key, value) in table {
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match value {
            toml::Value::Table(t) => numbers(t, &path, faults),
            toml::Value::Float(v) if key.ends_with("_s") => {
                let fits = v.is_finite() && (*v > 0.0 || (*v == 0.0 && MAY_BE_ZERO.contains(&key.as_str())));
                if !(fits && *v <= 1e6) {
                    faults.push(&path, v, "a positive number, s");
                }
            }
            toml::Value::Array(items) if ["demand", "given"].contains(&key.as_str()) => {
                let values: Vec<f64> = items.iter().filter_map(toml::Value::as_float).collect();
                let increasing =
                    values.windows(2).all(|w| w[0] < w[1]) && values.iter().all(|v| v.is_finite());
                if !values.is_empty() && !increasing {
                    faults.push(&path, format!("{values:?}"), "increasing numbers");
                }
            }
            _ => {}
        }
    }
}

fn counts(s: &CalibrateSpec, faults: &mut Faults) {
    let e = &s.excite;
    for (key, value, least, most) in [
        ("excite.levels", e.levels, 2, 1000),
        ("identify.terms", s.identify.terms, 1, 1000),
        ("identify.doublings", s.identify.doublings, 0, 3),
        ("identify.lags", s.identify.lags, 1, 50),
        ("identify.init_samples", s.identify.init_samples, 0, 100_000),
        ("design.max_evaluations", s.design.max_evaluations, 1, 1_000_000),
        ("design.starts", s.design.starts, 1, 1000),
        ("invert.at_rest.points", s.invert.at_rest.points, 3, 50),
        ("optimise.passes", s.optimise.passes, 1, 100),
        ("optimise.trials", s.optimise.trials, 0, 100),
        ("optimise.max_iterations", s.optimise.max_iterations, 1, 100_000),
        ("validate.scenario.points", s.validate.scenario.points, 1, 10_000),
        ("validate.scenario.steps", s.validate.scenario.steps, 1, 10_000),
        ("validate.static_map.search.sweeps", s.validate.static_map.search.sweeps, 1, 100),
    ] {
        if value < least || value > most {
            faults.push(key, value, format!("a whole number from {least} to {most}"));
        }
    }
    if let Some(w) = s.optimise.within_points {
        faults.range("optimise.within_points", w, 0.0, 100.0, "points");
    }
    faults.range("optimise.smoothing", s.optimise.smoothing, 0.0, 1e3, "of the objective");
    let r = &s.invert.at_rest;
    faults.range("invert.at_rest.hold_s", r.hold_s, s.sample_time_s, 600.0, "s");
    faults.range("invert.at_rest.average_s", r.average_s, s.sample_time_s, r.hold_s, "s");
    faults.range("optimise.give", s.optimise.give, 0.0, 0.1, "of the range of a demand");
    faults.range("optimise.tolerance", s.optimise.tolerance, 1e-12, 1e-2, "of the scaled KKT error");
    faults.range(
        "validate.static_map.search.tolerance",
        s.validate.static_map.search.tolerance,
        1e-4,
        0.5,
        "-",
    );
    if e.identification_files.is_empty() {
        for (key, value) in [
            ("excite.identification_records", e.identification_records),
            ("excite.validation_records", e.validation_records),
        ] {
            if !(1..=1000).contains(&value) {
                faults.push(key, value, "a whole number from 1 to 1000");
            }
        }
        let samples = e.record_s / s.sample_time_s * e.identification_records as f64;
        let most = s.identify.terms << s.identify.doublings.min(3);
        let terms = most + most / 3 + 30;
        if samples.is_finite() && samples < 5.0 * terms as f64 {
            faults.push(
                "excite.record_s",
                e.record_s,
                format!("identification records long enough for {terms} candidate terms (at least 5 samples for each)"),
            );
        }
    } else if e.validation_files.is_empty() {
        faults.push("excite.validation_files", "none", "at least one record that the models have not seen");
    }
}
