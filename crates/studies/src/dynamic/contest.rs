//! Controllers against each other: line searches of the rivals on the record, then the judged courses.

use dynocal_calib::fuelling::{
    self, Coat, Feedback, FuelPolicy, Fuelling, FuellingError, SpeedDensity, TransientRecord,
};
use dynocal_calib::map::static_map::StaticMap;
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::EngineBed;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::bed::{Controller, Course, MOST_MG, SAMPLE_S, Trace, play};
use super::learned;
use super::measures::{Measures, integral_s};
use super::rivals::{Ecu, Mapped, Ours};

/// Pressure before the throttle in kPa, and most of an extrapolation.
const AMBIENT_KPA: f64 = 101.325;
const MOST_KPA: f64 = 100.0;
/// What the line searches of the rivals try: lag at 2000 rpm, time of the extrapolation, time constant of the closed lambda loop,
/// in s.
pub(super) const LAGS_S: [f64; 8] = [0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2];
pub(super) const AHEADS_S: [f64; 7] = [0.02, 0.04, 0.05, 0.06, 0.08, 0.1, 0.12];
pub(super) const CLOSED_S: [f64; 5] = [0.3, 0.8, 2.0, 5.0, 12.0];
/// Beyond the seed of the first records: other disturbances.
pub(super) const REPEATED: u64 = 500;
/// And from one of the records that ours drives to the next one.
pub(super) const APART: u64 = 100;
/// Names of ours: the one that is judged, and the same without what the sensor shows.
pub(super) const OURS: &str = "identified air and film, lambda trim";
pub(super) const UNTRIMMED: &str = "identified air and film";
/// Names of what is possible: fuel learned on the judged record itself, without and with preview of the demand.
pub(super) const POSSIBLE: &str = "possible: learned on the record itself";
pub(super) const PREVIEW: &str = "possible with preview of the demand";
/// Name of the rival of the sixth scenario.
pub(super) const LAGGED: &str = "static map, lag";
/// The map that all start from.
pub(super) const STATIC: &str = "static map";
/// How names of rivals with lambda feedback end.
pub(super) const FEEDBACK: &str = ", lambda feedback";

/// A controller in all courses.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    pub(super) name: String,
    /// What its line searches chose.
    pub(super) setting: String,
    /// Bed time of its line searches in s.
    pub(super) search_s: f64,
    /// In the order of the courses.
    pub(super) courses: Vec<Measures>,
}

/// A course on the bed that it is driven on.
pub(super) struct Drive {
    pub(super) bed: EngineBed,
    pub(super) course: Course,
}

/// What all controllers share.
pub(super) struct Contest<'a> {
    pub(super) map: &'a StaticMap,
    pub(super) records: &'a [Drive],
    /// Records that ours drives with what it knows from the first ones, and identifies again from all of them.
    pub(super) repeated: &'a [Drive],
    pub(super) judged: &'a [Drive],
    pub(super) seed: u64,
    /// Film of the engine itself.
    pub(super) exact: Option<Coat>,
    /// Whether an ECU without film compensation is run too.
    pub(super) plain: bool,
    /// Every how manyth value the line searches try.
    pub(super) stride: usize,
}

/// Why there is no result.
pub(super) enum Ended {
    Interrupted,
    Failed(String),
}

impl From<String> for Ended {
    fn from(reason: String) -> Self {
        Self::Failed(reason)
    }
}

/// What was identified, and what the ECU knows.
pub(super) struct Known {
    pub(super) fuelling: Fuelling,
    /// An ECU without film compensation, extrapolation and feedback: with the charge at rest, and with that of ours.
    at_rest: SpeedDensity,
    ours: SpeedDensity,
}

/// A rival with what it tunes.
enum Rival {
    Map { searched: bool },
    Ecu { searched: bool, film: Option<Coat>, at_rest: bool },
    Ours { trimmed: bool },
}

/// What line searches choose, in s: a lag or an extrapolation, and a closed loop.
#[derive(Clone, Copy, Default)]
struct Choice {
    first_s: f64,
    closed_s: Option<f64>,
}

impl Contest<'_> {
    /// Drives the records, identifies, tunes, and runs all controllers over what is judged.
    pub(super) fn run(&self, interrupted: &(dyn Fn() -> bool + Sync)) -> Result<(Fuelling, Vec<Row>), Ended> {
        let plain = |d: &Drive| {
            let mut plain = self.base(0.0)?;
            play(&d.bed, self.seed, &d.course, &mut plain).map_err(|e| e.to_string())
        };
        let mut traces: Vec<Trace> = self.records.par_iter().map(plain).collect::<Result<_, String>>()?;
        let first = fuelling::identify(&self.views(&traces), interrupted).map_err(ended)?;
        // Where the mixture is near its demand already, small errors of the model show.
        let by_ours = |(k, d): (usize, &Drive)| {
            let policy = FuelPolicy::new(first.clone(), MOST_MG);
            let moved = d.course.moved_fuel(&mut Rng64::stream(self.seed + REPEATED, k as u64));
            let mut ours = Ours::new(self.base(0.0)?, policy, false).moving(moved);
            play(&d.bed, self.seed + REPEATED + APART * k as u64, &d.course, &mut ours)
                .map_err(|e| e.to_string())
        };
        traces.extend(self.repeated.par_iter().enumerate().map(by_ours).collect::<Result<Vec<_>, String>>()?);
        let views = self.views(&traces);
        let fuelling = fuelling::identify(&views, interrupted).map_err(ended)?;
        let (charge, law) = fuelling::steady_charge(&views).map_err(ended)?;
        let ecu = |charge, law| SpeedDensity {
            sample_time_s: SAMPLE_S,
            charge,
            law,
            most_kpa: MOST_KPA,
            ahead_s: 0.0,
            film: None,
            feedback: None,
        };
        let known = Known {
            at_rest: ecu(charge, law),
            ours: ecu(fuelling.charge.clone(), fuelling.coolant),
            fuelling,
        };
        let rows: Vec<Vec<Row>> = self
            .rivals(&known)
            .par_iter()
            .map(|(name, rival)| if interrupted() { Ok(Vec::new()) } else { self.rows(&known, name, rival) })
            .collect::<Result<_, String>>()?;
        let mut rows: Vec<Row> = rows.into_iter().flatten().collect();
        for (name, preview) in [(POSSIBLE, false), (PREVIEW, true)] {
            if interrupted() {
                return Err(Ended::Interrupted);
            }
            rows.push(learned::row(self, &known, name, preview)?);
        }
        Ok((known.fuelling, rows))
    }

    /// All records of the case.
    fn driven(&self) -> impl Iterator<Item = &Drive> {
        self.records.iter().chain(self.repeated)
    }

    fn views<'b>(&'b self, traces: &'b [Trace]) -> Vec<TransientRecord<'b>> {
        self.driven().zip(traces).map(|(d, t)| view(&d.course, t)).collect()
    }

    fn rivals(&self, known: &Known) -> Vec<(String, Rival)> {
        let found = known.fuelling.coat();
        let mut out = vec![
            (STATIC.to_string(), Rival::Map { searched: false }),
            (LAGGED.into(), Rival::Map { searched: true }),
            (UNTRIMMED.into(), Rival::Ours { trimmed: false }),
            (OURS.into(), Rival::Ours { trimmed: true }),
        ];
        let mut ecu = |words: &str, searched, film, at_rest| {
            let whose = if at_rest { "" } else { ", charge of ours" };
            out.push((format!("ECU{words}{whose}"), Rival::Ecu { searched, film, at_rest }));
        };
        if self.plain {
            ecu("", false, None, true);
            ecu(", extrapolated", true, None, true);
        }
        ecu(", extrapolated, film from the record", true, Some(found), true);
        ecu(", extrapolated, film from the record", true, Some(found), false);
        if self.exact.is_some() {
            ecu(", extrapolated, film of the engine itself", true, self.exact, false);
        }
        out
    }

    pub(super) fn base(&self, lag_s: f64) -> Result<Mapped<'_>, String> {
        Mapped::new(self.map, lag_s).ok_or_else(|| "the map lacks an actuator".into())
    }

    fn controller<'b>(
        &'b self,
        known: &'b Known,
        rival: &Rival,
        c: Choice,
    ) -> Result<Box<dyn Controller + 'b>, String> {
        Ok(match rival {
            Rival::Map { .. } => Box::new(self.base(c.first_s)?),
            Rival::Ecu { film, at_rest, .. } => {
                let plain = if *at_rest { &known.at_rest } else { &known.ours };
                let timing = known.fuelling.timing;
                let feedback = c.closed_s.map(|closed_s| Feedback { timing, closed_s });
                let ecu = SpeedDensity { ahead_s: c.first_s, film: *film, feedback, ..plain.clone() };
                Box::new(Ecu::new(self.base(0.0)?, ecu))
            }
            Rival::Ours { trimmed } => {
                let policy = FuelPolicy::new(known.fuelling.clone(), MOST_MG);
                Box::new(Ours::new(self.base(0.0)?, policy, *trimmed))
            }
        })
    }

    /// The best of choices on the records, by the lambda that the sensor shows.
    fn searched(&self, known: &Known, rival: &Rival, choices: &[Choice]) -> Result<Choice, String> {
        let mut best: Option<(f64, Choice)> = None;
        for choice in choices {
            let mut shown = 0.0;
            for d in self.driven() {
                let mut controller = self.controller(known, rival, *choice)?;
                let trace =
                    play(&d.bed, self.seed, &d.course, controller.as_mut()).map_err(|e| e.to_string())?;
                shown += integral_s(&trace.lambda);
            }
            if best.is_none_or(|b| shown < b.0) {
                best = Some((shown, *choice));
            }
        }
        Ok(best.map_or(Choice::default(), |b| b.1))
    }

    /// A rival; one with film compensation again with lambda feedback, its closed loop tuned with the rest held.
    fn rows(&self, known: &Known, name: &str, rival: &Rival) -> Result<Vec<Row>, String> {
        let tried: &[f64] = match rival {
            Rival::Map { searched: true } => &LAGS_S,
            Rival::Ecu { searched: true, .. } => &AHEADS_S,
            _ => &[],
        };
        let firsts: Vec<Choice> =
            tried.iter().step_by(self.stride).map(|v| Choice { first_s: *v, closed_s: None }).collect();
        let first = self.searched(known, rival, &firsts)?;
        let mut out = vec![self.row(known, name, rival, first, firsts.len())?];
        if matches!(rival, Rival::Ecu { film: Some(_), .. }) {
            let loops: Vec<Choice> = CLOSED_S
                .iter()
                .step_by(self.stride)
                .map(|c| Choice { closed_s: Some(*c), ..first })
                .collect();
            let closed = self.searched(known, rival, &loops)?;
            let name = format!("{name}{FEEDBACK}");
            out.push(self.row(known, &name, rival, closed, firsts.len() + loops.len())?);
        }
        Ok(out)
    }

    fn row(
        &self,
        known: &Known,
        name: &str,
        rival: &Rival,
        c: Choice,
        searched: usize,
    ) -> Result<Row, String> {
        let measured = |d: &Drive| {
            let mut controller = self.controller(known, rival, c)?;
            let seed = self.judged_seed();
            let trace = play(&d.bed, seed, &d.course, controller.as_mut()).map_err(|e| e.to_string())?;
            Ok::<_, String>(Measures::of(&trace, &d.course))
        };
        let courses = self.judged.iter().map(measured).collect::<Result<_, _>>()?;
        let closed = c.closed_s.map_or(String::new(), |v| format!(", loop {v} s"));
        let setting = if searched == 0 { "-".into() } else { format!("{} s{closed}", c.first_s) };
        let search_s = searched as f64 * self.record_s();
        Ok(Row { name: name.into(), setting, search_s, courses })
    }

    /// Not the disturbances of the record.
    pub(super) fn judged_seed(&self) -> u64 {
        self.seed + 1000
    }

    /// Bed time of the records in s.
    pub(super) fn record_s(&self) -> f64 {
        self.driven().map(|d| d.course.length_s()).sum()
    }
}

fn ended(e: FuellingError) -> Ended {
    match e {
        FuellingError::Interrupted => Ended::Interrupted,
        e => Ended::Failed(e.to_string()),
    }
}

/// A record as the identification takes it.
fn view<'a>(course: &'a Course, trace: &'a Trace) -> TransientRecord<'a> {
    TransientRecord {
        sample_time_s: SAMPLE_S,
        speed_rpm: &course.speed_rpm,
        throttle_deg: &trace.throttle_deg,
        injection: &trace.injection_mg,
        map_kpa: &trace.map_kpa,
        lambda: &trace.lambda,
        upstream_kpa: AMBIENT_KPA,
        boost_kpa: None,
        coolant_c: Some(&trace.coolant_c),
        cams_deg: None,
    }
}
