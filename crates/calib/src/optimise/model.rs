//! A modelled output as the optimisation takes it: any structure behind the model contract, with the way from named
//! channels to its inputs and from its output back to the user's.
//!
//! ```text
//! model input  = (monomial of channels - offset) / scale
//! model output = (factor y^power - offset) / scale           y the user's output
//! ```

use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::derived::Monomial;
use dynocal_ident::model::Model;
use dynocal_ident::validate::boundary::BoundaryModel;

/// A model input from named channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Monomial of measured channels.
    pub monomial: Monomial,
    /// Subtracted.
    pub offset: f64,
    /// Divided by.
    pub scale: f64,
}

impl Source {
    /// A channel as it is.
    pub fn plain(channel: &str) -> Self {
        let monomial = Monomial { factor: 1.0, powers: vec![(channel.into(), 1)] };
        Self { monomial, offset: 0.0, scale: 1.0 }
    }

    /// Its value where `of` says what the channels are.
    pub fn value(&self, of: impl Fn(&str) -> f64) -> f64 {
        (self.monomial.value(of) - self.offset) / self.scale
    }
}

/// The way from the user's output to the model's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputWay {
    /// Factor.
    pub factor: f64,
    /// Power, not 0.
    pub power: i32,
    /// Subtracted.
    pub offset: f64,
    /// Divided by.
    pub scale: f64,
}

impl OutputWay {
    /// The output itself.
    pub const PLAIN: Self = Self { factor: 1.0, power: 1, offset: 0.0, scale: 1.0 };

    /// The model's output for the user's.
    pub fn to_model(&self, y: f64) -> f64 {
        (self.factor * y.powi(self.power) - self.offset) / self.scale
    }

    /// Derivative of the model's output with respect to the user's.
    pub fn slope(&self, y: f64) -> f64 {
        self.factor * f64::from(self.power) * y.powi(self.power - 1) / self.scale
    }

    /// The user's output for the model's.
    pub fn to_user(&self, y: f64) -> f64 {
        let v = (y * self.scale + self.offset) / self.factor;
        match self.power {
            1 => v,
            -1 => 1.0 / v,
            p => v.signum() * v.abs().powf(1.0 / f64::from(p)),
        }
    }
}

/// A model of one output.
#[derive(Clone)]
pub struct OutputModel<'a> {
    /// Output in the user's words.
    pub output: String,
    /// Structure.
    pub model: &'a dyn Model,
    /// Parameters.
    pub theta: &'a [f64],
    /// Where each model input comes from.
    pub inputs: Vec<Source>,
    /// From the user's output to the model's.
    pub way: OutputWay,
    /// What it was identified on, in the coordinates of `model`; read where a guard is asked for.
    pub boundary: Option<&'a BoundaryModel>,
    /// Draws of its parameters; read where a robust optimum is asked for.
    pub draws: Vec<Vec<f64>>,
}

impl<'a> OutputModel<'a> {
    /// A model whose inputs and output are channels as they are.
    pub fn plain(output: &str, model: &'a dyn Model, theta: &'a [f64], inputs: &[&str]) -> Self {
        let inputs = inputs.iter().map(|name| Source::plain(name)).collect();
        Self {
            output: output.into(),
            model,
            theta,
            inputs,
            way: OutputWay::PLAIN,
            boundary: None,
            draws: Vec::new(),
        }
    }

    /// Channels that it reads.
    pub fn channels(&self) -> impl Iterator<Item = &str> {
        self.inputs.iter().flat_map(|s| s.monomial.powers.iter().map(|(name, _)| name.as_str()))
    }

    /// Its inputs over a record, N x m row-major.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn rows(&self, record: &Dataset) -> Result<Vec<f64>, DataError> {
        let mut rows = vec![0.0; record.len() * self.inputs.len()];
        for (i, source) in self.inputs.iter().enumerate() {
            let powers = source
                .monomial
                .powers
                .iter()
                .map(|(name, p)| Ok((record.values(name)?, *p)))
                .collect::<Result<Vec<_>, DataError>>()?;
            for (t, row) in rows.chunks_exact_mut(self.inputs.len()).enumerate() {
                let v = powers.iter().fold(source.monomial.factor, |v, (x, p)| v * x[t].powi(*p));
                row[i] = (v - source.offset) / source.scale;
            }
        }
        Ok(rows)
    }
}
