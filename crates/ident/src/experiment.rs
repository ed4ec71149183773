//! Datasets in the shape that models take: inputs row-major, output, first scored sample.

use crate::data::{DataError, Dataset};

/// One experiment for one model output.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// Name of the record.
    pub name: String,
    /// Inputs, N x m row-major; NaN where a sample is missing (see [`experiments_marked`]).
    pub u: Vec<f64>,
    /// Measured output, N; NaN where a sample is missing.
    pub y: Vec<f64>,
    /// Leading samples that only initialise and enter no score (at least; a model with longer lags takes more).
    pub init_samples: usize,
    /// Weights of the squared errors (N), or empty for all one.
    pub weights: Vec<f64>,
}

impl Experiment {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.y.is_empty()
    }

    /// The same record with `rows` samples of zero inputs and output before it, which then initialise: every
    /// sample of the record is scored and all delays start at rest.
    pub fn at_rest(&self, rows: usize) -> Self {
        let pad = |v: &[f64], n: usize| -> Vec<f64> {
            std::iter::repeat_n(0.0, n).chain(v.iter().copied()).collect()
        };
        let m = self.u.len().checked_div(self.y.len()).unwrap_or(0);
        let weights = if self.weights.is_empty() { Vec::new() } else { pad(&self.weights, rows) };
        Self {
            name: self.name.clone(),
            u: pad(&self.u, rows * m),
            y: pad(&self.y, rows),
            init_samples: rows,
            weights,
        }
    }

    /// Samples `from..to` as a record of their own, the first `init_samples` of them not scored.
    pub(crate) fn part(&self, from: usize, to: usize, init_samples: usize) -> Self {
        let m = self.u.len().checked_div(self.len()).unwrap_or(0);
        // Weights of a wrong length are left as they are, for the check of the data to name.
        let right = self.weights.len() == self.len();
        Self {
            name: self.name.clone(),
            u: self.u[from * m..to * m].to_vec(),
            y: self.y[from..to].to_vec(),
            init_samples,
            weights: if right { self.weights[from..to].to_vec() } else { self.weights.clone() },
        }
    }

    /// Weight of sample t.
    pub(crate) fn weight(&self, t: usize) -> f64 {
        self.weights.get(t).copied().unwrap_or(1.0)
    }
}

/// Takes `inputs` and `output` out of each dataset and checks them: lengths, finite samples, one common sample
/// time, and every input moving in at least one record.
///
/// # Errors
/// The first [`DataError`] found.
pub fn experiments(
    datasets: &[Dataset],
    inputs: &[String],
    output: &str,
) -> Result<Vec<Experiment>, DataError> {
    datasets.iter().try_for_each(Dataset::check)?;
    collect(datasets, inputs, output)
}

/// The same for records with missing samples: they stay NaN in [`Experiment::u`] and [`Experiment::y`], for an
/// estimator that deals with them. Channels that are not asked for may hold anything.
///
/// # Errors
/// The first [`DataError`] found, a record in which one of the channels has no sample included.
pub fn experiments_marked(
    datasets: &[Dataset],
    inputs: &[String],
    output: &str,
) -> Result<Vec<Experiment>, DataError> {
    for d in datasets {
        let wanted = inputs.iter().map(String::as_str).chain([output]);
        let channels = wanted.map(|name| d.channel(name).cloned()).collect::<Result<Vec<_>, _>>()?;
        let seen = Dataset { channels, origin: String::new(), name: d.name.clone(), ..*d };
        seen.check_marked()?;
    }
    collect(datasets, inputs, output)
}

fn collect(datasets: &[Dataset], inputs: &[String], output: &str) -> Result<Vec<Experiment>, DataError> {
    let mut out = Vec::with_capacity(datasets.len());
    for d in datasets {
        let expected = datasets[0].sample_time_s;
        // Time stamps rarely hold the same last digit in two files.
        let alike = (d.sample_time_s - expected).abs() <= 1e-6 * expected;
        if !alike {
            return Err(DataError::SampleTime {
                record: d.name.clone(),
                found: d.sample_time_s,
                expected: if expected.is_nan() {
                    "uniform stamps: a step `resample` in the preparation makes them".into()
                } else {
                    format!("{expected} s as in {}", datasets[0].name)
                },
            });
        }
        out.push(Experiment {
            name: d.name.clone(),
            u: d.matrix(inputs)?,
            y: d.values(output)?.to_vec(),
            init_samples: d.init_samples,
            weights: Vec::new(),
        });
    }
    for (i, channel) in inputs.iter().enumerate() {
        let values =
            || out.iter().flat_map(|e| e.u.iter().skip(i).step_by(inputs.len())).filter(|v| !v.is_nan());
        if let Some(&value) = values().next()
            && values().all(|v| *v == value)
        {
            let record = out.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
            let samples = values().count();
            return Err(DataError::ConstantInput { record, channel: channel.clone(), value, samples });
        }
    }
    Ok(out)
}
