//! Starts the command and turns its result into an exit code.

fn main() -> std::process::ExitCode {
    pivotsight::cli::run()
}
