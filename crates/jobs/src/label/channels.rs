//! Which channel of a log is what, and which labels of a tune make the fuel table.

use std::path::Path;

use dynocal_export::tune::ini::{Definition, Held, TableDef};
use dynocal_export::tune::msq::Tune;
use dynocal_files::FilesError;
use dynocal_files::measurement::{Raster, ReadKeys, Source, mlg::Mlg, open, recognise, recording_of};
use dynocal_files::table::Cells;
use dynocal_label::label::{Axis, Label};
use dynocal_label::ve::Log;

use super::result::LabelJobError;
use super::stamps;

/// Names of a quantity in logs, with letters and digits only and without `current`.
struct Names {
    what: &'static str,
    names: &'static [&'static str],
}

const SPEED: Names = Names { what: "engine speed", names: &["rpm", "enginespeed"] };
const LOAD: Names = Names { what: "load of the fuel table", names: &["fuelload", "map", "manifoldpressure"] };
const VE: Names = Names { what: "the table value in use", names: &["ve1", "ve", "vecurr1"] };
const LAMBDA: Names =
    Names { what: "measured lambda or air-fuel ratio", names: &["lambda", "afr", "lambda1", "afr1"] };
const PULSE: Names = Names { what: "injection pulse width", names: &["pw", "pw1", "pulsewidth"] };
const GAMMA: Names = Names { what: "fuel correction", names: &["gammae", "gammaenrichment"] };
const AIR: [&[&str]; 2] = [&["gair"], &["gbaro"]];

const STATE: [&[&str]; 3] = [&["clt", "coolant"], &["tpsdot"], &["engine"]];

/// Ratio of air to fuel of gasoline, where the tune does not say another one.
const STOICHIOMETRIC: f64 = 14.7;

fn plain(name: &str) -> String {
    let short: String = name.chars().filter(char::is_ascii_alphanumeric).collect();
    let short = short.to_ascii_lowercase();
    // `VE _Current` of one tool is `VE(Current)` and `Current VE` of others.
    match short.replace("current", "") {
        empty if empty.is_empty() => short,
        rest => rest,
    }
}

fn column(raster: &Raster, names: &[&str]) -> Option<(String, Vec<f64>)> {
    names.iter().find_map(|wanted| {
        raster.columns.iter().find_map(|c| match &c.cells {
            Cells::Number(v) if plain(&c.name) == *wanted => Some((plain(&c.name), v.clone())),
            _ => None,
        })
    })
}

fn needed(raster: &Raster, file: &str, known: &str, n: &Names) -> Result<(String, Vec<f64>), LabelJobError> {
    column(raster, n.names).ok_or_else(|| LabelJobError::Channel {
        file: file.into(),
        what: n.what,
        expected: n.names.join(", "),
        known: known.into(),
    })
}

/// Whether a name is one of those that are looked for.
fn may_be_needed(name: &str) -> bool {
    let all = [&SPEED, &LOAD, &VE, &LAMBDA, &PULSE, &GAMMA];
    all.iter().any(|n| n.names.contains(&name)) || AIR.iter().chain(&STATE).any(|names| names.contains(&name))
}

/// Puts the stamps in order: bad ones go with their records, and what follows a clock that was set back stands behind a hole.
fn in_order(raster: &mut Raster) -> Vec<String> {
    let order = stamps::ordered(&raster.time_s);
    let kept = |v: &[f64]| order.keep.iter().map(|k| v[*k]).collect::<Vec<f64>>();
    raster.time_s = kept(&raster.time_s);
    for c in &mut raster.columns {
        match &mut c.cells {
            Cells::Number(v) => *v = kept(v),
            Cells::Text(v) => *v = order.keep.iter().map(|k| v[*k].clone()).collect(),
        }
    }
    for &from in &order.starts[1..] {
        let shift = raster.time_s[from - 1] + UNKNOWN_S - raster.time_s[from];
        raster.time_s[from..].iter_mut().for_each(|t| *t += shift);
    }
    order.said
}

/// Time in s between two stretches of which nobody knows how long it was: a hole to all that looks back.
const UNKNOWN_S: f64 = 2.0 * dynocal_label::ve::mask::GAP_S;

/// A log with the tune that it carries, and what was decided on the way. An air-fuel ratio becomes a lambda by the stoichiometric ratio of
/// the tune: the `given` one, else that of the log.
///
/// # Errors
/// [`LabelJobError`]: files, a channel that is missing.
pub fn log(
    path: &Path,
    given: Option<&Tune>,
    notes: &mut Vec<String>,
) -> Result<(Log, Option<Tune>), LabelJobError> {
    let file = path.display().to_string();
    let (source, tune): (Box<dyn Source>, _) = if recognise(path)?.doc.name == "mlg" {
        let mlg = Mlg::open(path)?;
        let tune = mlg.tune().map(|t| Tune::parse(&format!("tune of {file}"), t.to_vec())).transpose()?;
        (Box::new(mlg), tune)
    } else {
        (open(path, None, &ReadKeys::default())?, None)
    };
    // A log may have hundreds of channels: only what may be needed is read.
    let recording = recording_of(source.as_ref(), &|name| may_be_needed(&plain(name)))?;
    notes.extend(recording.notes.iter().map(|n| format!("{file}: {n}")));
    let raster = recording.rasters.into_iter().max_by_key(|r| r.time_s.len());
    let mut raster = raster.ok_or_else(|| FilesError::Empty { path: file.clone(), expected: "a log" })?;
    notes.extend(in_order(&mut raster).into_iter().map(|n| format!("{file}: {n}")));
    let known: Vec<&str> =
        source.groups().iter().flat_map(|g| &g.channels).map(|c| c.name.as_str()).collect();
    let known = known.join(", ");
    let needed = |raster: &Raster, n: &Names| needed(raster, &file, &known, n);
    let (_, speed_rpm) = needed(&raster, &SPEED)?;
    let (load_name, load) = needed(&raster, &LOAD)?;
    let (_, ve) = needed(&raster, &VE)?;
    let (lambda_name, mut lambda) = needed(&raster, &LAMBDA)?;
    let (_, pulse_ms) = needed(&raster, &PULSE)?;
    if lambda_name.starts_with("afr") {
        let of_tune = given.or(tune.as_ref()).and_then(stoichiometric);
        let ratio = of_tune.unwrap_or(STOICHIOMETRIC);
        lambda.iter_mut().for_each(|v| *v /= ratio);
        notes.push(match of_tune {
            Some(ratio) => format!("{file}: lambda is the air-fuel ratio over {ratio}, the stoichiometric ratio of the tune"),
            None => format!(
                "{file}: lambda is the air-fuel ratio over {STOICHIOMETRIC}, gasoline: the tune does not say another stoichiometric ratio; with another fuel all cells are off by the ratio of the two"
            ),
        });
    }
    if let Some(median) = median(&lambda).filter(|m| !(0.4..=3.0).contains(m)) {
        return Err(LabelJobError::Lambda { file, channel: lambda_name, median });
    }
    if load_name != "fuelload" {
        notes.push(format!("{file}: the load is taken from the channel `{load_name}`"));
    }
    let (gamma_name, gamma) = needed(&raster, &GAMMA)?;
    if let Some(median) = median(&gamma).filter(|m| !PERCENT.contains(m)) {
        return Err(LabelJobError::Correction { file, channel: gamma_name, median });
    }
    let engine = column(&raster, STATE[2]);
    if engine.is_none() {
        notes.push(format!(
            "{file}: no channel of the engine's state: enrichments are seen by coolant and throttle only"
        ));
    }
    let log = Log {
        name: path.file_name().map_or(file.clone(), |n| n.to_string_lossy().into_owned()),
        enrichment: enrichment(&raster, gamma),
        target: vec![1.0; raster.time_s.len()],
        coolant_c: coolant(&raster, &file, notes),
        throttle_rate: column(&raster, STATE[1]).map(|c| c.1),
        // Bits of the state: after-start enrichment 4, warm-up 8, acceleration 16.
        enriching: engine.map(|e| e.1.iter().map(|v| (*v as i64) & (4 | 8 | 16) != 0).collect()),
        speed_rpm,
        load,
        ve,
        lambda,
        pulse_ms,
        time_s: raster.time_s,
    };
    Ok((log, tune))
}

/// Medians of the fuel correction that are one in percent: a running engine gets its fuel, and no third of it nor three times as much.
const PERCENT: std::ops::RangeInclusive<f64> = 33.0..=300.0;

/// Ratio of air to fuel that the tune calls stoichiometric.
fn stoichiometric(tune: &Tune) -> Option<f64> {
    tune.constant("stoich").ok()?.values.first().copied().filter(|s| *s > 0.0)
}

/// Median of what is positive.
pub(super) fn median(v: &[f64]) -> Option<f64> {
    let mut v: Vec<f64> = v.iter().copied().filter(|v| *v > 0.0 && v.is_finite()).collect();
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied()
}

/// Coolant temperature in degC, whatever the log has.
fn coolant(raster: &Raster, file: &str, notes: &mut Vec<String>) -> Option<Vec<f64>> {
    let found = raster.columns.iter().find(|c| STATE[0].contains(&plain(&c.name).as_str()))?;
    let Cells::Number(values) = &found.cells else { return None };
    let unit = found.unit.as_ref().map_or(String::new(), |u| plain(&u.0));
    let as_c: fn(f64) -> f64 = match unit.as_str() {
        "f" | "degf" | "fahrenheit" => |v| (v - 32.0) / 1.8,
        "k" | "kelvin" => |v| v - 273.15,
        "" => {
            notes.push(format!("{file}: the coolant temperature has no unit in the log and counts as degC"));
            return Some(values.clone());
        }
        _ => return Some(values.clone()),
    };
    notes.push(format!("{file}: the coolant temperature is logged in `{unit}` and counts as degC"));
    Some(values.iter().map(|v| as_c(*v)).collect())
}

/// What multiplied the table and is no air: the whole correction without those of air density and altitude.
fn enrichment(raster: &Raster, mut gamma: Vec<f64>) -> Vec<f64> {
    gamma.iter_mut().for_each(|g| *g /= 100.0);
    for names in AIR {
        if let Some((_, air)) = column(raster, names) {
            gamma.iter_mut().zip(air).filter(|(_, a)| *a > 0.0).for_each(|(g, a)| *g /= a / 100.0);
        }
    }
    gamma
}

/// The fuel table of the tune as a label, and what the ECU can hold in it.
pub(super) fn table(
    tune: &Tune,
    definition: Option<&Definition>,
) -> Result<(Label, Option<Held>), LabelJobError> {
    let def = definition.and_then(|d| {
        let name = &d.analyse.as_ref()?[0];
        d.tables.iter().find(|t| t.name == *name).cloned()
    });
    let pair = |a: &str, b: &str| (a.to_string(), b.to_string());
    let def = def.unwrap_or(TableDef {
        name: "veTable1Tbl".into(),
        x: pair("rpmBins", "rpm"),
        y: pair("fuelLoadBins", "fuelLoad"),
        z: "veTable".into(),
    });
    let (z, x, y) = (tune.constant(&def.z)?, tune.constant(&def.x.0)?, tune.constant(&def.y.0)?);
    let axes = vec![Axis::new(&def.x.1, &x.unit, &x.values), Axis::new(&def.y.1, &y.unit, &y.values)];
    let mut label = Label::new(&def.z, &z.unit, axes, &z.values);
    let held = definition.and_then(|d| d.labels.get(&def.z).cloned());
    match &held {
        Some(h) => {
            (label.lower, label.upper) = h.range();
            (label.step, label.origin) = (h.step(), h.offset * h.scale);
        }
        None => {
            label.step = Some(10f64.powi(-(z.digits as i32)));
            label.lower = 0.0;
        }
    }
    label.check()?;
    if !z.values.iter().any(|v| *v > 0.0) {
        let reason = "found no value above 0: an ECU with this table injects nothing".into();
        return Err(dynocal_label::LabelError::Label { label: def.z, reason }.into());
    }
    Ok((label, held))
}

/// The lambda that the target table of the tune asks for.
pub(super) fn target(tune: &Tune, definition: Option<&Definition>) -> Option<Label> {
    let def = definition.and_then(|d| {
        let name = &d.analyse.as_ref()?[1];
        d.tables.iter().find(|t| t.name == *name).cloned()
    });
    let def = def.unwrap_or(TableDef {
        name: "afrTable1Tbl".into(),
        x: ("rpmBinsAFR".into(), "rpm".into()),
        y: ("loadBinsAFR".into(), "fuelLoad".into()),
        z: "afrTable".into(),
    });
    let (z, x, y) =
        (tune.constant(&def.z).ok()?, tune.constant(&def.x.0).ok()?, tune.constant(&def.y.0).ok()?);
    // A table of lambda has values around 1, one of air-fuel ratios around 14.7.
    let ratio =
        if z.values.iter().all(|v| *v < 3.0) { 1.0 } else { stoichiometric(tune).unwrap_or(STOICHIOMETRIC) };
    let values: Vec<f64> = z.values.iter().map(|v| v / ratio).collect();
    let axes = vec![Axis::new(&def.x.1, &x.unit, &x.values), Axis::new(&def.y.1, &y.unit, &y.values)];
    let label = Label::new(&def.z, "-", axes, &values);
    label.check().is_ok().then_some(label)
}
