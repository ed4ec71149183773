//! Linear models out of records about a set point, with the uncertainty of their parameters.
//!
//! `A y = sum_i B_i u_i + C e` (ARMAX) by prediction errors, of deviations from the means of the record: a plant that bends has
//! another mean while it is moved than at rest, and a model without a constant would give what is left of it to a pole slower than
//! the record. The orders are the first ones of a list, from few parameters to many, whose
//! free run over the second half of the record, fitted on the first (blocks in turns where a test moves one input after the other, so that
//! every input moves in both), is not worse than the best one's by more than a standard error: more
//! parameters than the record asks for give factors that A, B and C have in common, anywhere, and gains at rest that mean nothing. The
//! model that is given is then fitted on all of the record. What chose the orders is no unseen data.
//!
//! A disturbance that goes on by itself (the ripple of an engine's cycle seen at its samples, a drift) is told by 1/A, the noise of these
//! models: poles on the circle that B has to cancel, and never does quite. A model whose A rings for longer than the record shows is left
//! out, and one that creeps as long wherever one that does not leaves no more than twice as much: a plant that integrates is not taken for
//! a drift.

use dynocal_ident::estimate::pem::Pem;
use dynocal_ident::experiment::Experiment;
use dynocal_ident::linear::fit_linear;
use dynocal_ident::model::linear::LinearModel;
use dynocal_ident::stored::{Quantity, StoredModel};
use dynocal_ident::validate::{Kind, Seen};

use crate::error::ControlError;

/// Orders of A and B that are compared, from few parameters to many.
pub const ORDERS: [(usize, usize); 6] = [(1, 4), (2, 8), (3, 12), (4, 16), (4, 24), (6, 24)];
/// Stretches of the second half whose means say how sure a difference is.
const STRETCHES: usize = 10;
/// Samples before anything is scored.
const INIT: usize = 40;
/// Time constant of a pole, as a share of the half that chooses, from which the record does not show that it fades.
const LASTING: f64 = 0.2;
/// Mean squared error of a model that comes to rest over that of one that creeps, up to which it is preferred.
const CREEPS: f64 = 2.0;

/// Most blocks of a record that are fitted and judged in turns.
const BLOCKS: usize = 64;
/// Share of an input's movement in the blocks that have more of it, below which the others show nothing of that input.
const STILL: f64 = 0.01;

/// A model of one output.
#[derive(Clone, Debug)]
pub struct Identified {
    /// With the covariance of its parameters.
    pub model: StoredModel,
    /// Orders of A and B.
    pub orders: (usize, usize),
    /// Free run over the half that chose the orders, in percent of the output's variance; at most 0: worse than no model.
    pub selection_r2: f64,
}

/// Orders with what their free run left of the second half.
struct Tried {
    orders: (usize, usize),
    r2: f64,
    /// Mean squared error of each stretch.
    left: Vec<f64>,
    lasting: Lasting,
}

/// Whether a model goes on by itself for longer than the record shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Lasting {
    No,
    Creeps,
    Rings,
}

/// What the poles of `A` do over `rows` samples.
fn lasting(a: &[f64], rows: usize) -> Lasting {
    let most = (-1.0 / (LASTING * rows as f64)).exp();
    // Roots in z^-1.
    let poles = crate::poly::roots(a).unwrap_or_default();
    let one = |z: &dynocal_numerics::fft::Complex<f64>| match z.norm() * most < 1.0 {
        false => Lasting::No,
        true if z.re > 0.0 && z.im.abs() < 1.0 / (LASTING * rows as f64) => Lasting::Creeps,
        true => Lasting::Rings,
    };
    poles.iter().map(one).max().unwrap_or(Lasting::No)
}

/// Without models that go on by themselves, where there are others that are as good.
fn settled(tried: Vec<Tried>) -> Vec<Tried> {
    let least = |of: &dyn Fn(&Tried) -> bool| {
        let each = tried.iter().filter(|t| of(t)).map(|t| t.left.iter().sum::<f64>());
        each.reduce(f64::min)
    };
    let (rests, creeps) = (least(&|t| t.lasting == Lasting::No), least(&|t| t.lasting == Lasting::Creeps));
    let most = match (rests, creeps) {
        (Some(r), Some(c)) if r > CREEPS * c => Lasting::Creeps,
        (None, Some(_)) => Lasting::Creeps,
        (Some(_), _) => Lasting::No,
        // Nothing else there is: what is left says so by its margins.
        (None, None) => Lasting::Rings,
    };
    tried.into_iter().filter(|t| t.lasting <= most).collect()
}

/// The first one that is not worse than the best by more than a standard error of the difference over the stretches.
fn simplest(tried: &[Tried]) -> Option<&Tried> {
    let best = tried.iter().max_by(|a, b| a.r2.total_cmp(&b.r2))?;
    tried.iter().find(|t| {
        let more: Vec<f64> = t.left.iter().zip(&best.left).map(|(a, b)| a - b).collect();
        let n = more.len() as f64;
        let mean = more.iter().sum::<f64>() / n;
        let variance = more.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0);
        mean <= (variance / n).sqrt()
    })
}

/// A column without its mean.
fn centred(x: &[f64]) -> Vec<f64> {
    let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
    x.iter().map(|v| v - mean).collect()
}

/// Blocks of which every other one is fitted, the rest judges: two halves, where they will do. A test that moves one input after the other
/// leaves halves that each know nothing of an input of the other: then the fewest by which every input moves in both parts. Halves again
/// where no number does that.
fn blocks(columns: &[Vec<f64>]) -> usize {
    let rows = columns.first().map_or(0, Vec::len);
    let moves = |x: &[f64], blocks: usize, from: usize| -> f64 {
        let own = (from..blocks).step_by(2).map(|k| {
            let x = &x[k * rows / blocks..(k + 1) * rows / blocks];
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            x.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
        });
        own.sum()
    };
    let in_both = |blocks: usize| {
        columns.iter().all(|x| {
            let (a, b) = (moves(x, blocks, 0), moves(x, blocks, 1));
            a.min(b) >= STILL * a.max(b)
        })
    };
    let counts = (1..).map(|n| 2 * n).take_while(|n| *n <= BLOCKS && (*n == 2 || rows / n >= 4 * INIT));
    counts.into_iter().find(|n| in_both(*n)).unwrap_or(2)
}

/// Model of `output` from `inputs` (columns about a point of rest), its orders among `orders` ([`ORDERS`]).
///
/// # Errors
/// [`ControlError::Model`]: a record too short, or one that no model of the list fits.
pub fn identify(
    inputs: &[(Quantity, Vec<f64>)],
    output: (Quantity, &[f64]),
    sample_time_s: f64,
    orders: &[(usize, usize)],
    stop: &dyn Fn() -> bool,
) -> Result<Identified, ControlError> {
    let (quantity, y) = output;
    let (rows, m) = (y.len(), inputs.len());
    let refused = |text: String| ControlError::Model(format!("a model of `{}`: {text}", quantity.name));
    if rows < 8 * INIT {
        return Err(refused(format!("the record has {rows} samples, expected {} at least", 8 * INIT)));
    }
    let (columns, y): (Vec<Vec<f64>>, _) = (inputs.iter().map(|i| centred(&i.1)).collect(), centred(y));
    let u: Vec<f64> = (0..rows * m).map(|k| columns[k % m][k / m]).collect();
    let part = |from: usize, to: usize| Experiment {
        name: "record".into(),
        u: u[m * from..m * to].to_vec(),
        y: y[from..to].to_vec(),
        init_samples: INIT,
        weights: vec![],
    };
    let blocks = blocks(&columns);
    let turns = |from: usize| -> Vec<Experiment> {
        let all = (from..blocks).step_by(2);
        all.map(|k| part(k * rows / blocks, (k + 1) * rows / blocks)).collect()
    };
    let (first, second) = (turns(0), turns(1));
    let names: Vec<&str> = inputs.iter().map(|(q, _)| q.name.as_str()).collect();
    let structure = |(na, nb): (usize, usize)| LinearModel::armax(&names, &quantity.name, na, nb, na, 0);
    let mut tried: Vec<Tried> = Vec::new();
    // A quarter of the samples at most are parameters.
    for orders in orders.iter().copied().filter(|(na, nb)| 4 * (2 * na + m * nb) < rows / 2) {
        let Ok(fit) = fit_linear(&structure(orders), &first, &Pem::default(), stop) else { continue };
        let r2 = 100.0 * fit.score(&second, Kind::FreeRun, Seen::Selection).r2;
        let errors = second.iter().flat_map(|e| {
            let run = fit.output(e, Kind::FreeRun);
            e.y.iter().zip(run).skip(INIT).map(|(y, p)| (y - p).powi(2)).collect::<Vec<f64>>()
        });
        let errors: Vec<f64> = errors.collect();
        let length = errors.len().div_ceil(STRETCHES);
        let left = errors.chunks(length).map(|c| c.iter().sum::<f64>() / c.len() as f64).collect();
        if r2.is_finite() {
            let a = structure(orders).polynomials(&fit.fit.theta).a;
            tried.push(Tried { orders, r2, left, lasting: lasting(&a, rows / 2) });
        }
    }
    let mut tried = settled(tried);
    if stop() {
        return Err(refused("interrupted".into()));
    }
    let (orders, selection_r2, found) = loop {
        let Some(&Tried { orders, r2, lasting: as_chosen, .. }) = simplest(&tried) else {
            return Err(refused("none of the orders could be fitted".into()));
        };
        let found = fit_linear(&structure(orders), &[part(0, rows)], &Pem::default(), stop)
            .map_err(|e| refused(e.to_string()))?;
        // On all of the record the fit may take up what it did not on the half.
        let a = structure(orders).polynomials(&found.fit.theta).a;
        if tried.len() == 1 || lasting(&a, rows) <= as_chosen {
            break (orders, r2, found);
        }
        tried.retain(|t| t.orders != orders);
    };
    let quantities = inputs.iter().map(|(q, _)| q.clone()).collect();
    let mut model =
        StoredModel::new(structure(orders), &found.fit.theta, quantities, quantity.clone(), sample_time_s)
            .map_err(|e| refused(e.to_string()))?;
    for (p, s) in model.parameters.iter_mut().zip(&found.fit.std_errors) {
        p.std_error = s.is_finite().then_some(*s);
    }
    model.correlate(&found.fit.covariance);
    Ok(Identified { model, orders, selection_r2 })
}
