//! A trade-off over all cells of a map: what is minimised against another response.
//!
//! ```text
//! minimise   (1 - s) F / |F0| + s G / |G0|      F = sum_k w_k [m_k(x_k) + caution sd_k(x_k)],  G = sum_k w_k g_k(x_k)
//! subject to the limits of every cell, as in `cell`
//! ```
//!
//! w is the share of time of a cell; F0 and G0 are those of the map that minimises F alone. The cells have nothing in common but s:
//! each is solved by itself, from where its neighbours on the front have it, with exact gradients and Hessians. At equal s one unit of
//! G costs the same in every cell, so that no other share-out of G over the cells costs less.
//!
//! The next s is normal to the longest chord of the front so far, until a chord has nothing below it. Parts of a front that bulge
//! towards the origin are found; what lies in a dent is no optimum of a weighted sum and is left out.
//!
//! Reference: J. L. Cohon, Multiobjective Programming and Planning, Academic Press 1978, chapter 6 (noninferior set estimation).

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cell::{CellOptimum, Setting};

/// Which trade-off is traced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrontSpec {
    /// The other response: an output of the plant, a derived channel or a driven input.
    pub against: String,
    /// Points of the front.
    #[serde(default = "nine")]
    pub points: usize,
    /// Share of the other response of the map of the least objective, at which the maps are taken; that map itself where it is not
    /// there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub take: Option<f64>,
}

fn nine() -> usize {
    9
}

/// A point of a front: a whole map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// s.
    pub share: f64,
    /// Mean over the cells of what is minimised, weighted by their shares of time.
    pub minimised: f64,
    /// The same of the other response.
    pub other: f64,
    /// What one unit less of the other response costs here; at the other end, where nearly nothing else is minimised, without meaning.
    pub price: f64,
    /// The cells, in their units.
    #[serde(skip)]
    pub cells: Vec<CellOptimum>,
}

/// A traced front.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Front {
    /// The other response.
    pub against: String,
    /// Its unit.
    pub unit: String,
    /// Points, least of what is minimised first.
    pub points: Vec<FrontPoint>,
    /// The point that the maps are taken from; none where that of the least objective stays, or where `take` is out of reach.
    pub taken: Option<FrontPoint>,
}

/// Models, cells and weights of a trade-off.
pub struct Tradeoff<'a, 'b> {
    /// Models with limits.
    pub setting: &'a Setting<'b>,
    /// Number of the other response.
    pub against: usize,
    /// Cells as they are where F alone is minimised.
    pub cells: Vec<CellOptimum>,
    /// Shares of time of the cells; they need no sum.
    pub weights: Vec<f64>,
    /// Seed of the starts.
    pub seed: u64,
}

/// s at the other end: F still decides between settings of equal G.
const LAST: f64 = 0.999;
/// Gain of a new point over its chord that is none, as a share of F0 and G0.
const STRAIGHT: f64 = 1e-5;
/// Distance from the asked value of the other response that is none, as its share.
const NEAR: f64 = 1e-3;
/// Halvings of s on the way to it.
const HALVINGS: usize = 25;

impl<'b> Tradeoff<'_, 'b> {
    /// The mean of a quantity over the cells.
    fn mean(&self, cells: &[CellOptimum], of: impl Fn(&CellOptimum) -> f64) -> f64 {
        let total: f64 = self.weights.iter().sum();
        cells.iter().zip(&self.weights).map(|(c, w)| w * of(c)).sum::<f64>() / total
    }

    fn other(&self, cells: &[CellOptimum]) -> f64 {
        self.mean(cells, |c| c.responses[self.against])
    }

    /// |F0| and |G0|.
    fn scales(&self) -> [f64; 2] {
        let (f, g) = (self.mean(&self.cells, |c| c.objective), self.other(&self.cells));
        [f, g].map(|v| v.abs().max(f64::MIN_POSITIVE))
    }

    /// The same models and limits with the weighted sum at `share` as what is minimised.
    pub fn weighted(&self, share: f64) -> Setting<'b> {
        let ([f, g], s) = (self.scales(), self.setting);
        let mut weights: Vec<f64> = s.weights.iter().map(|w| w * (1.0 - share) / f).collect();
        weights[self.against] += share / g;
        Setting { models: s.models.clone(), weights, sides: s.sides.clone(), ranges: s.ranges.clone(), ..*s }
    }

    /// An optimum of the weighted sum with objective and prices in the units of what is minimised.
    pub fn in_units(&self, share: f64, o: &CellOptimum) -> CellOptimum {
        let unit = if share < 1.0 { self.scales()[0] / (1.0 - share) } else { 0.0 };
        let saves: Vec<f64> = o.prices.iter().map(|p| p.saves * unit).collect();
        self.setting.judge(&o.x, o.status, Some(&saves))
    }

    fn point(&self, share: f64, cells: Vec<CellOptimum>) -> FrontPoint {
        let [f, g] = self.scales();
        FrontPoint {
            share,
            minimised: self.mean(&cells, |c| c.objective),
            other: self.other(&cells),
            price: share / (1.0 - share) * f / g,
            cells,
        }
    }

    /// The map at `share`, cells started where `warm` has them; no cell is worse than the best of these.
    fn solve(&self, share: f64, warm: &[&FrontPoint], interrupt: &(dyn Fn() -> bool + Sync)) -> FrontPoint {
        let weighted = self.weighted(share);
        let one = |k: usize| {
            let starts: Vec<Vec<f64>> = warm.iter().map(|p| p.cells[k].x.clone()).collect();
            let at = &self.cells[k].x[..weighted.axes];
            let mut best = weighted.optimise(at, 1, &starts, self.seed, &|| interrupt());
            for x in &starts {
                let there = weighted.judge(x, best.status, None);
                if weighted.better(&there, &best) {
                    best = there;
                }
            }
            self.in_units(share, &best)
        };
        self.point(share, (0..self.cells.len()).into_par_iter().map(one).collect())
    }

    /// At most `count` points of the front.
    pub fn trace(&self, count: usize, interrupt: &(dyn Fn() -> bool + Sync)) -> Vec<FrontPoint> {
        // The cells may have been smoothed at a cost.
        let first = self.solve(0.0, &[&self.point(0.0, self.cells.clone())], interrupt);
        let last = self.solve(LAST, &[&first], interrupt);
        let ([f, g], mut points) = (self.scales(), vec![first, last]);
        // Chords with nothing below them, by the s of their left end.
        let mut straight: Vec<f64> = Vec::new();
        while points.len() < count && !interrupt() {
            let rise = |k: usize| (points[k + 1].minimised - points[k].minimised) / f;
            let fall = |k: usize| (points[k].other - points[k + 1].other) / g;
            let open = (0..points.len() - 1)
                .filter(|k| !straight.contains(&points[*k].share) && rise(*k) > 0.0 && fall(*k) > 0.0);
            let Some(k) = open.max_by(|a, b| rise(*a).hypot(fall(*a)).total_cmp(&rise(*b).hypot(fall(*b))))
            else {
                break;
            };
            let share = rise(k) / (rise(k) + fall(k));
            let (a, b) = (&points[k], &points[k + 1]);
            let value = |p: &FrontPoint| (1.0 - share) * p.minimised / f + share * p.other / g;
            let inside = a.share < share && share < b.share;
            let new = self.solve(share, &[a, b], interrupt);
            if !inside || value(&new) > value(a) - STRAIGHT {
                straight.push(a.share);
                continue;
            }
            points.insert(k + 1, new);
        }
        points
    }

    /// The map of the least objective whose other response is `target` at most; none where the front does not reach it.
    pub fn at_most(
        &self,
        target: f64,
        front: &[FrontPoint],
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Option<FrontPoint> {
        let after = front.iter().position(|p| p.other <= target)?;
        if after == 0 {
            return Some(front[0].clone());
        }
        let (mut a, mut b) = (front[after - 1].clone(), front[after].clone());
        for _ in 0..HALVINGS {
            if interrupt() || target - b.other <= NEAR * target.abs() {
                break;
            }
            let middle = self.solve(0.5 * (a.share + b.share), &[&a, &b], interrupt);
            if middle.other <= target { b = middle } else { a = middle }
        }
        Some(b)
    }
}
