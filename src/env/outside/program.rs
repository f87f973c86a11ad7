//! The program of an environment, which all lanes of a job share.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use serde_json::{Map, Value as Json};

use crate::env::outside::description::Description;
use crate::external::{
    Declared, ENVIRONMENT_PROTOCOL, LONGEST_ENVIRONMENT_LINE, Message, Program, ProgramError,
    StopRequested, ToEnvironment,
};

/// The declaration of an environment that is an outside program.
#[derive(Clone, Debug)]
pub struct Launch {
    /// The program and its arguments.
    pub command: Vec<String>,
    /// The working directory.
    pub folder: PathBuf,
    /// The version that the manifest states.
    pub version: String,
    /// The parameters of the environment.
    pub parameters: Map<String, Json>,
}

/// The purpose of episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EpisodePhase {
    /// An agent trains in them.
    Train,
    /// A policy is tested in them.
    Test,
    /// The contract is checked in them.
    Check,
}

impl EpisodePhase {
    /// The word of the protocol.
    pub(super) fn word(self) -> &'static str {
        match self {
            EpisodePhase::Train => "train",
            EpisodePhase::Test => "test",
            EpisodePhase::Check => "check",
        }
    }
}

/// A started program of an environment. Clones are handles of the same program.
#[derive(Clone)]
pub struct EnvironmentProgram(Arc<Shared>);

struct Shared {
    description: Description,
    stop: StopRequested,
    /// The longest time for an answer; `None` for any.
    patience: Option<Duration>,
    running: Mutex<Running>,
    failure: OnceLock<ProgramError>,
}

struct Running {
    /// `None` once the program has ended.
    program: Option<Program>,
    /// Number of sets of lanes so far.
    instances: u64,
}

impl EnvironmentProgram {
    /// Starts a program and asks for its description. Every wait ends once `stop` returns true.
    ///
    /// **Errors**: the program cannot be started, ends, breaks the protocol, or `stop` returns true.
    pub fn start(launch: &Launch, stop: StopRequested) -> Result<Self, ProgramError> {
        EnvironmentProgram::start_within(launch, stop, None)
    }

    /// Starts a program that may take at most `patience` for an answer; see [`EnvironmentProgram::start`].
    pub(super) fn start_within(
        launch: &Launch,
        stop: StopRequested,
        patience: Option<Duration>,
    ) -> Result<Self, ProgramError> {
        let Launch { command, folder, version, parameters } = launch;
        let mut program = Program::start(command, folder, LONGEST_ENVIRONMENT_LINE)?;
        program.send(&ToEnvironment::Describe {
            protocol: ENVIRONMENT_PROTOCOL,
            jitai: env!("CARGO_PKG_VERSION"),
            version,
            parameters,
        });
        let expected = "\"description\"";
        let received = answer(&mut program, (expected, "at its start"), &*stop, patience);
        let declared: Declared = match received {
            Ok(declared) => declared,
            Err(ProgramError::Stopped) => {
                program.stop();
                return Err(ProgramError::Stopped);
            }
            Err(error) => return Err(error),
        };
        let description = Description::of(declared).map_err(|fault| program.broke(fault))?;
        let running = Mutex::new(Running { program: Some(program), instances: 0 });
        let failure = OnceLock::new();
        Ok(EnvironmentProgram(Arc::new(Shared { description, stop, patience, running, failure })))
    }

    /// The description of the environment.
    pub fn description(&self) -> &Description {
        &self.0.description
    }

    /// The first failure. A job checks it whenever it may pause, after every call of a learner, and before its
    /// results count. [`ProgramError::Stopped`] means that a wait was interrupted by a stop.
    pub fn failure(&self) -> Option<&ProgramError> {
        self.0.failure.get()
    }

    /// The first failure, if no lanes of the program are left.
    pub(super) fn into_failure(self) -> Option<ProgramError> {
        Arc::into_inner(self.0)?.failure.into_inner()
    }

    /// Ends a program whose job is done. It has two seconds to exit by itself.
    pub fn finish(&self) {
        if let Some(mut program) = self.with(|running| running.program.take()) {
            program.send(&ToEnvironment::End {});
            program.finish(&*self.0.stop);
        }
    }

    /// Ends a program whose job has been stopped.
    pub fn stop(&self) {
        if let Some(program) = self.with(|running| running.program.take()) {
            program.stop();
        }
    }

    /// Sends a message that has no answer.
    pub(super) fn send(&self, message: &ToEnvironment<'_>) {
        self.with(|running| running.program.as_mut().map(|program| program.send(message)));
    }

    /// Begins another set of lanes; returns its number.
    pub(super) fn begin(&self, lanes: usize, phase: EpisodePhase, state: bool) -> u64 {
        let instance = self.with(|running| {
            running.instances += 1;
            running.instances
        });
        self.send(&ToEnvironment::Begin { instance, lanes, phase: phase.word(), state });
        instance
    }

    /// Sends a message and returns the answer as `read` takes it; `None` after a failure. `when` is what the
    /// program was doing.
    pub(super) fn ask<M: Message>(
        &self,
        message: &ToEnvironment<'_>,
        expected: &str,
        when: &str,
    ) -> Option<M> {
        if self.failure().is_some() {
            return None;
        }
        let answer = self.with(|running| {
            let program = running.program.as_mut()?;
            program.send(message);
            Some(answer(program, (expected, when), &*self.0.stop, self.0.patience))
        });
        match answer? {
            Ok(answer) => Some(answer),
            Err(error) => {
                let _ = self.0.failure.set(error);
                None
            }
        }
    }

    /// Ends a program that broke the protocol.
    pub(super) fn broke(&self, fault: String) {
        if let Some(mut program) = self.with(|running| running.program.take()) {
            let _ = self.0.failure.set(program.broke(fault));
        }
    }

    fn with<T>(&self, work: impl FnOnce(&mut Running) -> T) -> T {
        work(&mut self.0.running.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Waits for an answer, at most as long as `patience`.
///
/// **Errors**: the program ends, breaks the protocol, takes longer, or `stop` returns true.
fn answer<M: Message>(
    program: &mut Program,
    (expected, when): (&str, &str),
    stop: &dyn Fn() -> bool,
    patience: Option<Duration>,
) -> Result<M, ProgramError> {
    let until = patience.map(|patience| Instant::now() + patience);
    let is_late = || until.is_some_and(|until| Instant::now() > until);
    match program.receive(expected, when, &|| stop() || is_late()) {
        Err(ProgramError::Stopped) if is_late() && !stop() => Err(program.broke(format!(
            "expected {expected} within {} s {when}, found nothing; flush standard output after every message",
            patience.unwrap_or_default().as_secs_f64(),
        ))),
        received => received,
    }
}

impl std::fmt::Debug for EnvironmentProgram {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EnvironmentProgram").field("description", &self.0.description).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silent_program_is_a_fault_where_patience_ends() {
        let launch = Launch {
            command: ["sleep", "600"].map(str::to_owned).into(),
            folder: std::env::temp_dir(),
            version: "1".to_owned(),
            parameters: Map::new(),
        };
        let patience = Some(Duration::from_millis(50));
        let error = EnvironmentProgram::start_within(&launch, Arc::new(|| false), patience);
        let error = error.unwrap_err().to_string();
        assert!(
            error.contains("\"description\" within 0.05 s at its start, found nothing"),
            "{error}"
        );
    }
}
