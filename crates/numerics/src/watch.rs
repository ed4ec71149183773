//! What listens to a long computation: one type for every job and for every face.
//!
//! Numerical routines keep asking a plain `interrupt: &dyn Fn() -> bool`; a job takes a [`Watch`] and hands its parts
//! down.

/// Three questions and messages of a computation that runs: whether to stop, what happens, how far it is.
///
/// ```
/// use std::sync::atomic::{AtomicUsize, Ordering};
/// use dynocal_numerics::watch::Watch;
///
/// fn work(watch: Watch) -> usize {
///     watch.note("counting");
///     (0..10).take_while(|k| { watch.fraction(*k as f64 / 10.0); !watch.interrupted() }).count()
/// }
/// assert_eq!(work(Watch::silent()), 10);
/// let asked = AtomicUsize::new(0);
/// let stop = || asked.fetch_add(1, Ordering::Relaxed) == 3;
/// assert_eq!(work(Watch { interrupt: &stop, ..Watch::silent() }), 3);
/// ```
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Asked often; `true` ends the work at the next safe point.
    pub interrupt: &'a (dyn Fn() -> bool + Sync),
    /// Told what happens, a line at a time.
    pub note: &'a (dyn Fn(&str) + Sync),
    /// Told the share of the work that is done, 0 to 1, where it is known.
    pub fraction: &'a (dyn Fn(f64) + Sync),
}

impl Watch<'static> {
    /// Nobody listens and nobody stops.
    pub fn silent() -> Self {
        Self { interrupt: &|| false, note: &|_| (), fraction: &|_| () }
    }
}

impl Watch<'_> {
    /// Whether the work should end.
    pub fn interrupted(&self) -> bool {
        (self.interrupt)()
    }

    /// Says what happens.
    pub fn note(&self, text: &str) {
        (self.note)(text);
    }

    /// Says how far the work is; values outside of 0 to 1 are cut.
    pub fn fraction(&self, done: f64) {
        (self.fraction)(done.clamp(0.0, 1.0));
    }
}

impl std::fmt::Debug for Watch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("Watch")
    }
}
