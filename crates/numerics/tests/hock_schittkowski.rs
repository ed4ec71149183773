//! Interior point on the test problems of Hock and Schittkowski; `data/hock_schittkowski.toml` has them with their source.

mod common;

use common::Jet;
use common::formula::Formula;
use dynocal_numerics::nlp::{NlpOptions, NlpOutcome, SparseNlp, solve};
use dynocal_numerics::status::Status;
use std::collections::BTreeMap;

/// A problem as the table has it; `g >= 0` get slacks behind the variables.
#[derive(Clone)]
struct Problem {
    name: String,
    start: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    objective: Formula,
    inequalities: Vec<Formula>,
    equations: Vec<Formula>,
    optimum: f64,
    local: Option<f64>,
}

fn bounds(table: &toml::Table, key: &str, none: f64, n: usize) -> Vec<f64> {
    match table.get(key) {
        None => vec![none; n],
        Some(toml::Value::Array(list)) => list.iter().map(|v| v.as_float().expect("bound")).collect(),
        Some(one) => vec![one.as_float().expect("bound"); n],
    }
}

fn problems() -> BTreeMap<String, Problem> {
    let table: toml::Table = include_str!("data/hock_schittkowski.toml").parse().expect("table");
    let read = |(name, value): (String, toml::Value)| {
        let t = value.as_table().expect("problem");
        let numbers = |v: &toml::Value| -> Vec<f64> {
            v.as_array().expect("list").iter().map(|v| v.as_float().expect("number")).collect()
        };
        let formulas = |key: &str| -> Vec<Formula> {
            let list = t.get(key).and_then(|v| v.as_array()).cloned().unwrap_or_default();
            list.iter().map(|v| Formula::parse(v.as_str().expect("formula"))).collect()
        };
        let start = numbers(&t["x0"]);
        let n = start.len();
        let problem = Problem {
            name: name.clone(),
            lower: bounds(t, "lower", f64::NEG_INFINITY, n),
            upper: bounds(t, "upper", f64::INFINITY, n),
            objective: Formula::parse(t["f"].as_str().expect("formula")),
            inequalities: formulas("g"),
            equations: formulas("h"),
            optimum: t["optimum"].as_float().expect("optimum"),
            local: t.get("local").and_then(|v| v.as_float()),
            start,
        };
        (name, problem)
    };
    table.into_iter().map(read).collect()
}

impl Problem {
    fn variables(&self) -> usize {
        self.start.len()
    }

    fn jets(&self, x: &[f64]) -> Vec<Jet> {
        let n = self.variables();
        (0..n).map(|k| Jet::variable(x[k], k, n)).collect()
    }

    fn rows(&self, x: &[f64]) -> Vec<Jet> {
        let jets = self.jets(x);
        self.inequalities.iter().chain(&self.equations).map(|f| f.at(&jets)).collect()
    }
}

impl SparseNlp for Problem {
    fn n(&self) -> usize {
        self.variables() + self.inequalities.len()
    }
    fn m(&self) -> usize {
        self.inequalities.len() + self.equations.len()
    }
    fn bounds(&self, lower: &mut [f64], upper: &mut [f64]) {
        let n = self.variables();
        lower[..n].copy_from_slice(&self.lower);
        upper[..n].copy_from_slice(&self.upper);
        lower[n..].fill(0.0);
    }
    fn start(&self, x: &mut [f64]) {
        let n = self.variables();
        x[..n].copy_from_slice(&self.start);
        let rows = self.rows(&self.start);
        x[n..].iter_mut().zip(&rows).for_each(|(s, g)| *s = g.v.max(0.0));
    }
    fn objective(&mut self, x: &[f64]) -> f64 {
        self.objective.at(&self.jets(x)).v
    }
    fn gradient(&mut self, x: &[f64], grad: &mut [f64]) {
        grad.fill(0.0);
        grad[..self.variables()].copy_from_slice(&self.objective.at(&self.jets(x)).g);
    }
    fn constraints(&mut self, x: &[f64], c: &mut [f64]) {
        let n = self.variables();
        c.iter_mut().zip(self.rows(x)).for_each(|(c, r)| *c = r.v);
        c.iter_mut().zip(&x[n..]).for_each(|(c, s)| *c -= s);
    }
    fn jacobian_structure(&self) -> Vec<(usize, usize)> {
        let n = self.variables();
        let dense = (0..self.m()).flat_map(|i| (0..n).map(move |j| (i, j)));
        dense.chain((0..self.inequalities.len()).map(|i| (i, n + i))).collect()
    }
    fn jacobian(&mut self, x: &[f64], values: &mut [f64]) {
        let n = self.variables();
        for (i, row) in self.rows(x).iter().enumerate() {
            values[i * n..(i + 1) * n].copy_from_slice(&row.g);
        }
        let from = self.m() * n;
        values[from..].fill(-1.0);
    }
    fn hessian_structure(&self) -> Vec<(usize, usize)> {
        (0..self.variables()).flat_map(|i| (0..=i).map(move |j| (i, j))).collect()
    }
    fn hessian(&mut self, x: &[f64], sigma: f64, multipliers: &[f64], values: &mut [f64]) {
        let n = self.variables();
        let (f, rows) = (self.objective.at(&self.jets(x)), self.rows(x));
        let lower = (0..n).flat_map(|i| (0..=i).map(move |j| i * n + j));
        for (v, k) in values.iter_mut().zip(lower) {
            *v = sigma * f.h[k] + rows.iter().zip(multipliers).map(|(r, l)| l * r.h[k]).sum::<f64>();
        }
    }
}

fn run(problem: &mut Problem) -> NlpOutcome {
    let options = NlpOptions { max_iterations: 1000, ..NlpOptions::default() };
    let found = solve(problem, &options, &|| false);
    println!(
        "{:14} {:?} f {:.10} of {:.10} violation {:.1e} iterations {} evaluations {}",
        problem.name,
        found.status,
        found.objective,
        problem.optimum,
        found.violation,
        found.history.len() - 1,
        found.history.last().map_or(0, |h| h.evaluations)
    );
    found
}

/// At least 98 of 100 end with the status that says so at a feasible point with the value of a minimum: the printed one,
/// or where there is another one, that.
#[test]
fn printed_optima_are_reached() {
    let (mut right, mut elsewhere, mut wrong) = (0, Vec::new(), Vec::new());
    let (mut iterations, mut evaluations) = (0, 0);
    let all = problems();
    assert!(all.len() >= 60);
    for (name, mut problem) in all {
        let found = run(&mut problem);
        iterations += found.history.len() - 1;
        evaluations += found.history.last().map_or(0, |h| h.evaluations);
        let is = |value: f64| (found.objective - value).abs() <= 1e-6 * value.abs().max(1.0);
        let solved = found.status == Status::Converged && found.violation < 1e-6;
        match problem.local {
            _ if solved && is(problem.optimum) => right += 1,
            Some(local) if solved && is(local) => elsewhere.push(name),
            _ => wrong.push((name, found.status, found.objective, problem.optimum)),
        }
    }
    println!("{right} at the printed optimum, at another minimum: {elsewhere:?}, wrong: {wrong:?}");
    assert!(50 * wrong.len() <= right + elsewhere.len() + wrong.len(), "{wrong:?}");
    assert!(elsewhere.len() <= 3, "{elsewhere:?}");
    // The work is pinned: a change of the search shows here. The last digits of powers and logarithms may differ elsewhere.
    let (pinned_iterations, pinned_evaluations) = (818usize, 1092usize);
    println!("{iterations} iterations, {evaluations} evaluations");
    assert!(
        iterations.abs_diff(pinned_iterations) <= 10,
        "{iterations} iterations, pinned {pinned_iterations}"
    );
    assert!(
        evaluations.abs_diff(pinned_evaluations) <= 20,
        "{evaluations} evaluations, pinned {pinned_evaluations}"
    );
}

/// Problems whose twins are tried: small and larger ones, with bounds, inequalities, equations, and with all of them.
const TWINS: [&str; 10] = ["HS5", "HS10", "HS21", "HS28", "HS35", "HS43", "HS63", "HS71", "HS76", "HS100"];

/// The same problem with a pair of inequalities that no point meets: a variable on both sides of a gap, or a sum of squares
/// below zero. The status says so, and the point that is left misses as little as can be: half of the gap on either side.
#[test]
fn infeasible_twins_are_called_infeasible() {
    let all = problems();
    for (k, name) in TWINS.iter().enumerate() {
        let mut twin = all[*name].clone();
        let at = twin.start[0];
        let gap = match k % 2 {
            0 => vec![format!("x1 - ({at:?}) - 1"), format!("({at:?}) - x1 - 1")],
            _ => vec![format!("0 - 1 - (x1 - ({at:?}))^2 - x2^2")],
        };
        twin.name += " infeasible";
        twin.inequalities.extend(gap.iter().map(|g| Formula::parse(g)));
        let found = run(&mut twin);
        assert_eq!(found.status, Status::Infeasible, "{}", twin.name);
        assert!(found.violation > 0.5, "{}: {}", twin.name, found.violation);
    }
}

/// The same problem with every constraint twice, the second time scaled: the gradients of active ones depend on each other
/// everywhere, and multipliers are not unique. The optimum is that of the plain problem.
#[test]
fn degenerate_twins_have_the_same_optimum() {
    let all = problems();
    let constrained = ["HS10", "HS21", "HS28", "HS35", "HS43", "HS48", "HS63", "HS71", "HS76", "HS100"];
    let table: toml::Table = include_str!("data/hock_schittkowski.toml").parse().expect("table");
    for name in constrained {
        let mut twin = all[name].clone();
        let again = |key: &str| -> Vec<Formula> {
            let list = table[name].get(key).and_then(|v| v.as_array()).cloned().unwrap_or_default();
            list.iter().map(|v| Formula::parse(&format!("3*({})", v.as_str().expect("formula")))).collect()
        };
        twin.name += " degenerate";
        assert!(twin.inequalities.len() + twin.equations.len() > 0, "{name}");
        twin.inequalities.extend(again("g"));
        twin.equations.extend(again("h"));
        let found = run(&mut twin);
        assert_eq!(found.status, Status::Converged, "{}", twin.name);
        let error = (found.objective - twin.optimum).abs() / twin.optimum.abs().max(1.0);
        assert!(
            error <= 1e-6 && found.violation < 1e-6,
            "{}: {} {}",
            twin.name,
            found.objective,
            twin.optimum
        );
    }
}
