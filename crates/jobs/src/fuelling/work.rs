//! The work: identify, judge on what was not seen, and on a plant drive against a speed-density ECU at its best.

use dynocal_calib::fuelling::{
    Feedback, FuelPolicy, Fuelling, FuellingError, SpeedDensity, SpeedDensityState, identify,
    identify_without_film, steady_charge,
};
use dynocal_numerics::rng::Rng64;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants::PlantSpec;
use rayon::prelude::*;

use super::bed::{Course, Driver, Rig};
use super::records::{self, Record};
use super::result::{Driven, Fuelled, FuellingJobError, Score, Seen, Shown};
use super::spec::{Job, Source, Tables, Test};
use super::verdict;
use crate::estimate::Estimate;

/// What line searches of the rival try: time of the extrapolation, and time constant of the closed lambda loop, in s.
pub(crate) const AHEADS_S: [f64; 6] = [0.02, 0.04, 0.06, 0.08, 0.1, 0.12];
pub(crate) const CLOSED_S: [f64; 5] = [0.3, 0.8, 2.0, 5.0, 12.0];
/// Steps of a table over what the records saw.
const STEPS: usize = 10;
/// Time at the begin of a course that is not judged, in s: everything starts from the plant's own start.
const LEAD_IN_S: f64 = 3.0;
/// Name of ours.
const OURS: &str = "identified air and film";

/// Identifies and judges in memory.
///
/// # Errors
/// [`FuellingJobError`]: files, channels, records that do not tell enough, an interruption.
pub fn fuelling(job: &Job, watch: Watch) -> Result<Fuelled, FuellingJobError> {
    match &job.source {
        Source::Files { identification, unseen } => {
            let all = |files: &[std::path::PathBuf]| -> Result<Vec<Record>, FuellingJobError> {
                let each: Result<Vec<Vec<Record>>, _> =
                    files.iter().map(|f| records::read(f, &job.channels, &watch)).collect();
                Ok(each?.into_iter().flatten().collect())
            };
            let (learn, judge) = (all(identification)?, all(unseen)?);
            records::apart(&learn, &judge, &job.channels)?;
            watch.fraction(0.1);
            let known = Known::of(job, &learn, &watch)?;
            finished(job, &known, learn, judge, Vec::new(), Vec::new())
        }
        Source::Plant { plant, test } => on_plant(job, plant, test, &watch),
    }
}

/// What the job will do, and what it takes.
///
/// # Errors
/// [`FuellingJobError`]: files that cannot be read.
pub fn estimate(job: &Job) -> Result<Estimate, FuellingJobError> {
    let mut plan = Estimate::new(&job.name).line("run folder", job.out.display().to_string());
    let mut samples = 0;
    match &job.source {
        Source::Files { identification, unseen } => {
            for (role, files) in [("identification", identification), ("unseen", unseen)] {
                for file in files {
                    for r in records::read(file, &job.channels, &Watch::silent())? {
                        samples += r.speed_rpm.len();
                        plan = plan.line(format!("{role} {}", r.name), format!("{:.0} s", r.length_s()));
                    }
                }
            }
        }
        Source::Plant { plant, test } => {
            Rig::new(plant, &job.channels, test)?;
            samples = ((2.0 * test.record_s + test.unseen_s) / test.sample_time_s) as usize;
            let searches = AHEADS_S.len() + CLOSED_S.len();
            plan = plan
                .line("plant", format!("{}, {}", plant.name, plant.parameters))
                .line(
                    "records",
                    format!("two of {} s, and a course of {} s that judges", test.record_s, test.unseen_s),
                )
                .line("rival", format!("{searches} runs of the second record to tune an ECU, twice"));
        }
    }
    // Some forty parameters by differences, five corrections, three rounds of some twenty steps, with and without a film.
    Ok(plan.memory(8.0 * 60.0 * samples as f64).work(2.0 * 5e4 * 40.0 * samples as f64))
}

/// What the records gave.
struct Known {
    fuelling: Fuelling,
    without_film: Fuelling,
    seen: Seen,
    tables: Tables,
}

fn views<'a>(job: &Job, records: &'a [Record]) -> Vec<dynocal_calib::fuelling::TransientRecord<'a>> {
    records.iter().map(|r| r.view(job.upstream_kpa)).collect()
}

fn named(records: &[Record]) -> String {
    records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>().join(", ")
}

fn failed(records: &[Record]) -> impl Fn(FuellingError) -> FuellingJobError {
    let record = named(records);
    move |source| match source {
        FuellingError::Interrupted => FuellingJobError::Interrupted,
        source => FuellingJobError::Identification { record: record.clone(), source },
    }
}

impl Known {
    fn of(job: &Job, learn: &[Record], watch: &Watch) -> Result<Self, FuellingJobError> {
        let views = views(job, learn);
        let interrupt = || watch.interrupted();
        watch.note("identifying air and film");
        let fuelling = identify(&views, &interrupt).map_err(failed(learn))?;
        watch.note("the same without a film");
        let without_film = identify_without_film(&views, &interrupt).map_err(failed(learn))?;
        let seen = seen(learn);
        Ok(Self { fuelling, without_film, seen, tables: tables(&job.tables, &seen) })
    }
}

fn on_plant(job: &Job, plant: &PlantSpec, test: &Test, watch: &Watch) -> Result<Fuelled, FuellingJobError> {
    let mut rig = Rig::new(plant, &job.channels, test)?;
    let course =
        |stream: u64, length_s: f64| Course::drawn(test, length_s, &mut Rng64::stream(job.seed, stream));
    let (a, b, judged) = (course(1, test.record_s), course(2, test.record_s), course(3, test.unseen_s));
    let most = job.most_injection;
    let seed = |k: u64| (job.seed.wrapping_add(1000 * k), most);
    watch.note("driving a first record");
    let mut first = rig.first()?;
    let mut learn = vec![rig.drive("record-1", (&a, test, true), &mut first, seed(1), watch)?];
    watch.fraction(0.1);
    let interrupt = || watch.interrupted();
    let begun = identify(&views(job, &learn), &interrupt).map_err(failed(&learn))?;
    watch.fraction(0.25);
    // Where the mixture is near its demand already, small errors of the model show.
    let policy = |f: &Fuelling| Box::new(FuelPolicy::new(f.clone(), most));
    let mut driver = Driver::Policy { policy: policy(&begun), trimmed: false };
    learn.push(rig.drive("record-2", (&b, test, true), &mut driver, seed(2), watch)?);
    let known = Known::of(job, &learn, watch)?;
    watch.fraction(0.6);
    watch.note("tuning a speed-density ECU");
    let rivals = rivals(job, (plant, test), (&learn, &b), &known, watch)?;
    watch.fraction(0.9);
    watch.note("driving the course that judges");
    let mut shown = Vec::new();
    let mut drive = |name: &str, setting: String, mut driver: Driver| -> Result<Driven, FuellingJobError> {
        let r = rig.drive(name, (&judged, test, false), &mut driver, seed(3), watch)?;
        let out = Driven { rival: matches!(driver, Driver::Ecu(_)), ..scored(name, setting, &r) };
        shown.push(r);
        Ok(out)
    };
    let ours = |trimmed| Driver::Policy { policy: policy(&known.fuelling), trimmed };
    let mut driven = vec![drive(OURS, "-".into(), ours(true))?];
    if known.fuelling.trim.is_some() {
        driven.push(drive("the same without the trim", "-".into(), ours(false))?);
    }
    // Neither what was identified nor what was tuned drives the record that the model is judged on.
    let plain = rivals.first().map(|(_, ecu)| SpeedDensity { ahead_s: 0.0, film: None, ..ecu.clone() });
    for (name, ecu) in rivals {
        let closed = ecu.feedback.map_or(String::new(), |f| format!(", loop {} s", f.closed_s));
        let setting = format!("extrapolation {} s{closed}", ecu.ahead_s);
        driven.push(drive(&name, setting, Driver::Ecu(Box::new(SpeedDensityState::new(ecu, most))))?);
    }
    let mut other = match plain {
        Some(ecu) => Driver::Ecu(Box::new(SpeedDensityState::new(ecu, most))),
        None => rig.first()?,
    };
    let unseen = rig.drive("unseen", (&judged, test, true), &mut other, seed(4), watch)?;
    finished(job, &known, learn, vec![unseen], driven, shown)
}

/// The mixture while somebody drove.
fn scored(name: &str, setting: String, r: &Record) -> Driven {
    let from = ((LEAD_IN_S / r.sample_time_s) as usize).min(r.lambda.len());
    let errors = || r.lambda[from..].iter().map(|l| l - 1.0);
    let count = (r.lambda.len() - from).max(1) as f64;
    Driven {
        name: name.into(),
        rival: false,
        setting,
        mean: errors().map(f64::abs).sum::<f64>() / count,
        lean: errors().fold(0.0, f64::max),
        rich: errors().fold(0.0, |m, e| m.max(-e)),
    }
}

/// A speed-density ECU with the film that was identified: with the charge at rest and with that of ours, its extrapolation and then
/// its lambda loop tuned by line searches on the second course.
fn rivals(
    job: &Job,
    (plant, test): (&PlantSpec, &Test),
    (learn, course): (&[Record], &Course),
    known: &Known,
    watch: &Watch,
) -> Result<Vec<(String, SpeedDensity)>, FuellingJobError> {
    let (charge, law) = steady_charge(&views(job, learn)).map_err(failed(learn))?;
    let f = &known.fuelling;
    let film = Some(f.coat());
    let plain = |charge, law| SpeedDensity {
        sample_time_s: f.sample_time_s,
        charge,
        law,
        most_kpa: learn.iter().flat_map(|r| &r.map_kpa).fold(job.upstream_kpa, |m, p| m.max(*p)),
        ahead_s: 0.0,
        film,
        feedback: None,
    };
    let both = [
        ("ECU by extrapolated pressure, film", plain(charge, law)),
        ("ECU by extrapolated pressure, film, charge of ours", plain(f.charge.clone(), f.coolant)),
    ];
    let tuned =
        |(name, plain): &(&str, SpeedDensity)| -> Result<Vec<(String, SpeedDensity)>, FuellingJobError> {
            let mut rig = Rig::new(plant, &job.channels, test)?;
            let mut best_of = |all: Vec<SpeedDensity>| -> Result<SpeedDensity, FuellingJobError> {
                let mut best: Option<(f64, SpeedDensity)> = None;
                for ecu in all {
                    let state = SpeedDensityState::new(ecu.clone(), job.most_injection);
                    let mut driver = Driver::Ecu(Box::new(state));
                    let seed = (job.seed.wrapping_add(2000), job.most_injection);
                    let r = rig.drive(name, (course, test, false), &mut driver, seed, watch)?;
                    let mean = scored(name, String::new(), &r).mean;
                    if best.as_ref().is_none_or(|b| mean < b.0) {
                        best = Some((mean, ecu));
                    }
                }
                Ok(best.map_or_else(|| plain.clone(), |b| b.1))
            };
            let open =
                best_of(AHEADS_S.iter().map(|s| SpeedDensity { ahead_s: *s, ..plain.clone() }).collect())?;
            let closed = |s: &f64| SpeedDensity {
                feedback: Some(Feedback { timing: f.timing, closed_s: *s }),
                ..open.clone()
            };
            let closed = best_of(CLOSED_S.iter().map(closed).collect())?;
            Ok(vec![(name.to_string(), open), (format!("{name}, lambda feedback"), closed)])
        };
    let each: Result<Vec<_>, _> = both.par_iter().map(tuned).collect();
    Ok(each?.into_iter().flatten().collect())
}

/// Scores, verdict and what is drawn.
fn finished(
    job: &Job,
    known: &Known,
    learn: Vec<Record>,
    judge: Vec<Record>,
    driven: Vec<Driven>,
    drives: Vec<Record>,
) -> Result<Fuelled, FuellingJobError> {
    let mut scores = Vec::new();
    let mut shown = Vec::new();
    let roles = [("identification", learn), ("unseen", judge)];
    for (role, record) in roles.into_iter().flat_map(|(role, all)| all.into_iter().map(move |r| (role, r))) {
        let richness = shown_by(job, &known.fuelling, &record)?;
        let bare = shown_by(job, &known.without_film, &record)?;
        scores.push(score(&record, role, &richness, &bare, &known.seen));
        shown.push(Shown { record, role: role.into(), richness });
    }
    for record in drives {
        let richness = shown_by(job, &known.fuelling, &record)?;
        shown.push(Shown { role: record.name.clone(), record, richness });
    }
    let (valid, verdict) = verdict::verdict(&scores, &driven);
    let warnings = verdict::warnings(&known.fuelling, &scores, &known.seen);
    Ok(Fuelled {
        verb: "fuelling",
        name: job.name.clone(),
        valid,
        verdict,
        warnings,
        fuelling: known.fuelling.clone(),
        scores,
        driven,
        seen: known.seen,
        files: Vec::new(),
        records: shown,
        tables: known.tables.clone(),
    })
}

fn shown_by(job: &Job, f: &Fuelling, r: &Record) -> Result<Vec<f64>, FuellingJobError> {
    let fault = |source| FuellingJobError::Identification { record: r.name.clone(), source };
    f.shown(&r.view(job.upstream_kpa)).map_err(fault)
}

fn score(r: &Record, role: &'static str, ours: &[f64], bare: &[f64], seen: &Seen) -> Score {
    let rms = |of: &dyn Fn(usize) -> f64| {
        let n = r.lambda.len();
        ((0..n).map(|t| (1.0 / r.lambda[t] - of(t)).powi(2)).sum::<f64>() / n as f64).sqrt()
    };
    let within = |v: f64, [low, high]: [f64; 2]| (low..=high).contains(&v);
    let outside = r.speed_rpm.iter().zip(&r.map_kpa);
    let outside =
        outside.filter(|(n, p)| !(within(**n, seen.speed_rpm) && within(**p, seen.map_kpa))).count();
    Score {
        record: r.name.clone(),
        role,
        length_s: r.length_s(),
        rms: rms(&|t| ours[t]),
        rms_without_film: rms(&|t| bare[t]),
        rms_of_mixture: rms(&|_| 1.0),
        outside: outside as f64 / r.speed_rpm.len() as f64,
    }
}

fn seen(records: &[Record]) -> Seen {
    let range = |of: &dyn Fn(&Record) -> &[f64]| {
        let all = records.iter().flat_map(|r| of(r).iter().copied());
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)])
    };
    let coolant = records.iter().all(|r| r.coolant_c.is_some());
    let cams = records.iter().all(|r| r.cams_deg.is_some());
    let cam = |k: usize| range(&|r: &Record| r.cams_deg.as_ref().map_or(&[][..], |c| &c[k]));
    Seen {
        speed_rpm: range(&|r| &r.speed_rpm),
        map_kpa: range(&|r| &r.map_kpa),
        throttle_deg: range(&|r| &r.throttle_deg),
        coolant_c: coolant.then(|| range(&|r| r.coolant_c.as_deref().unwrap_or(&[]))),
        cams_deg: cams.then(|| [cam(0), cam(1)]),
    }
}

/// Breakpoints as given, else equal steps over what was seen.
fn tables(given: &Tables, seen: &Seen) -> Tables {
    let axis = |given: &[f64], [low, high]: [f64; 2]| -> Vec<f64> {
        if !given.is_empty() {
            return given.to_vec();
        }
        (0..=STEPS).map(|k| low + (high - low) * k as f64 / STEPS as f64).collect()
    };
    Tables {
        speed_rpm: axis(&given.speed_rpm, seen.speed_rpm),
        map_kpa: axis(&given.map_kpa, seen.map_kpa),
        coolant_c: seen.coolant_c.map_or_else(Vec::new, |range| axis(&given.coolant_c, range)),
    }
}
