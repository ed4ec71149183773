//! Search for the hyperparameters of a Gaussian process.

use dynocal_numerics::registry::{self, Member, MemberDoc, ParamDoc};
use dynocal_numerics::rng::Rng64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::super::points::Points;
use super::super::scaling::Scaling;
use super::super::transform::Transform;
use super::super::warp::WarpChoice;
use super::super::{Learn, Learnt, LeftOut, ResponseError, ResponseModel};
use super::kernel::Kernel;
use super::likelihood::{Problem, Work};
use super::mean::Mean;
use super::model::{GpModel, Hyperparameters, Stored, basis};
use super::newton::{Effort, maximise};
use super::noise::VaryingNoise;

pub(in super::super) const MEMBER: Member<dyn Learn> = Member {
    doc: MemberDoc {
        name: "gaussian_process",
        what: "Gaussian process with a length for each input and estimated noise",
        params: &[
            ParamDoc {
                name: "kernel",
                unit: "-",
                default: "\"auto\"",
                what: "squared_exponential, matern32, matern52, or auto: the first or the last by the likelihood",
            },
            ParamDoc {
                name: "mean",
                unit: "-",
                default: "\"linear\"",
                what: "zero, constant, linear or quadratic",
            },
            ParamDoc {
                name: "starts",
                unit: "-",
                default: "4",
                what: "starts of the search for each kernel",
            },
            ParamDoc { name: "seed", unit: "-", default: "0", what: "seed of the starts after the first" },
            ParamDoc {
                name: "noise",
                unit: "-",
                default: "\"constant\"",
                what: "constant, or varying: its logarithm is a smooth function of the inputs",
            },
            ParamDoc {
                name: "transform",
                unit: "-",
                default: "\"none\"",
                what: "none, or log: learnt is the logarithm of the output, so that its errors are relative",
            },
            ParamDoc {
                name: "warp",
                unit: "-",
                default: "\"none\"",
                what: "none; sqrt: inputs that are sizes (positive, not near zero) enter by their roots; asinh: all by their \
                       inverse hyperbolic sine, for responses that change faster at small inputs",
            },
            ParamDoc {
                name: "exact_points",
                unit: "-",
                default: "3000",
                what: "most points that are taken exactly",
            },
            ParamDoc {
                name: "inducing_points",
                unit: "-",
                default: "150",
                what: "most inducing points of the sparse process that more points ask for; 0 refuses instead",
            },
        ],
    },
    build: |keys| Ok(Box::new(registry::keys::<GaussianProcess>("gaussian_process", keys)?)),
};

/// Bounds of the lengths, in standard deviations of the input: below, neighbours are independent; above, the input
/// acts through the mean functions or not at all.
pub(super) const LENGTHS: [f64; 2] = [0.02, 300.0];
/// Bounds of the noise ratio g: below, the rounding of a variance of the response, some eps / sqrt(g) of that of the signal,
/// is no longer small beside the variance of the noise (at 1e-8 it is a ten-thousandth of it).
pub(super) const NOISE: [f64; 2] = [1e-8, 1e3];
/// From this length on an input counts as lost, and the search is started again with it at a moderate one.
const LOST: f64 = 50.0;
/// Lengths and noise ratios from which starts are drawn (in logarithms), and where the first start stands.
const START_LENGTHS: [f64; 2] = [0.4, 8.0];
const START_NOISE: [f64; 2] = [1e-4, 0.1];
const FIRST: [f64; 2] = [1.5, 0.01];
/// Most starts of the search.
const MOST_STARTS: usize = 1000;
/// Starts on more points are run on as many of them, and the best goes on with all.
const SCREEN: usize = 500;

/// Which correlation function is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KernelChoice {
    /// Squared exponential or Matern 5/2, whichever has the higher restricted likelihood.
    #[default]
    Auto,
    /// Squared exponential.
    SquaredExponential,
    /// Matern 3/2.
    Matern32,
    /// Matern 5/2.
    Matern52,
}

impl KernelChoice {
    fn kernels(self) -> &'static [Kernel] {
        match self {
            Self::Auto => &[Kernel::SquaredExponential, Kernel::Matern52],
            Self::SquaredExponential => &[Kernel::SquaredExponential],
            Self::Matern32 => &[Kernel::Matern32],
            Self::Matern52 => &[Kernel::Matern52],
        }
    }
}

/// How the noise depends on the inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseChoice {
    /// Not at all.
    #[default]
    Constant,
    /// Its logarithm is a smooth function of them.
    Varying,
}

/// Which transform of the output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputChoice {
    /// None.
    #[default]
    None,
    /// Logarithm.
    Log,
}

impl OutputChoice {
    pub(super) fn transform(self) -> Transform {
        match self {
            Self::None => Transform::None,
            Self::Log => Transform::BoxCox { power: 0.0 },
        }
    }
}

/// Turns of process and noise.
const TURNS: usize = 3;

/// Keys of a Gaussian process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GaussianProcess {
    /// Correlation function.
    pub kernel: KernelChoice,
    /// Mean functions.
    pub mean: Mean,
    /// Starts of the search for each kernel.
    pub starts: usize,
    /// Seed of the starts after the first.
    pub seed: u64,
    /// Whether the noise varies with the inputs.
    pub noise: NoiseChoice,
    /// Transform of the output.
    pub transform: OutputChoice,
    /// Warp of the inputs.
    pub warp: WarpChoice,
    /// Most points that are taken exactly.
    pub exact_points: usize,
    /// Most inducing points of a sparse process above that; 0 refuses instead.
    pub inducing_points: usize,
}

impl Default for GaussianProcess {
    fn default() -> Self {
        Self {
            kernel: KernelChoice::Auto,
            mean: Mean::Linear,
            starts: 4,
            seed: 0,
            noise: NoiseChoice::Constant,
            transform: OutputChoice::None,
            warp: WarpChoice::None,
            exact_points: 3000,
            inducing_points: 150,
        }
    }
}

impl Learn for GaussianProcess {
    fn learn(&self, points: &Points, interrupt: &dyn Fn() -> bool) -> Result<Learnt, ResponseError> {
        let q = self.mean.count(points.dim());
        points.check(q + points.dim() + 2, "a Gaussian process")?;
        if q > 1 {
            points.check_independent_as(&Scaling::warped(self.warp, points))?;
        }
        if !(1..=MOST_STARTS).contains(&self.starts) {
            let (key, found, expected) = ("starts", self.starts.to_string(), format!("1 to {MOST_STARTS}"));
            return Err(ResponseError::Key { model: "gaussian_process", key, found, expected });
        }
        let transform = self.transform.transform();
        let learnt = Points { y: transform.apply(&points.y)?, ..points.clone() };
        let (measured, points) = (&points.y, &learnt);
        let scaling = Scaling::warped(self.warp, points);
        let data = Scaled::new(&scaling, points, self.mean);
        let sparse = points.len() > self.exact_points;
        if sparse && self.inducing_points == 0 {
            return Err(ResponseError::Memory {
                model: "gaussian_process",
                points: points.len(),
                mebibytes: Work::bytes(points.len()) >> 20,
                most: self.exact_points,
                key: "exact_points",
            });
        }
        let none = || ResponseError::NoStart { model: "gaussian_process", output: points.output.clone() };
        let start = self.screen(&data, &points.inputs, interrupt).ok_or_else(none)?;
        if sparse {
            let mut learnt = self.finish_sparse(points, scaling, &data, &start, interrupt)?;
            left_out_of(transform, measured, points, &mut learnt.left_out);
            return Ok(learnt);
        }
        let mut best = polish(&data.problem(start.kernel), &start, interrupt).ok_or_else(none)?;
        let mut noise = None;
        if self.noise == NoiseChoice::Varying {
            for _ in 0..TURNS {
                let learnt = data.noise(&best, noise.as_ref()).ok_or_else(none)?;
                let shape = data.noise_shape(Some(&learnt));
                let problem = Problem { noise_shape: &shape, ..data.problem(best.kernel) };
                best = polish(&problem, &best, interrupt).ok_or_else(none)?;
                noise = Some(learnt);
            }
        }
        let mut learnt = self.finish(points, scaling, data, best, noise)?;
        left_out_of(transform, measured, points, &mut learnt.left_out);
        Ok(learnt)
    }
}

/// Left-out residuals of a transformed output, in the unit of the measured one.
fn left_out_of(transform: Transform, measured: &[f64], points: &Points, left: &mut LeftOut) {
    if transform == Transform::None {
        return;
    }
    for (i, (y, g)) in measured.iter().zip(&points.y).enumerate() {
        let [back, slope, ..] = transform.inverse(g - left.residuals[i]);
        left.residuals[i] = y - back;
        left.variance[i] *= slope * slope;
    }
}

/// Points in scaled form.
pub(super) struct Scaled {
    pub(super) z: Vec<f64>,
    pub(super) columns: Vec<f64>,
    pub(super) y: Vec<f64>,
    pub(super) basis: Vec<f64>,
    pub(super) d: usize,
}

impl Scaled {
    pub(super) fn new(scaling: &Scaling, points: &Points, mean: Mean) -> Self {
        Self::of(scaling.inputs(points), scaling.outputs(points), points.dim(), mean)
    }

    fn of(z: Vec<f64>, y: Vec<f64>, d: usize, mean: Mean) -> Self {
        let columns = (0..d).flat_map(|j| z.iter().skip(j).step_by(d).copied()).collect();
        let basis = basis(mean, &z, d);
        Self { z, columns, y, basis, d }
    }

    pub(super) fn problem(&self, kernel: Kernel) -> Problem<'_> {
        Problem { kernel, columns: &self.columns, y: &self.y, basis: &self.basis, noise_shape: &[] }
    }

    /// Factors of the noise variance at the points; none for equal noise.
    fn noise_shape(&self, noise: Option<&VaryingNoise>) -> Vec<f64> {
        noise.map_or(Vec::new(), |noise| {
            self.z.chunks_exact(self.d).map(|z| noise.log_shape(z).exp()).collect()
        })
    }

    /// The noise that the left-out residuals show.
    fn noise(&self, at: &Found, before: Option<&VaryingNoise>) -> Option<VaryingNoise> {
        let shape = self.noise_shape(before);
        let problem = Problem { noise_shape: &shape, ..self.problem(at.kernel) };
        let (lengths, g) = (&at.theta[..self.d], at.theta[self.d].exp());
        let mut work = Work::new(self.y.len());
        let s2 = problem.likelihood(lengths, g, None, false, &mut work)?.signal_variance;
        let left = problem.leave_one_out(lengths, g, s2, &mut work)?;
        let own = |i: usize| s2 * g * shape.get(i).copied().unwrap_or(1.0);
        let response: Vec<f64> = (0..self.y.len()).map(|i| (left.variance[i] - own(i)).max(0.0)).collect();
        VaryingNoise::learn(&self.z, self.d, &left.residuals, &response)
    }

    /// A seeded choice of `count` points.
    fn subset(&self, count: usize, seed: u64, mean: Mean) -> Self {
        let mut rows: Vec<usize> = (0..self.y.len()).collect();
        let mut rng = Rng64::stream(seed, SUBSET);
        for i in 0..count.min(rows.len()) {
            let k = i + rng.below(rows.len() - i);
            rows.swap(i, k);
        }
        rows.truncate(count);
        rows.sort_unstable();
        let z = rows.iter().flat_map(|i| self.z[i * self.d..(i + 1) * self.d].iter().copied()).collect();
        Self::of(z, rows.iter().map(|i| self.y[*i]).collect(), self.d, mean)
    }
}

/// Streams of the generator.
const SUBSET: u64 = 1 << 32;
const STARTS: u64 = 2 << 32;

/// Where a search ended.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub(super) kernel: Kernel,
    pub(super) theta: Vec<f64>,
    pub(super) log_likelihood: f64,
    pub(super) evaluations: usize,
}

impl GaussianProcess {
    /// Starts of all kernels, coarsely, on at most `SCREEN` points; they run side by side and are not interrupted.
    fn screen(&self, data: &Scaled, names: &[String], interrupt: &dyn Fn() -> bool) -> Option<Found> {
        let part = (data.y.len() > SCREEN).then(|| data.subset(SCREEN, self.seed, self.mean));
        let coarse = part.as_ref().unwrap_or(data);
        let ends: Vec<Option<Found>> = self
            .kernels_and_starts(names)
            .into_par_iter()
            .map(|(kernel, start)| maximise(&coarse.problem(kernel), &start, Effort::Coarse, &|| false))
            .collect();
        // The first of equals, so that the order of the threads does not matter.
        let best = ends.into_iter().flatten().fold(None, better)?;
        Some(self.look_for_lost_inputs(coarse, best, interrupt))
    }

    /// An input at a very long length contributes nothing and its gradient has vanished: from there no search finds it
    /// again. Each such input is tried once at the length of the first start.
    fn look_for_lost_inputs(&self, data: &Scaled, best: Found, interrupt: &dyn Fn() -> bool) -> Found {
        (0..data.d).filter(|j| best.theta[*j] > LOST.ln()).fold(best.clone(), |best, j| {
            let mut start = best.theta.clone();
            start[j] = FIRST[0].ln();
            let again = maximise(&data.problem(best.kernel), &start, Effort::Coarse, interrupt);
            again.into_iter().fold(Some(best.clone()), better).unwrap_or(best)
        })
    }

    /// The first start is the same for all; the others are drawn from a stream of each input's place in the order of
    /// names, so that the order of the columns changes nothing.
    fn kernels_and_starts(&self, names: &[String]) -> Vec<(Kernel, Vec<f64>)> {
        let mut order: Vec<usize> = (0..names.len()).collect();
        order.sort_by(|a, b| names[*a].cmp(&names[*b]));
        let mut starts = vec![vec![FIRST[0].ln(); names.len()]; self.starts];
        let mut noise = vec![FIRST[1].ln(); self.starts];
        for s in 1..self.starts {
            let mut rng = Rng64::stream(self.seed, STARTS + s as u64);
            noise[s] = rng.uniform_in(START_NOISE[0].ln(), START_NOISE[1].ln());
            for j in &order {
                starts[s][*j] = rng.uniform_in(START_LENGTHS[0].ln(), START_LENGTHS[1].ln());
            }
        }
        let with_noise = starts.into_iter().zip(noise).map(|(mut l, g)| {
            l.push(g);
            l
        });
        let all: Vec<Vec<f64>> = with_noise.collect();
        self.kernel.kernels().iter().flat_map(|k| all.iter().map(|s| (*k, s.clone()))).collect()
    }

    fn finish(
        &self,
        points: &Points,
        scaling: Scaling,
        data: Scaled,
        best: Found,
        noise: Option<VaryingNoise>,
    ) -> Result<Learnt, ResponseError> {
        let none = || ResponseError::NoStart { model: "gaussian_process", output: points.output.clone() };
        let d = data.d;
        let (log_lengths, noise_ratio) = (best.theta[..d].to_vec(), best.theta[d].exp());
        let (left, signal_variance) = {
            let shape = data.noise_shape(noise.as_ref());
            let problem = Problem { noise_shape: &shape, ..data.problem(best.kernel) };
            let mut work = Work::new(points.len());
            let at =
                problem.likelihood(&log_lengths, noise_ratio, None, false, &mut work).ok_or_else(none)?;
            let left = problem.leave_one_out(&log_lengths, noise_ratio, at.signal_variance, &mut work);
            (left.ok_or_else(none)?, at.signal_variance)
        };
        let unit = scaling.output_std;
        let left_out = LeftOut {
            residuals: left.residuals.iter().map(|e| e * unit).collect(),
            variance: left.variance.iter().map(|v| v * unit * unit).collect(),
        };
        let mut notes = points.notes();
        notes.extend(lost_inputs(points, &log_lengths));
        let hyper = Hyperparameters { log_lengths, noise_ratio, signal_variance };
        let stored = Stored {
            scaling,
            transform: self.transform.transform(),
            kernel: best.kernel,
            mean: self.mean,
            hyper,
            noise,
            z: data.z,
            y: data.y,
        };
        let model = GpModel::build(stored)?;
        notes.push(format!(
            "{}; {} likelihoods were computed",
            super::super::Response::describe(&model),
            best.evaluations
        ));
        Ok(Learnt::new(ResponseModel::GaussianProcess(model), left_out, notes))
    }
}

/// The best point of a coarse search, finely on all points.
fn polish(problem: &Problem<'_>, from: &Found, interrupt: &dyn Fn() -> bool) -> Option<Found> {
    let fine = maximise(problem, &from.theta, Effort::Fine, interrupt)?;
    Some(Found { evaluations: fine.evaluations + from.evaluations, ..fine })
}

/// Sentences on inputs that change nothing.
pub(super) fn lost_inputs(points: &Points, log_lengths: &[f64]) -> Vec<String> {
    let lost = points.inputs.iter().zip(log_lengths).filter(|(_, l)| **l > LOST.ln());
    let words = lost.map(|(name, l)| {
        format!(
            "input `{name}` does not change `{}` beyond its trend: its length is {:.0} of its standard deviations",
            points.output,
            l.exp()
        )
    });
    words.collect()
}

fn better(best: Option<Found>, other: Found) -> Option<Found> {
    Some(match best {
        Some(best) if best.log_likelihood >= other.log_likelihood => best,
        _ => other,
    })
}
