//! The dynocal command-line tool: it parses, calls and shows; the mathematics is in the crates below.

mod common;
mod failure;
mod interrupt;
mod progress;
mod table;
mod terminal;
mod verbs;

use std::process::ExitCode;

use failure::{Exit, Failure};
use terminal::say;

fn main() -> ExitCode {
    // A panic is always our bug, never the user's: say so instead of showing a backtrace.
    std::panic::set_hook(Box::new(|info| {
        say(&format!("error: this is a bug in dynocal, not in your input: {info}"));
        say("  hint: please report it with the command and its spec on the project's issue page");
    }));
    let outcome = std::panic::catch_unwind(|| {
        let matches = match verbs::command().try_get_matches() {
            Ok(matches) => matches,
            Err(e) => return unparsed(&e).unwrap_or_else(could_not),
        };
        verbs::run(&matches).unwrap_or_else(could_not)
    });
    outcome.unwrap_or(Exit::CouldNot).into()
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
