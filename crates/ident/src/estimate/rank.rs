//! What a deficient rank of the Jacobian means, in words.

use dynocal_numerics::linalg::{PivotedR, dot};

use super::covariance::Rows;

/// A sentence for parameters that the rows do not determine, with the combination of others that each equals.
pub(super) fn rank_warning(factor: &PivotedR, names: &[String], theta: &[f64], rows: Rows) -> Option<String> {
    let p = names.len();
    if factor.dependent.is_empty() {
        return None;
    }
    let which =
        (factor.rank..p).map(|place| combination(factor, names, place, rows)).collect::<Vec<_>>().join("; ");
    let place = match rows {
        Rows::Regressors => "on these data",
        Rows::Sensitivities => "near this estimate",
    };
    let then = if factor.dependent.iter().all(|k| theta[*k] == 0.0) {
        "their parameters are set to zero, the others stand for them"
    } else {
        "only what these parameters do together is known, none of them alone"
    };
    Some(format!("rank {} of {p}: {place} {which}; {then}", factor.rank))
}

/// `name = 2 first - 0.5 second` for the column at `place` of the order: R11^-1 R12 in the columns' own scale.
fn combination(factor: &PivotedR, names: &[String], place: usize, rows: Rows) -> String {
    let (p, rank) = (names.len(), factor.rank);
    let dependent = factor.order[place];
    let name = &names[dependent];
    let mut x: Vec<f64> = (0..rank).map(|i| factor.r[i * p + place]).collect();
    for i in (0..rank).rev() {
        let row = &factor.r[i * p..i * p + rank];
        x[i] = (x[i] - dot(&row[i + 1..], &x[i + 1..])) / row[i];
    }
    // In unit columns: what is left out is rounding.
    let parts: Vec<usize> = (0..rank).filter(|i| x[*i].abs() > 1e-6).collect();
    let what = match rows {
        Rows::Regressors => "the regressor of",
        Rows::Sensitivities => "the effect of",
    };
    if parts.is_empty() {
        return format!("{what} `{name}` is zero throughout");
    }
    let term = |(position, &i): (usize, &usize)| {
        let k = factor.order[i];
        let coefficient = x[i] * factor.scale[dependent] / factor.scale[k];
        let sign = match (position, coefficient < 0.0) {
            (0, false) => "",
            (0, true) => "-",
            (_, false) => " + ",
            (_, true) => " - ",
        };
        let size = format!("{:.4e}", coefficient.abs()).parse::<f64>().unwrap_or(coefficient.abs());
        if size == 1.0 { format!("{sign}`{}`", names[k]) } else { format!("{sign}{size} `{}`", names[k]) }
    };
    const SHOWN: usize = 5;
    let mut text: String = parts.iter().take(SHOWN).enumerate().map(term).collect();
    if parts.len() > SHOWN {
        text += &format!(" and {} more", parts.len() - SHOWN);
    }
    format!("{what} `{name}` equals {text}")
}
