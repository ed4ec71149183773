//! Models of the outputs of a campaign, by the job `identify`: a spec for every output and candidate, written beside its
//! result, so that `dynocal identify` can repeat each.

use super::chain::with_read;
use super::context::Context;
use super::error::ChainError;
use super::given;
use super::model_spec::{Candidates, candidates, refit, spec_text};
use crate::identify::error::IdentifyError;
use crate::identify::finding::{Finding, Grade, Topic};
use crate::identify::job::work;
use crate::identify::result::Identified;
use crate::identify::spec::{self, Overrides};
use dynocal_files::{atomic, json};
use dynocal_ident::data::Dataset;
use dynocal_ident::stored::{Computed, MODEL_SCHEMA, MODEL_VERSION, StoredModel};
use dynocal_ident::validate::{Kind, Reference, Seen, score_values};
use dynocal_numerics::status::Status;
use dynocal_numerics::watch::Watch;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Free-run fit of one model on one record, in the user's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FreeRunScore {
    /// Record.
    pub record: String,
    /// Identification or unseen data.
    pub data: Seen,
    /// Whether the record chose between the candidates: then it is not unseen, whatever `data` says of the parameters.
    pub chooses: bool,
    /// Root mean square error in the output's unit; none when the free run diverged.
    pub rmse: Option<f64>,
    /// 95th percentile of |error|.
    pub p95: Option<f64>,
    /// R2 of eq. 2.48.
    pub r2: Option<f64>,
}

/// One candidate model with its free-run scores.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// Name, e.g. `torque-1, prune and sem`.
    pub name: String,
    /// The model.
    pub model: StoredModel,
    /// How the estimator ended; converged for a model from a file.
    pub status: Status,
    /// Cost evaluations.
    pub evaluations: usize,
    /// Scores on every record.
    pub scores: Vec<FreeRunScore>,
    /// Mean R2 over the records that choose; none when one diverged.
    pub choosing_r2: Option<f64>,
    /// Mean R2 over the unseen records; none when one diverged or there is none.
    pub unseen_r2: Option<f64>,
    /// Share of free runs on random inputs that left the range of the output; 0 where none was tried.
    #[serde(default)]
    pub unstable_share: f64,
    /// Whether it was there before the records of this step, which made its successor worse.
    #[serde(default)]
    pub earlier: bool,
    /// Warnings of the job `identify`.
    pub warnings: Vec<String>,
}

impl Candidate {
    /// Takes scores over, with the means that are made of them.
    fn take(&mut self, scores: Vec<FreeRunScore>) {
        self.choosing_r2 = mean_r2(&scores, |s| s.chooses);
        self.unseen_r2 = mean_r2(&scores, |s| s.data == Seen::Unseen && !s.chooses);
        self.scores = scores;
    }
}

/// All candidates of one output; the chosen one goes on.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputModels {
    /// Output.
    pub output: String,
    /// Unit.
    pub unit: String,
    /// Candidates.
    pub candidates: Vec<Candidate>,
    /// Index of the candidate with the best free run on the records that choose; one that is unstable on a part of random
    /// inputs only where all are.
    pub chosen: usize,
}

impl OutputModels {
    /// The candidate that goes on.
    pub fn best(&self) -> &Candidate {
        &self.candidates[self.chosen]
    }

    /// The candidate of most parameters that ran through all records and is nowhere unstable; the chosen one where there is none.
    pub fn richest(&self) -> &Candidate {
        let sound = |c: &&Candidate| c.unstable_share == 0.0 && c.scores.iter().all(|s| s.rmse.is_some());
        self.candidates.iter().filter(sound).max_by_key(|c| c.model.parameters.len()).unwrap_or(self.best())
    }
}

/// Models of one step, in the order of the outputs.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelsResult {
    /// By output.
    pub outputs: Vec<OutputModels>,
}

impl ModelsResult {
    /// The chosen models.
    pub fn chosen(&self) -> Vec<&StoredModel> {
        self.outputs.iter().map(|o| &o.best().model).collect()
    }
}

/// Records of an identification: files that estimate, and measured records that choose and judge.
pub struct ModelData<'a> {
    /// Estimation records with the files they stand in.
    pub identification: &'a [(Dataset, PathBuf)],
    /// Validation records.
    pub validation: &'a [Dataset],
}

impl ModelData<'_> {
    /// Number of validation records that choose between candidates.
    fn choosing(&self) -> usize {
        usize::from(self.validation.len() > 1)
    }
}

/// Identifies all outputs in `folder`.
///
/// # Errors
/// [`ChainError`].
pub fn identify_all(ctx: &Context, folder: &Path, data: &ModelData) -> Result<ModelsResult, ChainError> {
    each_output(ctx, data, |output, data| {
        if let Some(file) = ctx.spec.identify.files.get(output) {
            let model = given::model(ctx, output, file)?;
            return output_models(ctx, output, vec![stored(ctx, file, model, data)?]);
        }
        let found = candidates(ctx, output, data.identification)?;
        run_candidates(ctx, folder, output, &found, data)
    })
}

/// Estimates the chosen structures again on more records.
///
/// # Errors
/// [`ChainError`].
pub fn identify_again(
    ctx: &Context,
    folder: &Path,
    previous: &ModelsResult,
    data: &ModelData,
) -> Result<ModelsResult, ChainError> {
    each_output(ctx, data, |output, data| {
        let Some(old) = previous.outputs.iter().find(|o| o.output == output) else {
            return Err(ChainError::Identify { what: output.into(), reason: "no earlier model".into() });
        };
        match refit(ctx, &old.best().model) {
            Some(again) => run_candidates(ctx, folder, output, &again, data),
            // Another kind of model: the candidates as they were.
            None => run_candidates(ctx, folder, output, &candidates(ctx, output, data.identification)?, data),
        }
    })
}

/// R2 by which a model of more records may be worse than its predecessor on the records that choose: scatter of one record.
pub const WORSE: f64 = 0.01;

/// The models of more records, but for those that are clearly worse than their predecessors: there these go on.
///
/// # Errors
/// [`ChainError`].
pub fn with_predecessors(
    ctx: &Context,
    mut models: ModelsResult,
    before: &ModelsResult,
    data: &ModelData,
) -> Result<ModelsResult, ChainError> {
    // Those that others read come first among the models.
    let mut said: Option<Said> = None;
    for k in 0..models.outputs.len() {
        if (1..=ctx.channels.read.len()).contains(&k) {
            let then = Said::of(ctx, &models.outputs[..k], data)?;
            // New models were scored on what the new ones of these say, and shall be on those that go on.
            if models.outputs[..k].iter().any(|o| o.best().earlier) {
                rescore(ctx, &mut models.outputs[k..], &then.data())?;
            }
            said = Some(then);
        }
        let o = &mut models.outputs[k];
        let Some(old) = before.outputs.iter().find(|b| b.output == o.output) else { continue };
        // Scored on what its successor was scored on.
        let scores = match &said {
            Some(said) => scores(ctx, &old.best().model, &said.data())?,
            None => scores(ctx, &old.best().model, data)?,
        };
        let mut old = old.best().clone();
        old.take(scores);
        old.earlier = true;
        old.name = format!("earlier: {}", old.name.trim_start_matches("earlier: "));
        let new = o.best();
        if clearly_worse((new.choosing_r2, new.unstable_share), (old.choosing_r2, old.unstable_share)) {
            o.chosen = o.candidates.len();
            o.candidates.push(old);
        }
    }
    Ok(models)
}

/// Scores of all candidates on other records, and the choice by them.
fn rescore(ctx: &Context, outputs: &mut [OutputModels], data: &ModelData) -> Result<(), ChainError> {
    for o in outputs {
        for c in &mut o.candidates {
            c.take(scores(ctx, &c.model, data)?);
        }
        let found: Vec<_> = o.candidates.iter().map(|c| (c.choosing_r2, c.unstable_share)).collect();
        o.chosen = choose(&found);
    }
    Ok(())
}

/// Score and unstable share of a model against those of its predecessor.
fn clearly_worse(new: (Option<f64>, f64), old: (Option<f64>, f64)) -> bool {
    let Some(before) = old.0 else { return false };
    let score = new.0.unwrap_or(f64::NEG_INFINITY);
    score < before - WORSE || (old.1 == 0.0 && new.1 > 0.0 && score < before + WORSE)
}

/// Outputs that others read first: what reads them is estimated from what was measured, and scored on what they say.
fn each_output(
    ctx: &Context,
    data: &ModelData,
    job: impl Fn(&str, &ModelData) -> Result<OutputModels, ChainError> + Sync,
) -> Result<ModelsResult, ChainError> {
    let all = |outputs: Vec<String>, data: &ModelData| -> Result<Vec<OutputModels>, ChainError> {
        let found: Vec<Result<_, ChainError>> = outputs.par_iter().map(|o| job(o, data)).collect();
        found.into_iter().collect()
    };
    if ctx.channels.read.is_empty() {
        return Ok(ModelsResult { outputs: all(ctx.channels.outputs(), data)? });
    }
    let others = ctx.channels.outputs().into_iter().filter(|o| !ctx.channels.read.contains(o)).collect();
    let mut outputs = Vec::new();
    let mut said = Said::of(ctx, &outputs, data)?;
    for output in &ctx.channels.read {
        outputs.push(job(output, &said.data())?);
        said = Said::of(ctx, &outputs, data)?;
    }
    outputs.extend(all(others, &said.data())?);
    Ok(ModelsResult { outputs })
}

/// Records in which outputs that other models read are what their models say.
struct Said {
    identification: Vec<(Dataset, PathBuf)>,
    validation: Vec<Dataset>,
}

impl Said {
    fn of(ctx: &Context, outputs: &[OutputModels], data: &ModelData) -> Result<Self, ChainError> {
        let models: Vec<&StoredModel> = outputs.iter().map(|o| &o.best().model).collect();
        let one = |d: &Dataset| with_read(&ctx.channels, &models, d);
        let files = data.identification.iter();
        Ok(Self {
            identification: files
                .map(|(d, f)| Ok((one(d)?, f.clone())))
                .collect::<Result<_, ChainError>>()?,
            validation: data.validation.iter().map(one).collect::<Result<_, _>>()?,
        })
    }

    fn data(&self) -> ModelData<'_> {
        ModelData { identification: &self.identification, validation: &self.validation }
    }
}

fn run_candidates(
    ctx: &Context,
    folder: &Path,
    output: &str,
    candidates: &Candidates,
    data: &ModelData,
) -> Result<OutputModels, ChainError> {
    // Outputs differ in their number of candidates, so that these are shared out as well.
    let found: Vec<Result<Candidate, ChainError>> = candidates
        .tables
        .par_iter()
        .enumerate()
        .map(|(k, c)| {
            ctx.check_interrupt()?;
            let name = format!("{output}-{}", k + 1);
            let text = spec_text(ctx, (output, &name), c, &candidates.derive, data.identification, folder)?;
            let path = folder.join(format!("{name}.toml"));
            atomic::write(&path, text.as_bytes())?;
            candidate(ctx, &path, &name, &c.what, data)
        })
        .collect();
    output_models(ctx, output, found.into_iter().collect::<Result<_, _>>()?)
}

fn output_models(
    ctx: &Context,
    output: &str,
    candidates: Vec<Candidate>,
) -> Result<OutputModels, ChainError> {
    let scores: Vec<(Option<f64>, f64)> =
        candidates.iter().map(|c| (c.choosing_r2, c.unstable_share)).collect();
    let chosen = choose(&scores);
    let unit = ctx.spec.problem.unit(output).unwrap_or("-").into();
    Ok(OutputModels { output: output.into(), unit, candidates, chosen })
}

/// The candidate with the best score (none: diverged) among those that are nowhere unstable, else among all. An optimum goes where
/// a model is wrong, so one that runs away somewhere is worse than its score on measured records.
fn choose(scores: &[(Option<f64>, f64)]) -> usize {
    let any_stable = scores.iter().any(|(score, unstable)| score.is_some() && *unstable == 0.0);
    let worth = |(score, unstable): &(Option<f64>, f64)| match any_stable && *unstable > 0.0 {
        true => f64::NEG_INFINITY,
        false => score.unwrap_or(f64::NEG_INFINITY),
    };
    let best = scores.iter().map(worth).fold(f64::NEG_INFINITY, f64::max);
    scores.iter().position(|s| worth(s) == best).unwrap_or(0)
}

/// One candidate: the job `identify` on the spec at `path`, in a folder beside it.
fn candidate(
    ctx: &Context,
    path: &Path,
    name: &str,
    what: &str,
    data: &ModelData,
) -> Result<Candidate, ChainError> {
    let fault = |e: &dyn std::fmt::Display| ChainError::Identify { what: name.into(), reason: e.to_string() };
    let overrides = Overrides { seed: Some(ctx.spec.seed), ..Overrides::default() };
    let job = spec::read(path, &overrides).map_err(|e| fault(&e))?;
    let dir = path.with_extension("");
    std::fs::create_dir_all(&dir).map_err(|e| fault(&e))?;
    let watch = Watch { interrupt: ctx.watch.interrupt, ..Watch::silent() };
    let found: Identified = work(&job, &dir, watch).map_err(|e| match e {
        IdentifyError::Interrupted => ChainError::Interrupted,
        e => fault(&e),
    })?;
    let modelled = found.models.first().ok_or_else(|| fault(&"no model came out"))?;
    // The job names its files as seen from a run folder of its own.
    let file = Path::new(&modelled.file).file_name().map_or_else(|| dir.clone(), |f| dir.join(f));
    let model: StoredModel = json::read_versioned(&file, MODEL_SCHEMA, MODEL_VERSION)?;
    let scores = scores(ctx, &model, data)?;
    Ok(Candidate {
        name: format!("{name}, {what}"),
        status: modelled.status.unwrap_or(Status::Converged),
        evaluations: modelled.evaluations.unwrap_or(0),
        choosing_r2: mean_r2(&scores, |s| s.chooses),
        unseen_r2: mean_r2(&scores, |s| s.data == Seen::Unseen && !s.chooses),
        unstable_share: modelled.after.stability.as_ref().map_or(0.0, |s| s.share_diverged),
        earlier: false,
        scores,
        model,
        // The campaign has unseen records of its own, scored above.
        warnings: found
            .findings
            .iter()
            .filter(|f| f.grade != Grade::Note && f.topic != Topic::NoTestData)
            .map(Finding::sentence)
            .collect(),
    })
}

/// A model that was identified elsewhere, scored on the records of this campaign.
fn stored(ctx: &Context, file: &Path, model: StoredModel, data: &ModelData) -> Result<Candidate, ChainError> {
    let scores = scores(ctx, &model, data)?;
    Ok(Candidate {
        name: format!("from {}", file.display()),
        status: Status::Converged,
        evaluations: 0,
        choosing_r2: mean_r2(&scores, |s| s.chooses),
        unseen_r2: mean_r2(&scores, |s| s.data == Seen::Unseen && !s.chooses),
        unstable_share: 0.0,
        earlier: false,
        scores,
        model,
        warnings: Vec::new(),
    })
}

fn mean_r2(scores: &[FreeRunScore], which: impl Fn(&FreeRunScore) -> bool) -> Option<f64> {
    let wanted: Vec<&FreeRunScore> = scores.iter().filter(|s| which(s)).collect();
    let sum: Option<f64> = wanted.iter().map(|s| s.r2).sum();
    sum.filter(|_| !wanted.is_empty()).map(|s| s / wanted.len() as f64)
}

/// Free runs over all records. Where no record chooses, the identification records do.
fn scores(ctx: &Context, model: &StoredModel, data: &ModelData) -> Result<Vec<FreeRunScore>, ChainError> {
    ctx.check_interrupt()?;
    let choosing = data.choosing();
    let seen = data.identification.iter().map(|(d, _)| (d, Seen::Identification, choosing == 0));
    let unseen = data.validation.iter().enumerate().map(|(k, d)| (d, Seen::Unseen, k < choosing));
    seen.chain(unseen).map(|(d, data, chooses)| free_run_score(model, d, data, chooses)).collect()
}

/// Free run of `model` on `record`, scored in the measured unit after the initialisation window.
fn free_run_score(
    model: &StoredModel,
    record: &Dataset,
    data: Seen,
    chooses: bool,
) -> Result<FreeRunScore, ChainError> {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    for run in model.simulate(record, None)? {
        let measured = run.measured.unwrap_or_default();
        y.extend_from_slice(&run.y[run.first.min(run.y.len())..]);
        z.extend_from_slice(&measured[run.first.min(measured.len())..]);
    }
    let score = score_values(&z, &y, Kind::FreeRun, data, Reference::Noisy);
    let finite = y.iter().all(|v| v.is_finite());
    let value = |v: f64| (finite && v.is_finite()).then_some(v);
    Ok(FreeRunScore {
        record: record.name.clone(),
        data,
        chooses,
        rmse: value(score.rmse),
        p95: value(score.error_95),
        r2: value(score.r2),
    })
}

/// Errors of the free runs of `model` on `record`, measured less modelled, after the initialisation window.
///
/// # Errors
/// [`ChainError`].
pub(super) fn errors(model: &StoredModel, record: &Dataset) -> Result<Vec<Vec<f64>>, ChainError> {
    let run = |run: Computed| {
        let measured = run.measured.unwrap_or_default();
        measured.iter().zip(&run.y).skip(run.first).map(|(z, y)| z - y).collect()
    };
    Ok(model.simulate(record, None)?.into_iter().map(run).collect())
}

/// Writes the chosen models as files of their own.
///
/// # Errors
/// [`ChainError::Files`].
pub fn save_models(folder: &Path, models: &ModelsResult) -> Result<(), ChainError> {
    for o in &models.outputs {
        let file = folder.join(format!("{}_model.json", o.output));
        json::write_versioned(&file, MODEL_SCHEMA, MODEL_VERSION, &o.best().model)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{choose, clearly_worse};

    #[test]
    fn a_predecessor_goes_on_only_where_more_records_made_it_clearly_worse() {
        assert!(clearly_worse((None, 0.0), (Some(0.8), 0.0)), "diverged");
        assert!(clearly_worse((Some(-622.0), 0.0), (Some(0.85), 0.0)));
        assert!(!clearly_worse((Some(0.845), 0.0), (Some(0.85), 0.0)), "scatter of one record");
        assert!(!clearly_worse((Some(0.2), 0.5), (None, 0.0)), "the predecessor diverged");
        assert!(clearly_worse((Some(0.851), 0.1), (Some(0.85), 0.0)), "unstable now");
        assert!(!clearly_worse((Some(0.95), 0.1), (Some(0.85), 0.0)), "unstable, and much better");
    }

    #[test]
    fn a_stable_candidate_goes_before_a_better_one_that_runs_away() {
        assert_eq!(choose(&[(Some(0.9), 0.0), (Some(0.95), 0.0)]), 1);
        assert_eq!(choose(&[(Some(0.9), 0.0), (Some(0.95), 0.3)]), 0);
        assert_eq!(
            choose(&[(Some(0.9), 0.3), (Some(0.95), 1.0)]),
            1,
            "where none is stable the score decides"
        );
        assert_eq!(choose(&[(None, 0.0), (Some(0.2), 0.3)]), 1, "a diverged one is no choice");
        assert_eq!(choose(&[(None, 0.0), (None, 0.0)]), 0);
    }
}
