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
        if !text.is_ascii() || !text.len().is_multiple_of(16) {
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
