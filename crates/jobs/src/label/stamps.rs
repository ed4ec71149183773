//! Stamps of a log that do not follow each other: single bad ones, clocks that were set back, what a logger kept before its trigger.

/// Records that a bad stamp may last for before it is a clock that was set back.
const STRAY: usize = 3;
/// Share of the records that may lie before a trigger.
const BEFORE_TRIGGER: f64 = 0.1;

/// Which records stand, and how they hang together.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Ordered {
    /// Records that stay, by number.
    pub(super) keep: Vec<usize>,
    /// Places in `keep` at which the clock begins anew; the first of them is 0.
    pub(super) starts: Vec<usize>,
    /// What was left out or cut, in words.
    pub(super) said: Vec<String>,
}

/// Stamps in their order. One that lies before its predecessor while the next ones do not is a bad stamp, and its record is left out, as is
/// one without a number; one that the next ones go on from is a clock that was set back: a new stretch begins, of which nobody knows what
/// lay between.
pub(super) fn ordered(time_s: &[f64]) -> Ordered {
    let mut out = Ordered { starts: vec![0], ..Ordered::default() };
    let (mut stray, mut empty) = (Vec::new(), 0usize);
    for (k, &t) in time_s.iter().enumerate() {
        if !t.is_finite() {
            empty += 1;
            continue;
        }
        let Some(&last) = out.keep.last().filter(|_| out.keep.len() > out.starts[out.starts.len() - 1])
        else {
            out.keep.push(k);
            continue;
        };
        if t < time_s[last] {
            let stretch = out.starts[out.starts.len() - 1];
            let before = out.keep.len().checked_sub(2).filter(|p| *p >= stretch).map(|p| time_s[out.keep[p]]);
            let returns = |n: &f64| *n >= time_s[last];
            if before.is_some_and(|b| t >= b) {
                // The one before was too late.
                stray.push(last);
                out.keep.pop();
            } else if time_s[k + 1..].iter().take(STRAY).any(returns) {
                stray.push(k);
                continue;
            } else {
                out.starts.push(out.keep.len());
            }
        }
        out.keep.push(k);
    }
    if empty > 0 {
        out.said.push(format!("{empty} records without a stamp are left out"));
    }
    if let Some(first) = stray.first() {
        let many = if stray.len() == 1 {
            "record is".into()
        } else {
            format!("records, {} in all, are", stray.len())
        };
        out.said.push(format!(
            "the stamp of record {} ({} s) does not follow the one before: the {many} left out",
            first + 1,
            time_s[*first]
        ));
    }
    trigger(&mut out, time_s);
    if out.starts.len() > 1 {
        let at = out.keep[out.starts[1]];
        out.said.push(format!(
            "the clock goes back {} (first at record {}, by {:.3} s): what follows counts as a new stretch",
            if out.starts.len() == 2 { "once".into() } else { format!("{} times", out.starts.len() - 1) },
            at + 1,
            time_s[out.keep[out.starts[1] - 1]] - time_s[at]
        ));
    }
    out
}

/// Records that a logger kept before its trigger: short stretches at the beginning.
fn trigger(out: &mut Ordered, time_s: &[f64]) {
    let most = (BEFORE_TRIGGER * time_s.len() as f64) as usize;
    let Some(from) = out.starts.iter().copied().rfind(|s| *s > 0 && *s <= most) else { return };
    out.said.push(format!(
        "the first {from} records are left out: stamps go back after them, as after a trigger"
    ));
    out.keep.drain(..from);
    out.starts = out.starts.iter().filter(|s| **s >= from).map(|s| s - from).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(n: usize) -> Vec<f64> {
        (0..n).map(|k| 0.1 * k as f64).collect()
    }

    #[test]
    fn a_single_bad_stamp_costs_its_record_only() {
        let mut t = even(100);
        t[90] = t[88] - 0.05;
        let o = ordered(&t);
        assert_eq!((o.keep.len(), o.starts.as_slice()), (99, &[0][..]));
        assert!(!o.keep.contains(&90) && o.said[0].contains("record 91"), "{:?}", o.said);
        let mut late = even(100);
        late[50] = 1e6;
        let o = ordered(&late);
        assert!(o.keep.len() == 99 && !o.keep.contains(&50) && o.starts.len() == 1, "{:?}", o.said);
        let mut none = even(100);
        none[3] = f64::NAN;
        assert!(ordered(&none).said[0].contains("1 records without a stamp"));
    }

    #[test]
    fn a_clock_that_is_set_back_begins_a_stretch() {
        let mut t = even(100);
        t[70..].iter_mut().for_each(|t| *t -= 2.0);
        let o = ordered(&t);
        assert_eq!((o.keep.len(), o.starts.as_slice()), (100, &[0, 70][..]));
        assert!(o.said[0].contains("record 71, by 1.900 s"), "{:?}", o.said);
    }

    #[test]
    fn what_lies_before_a_trigger_is_left_out() {
        let mut t = even(100);
        t[..5].iter_mut().for_each(|t| *t += 3.0);
        let o = ordered(&t);
        assert_eq!((o.keep.len(), o.starts.as_slice()), (95, &[0][..]));
        assert!(o.said[0].contains("first 5 records"), "{:?}", o.said);
    }
}
