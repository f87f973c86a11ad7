//! The `jitai` program; everything is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    jitai::cli::main()
}
