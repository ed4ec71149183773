//! What a model remembers of the records that it comes from, so that a record that it has seen is not taken for a test.
//!
//! A record is taken as pieces: windows of eight successive samples of the channels that the model reads, of steady points single
//! rows. Of the hashes of all pieces the smallest [`KEPT`] are kept (bottom-k sketch, A. Broder, "On the resemblance and
//! containment of documents", 1997). They are a random sample of the pieces, the same one for everybody who looks, wherever a piece
//! stands: so a part of a record, a record around it, rows in another order and channels that stand beside are recognised.
//!
//! With `s` of the pieces of a record known, the estimate of [`Pieces::share`] has the standard error `sqrt(s (1 - s) / n)`, `n` being
//! the pieces of the record that are no larger than the largest one kept (all of a record as long as the one of the model: [`KEPT`]).

use serde::{Deserialize, Serialize};

use crate::data::{DataError, Dataset};

/// Samples of a piece of a record in time: so many are not equal by chance, where anything moves.
pub const WINDOW: usize = 8;
/// Hashes that are kept.
pub const KEPT: usize = 128;
/// From this share of known pieces on a record is not unseen.
pub const SEEN_FROM: f64 = 0.1;

/// Hashes of pieces of records, ascending: as text 16 hexadecimal digits each.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Pieces(Vec<u64>);

impl From<Pieces> for String {
    fn from(p: Pieces) -> Self {
        p.0.iter().map(|h| format!("{h:016x}")).collect()
    }
}

impl TryFrom<String> for Pieces {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let fault =
            || format!("found {} characters, expected 16 hexadecimal digits for each piece", text.len());
        if !text.is_ascii() || text.len() % 16 != 0 {
            return Err(fault());
        }
        let one = |k: usize| u64::from_str_radix(&text[16 * k..16 * (k + 1)], 16).map_err(|_| fault());
        let mut found = (0..text.len() / 16).map(one).collect::<Result<Vec<_>, _>>()?;
        found.sort_unstable();
        found.dedup();
        found.truncate(KEPT);
        Ok(Self(found))
    }
}

impl Pieces {
    /// Those of `channels` in `records`; `steady`: a row is a piece.
    ///
    /// # Errors
    /// A channel that a record does not have.
    pub fn of(records: &[&Dataset], channels: &[String], steady: bool) -> Result<Self, DataError> {
        let mut kept = Vec::new();
        for record in records {
            pieces(record, channels, steady, |h| {
                kept.push(h);
                if kept.len() > 64 * KEPT {
                    smallest(&mut kept);
                }
            })?;
        }
        smallest(&mut kept);
        Ok(Self(kept))
    }

    /// Share of the pieces of `record` that are known, from 0 to 1, estimated from those that are kept; 0 where none of the pieces
    /// can be compared.
    ///
    /// # Errors
    /// A channel that the record does not have.
    pub fn share(&self, record: &Dataset, channels: &[String], steady: bool) -> Result<f64, DataError> {
        // With fewer than are kept all are there, and every piece of the record can be compared.
        let last = if self.0.len() < KEPT { u64::MAX } else { self.0.last().copied().unwrap_or(0) };
        let mut compared = Vec::new();
        pieces(record, channels, steady, |h| {
            if h <= last {
                compared.push(h);
            }
        })?;
        compared.sort_unstable();
        compared.dedup();
        let known = compared.iter().filter(|h| self.0.binary_search(h).is_ok()).count();
        Ok(if compared.is_empty() { 0.0 } else { known as f64 / compared.len() as f64 })
    }

    /// Whether so much of `record` is known that it is no test ([`SEEN_FROM`]). A record that lacks a channel is not known.
    pub fn know(&self, record: &Dataset, channels: &[String], steady: bool) -> bool {
        !self.0.is_empty() && self.share(record, channels, steady).is_ok_and(|s| s >= SEEN_FROM)
    }
}

fn smallest(hashes: &mut Vec<u64>) {
    hashes.sort_unstable();
    hashes.dedup();
    hashes.truncate(KEPT);
}

/// Gives every piece to `take`. Pieces with a missing sample are none, nor are windows in which nothing moves: every record that
/// begins at rest has those.
fn pieces(
    d: &Dataset,
    channels: &[String],
    steady: bool,
    mut take: impl FnMut(u64),
) -> Result<(), DataError> {
    let mut names: Vec<&String> = channels.iter().collect();
    names.sort_unstable();
    let columns = names.into_iter().map(|n| d.values(n)).collect::<Result<Vec<_>, _>>()?;
    let row = |t: usize| -> Option<u64> {
        columns.iter().try_fold(START, |h, c| c[t].is_finite().then(|| mixed(h, u64::from(rounded(c[t])))))
    };
    let rows: Vec<Option<u64>> = (0..d.len()).map(row).collect();
    if steady {
        rows.into_iter().flatten().for_each(take);
        return Ok(());
    }
    for window in rows.windows(WINDOW) {
        let moves = window.iter().any(|r| *r != window[0]);
        if let Some(h) = window.iter().try_fold(START, |h, r| r.map(|r| mixed(h, r)))
            && moves
        {
            take(h);
        }
    }
    Ok(())
}

const START: u64 = 0x9e37_79b9_7f4a_7c15;

/// In single precision, for files that keep no more, with one zero: what differs by rounding is the same measurement.
fn rounded(v: f64) -> u32 {
    (v as f32 + 0.0).to_bits()
}

/// Finalizer of SplitMix64 (G. Steele and others, 2014): every bit of both numbers moves every bit of the result.
fn mixed(h: u64, v: u64) -> u64 {
    let mut z = h.rotate_left(23).wrapping_add(START) ^ v.wrapping_mul(0xff51_afd7_ed55_8ccd);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Channel, Role};

    /// A record of two channels that nobody else has.
    fn record(n: usize, seed: u64) -> Dataset {
        let mut h = seed;
        let mut draw = || {
            h = mixed(h, 1);
            (h >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut channel = |name: &str, role| Channel {
            name: name.into(),
            unit: "-".into(),
            role,
            values: (0..n).map(|_| draw()).collect(),
        };
        let channels = vec![channel("u", Role::Input), channel("y", Role::Output)];
        Dataset { name: "r".into(), sample_time_s: 0.1, channels, init_samples: 0, origin: String::new() }
    }

    fn names() -> Vec<String> {
        ["u", "y"].map(String::from).to_vec()
    }

    #[test]
    fn what_is_the_same_record_is_known() {
        let whole = record(5000, 1);
        let known = Pieces::of(&[&whole], &names(), false).unwrap();
        let share = |d: &Dataset| known.share(d, &names(), false).unwrap();
        assert_eq!(share(&whole), 1.0);
        // Channels in another order, one beside them, another sample time, one sample missing, another zero.
        let mut other = whole.clone();
        other.channels.reverse();
        other.channels.push(Channel { name: "z".into(), ..whole.channels[0].clone() });
        other.sample_time_s += 1e-16;
        other.channels[1].values[70] = f64::NAN;
        assert!(share(&other) > 0.95, "{}", share(&other));
        let zero = |z: f64| {
            let mut d = record(100, 2);
            d.channels[0].values[3] = z;
            Pieces::of(&[&d], &names(), false).unwrap()
        };
        assert_eq!(zero(0.0), zero(-0.0));
        // In single precision.
        let mut single = whole.clone();
        single.channels.iter_mut().flat_map(|c| &mut c.values).for_each(|v| *v = f64::from(*v as f32));
        assert_eq!(share(&single), 1.0);
    }

    #[test]
    fn parts_and_what_is_around_are_known_by_their_share() {
        let whole = record(20_000, 3);
        let known = |d: &Dataset| Pieces::of(&[d], &names(), false).unwrap();
        // Of a model of the first quarter the whole record has a quarter: sqrt(0.25 0.75 / 512) is 0.02, five of which are allowed.
        let quarter = whole.part(0, 5000, "quarter".into());
        let around = known(&quarter).share(&whole, &names(), false).unwrap();
        assert!((around - 0.25).abs() < 0.1, "{around}");
        // Of a model of the whole a tenth is all known; so is nothing of the rest by a model of the quarter.
        assert_eq!(
            known(&whole).share(&whole.part(7000, 9000, "tenth".into()), &names(), false).unwrap(),
            1.0
        );
        assert!(!known(&quarter).know(&whole.part(5000, 20_000, "rest".into()), &names(), false));
        assert!(!known(&whole).know(&record(20_000, 4), &names(), false));
    }

    #[test]
    fn rows_of_points_in_any_order() {
        let points = record(60, 5);
        let known = Pieces::of(&[&points], &names(), true).unwrap();
        let mut turned = points.clone();
        turned.channels.iter_mut().for_each(|c| c.values.reverse());
        assert_eq!(known.share(&turned, &names(), true).unwrap(), 1.0);
        assert_eq!(known.share(&record(60, 6), &names(), true).unwrap(), 0.0);
    }

    #[test]
    fn rest_is_nobodys() {
        let mut a = record(100, 7);
        a.channels.iter_mut().for_each(|c| c.values[..60].fill(0.0));
        let mut b = record(100, 8);
        b.channels.iter_mut().for_each(|c| c.values[..60].fill(0.0));
        assert_eq!(Pieces::of(&[&a], &names(), false).unwrap().share(&b, &names(), false).unwrap(), 0.0);
    }

    #[test]
    fn as_text_and_back() {
        let known = Pieces::of(&[&record(500, 9)], &names(), false).unwrap();
        let text = String::from(known.clone());
        assert_eq!((text.len(), Pieces::try_from(text)), (16 * KEPT, Ok(known)));
        for wrong in ["0", "g000000000000000", "é00000000000000"] {
            assert!(Pieces::try_from(wrong.to_string()).is_err(), "{wrong}");
        }
    }
}
