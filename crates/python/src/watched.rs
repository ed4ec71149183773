//! Long calls: the work in a thread of its own, the caller asleep without the interpreter's lock and awake every 50 ms for
//! Ctrl-C and for the progress callback. No signal handler of ours.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use dynocal_numerics::watch::Watch;
use pyo3::prelude::*;

use crate::errors::{Kind, Refusal};

/// How often a sleeping call looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// How long a call that was asked to stop waits for a safe point. After that the thread goes on to it alone and its result is
/// thrown away: the user has the prompt back.
const GRACE: Duration = Duration::from_millis(200);
/// Stack of a worker: what a main thread usually has.
const STACK_BYTES: usize = 8 << 20;

/// Whether threads of ours have been started in this process.
static USED: AtomicBool = AtomicBool::new(false);
/// Whether this process is the child of a fork after that.
static FORKED: AtomicBool = AtomicBool::new(false);

/// To be called in a child after `fork`: threads that were there are not.
#[pyfunction]
pub(crate) fn after_fork() {
    if USED.load(Ordering::Relaxed) {
        FORKED.store(true, Ordering::Relaxed);
    }
}

/// Waits, as any long call does, and returns whether nobody has stopped it: for the tests of the above.
#[pyfunction]
pub(crate) fn rest(py: Python<'_>, seconds: f64, heeds: bool, progress: Option<Py<PyAny>>) -> PyResult<bool> {
    let long = Duration::try_from_secs_f64(seconds)
        .map_err(|e| Refusal::new(Kind::Argument, format!("seconds: found {seconds}, {e}")))?;
    watched(py, progress, move |watch| {
        let start = Instant::now();
        while start.elapsed() < long {
            if heeds && watch.interrupted() {
                return false;
            }
            watch.fraction(start.elapsed().as_secs_f64() / long.as_secs_f64());
            thread::sleep(Duration::from_millis(5).min(long));
        }
        true
    })
}

/// Refuses to compute where the threads of a pool are missing.
pub(crate) fn ready() -> Result<(), Refusal> {
    if FORKED.load(Ordering::Relaxed) {
        let text = "this process was forked after dynocal had been used: its worker threads did not come along, and a call would \
                    wait for them for ever; start processes with multiprocessing.get_context(\"spawn\")";
        return Err(Refusal::new(Kind::Fork, text));
    }
    USED.store(true, Ordering::Relaxed);
    Ok(())
}

enum News<T> {
    Note(String),
    Done(thread::Result<T>),
}

/// Runs `work` in a thread. `progress(text, fraction)` hears of it, on the caller's thread.
pub(crate) fn watched<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(Watch) -> T + Send + 'static,
) -> PyResult<T> {
    ready()?;
    let stop = Arc::new(AtomicBool::new(false));
    let share = Arc::new(AtomicU64::new(f64::NAN.to_bits()));
    let (tell, mut news) = channel();
    let (asked, done, heard) = (stop.clone(), share.clone(), progress.is_some());
    let worker = move || {
        let interrupt = || asked.load(Ordering::Relaxed);
        let note = |text: &str| {
            if heard {
                // Nobody listens any more after an interruption.
                let _ = tell.send(News::Note(text.to_string()));
            }
        };
        let fraction = |f: f64| done.store(f.to_bits(), Ordering::Relaxed);
        let watch = Watch { interrupt: &interrupt, note: &note, fraction: &fraction };
        let found = catch_unwind(AssertUnwindSafe(|| work(watch)));
        let _ = tell.send(News::Done(found));
    };
    thread::Builder::new()
        .name("dynocal".into())
        .stack_size(STACK_BYTES)
        .spawn(worker)
        .map_err(|e| Refusal::new(Kind::Run, format!("no thread could be started: {e}")))?;
    let mut shown = f64::NAN;
    loop {
        let got;
        (news, got) = wait(py, news, LOOK);
        let told = match got {
            Ok(News::Done(found)) => return found.map_err(|_| bug()),
            Ok(News::Note(text)) => {
                tell_user(py, &progress, &text, f64::from_bits(share.load(Ordering::Relaxed)))
            }
            Err(RecvTimeoutError::Disconnected) => return Err(bug()),
            Err(RecvTimeoutError::Timeout) => {
                let now = f64::from_bits(share.load(Ordering::Relaxed));
                let moved = now.is_finite() && now != shown;
                shown = now;
                if moved { tell_user(py, &progress, "", now) } else { Ok(()) }
            }
        };
        if let Err(e) = told.and_then(|()| py.check_signals()) {
            stop.store(true, Ordering::Relaxed);
            leave(py, news);
            return Err(e);
        }
    }
}

/// Waits for news without the interpreter's lock.
fn wait<T: Send>(
    py: Python<'_>,
    news: Receiver<News<T>>,
    most: Duration,
) -> (Receiver<News<T>>, Result<News<T>, RecvTimeoutError>) {
    py.detach(move || {
        let got = news.recv_timeout(most);
        (news, got)
    })
}

/// Gives a stopped worker the time to reach a safe point.
fn leave<T: Send>(py: Python<'_>, news: Receiver<News<T>>) {
    py.detach(move || {
        let start = Instant::now();
        while let Some(left) = GRACE.checked_sub(start.elapsed()) {
            match news.recv_timeout(left) {
                Ok(News::Note(_)) => {}
                Ok(News::Done(_)) | Err(_) => return,
            }
        }
    });
}

fn tell_user(py: Python<'_>, progress: &Option<Py<PyAny>>, text: &str, fraction: f64) -> PyResult<()> {
    let Some(call) = progress else { return Ok(()) };
    let fraction = fraction.is_finite().then_some(fraction);
    call.call1(py, (text, fraction)).map(drop)
}

/// What a panic is to a user.
pub(crate) fn bug() -> PyErr {
    let text = "this is a bug in dynocal, not in your input: please report it with the call and its data on the project's issue \
                page (what standard error says of it helps)";
    Refusal::new(Kind::Bug, text).into()
}

/// Runs short `work` on the caller's thread without the interpreter's lock.
pub(crate) fn short<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    ready()?;
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).map_err(|_| bug())
}
