//! A model as the parameters of a search, and back.

use crate::fuelling::film::Film;
use crate::fuelling::{Fuelling, Timing};

/// Parameters of film, timing, the law of the coolant and the ends of the film, before those of the charge.
pub(super) const FILM: usize = 2;
pub(super) const TIMING: usize = 6;
const LAW: usize = 5;
const ENDS: usize = 4;

/// Without a share on the wall there is no film to search.
pub(super) fn has_film(f: &Fuelling) -> bool {
    f.film.share > 0.0
}

/// The half width of the temperatures: slopes are searched over it.
pub(super) fn half_k(f: &Fuelling) -> Option<f64> {
    f.coolant.map(|l| 0.5 * (l.range_c[1] - l.range_c[0]))
}

/// The parameters of a search: share (logit), tau, timing (logarithms where they are positive), law, ends of the film, cams, charge.
pub(super) fn given(f: &Fuelling) -> Vec<f64> {
    let t = &f.timing;
    let mut x = Vec::new();
    if has_film(f) {
        x.extend([(f.film.share / (1.0 - f.film.share)).ln(), f.film.tau_s.ln()]);
    }
    x.extend([t.charge_s, t.charge_cycles]);
    x.extend([t.transport_cycles, t.transport_fuel, t.mixing_fuel, t.sensor_lag_s].map(|v| v.max(1e-9).ln()));
    if let (Some(l), Some(half)) = (&f.coolant, half_k(f)) {
        let [by_speed, by_pressure] = l.charge_ends_per_k;
        x.extend([l.share_per_k, l.tau_per_k, l.charge_per_k, by_speed, by_pressure].map(|v| v * half));
    }
    x.extend(f.film_ends.iter().flat_map(|e| [e.share, e.tau]).flatten());
    if let Some(l) = &f.charge.cams {
        x.extend(l.given());
    }
    x.extend(&f.charge.coefficients);
    x
}

/// The reverse of [`given`].
pub(super) fn taken(x: &[f64], start: &Fuelling) -> Fuelling {
    let (film, x) = match has_film(start) {
        true => (Film { share: 1.0 / (1.0 + (-x[0]).exp()), tau_s: x[1].exp() }, &x[FILM..]),
        false => (start.film, x),
    };
    let timing = Timing {
        charge_s: x[0],
        charge_cycles: x[1],
        transport_cycles: x[2].exp(),
        transport_fuel: x[3].exp(),
        mixing_fuel: x[4].exp(),
        sensor_lag_s: x[5].exp(),
    };
    let mut from = TIMING;
    let mut coolant = start.coolant;
    if let (Some(l), Some(half)) = (&mut coolant, half_k(start)) {
        let at = |k: usize| x[TIMING + k] / half;
        [l.share_per_k, l.tau_per_k, l.charge_per_k] = [0, 1, 2].map(at);
        l.charge_ends_per_k = [3, 4].map(at);
        from += LAW;
    }
    let mut film_ends = start.film_ends;
    if let Some(e) = &mut film_ends {
        [e.share, e.tau] = [0, 2].map(|k| [x[from + k], x[from + k + 1]]);
        from += ENDS;
    }
    let mut charge = start.charge.clone();
    if let Some(l) = &mut charge.cams {
        from += l.take(&x[from..]);
    }
    charge.coefficients = x[from..].to_vec();
    Fuelling { film, film_ends, timing, coolant, charge, ..start.clone() }
}
