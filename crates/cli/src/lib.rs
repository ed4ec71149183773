//! The dynocal command-line tool: it parses, calls and shows; the mathematics is in the crates below.
//!
//! A library, so that what else brings the program (the Python package) brings the same one: [`run`] is all of it.

mod common;
mod failure;
mod interrupt;
mod progress;
mod table;
mod terminal;
mod verbs;

use std::ffi::OsString;

use failure::{Exit, Failure};
use terminal::say;

/// Runs the program with its arguments, the first being its name, and returns its exit code: 0 done, 1 done but not converged or
/// not valid, 2 could not.
///
/// It belongs to a process of its own: it catches Ctrl-C, and writes to standard output and standard error.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    // A panic is always our bug, never the user's: say so instead of showing a backtrace.
    std::panic::set_hook(Box::new(|info| {
        say(&format!("error: this is a bug in dynocal, not in your input: {info}"));
        say("  hint: please report it with the command and its spec on the project's issue page");
    }));
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let outcome = std::panic::catch_unwind(|| {
        let matches = match verbs::command().try_get_matches_from(arguments) {
            Ok(matches) => matches,
            Err(e) => return unparsed(&e).unwrap_or_else(could_not),
        };
        verbs::run(&matches).unwrap_or_else(could_not)
    });
    outcome.unwrap_or(Exit::CouldNot).code()
}

fn could_not(failure: Failure) -> Exit {
    failure.print();
    Exit::CouldNot
}

/// The command line gave help, or a complaint, instead of a verb.
fn unparsed(e: &clap::Error) -> Result<Exit, Failure> {
    let text = e.render().to_string();
    if e.use_stderr() {
        say(text.trim_end());
        return Ok(Exit::CouldNot);
    }
    terminal::print(&text)?;
    Ok(Exit::Done)
}
