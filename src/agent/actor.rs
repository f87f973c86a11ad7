//! The contracts of actors, which choose the actions of episodes, and of observers, which see every
//! step.

use std::io;

use crate::agent::effect_posterior::EffectPosterior;
use crate::agent::learner_error::LearnerError;
use crate::agent::weights::Weights;
use crate::env::{Action, LaneSet, Simulated, VectorEnvironment};
use crate::rng::Stream;
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// Chooses actions in the episodes of an environment; for example a trained policy or a decision rule.
/// An actor may keep memory within an episode, such as a hidden state, or learn, such as a posterior.
/// [`Resumable`] saves this memory in checkpoints.
///
/// The caller that rolls episodes calls [`Actor::reset`] for the lanes that start an episode, then
/// [`Actor::act`] before and [`Actor::observe`] after every step. A trained policy reads the
/// observations of [`VectorEnvironment::observe`]. An actor written for one environment may also read
/// the state of that environment.
pub trait Actor<Env: VectorEnvironment + ?Sized = Simulated>: Resumable + Send {
    /// Resets the memory of these lanes, which start new episodes. Does nothing by default.
    fn reset(&mut self, lanes: LaneSet<'_>) {
        let _ = lanes;
    }

    /// Chooses an action for every lane, ended lanes included. If `probabilities` are requested,
    /// they receive the probabilities from which the actions were drawn.
    ///
    /// **Shapes**: `actions` is \[lanes\], `probabilities` is \[lanes, actions\], row by row. Draws from
    /// the stream at most once per lane, and not at all if nothing is random.
    fn act(
        &mut self,
        environment: &Env,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    );

    /// Sees the rewards of the step, and the environment after the step with the status of every lane.
    /// Does nothing by default.
    fn observe(&mut self, environment: &Env, rewards: Rewards<'_>) {
        let _ = (environment, rewards);
    }
}

/// The rewards of a step, and the lanes whose rewards reach the agent.
#[derive(Clone, Copy, Debug)]
pub struct Rewards<'r> {
    /// \[lanes\]; 0 in lanes that had ended.
    pub values: &'r [f64],
    /// The lanes whose rewards reach the agent.
    pub reached: LaneSet<'r>,
}

impl<'r> Rewards<'r> {
    /// Rewards that all reach the agent, \[lanes\].
    pub fn all(values: &'r [f64]) -> Self {
        Rewards { values, reached: LaneSet::All }
    }

    /// The reward of a lane; `None` if it does not reach the agent.
    pub fn of_lane(&self, lane: usize) -> Option<f64> {
        self.reached.contains(lane).then_some(self.values[lane])
    }
}

/// The agent of a trial, which learns at calendar times. By default, it does not learn.
pub trait StudyAgent: Actor {
    /// Learns from the data that count. Does nothing by default.
    ///
    /// **Errors**: the agent cannot act on what it has learned; it cannot be used afterwards.
    fn update(&mut self, update: &StudyUpdate<'_>) -> Result<(), LearnerError> {
        let _ = update;
        Ok(())
    }

    /// Replaces the last choice by that of a record, from which the agent then learns. Does nothing by default, as for
    /// an agent that does not learn.
    ///
    /// **Shapes**: `actions` is \[people\], `probabilities` \[people, actions\].
    fn replay(&mut self, actions: &[Action], probabilities: &[f64]) {
        let _ = (actions, probabilities);
    }

    /// The posteriors of the effects of messages after every update of a trial that is over, if its plan asks for them.
    /// None by default.
    fn updates(&mut self) -> Vec<EffectPosterior> {
        Vec::new()
    }

    /// The weights that an agent has learned from all data of a trial that is over. None by default.
    ///
    /// **Errors**: as [`StudyAgent::update`].
    fn weights(&mut self) -> Result<Option<Weights>, LearnerError> {
        Ok(None)
    }
}

impl Actor for Box<dyn Actor> {
    fn reset(&mut self, lanes: LaneSet<'_>) {
        (**self).reset(lanes);
    }

    fn act(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        (**self).act(environment, stream, actions, probabilities);
    }

    fn observe(&mut self, environment: &Simulated, rewards: Rewards<'_>) {
        (**self).observe(environment, rewards);
    }
}

impl Resumable for Box<dyn Actor> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        (**self).save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        (**self).restore(from)
    }
}

/// Decision rules and trained policies act in trials without learning there.
impl StudyAgent for Box<dyn Actor> {}

/// An update of an agent at a calendar time of a trial.
#[derive(Clone, Copy, Debug)]
pub struct StudyUpdate<'u> {
    /// The people whose data count, \[people\].
    pub people: &'u [bool],
    /// The data of steps of the trial before this one count; steps are numbered from 0.
    pub before: u32,
    /// The person whose own agent is updated; `None` for an agent of everybody.
    pub agent: Option<usize>,
}

/// Reborrows an optional observer, so that several calls can use it in turn.
pub(super) fn reborrowed<'a, Env: ?Sized>(
    observer: &'a mut Option<&mut dyn StepObserver<Env>>,
) -> Option<&'a mut dyn StepObserver<Env>> {
    match observer {
        Some(observer) => Some(&mut **observer),
        None => None,
    }
}

/// Sees every step of episodes. Lanes that have ended are still shown; their statuses say so.
pub trait StepObserver<Env: ?Sized> {
    /// Sees the state before a step, the actions, and the probabilities from which they were
    /// drawn. Where only the chosen action's probability is known, the others are NaN.
    ///
    /// **Shapes**: `actions` is \[lanes\], `probabilities` is \[lanes, actions\], row by row.
    fn chosen(&mut self, environment: &Env, actions: &[Action], probabilities: &[f64]);

    /// Sees the state after the step and the rewards, \[lanes\]; lanes that had ended have reward
    /// 0.
    fn paid(&mut self, environment: &Env, rewards: &[f64]);

    /// Whether a roll should stop before the next step.
    fn stop_requested(&self) -> bool {
        false
    }
}
