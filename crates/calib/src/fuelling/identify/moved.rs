//! What cams do to the charge, as far as rests tell it.

use super::record::TransientRecord;
use super::worth::pays;
use super::{FuellingError, SteadyPoint};
use crate::fuelling::cams::CamLaw;
use crate::fuelling::charge::Charge;
use crate::fuelling::coolant::CoolantLaw;

/// Times that charge and cams are taken in turn, and parts of the rests that judge.
const TURNS: usize = 10;
const FOLDS: usize = 5;

/// Cams with nothing known of what they do: where they rest, and how far away from there the records show them. None where they are not
/// measured.
pub(super) fn empty_cams(
    records: &[TransientRecord<'_>],
    rested: &[SteadyPoint],
    charge: &Charge,
) -> Result<Option<CamLaw>, FuellingError> {
    let places: Option<Vec<[f64; 2]>> = rested.iter().map(|r| r.cams_deg).collect();
    let Some(places) = places else { return Ok(None) };
    let at: Vec<[f64; 2]> = rested.iter().map(|r| charge.scaled(r.speed_rpm, r.map_kpa)).collect();
    let mut law = CamLaw::of_rest(&at, &places)?;
    for r in records {
        for t in 0..r.speed_rpm.len() {
            let Some(cams) = r.cams_deg(t) else { continue };
            let off = law.off_deg(charge.scaled(r.speed_rpm[t], r.map_kpa[t]), cams);
            law.most_deg = [0, 1].map(|k| law.most_deg[k].max(off[k].abs()));
        }
    }
    Ok(Some(law))
}

/// Charge with what cams do to it by the rests. None where cams are not measured, or where rests that had no part in it do not say that
/// it is better ([`pays`]): cams that follow a schedule tell nothing at rest.
pub(super) fn moved_at_rest(
    records: &[TransientRecord<'_>],
    rested: &[SteadyPoint],
    (charge, law): (&Charge, Option<&CoolantLaw>),
) -> Result<Option<Charge>, FuellingError> {
    let Some(empty) = empty_cams(records, rested, charge)? else { return Ok(None) };
    let points: Vec<Point> = rested.iter().filter_map(|r| Point::of(r, (charge, law))).collect();
    let (mut plain, mut moved) = (vec![0.0; points.len()], vec![0.0; points.len()]);
    for fold in 0..FOLDS {
        let some: Vec<Point> =
            points.iter().enumerate().filter(|(k, _)| k % FOLDS != fold).map(|(_, p)| *p).collect();
        let simple = charge.again(&some.iter().map(Point::still).collect::<Vec<_>>())?;
        let rich = in_turns(charge, &empty, &some)?;
        for k in (fold..points.len()).step_by(FOLDS) {
            (plain[k], moved[k]) = (points[k].off(&simple), points[k].off(&rich));
        }
    }
    Ok(if pays(&plain, &moved) { Some(in_turns(charge, &empty, &points)?) } else { None })
}

/// A rest: speed, pressure, fuel that would make lambda 1 at the coolant of reference, places of the cams.
#[derive(Clone, Copy)]
struct Point {
    speed_rpm: f64,
    map_kpa: f64,
    fuel: f64,
    cams_deg: [f64; 2],
}

impl Point {
    fn of(r: &SteadyPoint, (charge, law): (&Charge, Option<&CoolantLaw>)) -> Option<Self> {
        let at = charge.scaled(r.speed_rpm, r.map_kpa);
        let fuel = r.fuel / law.map_or(1.0, |l| l.charge_factor_at(r.coolant_c, at));
        r.cams_deg.map(|cams_deg| Self { speed_rpm: r.speed_rpm, map_kpa: r.map_kpa, fuel, cams_deg })
    }

    /// As if cams did nothing.
    fn still(&self) -> [f64; 3] {
        [self.speed_rpm, self.map_kpa, self.fuel]
    }

    fn factor(&self, c: &Charge) -> f64 {
        c.cam_factor(self.speed_rpm, self.map_kpa, Some(self.cams_deg))
    }

    /// Logarithm of the fuel over what a charge says of it.
    fn off(&self, c: &Charge) -> f64 {
        let air = c.at(self.speed_rpm, self.map_kpa) * self.factor(c);
        (self.fuel / air.max(1e-9)).max(1e-3).ln()
    }
}

/// Charge and cams, each with the other held.
fn in_turns(charge: &Charge, empty: &CamLaw, points: &[Point]) -> Result<Charge, FuellingError> {
    let at: Vec<[f64; 2]> = points.iter().map(|p| charge.scaled(p.speed_rpm, p.map_kpa)).collect();
    let cams: Vec<[f64; 2]> = points.iter().map(|p| p.cams_deg).collect();
    let mut found = Charge { cams: Some(empty.clone()), ..charge.clone() };
    for _ in 0..TURNS {
        let freed = |p: &Point| [p.speed_rpm, p.map_kpa, p.fuel / p.factor(&found)];
        let freed: Vec<[f64; 3]> = points.iter().map(freed).collect();
        found = found.again(&freed)?;
        let bare = Charge { cams: None, ..found.clone() };
        let off: Vec<f64> = points.iter().map(|p| p.off(&bare)).collect();
        found.cams = Some(empty.of_logarithms(&at, &cams, &off)?);
    }
    Ok(found)
}
