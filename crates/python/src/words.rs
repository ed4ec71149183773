//! Messages of the crates below in words that a user of Python has: no types of Rust, no options of the program.

/// What a library says, and what it means. Longer pieces come before those that they contain.
const WORDS: &[(&str, &str)] = &[
    ("found unknown variant ", "found "),
    ("unknown variant ", "found "),
    ("unknown field ", "unknown key "),
    ("missing field ", "missing key "),
    ("duplicate field ", "twice the key "),
    ("invalid type: string ", "found the text "),
    ("invalid type: integer ", "found the number "),
    ("invalid type: floating point ", "found the number "),
    ("invalid type: boolean ", "found "),
    ("invalid type: sequence", "found a list"),
    ("invalid type: map", "found a mapping"),
    ("invalid type: null", "found nothing"),
    ("invalid type: unit value", "found nothing"),
    ("invalid type: ", "found "),
    ("invalid value: string ", "found the text "),
    ("invalid value: integer ", "found the number "),
    ("invalid value: floating point ", "found the number "),
    ("invalid value: ", "found "),
    ("invalid length 0", "found no values"),
    ("invalid length ", "number of values: found "),
    ("expected f64", "expected a number"),
    ("expected f32", "expected a number"),
    ("expected usize", "expected a whole number, 0 or more"),
    ("expected u64", "expected a whole number, 0 or more"),
    ("expected u32", "expected a whole number, 0 or more"),
    ("expected u16", "expected a whole number from 0 to 65535"),
    ("expected u8", "expected a whole number from 0 to 255"),
    ("expected i64", "expected a whole number"),
    ("expected i32", "expected a whole number"),
    ("expected a string", "expected a text"),
    ("expected string or map", "expected a text or a mapping"),
    ("expected a borrowed string", "expected a text"),
    ("expected path string", "expected a path"),
    ("expected a boolean", "expected true or false"),
    ("expected a sequence", "expected a list"),
    ("expected a map", "expected a mapping"),
    ("expected an array of length ", "expected a list of so many values: "),
    ("expected a tuple of size ", "expected a list of so many values: "),
    ("expected variant identifier", "expected a name"),
    ("expected internally tagged enum ", "expected a mapping, "),
    ("expected struct ", "expected a mapping with the keys of "),
    ("expected enum ", "expected a name or mapping, "),
    ("EOF while parsing a string", "it ends inside of a text"),
    ("EOF while parsing a list", "it ends inside of a list"),
    ("EOF while parsing an object", "it ends inside of a mapping"),
    ("EOF while parsing a value", "it ends where a value is expected"),
    ("Could not find EOCD", "it is no archive, expected an FMU (a zip archive)"),
    ("choose another --out folder", "choose another folder by out="),
    ("found found ", "found "),
];

/// The same message in plain words.
pub(crate) fn plain(text: &str) -> String {
    let mut text = text.to_string();
    for (found, meant) in WORDS {
        // `expected a mapping` holds `expected a map`: what is said already goes back first.
        if meant.starts_with(found) {
            text = text.replace(meant, found);
        }
        text = text.replace(found, meant);
    }
    without_numbers_of_the_system(text)
}

/// Without the numbers that the operating system has for its errors.
fn without_numbers_of_the_system(mut text: String) -> String {
    const START: &str = " (os error ";
    while let Some(at) = text.find(START) {
        let Some(end) = text[at..].find(')') else { break };
        text.replace_range(at..=at + end, "");
    }
    text
}
