//! What windows of lines say of how a loop was answered: how steep its input is over the demand, and where it had needlessly much of it.

/// Least share of its course that a demand counts as having gone between two windows, where its slope is measured.
const ANSWERED: f64 = 0.1;

/// A window as a loop saw it.
pub(super) struct Answer {
    /// Number of the line, and whether it was gone up.
    pub(super) way: (usize, bool),
    /// Which pass and leg it rested on; none where it was under way.
    pub(super) rest: Option<(usize, usize)>,
    /// Whether it had been gone up for a window by then.
    pub(super) rising: bool,
    /// Bed time in s.
    pub(super) at_s: f64,
    /// Demand as asked for, as it was, and the input that held it.
    pub(super) asked: f64,
    pub(super) got: f64,
    pub(super) input: f64,
}

/// Steepest slope of the input over the demand, both as shares, from each window to those beside it on its way that are no more than `apart_s`
/// apart, or from rest to rest; 0 where none is. Where the demand hardly answers any more the loop comes back through inputs that no map at rest goes through,
/// and what they miss is no matter.
pub(super) fn measured_slopes(answers: &[Answer], apart_s: f64) -> Vec<f64> {
    let share = |a: f64, b: f64| (a / b).ln().abs();
    let mut slopes = vec![0.0; answers.len()];
    for (i, w) in answers.windows(2).enumerate() {
        let (a, b) = (&w[0], &w[1]);
        let (asked, got) = (share(b.asked, a.asked), share(b.got, a.got));
        // Not a number where there is no logarithm.
        let same_rest = a.rest.is_some() && a.rest == b.rest;
        let stands = asked.is_nan() || got.is_nan() || asked == 0.0 || same_rest;
        if a.way != b.way || b.at_s - a.at_s > apart_s || stands {
            continue;
        }
        let found = share(b.input, a.input) / got.max(ANSWERED * asked);
        if found.is_finite() {
            slopes[i..=i + 1].iter_mut().for_each(|s: &mut f64| *s = s.max(found));
        }
    }
    let rests: Vec<&[Answer]> = answers.chunk_by(|a, b| a.rest == b.rest).collect();
    let mut begin = 0;
    for w in rests.windows(2) {
        let (a, b) = (&w[0], &w[1]);
        let end = begin + a.len() + b.len();
        if a[0].rest.zip(b[0].rest).is_some_and(|(a, b)| a.0 == b.0) {
            let of = |value: &dyn Fn(&Answer) -> f64| {
                // The input still moves in the first of several.
                let mean = |all: &[Answer]| {
                    let rested = &all[usize::from(all.len() > 1)..];
                    rested.iter().map(value).sum::<f64>() / rested.len() as f64
                };
                share(mean(b), mean(a))
            };
            let asked = of(&|a| a.asked);
            let found = of(&|a| a.input) / of(&|a| a.got).max(ANSWERED * asked);
            if found.is_finite() && asked > 0.0 {
                slopes[begin..end].iter_mut().for_each(|s: &mut f64| *s = s.max(found));
            }
        }
        begin += a.len();
    }
    slopes
}

/// Logarithm of how many times an input may be beyond what reached as much of the demand on the way up: the settings of the two windows may differ as far as maps
/// go through both.
const BEYOND: f64 = 0.1;

/// Which windows of the ways back, and of rests, have needlessly much of the input: at least as much of the demand was reached with less of it on the way up of the same
/// line. Where it has been gone up for a while the demand is behind the input, so that less had been enough at rest, too: the loop is on its way back from where
/// nothing answers. `way`: whether the input goes up with the demand (> 0) or down.
pub(super) fn needless(answers: &[Answer], way: f64) -> Vec<bool> {
    let up = || answers.iter().filter(|a| a.rising);
    let one = |back: &Answer| {
        let less = |a: &Answer| way.signum() * (back.input / a.input).ln() > BEYOND;
        !back.way.1 && up().any(|a| a.way.0 == back.way.0 && a.got >= back.got && less(a))
    };
    answers.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A throttle that has stood wide open: on the way back 46 deg hold what 31 held before, which is needless, and what nothing was shown to hold with less is not.
    #[test]
    fn a_way_back_with_needlessly_much_of_the_input_does_not_count() {
        let at = |line: usize, up: bool, got: f64, input: f64| Answer {
            way: (line, up),
            rest: None,
            rising: up,
            at_s: 0.0,
            asked: got,
            got,
            input,
        };
        let up = [(115.0, 24.0), (126.0, 28.0), (131.0, 30.6), (137.0, 32.8)];
        let back = [(141.0, 49.8), (134.0, 46.0), (125.0, 28.5), (116.0, 23.0)];
        let all = |way: f64| -> Vec<Answer> {
            let input = |u: f64| if way > 0.0 { u } else { 1000.0 / u };
            let there = up.iter().map(|(y, u)| at(0, true, *y, input(*u)));
            there.chain(back.iter().map(|(y, u)| at(0, false, *y, input(*u)))).collect()
        };
        let expected = [false, false, false, false, false, true, false, false];
        assert_eq!(needless(&all(1.0), 1.0), expected);
        // An input that goes down with the demand.
        assert_eq!(needless(&all(-1.0), -4.0), expected);
        // Nor by what was reached when it had just begun to go up.
        let mut begun = all(1.0);
        begun[..4].iter_mut().for_each(|a| a.rising = false);
        assert_eq!(needless(&begun, 1.0), [false; 8]);
        // Of another line nothing is known.
        let mut apart = all(1.0);
        apart[4..].iter_mut().for_each(|a| a.way.0 = 1);
        assert_eq!(needless(&apart, 1.0), [false; 8]);
    }

    /// From rest to rest: what the input does there, windows of a rest have in common, and of another pass nothing is known.
    #[test]
    fn slopes_go_from_rest_to_rest() {
        let at = |rest: Option<(usize, usize)>, got: f64, input: f64| Answer {
            way: (0, false),
            rest,
            rising: false,
            at_s: rest.map_or(0.0, |(pass, leg)| (100 * pass + 10 * leg) as f64),
            asked: got,
            got,
            input,
        };
        let rests = [(Some((0, 0)), 100.0, 20.0), (Some((0, 2)), 110.0, 22.0), (Some((0, 4)), 121.0, 44.0)];
        let pairs = rests.iter().flat_map(|(r, y, u)| [at(*r, *y, *u), at(*r, *y, *u)]);
        let mut all: Vec<Answer> = pairs.collect();
        all.push(at(Some((1, 0)), 130.0, 60.0));
        let slopes = measured_slopes(&all, 0.0);
        let steep = 2.0_f64.ln() / 1.1_f64.ln();
        for (found, right) in slopes.iter().zip([1.0, 1.0, steep, steep, steep, steep, 0.0]) {
            assert!((found - right).abs() < 1e-9, "{slopes:?}");
        }
    }

    /// y = 1 - exp(-u): gone up as at rest, and come back from the end through u of 6 to 3.5, where y stays what it was.
    #[test]
    fn a_loop_that_comes_back_from_where_nothing_answers_counts_little() {
        let at = |k: usize, up: bool, asked: f64, input: f64| Answer {
            way: (0, up),
            rest: None,
            rising: up,
            at_s: 2.0 * k as f64,
            asked,
            got: 1.0 - (-input).exp(),
            input,
        };
        let going: Vec<Answer> =
            (0..6).map(|k| at(k, true, 0.4 + 0.1 * k as f64, 0.5 + 0.35 * k as f64)).collect();
        let coming = (6..9).map(|k| at(k, false, 0.98 - 0.05 * (k - 6) as f64, 6.0 - 1.2 * (k - 6) as f64));
        // The last one is of another time: nothing is measured from it to the one before.
        let answers: Vec<Answer> = going.into_iter().chain(coming).chain([at(20, false, 0.5, 0.7)]).collect();
        let slopes = measured_slopes(&answers, 3.0);
        // d log u / d log y of the law is (exp(u) - 1) / u: 1.3 where u is 0.5, 4 where it is 2.25.
        assert!((1.2..1.7).contains(&slopes[0]) && (2.5..4.0).contains(&slopes[5]), "{slopes:?}");
        assert!(slopes[6..9].iter().all(|s| *s > 10.0), "{slopes:?}");
        assert_eq!(slopes[9], 0.0);
        // A demand that stands still says nothing, and what has no logarithm neither.
        let pair = |asked: f64, got: f64| {
            let first = Answer { asked, got, ..at(0, true, 0.5, 0.5) };
            measured_slopes(&[first, at(1, true, 0.5, 0.9)], 3.0)
        };
        for (asked, got) in [(0.5, 0.4), (-0.5, 0.4), (0.4, -0.4)] {
            assert_eq!(pair(asked, got), [0.0, 0.0]);
        }
        assert!(pair(0.4, 0.4)[0] > 1.0);
    }
}
