//! What a designed record is worth: information, safety, coverage.

use dynocal_design::channel::Channel;
use dynocal_design::information::{Report, report};
use dynocal_design::problem::{DesignProblem, Evaluator};
use dynocal_ident::excitation::correlation::{InputCorrelation, correlation};
use dynocal_ident::excitation::coverage::{Coverage, PairCoverage, coverage, pair_coverage};
use dynocal_numerics::interval::Interval;

use super::loaded::Loaded;
use super::margins::{MarginUsed, band, distances};
use super::result::{
    Curves, InformationLine, LeastDistance, OutputCurve, Outside, ParameterBound, Quantity, SafetyLine,
};

/// Rank and bounds of each model with a criterion over the record that `e` has evaluated.
pub(super) fn information(problem: &DesignProblem, models: &[Loaded], e: &Evaluator) -> Vec<InformationLine> {
    let with = problem.terms.iter().zip(models).enumerate().filter(|(_, (t, _))| t.criterion.is_some());
    with.map(|(i, (term, m))| {
        let mut rows = e.sensitivities(i).to_vec();
        rows.extend_from_slice(term.prior);
        let p = term.model.n_params();
        let line = |rank, unseen, std: Option<Vec<f64>>| InformationLine {
            model: m.name.clone(),
            parameters: p,
            rank,
            unseen,
            bounds: (0..p)
                .map(|k| ParameterBound {
                    name: term.model.param_name(k),
                    value: m.theta[k],
                    least_std: std.as_ref().map(|s| s[k]),
                })
                .collect(),
        };
        match report(term.model, &rows, term.noise_variance, &[]) {
            Report::Regular(r) => line(p, Vec::new(), Some(r.crlb_std)),
            Report::Singular(s) => line(s.rank, s.unseen, None),
        }
    })
    .collect()
}

/// Predicted outputs with bands, and the safety report of the record `u`.
pub(super) fn safety(
    models: &[Loaded],
    margins: &[Option<MarginUsed>],
    units: &[Quantity],
    u: &[f64],
    outputs: Vec<Vec<f64>>,
    first: usize,
    dt_s: f64,
) -> (Curves, Vec<SafetyLine>) {
    let (mut lines, mut curves) = (Vec::new(), Vec::new());
    for (((m, margin), unit), mut y) in models.iter().zip(margins).zip(units).zip(outputs) {
        let covered = distances(m, u, &y, first);
        let half = margin.as_ref().map_or(vec![0.0; y.len()], |q| band(q, covered.as_ref(), y.len()));
        y[..first].fill(f64::NAN);
        let computed = || y.iter().enumerate().skip(first);
        let predicted = Interval::spanning(computed().map(|(_, v)| *v));
        let least = |with: &dyn Fn(usize) -> f64| {
            let l = m.limits.as_ref()?;
            // In the same order of operations as the search, so that both come to the same verdict to the last bit.
            computed()
                .map(|(t, y)| LeastDistance {
                    distance: ((l.upper - with(t)) - y).min(y - (l.lower + with(t))),
                    at_s: t as f64 * dt_s,
                })
                .min_by(|a, b| a.distance.total_cmp(&b.distance))
        };
        lines.push(SafetyLine {
            output: unit.clone(),
            predicted,
            limits: m.limits.as_ref().map(|l| Interval::new(l.lower, l.upper)),
            margin: *margin,
            least_distance: least(&|_| 0.0),
            least_distance_of_band: least(&|t| half[t]),
            outside: covered.map(|c| Outside { worst: c.worst, share: c.share_outside }),
        });
        curves.push(OutputCurve { predicted: y, half_width: half });
    }
    (Curves { u: u.to_vec(), outputs: curves }, lines)
}

/// Coverage and correlation of the channels.
pub(super) fn inputs(
    channels: &[Channel],
    u: &[f64],
) -> (Vec<Coverage>, Vec<PairCoverage>, Vec<InputCorrelation>) {
    let m = channels.len();
    let columns: Vec<Vec<f64>> = (0..m).map(|i| u.iter().skip(i).step_by(m).copied().collect()).collect();
    let of = |(c, v): (&Channel, &Vec<f64>)| {
        coverage(&c.name, v, c.given.is_none().then_some(Interval::new(c.lower, c.upper)))
    };
    let covered: Vec<Coverage> = channels.iter().zip(&columns).filter_map(of).collect();
    let (mut pairs, mut correlations) = (Vec::new(), Vec::new());
    for b in 1..covered.len() {
        for a in 0..b {
            pairs.push(pair_coverage(&covered[a], &covered[b], &columns[a], &columns[b]));
            let (x, y) =
                ((channels[a].name.as_str(), &columns[a][..]), (channels[b].name.as_str(), &columns[b][..]));
            correlations.extend(correlation(x, y, 30));
        }
    }
    (covered, pairs, correlations)
}
