//! Values of a record of a bed that nothing there can have: a broken number would be taken for what the engine does.

use dynocal_calib::steady::layout::Layout;
use dynocal_files::table::Table;
use dynocal_ident::data::Dataset;

use super::error::MapError;

/// Values beyond this size are faults of a record: no channel of a bed has them in any unit.
const LARGEST: f64 = 1e12;
/// How far beyond its range, as a share of it, an input that a loop drives may stand: the loop of a bed keeps it within, and a sensor is off by little.
const DRIVEN: f64 = 0.025;
/// The same of a free input and of a given channel, which a bed may set where its own limits are.
const SET: f64 = 0.1;
/// The same of the demand that is an axis: what a bed measured where it could not hold it is learnt from.
const DEMANDED: f64 = 0.5;

/// Refuses values that no channel of a bed has.
///
/// # Errors
/// [`MapError::Record`] with file, line and column.
pub(super) fn in_size(table: &Table, all: &Dataset) -> Result<(), MapError> {
    for c in &all.channels {
        if let Some(row) = c.values.iter().position(|v| v.abs() > LARGEST) {
            return Err(MapError::Record(format!(
                "{}, {}, column `{}`: found {:e}, expected a number below {LARGEST:e} in size",
                table.file,
                table.place(row),
                c.name,
                c.values[row]
            )));
        }
    }
    Ok(())
}

/// What of row `row` is far outside of what the spec lets an input, a given channel or the demand of an axis be, in words; none where all may be.
pub(super) fn doubt(all: &Dataset, row: usize, layout: &Layout) -> Option<String> {
    let p = &layout.problem;
    let driven: Vec<&String> = layout.driven().into_iter().map(|k| &p.inputs[k].name).collect();
    let room = |name: &String| if driven.contains(&name) { DRIVEN } else { SET };
    let inputs = p.inputs.iter().map(|i| (&i.name, &i.unit, [i.lower, i.upper], room(&i.name)));
    let given = p.given.iter().map(|g| (&g.name, &g.unit, [g.lower, g.upper], SET));
    let axis = |name: &str| layout.factors.iter().any(|f| f.name == name);
    let demands = p.demands.iter().filter(|d| axis(&d.output));
    let demands = demands.map(|d| (&d.output, &d.unit, [d.lower, d.upper], DEMANDED));
    let all = inputs.chain(given).chain(demands).filter_map(|(name, unit, [lower, upper], share)| {
        let value = all.channels.iter().find(|c| c.name == *name)?.values[row];
        let room = share * (upper - lower);
        let out = value < lower - room || value > upper + room;
        out.then(|| format!("`{name}` is {value} where {lower} to {upper} {unit} are possible: not believed"))
    });
    all.into_iter().next()
}

/// Fewest values beside which one can be odd.
const FEWEST: usize = 8;
/// Share of values above 0 from which on a response counts as positive.
const POSITIVE: f64 = 0.9;
/// Standard deviations from the median beyond which a value is not believed: of the logarithm of a positive response, which goes through decades, with a
/// standard deviation of at least a fifth, and of any other.
const FAR: [f64; 2] = [10.0, 20.0];
const LEAST: f64 = 0.2;
/// Standard deviation of the logarithm up to which a response is never near 0.
const NARROW: f64 = 0.5;
/// Median absolute deviation to standard deviation of a normal variable.
const NORMAL: f64 = 1.4826;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Whether `value` is no value of a response that had those of `all` (itself among them): a sensor that is broken or not connected. What is only rare is believed: a response may go
/// through decades, and no limit may be learnt from what was left out.
pub(super) fn odd(value: f64, all: &[f64]) -> bool {
    if all.len() < FEWEST {
        return false;
    }
    let spread =
        |values: &[f64], centre: f64| NORMAL * median(values.iter().map(|v| (v - centre).abs()).collect());
    let positive: Vec<f64> = all.iter().copied().filter(|v| *v > 0.0).collect();
    if (positive.len() as f64) < POSITIVE * all.len() as f64 {
        let centre = median(all.to_vec());
        let std = spread(all, centre);
        return std > 0.0 && (value - centre).abs() > FAR[1] * std;
    }
    let logs: Vec<f64> = positive.iter().map(|v| v.ln()).collect();
    let centre = median(logs.clone());
    let std = spread(&logs, centre).max(LEAST);
    // About 0 a meter may be a little below it.
    if value > 0.0 {
        (value.ln() - centre).abs() > FAR[0] * std
    } else {
        std <= NARROW || -value > 0.5 * centre.exp()
    }
}

#[cfg(test)]
mod tests {
    use super::odd;

    /// Temperatures, a knock index that goes through a decade and reads a little below 0, and a response of both signs.
    #[test]
    fn broken_sensors_are_odd_and_rare_values_are_not() {
        let with = |value: f64, others: &dyn Fn(f64) -> f64| {
            let mut all: Vec<f64> = (0..30).map(|k| others(f64::from(k) / 29.0)).collect();
            all.push(value);
            odd(value, &all)
        };
        let heat = |t: f64| 850.0 + 300.0 * t;
        for (value, broken) in [(-999.0, true), (0.0, true), (9999.0, true), (1400.0, false), (500.0, false)]
        {
            assert_eq!(with(value, &heat), broken, "{value}");
        }
        let boost = |t: f64| 101.0 + 2.0 * t;
        assert!(!with(210.0, &boost));
        let knock = |t: f64| 0.02 * (4.0 * t).exp();
        for (value, broken) in [(-0.01, false), (0.0, false), (3.0, false), (-5.0, true), (1e9, true)] {
            assert_eq!(with(value, &knock), broken, "{value}");
        }
        let signed = |t: f64| 10.0 * t - 5.0;
        for (value, broken) in [(-999.0, true), (20.0, false)] {
            assert_eq!(with(value, &signed), broken, "{value}");
        }
        assert!(!odd(-999.0, &[900.0, 950.0, -999.0]), "too few to tell");
    }
}
