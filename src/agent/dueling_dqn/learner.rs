//! The learner of the dueling DQN, with and without memory.

#[cfg(test)]
mod tests;

use crate::agent::actor::{Actor, StepObserver, reborrowed};
use crate::agent::dueling_dqn::play::Play;
use crate::agent::dueling_dqn::{DuelingDqn, DuelingDqnEngine, Experience};
use crate::agent::learner::{Actions, Learner, LearnerError, SpanEnd, TrainedEpisode};
use crate::agent::memory::OutOfMemory;
use crate::agent::policy::best;
use crate::agent::weights::Weights;
use crate::env::{Action, Simulated, VectorEnvironment};
use crate::state::resumable;

/// A dueling DQN in training, one episode at a time.
pub struct DuelingDqnLearner<E: DuelingDqnEngine, Env = Simulated> {
    engine: E,
    experience: E::Experience,
    play: Play<Env>,
    /// The network's memory of the running episode; empty without a memory.
    memory: Vec<f32>,
    values: Vec<f32>,
}

impl<E: DuelingDqnEngine, Env: VectorEnvironment> DuelingDqnLearner<E, Env> {
    /// A learner before its first episode, in an environment of one lane.
    pub fn new(engine: E, parameters: &DuelingDqn, environment: Env, seed: u64) -> Self {
        let none = environment.observation_spec().observations();
        DuelingDqnLearner {
            experience: Experience::new(parameters, &none),
            play: Play::new(parameters, environment, seed),
            memory: vec![0.0; engine.memory()],
            values: Vec::new(),
            engine,
        }
    }

    /// One update from a batch of the experience.
    fn update(&mut self) -> Result<(), LearnerError> {
        let DuelingDqnLearner { engine, experience, play, .. } = self;
        if play.renews_target() {
            engine.renew_target();
            experience.forget_targets();
        }
        let target_values = |states: &_, out: &mut _| engine.target_values(states, out);
        let batch = experience.draw(&play.parameters, &mut play.replay_stream, target_values)?;
        let loss = engine.update(batch);
        play.count_update(loss)
    }

    /// Whether the stored actions are actions of the environment.
    fn fits(&self) -> bool {
        self.experience.fits(self.play.actions())
    }

    /// The action with the highest value in the current observation, which the memory then includes.
    fn greedy(&mut self) -> Action {
        self.engine.values(&self.play.observation, &mut self.memory, &mut self.values);
        best(&self.values)
    }

    /// Takes one step in the running episode and stores it; returns the step's part of the return.
    fn act(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
    ) -> Result<f64, OutOfMemory> {
        let explored = self.play.explore();
        // A memory advances with every step, also when the agent explores.
        let action = match explored {
            Some(explored) if self.memory.is_empty() && observer.is_none() => explored,
            _ => {
                let greedy = self.greedy();
                let action = explored.unwrap_or(greedy);
                if let Some(observer) = &mut observer {
                    let probabilities = self.play.probabilities(greedy);
                    observer.chosen(&self.play.environment, &[action], &probabilities);
                }
                action
            }
        };
        let (transition, outcome) = self.play.step(action, observer);
        let Play { observation, next_observation, .. } = &self.play;
        self.experience.push(observation, transition, next_observation)?;
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
    ) -> Result<SpanEnd, LearnerError> {
        if !self.play.environment.any_running() {
            self.play.begin();
            self.memory.fill(0.0);
        }
        while self.play.environment.any_running() {
            if pause() {
                return Ok(SpanEnd::BrokenOff);
            }
            let outcome = self.act(reborrowed(&mut observer))?;
            let may_update = self.play.count_step(outcome);
            if may_update && self.experience.stored() >= self.play.parameters.batch as usize {
                self.update()?;
            }
        }
        finished.push(self.play.finished());
        Ok(SpanEnd::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>> {
        self.play.policy(self.engine.network(), actions)
    }

    fn weights(&self) -> Weights {
        self.play.weights(self.engine.weights())
    }
}

resumable!([E: DuelingDqnEngine, Env: VectorEnvironment] DuelingDqnLearner<E, Env> { parts engine, experience, play; fixed memory; check fits, "actions" });
