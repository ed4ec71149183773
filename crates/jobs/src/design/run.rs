//! The work of a design: search, margins, comparison, files.

use std::path::Path;

use dynocal_design::certificate::certify;
use dynocal_design::channel::Layout;
use dynocal_design::problem::{DesignProblem, Evaluator, OutputLimits, Term};
use dynocal_design::search::{DesignOptions, DesignOutcome, design};
use dynocal_files::csv_io;
use dynocal_files::run_folder::RunFolder;
use dynocal_ident::data::{Channel, Dataset, Role, UnitAfter};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;

use super::error::DesignJobError;
use super::load::{Inputs, check_stable, load};
use super::loaded::{Loaded, NamedCriterion};
use super::margins::{MarginBasis, MarginUsed, margin_of};
use super::result::{
    Bound, CriterionLine, Curves, Designed, InformationLine, LeastDistance, OutputCurve, Outside, Quantity,
    SafetyLine,
};
use super::rivals::{efficiencies, uniform};
use super::rounds::{Bracket, MOST_ROUNDS, bands_keep};
use super::{Job, Objective, judge};

/// Makes the design and writes `design.csv`, `predicted.csv` and `summary.json` into the run folder.
///
/// # Errors
/// [`DesignJobError`].
pub fn run(job: &Job, watch: Watch) -> Result<(Designed, Curves, RunFolder), DesignJobError> {
    let inputs = load(job)?;
    inputs.notes.iter().for_each(|n| watch.note(n));
    // A folder that cannot be written is known before anything is computed.
    let folder = RunFolder::open_at(&job.out, "design", job)?;
    let (designed, curves) = make(job, &inputs, watch)?;
    write(job, &designed, &curves, folder.path())?;
    folder.write_summary(&designed)?;
    Ok((designed, curves, folder))
}

/// One design with the margins that it was made with.
struct Round {
    found: DesignOutcome,
    curves: Curves,
    safety: Vec<SafetyLine>,
    margins: Vec<Option<MarginUsed>>,
}

/// The design itself, without files.
///
/// # Errors
/// [`DesignJobError`].
pub fn make(job: &Job, inputs: &Inputs, watch: Watch) -> Result<(Designed, Curves), DesignJobError> {
    let mut margins: Vec<Option<MarginUsed>> = inputs.models.iter().map(margin_of).collect();
    let (objective, objective_text) = objective(job, inputs)?;
    inputs.models.iter().try_for_each(|m| check_stable(m, &objective))?;
    let mut options = DesignOptions {
        search: job.search.name.clone(),
        keys: job.search.keys.clone(),
        starts: job.search.starts,
        evaluations: job.search.evaluations,
        seed: job.seed,
        ..DesignOptions::default()
    };
    let weights = weights(job, inputs, &objective)?;
    let (mut rounds, mut evaluations) = (0, 0);
    let (mut bracket, mut best) = (Bracket::default(), None::<Round>);
    let Round { found, curves, safety, margins } = loop {
        rounds += 1;
        watch.note(&format!("round {rounds}: {} starts of {}", job.search.starts, job.search.name));
        let problem = problem(job, inputs, &objective, &margins, &weights);
        let found = design(&problem, &options, watch.interrupt, &|_| ())?;
        evaluations += found.evaluations;
        let (curves, safety) = judged(job, inputs, &margins, &problem, &found);
        let (met, kept) = (met_its_margins(&found), bands_keep(&safety));
        options.start = Some(found.u.clone());
        let round = Round { found, curves, safety, margins: margins.clone() };
        let further = rounds < MOST_ROUNDS && met && bracket.next(&mut margins, &round.safety);
        // Of the rounds whose bands keep the limits the most informative; where there is none, the last.
        let better = kept && met && best.as_ref().is_none_or(|b: &Round| round.found.value < b.found.value);
        let mut last = Some(round);
        if better {
            best = last.take();
        }
        if !further && let Some(chosen) = best.take().or(last) {
            break chosen;
        }
    };
    watch.note("comparing with random signals of the same limits");
    let problem = problem(job, inputs, &objective, &margins, &weights);
    let mut e = Evaluator::new(&problem)?;
    e.value(&found.u);
    let information = judge::information(&problem, &inputs.models, &e);
    let rivals = efficiencies(&problem, &inputs.models, &objective, &found.u, job.rivals, job.seed)?;
    let (coverage, pairs, correlations) = judge::inputs(&inputs.channels, &found.u);
    let warnings = warnings(&found, &safety, &information, inputs);
    let kept = bands_keep(&safety);
    let seen = information.iter().all(|i| i.rank == i.parameters);
    let criteria = criteria(&problem, inputs, &found.u)?;
    let bound = (job.certificate && !watch.interrupted()).then(|| {
        watch.note("bounding the information of every record within the limits (`certificate = false` leaves it out)");
        certificate(&problem, &criteria)
    });
    let channels = job.channels.iter().map(|c| quantity(&c.channel.name, &c.unit)).collect();
    Ok((
        Designed {
            verb: "design".into(),
            name: job.name.clone(),
            valid: !matches!(found.status, Status::Interrupted | Status::Infeasible) && kept && seen,
            warnings,
            status: found.status,
            samples: job.samples,
            sample_time_s: job.sample_time_s,
            channels,
            value: found.value,
            start_value: found.start_value,
            efficiencies: rivals,
            certificate: bound,
            criteria,
            objective: objective_text,
            safety,
            information,
            coverage,
            pairs,
            correlations,
            history: found.history,
            evaluations,
            rounds,
            files: ["design.csv", "design.plan.csv", "design.plan.json", "predicted.csv", "report.html"]
                .map(str::to_string)
                .to_vec(),
        },
        curves,
    ))
}

/// The certificate of a design (equivalence theorem), or why there is none.
fn certificate(problem: &DesignProblem, criteria: &[CriterionLine]) -> Bound {
    let value = criteria.first().map_or(f64::NAN, |c| c.value);
    match certify(problem, value) {
        Ok(c) => {
            let (bound, efficiency) = (Some(c.bound), Some(100.0 * c.efficiency));
            Bound { bound, efficiency_percent: efficiency, none_because: None }
        }
        Err(e) => Bound { bound: None, efficiency_percent: None, none_because: Some(e.to_string()) },
    }
}

fn quantity(name: &str, unit: &str) -> Quantity {
    Quantity { name: name.into(), unit: unit.into() }
}

/// The problem with the present margins.
fn problem<'a>(
    job: &Job,
    inputs: &'a Inputs,
    objective: &'a [f64],
    margins: &[Option<MarginUsed>],
    weights: &[f64],
) -> DesignProblem<'a> {
    let term = |((m, margin), weight): ((&'a Loaded, &Option<MarginUsed>), &f64)| Term {
        name: &m.name,
        model: m.model.as_ref(),
        predictor: m.predictor.as_deref(),
        theta: &m.theta,
        noise_variance: m.noise_variance,
        initial_output: m.initial_output,
        criterion: m.criterion.as_ref().map(|c| c.criterion.as_ref()),
        weight: *weight,
        objective_signal: objective,
        reference_scale: &[],
        prior: &m.prior,
        limits: m.limits.as_ref().zip(margin.as_ref()).map(|(l, q)| OutputLimits {
            lower: l.lower,
            upper: l.upper,
            margin: q.kept,
        }),
    };
    DesignProblem {
        channels: inputs.channels.clone(),
        n_samples: job.samples,
        convention: job.convention,
        start: 0,
        terms: inputs.models.iter().zip(margins).zip(weights).map(term).collect(),
    }
}

/// Weights of the criteria: those of the spec, or where efficiencies are asked for these over the criterion of a random record within
/// the limits, and for `d`, a logarithm, over the number of parameters. A criterion without a value there keeps its own.
fn weights(job: &Job, inputs: &Inputs, objective: &[f64]) -> Result<Vec<f64>, DesignJobError> {
    let own: Vec<f64> = inputs.models.iter().map(|m| m.weight).collect();
    if !job.efficiencies {
        return Ok(own);
    }
    let layout = Layout::new(&inputs.channels, job.samples)?;
    let random = uniform(&layout, job.seed);
    let none: Vec<Option<MarginUsed>> = inputs.models.iter().map(|_| None).collect();
    let all = problem(job, inputs, objective, &none, &own);
    let one = |(term, m): (&Term, &Loaded)| -> Result<f64, DesignJobError> {
        let Some(c) = &m.criterion else { return Ok(m.weight) };
        if !c.criterion.is_positive() {
            return Ok(m.weight / m.theta.len() as f64);
        }
        let alone = DesignProblem { terms: vec![Term { weight: 1.0, limits: None, ..*term }], ..all.clone() };
        let value = Evaluator::new(&alone)?.value(&random);
        Ok(if value.is_finite() && value > 0.0 { m.weight / value } else { m.weight })
    };
    all.terms.iter().zip(&inputs.models).map(one).collect()
}

/// The objective signal (N0 x m) and what it is.
fn objective(job: &Job, inputs: &Inputs) -> Result<(Vec<f64>, String), DesignJobError> {
    Ok(match (&inputs.objective, &job.objective) {
        (Some(u), Objective::File(path)) => (u.clone(), format!("record {}", path.display())),
        (Some(u), _) => (u.clone(), "test signals of the spec".into()),
        // Global accuracy (thesis section 4.8.1): what may be asked is anything within the limits.
        (None, _) => {
            let layout = Layout::new(&inputs.channels, job.samples)?;
            let text = "a uniformly distributed record within the limits (global accuracy)";
            (uniform(&layout, job.seed), text.into())
        }
    })
}

/// Outputs with bands and their safety report.
fn judged(
    job: &Job,
    inputs: &Inputs,
    margins: &[Option<MarginUsed>],
    problem: &DesignProblem,
    found: &DesignOutcome,
) -> (Curves, Vec<SafetyLine>) {
    let units: Vec<Quantity> = inputs.models.iter().map(|m| quantity(&m.name, &m.unit)).collect();
    let outputs = found.safety.iter().map(|s| s.predicted.clone()).collect();
    let trimmed = problem.convention == dynocal_design::problem::Convention::Trim;
    let first = if trimmed { problem.max_lag().max(problem.start) } else { 0 };
    judge::safety(&inputs.models, margins, &units, &found.u, outputs, first, job.sample_time_s)
}

/// Whether the search kept the margins that it was given: only then does a band that passes a limit say that they are too
/// small. A record that passes them says that none was found, and a wider margin would make that worse.
fn met_its_margins(found: &DesignOutcome) -> bool {
    let kept = found.safety.iter().filter_map(|s| s.worst).all(|w| w.distance >= 0.0);
    kept && !matches!(found.status, Status::Interrupted | Status::Infeasible)
}

fn criteria(
    problem: &DesignProblem,
    inputs: &Inputs,
    u: &[f64],
) -> Result<Vec<CriterionLine>, DesignJobError> {
    let mut out = Vec::new();
    for (term, m) in problem.terms.iter().zip(&inputs.models) {
        let Some(NamedCriterion { name, .. }) = &m.criterion else { continue };
        let one = DesignProblem { terms: vec![Term { weight: 1.0, ..*term }], ..problem.clone() };
        let value = Evaluator::new(&one)?.value(u);
        out.push(CriterionLine {
            model: m.name.clone(),
            criterion: name.clone(),
            weight: term.weight,
            value,
        });
    }
    Ok(out)
}

fn warnings(
    found: &DesignOutcome,
    safety: &[SafetyLine],
    information: &[InformationLine],
    inputs: &Inputs,
) -> Vec<String> {
    let mut out = Vec::new();
    for s in safety {
        let (name, unit) = (&s.output.name, UnitAfter(&s.output.unit));
        let (Some(prediction), Some(of_band)) = (s.least_distance, s.least_distance_of_band) else {
            continue;
        };
        let LeastDistance { distance, at_s: at } = prediction;
        let LeastDistance { distance: band, at_s: when } = of_band;
        if distance < 0.0 {
            out.push(format!(
                "the prediction of `{name}` passes a limit by {:.4}{unit} at {at:.2} s: no record that keeps all limits \
                 was found",
                -distance
            ));
        } else if band < 0.0 {
            out.push(format!(
                "the band of `{name}` passes a limit by {:.4}{unit} at {when:.2} s: the stated rate does not hold there",
                -band
            ));
        }
        match s.margin.map(|m| m.basis) {
            Some(MarginBasis::Range) => out.push(format!(
                "nothing is known about the error of `{name}` on unseen records: its margin is a share of the range (give \
                 held_out or margin)"
            )),
            Some(MarginBasis::FewBlocks) => out.push(format!(
                "the margin of `{name}` stands on {} held-out blocks, too few for a quantile at its rate",
                s.margin.map_or(0, |m| m.blocks)
            )),
            _ => {}
        }
        if let Some(Outside { worst, share }) = s.outside.filter(|o| o.share > 0.05) {
            out.push(format!(
                "{:.0} % of the plan lie outside of what the model of `{name}` was identified on (up to {worst:.2} of its \
                 boundary): there the band is a guess",
                100.0 * share
            ));
        }
    }
    out.extend(inputs.models.iter().filter_map(|m| m.note.clone()));
    for i in information.iter().filter(|i| i.rank < i.parameters) {
        out.push(format!("the record sees {} of {} parameters of `{}`", i.rank, i.parameters, i.model));
    }
    for (k, c) in inputs.channels.iter().enumerate() {
        let used = |m: &Loaded| m.model.window().iter().any(|w| w.0 == k);
        if !inputs.models.iter().any(used) {
            out.push(format!("no model uses the channel `{}`: what it does is arbitrary", c.name));
        }
    }
    match found.status {
        Status::Interrupted => out.push("interrupted: the best design so far".into()),
        Status::Infeasible if out.is_empty() => {
            out.push("no record that keeps all limits was found within the budget".into());
        }
        _ => {}
    }
    out
}

fn write(job: &Job, designed: &Designed, curves: &Curves, folder: &Path) -> Result<(), DesignJobError> {
    let m = designed.channels.len();
    let channel = |(i, q): (usize, &Quantity)| Channel {
        name: q.name.clone(),
        unit: q.unit.clone(),
        role: Role::Input,
        values: curves.u.iter().skip(i).step_by(m).copied().collect(),
    };
    let data = Dataset {
        name: job.name.clone(),
        sample_time_s: job.sample_time_s,
        channels: designed.channels.iter().enumerate().map(channel).collect(),
        init_samples: 0,
        origin: format!("design with seed {}", job.seed),
    };
    csv_io::write_dataset(&folder.join("design.csv"), &data)?;
    super::plan::write(job, designed, &data, folder)?;
    let time: Vec<f64> = (0..job.samples).map(|t| t as f64 * job.sample_time_s).collect();
    // Samples that only initialise have no prediction and stay out.
    let first = (0..job.samples)
        .find(|t| curves.outputs.iter().all(|o| o.predicted[*t].is_finite()))
        .unwrap_or(job.samples);
    let mut columns: Vec<(String, String, Vec<f64>)> =
        vec![("time".into(), "s".into(), time[first..].to_vec())];
    for (line, OutputCurve { predicted: y, half_width: half }) in designed.safety.iter().zip(&curves.outputs)
    {
        let (name, unit) = (&line.output.name, &line.output.unit);
        columns.push((name.clone(), unit.clone(), y[first..].to_vec()));
        if line.limits.is_some() {
            columns.push((format!("{name}_band"), unit.clone(), half[first..].to_vec()));
        }
    }
    let columns: Vec<(&str, &str, &[f64])> = columns.iter().map(|c| (&c.0[..], &c.1[..], &c.2[..])).collect();
    csv_io::write_columns(&folder.join("predicted.csv"), &columns)?;
    Ok(())
}
