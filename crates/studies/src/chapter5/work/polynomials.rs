//! The polynomial engine models of section 5.5 and of eq. (7.8), by prediction error and by simulation error.

use dynocal_ident::data::Dataset;
use dynocal_ident::estimate::ols::Ols;
use dynocal_ident::estimate::sem::Sem;
use dynocal_ident::estimate::{Estimator, Fit};
use dynocal_ident::experiment::{Experiment, experiments};
use dynocal_ident::model::poly::PolyNarx;
use dynocal_ident::validate::{Kind, output};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Chapter5Error, Fitness};

/// One estimator on one structure.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Estimated {
    /// Parameters.
    pub theta: Vec<f64>,
    /// One-step error on the identification record.
    pub one_step: Fitness,
    /// Free-run error on the identification record.
    pub free_run: Fitness,
    /// Free-run error on each unseen record.
    pub unseen: Vec<Fitness>,
    /// Free run over the identification record.
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub trace: Vec<f64>,
    /// Free run over the first unseen record.
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub unseen_trace: Vec<f64>,
    /// What the estimator warned of.
    pub warnings: Vec<String>,
}

impl Estimated {
    /// Mean over the unseen records.
    pub fn mean_unseen(&self) -> Fitness {
        Fitness::mean(&self.unseen)
    }
}

/// Both estimators with each record in turn as the identification record and all others unseen: one record of 60 s
/// decides little between them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Crossed {
    /// Mean free-run MSE on the unseen records by prediction error, one per identification record.
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub pem: Vec<f64>,
    /// The same by simulation error.
    #[serde(deserialize_with = "dynocal_ident::nullable::numbers")]
    pub sem: Vec<f64>,
}

impl Crossed {
    /// Mean of simulation error over mean of prediction error.
    pub fn ratio(&self) -> f64 {
        self.sem.iter().sum::<f64>() / self.pem.iter().sum::<f64>()
    }

    /// Identification records on which simulation error gave the better model.
    pub fn wins(&self) -> usize {
        self.sem.iter().zip(&self.pem).filter(|(s, p)| s < p).count()
    }
}

/// Crosses `records`, in parallel.
///
/// # Errors
/// As [`both`].
pub fn crossed(
    model: &PolyNarx,
    records: &[Dataset],
    interrupt: &(dyn Fn() -> bool + Sync),
) -> Result<Crossed, Chapter5Error> {
    let data = experiments(records, model.inputs(), model.output())?;
    let one = |k: usize| -> Result<(f64, f64), Chapter5Error> {
        if interrupt() {
            return Err(Chapter5Error::Interrupted);
        }
        let mut others = data.clone();
        let identification = [others.remove(k)];
        let pem = Ols::default().estimate(model, &identification, None, &|| interrupt())?;
        let sem = Sem::default().estimate(model, &identification, None, &|| interrupt())?;
        let of = |theta: &[f64]| Fitness::mean_over(model, theta, &others, Kind::FreeRun).mse;
        Ok((of(&pem.theta), of(&sem.theta)))
    };
    let found: Vec<(f64, f64)> =
        (0..data.len()).into_par_iter().map(one).collect::<Vec<_>>().into_iter().collect::<Result<_, _>>()?;
    let (pem, sem) = found.into_iter().unzip();
    Ok(Crossed { pem, sem })
}

/// Both estimators on one structure.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Both {
    /// Output.
    pub output: String,
    /// Regressors in the order of the parameters.
    pub regressors: Vec<String>,
    /// Least squares on the one-step error.
    pub pem: Estimated,
    /// Simulation error, from it.
    pub sem: Estimated,
    /// Measured output of the identification record.
    pub measured: Vec<f64>,
    /// Measured output of the first unseen record.
    pub unseen_measured: Vec<f64>,
}

/// Estimates `model` on `identification` and scores it there and on `unseen`.
///
/// # Errors
/// [`Chapter5Error::Data`], [`Chapter5Error::Estimate`].
pub fn both(
    model: &PolyNarx,
    identification: &Dataset,
    unseen: &[Dataset],
    interrupt: &dyn Fn() -> bool,
) -> Result<Both, Chapter5Error> {
    let of = |d: &[Dataset]| experiments(d, model.inputs(), model.output());
    let (data, unseen) = (of(std::slice::from_ref(identification))?, of(unseen)?);
    let pem = Ols::default().estimate(model, &data, None, interrupt)?;
    let sem = Sem::default().estimate(model, &data, None, interrupt)?;
    Ok(Both {
        output: model.output().into(),
        regressors: model.regressor_texts(),
        pem: estimated(model, pem, &data[0], &unseen),
        sem: estimated(model, sem, &data[0], &unseen),
        unseen_measured: unseen.first().map(|e| e.y.clone()).unwrap_or_default(),
        measured: data[0].y.clone(),
    })
}

fn estimated(model: &PolyNarx, fit: Fit, data: &Experiment, unseen: &[Experiment]) -> Estimated {
    let theta = fit.theta;
    let free_run = |e: &Experiment| output(model, &theta, e, Kind::FreeRun);
    Estimated {
        one_step: Fitness::of(model, &theta, data, Kind::OneStep),
        free_run: Fitness::of(model, &theta, data, Kind::FreeRun),
        unseen: unseen.iter().map(|e| Fitness::of(model, &theta, e, Kind::FreeRun)).collect(),
        trace: free_run(data),
        unseen_trace: unseen.first().map(free_run).unwrap_or_default(),
        warnings: fit.warnings,
        theta,
    }
}

/// Torque structure (5.13); inputs inj, spark, throttle.
///
/// # Errors
/// Never for the text of this file; the type is that of a structure.
pub fn torque_5_13() -> Result<PolyNarx, Chapter5Error> {
    let regressors = [
        "1",
        "inj(t-1)",
        "inj(t-2)",
        "inj(t-3)",
        "spark(t-1)",
        "throttle(t-1)",
        "throttle(t-2)",
        "torque(t-1)",
    ];
    Ok(PolyNarx::parse(&OPEN_LOOP_INPUTS, "torque", &regressors)?)
}

/// Lambda structure (5.14), same inputs.
///
/// # Errors
/// As [`torque_5_13`].
pub fn lambda_5_14() -> Result<PolyNarx, Chapter5Error> {
    let regressors = [
        "1",
        "inj(t-1)",
        "inj(t-2)",
        "spark(t-1)",
        "throttle(t-3)",
        "lambda(t-1)",
        "spark(t-1)*lambda(t-1)",
        "inj(t-1)*throttle(t-1)",
    ];
    Ok(PolyNarx::parse(&OPEN_LOOP_INPUTS, "lambda", &regressors)?)
}

/// Speed is constant in section 5.5 and no input.
const OPEN_LOOP_INPUTS: [&str; 3] = ["inj", "spark", "throttle"];
