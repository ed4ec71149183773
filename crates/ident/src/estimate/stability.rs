//! Whether the free run of a fit can be trusted beyond the record: it must forget where it starts.

use dynocal_numerics::status::Status;

use crate::experiment::Experiment;
use crate::model::{Model, Run};

/// Disturbance of the start in standard deviations of the output.
const DISTURBANCE: f64 = 1e-3;
/// Share of it that may be left at the end of a record.
const LEFT: f64 = 0.1;
/// How often the record is repeated to see where a run that does not forget goes.
const REPEATED: usize = 10;

/// A sentence when a disturbed start is not forgotten over the longest record: a pole, or what acts as one, lies on or
/// outside the unit circle. It then also says what the free run does when the record's inputs are repeated.
pub(super) fn stability_warning(model: &dyn Model, theta: &[f64], data: &[Experiment]) -> Option<String> {
    let e = data.iter().max_by_key(|e| e.len()).filter(|_| model.output_lag() > 0)?;
    let run = e.run(model);
    let (mut y, mut disturbed) = (vec![0.0; e.len()], vec![0.0; e.len()]);
    if model.simulate(theta, &run, &mut y) != Status::Converged {
        return None;
    }
    let samples = e.len() - run.start;
    let step = DISTURBANCE * spread(&y[run.start..]).max(f64::MIN_POSITIVE);
    let moved: Vec<f64> = e.y.iter().map(|v| v + step).collect();
    let status = model.simulate(theta, &Run { y: &moved, ..run }, &mut disturbed);
    let tail = run.start + samples - (samples / 10).max(1);
    let left = (tail..e.len()).map(|t| (disturbed[t] - y[t]).abs()).fold(0.0, f64::max);
    if status == Status::Converged && left <= LEFT * step {
        return None;
    }
    Some(format!(
        "the free run on {} does not forget where it starts (of a disturbance {:.0}% are left after {samples} samples): a \
         pole lies near, on or outside the unit circle; with the inputs repeated {}",
        e.name,
        100.0 * left / step,
        repeated(model, theta, e, &y)
    ))
}

/// What the free run does when the inputs of the record come again and again.
fn repeated(model: &dyn Model, theta: &[f64], e: &Experiment, first_run: &[f64]) -> String {
    let lag = model.max_lag();
    let m = model.n_inputs();
    let u: Vec<f64> = e.u.iter().copied().cycle().take(REPEATED * e.u.len()).collect();
    let mut y = vec![0.0; REPEATED * e.len()];
    y[..e.len()].copy_from_slice(first_run);
    let (known, mut out) = (y.clone(), vec![0.0; y.len()]);
    debug_assert_eq!(u.len(), m * y.len());
    let status = model.simulate(theta, &Run { u: &u, y: &known, start: e.len().max(lag) }, &mut out);
    if status != Status::Converged {
        let at = out.iter().position(|v| !v.is_finite()).unwrap_or(0);
        return format!("it diverges at sample {at}");
    }
    let size = |v: &[f64]| v.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let growth = size(&out[(REPEATED - 1) * e.len()..]) / size(first_run).max(f64::MIN_POSITIVE);
    let growth = if growth < 1e4 { format!("{growth:.3}") } else { format!("{growth:.1e}") };
    format!("the tenth passage is {growth} times as large as the first")
}

fn spread(v: &[f64]) -> f64 {
    let mean = v.iter().sum::<f64>() / v.len().max(1) as f64;
    (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / v.len().max(1) as f64).sqrt()
}
