//! Labels that enter linearly: sparse least squares with smoothness, limits and whole steps.

pub mod huber;
mod normal;
mod open;
mod rounds;
mod verdict;

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::correlation;
use crate::error::LabelError;
use crate::label::{Label, Limit};
use crate::qp;
use crate::quantise::{self, Steps};
use crate::rows::Rows;
use normal::Normal;
pub use open::Open;
use rounds::{Rounds, change, residuals, rounds};

/// Most cells in one fit: the equations are held dense.
pub const MOST_CELLS: usize = 4000;

/// What is fitted to what.
pub struct Problem<'a> {
    /// Labels; their cells are numbered one after the other.
    pub labels: &'a [Label],
    /// A row for each sample.
    pub rows: &'a Rows,
    /// What each row shall give.
    pub target: &'a [f64],
    /// Weight of each sample; none for 1.
    pub weights: Option<&'a [f64]>,
    /// Ranges of samples that follow each other in time; none where samples do not depend on each other.
    pub segments: Vec<Range<usize>>,
    /// What each cell may do; empty: all are fitted where data reach them.
    pub roles: Vec<Role>,
    /// Least and greatest value of single cells, in place of those of their label; empty: none.
    pub bounds: Vec<Option<[f64; 2]>>,
}

/// What a cell may do in a fit.
#[derive(Clone, Debug, PartialEq)]
pub enum Role {
    /// It is fitted.
    Fitted,
    /// It keeps its base.
    Held,
    /// Its change is this sum of the changes of fitted cells.
    Follows(Vec<(usize, f64)>),
}

impl<'a> Problem<'a> {
    /// A problem with independent samples of weight 1.
    pub fn new(labels: &'a [Label], rows: &'a Rows, target: &'a [f64]) -> Self {
        Self {
            labels,
            rows,
            target,
            weights: None,
            segments: Vec::new(),
            roles: Vec::new(),
            bounds: Vec::new(),
        }
    }

    /// A sum over cells as one over free cells: cells that follow stand for those that they follow.
    fn over_free(
        &self,
        map: &[Option<usize>],
        terms: impl Iterator<Item = (usize, f64)>,
    ) -> Vec<(usize, f64)> {
        let mut out: Vec<(usize, f64)> = Vec::new();
        let mut add = |cell: usize, v: f64| {
            let Some(f) = map[cell] else { return };
            match out.iter_mut().find(|t| t.0 == f) {
                Some(t) => t.1 += v,
                None => out.push((f, v)),
            }
        };
        for (k, v) in terms {
            match self.roles.get(k) {
                Some(Role::Follows(of)) => of.iter().for_each(|(j, w)| add(*j, v * w)),
                _ => add(k, v),
            }
        }
        out
    }
}

/// How it is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Weight of the roughness, where 1 gives it as much as the data; none: by generalised cross-validation.
    pub smooth: Option<f64>,
    /// Roughness of the change from the base (true) or of the values.
    pub smooth_change: bool,
    /// Samples far outside count less (Huber's loss at 1.345 robust standard deviations).
    pub robust: bool,
    /// Cells with fewer samples than this keep their base.
    pub least_visits: f64,
    /// Cells without data follow their neighbours instead. Where gradients or curvature are limited they follow anyway: at their base
    /// they would hold cells with data.
    pub extrapolate: bool,
    /// Draws that the intervals come from where a function is too large for its equations to be held, at most 16; without any it
    /// has no intervals.
    pub draws: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            smooth: None,
            smooth_change: true,
            robust: false,
            least_visits: 1.0,
            extrapolate: false,
            draws: 8,
        }
    }
}

/// What the data say of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// One independent measurement at the cell itself or more, and they outweigh what ties it to its neighbours and its base.
    Determined,
    /// Data reach it, but weigh less: neighbours, smoothness and base say the rest.
    Pulled,
    /// No data: it keeps its base, or follows its neighbours where that was asked for.
    Untouched,
    /// Locked.
    Locked,
    /// Only a sum with other cells, or a product, is known: a change of all of them together that nothing tells anything of.
    Open,
}

/// A fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Values of all cells, in whole steps where the label has steps.
    pub values: Vec<f64>,
    /// The same before rounding.
    pub exact: Vec<f64>,
    /// Half width of the 95 % interval of each cell; infinite where there are no data.
    #[serde(skip)]
    pub half_width: Vec<f64>,
    /// Samples at each cell, by their interpolation weights.
    pub visits: Vec<f64>,
    /// Independent measurements at each cell itself, correlated samples counted as what they are worth.
    pub facts: Vec<f64>,
    /// What the data say.
    pub verdicts: Vec<Verdict>,
    /// Weight of the roughness.
    pub smooth: f64,
    /// Standard deviation of one sample around the fit.
    pub sigma: f64,
    /// Samples that say as much as one independent one.
    pub correlation_samples: f64,
    /// Parameters that the fit effectively has.
    pub effective_parameters: f64,
    /// Root mean square of target less function, with the base and with the exact values.
    pub rms: [f64; 2],
    /// Limits that hold the fit, in words.
    pub held: Vec<String>,
    /// Limits that the base breaks among cells that are not fitted.
    pub broken: Vec<String>,
    /// Whether whole steps were proven best; none without steps.
    pub proven: Option<bool>,
    /// Changes of the labels that nothing tells anything of.
    #[serde(skip)]
    pub open: Open,
}

/// First cell of each label, and the number of cells.
pub fn offsets(labels: &[Label]) -> (Vec<usize>, usize) {
    let mut sum = 0;
    let first = labels
        .iter()
        .map(|l| {
            let first = sum;
            sum += l.len();
            first
        })
        .collect();
    (first, sum)
}

/// Fits the labels.
///
/// # Errors
/// [`LabelError`]: labels that contradict themselves or each other, too few samples, numbers that are none.
pub fn fit(p: &Problem, options: &Options) -> Result<Fit, LabelError> {
    fit_at(p, options, None)
}

/// The same; with a place, that is taken for the best values and all the rest is told of it: the minimum of a function, of which the rows are
/// the derivatives there.
pub(crate) fn fit_at(p: &Problem, options: &Options, place: Option<&[f64]>) -> Result<Fit, LabelError> {
    let (_, cells) = offsets(p.labels);
    check(p, cells)?;
    if !p.roles.iter().any(|r| matches!(r, Role::Follows(_))) {
        return fitted(p, options, cells, place);
    }
    // What follows stands for what it follows in every row.
    let mut rows = Rows::default();
    let alone: Vec<Option<usize>> = (0..cells).map(Some).collect();
    for k in 0..p.rows.len() {
        rows.start();
        let (at, w) = p.rows.row(k);
        let own = p.over_free(&alone, at.iter().copied().zip(w.iter().copied()));
        own.into_iter().for_each(|(j, w)| rows.push(j, w));
    }
    let base: Vec<f64> = p.labels.iter().flat_map(|l| l.base.iter().copied()).collect();
    // Their base stays where it is: only changes are passed on.
    let target: Vec<f64> =
        (0..p.target.len()).map(|k| p.target[k] - p.rows.times(k, &base) + rows.times(k, &base)).collect();
    let inner = Problem {
        rows: &rows,
        target: &target,
        segments: p.segments.clone(),
        roles: p.roles.clone(),
        bounds: p.bounds.clone(),
        ..*p
    };
    let mut found = fitted(&inner, options, cells, place)?;
    found.visits = verdict::visits(p, cells);
    taken_along(p, &base, &mut found);
    Ok(found)
}

/// Values of cells that follow.
fn taken_along(p: &Problem, base: &[f64], found: &mut Fit) {
    let (first, _) = offsets(p.labels);
    for (l, from) in p.labels.iter().zip(first) {
        for c in from..from + l.len() {
            let Some(Role::Follows(of)) = p.roles.get(c) else { continue };
            let moved = |v: &[f64]| of.iter().map(|(j, w)| w * (v[*j] - base[*j])).sum::<f64>();
            let exact = base[c] + moved(&found.exact);
            found.exact[c] = exact.clamp(l.lower.min(base[c]), l.upper.max(base[c]));
            found.values[c] = match l.step {
                Some(step) => l.origin + step * ((found.exact[c] - l.origin) / step).round(),
                None => found.exact[c],
            };
        }
    }
    if found.proven.is_some() {
        found.values = clean(p.labels, &found.values);
    }
}

fn fitted(p: &Problem, options: &Options, cells: usize, place: Option<&[f64]>) -> Result<Fit, LabelError> {
    let mut base: Vec<f64> = p.labels.iter().flat_map(|l| l.base.iter().copied()).collect();
    let visits = verdict::visits(p, cells);
    let locked: Vec<bool> = p.labels.iter().flat_map(|l| l.locked.iter().copied()).collect();
    let shaped: Vec<bool> =
        p.labels.iter().flat_map(|l| std::iter::repeat_n(l.is_shaped(), l.len())).collect();
    let free = |k: usize| {
        let told = options.extrapolate || shaped[k] || visits[k] >= options.least_visits.max(1e-9);
        !locked[k] && p.roles.get(k).is_none_or(|r| *r == Role::Fitted) && told
    };
    let map: Vec<Option<usize>> = {
        let mut count = 0;
        (0..cells)
            .map(|k| {
                free(k).then(|| {
                    count += 1;
                    count - 1
                })
            })
            .collect()
    };
    if let Some(place) = place {
        // What nothing depends on there has moved until nothing did.
        (0..cells).filter(|c| map[*c].is_none() && !locked[*c]).for_each(|c| base[c] = place[c]);
    }
    let weights: Vec<f64> = p.weights.map_or_else(|| vec![1.0; p.target.len()], <[f64]>::to_vec);
    let measured: Vec<f64> = (0..p.target.len()).map(|k| p.target[k] - p.rows.times(k, &base)).collect();
    let mut normal = Normal::new(p, &map, &base, &locked, options);
    let Rounds { offset, mut found, tau } = rounds(
        p,
        options,
        &map,
        &mut normal,
        (&measured, &weights),
        place.map(|place| change(place, &base, &map)),
    )?;
    let whole = |delta: &[f64]| -> Vec<f64> {
        (0..cells).map(|k| base[k] + map[k].map_or(0.0, |f| delta[f])).collect()
    };
    let (limits, broken) = limits(p, &map, &base);
    let open = open::find(&normal, found.smooth, &map);
    let h = normal.hessian(found.smooth);
    let mut solved = qp::solve(&h, &normal.right(found.smooth), &limits)?;
    if let Some(place) = place {
        let change = change(place, &base, &map);
        found.delta.iter_mut().zip(&change).zip(&solved.x).for_each(|((d, c), x)| *d += c - x);
        solved.x = change;
    }
    let held = solved.active.iter().map(|(k, _)| limits[*k].what.clone()).collect();
    let exact = whole(&solved.x);
    let squares = |delta: &[f64]| {
        let r = residuals(p, &map, &measured, delta);
        let sum: f64 = weights.iter().sum();
        (r.iter().zip(&weights).map(|(r, w)| w * r * r).sum::<f64>() / sum.max(1e-300)).sqrt()
    };
    let rms = [squares(&vec![0.0; solved.x.len()]), squares(&solved.x)];
    let steps = steps(p.labels, &map, &base);
    let (values, proven) = match steps.iter().any(Option::is_some) {
        true => {
            let (x, proven) = quantise::nearest(&h, &found.delta, &solved.x, &steps, &limits)?;
            (clean(p.labels, &whole(&x)), Some(proven))
        }
        false => (exact.clone(), None),
    };
    let cautious = normal.solve(p, &map, &offset, &weights, tau, Some(found.cautious))?;
    let residuals = residuals(p, &map, &offset, &found.delta);
    let (_, window) = correlation::time_and_window(&residuals, &p.segments);
    let correlated = verdict::Correlated { tau, window, residuals };
    let h_cautious = normal.hessian(found.cautious);
    let mut told =
        verdict::tell(p, &weights, &normal, &h_cautious, &cautious, &correlated, &map, &locked, &visits)?;
    // The interval reaches as far as that of the cautious fit, which lies elsewhere.
    for (half, f) in told.half_width.iter_mut().zip(&map) {
        *half += f.map_or(0.0, |f| (found.delta[f] - cautious.delta[f]).abs());
    }
    let ranges = p.labels.iter().flat_map(|l| std::iter::repeat_n(l.upper - l.lower, l.len()));
    for (half, range) in told.half_width.iter_mut().zip(ranges) {
        // Wider than what the cell may be at all is not known.
        if *half > range {
            *half = f64::INFINITY;
        }
    }
    for (k, half) in told.half_width.iter_mut().enumerate() {
        // A cell that only the limits of others move is not known to any width.
        if visits[k] <= 0.0 && !options.extrapolate && !locked[k] {
            *half = f64::INFINITY;
        }
    }
    let mut fit = Fit {
        values,
        exact,
        half_width: told.half_width,
        visits,
        facts: told.facts,
        verdicts: told.verdicts,
        smooth: found.smooth,
        sigma: told.sigma,
        correlation_samples: tau,
        effective_parameters: found.parameters,
        rms,
        held,
        broken,
        proven,
        open,
    };
    fit.mark_open();
    Ok(fit)
}

impl Fit {
    /// Cells along open directions have no interval.
    pub(crate) fn mark_open(&mut self) {
        for cell in (0..self.open.len()).flat_map(|k| self.open.cells(k)).collect::<Vec<_>>() {
            self.half_width[cell] = f64::INFINITY;
            if matches!(self.verdicts[cell], Verdict::Determined | Verdict::Pulled) {
                self.verdicts[cell] = Verdict::Open;
            }
        }
    }
}

/// Why nothing is fitted: no samples, or no label that they tell of.
fn nothing_told(p: &Problem, samples: usize) -> LabelError {
    if samples == 0 {
        return LabelError::TooFew { found: 0, expected: 1 };
    }
    let open = p.labels.iter().filter(|l| !l.locked.iter().all(|l| *l));
    LabelError::NothingTold {
        samples,
        labels: open.map(|l| format!("`{}`", l.name)).collect::<Vec<_>>().join(", "),
    }
}

fn check(p: &Problem, cells: usize) -> Result<(), LabelError> {
    p.labels.iter().try_for_each(Label::check)?;
    if cells > MOST_CELLS {
        return Err(LabelError::TooLarge { found: cells, most: MOST_CELLS });
    }
    let n = p.target.len();
    if n == 0 || p.rows.len() != n {
        return Err(LabelError::TooFew { found: n.min(p.rows.len()), expected: 1 });
    }
    let finite = |k: usize| p.target[k].is_finite() && p.rows.row(k).1.iter().all(|w| w.is_finite());
    if let Some(index) = (0..n).find(|k| !finite(*k)) {
        return Err(LabelError::NotFinite { what: "measurements", index });
    }
    match p.weights.and_then(|w| w.iter().position(|v| !(*v >= 0.0 && v.is_finite()))) {
        Some(index) => Err(LabelError::NotFinite { what: "weights", index }),
        None => Ok(()),
    }
}

/// What holds a cell with bounds of its own, in words.
pub const NEIGHBOURS: &str = "a cell that is held at the change of its neighbours";

/// Limits of the free cells as changes from the base, and those that the base breaks where nothing is free.
fn limits(p: &Problem, map: &[Option<usize>], base: &[f64]) -> (Vec<Limit>, Vec<String>) {
    let (first, _) = offsets(p.labels);
    let (mut out, mut broken) = (Vec::new(), Vec::new());
    for (l, from) in p.labels.iter().zip(first) {
        for limit in l.limits() {
            let now: f64 = limit.terms.iter().map(|(k, c)| c * base[from + k]).sum();
            let terms = p.over_free(map, limit.terms.iter().map(|(k, c)| (from + k, *c)));
            let size = limit.terms.iter().map(|(k, c)| (c * base[from + k]).abs()).fold(1e-9, f64::max);
            match terms.is_empty() {
                true if now < limit.least - 1e-9 * size => broken.push(limit.what),
                true => {}
                false => out.push(Limit { terms, least: limit.least - now, what: limit.what }),
            }
        }
        for k in 0..l.len() {
            let Some(f) = map[from + k] else { continue };
            let own = p.bounds.get(from + k).copied().flatten();
            let [lower, upper] = own.unwrap_or([l.lower, l.upper]);
            let what = |side: &str, v: f64| match own {
                Some(_) => format!("`{}`: {NEIGHBOURS}", l.name),
                None => format!("`{}`: {side} value {v} {}", l.name, l.unit),
            };
            if lower.is_finite() {
                out.push(Limit {
                    terms: vec![(f, 1.0)],
                    least: lower - base[from + k],
                    what: what("least", lower),
                });
            }
            if upper.is_finite() {
                let terms = vec![(f, -1.0)];
                out.push(Limit { terms, least: base[from + k] - upper, what: what("greatest", upper) });
            }
        }
    }
    (out, broken)
}

/// Steps of the free cells, as changes from the base.
fn steps(labels: &[Label], map: &[Option<usize>], base: &[f64]) -> Vec<Option<Steps>> {
    let (first, _) = offsets(labels);
    let mut out = Vec::new();
    for (l, from) in labels.iter().zip(first) {
        for k in (0..l.len()).filter(|k| map[from + k].is_some()) {
            out.push(l.step.map(|step| Steps { step, origin: l.origin - base[from + k] }));
        }
    }
    out
}

/// Whole steps without what rounding leaves of them: 7 steps of 0.1 are 0.7.
fn clean(labels: &[Label], values: &[f64]) -> Vec<f64> {
    let (first, _) = offsets(labels);
    let mut out = values.to_vec();
    for (l, from) in labels.iter().zip(first) {
        let Some(step) = l.step else { continue };
        let decimals = (0..10).find(|d| (step * 10f64.powi(*d)).fract().abs() < 1e-9).unwrap_or(10) as usize;
        for (k, v) in out[from..from + l.len()].iter_mut().enumerate() {
            if *v != l.base[k] {
                *v = format!("{:.decimals$}", *v).parse().unwrap_or(*v);
            }
        }
    }
    out
}
