//! Iterative learning: the same record again and again, the fuel corrected by what the mixture was the time before.

/// Law of the correction. With the error `e = lambda / lambda_demanded - 1` that the fuel of sample `t` shows `d(t)` samples later,
///
/// ```text
/// q(t) <- q(t) (1 + gain * mean of e over t + d(t) - half .. t + d(t) + half)
/// ```
///
/// The mean keeps what no injection can remove (cylinders that differ, scatter) out of the fuel. Fuel is a factor of the mixture, so a
/// gain below 1 is a relaxed Newton step for the part of the error that goes with the fuel at once; a film makes it slower.
///
/// S. Arimoto, S. Kawamura, F. Miyazaki, J. Robotic Systems 1 (1984).
///
/// ```
/// use dynocal_calib::fuelling::Learning;
///
/// // A plant that shows fuel three samples later, and air that the first trial does not know.
/// let air = |t: usize| if t < 100 { 10.0 } else { 14.0 };
/// let learning = Learning { gain: 0.6, half: 1, preview: true };
/// let mut fuel = vec![10.0; 200];
/// for _ in 0..14 {
///     let error: Vec<f64> = (0..200_usize).map(|t| air(t.saturating_sub(3)) / fuel[t.saturating_sub(3)] - 1.0).collect();
///     learning.correct(&mut fuel, &error, |_| 3, &[0, 100, 200]);
/// }
/// assert!((fuel[150] - 14.0).abs() < 1e-3 && (fuel[50] - 10.0).abs() < 1e-3);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learning {
    /// Share of the error that a trial takes away, above 0 and at most 1.
    pub gain: f64,
    /// Samples on either side of the mean.
    pub half: usize,
    /// Whether the fuel may prepare for a demand that has not come yet. Without it, what is shown after a change of the demand corrects
    /// no fuel from before it: that fuel keeps the correction of the last sample whose own effects were seen before the change.
    pub preview: bool,
}

impl Learning {
    /// Corrects the fuel of a record by the errors of its last trial, both of one length. `delay` gives the samples from the command
    /// of a sample until its effect; demands change at `changes`, ascending, first the begin of the record and last its end.
    pub fn correct(
        &self,
        fuel: &mut [f64],
        error: &[f64],
        delay: impl Fn(usize) -> usize,
        changes: &[usize],
    ) {
        let mut next = changes.iter().copied().filter(|c| *c > 0).peekable();
        let mut factor = 1.0;
        for (t, q) in fuel.iter_mut().enumerate() {
            while next.next_if(|c| *c <= t).is_some() {}
            let end = if self.preview { error.len() } else { *next.peek().unwrap_or(&error.len()) };
            let at = t + delay(t);
            let window = error.get(at.saturating_sub(self.half)..(at + self.half + 1).min(error.len()));
            // Beyond the end: as the sample before.
            if let Some(shown) = window.filter(|w| !w.is_empty() && at + self.half < end) {
                factor = 1.0 + self.gain * shown.iter().sum::<f64>() / shown.len() as f64;
            }
            *q *= factor;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Learning;

    /// A first-order film between fuel and mixture, as a plant.
    fn mixture(fuel: &[f64], share: f64, out: f64) -> Vec<f64> {
        let mut film = share * fuel[0] / out;
        fuel.iter()
            .map(|q| {
                let left = out * film;
                film += share * q - left;
                (1.0 - share) * q + left
            })
            .collect()
    }

    fn learned(preview: bool, trials: usize) -> Vec<f64> {
        let (n, change, late) = (400_usize, 200, 5_usize);
        // The air is there 4 samples before its fuel could be: it moves 4 samples before the demand's fuel takes effect.
        let air = |t: usize| if t + 4 < change { 10.0 } else { 16.0 };
        let learning = Learning { gain: 0.6, half: 0, preview };
        let mut fuel = vec![9.0; n];
        let mut error = vec![0.0; n];
        for trial in 0..=trials {
            let m = mixture(&fuel, 0.3, 0.05);
            for t in 0..n {
                let from = t.saturating_sub(late);
                error[t] = air(from) / m[from] - 1.0;
            }
            if trial < trials {
                learning.correct(&mut fuel, &error, |_| late, &[0, change, n]);
            }
        }
        error
    }

    fn worst(error: &[f64]) -> f64 {
        error.iter().fold(0.0, |m, e| m.max(e.abs()))
    }

    #[test]
    fn errors_fall_to_nothing_through_a_film() {
        let (few, many) = (worst(&learned(true, 3)), worst(&learned(true, 60)));
        assert!(many < 1e-6 && many < few, "{few} {many}");
    }

    #[test]
    fn without_preview_only_what_could_not_be_known_is_left() {
        let error = learned(false, 60);
        // Fuel from before the change that meets the air of after it: samples 196 to 199, shown 5 later.
        let left: Vec<usize> = (0..error.len()).filter(|t| error[*t].abs() > 1e-6).collect();
        assert_eq!(left, [201, 202, 203, 204], "{left:?}");
    }

    #[test]
    fn nothing_known_changes_nothing() {
        let learning = Learning { gain: 0.6, half: 2, preview: false };
        let mut fuel = vec![1.0, 2.0, 3.0];
        learning.correct(&mut fuel, &[0.1, 0.1, 0.1], |_| 50, &[0, 3]);
        assert_eq!(fuel, [1.0, 2.0, 3.0]);
    }
}
