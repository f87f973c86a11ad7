//! A program as the agent of a test or a trial: it chooses, and in a trial it sees rewards, and learns at calendar times.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::agent::{Actions, Actor, LearnerError, Rewards, StudyAgent, StudyUpdate};
use crate::env::{Action, LaneSet, Simulated, VectorEnvironment};
use crate::external::{Program, ProgramError, ToProgram};
use crate::job::Job;
use crate::rng::Stream;
use crate::state::resumable;
use crate::train::control::TrainingControl;
use crate::train::test::Test;

use super::broken::Broken;
use super::question::{Chosen, Question};

/// Plays the test or the trial of a job with the choices of a program.
pub(super) fn play(
    job: &Job,
    test: &mut Test,
    program: &mut Program,
    control: &dyn TrainingControl,
) -> Result<(), Broken> {
    let handle = control.stop_handle();
    let has_failed = AtomicBool::new(false);
    let occasion = match &job.trial {
        None => Occasion::Test { how: job.evaluation.test_actions.into(), is_announced: false },
        Some(trial) => Occasion::Trial { per_day: trial.decisions_per_day, time: 0 },
    };
    let mut agent = ProgramAgent {
        program,
        stop: &*handle,
        occasion,
        question: Question::new(job),
        taken: Vec::new(),
        failure: None,
        has_failed: &has_failed,
    };
    let pause = || has_failed.load(Ordering::Relaxed) || control.stop_requested();
    while !test.is_over() {
        test.advance(&mut agent, &pause).map_err(|error| match error {
            LearnerError::OutOfMemory(error) => Broken::from(error),
            LearnerError::Diverged(_) | LearnerError::Singular { .. } => {
                unreachable!("a program reports no such error: {error}")
            }
        })?;
        match agent.failure.take() {
            Some(error) => return Err(error.into()),
            None if pause() && !test.is_over() => return Err(ProgramError::Stopped.into()),
            None => {}
        }
    }
    Ok(())
}

/// A program as an agent. After a failure, the test or trial ends before its next step.
struct ProgramAgent<'p> {
    program: &'p mut Program,
    stop: &'p (dyn Fn() -> bool + Send + Sync),
    occasion: Occasion,
    question: Question,
    /// The actions that were taken in the lanes of the question.
    taken: Vec<usize>,
    failure: Option<ProgramError>,
    has_failed: &'p AtomicBool,
}

/// What the program takes part in.
enum Occasion {
    /// A test with these choices; whether the present batch of episodes has been announced.
    Test { how: Actions, is_announced: bool },
    /// A trial with decisions per day, and the number of its steps so far.
    Trial { per_day: u32, time: u32 },
}

impl ProgramAgent<'_> {
    /// Asks for the choices of a step, and writes them.
    fn choose(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: &mut [f64],
    ) -> Result<(), ProgramError> {
        self.question.find(environment);
        // In a trial, drawn for everybody, so that choices do not depend on who is in the study.
        let (how, moment, when, units) = match &mut self.occasion {
            Occasion::Test { how, is_announced } => {
                if !std::mem::replace(is_announced, true) {
                    self.program.send(&ToProgram::Test { lanes: environment.lanes() });
                }
                (*how, None, "in the test".to_owned(), None)
            }
            Occasion::Trial { per_day, time } => {
                let units: Vec<f64> = actions.iter().map(|_| stream.unit()).collect();
                if self.question.running.is_empty() {
                    return Ok(());
                }
                let (day, decision) = (*time / *per_day, *time % *per_day);
                let when = format!("in the trial, on day {day}");
                (Actions::AsTrained, Some([day, decision]), when, Some(units))
            }
        };
        let choices = self.question.ask(environment, self.program, moment, &when, self.stop)?;
        let running = &self.question.running;
        let chosen = Chosen { running, actions: &mut *actions, probabilities };
        let mut unit = |lane: usize| match &units {
            Some(units) => units[lane],
            None => stream.unit(),
        };
        let read = chosen.read(&choices, how, &mut unit);
        read.map_err(|fault| self.program.broke(fault))?;
        let taken = |lane: &usize| environment.taken(*lane, actions[*lane]).index();
        self.taken.clear();
        self.taken.extend(running.iter().map(taken));
        Ok(())
    }
}

impl Actor for ProgramAgent<'_> {
    /// Announces the episodes of a test, which begin together.
    fn reset(&mut self, _: LaneSet<'_>) {
        if let Occasion::Test { is_announced, .. } = &mut self.occasion {
            *is_announced = false;
        }
    }

    fn act(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        let probabilities = probabilities.expect("a drive asks for them");
        self.failure = self.choose(environment, stream, actions, probabilities).err();
        self.has_failed.store(self.failure.is_some(), Ordering::Relaxed);
    }

    fn observe(&mut self, _: &Simulated, rewards: Rewards<'_>) {
        let Occasion::Trial { time, .. } = &mut self.occasion else { return };
        *time += 1;
        let lanes = &self.question.running;
        if !lanes.is_empty() && self.failure.is_none() {
            let rewards: Vec<Option<f64>> =
                lanes.iter().map(|lane| rewards.of_lane(*lane)).collect();
            self.program.send(&ToProgram::Rewards {
                lanes,
                actions: &self.taken,
                rewards: &rewards,
            });
        }
    }
}

impl StudyAgent for ProgramAgent<'_> {
    fn update(&mut self, update: &StudyUpdate<'_>) -> Result<(), LearnerError> {
        let Occasion::Trial { per_day, time } = self.occasion else { return Ok(()) };
        let people = update.people.iter().enumerate();
        let people: Vec<usize> =
            people.filter(|(_, counts)| **counts).map(|(person, _)| person).collect();
        self.program.send(&ToProgram::Update {
            day: time / per_day,
            people: &people,
            before: update.before / per_day,
            agent: update.agent,
        });
        Ok(())
    }
}

// Jobs with programs start over.
resumable!([] ProgramAgent<'_> {});
