//! Whether a free run has left everything that was ever measured of its output.

/// A free run that leaves the range by more than so many times its width says nothing any more: a mean would be better by an
/// order of magnitude.
pub const BEYOND: f64 = 3.0;

/// Where and how far a free run left its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Departure {
    /// First sample that is not finite or leaves the range by more than [`BEYOND`] times its width.
    pub sample: usize,
    /// Most that any sample leaves it by, in widths; infinite where one is not finite.
    pub widths: f64,
}

impl Departure {
    /// In words: what the free run does.
    pub fn words(self) -> String {
        if self.widths.is_finite() {
            format!("leaves the measured range by {:.1} times its width", self.widths)
        } else {
            "diverges".into()
        }
    }
}

/// The departure of `found` from the range that the finite values of `measured` span; samples for which `known` is false do not
/// count. None where it stays near. Without a finite measured value only samples that are not finite are departures.
///
/// ```
/// use dynocal_ident::validate::departure;
/// let measured = [0.0, 1.0];
/// assert_eq!(departure(&[0.5, 3.9], measured, |_| true), None);
/// let far = departure(&[0.5, 4.5, -9.0], measured, |_| true).unwrap();
/// assert_eq!((far.sample, far.widths), (1, 9.0));
/// ```
pub fn departure(
    found: &[f64],
    measured: impl IntoIterator<Item = f64>,
    known: impl Fn(usize) -> bool,
) -> Option<Departure> {
    let (low, high) = measured
        .into_iter()
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let width = if high > low { high - low } else { high.abs().max(1.0) };
    let out = |v: f64| if low > high { 0.0 } else { (v - high).max(low - v).max(0.0) / width };
    let far = |t: &usize| known(*t) && (!found[*t].is_finite() || out(found[*t]) > BEYOND);
    let sample = (0..found.len()).find(far)?;
    let widths =
        found.iter().map(|v| if v.is_finite() { out(*v) } else { f64::INFINITY }).fold(0.0, f64::max);
    Some(Departure { sample, widths })
}
