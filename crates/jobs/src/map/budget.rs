//! How the points of a day are spent: whatever the bed measures counts.
//!
//! ```text
//! points >= learnt + repeats + verification
//! repeats = ceil(planned / block) + 1 + ceil(followed / batch),   learnt = planned + followed
//! ```

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

/// Fewest usable points that models and envelope are learnt from.
pub(super) fn fewest(s: &MapSpec) -> usize {
    let driven = |name: &str| s.loops.iter().any(|l| l.input == name);
    let free = s.problem.inputs.iter().filter(|i| !driven(&i.name)).count();
    (2 * (s.axes.len() + free + 1)).max(5 * (s.axes.len() + 2))
}
