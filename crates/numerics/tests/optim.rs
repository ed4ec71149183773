//! Conformance of every bounded optimiser in the table.

use dynocal_numerics::optim::{
    Annealing, Bounds, Budget, Genetic, InteriorPoint, OPTIMISERS, Objective, Optimiser, Outcome,
    SequentialQuadratic, TrustRegion, optimiser,
};
use dynocal_numerics::status::Status;

/// Objective from closures, counting evaluations and checking the bounds.
struct Counted<F: FnMut(&[f64], &mut [f64]) -> f64> {
    n: usize,
    f: F,
    bounds: Bounds,
    evaluations: usize,
}

impl<F: FnMut(&[f64], &mut [f64]) -> f64> Objective for Counted<F> {
    fn n(&self) -> usize {
        self.n
    }
    fn value_gradient(&mut self, x: &[f64], grad: &mut [f64]) -> f64 {
        self.evaluations += 1;
        for k in 0..self.n {
            assert!(x[k] >= self.bounds.lower[k] && x[k] <= self.bounds.upper[k], "outside of the bounds");
        }
        (self.f)(x, grad)
    }
}

/// The table, and the searches that stay out of it because they need a box, a seed or dense matrices, or are here to be compared with.
fn members() -> Vec<(&'static str, Box<dyn Optimiser>)> {
    let annealing = Annealing { temperature: 1.0, cooling: 0.8, steps: 10, levels: 100, seed: 3 };
    let more: [(&'static str, Box<dyn Optimiser>); 5] = [
        ("trust_region", Box::new(TrustRegion::default())),
        ("sequential_quadratic", Box::new(SequentialQuadratic::default())),
        ("interior_point", Box::new(InteriorPoint)),
        ("genetic", Box::new(Genetic { population: 20, seed: 3 })),
        ("annealing", Box::new(annealing)),
    ];
    OPTIMISERS
        .iter()
        .map(|m| (m.doc.name, optimiser(m.doc.name, &toml::Table::new()).expect("defaults build")))
        .chain(more)
        .collect()
}

fn needs_gradient(name: &str) -> bool {
    matches!(name, "quasi_newton" | "lbfgsb" | "trust_region" | "sequential_quadratic" | "interior_point")
}

/// sum w_k (x_k - t_k)^2 with a coupling term; convex. Target partly outside of the box [-1, 1]^4.
fn quadratic(x: &[f64], g: &mut [f64]) -> f64 {
    let (w, t) = ([1.0, 10.0, 3.0, 0.5], [0.3, 2.0, -0.4, -5.0]);
    for k in 0..g.len() {
        g[k] = 2.0 * w[k] * (x[k] - t[k]);
    }
    (0..4).map(|k| w[k] * (x[k] - t[k]).powi(2)).sum()
}

/// Separable: the minimum over the box is the clipped target (0.3, 1, -0.4, -1).
const QUADRATIC_MINIMUM: f64 = 10.0 + 0.5 * 16.0;

fn rosenbrock(x: &[f64], g: &mut [f64]) -> f64 {
    g.fill(0.0);
    let mut f = 0.0;
    for k in 0..x.len() - 1 {
        let (a, b) = (x[k + 1] - x[k] * x[k], 1.0 - x[k]);
        f += 100.0 * a * a + b * b;
        if !g.is_empty() {
            g[k] += -400.0 * a * x[k] - 2.0 * b;
            g[k + 1] += 200.0 * a;
        }
    }
    f
}

fn run<F: FnMut(&[f64], &mut [f64]) -> f64>(
    method: &dyn Optimiser,
    f: F,
    bounds: Bounds,
    x0: &[f64],
    evaluations: usize,
) -> (Outcome, usize) {
    let mut problem = Counted { n: x0.len(), f, bounds: bounds.clone(), evaluations: 0 };
    let budget = Budget { evaluations, gradient_tolerance: 1e-9, value_tolerance: 1e-15 };
    let found = method.minimise(&mut problem, &bounds, x0, &budget);
    (found, problem.evaluations)
}

fn boxed(n: usize, lower: f64, upper: f64) -> Bounds {
    Bounds { lower: vec![lower; n], upper: vec![upper; n] }
}

#[test]
fn the_minimum_of_a_convex_quadratic_over_a_box_is_reached() {
    for (name, method) in members() {
        let (found, used) = run(method.as_ref(), quadratic, boxed(4, -1.0, 1.0), &[0.0; 4], 4000);
        println!("{name}: {:?} {:.12} after {used}", found.status, found.value);
        let tolerance = if needs_gradient(name) { 1e-9 } else { 1e-4 };
        assert!((found.value - QUADRATIC_MINIMUM).abs() < tolerance, "{name}: {}", found.value);
        for (x, t) in found.x.iter().zip([0.3, 1.0, -0.4, -1.0]) {
            assert!((x - t).abs() < 1e-2, "{name}: {:?}", found.x);
        }
    }
}

#[test]
fn bounded_rosenbrock_of_dimension_50_is_solved_by_the_gradient_methods() {
    for (name, method) in members().into_iter().filter(|m| needs_gradient(m.0)) {
        let (found, used) = run(method.as_ref(), rosenbrock, boxed(50, -10.0, 0.8), &[0.0; 50], 2000);
        println!("{name}: {:?} {:.12} after {used}", found.status, found.value);
        assert!(matches!(found.status, Status::Converged | Status::Stalled), "{name}: {:?}", found.status);
        assert!((found.value - 45.596_891_356_879).abs() < 1e-6, "{name}: {}", found.value);
    }
}

#[test]
fn budgets_are_kept_and_the_result_is_never_worse_than_the_start() {
    let start = [-1.2, 1.0, 0.5];
    let f0 = rosenbrock(&start, &mut []);
    for (name, method) in members() {
        for budget in [1, 2, 7, 40] {
            let (found, used) = run(method.as_ref(), rosenbrock, boxed(3, -2.0, 2.0), &start, budget);
            assert!(used <= budget, "{name}: {used} of {budget}");
            assert!(found.value <= f0, "{name}");
            assert_eq!(found.status, Status::Limit, "{name} at {budget}");
            assert!((rosenbrock(&found.x, &mut []) - found.value).abs() <= 1e-12 * f0, "{name}");
        }
    }
}

#[test]
fn history_is_monotone_and_reruns_are_identical() {
    for (name, method) in members() {
        let go = || run(method.as_ref(), rosenbrock, boxed(3, -2.0, 2.0), &[-1.2, 1.0, 0.5], 300).0;
        let (a, b) = (go(), go());
        assert_eq!(a.x, b.x, "{name}");
        assert!(a.history.windows(2).all(|w| w[1].objective < w[0].objective), "{name}");
        assert_eq!(a.history.last().map(|h| h.objective), Some(a.value), "{name}");
    }
}

#[test]
fn non_finite_trials_are_survived_and_a_non_finite_start_is_diverged() {
    // -ln(1 - x) - ln(1 - y) - 2 x - y: minimum at x = 1/2, y = 0; not a number beyond 1.
    fn logarithm(x: &[f64], g: &mut [f64]) -> f64 {
        if !g.is_empty() {
            (g[0], g[1]) = (1.0 / (1.0 - x[0]) - 2.0, 1.0 / (1.0 - x[1]) - 1.0);
        }
        -(1.0 - x[0]).ln() - (1.0 - x[1]).ln() - 2.0 * x[0] - x[1]
    }
    let minimum = 2f64.ln() - 1.0;
    for (name, method) in members() {
        let (found, _) = run(method.as_ref(), logarithm, boxed(2, -50.0, 50.0), &[-8.0, -3.0], 2000);
        assert!((found.value - minimum).abs() < 1e-4, "{name}: {}", found.value);
        let (bad, _) = run(
            method.as_ref(),
            |_, g| {
                g.fill(0.0);
                f64::NAN
            },
            boxed(2, -1.0, 1.0),
            &[0.0; 2],
            50,
        );
        assert_eq!(bad.status, Status::Diverged, "{name}");
    }
}

#[test]
fn unknown_names_and_keys_are_refused_with_a_hint() {
    let unknown = optimiser("neldermead", &toml::Table::new()).err().expect("unknown").to_string();
    assert!(unknown.contains("nelder_mead"), "{unknown}");
    let keys: toml::Table = toml::from_str("memroy = 3").expect("a table");
    assert!(optimiser("quasi_newton", &keys).is_err());
}
