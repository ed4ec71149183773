//! Names of the channels of a record that bound an input sample by sample.

/// Channels of a record that bound an input sample by sample: from below, from above.
pub fn bound_channels(input: &str) -> [String; 2] {
    ["lower", "upper"].map(|side| format!("{input}_{side}"))
}
