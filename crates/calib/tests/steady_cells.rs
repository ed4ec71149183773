//! The optimum of a cell on known responses: closed forms, prices, conflicts.

use dynocal_calib::steady::breakpoints::Tables;
use dynocal_calib::steady::cell::{Setting, Side};
use dynocal_calib::steady::envelope::Envelope;
use dynocal_calib::steady::front::Tradeoff;
use dynocal_calib::steady::grid::{CellState, GridSpec, interpolate, solve};
use dynocal_calib::steady::quantise::quantise;
use dynocal_calib::steady::refine::Known;
use dynocal_calib::steady::whole::{Coupling, Way, solve_whole};
use dynocal_ident::model::response::{Ask, Prediction, Response};
use dynocal_numerics::interval::Interval;

/// A quadratic `c + g'x + x'Hx/2` with variance `v0 + v1 |x - centre|^2`.
struct Quadratic {
    constant: f64,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
    variance: [f64; 2],
    centre: Vec<f64>,
}

impl Quadratic {
    fn new(constant: f64, gradient: &[f64], diagonal: &[f64]) -> Self {
        let d = gradient.len();
        let mut hessian = vec![0.0; d * d];
        (0..d).for_each(|i| hessian[i * d + i] = diagonal[i]);
        Self { constant, gradient: gradient.to_vec(), hessian, variance: [0.0; 2], centre: vec![0.0; d] }
    }
}

impl Response for Quadratic {
    fn dim(&self) -> usize {
        self.gradient.len()
    }
    fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
        let d = x.len();
        *out = Prediction::new(d);
        out.mean = self.constant;
        out.variance = self.variance[0];
        for i in 0..d {
            let slope: f64 = (0..d).map(|j| self.hessian[i * d + j] * x[j]).sum();
            out.mean += x[i] * (self.gradient[i] + 0.5 * slope);
            out.gradient[i] = self.gradient[i] + slope;
            let away = x[i] - self.centre[i];
            out.variance += self.variance[1] * away * away;
            out.variance_gradient[i] = 2.0 * self.variance[1] * away;
            out.variance_hessian[i * d + i] = 2.0 * self.variance[1];
        }
        out.hessian.copy_from_slice(&self.hessian);
    }
    fn describe(&self) -> String {
        "quadratic".into()
    }
}

fn setting<'a>(models: Vec<&'a dyn Response>, sides: Vec<Side>, d: usize) -> Setting<'a> {
    let mut weights = vec![0.0; models.len()];
    weights[0] = 1.0;
    Setting {
        models,
        weights,
        sides,
        z: 0.0,
        caution: 0.0,
        ranges: vec![Interval::new(-5.0, 5.0); d],
        axes: 1,
    }
}

fn upper(response: usize, limit: f64) -> Side {
    Side { response, limit, sign: 1.0, scale: 2.0, caution: 1.0 }
}

/// minimise (x - 2)^2 + (y - 1)^2 + a subject to x <= 1 + a, -y <= -2: x = 1 + a, y = 2; prices 2 (1 - a) and 2.
#[test]
fn two_limits_act_and_their_prices_are_the_multipliers() {
    let fuel = Quadratic::new(5.0, &[1.0, -4.0, -2.0], &[0.0, 2.0, 2.0]);
    let knock = Quadratic::new(0.0, &[-1.0, 1.0, 0.0], &[0.0; 3]);
    let heat = Quadratic::new(0.0, &[0.0, 0.0, 1.0], &[0.0; 3]);
    let sides = vec![
        upper(1, 1.0),
        Side { response: 2, limit: 2.0, sign: -1.0, scale: 0.5, caution: 1.0 },
        upper(2, 40.0),
    ];
    let s = setting(vec![&fuel, &knock, &heat], sides, 3);
    for a in [-0.5, 0.0, 0.5] {
        let o = s.optimise(&[a], 3, &[], 1, &|| false);
        assert!(o.feasible && o.status.is_success(), "{o:?}");
        assert!((o.x[1] - (1.0 + a)).abs() < 1e-5 && (o.x[2] - 2.0).abs() < 1e-5, "{:?}", o.x);
        let expected = [2.0 * (1.0 - a), 2.0, 0.0];
        for (p, e) in o.prices.iter().zip(expected) {
            assert!((p.saves - e).abs() < 1e-4, "{:?} {expected:?}", o.prices);
        }
        // A price is what a unit of room saves: the derivative of the optimal value.
        let objective = (a - 1.0f64).powi(2) + 1.0 + a;
        assert!((o.objective - objective).abs() < 1e-5);
    }
}

/// A limit with uncertainty: x + z s <= 1 with constant s, and with s that grows away from a centre.
#[test]
fn a_limit_is_kept_with_its_standard_deviations() {
    let fuel = Quadratic::new(0.0, &[0.0, -1.0], &[0.0, 0.0]);
    let mut knock = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    knock.variance = [0.04, 0.0];
    let mut s = setting(vec![&fuel, &knock], vec![upper(1, 1.0)], 2);
    s.z = 1.5;
    let o = s.optimise(&[0.0], 2, &[], 1, &|| false);
    assert!((o.x[1] - 0.7).abs() < 1e-5, "{:?}", o.x);
    // One that harms nothing is kept as far as it is expected.
    s.sides[0].caution = 0.0;
    let o = s.optimise(&[0.0], 2, &[], 1, &|| false);
    assert!(o.feasible && (o.x[1] - 1.0).abs() < 1e-5, "{:?}", o.x);
    let mut growing = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    growing.variance = [0.0, 0.25];
    let mut s = setting(vec![&fuel, &growing], vec![upper(1, 1.0)], 2);
    s.z = 2.0;
    // x + 2 * 0.5 |x| = 1 on the right of the centre.
    let o = s.optimise(&[0.0], 2, &[], 1, &|| false);
    assert!((o.x[1] - 0.5).abs() < 1e-5, "{:?}", o.x);
}

/// x >= 2 and x <= -1 cannot both be: the least sum of violations in scales 2 and 2 lies anywhere between, 3 apart.
#[test]
fn limits_that_conflict_are_named_with_their_distance() {
    let fuel = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    let x = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    let low = Side { response: 1, limit: 2.0, sign: -1.0, scale: 2.0, caution: 1.0 };
    let s = setting(vec![&fuel, &x], vec![upper(1, -1.0), low], 2);
    let o = s.optimise(&[0.0], 3, &[], 1, &|| false);
    assert!(!o.feasible);
    let sum: f64 = o.prices.iter().map(|p| p.passed.max(0.0)).sum();
    assert!((sum - 3.0).abs() < 1e-3, "{:?}", o.prices);
}

/// Of two valleys the deeper one is found from whatever seed, with the interior point started in several places.
#[test]
fn several_starts_find_the_deeper_valley() {
    struct Valleys;
    impl Response for Valleys {
        fn dim(&self) -> usize {
            2
        }
        fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
            *out = Prediction::new(2);
            let v = x[1];
            // (v^2 - 4)^2 / 16 + 0.3 v
            out.mean = (v * v - 4.0).powi(2) / 16.0 + 0.3 * v;
            out.gradient[1] = (v * v - 4.0) * v / 4.0 + 0.3;
            out.hessian[3] = (3.0 * v * v - 4.0) / 4.0;
        }
        fn describe(&self) -> String {
            "two valleys".into()
        }
    }
    for seed in 0..20 {
        let o = setting(vec![&Valleys], Vec::new(), 2).optimise(&[0.0], 4, &[], seed, &|| false);
        assert!(o.x[1] < -1.9, "seed {seed}: {:?}", o.x);
    }
}

/// Optimum x = 1 + a b: the map holds it in every cell that is reached; where it is not, neighbours fill it and it is marked.
#[test]
fn a_map_holds_the_optimum_of_each_cell_and_marks_what_was_not_reached() {
    struct Bowl;
    impl Response for Bowl {
        fn dim(&self) -> usize {
            3
        }
        fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
            *out = Prediction::new(3);
            let e = x[2] - (1.0 + x[0] * x[1]);
            out.mean = 10.0 + e * e;
            out.gradient.copy_from_slice(&[-2.0 * e * x[1], -2.0 * e * x[0], 2.0 * e]);
            out.hessian[8] = 2.0;
        }
        fn describe(&self) -> String {
            "bowl".into()
        }
    }
    let axes = vec![vec![0.0, 0.5, 1.0], vec![-1.0, 0.0, 1.0, 2.0]];
    let mut s = setting(vec![&Bowl], Vec::new(), 3);
    s.axes = 2;
    let spec = GridSpec { smooth: 0.0, ..GridSpec::default() };
    let reached = |at: &[f64]| !(at[0] > 0.9 && at[1] > 1.5);
    let cells = solve(&s, &axes, &spec, &reached, 1, &|| false);
    assert_eq!(cells.len(), 12);
    for c in &cells[..11] {
        assert_eq!(c.state, CellState::Optimal);
        assert!((c.optimum.x[2] - (1.0 + c.at[0] * c.at[1])).abs() < 1e-5, "{c:?}");
    }
    assert_eq!(cells[11].state, CellState::Filled);
    // The mean of its neighbours, (0.5, 2) and (1, 1).
    assert!((cells[11].optimum.x[2] - 2.0).abs() < 1e-5);
    // Bilinear in the axes, so that interpolation is exact.
    let x = interpolate(&axes, &cells, &[0.25, 0.7]);
    assert!((x[2] - (1.0 + 0.25 * 0.7)).abs() < 1e-5, "{x:?}");
    // A smoother map costs no more than it may.
    let smooth = solve(&s, &axes, &GridSpec { smooth: 0.01, ..spec }, &reached, 1, &|| false);
    let rough = |cells: &[dynocal_calib::steady::grid::Cell]| -> f64 {
        let v = |i: usize, j: usize| cells[4 * i + j].optimum.x[2];
        (0..3)
            .map(|i| (1..3).map(|j| (v(i, j - 1) - 2.0 * v(i, j) + v(i, j + 1)).powi(2)).sum::<f64>())
            .sum::<f64>()
            + (0..4).map(|j| (v(0, j) - 2.0 * v(1, j) + v(2, j)).powi(2)).sum::<f64>()
    };
    assert!(smooth[..11].iter().all(|c| c.optimum.objective <= c.best + 0.01 * 10.1));
    assert!(rough(&smooth) <= rough(&cells) + 0.1);
}

/// `10 + (v^2 - 4)^2 / 16 + slope v` with another slope in each cell: two valleys at -2 and 2 that differ by four times the slope.
struct Turns([f64; 6]);

impl Response for Turns {
    fn dim(&self) -> usize {
        2
    }
    fn predict(&self, x: &[f64], _ask: Ask, out: &mut Prediction) {
        *out = Prediction::new(2);
        let v = x[1];
        let slope = self.0[x[0].round() as usize];
        out.mean = 10.0 + (v * v - 4.0).powi(2) / 16.0 + slope * v;
        out.gradient[1] = (v * v - 4.0) * v / 4.0 + slope;
        out.hessian[3] = (3.0 * v * v - 4.0) / 4.0;
    }
    fn describe(&self) -> String {
        "two valleys in turns".into()
    }
}

/// Signs of the valleys that the cells of a row hold.
fn valleys(slopes: [f64; 6], smooth: f64, jump: f64) -> Vec<f64> {
    let (axes, turns) = (vec![vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]], Turns(slopes));
    let s = setting(vec![&turns], Vec::new(), 2);
    let spec = GridSpec { smooth, jump, ..GridSpec::default() };
    let cells = solve(&s, &axes, &spec, &|_| true, 1, &|| false);
    // No cell costs more than what is free and jumps to both of its neighbours.
    let most = smooth + 2.0 * jump * 0.16;
    assert!(cells.iter().all(|c| s.cost(&c.optimum) <= c.best + most * c.optimum.objective + 1e-9));
    assert!(cells.iter().all(|c| c.optimum.x[1].abs() > 1.5), "{cells:?}");
    cells.iter().map(|c| c.optimum.x[1].signum()).collect()
}

/// Worth the same but for 0.08 %, the deeper one in turns; in the last cell one is deeper by 4 %. Within the share that a smoother map may cost no
/// more than one of five jumps is left; within a smaller share each cell keeps its own.
#[test]
fn cells_whose_valleys_are_worth_nearly_the_same_agree_on_one() {
    let signs = |smooth: f64| valleys([0.002, -0.002, 0.002, -0.002, 0.002, -0.1], smooth, 0.0);
    let own = [-1.0, 1.0, -1.0, 1.0, -1.0, 1.0];
    assert_eq!(signs(0.0), own);
    assert_eq!(signs(0.0005), own);
    let agreed = signs(0.002);
    assert!(agreed[5] > 0.0 && agreed.windows(2).filter(|w| w[0] != w[1]).count() <= 1, "{agreed:?}");
}

/// Two cells gain 0.3 % each in a valley of their own; the jump beside them is 0.4 of the range, 0.16 of what a whole one costs. Neither goes over alone,
/// for the jump is then between the two.
#[test]
fn a_region_goes_over_where_its_jumps_cost_more_than_it_gains() {
    let signs = |jump: f64| valleys([0.0075, 0.0075, -0.0075, -0.0075, -0.0075, -0.0075], 1e-4, jump);
    let own = [-1.0, -1.0, 1.0, 1.0, 1.0, 1.0];
    assert_eq!(signs(0.0), own);
    // 0.16 * 0.03 = 0.48 % and 0.16 * 0.045 = 0.72 %, beside 2 (0.3 - 0.01) %.
    assert_eq!(signs(0.03), own);
    assert_eq!(signs(0.045), [1.0; 6]);
}

/// minimise sum of (x_k - a_k)^2 / 2 with a_k = 0.1, 0.4, 0.2, a limit x <= 0.3 and nothing that couples the cells: each cell by
/// itself.
#[test]
fn a_whole_map_without_coupling_is_the_optimum_of_each_cell() {
    let fuel =
        Quadratic { hessian: vec![1.0, -1.0, -1.0, 1.0], ..Quadratic::new(10.0, &[0.0, 0.0], &[0.0, 0.0]) };
    let knock = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    let s = setting(vec![&fuel, &knock], vec![upper(1, 0.3)], 2);
    let coupling = Coupling {
        weights: vec![1.0, 3.0, 2.0],
        pairs: vec![(0, 1), (1, 2)],
        smooth: 0.0,
        steps: vec![None],
        monotone: Vec::new(),
    };
    let starts: Vec<Vec<f64>> = [0.1, 0.4, 0.2].iter().map(|a| vec![*a, 0.0]).collect();
    let found = solve_whole(&s, &starts, &coupling, &|| false);
    assert!(found.status.is_success(), "{found:?}");
    for (c, expected) in found.cells.iter().zip([0.1, 0.3, 0.2]) {
        assert!((c.x[1] - expected).abs() < 1e-5, "{:?} {expected}", c.x);
        let alone = s.optimise(&c.x[..1], 2, &[], 1, &|| false);
        // A price does not depend on the weight of its cell.
        assert!(
            (c.prices[0].saves - alone.prices[0].saves).abs() < 1e-4,
            "{:?} {:?}",
            c.prices,
            alone.prices
        );
    }
}

/// Two cells that nothing couples.
fn pair() -> Coupling {
    Coupling {
        weights: vec![1.0, 1.0],
        pairs: vec![(0, 1)],
        smooth: 0.0,
        steps: vec![None],
        monotone: Vec::new(),
    }
}

/// Cells with optima 1 and 3 (x = a). Rising they stay there; falling they meet where the weighted slopes cancel: the mean, the weights being
/// those of cells of nearly equal size.
#[test]
fn an_input_that_is_to_fall_along_an_axis_does_not_rise() {
    let fuel =
        Quadratic { hessian: vec![2.0, -2.0, -2.0, 2.0], ..Quadratic::new(1000.0, &[0.0, 0.0], &[0.0, 0.0]) };
    let s = setting(vec![&fuel], Vec::new(), 2);
    let solved = |way| {
        let coupling = Coupling { monotone: vec![(0, 0, way)], ..pair() };
        let found = solve_whole(&s, &[vec![1.0, 0.0], vec![3.0, 0.0]], &coupling, &|| false);
        assert!(found.status.is_success(), "{found:?}");
        [found.cells[0].x[1], found.cells[1].x[1]]
    };
    let [a, b] = solved(Way::Rising);
    assert!((a - 1.0).abs() < 1e-4 && (b - 3.0).abs() < 1e-4, "{a} {b}");
    let [a, b] = solved(Way::Falling);
    let mean = (1.0 / 1001.0 + 3.0 / 1009.0) / (1.0 / 1001.0 + 1.0 / 1009.0);
    assert!((a - mean).abs() < 1e-4 && (b - mean).abs() < 1e-4 && a >= b - 1e-9, "{a} {b} {mean}");
}

/// Two cells with optima 1 and 3, at most 0.5 apart: where the weighted slopes of (x - 1)^2 and (x + 0.5 - 3)^2 cancel.
#[test]
fn a_limited_step_between_cells_is_kept_and_shared_by_weight() {
    let fuel =
        Quadratic { hessian: vec![2.0, -2.0, -2.0, 2.0], ..Quadratic::new(1000.0, &[0.0, 0.0], &[0.0, 0.0]) };
    let s = setting(vec![&fuel], Vec::new(), 2);
    let coupling = Coupling { weights: vec![1.0, 3.0], steps: vec![Some(0.5)], ..pair() };
    let found = solve_whole(&s, &[vec![1.0, 0.0], vec![3.0, 0.0]], &coupling, &|| false);
    assert!(found.status.is_success(), "{found:?}");
    // The starts scale the objectives of the cells: 1001 and 1009.
    let (a, b) = (1.0 / 1001.0, 3.0 / 1009.0);
    let first = (a * 1.0 + b * 2.5) / (a + b);
    assert!((found.cells[0].x[1] - first).abs() < 1e-4, "{:?} {first}", found.cells[0].x);
    assert!((found.cells[1].x[1] - first - 0.5).abs() < 1e-4, "{:?}", found.cells[1].x);
}

/// Smoothness alone couples: the program is a linear system, solved here by hand.
#[test]
fn smoothness_draws_neighbours_together_as_the_linear_system_says() {
    let fuel =
        Quadratic { hessian: vec![2.0, -2.0, -2.0, 2.0], ..Quadratic::new(1.0, &[0.0, 0.0], &[0.0, 0.0]) };
    let s = setting(vec![&fuel], Vec::new(), 2);
    let rho = 0.3;
    let coupling = Coupling { smooth: rho, ..pair() };
    let found = solve_whole(&s, &[vec![-1.0, -1.0], vec![1.0, 1.0]], &coupling, &|| false);
    assert!(found.status.is_success(), "{found:?}");
    // By symmetry x and -x: derivative of (x - 1)^2 / 2 [weight 1/2, scale 1] + rho / 2 (2 x / 10)^2 by x at the second cell.
    // Both cells: (x - 1)^2 in all, so 2 (x - 1) + rho (2 x) 2 / 100 = 0.
    let x = 2.0 / (2.0 + rho * 4.0 / 100.0);
    assert!((found.cells[1].x[1] - x).abs() < 1e-5, "{:?} {x}", found.cells[1].x);
    assert!((found.cells[0].x[1] + x).abs() < 1e-5, "{:?}", found.cells[0].x);
}

/// The next points go to the cells that were not reached, farthest first, then to where the map is in doubt.
#[test]
fn the_next_points_go_far_out_first_and_then_where_the_map_is_in_doubt() {
    let mut fuel = Quadratic::new(10.0, &[0.0, 0.0], &[0.0, 2.0]);
    // Doubt grows towards the upper end of the axis.
    fuel.variance = [1e-4, 1e-2];
    fuel.centre = vec![-5.0, 0.0];
    let s = setting(vec![&fuel], Vec::new(), 2);
    let axes = vec![(0..9).map(|k| -4.0 + f64::from(k)).collect::<Vec<f64>>()];
    let envelope = Envelope::of(&[vec![-4.0], vec![2.0]], &[Interval::new(-5.0, 5.0)]);
    let cells = solve(&s, &axes, &GridSpec::default(), &|at| envelope.contains(at), 1, &|| false);
    let measured = vec![vec![-4.0, 0.0], vec![0.0, 0.0], vec![2.0, 1.0]];
    let known = |asked: &[Vec<f64>], count: usize| {
        let known = Known {
            setting: &s,
            axes: &axes,
            cells: &cells,
            hopeful: &cells,
            envelope: &envelope,
            measured: &measured,
            with_room: &measured,
            asked,
        };
        (known.untried(), known.next(count, 1, &|| false))
    };
    // Cells 3 and 4 lie outside; the farthest is 4, and the better half of a batch goes to the map.
    let (untried, next) = known(&[], 2);
    assert_eq!(untried, [7, 8]);
    assert_eq!((next.len(), next[0][0]), (2, 4.0));
    // The optimum is y = 0, and doubt times distance is greatest at its upper end inside.
    assert!(next[1][0] <= 2.0 && next[1][1].abs() < 1e-4, "{next:?}");
    // Tried once, it is gone to with the setting of the nearest point, then with that of its neighbours, then no more.
    let (_, again) = known(&[vec![4.0]], 2);
    assert_eq!(again[0], [4.0, 1.0]);
    let (left, third) = known(&[vec![4.0], vec![4.0], vec![3.0], vec![3.0], vec![3.0]], 2);
    assert_eq!((left, third[0].clone()), (vec![8], cells[8].optimum.x.clone()));
    let (none, _) = known(&[vec![4.0], vec![4.0], vec![4.0], vec![3.0], vec![3.0], vec![3.0]], 2);
    assert!(none.is_empty());
}

/// Cells a with fuel x^2 + 5 and emission (x - 2)^2 + 3: at weights (1 - s)/F0 and s/G0 every cell has
/// x = 2 r / (1 + r), r = s F0 / ((1 - s) G0), so that sqrt(F - 5) + sqrt(G - 3) = 2 along the front, and its price is r.
#[test]
fn a_front_in_closed_form() {
    let fuel = Quadratic::new(5.0, &[0.0, 0.0], &[0.0, 2.0]);
    let emission = Quadratic::new(7.0, &[0.0, -4.0], &[0.0, 2.0]);
    let s = setting(vec![&fuel, &emission], Vec::new(), 2);
    let cells: Vec<_> = [-1.0, 0.5, 2.0].iter().map(|a| s.optimise(&[*a], 2, &[], 1, &|| false)).collect();
    let trade = Tradeoff { setting: &s, against: 1, cells, weights: vec![1.0, 2.0, 0.0], seed: 1 };
    let front = trade.trace(9, &|| false);
    assert_eq!(front.len(), 9);
    assert!(front.windows(2).all(|w| w[0].minimised < w[1].minimised && w[0].other > w[1].other));
    for p in &front {
        let root = (p.minimised - 5.0).max(0.0).sqrt() + (p.other - 3.0).max(0.0).sqrt();
        assert!((root - 2.0).abs() < 1e-4, "{root} at {}", p.share);
        let x = p.cells[0].x[1];
        assert!((x - 2.0 * p.price / (1.0 + p.price)).abs() < 1e-4, "{x} at a price of {}", p.price);
    }
    // No two neighbours lie far apart: the ends are 4 apart in both.
    assert!(front.windows(2).all(|w| w[1].minimised - w[0].minimised < 1.2), "{front:?}");
    // G = 5: x = 2 - sqrt(2), F = 5.343; from below, within a thousandth.
    let taken = trade.at_most(5.0, &front, &|| false).unwrap();
    assert!(taken.other <= 5.0 && taken.other >= 4.994, "{}", taken.other);
    assert!((taken.minimised - 5.0 - (2.0 - 2f64.sqrt()).powi(2)).abs() < 5e-3, "{}", taken.minimised);
    assert!(trade.at_most(2.9, &front, &|| false).is_none());
    assert_eq!(trade.at_most(8.0, &front, &|| false).unwrap().share, 0.0);
}

/// On a front with a limit x <= 1 the least emission is that at the limit, and the weighted sum of the cells is the same whatever way
/// it is cut into cells of unequal time.
#[test]
fn a_front_ends_at_its_limit() {
    let fuel = Quadratic::new(5.0, &[0.0, 0.0], &[0.0, 2.0]);
    let emission = Quadratic::new(7.0, &[0.0, -4.0], &[0.0, 2.0]);
    let place = Quadratic::new(0.0, &[0.0, 1.0], &[0.0, 0.0]);
    let s = setting(vec![&fuel, &emission, &place], vec![upper(2, 1.0)], 2);
    let cells = vec![s.optimise(&[0.0], 2, &[], 1, &|| false)];
    let trade = Tradeoff { setting: &s, against: 1, cells, weights: vec![3.0], seed: 1 };
    let front = trade.trace(5, &|| false);
    let last = front.last().unwrap();
    assert!((last.other - 4.0).abs() < 1e-4 && last.cells.iter().all(|c| c.feasible), "{last:?}");
    assert!(trade.at_most(3.9, &front, &|| false).is_none());
}

/// A broken line has its breakpoints where it breaks; a parabola has equal segments, as the error of a chord grows with its length to
/// the fourth. On two axes the choice is compared with all choices there are.
#[test]
fn breakpoints_are_those_of_least_error() {
    let x: Vec<f64> = (0..21).map(f64::from).collect();
    let broken: Vec<f64> =
        x.iter().map(|x| if *x < 4.0 { 3.0 * x } else { 12.0 + 0.5 * (x - 4.0) }).collect();
    let one = |f: Vec<f64>| Tables { axes: vec![x.clone()], layers: vec![f], weights: vec![1.0; 21] };
    let t = one(broken);
    assert_eq!(t.choose(&[3]), vec![vec![0, 4, 20]]);
    assert!(t.error(&[vec![0, 4, 20]]) < 1e-20 && t.error(&[vec![0, 5, 20]]) > 0.1);
    let parabola = one(x.iter().map(|x| x * x).collect());
    assert_eq!(parabola.choose(&[5]), vec![vec![0, 5, 10, 15, 20]]);
    // What has no weight does not count.
    let mut part = parabola.clone();
    part.weights[10..].fill(0.0);
    assert!(part.choose(&[4])[0][..3].iter().all(|i| *i <= 10));

    let (a, b): (Vec<f64>, Vec<f64>) =
        ((0..7).map(f64::from).collect(), (0..6).map(|v| f64::from(v).powi(2)).collect());
    let surface: Vec<f64> =
        a.iter().flat_map(|x| b.iter().map(move |y| (0.3 * x * x).sin() + (y / 9.0).tanh() * x)).collect();
    let t = Tables { axes: vec![a, b], layers: vec![surface], weights: vec![1.0; 42] };
    let found = t.error(&t.choose(&[4, 3]));
    let mut all = Vec::new();
    for i in 1..5 {
        for j in i + 1..6 {
            for k in 1..5 {
                all.push(t.error(&[vec![0, i, j, 6], vec![0, k, 5]]));
            }
        }
    }
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    // In turns it may end beside the least of all; here it does not.
    assert!((found - least).abs() < 1e-12, "{found} {least}");
}

/// x = 1.37 y = 0.62 with x + y <= 2: rounded to 0.5 each by itself (1.5, 0.5) it keeps the limit only by chance. With x + y <= 1.99 the
/// nearest is refused and the best of the others taken.
#[test]
fn inputs_in_steps_keep_their_limits() {
    let fuel = Quadratic::new(10.0, &[0.0, -2.74, -1.24], &[0.0, 2.0, 2.0]);
    let sum = Quadratic::new(0.0, &[0.0, 1.0, 1.0], &[0.0; 3]);
    let s = setting(vec![&fuel, &sum], vec![upper(1, 1.995)], 3);
    let o = s.optimise(&[0.0], 3, &[], 1, &|| false);
    assert!((o.x[1] - 1.37).abs() < 1e-4 && (o.x[2] - 0.62).abs() < 1e-4, "{:?}", o.x);
    let q = quantise(&s, &o, &[Some(0.5), Some(0.5)]);
    // (1.5, 0.5) passes the limit; (1.0, 0.5) costs 0.151, (1.5, 0) 0.401, (1, 1) passes it.
    assert!(q.feasible && q.x[1..] == [1.0, 0.5], "{:?}", q.x);
    let free = quantise(&s, &o, &[None, Some(0.25)]);
    assert!(free.x[1] == o.x[1] && free.x[2] == 0.5, "{:?}", free.x);
    let wide = setting(vec![&fuel, &sum], vec![upper(1, 3.0)], 3);
    assert_eq!(quantise(&wide, &o, &[Some(0.5), Some(0.5)]).x[1..], [1.5, 0.5]);
}
