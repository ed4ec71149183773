//! Which of the richer models are worth their parameters.

use super::filled::refilled;
use super::follow::pressure;
use super::moved::empty_cams;
use super::record::TransientRecord;
use super::search::Effort;
use super::worth::{block, pays};
use super::{
    CORRECTIONS, FuellingError, Loss, Measured, SteadyPoint, corrected, has_film, length, mixed, mixed_by,
    unexplained,
};
use crate::fuelling::cams::CamBends;
use crate::fuelling::charge::Charge;
use crate::fuelling::filling::Filling;
use crate::fuelling::film::Film;
use crate::fuelling::{FilmEnds, Fuelling};

/// Of a model the one with what cams do to the charge, where they are measured and that is worth its parameters, and without a film
/// that is not worth its two, or without its slopes over speed and pressure: on the halves of the blocks of the records that did not fit it the richer model must leave less
/// than the simpler one does that was fitted to the same halves ([`pays`]). The inverse of a film must be stable besides and not
/// swing at any temperature of the records.
pub(super) fn chosen(
    measured: Measured<'_>,
    rested: &[SteadyPoint],
    found: Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let mut best = Judged::of(found);
    // Cams first: what they do in a transient must not pass for a film. What rests have said of them needs no other proof.
    let known = best.fuelling.charge.cams.is_some();
    let moved = if known { None } else { with_cams(measured, rested, &best.fuelling, interrupt)? };
    if let Some(moved) = moved {
        let mut moved = Judged::of(moved);
        let apart = best.left(measured, Effort::Compared, interrupt)?;
        if pays(apart, moved.left(measured, Effort::Judged, interrupt)?) {
            best = moved;
            let mut bent = Judged::of(with_bends(measured, rested, &best.fuelling, interrupt)?);
            if pays(
                best.left(measured, Effort::Judged, interrupt)?,
                bent.left(measured, Effort::Judged, interrupt)?,
            ) {
                best = bent;
            }
        }
    }
    if !has_film(&best.fuelling) {
        return Ok(best.fuelling);
    }
    let film = Film { share: 0.0, ..best.fuelling.film };
    let dry = Fuelling { film, ..best.fuelling.clone() };
    let bare = mixed(measured, &dry, &dry, Effort::Compared, interrupt)?;
    if swings(&best.fuelling) {
        return Ok(bare);
    }
    // Behind the same manifold: what is judged is the film.
    let mut bare = Judged { start: dry, ..Judged::of(bare) };
    let apart = bare.left(measured, Effort::Compared, interrupt)?;
    let film_pays = pays(apart, best.left(measured, Effort::Judged, interrupt)?);
    if film_pays { with_ends(measured, best, interrupt) } else { Ok(bare.fuelling) }
}

/// A film over speed and pressure, if it pays beside one that is the same everywhere, behind the same manifold.
fn with_ends(
    measured: Measured<'_>,
    mut plain: Judged,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    // Of the records: steady points beside them say nothing of a film.
    let range = |of: fn(&TransientRecord<'_>) -> Vec<f64>| {
        let all = measured.records.iter().flat_map(of);
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        [0.5 * (low + high), (0.5 * (high - low)).max(1e-6 * high.abs())]
    };
    let (speed_rpm, pressure_kpa) = (range(|r| r.speed_rpm.to_vec()), range(|r| r.map_kpa.to_vec()));
    let ends = FilmEnds { speed_rpm, pressure_kpa, share: [0.0; 2], tau: [0.0; 2] };
    let start = Fuelling { film_ends: Some(ends), ..plain.fuelling.clone() };
    let mut rich = Judged::of(mixed(measured, &start, &start, Effort::Compared, interrupt)?);
    let apart = plain.left(measured, Effort::Judged, interrupt)?;
    let ends_pay = pays(apart, rich.left(measured, Effort::Judged, interrupt)?);
    Ok(if ends_pay && !swings(&rich.fuelling) { rich.fuelling } else { plain.fuelling })
}

/// A model that was fitted to all, with its errors on each half of the blocks when it is fitted to the other one: where they are known.
struct Judged {
    /// Whose manifold it has.
    start: Fuelling,
    fuelling: Fuelling,
    left: Option<Vec<f64>>,
}

impl Judged {
    fn of(fuelling: Fuelling) -> Self {
        Self { start: fuelling.clone(), fuelling, left: None }
    }

    fn left(
        &mut self,
        measured: Measured<'_>,
        effort: Effort,
        interrupt: &dyn Fn() -> bool,
    ) -> Result<&[f64], FuellingError> {
        if self.left.is_none() {
            self.left = Some(judged_apart(measured, (&self.start, &self.fuelling), effort, interrupt)?);
        }
        Ok(self.left.as_deref().unwrap_or_default())
    }
}

/// Errors on each half of the blocks of a model that is fitted to the other one, with the manifold of `start`, searched from `from`. A
/// search that ends at its limit gives its best so far: nothing of it is delivered.
fn judged_apart(
    measured: Measured<'_>,
    (start, from): (&Fuelling, &Fuelling),
    effort: Effort,
    interrupt: &dyn Fn() -> bool,
) -> Result<Vec<f64>, FuellingError> {
    let records = measured.records;
    let samples = length(records);
    let pressures: Vec<Vec<f64>> = records.iter().map(|r| pressure(r, start)).collect();
    let mut out = vec![0.0; samples];
    let mut half = vec![0.0; samples];
    for odd in [0, 1] {
        let apart = |t: usize| block(t, samples) % 2 == odd;
        let by = (effort, Loss::CHOOSING);
        let fitted = mixed_by(measured, (start, from), &|t| !apart(t), by, interrupt)?;
        unexplained(records, &pressures, &fitted, Loss::CHOOSING, &mut half);
        (0..samples).filter(|t| apart(*t)).for_each(|t| out[t] = measured.weight(t) * half[t]);
    }
    Ok(out)
}

/// Whether the inverse of the film is unstable or swings at a temperature, a speed and a pressure of the records.
pub(super) fn swings(found: &Fuelling) -> bool {
    let ends = found.coolant.map_or(vec![0.0], |law| law.range_c.to_vec());
    // Without them the film is the same everywhere.
    let corners = found.film_ends.map_or(vec![[0.0; 2]], |e| e.corners().to_vec());
    let swings = |c: f64, [n, p]: [f64; 2]| found.film_of(c, n, p).inverse_pole(found.sample_time_s) < 0.0;
    ends.iter().any(|c| corners.iter().any(|at| swings(*c, *at)))
}

/// A model with what cams that are not at rest do to the charge; none where they are not measured.
fn with_cams(
    measured: Measured<'_>,
    rested: &[SteadyPoint],
    found: &Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Option<Fuelling>, FuellingError> {
    let Some(law) = empty_cams(measured.records, rested, &found.charge)? else { return Ok(None) };
    let charge = Charge { cams: Some(law), ..found.charge.clone() };
    // Manifold and charge anew, in turns: a manifold behind a choked throttle passes on what flows in, so that a pressure that is not
    // corrected hides what cams do to charge and pressure together.
    let start = Fuelling { charge, ..found.clone() };
    let filling = Filling { correction_per_s: CORRECTIONS[CORRECTIONS.len() - 1], ..start.filling.clone() };
    let start = Fuelling { filling, ..start };
    again(measured, rested, start, interrupt).map(Some)
}

/// The same where straight lines do not say it all.
fn with_bends(
    measured: Measured<'_>,
    rested: &[SteadyPoint],
    found: &Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let mut start = found.clone();
    if let Some(law) = &mut start.charge.cams {
        law.bends = Some(CamBends::default());
    }
    again(measured, rested, start, interrupt)
}

/// Manifold and charge of a richer model.
fn again(
    measured: Measured<'_>,
    rested: &[SteadyPoint],
    start: Fuelling,
    interrupt: &dyn Fn() -> bool,
) -> Result<Fuelling, FuellingError> {
    let first = mixed(measured, &start, &start, Effort::Compared, interrupt)?;
    corrected(measured, &refilled(measured.records, rested, first, interrupt)?, interrupt)
}
