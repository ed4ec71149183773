//! Signals of a campaign, by the table of signals.

use dynocal_ident::signal;
use dynocal_numerics::registry::BuildError;
use dynocal_numerics::rng::Rng64;

/// `n` samples of an APRBS.
///
/// # Errors
/// [`BuildError`] when the numbers do not fit the signal.
pub(super) fn aprbs(
    range: (f64, f64),
    levels: usize,
    hold_s: f64,
    phase_s: f64,
    n: usize,
    sample_time_s: f64,
    rng: &mut Rng64,
) -> Result<Vec<f64>, BuildError> {
    let mut keys = table(&[("lo", range.0), ("hi", range.1), ("hold_s", hold_s), ("phase_s", phase_s)]);
    keys.insert("levels".into(), toml::Value::Integer(levels as i64));
    let mut u = vec![0.0; n];
    signal::signal("aprbs", &keys)?.fill(&mut u, sample_time_s, rng)?;
    Ok(u)
}

/// `n` samples of a triangular sweep, `sweep_s` from end to end.
///
/// # Errors
/// [`BuildError`] when the numbers do not fit the signal.
pub(super) fn sweep(
    range: (f64, f64),
    sweep_s: f64,
    dwell_s: f64,
    n: usize,
    sample_time_s: f64,
) -> Result<Vec<f64>, BuildError> {
    let period_s = 2.0 * (sweep_s + dwell_s);
    let keys = table(&[("lo", range.0), ("hi", range.1), ("period_s", period_s), ("dwell_s", dwell_s)]);
    let mut u = vec![0.0; n];
    // The sweep has nothing random in it.
    signal::signal("sweep", &keys)?.fill(&mut u, sample_time_s, &mut Rng64::new(0))?;
    Ok(u)
}

fn table(pairs: &[(&str, f64)]) -> toml::Table {
    pairs.iter().map(|(k, v)| ((*k).to_string(), toml::Value::Float(*v))).collect()
}
