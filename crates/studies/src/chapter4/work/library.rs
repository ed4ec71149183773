//! Signals of a study, made once and shared by everything that asks for them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::source::{Record, Source, signals};
use super::{Chapter4Error, Setting, Size};

/// Signals by the name of their kind and the number of their set.
type Made = BTreeMap<(String, u64), Arc<Vec<Record>>>;

/// Identification and validation signals of one setting, size and seed.
///
/// ```
/// use dynocal_studies::chapter4::work::library::Library;
/// use dynocal_studies::chapter4::work::{Size, source::Source};
/// let library = Library::new(Size { identification: 3, validation: 4, designed: 0, seed: 1 })?;
/// let (a, b) = (library.identification(Source::Udrn, &|| false)?, library.validation(Source::Udrn, &|| false)?);
/// assert_eq!((a.len(), b.len()), (3, 4));
/// assert_ne!(a[0].u, b[0].u);
/// # Ok::<(), dynocal_studies::chapter4::work::Chapter4Error>(())
/// ```
pub struct Library {
    /// Models, limits and objective signal.
    pub setting: Setting,
    /// Size of the populations.
    pub size: Size,
    made: Mutex<Made>,
}

impl Library {
    /// A library of the chapter's setting.
    ///
    /// # Errors
    /// [`Chapter4Error::Objective`].
    pub fn new(size: Size) -> Result<Self, Chapter4Error> {
        Ok(Self { setting: Setting::new()?, size, made: Mutex::default() })
    }

    /// Signals that identify models.
    ///
    /// # Errors
    /// [`Chapter4Error`] of a design, or [`Chapter4Error::Interrupted`].
    pub fn identification(
        &self,
        source: Source,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Arc<Vec<Record>>, Chapter4Error> {
        self.get(source, 1, self.size.identification, interrupt)
    }

    /// Signals that validate models: of other seeds than those that identify.
    ///
    /// # Errors
    /// [`Chapter4Error`] of a design, or [`Chapter4Error::Interrupted`].
    pub fn validation(
        &self,
        source: Source,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Arc<Vec<Record>>, Chapter4Error> {
        let n = if source.is_designed() { self.size.designed } else { self.size.validation };
        self.get(source, 2, n, interrupt)
    }

    fn get(
        &self,
        source: Source,
        set: u64,
        n: usize,
        interrupt: &(dyn Fn() -> bool + Sync),
    ) -> Result<Arc<Vec<Record>>, Chapter4Error> {
        let key = (source.name(), set);
        if let Some(found) = self.made.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(found.clone());
        }
        // Outside of the lock: making them may take long and runs in parallel.
        let records = Arc::new(signals(&self.setting, source, n, set, self.size.seed, interrupt)?);
        self.made.lock().unwrap_or_else(PoisonError::into_inner).insert(key, records.clone());
        Ok(records)
    }
}
