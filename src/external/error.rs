//! Errors that end an outside program.

use std::io;

/// Why an outside program did not finish its job.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProgramError {
    /// The program cannot be started.
    #[error("cannot start `{command}` in {folder}: {source}{help}")]
    NotStarted {
        /// The command.
        command: String,
        /// The working directory.
        folder: String,
        /// The error of the operating system.
        source: io::Error,
        /// What to do, or nothing.
        help: &'static str,
    },
    /// The program ended too early, or closed its standard output.
    #[error("`{command}` {end} {when}{said}")]
    Ended {
        /// The command.
        command: String,
        /// How it ended, as in "exited with code 1".
        end: String,
        /// What the program was doing, and which message was expected.
        when: String,
        /// The last lines of its standard error, or nothing.
        said: String,
    },
    /// The program broke the protocol.
    #[error("`{command}` broke the protocol: {fault}{said}")]
    Protocol {
        /// The command.
        command: String,
        /// What was found and what was expected.
        fault: String,
        /// The last lines of its standard error, or nothing.
        said: String,
    },
    /// A stop was requested.
    #[error("stopped")]
    Stopped,
}
