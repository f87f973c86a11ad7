//! The trial of a program: it chooses for the people in the study, sees their rewards, and learns at calendar times.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::agent::{Actions, Actor, LearnerError, StudyUpdate};
use crate::env::{Action, Simulated};
use crate::external::{Program, ProgramError, ToProgram};
use crate::job::{Job, Trial};
use crate::rng::Stream;
use crate::state::resumable;
use crate::train::control::TrainingControl;
use crate::train::test::Test;

use super::broken::Broken;
use super::testing::{Chosen, Question};

/// Plays the trial of a job with the choices of a program.
pub(super) fn play(
    (job, mut test): (&Job, Test),
    trial: &Trial,
    program: &mut Program,
    control: &dyn TrainingControl,
) -> Result<Test, Broken> {
    let handle = control.stop_handle();
    let has_failed = AtomicBool::new(false);
    let mut agent = InTrial {
        program,
        stop: &*handle,
        per_day: trial.decisions_per_day,
        time: 0,
        question: Question::new(job),
        taken: Vec::new(),
        failure: None,
        has_failed: &has_failed,
    };
    let pause = || has_failed.load(Ordering::Relaxed) || control.stop_requested();
    test.advance(&mut agent, &pause).map_err(|error| match error {
        LearnerError::OutOfMemory(error) => Broken::from(error),
        LearnerError::Diverged(_) | LearnerError::Singular { .. } => {
            unreachable!("a program reports no such error: {error}")
        }
    })?;
    match agent.failure {
        Some(error) => Err(error.into()),
        None if test.is_over() => Ok(test),
        None => Err(ProgramError::Stopped.into()),
    }
}

/// A program as the agent of a trial. After a failure, the trial ends before its next step.
struct InTrial<'p> {
    program: &'p mut Program,
    stop: &'p (dyn Fn() -> bool + Send + Sync),
    per_day: u32,
    /// The number of steps of the trial so far.
    time: u32,
    question: Question,
    /// The actions that were taken in the lanes of the question.
    taken: Vec<usize>,
    failure: Option<ProgramError>,
    has_failed: &'p AtomicBool,
}

impl InTrial<'_> {
    /// Asks for the choices of a step, and writes them.
    fn choose(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: &mut [f64],
    ) -> Result<(), ProgramError> {
        // Drawn for everybody, so that choices do not depend on who is in the study.
        let units: Vec<f64> = actions.iter().map(|_| stream.unit()).collect();
        self.question.find(environment);
        if self.question.running.is_empty() {
            return Ok(());
        }
        let (day, decision) = (self.time / self.per_day, self.time % self.per_day);
        let when = format!("in the trial, on day {day}");
        let moment = Some([day, decision]);
        let choices = self.question.ask(environment, self.program, moment, &when, self.stop)?;
        let running = &self.question.running;
        let chosen = Chosen { running, actions: &mut *actions, probabilities };
        let read = chosen.read(&choices, Actions::AsTrained, &mut |lane| units[lane]);
        read.map_err(|fault| self.program.broke(fault))?;
        let taken = |lane: &usize| environment.taken(*lane, actions[*lane]).index();
        self.taken.clear();
        self.taken.extend(running.iter().map(taken));
        Ok(())
    }
}

impl Actor for InTrial<'_> {
    fn act(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        let probabilities = probabilities.expect("a trial asks for them");
        self.failure = self.choose(environment, stream, actions, probabilities).err();
        self.has_failed.store(self.failure.is_some(), Ordering::Relaxed);
    }

    /// Rewards that are NaN have not reached the agent.
    fn observe(&mut self, _: &Simulated, rewards: &[f64]) {
        let lanes = &self.question.running;
        if !lanes.is_empty() && self.failure.is_none() {
            let reached = |lane: &usize| Some(rewards[*lane]).filter(|reward| !reward.is_nan());
            let rewards: Vec<Option<f64>> = lanes.iter().map(reached).collect();
            self.program.send(&ToProgram::Rewards {
                lanes,
                actions: &self.taken,
                rewards: &rewards,
            });
        }
        self.time += 1;
    }

    fn update(&mut self, update: &StudyUpdate<'_>) -> Result<(), LearnerError> {
        let people = update.people.iter().enumerate();
        let people: Vec<usize> =
            people.filter(|(_, counts)| **counts).map(|(person, _)| person).collect();
        self.program.send(&ToProgram::Update {
            day: self.time / self.per_day,
            people: &people,
            before: update.before / self.per_day,
            agent: update.agent,
        });
        Ok(())
    }
}

// Jobs with programs start over.
resumable!([] InTrial<'_> {});
