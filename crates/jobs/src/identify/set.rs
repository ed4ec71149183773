//! Models of several outputs on one record: outputs that are regressors of each other run free together.
//!
//! ```text
//! y_k(t) = f_k(u(t-i), y_1(t-j), .., y_K(t-j))        all past outputs are the models' own
//! ```

use dynocal_ident::data::{DataError, Dataset};
use dynocal_ident::experiment::Experiment;
use dynocal_ident::model::fitted::Fitted;
use dynocal_ident::model::{Model, Run};
use dynocal_ident::validate::Kind;

/// One model of the set.
#[derive(Clone, Debug)]
pub struct Member {
    /// Modelled channel.
    pub target: String,
    /// Driving channels, other targets included.
    pub inputs: Vec<String>,
    /// The model.
    pub model: Fitted,
}

/// Models that run together.
#[derive(Clone, Debug)]
pub struct Set {
    /// The models.
    pub members: Vec<Member>,
    /// For each member the (input, member) pairs of inputs that other members compute.
    coupled: Vec<Vec<(usize, usize)>>,
}

impl Set {
    /// The set; an input that another member computes is taken from there in free run.
    pub fn new(members: Vec<Member>) -> Self {
        let place = |name: &String| members.iter().position(|m| m.target == *name);
        let pairs =
            |m: &Member| m.inputs.iter().enumerate().filter_map(|(i, n)| Some((i, place(n)?))).collect();
        let coupled = members.iter().map(pairs).collect();
        Self { members, coupled }
    }

    /// Whether any output is a regressor of another model.
    pub fn is_coupled(&self) -> bool {
        self.coupled.iter().any(|c| !c.is_empty())
    }

    /// `(target, input)` of a coupling with a model that cannot be run sample by sample from its last outputs.
    pub fn without_step(&self) -> Option<(&str, &str)> {
        let each = || self.members.iter().zip(&self.coupled);
        let steps = |m: &Member| m.model.form().goes_on_from_outputs();
        each().find_map(|(m, coupled)| {
            let (i, _) = coupled.iter().find(|(_, other)| !steps(m) || !steps(&self.members[*other]))?;
            Some((m.target.as_str(), m.inputs[*i].as_str()))
        })
    }

    /// `(target, input)` of a regressor that is the output of another model at the same sample: there is no order in
    /// which such a set can be computed.
    pub fn loop_at_once(&self) -> Option<(&str, &str)> {
        self.members.iter().zip(&self.coupled).find_map(|(m, coupled)| {
            let (model, _) = m.model.simulated()?;
            let (i, _) =
                model.window().iter().find(|(i, lag)| *lag == 0 && coupled.iter().any(|c| c.0 == *i))?;
            Some((m.target.as_str(), m.inputs[*i].as_str()))
        })
    }

    /// The record as each member sees it.
    ///
    /// # Errors
    /// [`DataError::NoChannel`].
    pub fn shaped(&self, d: &Dataset) -> Result<Vec<Experiment>, DataError> {
        self.members.iter().map(|m| shape(d, &m.inputs, &m.target)).collect()
    }

    /// Outputs of all members on one record, `shaped` by [`Set::shaped`]; none where a model has no such output.
    pub fn outputs(&self, shaped: &[Experiment], kind: Kind) -> Vec<Option<Vec<f64>>> {
        if kind == Kind::OneStep || !self.is_coupled() {
            return self.members.iter().zip(shaped).map(|(m, e)| m.model.output(e, kind)).collect();
        }
        let Some(models) = self.members.iter().map(|m| m.model.simulated()).collect::<Option<Vec<_>>>()
        else {
            return vec![None; shaped.len()];
        };
        let together = match kind {
            Kind::KStep(k) => self.k_steps(&models, shaped, k.max(1)),
            _ => self.together(&models, shaped, self.first(shaped)),
        };
        together.into_iter().map(Some).collect()
    }

    /// First sample that all members compute.
    fn first(&self, shaped: &[Experiment]) -> usize {
        self.members.iter().zip(shaped).map(|(m, e)| m.model.first(e).min(e.len())).max().unwrap_or(0)
    }

    fn together(
        &self,
        models: &[(&dyn Model, &[f64])],
        shaped: &[Experiment],
        first: usize,
    ) -> Vec<Vec<f64>> {
        let n = shaped.first().map_or(0, Experiment::len);
        let mut u: Vec<Vec<f64>> = shaped.iter().map(|e| e.u.clone()).collect();
        let mut y: Vec<Vec<f64>> = shaped.iter().map(|e| e.y.clone()).collect();
        let lags: Vec<usize> = models.iter().map(|m| m.0.max_lag()).collect();
        let mut tail = vec![0.0; lags.iter().max().unwrap_or(&0) + 1];
        for t in first..n {
            for (k, (model, theta)) in models.iter().enumerate() {
                let (m, lag) = (model.n_inputs(), lags[k]);
                let run = Run { u: &u[k][(t - lag) * m..(t + 1) * m], y: &y[k][t - lag..=t], start: lag };
                model.simulate(theta, &run, &mut tail[..=lag]);
                y[k][t] = tail[lag];
            }
            for (k, pairs) in self.coupled.iter().enumerate() {
                let m = models[k].0.n_inputs();
                for (i, other) in pairs {
                    u[k][t * m + i] = y[*other][t];
                }
            }
        }
        y
    }

    /// For every t a joint free run over the last k samples from the measured outputs before.
    fn k_steps(&self, models: &[(&dyn Model, &[f64])], shaped: &[Experiment], k: usize) -> Vec<Vec<f64>> {
        let first = self.first(shaped);
        let lag = models.iter().map(|m| m.0.max_lag()).max().unwrap_or(0);
        let mut out: Vec<Vec<f64>> = shaped.iter().map(|e| e.y.clone()).collect();
        for t in first..shaped.first().map_or(0, Experiment::len) {
            let free = k.min(t + 1 - first);
            let from = t + 1 - free - lag;
            let part: Vec<Experiment> = shaped.iter().map(|e| piece(e, from, t + 1)).collect();
            for (y, found) in out.iter_mut().zip(self.together(models, &part, lag)) {
                y[t] = found[lag + free - 1];
            }
        }
        out
    }
}

/// The record as one model sees it.
///
/// # Errors
/// [`DataError::NoChannel`].
pub fn shape(d: &Dataset, inputs: &[String], target: &str) -> Result<Experiment, DataError> {
    Ok(Experiment {
        name: d.name.clone(),
        u: d.matrix(inputs)?,
        y: d.values(target)?.to_vec(),
        init_samples: d.init_samples,
        weights: Vec::new(),
    })
}

fn piece(e: &Experiment, from: usize, to: usize) -> Experiment {
    let m = e.u.len().checked_div(e.len()).unwrap_or(0);
    Experiment {
        name: String::new(),
        u: e.u[from * m..to * m].to_vec(),
        y: e.y[from..to].to_vec(),
        init_samples: 0,
        weights: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_ident::data::{Channel, Role};
    use dynocal_ident::model::poly::PolyNarx;

    fn member(target: &str, inputs: &[&str], terms: &[&str], theta: &[f64]) -> Member {
        let model = PolyNarx::parse(inputs, target, terms).unwrap();
        let model = Fitted::new(model, theta.to_vec()).unwrap();
        Member { target: target.into(), inputs: inputs.iter().map(|s| s.to_string()).collect(), model }
    }

    /// a(t) = 0.5 a(t-1) + 0.2 b(t-1) + u(t-1), b(t) = 0.3 a(t-2) - 0.4 b(t-1): both from the equations.
    #[test]
    fn coupled_outputs_run_free_together() {
        let n = 60;
        let u: Vec<f64> = (0..n).map(|t| ((t * t * 13) % 17) as f64 / 8.0 - 1.0).collect();
        let (mut a, mut b) = (vec![0.3, -0.2, 0.1], vec![0.5, 0.4, -0.3]);
        for t in 3..n {
            a.push(0.5 * a[t - 1] + 0.2 * b[t - 1] + u[t - 1]);
            b.push(0.3 * a[t - 2] - 0.4 * b[t - 1]);
        }
        let set = Set::new(vec![
            member("a", &["u", "b"], &["a(t-1)", "b(t-1)", "u(t-1)"], &[0.5, 0.2, 1.0]),
            member("b", &["a"], &["a(t-2)", "b(t-1)"], &[0.3, -0.4]),
        ]);
        assert!(set.is_coupled() && set.loop_at_once().is_none());
        // What is measured after the initial samples is wrong on purpose: a free run must not see it.
        let spoilt = |v: &[f64]| v.iter().enumerate().map(|(t, x)| if t < 3 { *x } else { 9.0 }).collect();
        let channel =
            |name: &str, values| Channel { name: name.into(), unit: "-".into(), role: Role::Output, values };
        let mut d = Dataset {
            name: "r".into(),
            sample_time_s: 1.0,
            channels: vec![channel("u", u), channel("a", spoilt(&a)), channel("b", spoilt(&b))],
            init_samples: 3,
            origin: "test".into(),
        };
        let free = set.outputs(&set.shaped(&d).unwrap(), Kind::FreeRun);
        for (found, truth) in free.iter().zip([&a, &b]) {
            let found = found.as_ref().unwrap();
            assert!(found.iter().zip(truth).all(|(x, y)| (x - y).abs() < 1e-12));
        }
        // On the true record every horizon gives the truth.
        d.channels[1].values = a.clone();
        d.channels[2].values = b.clone();
        let ahead = set.outputs(&set.shaped(&d).unwrap(), Kind::KStep(4));
        for (found, truth) in ahead.iter().zip([&a, &b]) {
            assert!(found.as_ref().unwrap().iter().zip(truth).all(|(x, y)| (x - y).abs() < 1e-12));
        }
    }

    #[test]
    fn outputs_of_the_same_sample_are_a_loop() {
        let set = Set::new(vec![
            member("a", &["b"], &["a(t-1)", "b(t)"], &[0.5, 0.2]),
            member("b", &["a"], &["a(t-1)"], &[0.3]),
        ]);
        assert_eq!(set.loop_at_once(), Some(("a", "b")));
    }
}
