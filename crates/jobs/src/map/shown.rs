//! What is left of lines in each cell: how far the maps of driven inputs, trimmed by them, miss their demand there, alone.
//!
//! ```text
//! m_k = sum_i w_i m_i / sum_i w_i      i: windows that count and are nearer to cell k than to any other, m_i: share by which the demand there was above what the
//!                                      map says for its input, without the lag of the way, w_i: their weights
//! ```
//!
//! A trim is smooth; where what lines show is not, it misses cells that they passed. The mean over all windows does not tell. It is no test of the trim: the
//! windows are those that it was found from. And it is a record, not a verdict: an error of the input counts by the slope of the map, and where the demand hardly
//! answers that is not steep enough by far (40 % at a cell of `gtdi_2l` around which the engine missed less than 2 %).

use dynocal_calib::steady::grid::corners;

/// A window: its place over the axes, the share by which the demand was missed, its weight.
pub(super) type Shown<'a> = (&'a [f64], f64, f64);

/// Mean of what windows show of each cell of the `axes`, the last one fastest; none where none is near.
pub(super) fn by_cell(axes: &[Vec<f64>], windows: &[Shown]) -> Vec<Option<f64>> {
    let cells: usize = axes.iter().map(Vec::len).product();
    let mut sums = vec![(0.0, 0.0); cells];
    for (at, missed, weight) in windows.iter().filter(|w| w.1.is_finite()) {
        let near = corners(axes, at).into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, _)) = near {
            sums[k].0 += weight * missed;
            sums[k].1 += weight;
        }
    }
    sums.into_iter().map(|(sum, weight)| (weight > 0.0).then(|| sum / weight)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows count for the nearest cell by their weights; cells beside no window say nothing.
    #[test]
    fn a_cell_is_judged_by_the_windows_next_to_it() {
        let axes = vec![vec![0.0, 10.0, 20.0], vec![1.0, 2.0]];
        let (a, b, c) = ([1.0, 1.1], [4.0, 1.0], [16.0, 2.0]);
        let windows: [Shown; 4] = [(&a, 0.01, 1.0), (&b, 0.05, 3.0), (&c, -0.06, 1.0), (&a, f64::NAN, 1.0)];
        let shown = by_cell(&axes, &windows);
        assert_eq!(shown.len(), 6);
        assert!((shown[0].unwrap() - 0.04).abs() < 1e-12 && (shown[5].unwrap() + 0.06).abs() < 1e-12);
        assert!(shown[1..5].iter().all(Option::is_none));
    }
}
