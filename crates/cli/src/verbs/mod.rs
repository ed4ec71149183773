//! One file per verb, one line here: the file exports `VERB`.

use clap::{ArgMatches, Command};

use crate::failure::{Exit, Failure};

/// A verb of the command line.
pub(crate) struct Verb {
    /// Name.
    pub(crate) name: &'static str,
    /// Adds its description and arguments.
    pub(crate) describe: fn(Command) -> Command,
    /// Does it.
    pub(crate) run: fn(&ArgMatches) -> Result<Exit, Failure>,
}

macro_rules! verbs {
    ($($file:ident),* $(,)?) => {
        $(mod $file;)*
        /// All verbs, in the order of the help text.
        static VERBS: &[Verb] = &[$($file::VERB),*];
    };
}
mod calibrate_text;
mod engine_cycle;
mod engine_fit;
mod engine_map;
mod engine_transient;
mod reading;

verbs![
    new,        //
    calibrate,  //
    map,        //
    identify,   //
    simulate,   //
    label,      //
    optimise,   //
    control,    //
    fuelling,   //
    design,     //
    sequential, //
    signal,     //
    study,      //
    report,     //
    engine,     //
    show,       //
    convert,    //
    export,     //
    compare,    //
    list,       //
];

/// The whole command line.
pub(crate) fn command() -> Command {
    let root = Command::new("dynocal")
        .version(env!("CARGO_PKG_VERSION"))
        .about("Dynamic powertrain calibration: from a test signal to a validated dynamic map")
        .after_help("Exit codes: 0 done, 1 done but not converged or not valid, 2 could not.")
        .subcommand_required(true)
        .arg_required_else_help(true);
    VERBS.iter().fold(root, |c, v| c.subcommand((v.describe)(Command::new(v.name))))
}

/// Runs the verb that was asked for.
pub(crate) fn run(matches: &ArgMatches) -> Result<Exit, Failure> {
    let Some((name, args)) = matches.subcommand() else { return Ok(Exit::CouldNot) };
    match VERBS.iter().find(|v| v.name == name) {
        Some(verb) => (verb.run)(args),
        None => Ok(Exit::CouldNot),
    }
}
