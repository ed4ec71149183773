//! Throttle and manifold from the pressure of the records.

use super::follow::shown;
use super::record::TransientRecord;
use super::search::{Effort, searched};
use super::worth::pays;
use super::{FuellingError, SteadyPoint, length};
use crate::fuelling::Fuelling;
use crate::fuelling::filling::Filling;
use dynocal_numerics::lm::LmOutcome;

/// Rates of the throttle of which the search begins from the best, over that which the lag alone would make of the largest step of the records.
const RATES: [f64; 3] = [0.5, 0.25, 0.125];

/// Throttle by the rests; gain and lag of the filling, and where it pays the rate of the throttle, by the pressure of the records.
pub(super) fn filled(
    records: &[TransientRecord<'_>],
    rested: &[SteadyPoint],
    start: Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    // Whether the pressure channel is a sample late: a lag that is searched with that of the throttle takes it over, or gives it its own.
    let late = |sensor_lag_s: f64| {
        let filling = Filling { sensor_lag_s, ..start.filling.clone() };
        let fit = Fit::of(records, rested, Fuelling { filling, ..start.clone() })?;
        let plain = fit.search("filling", &fit.begin(), Effort::Delivered, interrupt)?;
        Ok::<_, FuellingError>((fit, plain))
    };
    let (prompt, later) = (late(0.0)?, late(start.sample_time_s)?);
    let (fit, plain) = if later.1.cost < prompt.1.cost { later } else { prompt };
    let steps = records.iter().flat_map(|r| r.throttle_deg.windows(2)).map(|w| (w[1] - w[0]).abs());
    let fastest = (steps.fold(0.0, f64::max) / plain.x[1].exp()).max(1e-6);
    let from = RATES.map(|share| [plain.x[0], plain.x[1], (share * fastest).ln()]);
    let squares = |x: &[f64; 3]| fit.left(x).iter().map(|e| e * e).sum::<f64>();
    let least = from.iter().min_by(|a, b| squares(a).total_cmp(&squares(b)));
    let limited = least.map(|x| fit.search("rate of the throttle", x, Effort::Delivered, interrupt));
    let limited = match limited.transpose() {
        // A rate that the records do not tell may run away.
        Err(FuellingError::Search { .. }) => None,
        found => found?,
    };
    let found = limited.filter(|l| pays(&fit.left(&plain.x), &fit.left(&l.x))).unwrap_or(plain);
    Ok(fit.taken(&found))
}

/// The same for a charge that has become another: whether the rate of the throttle is limited has been judged.
pub(super) fn refilled(
    records: &[TransientRecord<'_>],
    rested: &[SteadyPoint],
    start: Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let rate = start.filling.throttle_rate_deg_s;
    let fit = Fit::of(records, rested, start)?;
    let [gain, lag] = fit.begin();
    if let Some(rate) = rate {
        match fit.search("rate of the throttle", &[gain, lag, rate.ln()], Effort::Delivered, interrupt) {
            // A rate that the records do not tell any more.
            Err(FuellingError::Search { .. }) => {}
            found => return Ok(fit.taken(&found?)),
        }
    }
    let found = fit.search("filling", &[gain, lag], Effort::Delivered, interrupt)?;
    Ok(fit.taken(&found))
}

/// A search of gain, lag and maybe rate.
struct Fit<'a> {
    records: &'a [TransientRecord<'a>],
    start: Fuelling,
}

impl<'a> Fit<'a> {
    /// With the throttle by the rests.
    fn of(
        records: &'a [TransientRecord<'a>],
        rested: &[SteadyPoint],
        start: Fuelling,
    ) -> Result<Self, FuellingError> {
        let point = |r: &SteadyPoint| {
            let flow = start.air(r.coolant_c, r.cams_deg).flow(r.speed_rpm, r.map_kpa);
            [flow, r.map_kpa, r.throttle_deg, r.upstream_kpa]
        };
        let points: Vec<[f64; 4]> = rested.iter().map(point).collect();
        let filling = start.filling.of_rest(&points)?;
        Ok(Self { records, start: Fuelling { filling, ..start } })
    }

    fn begin(&self) -> [f64; 2] {
        [self.start.filling.gain.ln(), self.start.filling.throttle_lag_s.ln()]
    }

    fn with(&self, x: &[f64]) -> Fuelling {
        let filling = Filling {
            gain: x[0].exp(),
            throttle_lag_s: x[1].exp(),
            throttle_rate_deg_s: x.get(2).map(|rate| rate.exp()),
            ..self.start.filling.clone()
        };
        Fuelling { filling, ..self.start.clone() }
    }

    /// What was measured beside what the channel would show in kPa; whether all are numbers.
    fn errors(&self, x: &[f64], out: &mut [f64]) -> bool {
        let f = self.with(x);
        let shown = self.records.iter().flat_map(|r| r.map_kpa.iter().zip(shown(r, &f)));
        out.iter_mut().zip(shown).for_each(|(e, (m, s))| *e = m - s);
        out.iter().all(|v| v.is_finite())
    }

    fn left(&self, x: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; length(self.records)];
        self.errors(x, &mut out);
        out
    }

    fn search(
        &self,
        what: &'static str,
        from: &[f64],
        effort: Effort,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<LmOutcome, FuellingError> {
        let samples = length(self.records);
        searched(what, (&|x, out| self.errors(x, out), None), samples, from, effort, interrupt)
    }

    fn taken(&self, found: &LmOutcome) -> Fuelling {
        let samples = length(self.records) as f64;
        Fuelling { pressure_rms_kpa: (found.cost / samples).sqrt(), ..self.with(&found.x) }
    }
}
