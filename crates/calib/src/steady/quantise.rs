//! Inputs in the steps of an ECU: of the settings around an optimum, the one of least cost that keeps all limits.

use super::cell::{CellOptimum, Setting};

/// Most settings that are tried for one cell.
const MOST: usize = 4096;

/// The optimum `o` on a raster: free factor i in multiples of `steps[i]` (none: as it is). Rounding each input by itself may pass a
/// limit, so that all combinations of the values below and above are compared, where there are too many of them those that differ from the
/// nearest in one input or two.
pub fn quantise(setting: &Setting, o: &CellOptimum, steps: &[Option<f64>]) -> CellOptimum {
    let near = nearby(setting, o, steps, 0);
    if near.feasible || steps.iter().all(Option::is_some) {
        return near;
    }
    // Inputs without a step make room for what rounding took.
    let far = nearby(setting, o, steps, PLACES);
    if setting.better(&far, &near) { far } else { near }
}

/// The multiple n of a step in as many decimals as the step has: 7 times 0.1 is 0.7, not 0.7000000000000001.
pub fn multiple(n: f64, step: f64) -> f64 {
    let decimals = format!("{step}").split_once('.').map_or(0, |(_, after)| after.len());
    let exact = n * step;
    let short: f64 = format!("{exact:.decimals$}").parse().unwrap_or(exact);
    // A step such as 1/3 has no end: then the product is as good.
    if (short - exact).abs() <= 4.0 * f64::EPSILON * exact.abs() { short } else { exact }
}

/// Values of an input without a step that are tried where rounding the others leaves no setting within all limits.
const PLACES: usize = 40;

/// The best of the settings around `o`; inputs without a step as they are, or at one of `places` more values of their range.
fn nearby(setting: &Setting, o: &CellOptimum, steps: &[Option<f64>], places: usize) -> CellOptimum {
    let axes = setting.axes;
    let values = |i: usize| -> Vec<f64> {
        let x = o.x[axes + i];
        let range = setting.ranges[axes + i];
        let Some(step) = steps[i] else {
            let even = (0..places).map(|k| range.value_at(k as f64 / (places - 1) as f64));
            return std::iter::once(x).chain(even).collect();
        };
        let nearest = (x / step).round();
        let (below, above) = ((x / step).floor(), (x / step).ceil());
        let mut all: Vec<f64> = [nearest, below, above, below - 1.0, above + 1.0]
            .iter()
            .map(|n| multiple(*n, step))
            .filter(|v| *v >= range.lower - 1e-9 * step && *v <= range.upper + 1e-9 * step)
            .collect();
        let mut seen = Vec::new();
        all.retain(|v| {
            !seen.contains(v) && {
                seen.push(*v);
                true
            }
        });
        // No multiple lies within the range: the value stays.
        if all.is_empty() { vec![x] } else { all }
    };
    let choices: Vec<Vec<f64>> = (0..steps.len()).map(values).collect();
    let mut best: Option<CellOptimum> = None;
    let mut offer = |picks: &[usize]| {
        let x = o.x[..axes].iter().copied().chain(picks.iter().zip(&choices).map(|(p, c)| c[*p]));
        let x: Vec<f64> = x.collect();
        let mut found = setting.judge(&x, o.status, None);
        // The prices are those of the optimum that was rounded.
        found.prices.iter_mut().zip(&o.prices).for_each(|(new, old)| new.saves = old.saves);
        if best.as_ref().is_none_or(|b| setting.better(&found, b)) {
            best = Some(found);
        }
    };
    let all: usize =
        choices.iter().map(Vec::len).try_fold(1usize, |n, c| n.checked_mul(c)).unwrap_or(MOST + 1);
    if all <= MOST {
        for number in 0..all {
            offer(&digits(number, &choices));
        }
    } else {
        let nearest = vec![0; choices.len()];
        offer(&nearest);
        for i in 0..choices.len() {
            for a in 1..choices[i].len() {
                let mut one = nearest.clone();
                one[i] = a;
                offer(&one);
                for j in i + 1..choices.len() {
                    for b in 1..choices[j].len() {
                        let mut two = one.clone();
                        two[j] = b;
                        offer(&two);
                    }
                }
            }
        }
    }
    best.unwrap_or_else(|| o.clone())
}

/// Combination `number` of the choices.
fn digits(mut number: usize, choices: &[Vec<f64>]) -> Vec<usize> {
    let digit = |c: &Vec<f64>| {
        let d = number % c.len();
        number /= c.len();
        d
    };
    choices.iter().map(digit).collect()
}
