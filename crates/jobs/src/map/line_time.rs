//! Bed time of lines of the maps.

use super::spec::{MapSpec, SweepSpec};

/// Bed time that the sweeps of a spec take, about.
pub(super) fn expected_s(spec: &MapSpec, axes: &[Vec<f64>]) -> f64 {
    let Some(s) = &spec.bed.sweep else { return 0.0 };
    lines(s, axes) as f64 * line_s(spec, s, axes) + again_s(spec, axes)
}

/// Number of lines of a map.
fn lines(s: &SweepSpec, axes: &[Vec<f64>]) -> usize {
    axes.get(1).map_or(1, |a| (a.len() - 1) * (s.between + 1) + 1)
}

/// Bed time of a line with the way to it.
fn line_s(spec: &MapSpec, s: &SweepSpec, axes: &[Vec<f64>]) -> f64 {
    along_s(s, (axes.first().map_or(0, Vec::len), 1.0)) + beside_s(spec, s)
}

/// Bed time as the spec asks along a line through so many values and a share of the first axis: there and back, or there with its rests.
pub(super) fn along_s(s: &SweepSpec, (values, share): (usize, f64)) -> f64 {
    if s.rest_s > 0.0 { s.pass_s * share + values as f64 * s.rest_s } else { 2.0 * s.pass_s * share }
}

/// Bed time of a line that does not go with its length: the way to it and a rest at the turn, or the way back where nothing is measured on it.
pub(super) fn beside_s(spec: &MapSpec, s: &SweepSpec) -> f64 {
    next_line_s(spec) + if s.rest_s > 0.0 { spec.bed.approach.ramp_s } else { s.turn_s }
}

/// Share of the lines for which bed time is kept to go along parts of them again, one at least: where a demand is not reached at one place of the other axis it
/// mostly is not beside it, either, and what the first lines show of what is minimised moves maps under lines that were gone along. With one of eight lines most
/// days of `gtdi_2l` had left parts out, or hurried along all; with two many still did.
const AGAIN: f64 = 0.375;

/// Bed time that is kept for parts of lines that are gone along again.
pub(super) fn again_s(spec: &MapSpec, axes: &[Vec<f64>]) -> f64 {
    let kept = |s: &SweepSpec| (AGAIN * lines(s, axes) as f64).max(1.0) * line_s(spec, s, axes);
    spec.bed.sweep.as_ref().map_or(0.0, kept)
}

/// Bed time to the next line, about: half of the range, and half of the longest wait for its rest. More would be points that are not
/// measured; where it takes longer, the lines that are left go faster ([`pace`]).
fn next_line_s(spec: &MapSpec) -> f64 {
    let a = &spec.bed.approach;
    0.5 * (a.ramp_s + a.settle_s) + a.average_s
}

/// How many times as fast as asked a line may be gone along.
const FASTEST: f64 = 1.5;

/// Least bed time that a line through so many values and a share of the first axis takes, about.
pub(super) fn least_s(spec: &MapSpec, s: &SweepSpec, line: (usize, f64)) -> f64 {
    along_s(s, line) / FASTEST + beside_s(spec, s)
}

/// By how much the times that the spec asks for are shortened on the next of `lines` that have `left_s` of bed time and would take `along_s` together: not at
/// all, or to a `FASTEST`th where time is short, so that neither the last lines nor the verification are left out.
pub(super) fn pace(spec: &MapSpec, s: &SweepSpec, left_s: f64, (lines, along_s): (usize, f64)) -> f64 {
    ((left_s - lines as f64 * beside_s(spec, s)) / along_s.max(f64::MIN_POSITIVE)).clamp(1.0 / FASTEST, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines take what is asked as long as there is time for all, and share what there is after that.
    #[test]
    fn lines_go_faster_where_time_is_short() {
        let (spec, axes) = (MapSpec::default(), [vec![40.0, 100.0, 160.0]]);
        let way_s = next_line_s(&spec);
        let sweep = SweepSpec { pass_s: 40.0, ..SweepSpec::default() };
        let pass_s = |left_s: f64, (lines, share): (usize, f64)| {
            40.0 * pace(&spec, &sweep, left_s, (lines, along_s(&sweep, (3, share))))
        };
        for lines in [1, 4] {
            let of = |each_s: f64| pass_s(lines as f64 * each_s, (lines, lines as f64));
            for (found, right) in [of(500.0), of(80.0 + way_s), of(30.0), of(-1.0)].into_iter().zip([
                40.0,
                40.0,
                40.0 / FASTEST,
                40.0 / FASTEST,
            ]) {
                assert!((found - right).abs() < 1e-12, "{found} {right}");
            }
            assert!((of(70.0 + way_s) - 35.0).abs() < 1e-12);
            // Half lines need half of the time.
            let half = pass_s(lines as f64 * (40.0 + way_s), (lines, 0.5 * lines as f64));
            assert!((half - 40.0).abs() < 1e-12, "{half}");
        }
        // With rests there is one way of them, and one back in the time of a ramp.
        let rests = SweepSpec { rest_s: 8.0, pass_s: 16.0, ..sweep };
        let all_s = 16.0 + 3.0 * 8.0 + spec.bed.approach.ramp_s + way_s;
        assert!((line_s(&spec, &rests, &axes) - all_s).abs() < 1e-12);
        let along_s = along_s(&rests, (3, 1.0));
        assert_eq!(pace(&spec, &rests, all_s, (1, along_s)), 1.0);
        assert!((pace(&spec, &rests, all_s - 8.0, (1, along_s)) - 0.8).abs() < 1e-12);
    }

    /// Eight lines keep the time of three more for what is gone along again, one keeps that of one more.
    #[test]
    fn time_is_kept_for_parts_that_are_gone_along_again() {
        let mut spec = MapSpec::default();
        spec.bed.sweep = Some(SweepSpec { between: 0, ..SweepSpec::default() });
        let each_s = line_s(&spec, spec.bed.sweep.as_ref().unwrap(), &[vec![40.0, 160.0]]);
        let lines = |spec: &MapSpec, n: usize| {
            let axes = [vec![40.0, 160.0], (0..n).map(|k| k as f64).collect()];
            expected_s(spec, &axes[..if n == 1 { 1 } else { 2 }]) / each_s
        };
        let demand = spec.problem.demand_names()[0].clone();
        spec.axes = std::collections::BTreeMap::from([(demand, vec![40.0, 160.0])]);
        assert!((lines(&spec, 8) - 11.0).abs() < 1e-9 && (lines(&spec, 1) - 2.0).abs() < 1e-9);
    }
}
