//! Searches on the bed, by repeated tip-ins and what its channels show of them: retard against knock for all, wastegate at rest and
//! cams while boost builds for ours.

use dynocal_calib::fuelling::{FuelPolicy, Fuelling};
use rayon::prelude::*;

use super::super::bed::SAMPLE_S;
use super::bed::{Course, MOST_MG, Trace};
use super::contest::{Contest, TIPS, tip};
use super::control::{Fuel, PRODUCTION, Setting};

/// Retards that are tried in deg, how often the way back to the one before is halved then, and the knock index that a tip-in may
/// show: the onset less what other cycles may add.
const RETARDS_DEG: [f64; 12] = [0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 12.5, 15.0, 18.0, 22.0];
pub(super) const HALVINGS: usize = 2;
const KNOCK: f64 = 0.95;
/// Wastegate at rest that is tried, in mm, widest first, and moves of the cams in deg.
const RESTS_MM: [f64; 5] = [14.0, 10.0, 7.0, 4.0, 0.0];
const MOVES_DEG: [f64; 5] = [-8.0, -4.0, 0.0, 4.0, 8.0];
/// What knock beyond its most weighs beside missing torque, in s.
const KNOCK_S: f64 = 2.0;
/// Time of a tip-in over which missing torque is summed, in s.
const BUILD_S: f64 = 2.5;

/// The searches of a case.
pub(super) struct Searched<'a> {
    pub(super) of: &'a Contest,
    pub(super) fuelling: &'a Fuelling,
}

/// What tip-ins showed.
#[derive(Clone, Copy)]
struct Told {
    /// Missing torque over the demand, summed over the begin of the tip-in, in s.
    missing_s: f64,
    knock: f64,
}

impl Told {
    fn cost(&self) -> f64 {
        self.missing_s + KNOCK_S * (self.knock - KNOCK).max(0.0)
    }
}

impl Searched<'_> {
    /// The least retard that keeps knock away; and bed time.
    pub(super) fn production(&self) -> Result<(Setting, f64), String> {
        self.retarded(PRODUCTION)
    }

    /// Wastegate at rest, then each cam in turn, then the retard anew; and bed time.
    pub(super) fn ours(&self, from: Setting) -> Result<(Setting, f64), String> {
        let stride = if self.of.reduced { 2 } else { 1 };
        let rests: Vec<Setting> =
            RESTS_MM.iter().step_by(stride).map(|mm| Setting { rest_mm: Some(*mm), ..from }).collect();
        let (mut best, mut time_s) = self.best(&rests)?;
        for cam in 0..2 {
            let moved = |d: &f64| {
                let mut build_deg = best.build_deg;
                build_deg[cam] = *d;
                Setting { build_deg, ..best }
            };
            let tried: Vec<Setting> = MOVES_DEG.iter().step_by(stride).map(moved).collect();
            let (found, s) = self.best(&tried)?;
            (best, time_s) = (found, time_s + s);
        }
        let (found, s) = self.retarded(best)?;
        Ok((found, time_s + s))
    }

    /// The least retard with which no tip-in shows more knock than it may; the most where none does.
    fn retarded(&self, from: Setting) -> Result<(Setting, f64), String> {
        let mut time_s = 0.0;
        let mut knocks = |retard_deg: f64| {
            let (told, s) = self.told(Setting { retard_deg, ..from })?;
            time_s += s;
            Ok::<_, String>(told.knock > KNOCK)
        };
        let (stride, halvings) = if self.of.reduced { (3, 0) } else { (1, HALVINGS) };
        // The most that knocks, and the least that does not.
        let (mut less, mut enough) = (None, from.retard_deg);
        for retard_deg in RETARDS_DEG.iter().step_by(stride) {
            enough = *retard_deg;
            if !knocks(enough)? {
                break;
            }
            less = Some(enough);
        }
        if let Some(mut less) = less.filter(|l| *l < enough) {
            for _ in 0..halvings {
                let middle = 0.5 * (less + enough);
                *(if knocks(middle)? { &mut less } else { &mut enough }) = middle;
            }
        }
        Ok((Setting { retard_deg: enough, ..from }, time_s))
    }

    fn best(&self, tried: &[Setting]) -> Result<(Setting, f64), String> {
        let told: Vec<(Told, f64)> =
            tried.par_iter().map(|s| self.told(*s)).collect::<Result<_, String>>()?;
        let cost = |k: &usize| told[*k].0.cost();
        let at = (0..tried.len()).min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0);
        Ok((tried[at], told.iter().map(|t| t.1).sum()))
    }

    /// One of each tip-in: the worst knock, the sum of what is missing.
    fn told(&self, setting: Setting) -> Result<(Told, f64), String> {
        let (mut out, mut time_s) = (Told { missing_s: 0.0, knock: 0.0 }, 0.0);
        for t in TIPS {
            let course = tip(t);
            let policy = FuelPolicy::new(self.fuelling.clone(), MOST_MG);
            let fuel = Fuel::Policy { policy: Box::new(policy), trimmed: false };
            let mut driver = self.of.driver(Some(self.fuelling), setting, fuel);
            let trace = self.of.played(self.of.seed + 200, &course, &mut driver)?;
            out.missing_s += missing_s(&trace, &course);
            out.knock = trace.knock[course.switches[0]..].iter().copied().fold(out.knock, f64::max);
            time_s += course.length_s();
        }
        Ok((out, time_s))
    }
}

fn missing_s(trace: &Trace, course: &Course) -> f64 {
    let from = course.switches[0];
    let to = from + (BUILD_S / SAMPLE_S) as usize;
    let demand = course.torque_nm[from];
    trace.torque_nm[from..to].iter().map(|y| ((demand - y) / demand).max(0.0) * SAMPLE_S).sum()
}
