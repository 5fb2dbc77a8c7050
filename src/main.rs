//! The `lumenfab` command.

fn main() -> std::process::ExitCode {
    lumenfab::cli::main()
}
