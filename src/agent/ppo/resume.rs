//! The state of PPO, as a checkpoint holds it in the middle of a rollout or of the learning from
//! it.

use std::io;

use crate::agent::learner::TrainedEpisode;
use crate::agent::ppo::learner::Learning;
use crate::agent::ppo::{Ppo, PpoEngine, PpoLearner};
use crate::env::{EpisodeStatus, VectorEnvironment};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

impl<E: PpoEngine, Env: VectorEnvironment> Resumable for PpoLearner<E, Env> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.engine.save(out)?;
        self.environment.save(out)?;
        self.environment_streams.save(out)?;
        self.exploration_stream.save(out)?;
        self.minibatch_stream.save(out)?;
        out.one(self.begun)?;
        out.one(self.ended)?;
        out.one(self.updates)?;
        out.many(&self.numbers)?;
        out.many(&self.totals)?;
        out.many(&self.lengths)?;
        out.many(&self.memory)?;
        self.rollout.save(out)?;
        out.each(self.finished.iter(), |out, episode| episode.save(out))?;
        out.one(self.loss_sum)?;
        out.one(self.losses)?;
        out.each(self.learning.iter(), |out, learning| {
            out.one(learning.epoch)?;
            out.one(learning.parts as u64)?;
            out.many(&learning.order)
        })
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "rollout";
        self.engine.restore(from)?;
        self.environment.restore(from)?;
        self.environment_streams.restore(from)?;
        self.exploration_stream.restore(from)?;
        self.minibatch_stream.restore(from)?;
        self.begun = from.one()?;
        self.ended = from.one()?;
        self.updates = from.one()?;
        from.fill(&mut self.numbers, WHAT)?;
        from.fill(&mut self.totals, WHAT)?;
        from.fill(&mut self.lengths, WHAT)?;
        from.fill(&mut self.memory, "memory")?;
        self.rollout.restore(from)?;
        let remembered = self.rollout.memory.len();
        if remembered != if self.rollout.steps() == 0 { 0 } else { self.memory.len() } {
            return Err(StateError::Misfit(WHAT));
        }
        self.finished = from.each(usize::MAX, "episodes", |from| {
            let mut episode = TrainedEpisode::default();
            episode.restore(from)?;
            Ok(episode)
        })?;
        self.loss_sum = from.one()?;
        self.losses = from.one()?;
        let rows = self.rollout.real.len();
        let learning = from.each(1, WHAT, |from| {
            let (epoch, parts) = (from.one()?, from.one::<u64>()? as usize);
            Ok(Learning { epoch, parts, order: from.many(rows, WHAT)? })
        })?;
        self.learning = learning.into_iter().next();
        let fits = self.counts_fit() && self.learning.iter().all(|learning| self.fits(learning));
        if fits { Ok(()) } else { Err(StateError::Misfit(WHAT)) }
    }
}

impl<E: PpoEngine, Env: VectorEnvironment> PpoLearner<E, Env> {
    /// Whether the number of episodes that have begun equals those that ended plus those running.
    fn counts_fit(&self) -> bool {
        let statuses = self.environment.statuses().iter();
        let running = statuses.filter(|status| **status == EpisodeStatus::Running).count();
        let ended = self.ended as usize + self.finished.len();
        self.begun <= self.parameters.episodes && self.begun as usize == ended + running
    }

    /// Whether the progress of learning is consistent with the rollout.
    fn fits(&self, learning: &Learning) -> bool {
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
