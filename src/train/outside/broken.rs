//! The reasons why the job of an outside program ends early.

use crate::agent::OutOfMemory;
use crate::external::{FromProgram, Program, ProgramError};

/// Why a job ends early.
pub(super) enum Broken {
    /// The program failed, or the job was stopped.
    Program(ProgramError),
    /// There is not enough memory.
    OutOfMemory(OutOfMemory),
}

impl From<ProgramError> for Broken {
    fn from(error: ProgramError) -> Self {
        Broken::Program(error)
    }
}

impl From<OutOfMemory> for Broken {
    fn from(error: OutOfMemory) -> Self {
        Broken::OutOfMemory(error)
    }
}

/// The error of a program that sent an unexpected message.
pub(super) fn unexpected(
    program: &mut Program,
    found: &FromProgram,
    expected: &str,
) -> ProgramError {
    program.broke(format!("expected {expected}, found \"{}\"", found.word()))
}
