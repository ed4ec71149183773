//! What demands and limits cost: derivatives of the optimal objective, from the multipliers of the solution.
//!
//! ```text
//! d f* / d demand(t)  = -l(t) + sum_j l(t+j) df/dy(t)       l multipliers of the model's equations, in the user's unit
//! d f* / d rate       = -sum_t |l_r(t)|                     l_r multipliers of the increments
//! d f* / d bound      =  sum_t z(t)                         z reduced gradient of the variables at the bound
//! d f* / d mean_upper = -l
//! ```
//!
//! They say what one unit more of a demand at all samples, of a limit or of a rate changes, as long as the same limits stay
//! active.

use super::program::{FIXED, Program, Target};
use super::setup::Setup;
use dynocal_numerics::nlp::{NlpOutcome, SparseNlp};
use serde::{Deserialize, Serialize};

/// Price of one demand, limit or rate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Price {
    /// Channel.
    pub channel: String,
    /// What of it: `demand`, `lower`, `upper`, `rate` (per second) or `mean_upper`.
    pub of: String,
    /// Its unit; the price is in objective unit per this.
    pub unit: String,
    /// Change of the optimal objective for one unit more.
    pub price: f64,
    /// The same for one sample of a demand or limit (N); empty for others.
    pub by_sample: Vec<f64>,
}

/// Prices of a solved program.
pub(super) fn prices(setup: &Setup<'_>, program: &mut Program<'_>, found: &NlpOutcome) -> Vec<Price> {
    let mut out = demand_prices(setup, program, found);
    out.extend(bound_prices(setup, program, found));
    let first = program.model_equations();
    let (rates, sums) = program.inequalities();
    let multipliers = &found.multipliers[first..];
    for (c, input) in setup.problem.inputs.iter().enumerate().filter(|(_, i)| i.rate_per_s.is_some()) {
        let of = rates.iter().zip(multipliers).filter(|(column, _)| **column == c);
        let price = -of.map(|(_, l)| l.abs()).sum::<f64>() * setup.sample_time_s;
        let unit = format!("{}/s", input.unit);
        out.push(Price {
            channel: input.name.clone(),
            of: "rate".into(),
            unit,
            price,
            by_sample: Vec::new(),
        });
    }
    let limits = setup.mean_limits().into_iter().zip(&multipliers[rates.len()..rates.len() + sums]);
    out.extend(limits.map(|((channel, ..), l)| Price {
        unit: setup.problem.unit(&channel).unwrap_or("-").into(),
        channel,
        of: "mean_upper".into(),
        price: -l,
        by_sample: Vec::new(),
    }));
    out
}

fn demand_prices(setup: &Setup<'_>, program: &Program<'_>, found: &NlpOutcome) -> Vec<Price> {
    let mut out = Vec::new();
    let mut from = 0;
    for (k, (row, samples)) in program.model_rows().enumerate() {
        let multipliers = &found.multipliers[from..from + samples.len()];
        from += samples.len();
        if row.target != Target::Demand {
            continue;
        }
        let m = &setup.models[k];
        let mut by_sample = program.demand_slopes(k, multipliers);
        by_sample[..setup.first_equation()].fill(0.0);
        if let Some(demand) = setup.given(&m.output) {
            by_sample.iter_mut().zip(demand).for_each(|(p, y)| *p *= m.way.slope(*y));
        }
        out.push(Price {
            channel: m.output.clone(),
            of: "demand".into(),
            unit: setup.problem.unit(&m.output).unwrap_or("-").into(),
            price: by_sample.iter().sum(),
            by_sample,
        });
    }
    out
}

fn bound_prices(setup: &Setup<'_>, program: &mut Program<'_>, found: &NlpOutcome) -> Vec<Price> {
    let structure = program.jacobian_structure();
    let (mut reduced, mut jacobian) = (vec![0.0; program.n()], vec![0.0; structure.len()]);
    program.gradient(&found.x, &mut reduced);
    program.jacobian(&found.x, &mut jacobian);
    for (&(row, v), j) in structure.iter().zip(&jacobian) {
        reduced[v] += found.multipliers[row] * j;
    }
    let mut out = Vec::new();
    for (c, name) in setup.columns.iter().enumerate() {
        let (lower, upper) = program.columns.bounds(c);
        for (of, bound, sign) in [("lower", lower, 1.0), ("upper", upper, -1.0)] {
            if !bound.is_finite() {
                continue;
            }
            let mut by_sample = vec![0.0; setup.samples];
            let mut last = FIXED;
            for (t, p) in by_sample.iter_mut().enumerate() {
                let v = program.columns.variable(t, c);
                // A held value counts once.
                if v != FIXED && v != last {
                    *p = sign * (sign * reduced[v]).max(0.0);
                }
                last = v;
            }
            out.push(Price {
                channel: name.clone(),
                of: of.into(),
                unit: setup.problem.unit(name).unwrap_or("-").into(),
                price: by_sample.iter().sum(),
                by_sample,
            });
        }
    }
    out
}
