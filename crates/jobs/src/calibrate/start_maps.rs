//! Start of an optimisation from the maps that an ECU has: inputs follow them along the references of the start record.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::context::Context;
use super::error::ChainError;
use dynocal_export::characteristic::{Axis, Characteristic};
use dynocal_export::evaluate::lookup;
use dynocal_export::format;
use dynocal_export::package::Extrapolation;
use dynocal_files::units;

/// A map in the units of the problem.
#[derive(Clone, Debug)]
pub(super) struct StartMap {
    /// Place of the input in the problem.
    pub input: usize,
    map: Characteristic,
    /// Place of each axis' channel among the references.
    from: Vec<usize>,
    bounds: (f64, f64),
}

/// A channel that an axis may take.
struct Reference<'a> {
    name: &'a str,
    unit: &'a str,
}

/// The start maps of a spec; none where it has none.
///
/// # Errors
/// [`ChainError`]: a file that cannot be read, a characteristic that is not there, an axis without a channel, units of other
/// dimensions.
pub(super) fn start_maps(ctx: &Context) -> Result<Vec<StartMap>, ChainError> {
    let Some(spec) = &ctx.spec.optimise.start_maps else { return Ok(Vec::new()) };
    let problem = &ctx.spec.problem;
    let known = characteristics(&spec.files)?;
    let demands = problem.demands.iter().map(|d| Reference { name: &d.output, unit: &d.unit });
    let given = problem.given.iter().map(|g| Reference { name: &g.name, unit: &g.unit });
    let references: Vec<Reference> = demands.chain(given).collect();
    let one = |(input, name): (&String, &String)| {
        let key = format!("optimise.start_maps.maps.{input}");
        let place = problem.inputs.iter().position(|i| i.name == *input);
        let place = place.ok_or_else(|| fault(&key, input, "an input of the problem"))?;
        let i = &problem.inputs[place];
        let found = known.iter().find(|c| c.name == *name).ok_or_else(|| {
            let names: Vec<&str> = known.iter().map(|c| c.name.as_str()).collect();
            fault(&key, &format!("`{name}`"), &format!("one of {}", names.join(", ")))
        })?;
        let (map, from) =
            in_units(found, &i.unit, &references, &spec.axes).map_err(|(f, e)| fault(&key, &f, &e))?;
        Ok(StartMap { input: place, map, from, bounds: (i.lower, i.upper) })
    };
    spec.maps.iter().map(one).collect()
}

fn fault(key: &str, found: &str, expected: &str) -> ChainError {
    ChainError::Spec { key: key.into(), found: found.into(), expected: expected.into() }
}

fn characteristics(files: &[PathBuf]) -> Result<Vec<Characteristic>, ChainError> {
    let mut all = Vec::new();
    for path in files {
        let read = |path: &Path| {
            let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
            format::read(&path.display().to_string(), &bytes).map_err(|e| e.to_string())
        };
        let package = read(path).map_err(|e| {
            fault("optimise.start_maps.files", &path.display().to_string(), &format!("maps ({e})"))
        })?;
        all.extend(package.characteristics);
    }
    Ok(all)
}

/// The map in the unit of its input and its axes in those of their channels, with the places of these; or found and expected.
fn in_units(
    c: &Characteristic,
    unit: &str,
    references: &[Reference],
    axes: &BTreeMap<String, String>,
) -> Result<(Characteristic, Vec<usize>), (String, String)> {
    let mut map = c.clone();
    if map.axes.is_empty() && map.values.len() != 1 || map.axes.len() > 2 {
        return Err((
            format!("`{}` with {} values", c.name, c.values.len()),
            "a scalar, a curve or a map".into(),
        ));
    }
    convert(&mut map.values, &c.unit, unit, &c.name)?;
    let mut from = Vec::new();
    for axis in &mut map.axes {
        let named = [&axis.input, &axis.name].into_iter().find_map(|n| axes.get(n));
        let is_it = |r: &Reference| match named {
            Some(name) => r.name == name,
            None => r.name == axis.input || r.name == axis.name,
        };
        let place = references.iter().position(is_it).ok_or_else(|| {
            let names: Vec<&str> = references.iter().map(|r| r.name).collect();
            let expected = format!("in optimise.start_maps.axes its channel, one of {}", names.join(", "));
            (format!("the axis `{}` of `{}`", label(axis), c.name), expected)
        })?;
        let own = axis.unit.clone();
        let what = format!("axis {} of {}", label(axis), c.name);
        convert(&mut axis.points, &own, references[place].unit, &what)?;
        from.push(place);
    }
    // A conversion may turn an axis round (never with the units that we know), and rounding may make points equal.
    map.check().map_err(|e| (e.to_string(), "a map that is still one in the units of the problem".into()))?;
    Ok((map, from))
}

fn label(axis: &Axis) -> &str {
    if axis.name.is_empty() { &axis.input } else { &axis.name }
}

/// Values of one unit in another; a unit that is empty on either side is taken for the other.
fn convert(values: &mut [f64], from: &str, to: &str, what: &str) -> Result<(), (String, String)> {
    let none = |u: &str| u.trim().is_empty() || u.trim() == "-";
    if from == to || none(from) || none(to) {
        return Ok(());
    }
    let (factor, offset) = units::conversion(&units::normalise(from), &units::normalise(to))
        .ok_or_else(|| (format!("`{what}` in {from}"), format!("a unit that converts to {to}")))?;
    values.iter_mut().for_each(|v| *v = *v * factor + offset);
    Ok(())
}

impl StartMap {
    /// The input along columns of (demands, given channels), inside its bounds; beyond its axes a map keeps its value.
    pub(super) fn along(&self, references: &[&[f64]], samples: usize) -> Vec<f64> {
        let mut at = vec![0.0; self.from.len()];
        let mut value = |t: usize| {
            at.iter_mut().zip(&self.from).for_each(|(x, k)| *x = references[*k][t]);
            let y = match self.from.is_empty() {
                true => self.map.values[0],
                false => lookup(&self.map, &at, Extrapolation::Clip),
            };
            y.clamp(self.bounds.0, self.bounds.1)
        };
        (0..samples).map(&mut value).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(name: &str, unit: &str, points: &[f64]) -> Axis {
        Axis {
            name: name.into(),
            description: String::new(),
            unit: unit.into(),
            input: String::new(),
            points: points.to_vec(),
            shared: false,
        }
    }

    /// z = x + 10 y over its corners, x in kNm-like units: bilinear between them, held beyond them.
    #[test]
    fn a_map_in_other_units_gives_the_values_of_its_plane() {
        let c = Characteristic {
            name: "KF".into(),
            description: String::new(),
            unit: "deg".into(),
            axes: vec![axis("n_mot", "1/min", &[1000.0, 2000.0]), axis("torque", "lbf ft", &[0.0, 100.0])],
            values: vec![10.0, 20.0, 15.0, 25.0],
            limits: None,
        };
        let references = [Reference { name: "torque", unit: "Nm" }, Reference { name: "speed", unit: "rpm" }];
        let refused = in_units(&c, "deg", &references, &BTreeMap::new()).unwrap_err();
        assert!(refused.0.contains("n_mot") && refused.1.contains("torque, speed"), "{refused:?}");
        let axes = BTreeMap::from([("n_mot".to_string(), "speed".to_string())]);
        let (map, from) = in_units(&c, "deg", &references, &axes).unwrap();
        assert_eq!(from, [1, 0]);
        let start = StartMap { input: 0, map, from, bounds: (0.0, 24.0) };
        // 1 lbf ft = 1.3558179483314004 Nm by definition.
        let torque = [0.0, 0.5 * 135.581_794_833_140_04, 500.0];
        let speed = [1500.0, 1250.0, 9000.0];
        let found = start.along(&[&torque, &speed], 3);
        for (y, want) in found.iter().zip([15.0, 15.0, 24.0]) {
            assert!((y - want).abs() < 1e-9, "{found:?}");
        }
        assert!(in_units(&c, "Nm", &references, &axes).unwrap_err().0.contains("deg"));
    }
}
