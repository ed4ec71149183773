//! The regressor windows that a record within its bounds can show, as a finite set that majorises them.
//!
//! A regressor vector phi is a polynomial of the samples in its window. A sample that no regressor squares enters
//! every entry of phi affinely; one that is squared enters through the pair (x, x^2), which lies in the triangles
//! spanned by the parabola's chords and tangents over a few cells. Any convex function of phi, say phi' W phi, is
//! then convex in each sample (or pair) while the others stay, so that its largest value over all windows is at most
//! its largest value over the finite product of end points and triangle corners.

use super::NoCertificate;
use dynocal_ident::model::poly::{PolyNarx, Source};
use dynocal_numerics::rng::Rng64;

/// One sample of the window: the points (x, x^2 or its bound) that stand for its range.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub(super) points: Vec<(f64, f64)>,
}

/// Product set of points.
#[derive(Clone, Debug)]
pub(super) struct Windows {
    pub(super) samples: Vec<Sample>,
    /// Per regressor: (sample, whether squared).
    terms: Vec<Vec<(usize, bool)>>,
}

/// Most multiplications of one pass over all windows.
const MOST_WORK: f64 = 2.5e9;
/// Cells that a squared range is cut into, the finest that can be afforded.
const CELLS: [usize; 6] = [8, 6, 4, 3, 2, 1];

impl Windows {
    /// Windows of `model` for input ranges `inputs` (m) and an output in `output`.
    pub(super) fn new(
        model: &PolyNarx,
        inputs: &[(f64, f64)],
        output: (f64, f64),
    ) -> Result<Self, NoCertificate> {
        let mut places: Vec<(Source, usize)> = model.regressors().iter().flat_map(|r| r.reads()).collect();
        places.sort_unstable();
        places.dedup();
        let mut squared = vec![false; places.len()];
        let mut terms = Vec::new();
        for (k, r) in model.regressors().iter().enumerate() {
            let name = || model.regressor_texts()[k].clone();
            if !r.functions().is_empty() {
                return Err(NoCertificate::Regressor { regressor: name(), what: "is not a polynomial" });
            }
            if r.reads_output() && (r.degree() != 1) {
                return Err(NoCertificate::Regressor {
                    regressor: name(),
                    what: "feeds the output back in a product",
                });
            }
            let mut term = Vec::new();
            for f in r.factors() {
                if f.power > 2 {
                    return Err(NoCertificate::Regressor {
                        regressor: name(),
                        what: "has a power above two",
                    });
                }
                let at = places.partition_point(|p| *p < (f.source, f.lag));
                squared[at] |= f.power == 2;
                term.push((at, f.power == 2));
            }
            terms.push(term);
        }
        let range = |source| match source {
            Source::Input(i) => inputs[i],
            Source::Output => output,
        };
        let of = |cells: usize| -> Self {
            let samples = places.iter().zip(&squared).map(|((source, _), squared)| Sample {
                points: points(range(*source), if *squared { cells } else { 0 }),
            });
            Self { samples: samples.collect(), terms: terms.clone() }
        };
        let p = terms.len() as f64;
        CELLS
            .iter()
            .map(|cells| of(*cells))
            .find(|w| w.size() * p * p <= MOST_WORK)
            .ok_or_else(|| NoCertificate::Windows { samples: places.len(), windows: of(1).size() })
    }

    /// Number of windows.
    pub(super) fn size(&self) -> f64 {
        self.samples.iter().map(|s| s.points.len() as f64).product()
    }

    /// Regressors of the window with the point `at[i]` for sample i.
    pub(super) fn row(&self, at: &[usize], row: &mut [f64]) {
        for (v, term) in row.iter_mut().zip(&self.terms) {
            *v = term.iter().fold(1.0, |x, (i, squared)| {
                let (first, second) = self.samples[*i].points[at[*i]];
                x * if *squared { second } else { first }
            });
        }
    }

    /// Points of window number `index`.
    pub(super) fn decode(&self, mut index: usize, at: &mut [usize]) {
        for (a, s) in at.iter_mut().zip(&self.samples) {
            *a = index % s.points.len();
            index /= s.points.len();
        }
    }

    /// The next window.
    pub(super) fn advance(&self, at: &mut [usize]) {
        for (a, s) in at.iter_mut().zip(&self.samples) {
            *a += 1;
            if *a < s.points.len() {
                return;
            }
            *a = 0;
        }
    }
}

impl Windows {
    /// A window drawn at random.
    pub(super) fn random(&self, rng: &mut Rng64) -> Vec<usize> {
        self.samples.iter().map(|s| rng.below(s.points.len())).collect()
    }

    /// Largest size of every regressor, 1 where it is zero throughout.
    pub(super) fn scale(&self) -> Vec<f64> {
        let most = |(i, squared): &(usize, bool)| {
            let size = |v: &(f64, f64)| if *squared { v.1.abs() } else { v.0.abs() };
            self.samples[*i].points.iter().map(size).fold(0.0, f64::max)
        };
        let of = |term: &Vec<(usize, bool)>| term.iter().map(most).product::<f64>();
        self.terms.iter().map(|t| if of(t) > 0.0 { of(t) } else { 1.0 }).collect()
    }
}

/// End points, or for a squared sample the corners of the triangles over `cells` cells.
fn points((low, high): (f64, f64), cells: usize) -> Vec<(f64, f64)> {
    if low == high {
        return vec![(low, low * low)];
    }
    if cells == 0 {
        return vec![(low, low * low), (high, high * high)];
    }
    let node = |i: usize| low + (high - low) * i as f64 / cells as f64;
    let on_curve = (0..=cells).map(|i| (node(i), node(i) * node(i)));
    let tangents = (0..cells).map(|i| (0.5 * (node(i) + node(i + 1)), node(i) * node(i + 1)));
    on_curve.chain(tangents).collect()
}
