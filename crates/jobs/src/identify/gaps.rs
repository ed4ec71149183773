//! Missing samples on the way to an estimator that needs every one.
//!
//! Gaps are bridged by straight lines. A bridged output is compared with nothing; in a one-step fit neither is a sample
//! whose regressors hold a bridged value. Linear models with a noise model estimate missing samples themselves.

use dynocal_ident::data::runs;
use dynocal_ident::estimate::missing::bridged;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::form::Form;

use super::spec::Target;

/// Records without gaps, and what was done, in sentences.
#[derive(Debug, Default)]
pub struct Bridged {
    /// Records.
    pub data: Vec<Experiment>,
    /// What was missing.
    pub remarks: Vec<String>,
}

/// Bridges the gaps of `data` for a fit of `model`; `free_run` where the estimator simulates.
pub fn bridge(t: &Target, model: &dyn Form, data: &[Experiment], free_run: bool) -> Bridged {
    let mut out = Bridged::default();
    // A prediction with a noise model may remember every sample as long as the longest.
    let whole = || (0..t.inputs.len()).flat_map(|i| (0..=model.memory()).map(move |lag| (i, lag))).collect();
    let window: Vec<(usize, usize)> = model.dynamics().map_or_else(whole, |m| m.window().to_vec());
    let output_lag = model.dynamics().map_or(model.memory(), dynocal_ident::model::Model::output_lag);
    for e in data {
        let (mut whole, missing) = bridged(e);
        if missing.is_empty() {
            out.data.push(whole);
            continue;
        }
        let n = e.len();
        let mut weights = if e.weights.is_empty() { vec![1.0; n] } else { e.weights.clone() };
        for &t in &missing.outputs {
            let reach = if free_run { 0 } else { output_lag };
            weights[t..(t + reach + 1).min(n)].fill(0.0);
        }
        if !free_run {
            for &(i, t) in &missing.inputs {
                let lags = window.iter().filter(|w| w.0 == i);
                lags.filter(|w| t + w.1 < n).for_each(|w| weights[t + w.1] = 0.0);
            }
        }
        let left = weights.iter().filter(|w| **w > 0.0).count();
        out.remarks.push(format!(
            "{}: {} missing samples bridged by straight lines; {left} of {n} samples enter the fit",
            e.name,
            missing.outputs.len() + missing.inputs.len()
        ));
        out.remarks.extend(long_gaps(t, model, e));
        whole.weights = weights;
        out.data.push(whole);
    }
    out
}

/// A straight line over more samples than the model remembers is an invented record.
fn long_gaps(t: &Target, model: &dyn Form, e: &Experiment) -> Vec<String> {
    let m = t.inputs.len();
    let lag = model.memory().max(1);
    let mut out = Vec::new();
    let mut tell = |channel: &str, longest: usize| {
        if longest > lag {
            out.push(format!(
                "{}: a gap of {longest} samples in `{channel}` is longer than the longest lag ({lag}): split the record there (step `missing`)",
                e.name
            ));
        }
    };
    let longest =
        |bad: &dyn Fn(usize) -> bool| runs(e.len(), bad).iter().map(|g| g.to - g.from).max().unwrap_or(0);
    for (i, name) in t.inputs.iter().enumerate() {
        tell(name, longest(&|k| e.u[k * m + i].is_nan()));
    }
    tell(&t.target, longest(&|k| e.y[k].is_nan()));
    out
}
