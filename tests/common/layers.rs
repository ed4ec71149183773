//! Arrows between the modules of a crate, read from its source: an import may only point down.
//!
//! Included by path from the tests of any crate:
//!
//! ```ignore
//! #[path = "../../../tests/common/layers.rs"]
//! mod layers;
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Which modules use which, with a place (`file:line`) for each arrow.
pub(crate) type Arrows = BTreeMap<(String, String), String>;

/// Arrows between the top modules of the crate with the sources in `src`: every `crate::module` in code (imports, grouped
/// ones too, and paths in expressions), and `super::module` in the top modules' own files. Comments and documentation do
/// not count; the root file, which names them all, is not a module.
pub(crate) fn arrows(src: &Path) -> Arrows {
    arrows_below(src, "crate::")
}

/// The same for the modules of a folder `src` inside a crate, whose path is `own`, e.g. `crate::identify::`.
pub(crate) fn arrows_below(src: &Path, own: &str) -> Arrows {
    let modules = modules(src);
    let mut found = Arrows::new();
    for file in sources(src) {
        let inside = file.strip_prefix(src).unwrap_or(&file);
        let Some(from) = module_of(inside) else { continue };
        let text = code(&fs::read_to_string(&file).unwrap_or_default());
        let at_top = inside.components().count() == 1;
        let prefixes: &[&str] = if at_top { &[own, "super::"] } else { &[own] };
        for prefix in prefixes {
            for (place, _) in text.match_indices(prefix) {
                // `super::super::x`, `pub(in crate::x)` and the tail of another path are no arrows of their own.
                let before = text[..place].chars().next_back();
                let restricted = text[..place].ends_with("pub(in ");
                if restricted || before.is_some_and(|c| c == ':' || c == '_' || c.is_alphanumeric()) {
                    continue;
                }
                for to in first_names(&text[place + prefix.len()..]) {
                    if to != from && modules.contains(&to) {
                        let line = 1 + text[..place].matches('\n').count();
                        found.entry((from.clone(), to)).or_insert(format!("{}:{line}", inside.display()));
                    }
                }
            }
        }
    }
    found
}

/// Faults in words: modules that are not in `order` (lowest first), and arrows that point up in it. Names in `order` that
/// the crate does not have are no fault: others may bring them.
pub(crate) fn faults(src: &Path, order: &[&str]) -> Vec<String> {
    faults_below(src, "crate::", order)
}

/// The same for the modules of a folder inside a crate.
pub(crate) fn faults_below(src: &Path, own: &str, order: &[&str]) -> Vec<String> {
    let place = |name: &str| order.iter().position(|n| *n == name);
    let mut out: Vec<String> = modules(src)
        .iter()
        .filter(|m| place(m).is_none())
        .map(|m| format!("the module `{m}` has no place in the order: name it where it belongs"))
        .collect();
    for ((from, to), at) in arrows_below(src, own) {
        if let (Some(a), Some(b)) = (place(&from), place(&to))
            && b > a
        {
            out.push(format!("{at}: `{from}` uses `{to}`, which stands above it"));
        }
    }
    out
}

/// Top modules: files and folders beside the root file.
fn modules(src: &Path) -> BTreeSet<String> {
    sources(src).iter().filter_map(|f| module_of(f.strip_prefix(src).unwrap_or(f))).collect()
}

fn module_of(inside: &Path) -> Option<String> {
    let first = inside.components().next()?.as_os_str().to_string_lossy().into_owned();
    let name = first.strip_suffix(".rs").unwrap_or(&first).to_string();
    (name != "lib" && name != "main" && name != "mod").then_some(name)
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let Ok(entries) = fs::read_dir(folder) else { return out };
    for path in entries.filter_map(|e| Some(e.ok()?.path())) {
        if path.is_dir() {
            out.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
    out.sort();
    out
}

/// The text with comments emptied, line by line; a test module at the end of a file may use what it likes.
fn code(text: &str) -> String {
    let text = text.split("\n#[cfg(test)]\nmod ").next().unwrap_or(text);
    let line = |l: &str| l.split("//").next().unwrap_or("").to_string();
    text.lines().map(line).collect::<Vec<_>>().join("\n")
}

/// The first name of a path, or of each path in braces.
fn first_names(rest: &str) -> Vec<String> {
    let name =
        |s: &str| s.trim().chars().take_while(|c| *c == '_' || c.is_alphanumeric()).collect::<String>();
    let Some(inner) = rest.strip_prefix('{') else { return vec![name(rest)] };
    let (mut depth, mut out, mut start) = (0usize, Vec::new(), 0);
    for (i, c) in inner.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                out.push(name(&inner[start..i]));
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                out.push(name(&inner[start..i]));
                start = i + 1;
            }
            _ => {}
        }
    }
    out
}
