//! The mean of several response models.
//!
//! ```text
//! mean = (1/K) sum_k m_k,   variance = (1/K) sum_k (v_k + (m_k - mean)^2)
//! ```
//!
//! The second is the variance of a response that is each of the K models with equal probability.
//! Source: C. M. Bishop, Pattern Recognition and Machine Learning (2006), section 14.2.

use dynocal_numerics::registry::{self, BuildError, Member, MemberDoc, ParamDoc};
use serde::{Deserialize, Serialize};

use super::{Ask, Learn, Learnt, LeftOut, Points, Prediction, Response, ResponseError, ResponseModel};

pub(super) const MEMBER: Member<dyn Learn> = Member {
    doc: MemberDoc {
        name: "mean_of",
        what: "mean of several response models",
        params: &[ParamDoc {
            name: "models",
            unit: "-",
            default: "",
            what: "list of tables, each with `kind` and the keys of that kind",
        }],
    },
    build: |keys| Ok(Box::new(MeanOf::parse(keys)?)),
};

/// Several kinds that are learnt side by side.
pub struct MeanOf {
    /// Them.
    pub members: Vec<Box<dyn Learn>>,
}

impl MeanOf {
    fn parse(keys: &toml::Table) -> Result<Self, BuildError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Keys {
            models: Vec<toml::Table>,
        }
        let keys: Keys = registry::keys("mean_of", keys)?;
        let members = members("mean_of", keys.models)?.into_iter().map(|(_, kind)| kind).collect();
        Ok(Self { members })
    }
}

/// Kinds with their names for reports.
pub(super) type Members = Vec<(String, Box<dyn Learn>)>;

/// A list of tables as kinds, each with a name for reports: that of the kind with its keys.
pub(super) fn members(of: &str, tables: Vec<toml::Table>) -> Result<Members, BuildError> {
    let wrong = |message: String| BuildError::Keys { member: of.into(), message };
    if tables.is_empty() {
        return Err(wrong("`models` is empty, expected one or more tables".into()));
    }
    let mut out: Members = Vec::with_capacity(tables.len());
    for mut table in tables {
        let Some(toml::Value::String(kind)) = table.remove("kind") else {
            return Err(wrong("each table of `models` needs a `kind`".into()));
        };
        let built = super::learner(&kind, &table)?;
        let own: Vec<String> = table.iter().map(|(k, v)| format!("{k} = {v}")).collect();
        let name = if own.is_empty() { kind } else { format!("{kind} ({})", own.join(", ")) };
        out.push((name, built));
    }
    Ok(out)
}

impl Learn for MeanOf {
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
        let learnt = self.members.iter().map(|m| m.learn(points, interrupt)).collect::<Result<_, _>>()?;
        Ok(together(learnt))
    }
}

/// Models that were learnt from the same points as one, their mean. A single one stays what it is.
///
/// # Panics
/// Where there is none, or they were learnt from different numbers of points.
pub fn together(mut learnt: Vec<Learnt>) -> Learnt {
    if learnt.len() == 1 {
        return learnt.remove(0);
    }
    let (n, count) = (learnt[0].left_out.residuals.len(), learnt.len() as f64);
    let mut left_out = LeftOut { residuals: vec![0.0; n], variance: vec![0.0; n] };
    for i in 0..n {
        let mean = learnt.iter().map(|l| l.left_out.residuals[i]).sum::<f64>() / count;
        let spread = |l: &Learnt| l.left_out.variance[i] + (l.left_out.residuals[i] - mean).powi(2);
        left_out.residuals[i] = mean;
        left_out.variance[i] = learnt.iter().map(spread).sum::<f64>() / count;
    }
    let mut notes: Vec<String> = Vec::new();
    for note in learnt.iter().flat_map(|l| &l.notes) {
        if !notes.contains(note) {
            notes.push(note.clone());
        }
    }
    let models = learnt.into_iter().map(|l| l.model).collect();
    Learnt::new(ResponseModel::MeanOf(MeanOfModel { models }), left_out, notes)
}

/// Several models of one output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanOfModel {
    /// Them; at least one.
    pub models: Vec<ResponseModel>,
}

impl Response for MeanOfModel {
    fn dim(&self) -> usize {
        self.models.first().map_or(0, Response::dim)
    }

    fn predict(&self, x: &[f64], ask: Ask, out: &mut Prediction) {
        let (d, count) = (x.len(), self.models.len() as f64);
        out.parts.resize_with(self.models.len(), Prediction::default);
        let mut parts = std::mem::take(&mut out.parts);
        for (model, part) in self.models.iter().zip(&mut parts) {
            part.fit(d);
            part.moving = out.moving;
            model.predict(x, ask, part);
        }
        let average = |of: &dyn Fn(&Prediction) -> f64| parts.iter().map(of).sum::<f64>() / count;
        out.mean = average(&|p| p.mean);
        let mean = out.mean;
        if ask >= Ask::Variance {
            out.variance = average(&|p| p.variance + (p.mean - mean).powi(2));
            out.noise = average(&|p| p.noise);
        }
        if ask >= Ask::Gradient {
            for j in 0..d {
                out.gradient[j] = average(&|p| p.gradient[j]);
                // The term with the gradient of the mean has the factor sum (m_k - mean) = 0.
                out.variance_gradient[j] =
                    average(&|p| p.variance_gradient[j] + 2.0 * (p.mean - mean) * p.gradient[j]);
            }
        }
        if ask == Ask::Hessian {
            for at in 0..d * d {
                let (j, l) = (at / d, at % d);
                out.hessian[at] = average(&|p| p.hessian[at]);
                let cross = average(&|p| {
                    p.variance_hessian[at]
                        + 2.0 * (p.mean - mean) * p.hessian[at]
                        + 2.0 * p.gradient[j] * p.gradient[l]
                });
                out.variance_hessian[at] = cross - 2.0 * out.gradient[j] * out.gradient[l];
            }
        }
        out.parts = parts;
    }

    fn describe(&self) -> String {
        let names: Vec<String> = self.models.iter().map(Response::describe).collect();
        format!("mean of {}: {}", names.len(), names.join("; "))
    }
}
