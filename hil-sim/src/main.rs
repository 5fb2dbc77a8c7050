//! The simulated printer as a program; everything is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    hil_sim::cli::main_from(std::env::args_os())
}
