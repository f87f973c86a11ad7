//! A trial of a program: the contract of environments, checked with the program itself.

use std::time::{Duration, Instant};

use serde::Serialize;

use crate::env::contract::{self, ContractViolation};
use crate::env::outside::client::OutsideEnvironment;
use crate::env::outside::description::Description;
use crate::env::outside::program::{EnvironmentProgram, EpisodePhase, Launch};
use crate::env::vector::{Action, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment};
use crate::external::{ProgramError, StopRequested, shown};
use crate::rng::{Purpose, Stream};

/// The range of the number of steps of a walk.
const STEPS: std::ops::RangeInclusive<usize> = 200..=20_000;

/// The longest time that a program may take for an answer.
const PATIENCE: Duration = Duration::from_secs(60);

/// The numbers of lanes that are timed, and the time for each.
const TIMED: [usize; 2] = [1, 64];
const TIME: Duration = Duration::from_millis(200);

/// The result of a trial.
#[derive(Clone, Debug, Serialize)]
pub struct Trial {
    /// The description of the environment.
    pub description: Description,
    /// Steps per second and lane-steps per second, by the number of lanes: 1 and 64.
    pub speeds: [(usize, f64); 2],
}

/// Why a program failed its trial.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// It does not run, or breaks the protocol.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// It breaks the contract of environments.
    #[error("`{command}` broke the contract of environments: {violation}")]
    Contract {
        /// The command.
        command: String,
        /// The violation.
        violation: ContractViolation,
    },
}

/// Starts a program and checks the contract: equal seeds give equal episodes, lanes do not depend on their
/// neighbours, and values lie inside their bounds. Then times its steps.
///
/// **Errors**: the first fault.
pub fn try_program(launch: &Launch, stop: StopRequested) -> Result<Trial, TrialError> {
    let program = EnvironmentProgram::start_within(launch, stop, Some(PATIENCE))?;
    let description = program.description().clone();
    let all: Vec<usize> = (0..description.features.len()).collect();
    // Episodes end by the horizon at the latest.
    let horizon = description.horizon as usize;
    let steps = (horizon + 20).clamp(*STEPS.start(), *STEPS.end());
    let lanes = |lanes| OutsideEnvironment::new(&program, EpisodePhase::Check, &all, true, lanes);
    let checked = contract::check_walks(lanes, steps, horizon <= steps);
    let speeds = TIMED.map(|number| match (&checked, program.failure()) {
        (Ok(()), None) => (number, steps_per_second(lanes(number))),
        _ => (number, 0.0),
    });
    program.finish();
    // A walk after a failure breaks other clauses.
    if let Some(error) = program.into_failure() {
        return Err(error.into());
    }
    let command = shown(&launch.command);
    checked.map_err(|violation| TrialError::Contract { command, violation })?;
    Ok(Trial { description, speeds })
}

/// Lane-steps per second with random actions, resets included.
fn steps_per_second(mut lanes: OutsideEnvironment) -> f64 {
    let number = lanes.lanes();
    let count = lanes.action_spec().count as u32;
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::Environment));
    let mut choices = Stream::new(1, Purpose::Exploration);
    let (mut actions, mut rewards) = (vec![Action::default(); number], vec![0.0; number]);
    lanes.reset(LaneSet::All, &mut streams);
    let (begun, mut steps) = (Instant::now(), 0);
    while begun.elapsed() < TIME && lanes.program().failure().is_none() {
        for action in &mut actions {
            *action = Action::from_index(choices.below(count) as usize).unwrap_or_default();
        }
        lanes.step(&actions, &mut rewards, &mut streams);
        steps += number;
        let ended: Vec<bool> =
            lanes.statuses().iter().map(|status| *status != EpisodeStatus::Running).collect();
        lanes.reset(LaneSet::Masked(&ended), &mut streams);
    }
    steps as f64 / begun.elapsed().as_secs_f64()
}
