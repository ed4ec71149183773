//! Where a channel that is slower than a point comes to rest, and how fast: oil.
//!
//! Points are held until what their loops hold has come to rest, and lines are gone along in a minute. Oil is a minute and more behind, so that it is
//! warmer or colder everywhere than it will be. But it is measured, and a day at many places tells where it goes:
//!
//! ```text
//! T_1 = T_0 exp(-(r + h)/tau) + (1 - exp(-r/tau)) exp(-h/tau) (R(z_0) + R(z_1))/2 + (1 - exp(-h/tau)) R(z_1)
//! R(z) = phi(z)' theta                       phi: 1, z, z^2, products of the axes z; theta by least squares for each tau
//! ```
//!
//! from a point z_0 to the next one z_1, r: time on the way, h: time there; along a line z is the mean of a step, and r is 0. What other factors do to R is left in
//! what the law misses. What the channel does to the engine: [`super::rest`].

use dynocal_calib::steady::day::DayPoint;
use dynocal_calib::steady::layout::Layout;
use dynocal_calib::steady::station::ApproachSpec;
use dynocal_numerics::interval::Interval;
use dynocal_numerics::linalg::least_squares;

use super::windows::Window;

/// What a slow channel did from one measurement to the next.
pub(super) struct Step {
    /// Time on the way and at its end in s.
    span_s: [f64; 2],
    /// The channel before and after.
    value: [f64; 2],
    /// Axes before and after.
    at: [Vec<f64>; 2],
}

/// Windows over which a change is taken: one alone is mostly noise.
const WINDOWS: usize = 5;

/// From one point to the next as the bed approaches them. Where far more time went by than a point takes the bed was elsewhere.
pub(super) fn between_points(
    layout: &Layout,
    points: &[DayPoint],
    response: usize,
    approach: &ApproachSpec,
) -> Vec<Step> {
    let longest_s = 2.0 * (approach.ramp_s + approach.settle_s + approach.average_s);
    let one = |pair: &[DayPoint]| {
        let (a, b) = (&pair[0].point, &pair[1].point);
        let gone_s = b.at_s - a.at_s;
        let shares = layout.factors.iter().zip(a.factors.iter().zip(&b.factors));
        let far = shares.map(|(f, (x, y))| (y - x).abs() / (f.upper - f.lower)).fold(0.0, f64::max);
        let ramp_s = (approach.ramp_s * far).min(gone_s);
        let value = [a.responses[response], b.responses[response]];
        let at = [a, b].map(|p| p.factors[..layout.axes].to_vec());
        // Where nothing was measured there is no number.
        let lasts = gone_s > 0.0 && gone_s < longest_s;
        let stands = lasts && value.iter().chain(at.iter().flatten()).all(|v| v.is_finite());
        stands.then_some(Step { span_s: [ramp_s, gone_s - ramp_s], value, at })
    };
    points.windows(2).filter_map(one).collect()
}

/// Along lines over the first `axes` factors.
pub(super) fn along_lines(windows: &[Window], response: usize, axes: usize) -> Vec<Step> {
    let one = |part: &[Window]| {
        let (a, b) = (&part[0], &part[WINDOWS]);
        let gone_s = b.row.at_s - a.row.at_s;
        let follows = a.line == b.line && gone_s > 0.0 && gone_s < 2.0 * WINDOWS as f64 * a.way.window_s;
        let mean = |k: usize| part.iter().map(|w| w.row.factors[k]).sum::<f64>() / part.len() as f64;
        let at: Vec<f64> = (0..axes).map(mean).collect();
        let value = [a, b].map(|w| w.row.responses[response]);
        follows.then(|| Step { span_s: [0.0, gone_s], value, at: [at.clone(), at] })
    };
    windows.windows(WINDOWS + 1).step_by(WINDOWS).filter_map(one).collect()
}

/// Where a slow channel comes to rest over the axes, and how fast.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Law {
    /// Time constant in s.
    pub(super) tau_s: f64,
    axes: Vec<Interval>,
    theta: Vec<f64>,
}

/// Time constants that are tried, from half of the middle step on, each longer by this factor.
const TAUS: usize = 28;
const LONGER: f64 = 1.2;
/// Share of what it changes, and of what is left without a memory of where it was, that the law has to explain.
const SIGNAL: f64 = 0.5;
/// Steps for each coefficient, at least.
const STEPS: usize = 2;

/// 1, z, z^2 and products of the axes in shares of half their ranges about their middle.
fn terms(axes: &[Interval], at: &[f64]) -> Vec<f64> {
    let half = |r: &Interval| (0.5 * r.width()).max(f64::MIN_POSITIVE);
    let z: Vec<f64> = axes.iter().zip(at).map(|(r, v)| (v - r.middle()) / half(r)).collect();
    let squares = (0..z.len()).flat_map(|i| (i..z.len()).map(move |j| (i, j)));
    let squares: Vec<f64> = squares.map(|(i, j)| z[i] * z[j]).collect();
    [vec![1.0], z, squares].concat()
}

impl Law {
    /// From steps over the ranges of the `axes`; none where they do not tell where the channel goes.
    pub(super) fn learn(axes: &[Interval], steps: &[Step]) -> Option<Self> {
        let each: Vec<[Vec<f64>; 2]> =
            steps.iter().map(|s| [terms(axes, &s.at[0]), terms(axes, &s.at[1])]).collect();
        let (rows, cols) = (steps.len(), each.first()?[0].len());
        if rows < STEPS * cols {
            return None;
        }
        let mut spans_s: Vec<f64> = steps.iter().map(|s| s.span_s[0] + s.span_s[1]).collect();
        spans_s.sort_by(f64::total_cmp);
        let first_s = 0.5 * spans_s[spans_s.len() / 2];
        let fit = |tau_s: f64| {
            let (mut a, mut b) = (Vec::with_capacity(rows * cols), Vec::with_capacity(rows));
            for (s, [before, after]) in steps.iter().zip(&each) {
                let [on_the_way, there] = s.span_s.map(|t| (-t / tau_s).exp());
                let mid = 0.5 * (1.0 - on_the_way) * there;
                a.extend(before.iter().zip(after).map(|(x, y)| mid * (x + y) + (1.0 - there) * y));
                b.push(s.value[1] - s.value[0] * on_the_way * there);
            }
            let found = least_squares(&a, rows, cols, &b, 0.0).ok()?;
            Some((found.residual_sum_squares, tau_s, found.x))
        };
        let taus: Vec<f64> = (0..TAUS).map(|k| first_s * LONGER.powi(k as i32)).collect();
        let fits = taus.iter().filter_map(|t| fit(*t));
        let (rest, tau_s, theta) = fits.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let changes: f64 = steps.iter().map(|s| (s.value[1] - s.value[0]).powi(2)).sum();
        // What follows at once is not slow, and noise is no memory.
        let (forgets, ..) = fit(1e-9 * spans_s[0])?;
        // At an end of what is tried it is no minimum.
        let inner = tau_s > taus[0] && tau_s < taus[TAUS - 1];
        let most = (1.0 - SIGNAL) * forgets.min(changes * (rows - cols) as f64 / rows as f64);
        (inner && rest < most).then(|| Self { tau_s, axes: axes.to_vec(), theta })
    }

    /// Number of axes.
    pub(super) fn axes(&self) -> usize {
        self.axes.len()
    }

    /// How far the channel is from where it comes to rest at the axes `at`.
    pub(super) fn away(&self, at: &[f64], value: f64) -> f64 {
        let rests: f64 = terms(&self.axes, at).iter().zip(&self.theta).map(|(t, c)| t * c).sum();
        value - rests
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
    fn rests(at: &[f64]) -> f64 {
        360.0 + 0.012 * (at[1] - 1000.0) + 0.05 * at[0]
    }

    fn follow(oil: &mut f64, at: &[f64], h_s: f64) {
        *oil += (rests(at) - *oil) * (1.0 - (-h_s / TAU_S).exp());
    }

    fn axes() -> Vec<Interval> {
        vec![Interval::new(40.0, 160.0), Interval::new(1000.0, 4500.0)]
    }

    /// Oil behind that by 60 s along eight lines of 80 s, there and back from 40 to 160 Nm; windows of 2 s, read with noise. It `moves` or stands.
    fn windows(moves: bool) -> Vec<Window> {
        let mut rng = Rng64::new(4);
        let (mut oil, mut at_s, mut all) = (400.0, 0.0, Vec::new());
        for line in 0..8 {
            for k in 0..40 {
                let torque = if k < 20 { 43.0 + 6.0 * k as f64 } else { 157.0 - 6.0 * (k - 20) as f64 };
                let at = vec![torque, 1000.0 + 500.0 * line as f64];
                if moves {
                    follow(&mut oil, &at, 2.0);
                }
                at_s += 2.0;
                let way = Way { up: 1.0, since_s: 2.0 * k as f64, before: [(0.0, 0.0); 2], window_s: 2.0 };
                let row = SweepRow {
                    factors: at,
                    responses: vec![oil + 0.02 * rng.normal()],
                    asked: Vec::new(),
                    leg: 0,
                    at_end: Vec::new(),
                    followed: Vec::new(),
                    behind: Vec::new(),
                    at_s,
                };
                all.push(Window { line, pass: line, way, last: false, halfway: false, row });
            }
            // The way to the next line.
            at_s += 20.0;
        }
        all
    }

    #[test]
    fn where_a_slow_channel_goes_is_told_by_lines() {
        let all = windows(true);
        let law = Law::learn(&axes(), &along_lines(&all, 0, 2)).unwrap();
        // Time constants are tried by steps of a fifth.
        assert!((TAU_S / 1.2..1.2 * TAU_S).contains(&law.tau_s), "{}", law.tau_s);
        for w in &all {
            let (at, oil) = (&w.row.factors, w.row.responses[0]);
            // Within a tenth of the 40 K that it is away at the begin.
            assert!((law.away(at, oil) - (oil - rests(at))).abs() < 4.0, "{at:?}: {}", law.away(at, oil));
        }
    }

    /// A point of two seconds' ramp and some rest each, at random places.
    #[test]
    fn and_by_two_dozen_points() {
        let mut rng = Rng64::new(8);
        let (mut oil, mut before) = (390.0, vec![100.0, 2500.0]);
        let mut steps = Vec::new();
        for k in 0..24 {
            let at = vec![rng.uniform_in(40.0, 160.0), rng.uniform_in(1000.0, 4500.0)];
            let (from, span_s) = (oil, [6.0, 14.0 + f64::from(k % 5)]);
            for i in 0..60 {
                let share = (f64::from(i) + 0.5) / 60.0;
                let on: Vec<f64> = before.iter().zip(&at).map(|(a, b)| a + share * (b - a)).collect();
                follow(&mut oil, &on, 0.1);
            }
            follow(&mut oil, &at, span_s[1]);
            let value = [from, oil + 0.02 * rng.normal()];
            steps.push(Step { span_s, value, at: [before, at.clone()] });
            before = at;
        }
        let law = Law::learn(&axes(), &steps).unwrap();
        assert!((TAU_S / 1.2..1.2 * TAU_S).contains(&law.tau_s), "{}", law.tau_s);
        for at in [[50.0, 1200.0], [100.0, 4000.0], [150.0, 2000.0]] {
            assert!(law.away(&at, rests(&at)).abs() < 3.0, "{at:?}: {}", law.away(&at, rests(&at)));
        }
    }

    /// What moves by noise alone, or is where it comes to rest at once, is not slow; steps of any length.
    #[test]
    fn a_channel_that_does_not_follow_is_not_taken() {
        for seed in 0..20 {
            let mut rng = Rng64::new(seed);
            let step = |rng: &mut Rng64, moves: f64| {
                let at = [0, 1].map(|_| vec![rng.uniform_in(40.0, 160.0), rng.uniform_in(1000.0, 4500.0)]);
                let value = [0, 1].map(|k: usize| 380.0 + moves * (rests(&at[k]) - 380.0) + rng.normal());
                Step { span_s: [3.0, rng.uniform_in(12.0, 30.0)], value, at }
            };
            for moves in [0.0, 1.0] {
                let steps: Vec<Step> = (0..60).map(|_| step(&mut rng, moves)).collect();
                assert_eq!(Law::learn(&axes(), &steps), None, "{seed} {moves}");
            }
        }
        assert!(Law::learn(&axes(), &along_lines(&windows(false), 0, 2)).is_none());
        assert!(Law::learn(&axes(), &along_lines(&windows(true)[..20], 0, 2)).is_none());
        assert!(Law::learn(&axes(), &[]).is_none());
    }
}
