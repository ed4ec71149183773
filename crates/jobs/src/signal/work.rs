//! The work: fill every channel, analyse it, see how the channels go together.

use dynocal_ident::excitation::correlation::correlation;
use dynocal_ident::excitation::coverage::{Coverage, coverage, pair_coverage};
use dynocal_ident::signal::analysis::analyse;
use dynocal_ident::signal::signal;
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;

use super::result::{Made, SignalError};
use super::spec::{Job, Wanted};
use crate::estimate::Estimate;

/// Most lags of the autocorrelation.
const LAGS: usize = 200;
/// Correlation from which effects are hard to tell apart, whatever chance allows.
const TOGETHER: f64 = 0.3;

/// What making the signals takes: samples, and the segments and lags of their analysis.
pub fn estimate(job: &Job) -> Estimate {
    let (n, m) = (job.samples as f64, job.channels.len() as f64);
    let length = format!("{} samples of {} s", job.samples, job.sample_time_s);
    let plan =
        Estimate::new(&job.name).line("record", length).line("run folder", job.out.display().to_string());
    job.channels
        .iter()
        .fold(plan, |plan, c| plan.line(format!("channel {}", c.name), format!("{} [{}]", c.signal, c.unit)))
        .memory(8.0 * n * (2.0 * m + 4.0))
        .work(m * n * (2.0 * LAGS as f64 + 5.0 * n.log2()))
}

/// Makes and analyses the signals in memory.
///
/// # Errors
/// [`SignalError`]: keys that do not fit, a sample that is not finite, an interruption.
pub fn make(job: &Job, watch: Watch) -> Result<Made, SignalError> {
    let lags = LAGS.min(job.samples / 2);
    let (mut columns, mut analyses) = (Vec::new(), Vec::new());
    for (k, w) in job.channels.iter().enumerate() {
        if watch.interrupted() {
            return Err(SignalError::Interrupted);
        }
        watch.fraction(k as f64 / job.channels.len() as f64);
        let u = fill(w, job, k as u64)?;
        let not_finite = || SignalError::NotFinite { channel: w.name.clone(), signal: w.signal.clone() };
        analyses.push(analyse(&u, job.sample_time_s, lags).ok_or_else(not_finite)?);
        columns.push(u);
    }
    let coverage: Vec<Coverage> =
        job.channels.iter().zip(&columns).filter_map(|(w, u)| coverage(&w.name, u, None)).collect();
    let mut made = Made {
        columns,
        analyses,
        coverage,
        pairs: Vec::new(),
        correlations: Vec::new(),
        warnings: rounded(job),
    };
    together(job, lags, &mut made);
    Ok(made)
}

/// Times that are held for another number of samples than they ask for.
fn rounded(job: &Job) -> Vec<String> {
    let dt = job.sample_time_s;
    let one = |w: &Wanted| {
        let of = |key: &str| w.keys.get(key).and_then(|v| v.as_float().or(v.as_integer().map(|v| v as f64)));
        let held = |key: &&str| {
            let asked = of(key)?;
            let samples = (asked / dt).round();
            ((samples * dt - asked).abs() > 1e-6 * dt).then(|| {
                format!(
                    "`{}`: {key} = {asked} s is no whole number of samples of {dt} s: it is held for {samples} of them",
                    w.name
                )
            })
        };
        ["hold_s", "hold_max_s"].iter().filter_map(held).collect::<Vec<_>>()
    };
    job.channels.iter().flat_map(one).collect()
}

fn fill(w: &Wanted, job: &Job, stream: u64) -> Result<Vec<f64>, SignalError> {
    let refused = |source| SignalError::Build { channel: w.name.clone(), source };
    let mut u = vec![0.0; job.samples];
    let made = signal(&w.signal, &w.keys).map_err(refused)?;
    made.fill(&mut u, job.sample_time_s, &mut Rng64::stream(job.seed, stream)).map_err(refused)?;
    Ok(u)
}

/// Coverage and correlation of every pair.
fn together(job: &Job, lags: usize, made: &mut Made) {
    for b in 1..made.coverage.len() {
        for a in 0..b {
            let (u, v) = (&made.columns[a], &made.columns[b]);
            made.pairs.push(pair_coverage(&made.coverage[a], &made.coverage[b], u, v));
            let named = |k: usize, u| (job.channels[k].name.as_str(), u);
            let Some(c) = correlation(named(a, &u[..]), named(b, &v[..]), lags) else { continue };
            if c.r.abs() > c.bound.max(TOGETHER) {
                made.warnings.push(format!(
                    "`{}` and `{}` move together (correlation {:.2}, independent ones stay within {:.2}): their effects are \
                     hard to tell apart",
                    c.a, c.b, c.r, c.bound
                ));
            }
            made.correlations.push(c);
        }
    }
}
