//! Candidate pools for structure selection.

use crate::model::poly::Regressor;

/// All products of 1 to `degree` of the given variables, repetition allowed: first the variables themselves, then
/// the products of two, and so on; each product once.
pub fn products(variables: &[Regressor], degree: u32) -> Vec<Regressor> {
    let mut all = Vec::new();
    // Each entry carries the place of its last variable, so that every product is built in one order only.
    let mut level: Vec<(Regressor, usize)> =
        if degree == 0 { Vec::new() } else { variables.iter().cloned().zip(0..).collect() };
    for d in 1..=degree {
        let next = if d == degree {
            Vec::new()
        } else {
            let grow = |(r, last): &(Regressor, usize)| {
                let (r, last) = (r.clone(), *last);
                (last..variables.len()).map(move |i| (r.times(&variables[i]), i)).collect::<Vec<_>>()
            };
            level.iter().flat_map(grow).collect()
        };
        all.extend(level.into_iter().map(|(r, _)| r));
        level = next;
    }
    dedup(all)
}

/// Removes later copies, keeps the order.
pub fn dedup(mut regressors: Vec<Regressor>) -> Vec<Regressor> {
    let mut seen = std::collections::BTreeSet::new();
    regressors.retain(|r| seen.insert(r.clone()));
    regressors
}

/// What a pool holds, over the inputs of one model.
#[derive(Clone, Debug, Default)]
pub struct PoolSpec {
    /// Lagged inputs (input, lag) whose products of degree 1 and 2 are candidates.
    pub lagged: Vec<(usize, usize)>,
    /// Lagged inputs whose products of degree 3 are candidates as well.
    pub cubic: Vec<(usize, usize)>,
    /// Output lags that enter alone.
    pub output_lags: Vec<usize>,
    /// Lagged inputs that multiply each of these output lags.
    pub output_times: Vec<(usize, usize)>,
}

impl PoolSpec {
    /// The candidates: constant, degree 1 and 2, degree 3 of the chosen ones, output lags alone and multiplied.
    pub fn candidates(&self) -> Vec<Regressor> {
        let inputs = |pairs: &[(usize, usize)]| -> Vec<Regressor> {
            pairs.iter().map(|&(i, lag)| Regressor::input(i, lag)).collect()
        };
        let mut pool = vec![Regressor::constant()];
        pool.extend(products(&inputs(&self.lagged), 2));
        pool.extend(products(&inputs(&self.cubic), 3).into_iter().filter(|r| r.degree() == 3));
        for &lag in &self.output_lags {
            let y = Regressor::output(lag);
            pool.extend(inputs(&self.output_times).iter().map(|r| r.times(&y)));
            pool.push(y);
        }
        dedup(pool)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_of_products_is_binomial() {
        let v: Vec<Regressor> = (0..6).map(|i| Regressor::input(i, 1)).collect();
        // Multisets of size d from n: C(n + d - 1, d).
        assert_eq!(products(&v, 1).len(), 6);
        assert_eq!(products(&v, 2).len(), 6 + 21);
        assert_eq!(products(&v, 3).len(), 6 + 21 + 56);
        assert_eq!(products(&v, 0).len(), 0);
    }

    #[test]
    fn pool_has_each_candidate_once() {
        let spec = PoolSpec {
            lagged: vec![(0, 1), (0, 2), (1, 1)],
            cubic: vec![(0, 1), (1, 1)],
            output_lags: vec![1, 2],
            output_times: vec![(0, 1)],
        };
        let pool = spec.candidates();
        assert_eq!(pool.len(), 1 + 3 + 6 + 4 + 2 * 2);
        assert_eq!(dedup(pool.clone()), pool);
    }
}
