//! Members of a family named in a spec: name and keys, built once to see that they fit.

use dynocal_files::spec::{Faults, plain};
use dynocal_ident::prepare::Planned;
use dynocal_numerics::registry::BuildError;

/// Name and keys of a table like `{ name = "arx", na = 2 }`, `name` being the key that names the member.
pub(super) fn member_of(
    key: &str,
    name: &str,
    table: &toml::Table,
    hint: &str,
    faults: &mut Faults,
) -> Option<(String, toml::Table)> {
    let mut keys = table.clone();
    match keys.remove(name) {
        Some(toml::Value::String(member)) => Some((member, keys)),
        _ => {
            faults.push(&format!("{key}.{name}"), "no text", format!("a name ({hint})"));
            None
        }
    }
}

/// The same where the table itself may be missing.
pub(super) fn member(
    key: &str,
    table: &Option<toml::Table>,
    faults: &mut Faults,
) -> Option<(String, toml::Table)> {
    let table = faults.required(key, table, "a table with name and its keys (see `dynocal list`)")?;
    member_of(key, "name", &table, "see `dynocal list`", faults)
}

/// What was built, or the fault in words for the user.
pub fn built<T>(key: &str, name: &str, result: Result<T, BuildError>, faults: &mut Faults) -> Option<T> {
    match result {
        Ok(t) => Some(t),
        Err(BuildError::UnknownMember { found, known, .. }) => {
            faults.unknown(&format!("{key}.{name}"), &found, &known);
            None
        }
        Err(BuildError::Keys { message, .. }) => {
            let known: Vec<String> = message.split('`').skip(1).step_by(2).map(str::to_string).collect();
            match known.split_first() {
                Some((found, known)) if message.starts_with("unknown field") => {
                    faults.unknown(&format!("{key}.{found}"), found, known);
                }
                Some((found, _)) if message.starts_with("missing field") => {
                    faults.push(&format!("{key}.{found}"), "nothing", "this key (see `dynocal list`)");
                }
                _ if message.contains(", expected ") && message.starts_with("invalid ") => {
                    let (found, expected) = plain(&message);
                    faults.push(key, found, format!("{expected} (see `dynocal list`)"));
                }
                _ => faults.push(key, message, "keys as `dynocal list` shows them"),
            }
            None
        }
    }
}

/// [`built`] from `keys`: a fault names the key whose value is wrong.
pub fn built_with<T>(
    key: &str,
    name: &str,
    keys: &toml::Table,
    build: impl Fn(&toml::Table) -> Result<T, BuildError>,
    faults: &mut Faults,
) -> Option<T> {
    let result = build(keys);
    // The reader of keys says what it found, not where: it is the key without which this fault is gone.
    let wrong = match &result {
        Err(BuildError::Keys { message, .. }) if message.starts_with("invalid ") => keys.keys().find(|k| {
            let mut rest = keys.clone();
            rest.remove(*k);
            !matches!(build(&rest), Err(BuildError::Keys { message: other, .. }) if other == *message)
        }),
        _ => None,
    };
    let place = wrong.map_or_else(|| key.to_string(), |k| format!("{key}.{k}"));
    built(&place, name, result, faults)
}

/// Whether a step of the preparation can be built.
pub(super) fn check_step(key: &str, step: &str, keys: &toml::Table, faults: &mut Faults) -> Option<()> {
    built_with(key, "step", keys, |keys| Planned::new(step, keys), faults).map(|_| ())
}
