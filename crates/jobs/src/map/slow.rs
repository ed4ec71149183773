//! A channel that is slower than a line: oil.
//!
//! Maps are for an engine that has come to rest, and oil is a minute and more behind whatever is done. Along a line at one speed that follows
//! one at another it is warmer or colder than it will be, and friction with it: an error that no loop and no way back shows. But the channel
//! is measured, and lines at many speeds tell where it goes:
//!
//! ```text
//! T(t + h) - T(t) = (1 - exp(-h/tau)) (phi(z)' theta - T(t))      phi: 1, z, z^2, products; tau by least squares along the lines
//! e = c + k (T - phi(z)' theta) / y                               at the begin of the first line, where all else rests ([`super::sweep`])
//! ```
//!
//! y: the leading demand; what friction takes of it is the same whatever it is, so that its share goes with 1 / y. That k is the same at all speeds is
//! an assumption: friction grows with speed, and what the rest shows at one end of the axis is too much or too little at the other, where the channel is
//! nearer to rest. k is taken where it is told from nothing with three standard errors, those of residuals that follow each other; that all else rests is not tested.

use dynocal_numerics::linalg::least_squares;

use super::windows::Window;

/// Where a slow channel goes, and how fast.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Slow {
    /// Its number among the responses.
    pub(super) response: usize,
    /// Time constant in s.
    pub(super) tau_s: f64,
    /// Middle and half width of each axis, and coefficients over them in shares of those.
    scale: Vec<[f64; 2]>,
    theta: Vec<f64>,
    /// The demand that leads, among the factors.
    demand: Option<usize>,
}

/// Windows over which a change is taken: one alone is mostly noise.
const STEP: usize = 5;
/// Time constants that are tried, from three steps on (what is faster is noise, or is behind by none), each longer by half.
const TAUS: usize = 11;
const FASTEST: f64 = 3.0;
/// Share of the changes that the law has to explain.
const SIGNAL: f64 = 0.5;
/// Standard errors from which on an effect is told from nothing.
const TOLD: f64 = 3.0;
/// Share of a rest in which other things than the slow channel come to rest.
const BEGIN: f64 = 0.25;
/// Fewest windows of a rest that tell an effect.
const FEWEST: usize = 8;

/// 1, z, z^2 and products of scaled axes.
fn terms(scale: &[[f64; 2]], at: &[f64]) -> Vec<f64> {
    let z: Vec<f64> = scale.iter().zip(at).map(|([middle, half], v)| (v - middle) / half).collect();
    let squares = (0..z.len()).flat_map(|i| (i..z.len()).map(move |j| (i, j)));
    let squares: Vec<f64> = squares.map(|(i, j)| z[i] * z[j]).collect();
    [vec![1.0], z, squares].concat()
}

impl Slow {
    /// From windows along lines over `axes`, one of which is the leading `demand`; none where they do not tell where the channel of response
    /// `response` goes.
    pub(super) fn learn(
        axes: &[Vec<f64>],
        demand: Option<usize>,
        response: usize,
        windows: &[Window],
    ) -> Option<Self> {
        let scale: Vec<[f64; 2]> = axes
            .iter()
            .map(|a| {
                let (first, last) = (a[0], a[a.len() - 1]);
                [0.5 * (first + last), (0.5 * (last - first).abs()).max(f64::MIN_POSITIVE)]
            })
            .collect();
        let n = axes.len();
        let one = |part: &[Window]| -> Option<(f64, f64, f64, Vec<f64>)> {
            let (a, b) = (&part[0], &part[STEP]);
            let h_s = b.row.at_s - a.row.at_s;
            let follows = a.line == b.line && h_s > 0.0 && h_s < 2.0 * STEP as f64 * a.way.window_s;
            let mean = |k: usize| part.iter().map(|w| w.row.factors[k]).sum::<f64>() / part.len() as f64;
            let at: Vec<f64> = (0..n).map(mean).collect();
            let of = |w: &Window| w.row.responses[response];
            follows.then(|| (h_s, of(a), of(b) - of(a), terms(&scale, &at)))
        };
        let steps: Vec<_> = windows.windows(STEP + 1).step_by(STEP).filter_map(one).collect();
        let (rows, cols) = (steps.len(), steps.first()?.3.len());
        if rows < 3 * cols {
            return None;
        }
        let least_s = steps.iter().map(|s| s.0).fold(f64::INFINITY, f64::min);
        let fit = |tau_s: f64| {
            let gain = |h_s: f64| 1.0 - (-h_s / tau_s).exp();
            let a: Vec<f64> = steps.iter().flat_map(|s| s.3.iter().map(|t| gain(s.0) * t)).collect();
            let b: Vec<f64> = steps.iter().map(|s| s.2 + gain(s.0) * s.1).collect();
            let found = least_squares(&a, rows, cols, &b, 0.0).ok()?;
            Some((found.residual_sum_squares, tau_s, found.x))
        };
        let fits = (0..TAUS).filter_map(|k| fit(FASTEST * least_s * 1.5_f64.powi(k as i32)));
        let (rest, tau_s, theta) = fits.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let changes: f64 = steps.iter().map(|s| s.2 * s.2).sum();
        // By degrees of freedom: few rows follow anything.
        let rest = rest / (rows - cols) as f64;
        (rest < (1.0 - SIGNAL) * changes / rows as f64).then_some(Self {
            response,
            tau_s,
            scale,
            theta,
            demand,
        })
    }

    /// How far the channel is from where it comes to rest at the axes of a window, over the leading demand.
    pub(super) fn away(&self, w: &Window) -> f64 {
        let at = &w.row.factors;
        let rests: f64 = terms(&self.scale, at).iter().zip(&self.theta).map(|(t, c)| t * c).sum();
        // A demand that is none has no share.
        let size = self.demand.map_or(1.0, |k| if at[k] > 0.0 { at[k] } else { f64::NAN });
        (w.row.responses[self.response] - rests) / size
    }

    /// What it does, from windows of the rest at the begin of a line with what each misses; none where that is not told from nothing.
    pub(super) fn effect(&self, rest: &[(&Window, f64)]) -> Option<f64> {
        let last_s = rest.iter().map(|(w, _)| w.way.since_s).fold(0.0, f64::max);
        let used: Vec<(f64, f64)> = rest
            .iter()
            .filter(|(w, e)| w.way.since_s >= BEGIN * last_s && e.is_finite())
            .map(|(w, e)| (self.away(w), *e))
            .collect();
        let n = used.len() as f64;
        if used.len() < FEWEST {
            return None;
        }
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| used.iter().map(of).sum::<f64>() / n;
        let (x, e) = (mean(&|p| p.0), mean(&|p| p.1));
        let spread: f64 = used.iter().map(|p| (p.0 - x).powi(2)).sum();
        let k = used.iter().map(|p| (p.0 - x) * (p.1 - e)).sum::<f64>() / spread;
        let left: Vec<f64> = used.iter().map(|p| p.1 - e - k * (p.0 - x)).collect();
        let rest: f64 = left.iter().map(|r| r * r).sum();
        // Windows under a loop are not independent.
        let next = left.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / rest;
        let fewer = ((1.0 + next) / (1.0 - next)).max(1.0);
        let error = (fewer * rest / (n - 2.0) / spread).sqrt();
        (k.abs() > TOLD * error).then_some(k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dynocal_calib::steady::station::SweepRow;
    use dynocal_calib::steady::trim::Way;
    use dynocal_numerics::rng::Rng64;

    const TAU_S: f64 = 60.0;

    /// Where oil comes to rest: with the speed, and a little with the torque.
    fn rests(torque: f64, speed: f64) -> f64 {
        360.0 + 0.012 * (speed - 1000.0) + 0.05 * torque
    }

    /// Oil behind that by 60 s along eight lines of 80 s, there and back from 40 to 160 Nm, after a rest of 60 s at the begin of the first; windows of 2 s.
    /// It is read with noise, and moves by `moves` of its way.
    fn windows(moves: f64) -> Vec<Window> {
        let mut rng = Rng64::new(4);
        let (mut oil, mut at_s, mut all) = (400.0, 0.0, Vec::new());
        for line in 0..8 {
            let speed = 1000.0 + 500.0 * line as f64;
            let rest = if line == 0 { 30 } else { 0 };
            for k in 0..rest + 40 {
                let (up, torque) = match k {
                    k if k < rest => (0.0, 40.0),
                    k if k < rest + 20 => (1.0, 43.0 + 6.0 * (k - rest) as f64),
                    k => (-1.0, 157.0 - 6.0 * (k - rest - 20) as f64),
                };
                oil += moves * (rests(torque, speed) - oil) * (1.0 - (-2.0 / TAU_S).exp());
                at_s += 2.0;
                let way = Way { up, since_s: 2.0 * k as f64, before_s: 0.0, window_s: 2.0 };
                let row = SweepRow {
                    factors: vec![torque, speed],
                    responses: vec![oil + 0.02 * rng.normal()],
                    asked: Vec::new(),
                    leg: 0,
                    at_end: Vec::new(),
                    followed: Vec::new(),
                    at_s,
                };
                all.push(Window { line, way, row });
            }
            // The way to the next line.
            at_s += 20.0;
        }
        all
    }

    fn axes() -> Vec<Vec<f64>> {
        vec![vec![40.0, 160.0], vec![1000.0, 4500.0]]
    }

    #[test]
    fn where_a_slow_channel_goes_is_told_by_lines() {
        let all = windows(1.0);
        let slow = Slow::learn(&axes(), Some(0), 0, &all).unwrap();
        // Time constants are tried by steps of a half.
        assert!((TAU_S / 1.3..1.3 * TAU_S).contains(&slow.tau_s), "{}", slow.tau_s);
        for w in &all {
            let (torque, speed) = (w.row.factors[0], w.row.factors[1]);
            let away = (w.row.responses[0] - rests(torque, speed)) / torque;
            // Within a tenth of the 40 K that it is away at the begin: time constants are tried by steps of a half.
            assert!((slow.away(w) - away).abs() < 4.0 / torque, "{torque} {speed}: {} {away}", slow.away(w));
        }
        // 0.07 Nm a K, told with an error of a tenth where 0.2 % scatter, and not told where it is nothing.
        let told = |k: f64| {
            let mut rng = Rng64::new(9);
            let rest = all.iter().filter(|w| w.rests());
            let each: Vec<(&Window, f64)> =
                rest.map(|w| (w, 0.01 + k * slow.away(w) + 0.002 * rng.normal())).collect();
            slow.effect(&each)
        };
        assert!((told(0.07).unwrap() - 0.07).abs() < 0.007, "{:?}", told(0.07));
        assert_eq!(told(0.0), None);
        assert_eq!(slow.effect(&[]), None);
    }

    /// What does not move, or moves by noise alone, goes nowhere.
    #[test]
    fn a_channel_that_does_not_follow_is_not_taken() {
        assert!(Slow::learn(&axes(), Some(0), 0, &windows(0.0)).is_none());
        assert!(Slow::learn(&axes(), Some(0), 0, &windows(1.0)[..20]).is_none());
        assert!(Slow::learn(&axes(), Some(0), 0, &[]).is_none());
    }
}
