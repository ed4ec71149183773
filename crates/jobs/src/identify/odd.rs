//! What the values of channels say before any fit: copies of each other, stand-ins for missing samples.

use dynocal_ident::data::Dataset;

use super::finding::{Finding, Grade, Topic};
use super::spec::Job;

/// What of the variance of one channel another may leave open for the two to be one.
const SAME: f64 = 1e-9;
/// How often the range of all other values a repeated value must lie beyond it to be no measurement.
const BEYOND: f64 = 3.0;

/// Copies among inputs and outputs, and values that stand for missing ones, in the estimation records.
pub fn of_values(job: &Job, records: &[Dataset]) -> Vec<Finding> {
    let mut names: Vec<&String> = Vec::new();
    for name in job.targets.iter().flat_map(|t| t.inputs.iter().chain([&t.target])) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let channels: Vec<Vec<f64>> = names.iter().map(|n| joined(records, n)).collect();
    // Targets share their inputs: each pair is compared once.
    let pairs = (0..names.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    let alike: Vec<[&String; 2]> =
        pairs.filter(|&(a, b)| one(&channels[a], &channels[b])).map(|(a, b)| [names[a], names[b]]).collect();
    let warning =
        |about: &String, text: String| Finding::new(Grade::Warning, about.as_str(), text).on(Topic::Values);
    let mut out = Vec::new();
    for t in &job.targets {
        for (k, a) in t.inputs.iter().enumerate() {
            let same = |b: &String| alike.iter().any(|p| p.contains(&a) && p.contains(&b));
            if same(&t.target) && *a != t.target {
                let text = format!(
                    "`{a}` is a copy of it, but for scale and offset: the model reads its answer from there"
                );
                out.push(warning(&t.target, text));
            }
            for b in t.inputs[k + 1..].iter().filter(|b| same(b)) {
                let text = format!(
                    "`{a}` and `{b}` move as one to nine digits: what each of them does cannot be told apart"
                );
                out.push(warning(&t.target, text));
            }
        }
    }
    for (name, values) in names.iter().zip(&channels) {
        if let Some((samples, times)) = stand_in(values) {
            let text = format!(
                "{samples} samples of `{name}` have one and the same value, {times:.0} times the range of all others away from them: if it \
                 stands for missing samples, empty those cells (`missing = \"mark\"`) or let step `hampel` take them out"
            );
            out.push(warning(name, text));
        }
    }
    out
}

fn joined(records: &[Dataset], name: &str) -> Vec<f64> {
    records.iter().filter_map(|d| d.values(name).ok()).flatten().copied().collect()
}

/// Whether two channels are one but for scale and offset: 1 - r^2 below [`SAME`] over the samples that both have.
fn one(a: &[f64], b: &[f64]) -> bool {
    let both = || a.iter().zip(b).filter(|(x, y)| x.is_finite() && y.is_finite());
    let n = both().count() as f64;
    if a.len() != b.len() || n < 3.0 {
        return false;
    }
    let (ma, mb) = both().fold((0.0, 0.0), |(p, q), (x, y)| (p + x / n, q + y / n));
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (x, y) in both() {
        let (x, y) = (x - ma, y - mb);
        (aa, bb, ab) = (aa + x * x, bb + y * y, ab + x * y);
    }
    // Least squares of one on the other, by what is left: 1 - r^2 itself would be a difference of nearly equal numbers.
    let gain = ab / aa;
    let left: f64 = both().map(|(x, y)| ((y - mb) - gain * (x - ma)).powi(2)).sum();
    aa > 0.0 && bb > 0.0 && left < SAME * bb
}

/// How many samples have one value far from all others, and how many ranges of those away.
fn stand_in(values: &[f64]) -> Option<(usize, f64)> {
    let finite = || values.iter().copied().filter(|v| v.is_finite());
    let (least, most) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), v| (l.min(v), m.max(v)));
    let beyond = |extreme: f64| {
        let samples = finite().filter(|v| *v == extreme).count();
        let rest = finite().filter(|v| *v != extreme);
        let (low, high) = rest.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), v| (l.min(v), m.max(v)));
        let times = (low - extreme).max(extreme - high) / (high - low);
        (samples > 1 && high > low && times > BEYOND).then_some((samples, times))
    };
    beyond(most).or_else(|| beyond(least))
}

#[cfg(test)]
mod tests {
    use super::{one, stand_in};

    #[test]
    fn copies_are_told_from_what_only_resembles() {
        let a: Vec<f64> = (0..200).map(|t| (f64::from(t) * 0.37).sin() + 1e6).collect();
        let copy: Vec<f64> = a.iter().map(|v| 3.0 - 2.0 * v).collect();
        let like: Vec<f64> = a.iter().enumerate().map(|(t, v)| v + 1e-3 * (t as f64 * 1.7).sin()).collect();
        assert!(one(&a, &copy) && !one(&a, &like) && !one(&a, &vec![1.0; 200]));
    }

    #[test]
    fn a_value_that_no_sensor_gave_is_seen() {
        let mut v: Vec<f64> = (0..100).map(|t| f64::from(t % 10)).collect();
        assert_eq!(stand_in(&v), None);
        (v[3], v[40], v[41]) = (9999.0, 9999.0, 9999.0);
        assert!(stand_in(&v).is_some_and(|(n, times)| n == 3 && (times - 9990.0 / 9.0).abs() < 1e-9));
        // Two levels are a signal.
        assert_eq!(stand_in(&[0.0, 1.0, 1.0, 0.0]), None);
        // One peak may have been measured.
        v[3] = 1.0;
        v[40] = 1.0;
        assert_eq!(stand_in(&v), None);
    }
}
