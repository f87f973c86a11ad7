//! The state of PPO, as a checkpoint holds it in the middle of a rollout or of the learning from
//! it.

use crate::agent::ppo::learner::Learning;
use crate::agent::ppo::{Ppo, PpoEngine, PpoLearner};
use crate::env::{EpisodeStatus, VectorEnvironment};
use crate::state::resumable;

resumable!([E: PpoEngine, Env: VectorEnvironment] PpoLearner<E, Env> {
    parts engine, environment, environment_streams, exploration_stream, minibatch_stream, begun, ended, updates,
    rollout, finished, loss_sum, losses, learning;
    fixed numbers, totals, lengths, memory;
    check fits, "rollout"
});

resumable!([] Learning { parts epoch, parts; grown order });

impl<E: PpoEngine, Env: VectorEnvironment> PpoLearner<E, Env> {
    /// Whether the restored parts are consistent.
    fn fits(&self) -> bool {
        let count = self.environment.action_spec().count;
        let remembered = if self.rollout.steps() == 0 { 0 } else { self.memory.len() };
        self.rollout.memory.len() == remembered
            && self.rollout.actions.iter().all(|action| action.index() < count)
            && self.counts_fit()
            && self.learning.iter().all(|learning| self.fits_rollout(learning))
    }

    /// Whether the number of episodes that have begun equals those that ended plus those running.
    fn counts_fit(&self) -> bool {
        let statuses = self.environment.statuses().iter();
        let running = statuses.filter(|status| **status == EpisodeStatus::Running).count();
        let ended = self.ended as usize + self.finished.len();
        self.begun <= self.parameters.episodes && self.begun as usize == ended + running
    }

    /// Whether the progress of learning is consistent with the rollout.
    fn fits_rollout(&self, learning: &Learning) -> bool {
        let Ppo { minibatches, epochs, .. } = self.parameters;
        let rows = self.rollout.real.len();
        let below = if self.engine.memory() > 0 { self.rollout.lanes } else { rows };
        let parts = (minibatches as usize).min(learning.order.len());
        learning.epoch < epochs
            && learning.parts < parts
            && self.rollout.advantages.len() == rows
            && learning.order.iter().all(|row| (*row as usize) < below)
    }
}
