//! Ours beside production ECUs: records, searches on the bed, tip-ins that are judged.

use std::collections::VecDeque;

use dynocal_calib::fuelling::{
    self, Feedback, FuelPolicy, Fuelling, FuellingError, SpeedDensity, SpeedDensityState, SteadyPoint,
    TransientRecord,
};
use dynocal_numerics::rng::Rng64;
use dynocal_plant::bed::EngineBed;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::super::bed::SAMPLE_S;
use super::super::contest::{AHEADS_S, APART, CLOSED_S, Ended, REPEATED};
use super::super::measures::integral_s;
use super::bed::{Course, MOST_MG, Trace, bed, play};
use super::control::{Driver, Fuel, PRODUCTION, Path, Setting};
use super::learned;
use super::measures::TipIn;
use super::search::Searched;
use super::steady::{Of, Steady};

/// The tip-ins of the table of rivals: speed in rpm, torque before and after in Nm.
pub(super) const TIPS: [(f64, [f64; 2]); 2] = [(1750.0, [33.0, 220.0]), (2000.0, [33.0, 250.0])];
/// Time at the low torque before a tip-in, after it, and after the tip-out, in s; the first one more, as the bed starts elsewhere.
const LEAD_S: f64 = 4.0;
const BEFORE_S: f64 = 6.0;
const HIGH_S: f64 = 8.0;
const LOW_S: f64 = 6.0;
/// Steady points.
const SPEEDS_RPM: [f64; 4] = [1500.0, 1750.0, 2000.0, 2300.0];
const TORQUES_NM: [f64; 10] = [15.0, 33.0, 60.0, 90.0, 120.0, 150.0, 180.0, 210.0, 240.0, 275.0];
/// What records are drawn from: torque in Nm, on a logarithmic scale, speed in rpm, time of a hold in s.
const TORQUE_NM: (f64, f64) = (22.0, 250.0);
const SPEED_RPM: (f64, f64) = (1600.0, 2150.0);
const HOLD_S: f64 = 4.0;
/// Number of the record in which cams are moved whatever the load.
pub(super) const MOVES: usize = 1;
/// Records: the first driver's, and those that ours drives with what it knows by then.
pub(super) const RECORDS: usize = 3;
/// Lags of the fuel at 2000 rpm that are tried for the map behind a lag, in s: boost makes long ones.
const LAGS_S: [f64; 8] = [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.5];
/// Greatest pressure of an extrapolation in kPa; pressure before a throttle that stands still.
const MOST_KPA: f64 = 240.0;
const AMBIENT_KPA: f64 = 101.325;
/// Names.
pub(super) const OURS: &str = "measured states, lambda trim";
pub(super) const UNTRIMMED: &str = "measured states";
pub(super) const WAITS: &str = "measured states, lambda trim, throttle waits for the fuel";
pub(super) const PREPARED: &str = ", wastegate at rest as ours";

/// A controller in all tip-ins.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    pub(super) name: String,
    /// What its line searches chose.
    pub(super) words: String,
    /// In the order of [`TIPS`].
    pub(super) tips: Vec<TipIn>,
}

/// What a case found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Found {
    pub(super) fuelling: Fuelling,
    /// Settings of the production ECU and of ours.
    pub(super) production: Setting,
    pub(super) ours: Setting,
    /// Bed time of the steady points, of the records, of the searches of both in s.
    pub(super) steady_s: f64,
    pub(super) record_s: f64,
    pub(super) search_s: [f64; 2],
    pub(super) rows: Vec<Row>,
}

/// Engine, seed and length of a case.
pub(super) struct Contest {
    pub(super) bed: EngineBed,
    pub(super) steady: Steady,
    pub(super) seed: u64,
    pub(super) reduced: bool,
}

/// A tip-in and the tip-out after it.
pub(super) fn tip((speed_rpm, [low, high]): (f64, [f64; 2])) -> Course {
    let mut out = Course::default();
    out.hold(low, speed_rpm, LEAD_S + BEFORE_S);
    out.hold(high, speed_rpm, HIGH_S);
    out.hold(low, speed_rpm, LOW_S);
    out.end()
}

/// A fuel with what its line searches chose.
#[derive(Clone, Copy)]
enum Fuelled {
    Demand {
        lag_s: f64,
    },
    Ecu {
        at_rest: bool,
        ahead_s: f64,
        closed_s: Option<f64>,
    },
    /// `waits`: the throttle waits until fuel that is injected now meets its air.
    Policy {
        trimmed: bool,
        waits: bool,
    },
}

/// What was identified, and charges that an ECU may know.
pub(super) struct Known {
    pub(super) fuelling: Fuelling,
    at_rest: SpeedDensity,
    ours: SpeedDensity,
}

impl Contest {
    pub(super) fn new(engine: &str, seed: u64, reduced: bool) -> Result<Self, String> {
        let torques: Vec<f64> = TORQUES_NM.iter().step_by(if reduced { 3 } else { 1 }).copied().collect();
        let speeds = if reduced { &SPEEDS_RPM[1..3] } else { &SPEEDS_RPM[..] };
        Ok(Self { bed: bed(engine)?, steady: Steady::measured(engine, speeds, &torques)?, seed, reduced })
    }

    /// Everything, from the records to the judged rows.
    pub(super) fn run(&self, interrupted: &(dyn Fn() -> bool + Sync)) -> Result<Found, Ended> {
        let mut rng = Rng64::stream(self.seed, 34);
        let count = if self.reduced { 2 } else { RECORDS };
        let mut courses: Vec<Course> = (0..count).map(|_| self.record(&mut rng)).collect();
        self.move_cams(&mut courses[MOVES]);
        let mut first = self.driver(None, PRODUCTION, Fuel::First { factor: 0.0 });
        let mut traces = vec![self.played(self.seed, &courses[0], &mut first)?];
        let by_first = shown_s(&traces[0], &courses[0]);
        let mut fuelling = self.identified(&courses[..1], &traces, interrupted)?;
        let (mut production, mut ours, mut search_s) = (PRODUCTION, PRODUCTION, [0.0; 2]);
        for (k, course) in courses.iter().enumerate().skip(1) {
            traces.push(self.next_record(k, course, (&fuelling, ours), by_first)?);
            fuelling = self.identified(&courses[..=k], &traces, interrupted)?;
            if k == MOVES {
                // Both search with the same fuel: that which knows what cams do, or its errors would be taken for theirs.
                let searched = Searched { of: self, fuelling: &fuelling };
                (production, search_s[0]) = searched.production()?;
                (ours, search_s[1]) = searched.ours(production)?;
            }
        }
        let known = self.known(fuelling, &courses, &traces)?;
        let rows = self.rows(&known, &courses, [production, ours], interrupted)?;
        Ok(Found {
            fuelling: known.fuelling,
            production,
            ours,
            steady_s: self.steady.time_s,
            record_s: courses.iter().map(Course::length_s).sum(),
            search_s,
            rows,
        })
    }

    /// A record that is driven with what was identified. An identification that drives worse than the first driver (`by_first`) must not make the
    /// record of the next one.
    fn next_record(
        &self,
        k: usize,
        course: &Course,
        (fuelling, setting): (&Fuelling, Setting),
        by_first: f64,
    ) -> Result<Trace, String> {
        let seed = self.seed + REPEATED + APART * (k - 1) as u64;
        let policy = Box::new(FuelPolicy::new(fuelling.clone(), MOST_MG));
        let by = |fuel| self.played(seed, course, &mut self.driver(Some(fuelling), setting, fuel));
        let next = by(Fuel::Policy { policy, trimmed: false })?;
        if shown_s(&next, course) <= by_first { Ok(next) } else { by(Fuel::First { factor: 0.0 }) }
    }

    /// Cams somewhere within the range of their schedule in each hold, whatever the load: there a phaser is that is behind a load. Cams that follow
    /// the load tell nothing of what they do from what the load does.
    fn move_cams(&self, course: &mut Course) {
        let mut rng = Rng64::stream(self.seed, 35);
        let ranges = self.steady.cam_ranges_deg();
        let mut from = 0;
        for to in &course.switches {
            let sent = ranges.map(|[low, high]| rng.uniform_in(low, high));
            course.cams_deg.extend(std::iter::repeat_n(sent, to - from));
            from = *to;
        }
    }

    /// Torques and speeds drawn and held; each other one is a low torque, so that boost is built and let go.
    fn record(&self, rng: &mut Rng64) -> Course {
        let mut out = Course::default();
        for _ in 0..if self.reduced { 26 } else { 44 } {
            let torque = rng.uniform_in(TORQUE_NM.0.ln(), TORQUE_NM.1.ln()).exp();
            out.hold(torque, rng.uniform_in(SPEED_RPM.0, SPEED_RPM.1), HOLD_S);
        }
        out.end()
    }

    pub(super) fn driver<'a>(
        &'a self,
        known: Option<&'a Fuelling>,
        setting: Setting,
        fuel: Fuel,
    ) -> Driver<'a> {
        let path = Path::new(&self.steady, known.map(|f| &f.filling), setting);
        Driver { path, fuel, waiting: VecDeque::new() }
    }

    pub(super) fn played(
        &self,
        seed: u64,
        course: &Course,
        driver: &mut Driver<'_>,
    ) -> Result<Trace, String> {
        play(&self.bed, seed, course, driver)
    }

    /// Not the disturbances of the records.
    pub(super) fn judged_seed(&self) -> u64 {
        self.seed + 1000
    }

    /// The shared steady points, at the coolant of the records.
    fn points(&self, traces: &[Trace]) -> Vec<SteadyPoint> {
        let coolant = || traces.iter().flat_map(|t| &t.coolant_c);
        self.steady.points(coolant().sum::<f64>() / coolant().count().max(1) as f64)
    }

    fn identified(
        &self,
        courses: &[Course],
        traces: &[Trace],
        interrupted: &(dyn Fn() -> bool + Sync),
    ) -> Result<Fuelling, Ended> {
        let views: Vec<_> = courses.iter().zip(traces).map(|(c, t)| view(c, t)).collect();
        fuelling::identify_with(&views, &self.points(traces), interrupted).map_err(ended)
    }

    fn known(&self, fuelling: Fuelling, courses: &[Course], traces: &[Trace]) -> Result<Known, Ended> {
        let views: Vec<_> = courses.iter().zip(traces).map(|(c, t)| view(c, t)).collect();
        let points = self.points(traces);
        let (mut charge, mut law) = fuelling::steady_charge_with(&views, &points).map_err(ended)?;
        if charge.cams.is_none() {
            // Rests whose cams are moved, and nothing that says what that does: the others alone.
            let still: Vec<_> = courses.iter().zip(&views).filter(|(c, _)| c.cams_deg.is_empty()).collect();
            let still: Vec<_> = still.into_iter().map(|(_, v)| *v).collect();
            (charge, law) = fuelling::steady_charge_with(&still, &points).map_err(ended)?;
        }
        let ecu = |charge, law| SpeedDensity {
            sample_time_s: SAMPLE_S,
            charge,
            law,
            most_kpa: MOST_KPA,
            ahead_s: 0.0,
            film: None,
            feedback: None,
        };
        let ours = ecu(fuelling.charge.clone(), fuelling.coolant);
        Ok(Known { at_rest: ecu(charge, law), ours, fuelling })
    }

    fn fuel(&self, known: &Known, fuelled: Fuelled) -> Fuel {
        match fuelled {
            Fuelled::Demand { lag_s } => Fuel::Demand { lag_s, behind: None },
            Fuelled::Policy { trimmed, waits } => {
                let mut fuelling = known.fuelling.clone();
                if waits {
                    // The model knows the throttle that much earlier than the engine, and looks ahead that much less.
                    fuelling.timing.charge_s -= wait(known) as f64 * SAMPLE_S;
                }
                let policy = FuelPolicy::new(fuelling, MOST_MG);
                Fuel::Policy { policy: Box::new(policy), trimmed }
            }
            Fuelled::Ecu { at_rest, ahead_s, closed_s } => {
                let plain = if at_rest { &known.at_rest } else { &known.ours };
                let timing = known.fuelling.timing;
                let feedback = closed_s.map(|closed_s| Feedback { timing, closed_s });
                let ecu = SpeedDensity { ahead_s, feedback, ..plain.clone() };
                Fuel::Ecu(Box::new(SpeedDensityState::new(ecu, MOST_MG)))
            }
        }
    }

    /// The best of fuels over the records, cams by their schedule as they will be driven, by the lambda that the sensor shows.
    fn best(
        &self,
        known: &Known,
        courses: &[Course],
        setting: Setting,
        tried: Vec<Fuelled>,
    ) -> Result<Fuelled, String> {
        let shown: Vec<f64> = tried
            .par_iter()
            .map(|fuelled| {
                let mut sum = 0.0;
                for course in courses {
                    let course = &Course { cams_deg: Vec::new(), ..course.clone() };
                    let mut driver = self.driver(Some(&known.fuelling), setting, self.fuel(known, *fuelled));
                    sum += integral_s(&self.played(self.seed, course, &mut driver)?.lambda);
                }
                Ok(sum)
            })
            .collect::<Result<_, String>>()?;
        let at = (0..tried.len()).min_by(|a, b| shown[*a].total_cmp(&shown[*b]));
        Ok(tried[at.unwrap_or(0)])
    }

    fn rows(
        &self,
        known: &Known,
        courses: &[Course],
        [production, ours]: [Setting; 2],
        interrupted: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<Row>, Ended> {
        let stride = if self.reduced { 3 } else { 1 };
        let ecu = |at_rest, ahead_s, closed_s| Fuelled::Ecu { at_rest, ahead_s, closed_s };
        let lags = LAGS_S.iter().step_by(stride).map(|lag_s| Fuelled::Demand { lag_s: *lag_s }).collect();
        let mut all = vec![
            ("fuel by demand".to_string(), production, Fuelled::Demand { lag_s: 0.0 }),
            ("fuel by demand, lag".into(), production, self.best(known, courses, production, lags)?),
            ("ECU".into(), production, ecu(true, 0.0, None)),
        ];
        for (at_rest, whose) in [(true, ""), (false, ", charge of ours")] {
            if interrupted() {
                return Err(Ended::Interrupted);
            }
            let aheads = AHEADS_S.iter().step_by(stride).map(|a| ecu(at_rest, *a, None)).collect();
            let open = self.best(known, courses, production, aheads)?;
            let name = format!("ECU, extrapolated{whose}");
            all.push((name.clone(), production, open));
            let Fuelled::Ecu { ahead_s, .. } = open else { continue };
            let loops = CLOSED_S.iter().step_by(stride).map(|c| ecu(at_rest, ahead_s, Some(*c))).collect();
            let closed = self.best(known, courses, production, loops)?;
            all.push((format!("{name}, lambda feedback"), production, closed));
            let prepared = Setting { rest_mm: ours.rest_mm, ..production };
            all.push((format!("{name}, lambda feedback{PREPARED}"), prepared, closed));
        }
        let policy = |trimmed, waits| Fuelled::Policy { trimmed, waits };
        all.push((UNTRIMMED.into(), ours, policy(false, false)));
        all.push((WAITS.into(), ours, policy(true, true)));
        all.push((OURS.into(), ours, policy(true, false)));
        let row = |(name, setting, fuelled): &(String, Setting, Fuelled)| {
            let one = |t: &(f64, [f64; 2])| {
                let course = tip(*t);
                let mut driver = self.driver(Some(&known.fuelling), *setting, self.fuel(known, *fuelled));
                if let Fuelled::Policy { waits: true, .. } = fuelled {
                    driver.waiting = std::iter::repeat_n(
                        self.steady.at(Of::Throttle, Of::Torque, t.1[0], t.0),
                        wait(known),
                    )
                    .collect();
                }
                let trace = self.played(self.judged_seed(), &course, &mut driver)?;
                Ok::<_, String>(TipIn::of(&trace, &course))
            };
            let tips = TIPS.iter().map(one).collect::<Result<_, _>>()?;
            Ok(Row { name: name.clone(), words: words(*fuelled), tips })
        };
        let mut out: Vec<Row> = all.par_iter().map(row).collect::<Result<_, String>>()?;
        if interrupted() {
            return Err(Ended::Interrupted);
        }
        out.push(learned::row(self, known, ours)?);
        Ok(out)
    }
}

/// Integral of |lambda - 1| that the sensor shows over the time of a course.
fn shown_s(trace: &Trace, course: &Course) -> f64 {
    integral_s(&trace.lambda) / course.length_s()
}

/// Samples from the command of an injection until its air counts, at the middle speed.
fn wait(known: &Known) -> usize {
    let middle_rpm = 0.5 * (TIPS[0].0 + TIPS[1].0);
    (known.fuelling.timing.ahead_s(middle_rpm) / SAMPLE_S).round() as usize
}

fn words(fuelled: Fuelled) -> String {
    match fuelled {
        Fuelled::Ecu { ahead_s, closed_s: Some(c), .. } => format!("{ahead_s} s, loop {c} s"),
        Fuelled::Ecu { ahead_s, .. } => format!("{ahead_s} s"),
        Fuelled::Demand { lag_s } if lag_s > 0.0 => format!("{lag_s} s"),
        _ => "-".into(),
    }
}

fn ended(e: FuellingError) -> Ended {
    match e {
        FuellingError::Interrupted => Ended::Interrupted,
        e => Ended::Failed(e.to_string()),
    }
}

fn view<'a>(course: &'a Course, trace: &'a Trace) -> TransientRecord<'a> {
    TransientRecord {
        sample_time_s: SAMPLE_S,
        speed_rpm: &course.speed_rpm,
        throttle_deg: &trace.throttle_deg,
        injection: &trace.injection_mg,
        map_kpa: &trace.map_kpa,
        lambda: &trace.lambda,
        upstream_kpa: AMBIENT_KPA,
        boost_kpa: Some(&trace.boost_kpa),
        coolant_c: Some(&trace.coolant_c),
        cams_deg: Some([&trace.cams_deg[0], &trace.cams_deg[1]]),
    }
}
