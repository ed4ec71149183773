//! The dynocal command-line tool.
fn main() {}
