//! The learner of the dueling DQN without memory, which learns from single transitions.

#[cfg(test)]
mod tests;

use crate::agent::actor::{Actor, StepObserver, reborrowed};
use crate::agent::dueling_dqn::play::Play;
use crate::agent::dueling_dqn::{DuelingDqn, DuelingDqnEngine, target, value_after};
use crate::agent::learner::{Actions, Learner, LearnerError, Span, TrainedEpisode};
use crate::agent::memory::OutOfMemory;
use crate::agent::policy::best;
use crate::agent::replay::{Batch, Replay};
use crate::agent::weights::Weights;
use crate::env::{Action, Observations, Simulated, VectorEnvironment};
use crate::state::resumable;

/// A dueling DQN in training, one episode at a time.
pub struct DuelingDqnLearner<E, Env = Simulated> {
    engine: E,
    replay: Replay,
    play: Play<Env>,
    workspace: Workspace,
}

/// Buffers that are reused, so that an update allocates nothing.
struct Workspace {
    positions: Vec<usize>,
    batch: Batch,
    /// Drawn positions whose target is unknown.
    unknown: Vec<usize>,
    next: Observations,
    values: Vec<f32>,
}

impl<E: DuelingDqnEngine, Env: VectorEnvironment> DuelingDqnLearner<E, Env> {
    /// A learner before its first episode, in an environment of one lane.
    pub fn new(engine: E, parameters: &DuelingDqn, environment: Env, seed: u64) -> Self {
        let none = environment.observation_spec().observations();
        DuelingDqnLearner {
            engine,
            replay: Replay::new(parameters.buffer as usize, &none, parameters.terminal_target),
            workspace: Workspace {
                positions: vec![0; parameters.batch as usize],
                batch: Batch {
                    observations: none.clone(),
                    actions: Vec::new(),
                    targets: Vec::new(),
                },
                unknown: Vec::new(),
                next: none,
                values: Vec::new(),
            },
            play: Play::new(parameters, environment, seed),
        }
    }

    /// One update from a batch of the buffer.
    fn update(&mut self) -> Result<(), LearnerError> {
        if self.play.renews_target() {
            self.engine.renew_target();
            self.replay.forget_targets();
        }
        self.replay.draw(&mut self.play.replay_stream, &mut self.workspace.positions);
        self.learn_targets()?;
        let Workspace { positions, batch, .. } = &mut self.workspace;
        self.replay.gather(positions, batch);
        let loss = self.engine.update(batch);
        self.play.count_update(loss)
    }

    /// Computes the unknown targets of the drawn transitions. The target network changes only once
    /// per period, so targets stay valid until the period ends.
    fn learn_targets(&mut self) -> Result<(), OutOfMemory> {
        let Workspace { positions, unknown, next, values, .. } = &mut self.workspace;
        unknown.clear();
        next.clear();
        for &position in positions.iter() {
            if self.replay.target(position).is_none() {
                unknown.push(position);
                self.replay.push_after(position, next);
            }
        }
        if unknown.is_empty() {
            return Ok(());
        }
        self.engine.target_values(next, values);
        let DuelingDqn { gamma, terminal_target, .. } = self.play.parameters;
        let actions = self.play.actions();
        for (&position, values) in unknown.iter().zip(values.chunks_exact(actions)) {
            let transition = self.replay.transition(position);
            let target =
                target(&transition, value_after(&transition, values), gamma, terminal_target);
            self.replay.set_target(position, target)?;
        }
        Ok(())
    }

    /// Whether the stored actions are actions of the environment.
    fn fits(&self) -> bool {
        self.replay.fits(self.play.actions())
    }

    /// The action with the highest value in the current observation.
    fn greedy(&mut self) -> Action {
        self.engine.values(&self.play.observation, &mut self.workspace.values);
        best(&self.workspace.values)
    }

    /// Takes one step in the running episode and stores it; returns the step's part of the return.
    fn act(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
    ) -> Result<f64, OutOfMemory> {
        let explored = self.play.explore();
        let action = match &mut observer {
            None => explored.unwrap_or_else(|| self.greedy()),
            Some(observer) => {
                let greedy = self.greedy();
                let action = explored.unwrap_or(greedy);
                let probabilities = self.play.probabilities(greedy);
                observer.chosen(&self.play.environment, &[action], &probabilities);
                action
            }
        };
        let (transition, outcome) = self.play.step(action, observer);
        let Play { observation, next_observation, .. } = &self.play;
        self.replay.push(observation, transition, next_observation)?;
        self.play.move_on();
        Ok(outcome)
    }
}

impl<E: DuelingDqnEngine, Env: VectorEnvironment> Learner<Env> for DuelingDqnLearner<E, Env> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        mut observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<Span, LearnerError> {
        if !self.play.environment.any_running() {
            self.play.begin();
        }
        while self.play.environment.any_running() {
            if pause() {
                return Ok(Span::BrokenOff);
            }
            let outcome = self.act(reborrowed(&mut observer))?;
            let may_update = self.play.count_step(outcome);
            if may_update && self.replay.len() >= self.play.parameters.batch as usize {
                self.update()?;
            }
        }
        finished.push(self.play.finished());
        Ok(Span::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>> {
        self.play.policy(self.engine.network(), actions)
    }

    fn weights(&self) -> Weights {
        self.play.weights(self.engine.weights())
    }
}

resumable!([E: DuelingDqnEngine, Env: VectorEnvironment] DuelingDqnLearner<E, Env> { parts engine, replay, play; check fits, "actions" });
