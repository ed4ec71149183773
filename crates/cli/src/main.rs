//! The program `dynocal`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(dynocal_cli::run(std::env::args_os()))
}
