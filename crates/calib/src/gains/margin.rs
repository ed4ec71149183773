//! PI gains of several loops on a linear model, and their margins.

use dynocal_ident::pi::PiGains;
use dynocal_ident::plan::PlanLoop;
use dynocal_numerics::fft::Complex;
use serde::{Deserialize, Serialize};

use super::fit::Linear;
use super::{TuneError, TuneSpec};

/// Margins of one loop with the others open.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopMargin {
    /// Output.
    pub output: String,
    /// Input.
    pub input: String,
    /// Factor by which the gains may grow; none: any.
    pub gain_margin: Option<f64>,
    /// Phase margin in deg; none: the loop gain never reaches 1.
    pub phase_margin_deg: Option<f64>,
    /// Largest |1 / (1 + g c)|.
    pub sensitivity: f64,
}

/// Gains with their margins on every model.
pub(super) struct Found {
    pub(super) loops: Vec<PlanLoop>,
    pub(super) margins: Vec<Margins>,
    pub(super) detuned: f64,
}

/// Margins on one model.
pub(super) struct Margins {
    pub(super) loops: Vec<LoopMargin>,
    pub(super) log_modulus_db: f64,
}

/// Frequencies at which loops are looked at.
const FREQUENCIES: usize = 600;
/// Share of a response that may still come in its last quarter: what comes after it is cut.
const UNSETTLED: f64 = 0.1;
/// Growth of F from one look to the next, and most looks.
const DETUNE: (f64, usize) = (1.08, 90);

/// Gains of each loop alone on one model.
pub(super) fn alone(linear: &Linear, loops: &[PlanLoop]) -> Result<Vec<PiGains>, TuneError> {
    loops.iter().enumerate().map(|(k, l)| simc(linear, k, l)).collect()
}

/// The smallest gains of each loop over several points.
pub(super) fn least<'a>(
    loops: &[PlanLoop],
    points: impl Iterator<Item = &'a [PiGains]>,
) -> Result<Vec<PiGains>, TuneError> {
    let mut least: Vec<Option<PiGains>> = vec![None; loops.len()];
    let smaller = |a: f64, b: f64| if a.abs() <= b.abs() { a } else { b };
    for gains in points {
        for ((so_far, g), l) in least.iter_mut().zip(gains).zip(loops) {
            *so_far = Some(match *so_far {
                None => *g,
                Some(s) if s.ki * g.ki > 0.0 => PiGains { kp: smaller(s.kp, g.kp), ki: smaller(s.ki, g.ki) },
                Some(_) => {
                    let reason =
                        "the answer of the output changes its sign between the operating points".into();
                    return Err(TuneError::NoAnswer {
                        output: l.output.clone(),
                        input: l.input.clone(),
                        reason,
                    });
                }
            });
        }
    }
    Ok(least.into_iter().flatten().collect())
}

/// The largest gains `start / F` with the margins of `spec` on all `models`, F at least `least`.
pub(super) fn detuned(
    models: &[&Linear],
    start: &[PiGains],
    loops: &[PlanLoop],
    spec: &TuneSpec,
    least: f64,
) -> Result<Found, TuneError> {
    let grids: Vec<Grid> = models.iter().map(|m| Grid::new(m)).collect();
    let most_db = spec.log_modulus_db * loops.len() as f64;
    let mut detuned = least.max(1.0);
    for _ in 0..DETUNE.1 {
        let gains: Vec<PiGains> =
            start.iter().map(|g| PiGains { kp: g.kp / detuned, ki: g.ki / (detuned * detuned) }).collect();
        let margins: Vec<Margins> = grids.iter().map(|g| g.margins(loops, &gains)).collect();
        let sound = |m: &Margins| {
            m.log_modulus_db <= most_db && m.loops.iter().all(|l| l.sensitivity <= spec.sensitivity)
        };
        if margins.iter().all(sound) && models.iter().all(|m| settles(m, &gains)) {
            let closed = |(l, gains): (&PlanLoop, PiGains)| PlanLoop { gains, closed: true, ..l.clone() };
            let loops = loops.iter().zip(gains).map(closed).collect();
            return Ok(Found { loops, margins, detuned });
        }
        detuned *= DETUNE.0;
    }
    Err(TuneError::NoAnswer {
        output: loops.iter().map(|l| l.output.as_str()).collect::<Vec<_>>().join("`, `"),
        input: loops.iter().map(|l| l.input.as_str()).collect::<Vec<_>>().join("`, `"),
        reason: format!(
            "none keep {most_db} dB of log modulus and a sensitivity of {}, made smaller by a factor {detuned:.0}",
            spec.sensitivity
        ),
    })
}

/// Gains of one loop alone, from the step of its own channel.
fn simc(linear: &Linear, k: usize, l: &PlanLoop) -> Result<PiGains, TuneError> {
    let dt = linear.sample_time_s;
    let step = linear.step(k, k);
    let n = step.len();
    let end = step[n - 1];
    let refused = |reason: String| {
        Err(TuneError::NoAnswer { output: l.output.clone(), input: l.input.clone(), reason })
    };
    // What scatter leaves of the last quarter is no movement: twice the standard error of the steady effect.
    let unsettled = UNSETTLED.max(2.0 * linear.doubt);
    if !(end.is_finite() && end != 0.0) || (end - step[n - n / 4]).abs() > unsettled * end.abs() {
        return refused(format!("the identified step response does not settle (it ends at {end:.3e})"));
    }
    let reaches = |share: f64| {
        let t = step.iter().position(|y| y / end >= share).unwrap_or(n - 1);
        let (before, after) = (step[t.saturating_sub(1)] / end, step[t] / end);
        let within = if after > before { (share - before) / (after - before) } else { 1.0 };
        (t as f64 - 1.0 + within) * dt
    };
    let (t28, t63) = (reaches(0.283), reaches(0.632));
    let lag_s = (1.5 * (t63 - t28)).max(0.1 * dt);
    // The hold delays by half a sample.
    let dead_s = (t63 - lag_s).max(dt) + 0.5 * dt;
    let kp = lag_s / (2.0 * end * dead_s);
    Ok(PiGains { kp, ki: kp / lag_s.min(8.0 * dead_s) })
}

/// Whether the loops come to rest on the model after a unit error.
fn settles(linear: &Linear, gains: &[PiGains]) -> bool {
    let n_loops = gains.len();
    let (dt, lags) = (linear.sample_time_s, linear.b[0][0].len());
    let slowest = gains.iter().map(|g| (g.kp / g.ki).abs()).fold(0.0, f64::max);
    let n = ((60.0 * slowest / dt) as usize).clamp(4 * lags, 20_000);
    let (mut y, mut u) = (vec![vec![0.0; n]; n_loops], vec![vec![0.0; n]; n_loops]);
    let mut integral = vec![0.0; n_loops];
    for t in 0..n {
        for o in 0..n_loops {
            let of_input = |(b, u): (&Vec<f64>, &Vec<f64>)| {
                b.iter().zip(u[..t].iter().rev()).map(|(b, u)| b * u).sum::<f64>()
            };
            y[o][t] = linear.b[o].iter().zip(&u).map(of_input).sum();
        }
        for o in 0..n_loops {
            let e = 1.0 - y[o][t];
            integral[o] += gains[o].ki * e * dt;
            u[o][t] = gains[o].kp * e + integral[o];
        }
    }
    y.iter().all(|y| y[n - n / 10..].iter().all(|v| (v - 1.0).abs() < 0.05))
}

/// Frequency responses of the model.
struct Grid {
    /// exp(i w dt) at each frequency.
    z: Vec<Complex<f64>>,
    /// Model by frequency, output, input.
    g: Vec<Vec<Vec<Complex<f64>>>>,
    sample_time_s: f64,
}

impl Grid {
    fn new(linear: &Linear) -> Self {
        let at = |k: usize| {
            // Four decades up to half the sampling frequency, which is left out: PI and hold are real there.
            let angle = std::f64::consts::PI * 10f64.powf(-4.0 + 4.0 * (k as f64 + 0.5) / FREQUENCIES as f64);
            Complex::new(angle.cos(), angle.sin())
        };
        let z: Vec<Complex<f64>> = (0..FREQUENCIES).map(at).collect();
        let g = z.iter().map(|z| response(linear, *z)).collect();
        Self { z, g, sample_time_s: linear.sample_time_s }
    }

    /// `kp + ki dt z / (z - 1)`: the integral holds the present error already.
    fn pi(&self, w: usize, gains: PiGains) -> Complex<f64> {
        let z = self.z[w];
        Complex::new(gains.kp, 0.0)
            + Complex::new(gains.ki * self.sample_time_s, 0.0) * z / (z - Complex::new(1.0, 0.0))
    }

    fn margins(&self, loops: &[PlanLoop], gains: &[PiGains]) -> Margins {
        let own = loops.iter().zip(gains).enumerate().map(|(k, (l, g))| self.margin(k, l, *g));
        Margins { loops: own.collect(), log_modulus_db: self.log_modulus_db(gains) }
    }

    fn log_modulus_db(&self, gains: &[PiGains]) -> f64 {
        let n = gains.len();
        let one = |w: usize| {
            let c: Vec<Complex<f64>> = gains.iter().map(|g| self.pi(w, *g)).collect();
            let mut m: Vec<Vec<Complex<f64>>> =
                (0..n).map(|o| (0..n).map(|i| self.g[w][o][i] * c[i]).collect()).collect();
            (0..n).for_each(|o| m[o][o] += Complex::new(1.0, 0.0));
            let whole = determinant(m);
            20.0 * ((whole - Complex::new(1.0, 0.0)).norm() / whole.norm()).log10()
        };
        (0..self.z.len()).map(one).fold(f64::NEG_INFINITY, f64::max)
    }

    fn margin(&self, k: usize, l: &PlanLoop, gains: PiGains) -> LoopMargin {
        let open: Vec<Complex<f64>> =
            (0..self.z.len()).map(|w| self.g[w][k][k] * self.pi(w, gains)).collect();
        let one = Complex::new(1.0, 0.0);
        let sensitivity = open.iter().map(|l| 1.0 / (one + *l).norm()).fold(0.0, f64::max);
        // Between two frequencies the curve is taken as straight.
        let crossing =
            |w: usize, share: f64| open[w - 1] + Complex::new(share, 0.0) * (open[w] - open[w - 1]);
        let mut largest: f64 = 0.0;
        let mut phase: Option<f64> = None;
        for w in 1..open.len() {
            let (a, b) = (open[w - 1], open[w]);
            if (a.im > 0.0) != (b.im > 0.0) {
                let at = crossing(w, a.im / (a.im - b.im));
                largest = largest.max(-at.re);
            }
            if (a.norm() > 1.0) != (b.norm() > 1.0) {
                let at = crossing(w, (1.0 - a.norm()) / (b.norm() - a.norm()));
                let margin = (180.0 - at.im.atan2(at.re).to_degrees().abs()).abs();
                phase = Some(phase.map_or(margin, |p: f64| p.min(margin)));
            }
        }
        LoopMargin {
            output: l.output.clone(),
            input: l.input.clone(),
            gain_margin: (largest > 0.0).then(|| 1.0 / largest),
            phase_margin_deg: phase,
            sensitivity,
        }
    }
}

fn response(linear: &Linear, z: Complex<f64>) -> Vec<Vec<Complex<f64>>> {
    let back = Complex::new(z.re, -z.im);
    let sum = |values: &[f64]| {
        let mut power = Complex::new(1.0, 0.0);
        let mut sum = Complex::new(0.0, 0.0);
        for v in values {
            power *= back;
            sum += power * v;
        }
        sum
    };
    linear.b.iter().map(|inputs| inputs.iter().map(|b| sum(b)).collect()).collect()
}

/// By elimination with the largest pivot of each column.
fn determinant(mut m: Vec<Vec<Complex<f64>>>) -> Complex<f64> {
    let n = m.len();
    let mut product = Complex::new(1.0, 0.0);
    for k in 0..n {
        let pivot = (k..n).max_by(|a, b| m[*a][k].norm().total_cmp(&m[*b][k].norm())).unwrap_or(k);
        if m[pivot][k].norm() == 0.0 {
            return Complex::new(0.0, 0.0);
        }
        if pivot != k {
            m.swap(pivot, k);
            product = Complex::new(0.0, 0.0) - product;
        }
        product *= m[k][k];
        for i in k + 1..n {
            let share = m[i][k] / m[k][k];
            for j in k..n {
                m[i][j] = m[i][j] - share * m[k][j];
            }
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;

    /// g = b z^-delay / (1 - a z^-1), a first-order lag with dead time, until nothing is left of it.
    fn lag(sample_time_s: f64, a: f64, delay: usize, b: f64) -> Linear {
        let response = (1..1500).map(|k| if k < delay { 0.0 } else { b * a.powi((k - delay) as i32) });
        Linear { sample_time_s, b: vec![vec![response.collect()]], doubt: 0.0 }
    }

    /// P control of a first-order lag is stable until b kp = 1 + a.
    #[test]
    fn the_gain_margin_of_a_sampled_lag_is_analytic() {
        let l = PlanLoop::closed("y", "u", PiGains { ki: 0.0, kp: 0.0 });
        for (a, b, kp) in [(0.9, 0.2, 1.0), (0.5, 0.5, 0.7), (0.0, 1.0, 0.25)] {
            let m = Grid::new(&lag(0.1, a, 1, b)).margin(0, &l, PiGains { ki: 0.0, kp });
            // The curve ends at half the sampling frequency, just before the axis: gain there by its real part.
            let exact = (1.0 + a) / (b * kp);
            let largest =
                Grid::new(&lag(0.1, a, 1, b)).g.iter().map(|g| -g[0][0].re * kp).fold(0.0, f64::max);
            assert!((1.0 / largest / exact - 1.0).abs() < 1e-3, "{largest} {exact}");
            assert!(m.gain_margin.is_none_or(|g| (g / exact - 1.0).abs() < 1e-2), "{m:?}");
        }
    }

    /// Integral control of a pure delay of d samples, L = ki dt z^(1-d) / (z - 1): |L| = 1 where 2 sin(w/2) = ki dt, the phase
    /// there is -90 deg - (d - 1/2) w.
    #[test]
    fn the_phase_margin_of_an_integrator_with_delay_is_analytic() {
        let l = PlanLoop::closed("y", "u", PiGains { ki: 0.0, kp: 0.0 });
        for (d, share) in [(1usize, 0.3), (3, 0.2), (6, 0.1)] {
            let linear = lag(0.1, 0.0, d, 1.0);
            let m = Grid::new(&linear).margin(0, &l, PiGains { ki: share / 0.1, kp: 0.0 });
            let w = 2.0 * (share / 2.0f64).asin();
            let exact = 90.0 - (d as f64 - 0.5) * w.to_degrees();
            assert!((m.phase_margin_deg.unwrap() - exact).abs() < 0.1, "{m:?} {exact}");
            // Crosses the axis where (d - 1/2) w = 90 deg.
            let w = std::f64::consts::FRAC_PI_2 / (d as f64 - 0.5);
            if w < std::f64::consts::PI {
                let exact = 2.0 * (w / 2.0).sin() / share;
                assert!((m.gain_margin.unwrap() / exact - 1.0).abs() < 1e-2, "{m:?} {exact}");
            }
        }
    }

    #[test]
    fn determinants_of_known_matrices() {
        let c = |re: f64, im: f64| Complex::new(re, im);
        let m = vec![vec![c(0.0, 0.0), c(2.0, 0.0)], vec![c(0.0, 3.0), c(1.0, 1.0)]];
        assert!((determinant(m) - c(0.0, -6.0)).norm() < 1e-12);
        let identity = vec![vec![c(1.0, 0.0), c(5.0, 2.0)], vec![c(0.0, 0.0), c(0.0, 1.0)]];
        assert!((determinant(identity) - c(0.0, 1.0)).norm() < 1e-12);
    }

    /// A loop alone: what is found keeps its margins, and the model settles with it.
    #[test]
    fn gains_of_known_lags_keep_their_margins() {
        let spec = TuneSpec::default();
        for (a, delay, gain) in [(0.5f64, 1usize, 3.0), (0.9, 4, -0.02), (0.97, 8, 40.0), (0.0, 5, 1.0)] {
            let linear = lag(0.03, a, delay, gain * (1.0 - a));
            let l = PlanLoop::closed("y", "u", PiGains { ki: 0.0, kp: 0.0 });
            let loops = [l];
            let start = alone(&linear, &loops).unwrap();
            let found = detuned(&[&linear], &start, &loops, &spec, 1.0).unwrap();
            let m = &found.margins[0].loops[0];
            assert!(found.margins[0].log_modulus_db <= 2.0 && m.sensitivity <= 2.0, "{m:?}");
            // A sensitivity of S gives a gain margin of S / (S - 1) and a phase margin of 2 asin(1 / 2 S) at least.
            assert!(
                m.gain_margin.is_none_or(|g| g >= 2.0 - 1e-2) && m.phase_margin_deg.unwrap() >= 28.9,
                "{m:?}"
            );
            assert!(found.loops[0].gains.ki * gain > 0.0 && found.detuned < 3.0, "{}", found.detuned);
        }
    }
}
