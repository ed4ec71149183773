//! Other starts for a program with several local optima.
//!
//! Start k replaces one input, each in turn, by a constant level: those of the van der Corput sequence (1/2, 1/4, 3/4, ..)
//! over its range. The demand stays what the models answered to the start record.

use super::program::Program;
use super::setup::Setup;

/// Moves the program to its `k`-th other start, from 1 on.
pub(super) fn other(setup: &Setup<'_>, program: &mut Program<'_>, k: usize) {
    let inputs = setup.problem.inputs.len();
    let (c, round) = ((k - 1) % inputs, (k - 1) / inputs + 1);
    let input = &setup.problem.inputs[c];
    let level = input.lower + radical_inverse(round) * (input.upper - input.lower);
    program.columns.level(c, level);
}

/// The digits of `k` in base 2 mirrored at the point.
fn radical_inverse(k: usize) -> f64 {
    let digits = (0..usize::BITS).map(|b| ((k >> b) & 1) as f64 * 0.5f64.powi(b as i32 + 1));
    digits.sum()
}

#[cfg(test)]
mod tests {
    #[test]
    fn levels_fill_the_range() {
        let levels: Vec<f64> = (1..8).map(super::radical_inverse).collect();
        assert_eq!(levels, [0.5, 0.25, 0.75, 0.125, 0.625, 0.375, 0.875]);
    }
}
