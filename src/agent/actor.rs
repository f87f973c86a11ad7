//! The contracts of actors, which choose the actions of episodes, and of observers, which see every
//! step.

use crate::env::{Action, LaneSet, PhysicalActivity, VectorEnvironment};
use crate::rng::Stream;
use crate::state::Resumable;

/// What chooses actions in the episodes of an environment: a trained policy, a decision rule, or
/// anything else. An actor may keep memory within an episode, such as a hidden state, or learn from
/// what it observes, such as a posterior: [`Resumable`] saves this memory in checkpoints.
///
/// Whoever rolls episodes calls [`Actor::reset`] for the lanes that begin an episode, then
/// [`Actor::act`] before and [`Actor::observe`] after every step. The observations of a trained policy
/// are those of [`VectorEnvironment::observe`]; an actor written for one environment may also read the
/// state of that environment.
pub trait Actor<Env: VectorEnvironment + ?Sized = PhysicalActivity>: Resumable + Send {
    /// Forgets the episodes of these lanes, which begin new ones. Does nothing unless implemented.
    fn reset(&mut self, lanes: LaneSet<'_>) {
        let _ = lanes;
    }

    /// Chooses an action for every lane, ended lanes included. If `probabilities` are asked for, they
    /// become the probabilities with which the actions were drawn.
    ///
    /// **Shapes**: `actions` and `probabilities` are \[lanes\]. The stream is drawn from at most once
    /// per lane, and never if nothing is random.
    fn act(
        &mut self,
        environment: &Env,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    );

    /// Sees the rewards of the step, \[lanes\], and the environment after the step with the status of
    /// every lane. Does nothing unless implemented.
    fn observe(&mut self, environment: &Env, rewards: &[f64]) {
        let _ = (environment, rewards);
    }
}

/// An observer for one call among several.
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
    /// Sees the state before a step, and the actions with the probabilities with which they were
    /// chosen.
    ///
    /// **Shapes**: `actions` and `probabilities` are \[lanes\].
    fn chosen(&mut self, environment: &Env, actions: &[Action], probabilities: &[f64]);

    /// Sees the state after the step, and the rewards, \[lanes\]: 0 in lanes that had ended.
    fn paid(&mut self, environment: &Env, rewards: &[f64]);

    /// Whether a roll should stop before the next step.
    fn stop_requested(&self) -> bool {
        false
    }
}
