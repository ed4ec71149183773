//! Options of a bed from the table that a spec gives, over the defaults of the parameter set.

use super::settings::BedOptions;
use crate::error::PlantError;
use toml::{Table, Value};

impl BedOptions {
    /// The options of parameter set `set` with what `given` says otherwise. Tables merge key by key; `false` in place of
    /// a table switches that part off, and `real = true` or `real = false` chooses between the real bed (that of the set, where
    /// it has one) and the ideal one as what the rest is laid over.
    ///
    /// # Errors
    /// [`PlantError::Bed`] for unknown keys, wrong types, and values out of range.
    ///
    /// ```
    /// use dynocal_plant::testbed::settings::BedOptions;
    /// let table: toml::Table = toml::from_str("[dynamometer]\nmode = \"load\"").unwrap();
    /// let o = BedOptions::from_table("thesis", &table)?;
    /// assert_ne!(o.dynamometer.mode, BedOptions::default().dynamometer.mode);
    /// let real: toml::Table = toml::from_str("real = true").unwrap();
    /// assert_eq!(BedOptions::from_table("pfi_1_6l", &real)?, BedOptions::of_set("pfi_1_6l"));
    /// assert_eq!(BedOptions::from_table("thesis", &real)?, BedOptions::real());
    /// # Ok::<(), dynocal_plant::error::PlantError>(())
    /// ```
    pub fn from_table(set: &str, given: &Table) -> Result<Self, PlantError> {
        let mut given = given.clone();
        let base = match given.remove("real") {
            None => Self::of_set(set),
            Some(Value::Boolean(true)) => Self::real_of_set(set),
            Some(Value::Boolean(false)) => Self::default(),
            Some(other) => return Err(refused("bed.real", &other, "true or false")),
        };
        let mut merged =
            Table::try_from(&base).map_err(|e| refused("bed", &e, "a bed that can be written"))?;
        merge(&mut merged, given);
        let options: Self = merged.try_into().map_err(|e: toml::de::Error| {
            refused("bed", &e.message().replace('\n', " "), "the keys of docs/testbed.md")
        })?;
        options.check()?;
        Ok(options)
    }
}

fn refused(key: &str, found: &dyn std::fmt::Display, expected: &str) -> PlantError {
    PlantError::Bed { key: key.to_owned(), found: found.to_string(), expected: expected.to_owned() }
}

fn merge(base: &mut Table, given: Table) {
    for (key, value) in given {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(_)), Value::Boolean(false)) => {
                base.remove(&key);
            }
            (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}
