//! Throttle and manifold from the pressure of the records.

use super::follow::shown;
use super::record::TransientRecord;
use super::search::searched;
use super::worth::pays;
use super::{FuellingError, Rested, length};
use crate::fuelling::Fuelling;
use crate::fuelling::filling::Filling;
use rayon::prelude::*;

/// Rates of the throttle that the search begins from, over that which the lag alone would make of the largest step of the records.
const RATES: [f64; 3] = [0.5, 0.25, 0.125];

/// Throttle by the rests; gain and lag of the filling, and where it pays the rate of the throttle, by the pressure of the records.
pub(super) fn filled(
    records: &[TransientRecord<'_>],
    rested: &[Rested],
    start: Fuelling,
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Fuelling, FuellingError> {
    let point = |r: &Rested| {
        let flow = start.air(r.coolant_c, r.cams_deg).flow(r.speed_rpm, r.map_kpa);
        [flow, r.map_kpa, r.throttle_deg, r.upstream_kpa]
    };
    let points: Vec<[f64; 4]> = rested.iter().map(point).collect();
    let filling = start.filling.of_rest(&points)?;
    let with = |x: &[f64]| Fuelling {
        filling: Filling {
            gain: x[0].exp(),
            throttle_lag_s: x[1].exp(),
            throttle_rate_deg_s: x.get(2).map(|rate| rate.exp()),
            ..filling.clone()
        },
        ..start.clone()
    };
    let errors = |x: &[f64], out: &mut [f64]| {
        let f = with(x);
        let shown = records.iter().flat_map(|r| r.map_kpa.iter().zip(shown(r, &f)));
        out.iter_mut().zip(shown).for_each(|(e, (m, s))| *e = m - s);
        out.iter().all(|v| v.is_finite())
    };
    let samples = length(records);
    let from = [filling.gain.ln(), filling.throttle_lag_s.ln()];
    let plain = searched("filling", &errors, samples, &from, interrupt)?;
    let steps = records.iter().flat_map(|r| r.throttle_deg.windows(2)).map(|w| (w[1] - w[0]).abs());
    let fastest = steps.fold(0.0, f64::max) / plain.x[1].exp();
    let limited = |share: &f64| {
        let from = [plain.x[0], plain.x[1], (share * fastest.max(1e-6)).ln()];
        match searched("rate of the throttle", &errors, samples, &from, interrupt) {
            // A rate that the records do not tell may run away.
            Err(FuellingError::Search { .. }) => Ok(None),
            found => found.map(Some),
        }
    };
    let tries = RATES.par_iter().map(limited).collect::<Result<Vec<_>, FuellingError>>()?;
    let best = tries.into_iter().flatten().min_by(|a, b| a.cost.total_cmp(&b.cost));
    let left = |x: &[f64]| {
        let mut out = vec![0.0; samples];
        errors(x, &mut out);
        out
    };
    let found = match best {
        Some(best) if pays(&left(&plain.x), &left(&best.x)) => best,
        _ => plain,
    };
    Ok(Fuelling { pressure_rms_kpa: (found.cost / samples as f64).sqrt(), ..with(&found.x) })
}
