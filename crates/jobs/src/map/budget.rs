//! How the points of a day are spent: whatever the bed measures counts.
//!
//! ```text
//! points >= learnt + repeats + verification
//! repeats = ceil(planned / block) + 1 + ceil(followed / batch),   learnt = planned + followed
//! ```

use super::line_time;
use super::spec::MapSpec;

/// Points of a day by what they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Budget {
    /// Planned points, all over the space.
    pub(super) planned: usize,
    /// Points that follow the expected optimum.
    pub(super) followed: usize,
    /// Repeats among the planned points, and after batches.
    pub(super) repeats: [usize; 2],
}

impl Budget {
    /// The most points to learn from that the spec has room for; none where there is not room for the fewest.
    pub(super) fn of(s: &MapSpec) -> Option<Self> {
        let fewest = fewest(s);
        (fewest..=s.bed.points).rev().map(|learnt| Self::spent(s, learnt)).find(|b| b.all(s) <= s.bed.points)
    }

    /// Points of the smallest day.
    pub(super) fn least(s: &MapSpec) -> usize {
        Self::spent(s, fewest(s)).all(s)
    }

    fn spent(s: &MapSpec, learnt: usize) -> Self {
        // What is planned has to be enough for first models.
        let asked = (s.bed.refine.share * learnt as f64).round() as usize;
        let followed = asked.min(learnt.saturating_sub(fewest(s)));
        let planned = learnt - followed;
        let repeats =
            [planned.div_ceil(s.bed.block.max(1)) + 1, followed.div_ceil(s.bed.refine.batch.max(1))];
        Self { planned, followed, repeats }
    }

    /// All points before the verification.
    pub(super) fn before(&self) -> usize {
        self.planned + self.followed + self.repeats.iter().sum::<usize>()
    }

    fn all(&self, s: &MapSpec) -> usize {
        self.before() + s.verify.points
    }
}

/// Share of the bed time of all points that the verification takes.
pub(super) fn verify_share(spec: &MapSpec) -> f64 {
    spec.verify.points as f64 / spec.bed.points.max(1) as f64
}

/// Bed time in s that a point may take.
pub(super) fn longest_s(spec: &MapSpec) -> f64 {
    let a = &spec.bed.approach;
    // Over a corner at most.
    2.0 * a.ramp_s + a.settle_s + a.average_s
}

/// Bed time in s that is kept beside that of the points: for the last one, which may take longest, and for one that has to be measured once
/// more. Nothing where there are no points.
pub(super) fn verify_spare_s(spec: &MapSpec) -> f64 {
    if spec.verify.points == 0 { 0.0 } else { 2.0 * longest_s(spec) }
}

/// Least bed time of a day beside the gains of its loops, in s, and what takes it in words: the lines of the maps, what is kept for the verification, and the fewest
/// points that models are learnt from, each no longer than it is watched and averaged.
pub(super) fn least_s(s: &MapSpec) -> (f64, String) {
    // In the order of maps: the demand, then the given channel.
    let p = &s.problem;
    let names = p.demand_names().into_iter().chain(p.given_names());
    let axes: Vec<Vec<f64>> = names.filter_map(|n| s.axes.get(&n).cloned()).collect();
    let a = &s.bed.approach;
    let (lines_s, verify_s) = (line_time::expected_s(s, &axes), verify_spare_s(s));
    let points_s = fewest(s) as f64 * (2.0 * a.window_s + a.average_s);
    let all_s = lines_s + verify_s + points_s;
    let words = format!(
        "{:.1} min: lines of the maps take {:.1}, the verification keeps {:.1}, {} points to learn from {:.1}",
        all_s / 60.0,
        lines_s / 60.0,
        verify_s / 60.0,
        fewest(s),
        points_s / 60.0
    );
    (all_s, words)
}

/// Fewest usable points that models and envelope are learnt from.
pub(super) fn fewest(s: &MapSpec) -> usize {
    let driven = |name: &str| s.loops.iter().any(|l| l.input == name);
    let free = s.problem.inputs.iter().filter(|i| !driven(&i.name)).count();
    (2 * (s.axes.len() + free + 1)).max(5 * (s.axes.len() + 2))
}
