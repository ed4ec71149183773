//! Tunes of open ECUs: the whole tune (`.msq`), a single table (`.table`), and what the ECU can hold (`.ini`).
//!
//! A tune is never written anew: [`msq::Tune`] keeps every byte of the file that it read and changes only the numbers of the labels
//! that are named, so that the tool it came from finds all the rest as it was.

pub mod ini;
pub mod msq;
pub mod table;

/// Bytes as text: ISO-8859-1 as these tools write it, UTF-8 where the file says so. The flag tells that bytes and characters count alike.
fn decoded(bytes: &[u8]) -> (String, bool) {
    let head: String = bytes.iter().take(200).map(|b| char::from(b.to_ascii_lowercase())).collect();
    match std::str::from_utf8(bytes) {
        Ok(text) if head.contains("utf-8") || text.is_ascii() => (text.to_string(), false),
        _ => (bytes.iter().map(|b| char::from(*b)).collect(), true),
    }
}

/// Line of byte `at` in `text`, from 1.
fn line_of(text: &str, at: usize) -> usize {
    1 + text.as_bytes()[..at.min(text.len())].iter().filter(|b| **b == b'\n').count()
}
