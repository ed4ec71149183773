//! Member tables: each family (signals, criteria, model structures, optimisers, plants) has one table that
//! lists its members. Spec parsing, help text, `dynocal list` and the conformance tests come from it.

use serde::Serialize;

/// Documentation of one parameter of a member.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ParamDoc {
    /// Key in the spec.
    pub name: &'static str,
    /// Unit, `-` for none.
    pub unit: &'static str,
    /// Default as text; empty when the parameter is required.
    pub default: &'static str,
    /// What it does, one line.
    pub what: &'static str,
}

/// What every member of every family tells about itself.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MemberDoc {
    /// Name in specs and on the command line.
    pub name: &'static str,
    /// One line.
    pub what: &'static str,
    /// Parameters that the spec may set.
    pub params: &'static [ParamDoc],
}

/// One row of a family's table: its documentation and how to build it from the keys of a spec.
pub struct Member<T: ?Sized + 'static> {
    /// Name, summary and parameters.
    pub doc: MemberDoc,
    /// Builds the member; unknown or wrong keys are a [`BuildError`].
    pub build: fn(&toml::Table) -> Result<Box<T>, BuildError>,
}

/// A member could not be built from the keys that a spec gave.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// The name is in no row of the table.
    #[error("unknown {family} `{found}`{}; known: {}", nearest_hint(.nearest), .known.join(", "))]
    UnknownMember {
        /// Family, e.g. `criterion`.
        family: &'static str,
        /// Name that was asked for.
        found: String,
        /// Nearest known name, if any is near.
        nearest: Option<String>,
        /// All names.
        known: Vec<String>,
    },
    /// The keys do not fit the member.
    #[error("{member}: {message}")]
    Keys {
        /// Member name.
        member: String,
        /// What is wrong, with found and expected.
        message: String,
    },
}

fn nearest_hint(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|n| format!(" (did you mean `{n}`?)")).unwrap_or_default()
}

/// Finds `name` in `table` and builds it from `keys`.
pub fn build<T: ?Sized>(
    family: &'static str,
    table: &[Member<T>],
    name: &str,
    keys: &toml::Table,
) -> Result<Box<T>, BuildError> {
    match table.iter().find(|m| m.doc.name == name) {
        Some(m) => (m.build)(keys),
        None => {
            let known: Vec<String> = table.iter().map(|m| m.doc.name.to_string()).collect();
            Err(BuildError::UnknownMember {
                family,
                found: name.into(),
                nearest: nearest(name, &known),
                known,
            })
        }
    }
}

/// Reads the keys of a member as `P` (a struct with `#[serde(default, deny_unknown_fields)]`).
pub fn keys<P: serde::de::DeserializeOwned>(member: &str, keys: &toml::Table) -> Result<P, BuildError> {
    P::deserialize(toml::Value::Table(keys.clone()))
        .map_err(|e| BuildError::Keys { member: member.into(), message: e.message().to_string() })
}

/// The entry of `known` that is nearest to `name` in edit distance, if at most a third of it differs.
pub fn nearest(name: &str, known: &[String]) -> Option<String> {
    let best = known.iter().map(|k| (edit_distance(name, k), k)).min()?;
    (best.0 * 3 <= name.chars().count().max(best.1.chars().count()) + 2).then(|| best.1.clone())
}

/// Levenshtein distance in characters.
pub fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substitute = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substitute.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edit_distance_of_textbook_pairs() {
        assert_eq!(edit_distance("kitten", "sitting"), 3);
        assert_eq!(edit_distance("", "abc"), 3);
        assert_eq!(edit_distance("flaw", "lawn"), 2);
    }

    #[test]
    fn nearest_offers_a_close_name_only() {
        let known = vec!["estimator".to_string(), "split".to_string()];
        assert_eq!(nearest("estimater", &known).as_deref(), Some("estimator"));
        assert_eq!(nearest("temperature", &known), None);
    }
}
