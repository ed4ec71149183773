//! Products of lagged variables.

use super::Regressor;

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
}
