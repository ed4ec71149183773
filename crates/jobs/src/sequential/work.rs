//! The campaign, played in memory.

use dynocal_numerics::interval::Interval;
use std::sync::Arc;

use dynocal_calib::loops::bed::TestBed;
use dynocal_calib::loops::model::mean_square;
use dynocal_calib::loops::plan::{Aim, Known, RobustAim, Structure, know, problem};
use dynocal_calib::loops::{Campaign, Limit, LoopError, Rounds, StopRule, iterate, sequential};
use dynocal_design::criterion::criterion;
use dynocal_design::problem::Term;
use dynocal_design::search::{DesignOptions, random_record};
use dynocal_ident::data::{Dataset, UnitAfter};
use dynocal_ident::model::Model;
use dynocal_ident::model::form::Form;
use dynocal_ident::model::kinds::kind;
use dynocal_ident::plant::{Causality, Plant, Variable};
use dynocal_ident::stored::{Quantity, StoredModel};
use dynocal_ident::validate::departure;
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use dynocal_plant::plants;

use super::result::{OutputLine, ParameterLine, RoundLine, Sequenced, SequentialError};
use super::spec::{Course, Job};

/// Seeds of the random records, apart from those of the rounds (which count on in thousands).
const HELD_OUT: u64 = 101;
const FIRST: u64 = 102;
const RIVAL: u64 = 200;

/// Plays the campaign.
///
/// # Errors
/// [`SequentialError`].
pub fn play(job: &Job, watch: Watch) -> Result<Sequenced, SequentialError> {
    let (mut plant, mut rival) = (made(job)?, made(job)?);
    let variables = plant.variables().to_vec();
    let units = named(job, &variables)?;
    let bed =
        TestBed { channels: job.channels.clone(), sample_time_s: job.sample_time_s, settle_s: job.settle_s };
    let forms = forms(job)?;
    let models =
        forms.iter().zip(&job.outputs).map(|(f, o)| narx(f.as_ref(), o)).collect::<Result<Vec<_>, _>>()?;
    let structures: Vec<Structure> = models
        .iter()
        .zip(&job.outputs)
        .map(|(model, o)| Structure { weight: o.weight, ..Structure::new(&o.name, *model) })
        .collect();
    watch.note("held-out and first record");
    // A problem needs something to make small; a random record does not look at it.
    let chosen = criterion("d", &toml::Table::new())?;
    let nothing = vec![0.0; models[0].n_params()];
    let random = |plant: &mut dyn Plant, name: &str, samples: usize, seed: u64| {
        let term = Term::new(structures[0].output, models[0], &nothing, 1.0, chosen.as_ref());
        let u = random_record(&problem(&bed, samples, vec![term]), job.seed.wrapping_add(seed))
            .map_err(LoopError::from)?;
        bed.measure(plant, name, &u)
    };
    let held_out = random(plant.as_mut(), "held_out", job.held_out, HELD_OUT)?;
    let first = random(plant.as_mut(), "first", job.first, FIRST)?;
    watch.note("rounds of design and measurement");
    let found = rounds(job, plant.as_mut(), &bed, &structures, vec![first.clone()], &held_out, watch)?;
    let measured = found.records.len() - 1;
    watch.note("random records of the same bed time beside it");
    let mut records = vec![first];
    for k in 0..measured {
        if watch.interrupted() {
            return Err(LoopError::Interrupted.into());
        }
        records.push(random(rival.as_mut(), &format!("random{:02}", k + 1), job.samples, RIVAL + k as u64)?);
    }
    let by_chance = know(&bed, &structures, &records)?;
    let before = know(&bed, &structures, &records[..1])?;
    let judged = Judged { bed: &bed, structures: &structures, held_out: &held_out };
    let mut outputs = Vec::new();
    for (k, unit) in units.iter().enumerate() {
        outputs.push(OutputLine {
            output: job.outputs[k].name.clone(),
            unit: unit.clone(),
            rmse_first: judged.rmse(k, &before[k])?,
            rmse_designed: judged.rmse(k, &found.known[k])?,
            rmse_random: judged.rmse(k, &by_chance[k])?,
            parameters: parameters(&found.known[k], &before[k]),
            measured: span(&found.records[1..], &job.outputs[k].name)?,
        });
    }
    let computed =
        (0..structures.len()).map(|k| judged.free_run(k, &found.known[k])).collect::<Result<_, _>>()?;
    let stored = stored(job, &forms, &found.known, &units)?;
    let settled = if job.course == Course::Separate { measured + 1 } else { 1 };
    let bed_s =
        (job.first + measured * job.samples) as f64 * job.sample_time_s + settled as f64 * job.settle_s;
    let mut out = Sequenced {
        verb: "sequential",
        name: job.name.clone(),
        valid: true,
        verdict: String::new(),
        warnings: Vec::new(),
        rounds: round_lines(&found),
        stopped: found.stopped,
        outputs,
        bed_s,
        held_out_s: job.held_out as f64 * job.sample_time_s + job.settle_s,
        files: Vec::new(),
        records: found.records,
        held_out,
        computed,
        models: stored,
    };
    judge(job, &mut out);
    Ok(out)
}

fn made(job: &Job) -> Result<Box<dyn Plant>, SequentialError> {
    // The check of the spec refuses plants that cannot be made.
    let make =
        plants::find(&job.plant.name).and_then(|m| m.make).ok_or_else(|| SequentialError::Channel {
            role: "row in the table of plants that answers",
            name: job.plant.name.clone(),
            known: plants::PLANTS.iter().map(|p| p.doc.name).collect::<Vec<_>>().join(", "),
        })?;
    let mut plant = make(&job.plant, true)?;
    plant.reset(job.seed);
    Ok(plant)
}

/// Every channel and output is one of the plant's, in its unit; the units of the outputs.
fn named(job: &Job, variables: &[Variable]) -> Result<Vec<String>, SequentialError> {
    let known = |causality: Causality| {
        let names = variables.iter().filter(|v| v.causality == causality).map(|v| v.name.as_str());
        names.collect::<Vec<_>>().join(", ")
    };
    let find = |name: &str, causality: Causality, role: &'static str| {
        variables
            .iter()
            .find(|v| v.name == name && v.causality == causality)
            .ok_or_else(|| SequentialError::Channel { role, name: name.into(), known: known(causality) })
    };
    for (c, unit) in job.channels.iter().zip(&job.units) {
        let v = find(&c.name, Causality::Input, "input")?;
        if v.unit != *unit {
            return Err(SequentialError::Unit {
                name: c.name.clone(),
                found: unit.clone(),
                expected: v.unit.clone(),
            });
        }
    }
    job.outputs.iter().map(|o| Ok(find(&o.name, Causality::Output, "output")?.unit.clone())).collect()
}

fn forms(job: &Job) -> Result<Vec<Arc<dyn Form>>, SequentialError> {
    let inputs: Vec<String> = job.channels.iter().map(|c| c.name.clone()).collect();
    job.outputs
        .iter()
        .map(|o| {
            let structure = kind(&o.kind, &o.keys)?;
            let fault = |source| SequentialError::Structure { output: o.name.clone(), source };
            structure.form(&inputs, &o.name, &[]).map_err(fault)
        })
        .collect()
}

/// A NARX model that is linear in its parameters: what the campaign estimates by least squares.
fn narx<'a>(form: &'a dyn Form, o: &super::spec::Output) -> Result<&'a dyn Model, SequentialError> {
    form.dynamics()
        .filter(|m| m.is_linear_in_params())
        .ok_or_else(|| SequentialError::Kind { output: o.name.clone(), kind: o.kind.clone() })
}

fn rounds(
    job: &Job,
    plant: &mut dyn Plant,
    bed: &TestBed,
    structures: &[Structure],
    initial: Vec<Dataset>,
    held_out: &Dataset,
    watch: Watch,
) -> Result<Campaign, LoopError> {
    let search = DesignOptions {
        search: job.search.name.clone(),
        starts: job.search.starts,
        evaluations: job.search.evaluations,
        seed: job.seed,
        ..DesignOptions::default()
    };
    // Where predictions shall be good: as the held-out record, which is random within the limits.
    let names = bed.names();
    let objective = held_out.matrix(&names)?;
    let aim = Aim {
        criterion: job.criterion.clone(),
        keys: toml::Table::new(),
        objective,
        adds: job.course == Course::Continuous,
        search,
        robust: job.robust.map(|r| RobustAim { draws: r.draws, risk: r.risk }),
    };
    let limits: Vec<Limit> = job
        .outputs
        .iter()
        .filter_map(|o| {
            let l = o.limits?;
            let output = o.name.clone();
            Some(Limit { output, lower: l.lower, upper: l.upper, rate: l.rate, caution: l.caution })
        })
        .collect();
    let rounds =
        Rounds { bed, structures, aim: &aim, samples: job.samples, rounds: job.rounds, limits: &limits };
    match job.course {
        Course::Separate => iterate(plant, &rounds, initial, watch.interrupt),
        Course::Continuous => {
            let stop = StopRule {
                held_out: std::slice::from_ref(held_out),
                noise: job.noise_std.powi(2),
                threshold: job.stop_below,
            };
            sequential(plant, &rounds, initial, Some(stop), watch.interrupt)
        }
    }
}

/// What models are judged on.
struct Judged<'a> {
    bed: &'a TestBed,
    structures: &'a [Structure<'a>],
    held_out: &'a Dataset,
}

impl Judged<'_> {
    fn rmse(&self, k: usize, known: &Known) -> Result<Option<f64>, SequentialError> {
        let data = self.bed.experiments(std::slice::from_ref(self.held_out), self.structures[k].output)?;
        let square = mean_square(self.structures[k].model, &known.fit.theta, &data);
        Ok(Some(square.sqrt()).filter(|v| v.is_finite()))
    }

    fn free_run(&self, k: usize, known: &Known) -> Result<Vec<f64>, SequentialError> {
        let s = &self.structures[k];
        let data = self.bed.experiments(std::slice::from_ref(self.held_out), s.output)?;
        let mut y = vec![f64::NAN; self.held_out.len()];
        if let Some(e) = data.first() {
            s.model.simulate(&known.fit.theta, &e.run(s.model), &mut y);
        }
        Ok(y)
    }
}

fn parameters(now: &Known, before: &Known) -> Vec<ParameterLine> {
    let finite = |v: f64| Some(v).filter(|v| v.is_finite());
    let names = now.fit.names.iter().zip(&now.fit.theta);
    names
        .enumerate()
        .map(|(i, (name, value))| ParameterLine {
            name: name.clone(),
            value: *value,
            std_error: finite(now.fit.std_errors[i]),
            std_error_first: finite(before.fit.std_errors[i]),
        })
        .collect()
}

fn span(records: &[Dataset], output: &str) -> Result<Interval, SequentialError> {
    let mut all = Interval::spanning([]);
    for r in records {
        let values = r.values(output).map_err(LoopError::from)?;
        all = values.iter().copied().fold(all, Interval::including);
    }
    Ok(all)
}

fn stored(
    job: &Job,
    forms: &[Arc<dyn Form>],
    known: &[Known],
    units: &[String],
) -> Result<Vec<StoredModel>, SequentialError> {
    let inputs: Vec<Quantity> = job
        .channels
        .iter()
        .zip(&job.units)
        .map(|(c, unit)| Quantity { name: c.name.clone(), unit: unit.clone() })
        .collect();
    let mut out = Vec::new();
    for (k, known) in known.iter().enumerate() {
        let output = Quantity { name: job.outputs[k].name.clone(), unit: units[k].clone() };
        let form = dynocal_ident::model::form::AnyForm(forms[k].clone());
        let made = StoredModel::new(form, &known.fit.theta, inputs.clone(), output, job.sample_time_s);
        let mut model = made.map_err(|e| LoopError::Model {
            what: format!("model of `{}`", job.outputs[k].name),
            reason: e.to_string(),
        })?;
        for (p, e) in model.parameters.iter_mut().zip(&known.fit.std_errors) {
            p.std_error = Some(*e).filter(|e| e.is_finite());
        }
        model.estimator = known.fit.estimator.clone();
        model.noise_variance = Some(known.fit.noise_variance);
        model.origin = format!("campaign {}", job.name);
        out.push(model);
    }
    Ok(out)
}

fn round_lines(found: &Campaign) -> Vec<RoundLine> {
    let measured = found.records.len() - 1;
    let line = |(k, r): (usize, &dynocal_calib::loops::Round)| RoundLine {
        round: k + 1,
        status: r.design.status,
        criterion: r.design.value,
        rmse_before: r.stage.map(|s| s.held_out.sqrt()).filter(|v| v.is_finite()),
        forecast: r.forecast,
        measured: k < measured,
    };
    found.rounds.iter().enumerate().map(line).collect()
}

/// Verdict and warnings.
fn judge(job: &Job, out: &mut Sequenced) {
    let mut warnings = Vec::new();
    for (o, y) in out.outputs.iter().zip(&out.computed) {
        let measured = out.held_out.values(&o.output).unwrap_or_default();
        if let Some(far) = departure(y, measured.iter().copied(), |_| true) {
            warnings.push(format!(
                "the free run of the model of `{}` {} on the held-out record: another structure is needed",
                o.output,
                far.words()
            ));
        }
        let limits = job.outputs.iter().find(|s| s.name == o.output).and_then(|s| s.limits);
        if let Some(l) = limits.filter(|l| o.measured.lower < l.lower || o.measured.upper > l.upper) {
            warnings.push(format!(
                "`{}` went from {:.4} to {:.4} {} in the designed records: outside of {} to {}",
                o.output, o.measured.lower, o.measured.upper, o.unit, l.lower, l.upper
            ));
        }
    }
    out.valid = warnings.is_empty();
    for r in out.rounds.iter().filter(|r| r.status == Status::Infeasible) {
        warnings.push(format!(
            "the design of round {} keeps its output limits nowhere: the least violation was played",
            r.round
        ));
        out.valid = false;
    }
    out.warnings = warnings;
    out.verdict = verdict(out);
}

fn verdict(out: &Sequenced) -> String {
    let played = out.rounds.iter().filter(|r| r.measured).count();
    let end = match out.stopped {
        true => "the next one was expected to be worth too little",
        false => "the budget of rounds is used",
    };
    let each: Vec<String> = out
        .outputs
        .iter()
        .map(|o| match (o.rmse_first, o.rmse_designed, o.rmse_random) {
            (Some(a), Some(b), Some(c)) => format!(
                "`{}`: error on the held-out record from {a:.4} to {b:.4} {}, {}",
                o.output,
                o.unit,
                beside(b, c, &o.unit)
            ),
            (_, None, _) => format!("`{}`: no usable model", o.output),
            (_, Some(b), None) => {
                format!("`{}`: error {b:.4} {}; with random records instead it diverges", o.output, o.unit)
            }
            (None, Some(b), Some(c)) => {
                format!("`{}`: error {b:.4} {}, {}", o.output, o.unit, beside(b, c, &o.unit))
            }
        })
        .collect();
    let records = if played == 1 { "record" } else { "records" };
    format!("{played} designed {records}, then {end}. {}.", each.join("; "))
}

/// Two errors that differ by less than this share are not told apart by one held-out record.
const ALIKE: f64 = 0.05;

fn beside(designed: f64, random: f64, unit: &str) -> String {
    let unit = UnitAfter(unit);
    let ratio = designed / random;
    if ratio < 1.0 - ALIKE {
        format!("better than with random records of the same bed time ({random:.4}{unit})")
    } else if ratio > 1.0 + ALIKE {
        format!(
            "worse than with random records of the same bed time ({random:.4}{unit}): the design did not pay"
        )
    } else {
        format!("as with random records of the same bed time ({random:.4}{unit}): the design did not pay")
    }
}
