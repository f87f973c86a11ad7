//! The dueling DQN with a memory of the episode: Q-learning from whole episodes or from parts of
//! them.
//!
//! **Source**: Hausknecht and Stone, "Deep recurrent Q-learning for partially observable MDPs",
//! 2015: "bootstrapped sequential updates" from whole episodes and the zero state, or "random
//! updates" from sequences. Kapturowski et al., "Recurrent experience replay in distributed
//! reinforcement learning", 2019 (R2D2): the burn-in, here from the zero state, because no states
//! are stored. Ni et al., "Recurrent model-free RL can be a strong baseline for many POMDPs", 2022:
//! all episodes are equally likely, whatever their length, and the loss is the mean over all steps
//! that count.

use crate::agent::actor::{Actor, StepObserver, reborrowed};
use crate::agent::dueling_dqn::episodes::{EpisodeReplay, SequenceBatch};
use crate::agent::dueling_dqn::play::Play;
use crate::agent::dueling_dqn::{DuelingDqn, target, value_after};
use crate::agent::learner::{Actions, Learner, LearnerError, Span, TrainedEpisode};
use crate::agent::memory::OutOfMemory;
use crate::agent::policy::{ActionNetwork, best};
use crate::agent::weights::Weights;
use crate::env::{Observations, Simulated, VectorEnvironment};
use crate::state::{Resumable, resumable};

/// The engine of the recurrent dueling DQN, which trains a dueling network with a memory.
pub trait RecurrentDqnEngine: Resumable {
    /// The network at the time of the call, which chooses actions.
    type Network: ActionNetwork + Send + 'static;

    /// Size of the network's memory of an episode, in numbers.
    fn memory(&self) -> usize;

    /// Replaces `out` by the action values for the next observations, \[rows, actions\]; `memory`
    /// is as in [`ActionNetwork::recall`].
    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>);

    /// Replaces `out` by the action values of the target network along sequences, \[rows,
    /// actions\].
    fn target_values(&mut self, batch: &SequenceBatch, out: &mut Vec<f32>);

    /// Copies the network into the target network.
    fn renew_target(&mut self);

    /// One step of Adam on the mean squared difference between Q(s, a) and the targets, over the
    /// rows that count; returns this loss. If the loss is not finite, the engine may leave the
    /// network unchanged.
    fn update(&mut self, batch: &SequenceBatch) -> f32;

    /// The current network.
    fn network(&self) -> Self::Network;

    /// The weights of the current network.
    fn weights(&self) -> Weights;
}

/// A recurrent dueling DQN in training, one episode at a time.
pub struct RecurrentDqnLearner<E, Env = Simulated> {
    engine: E,
    replay: EpisodeReplay,
    play: Play<Env>,
    /// The network's memory of the running episode.
    memory: Vec<f32>,
    batch: SequenceBatch,
    values: Vec<f32>,
}

impl<E: RecurrentDqnEngine, Env: VectorEnvironment> RecurrentDqnLearner<E, Env> {
    /// A learner before its first episode, in an environment of one lane.
    pub fn new(engine: E, parameters: &DuelingDqn, environment: Env, seed: u64) -> Self {
        let none = environment.observation_spec().observations();
        let DuelingDqn { buffer, terminal_target, .. } = *parameters;
        RecurrentDqnLearner {
            replay: EpisodeReplay::new(buffer as usize, &none, terminal_target),
            play: Play::new(parameters, environment, seed),
            memory: vec![0.0; engine.memory()],
            batch: SequenceBatch::new(none),
            values: Vec::new(),
            engine,
        }
    }

    /// One update from sequences of the buffer.
    fn update(&mut self) -> Result<(), LearnerError> {
        if self.play.renews_target() {
            self.engine.renew_target();
        }
        let DuelingDqn { batch, sequence, burn_in, .. } = self.play.parameters;
        let steps = [sequence, burn_in].map(|steps| steps as usize);
        let stream = &mut self.play.replay_stream;
        self.replay.draw(batch as usize, steps, stream, &mut self.batch)?;
        self.compute_targets();
        let loss = self.engine.update(&self.batch);
        self.play.count_update(loss)
    }

    /// Computes the targets of the rows that count. The target network computes its own states from
    /// the same steps.
    fn compute_targets(&mut self) {
        let RecurrentDqnLearner { engine, replay, batch, values, play, .. } = self;
        engine.target_values(batch, values);
        let DuelingDqn { gamma, terminal_target, .. } = play.parameters;
        let (lanes, actions) = (batch.lanes, play.actions());
        for row in 0..batch.rows() {
            if !batch.learned[row] {
                continue;
            }
            let Some(transition) = replay.transition(row % lanes, row / lanes) else { continue };
            let next = (row + lanes) * actions;
            let values = &values[next..next + actions];
            batch.targets[row] =
                target(&transition, value_after(&transition, values), gamma, terminal_target);
        }
    }

    /// Whether the stored actions are actions of the environment.
    fn fits(&self) -> bool {
        self.replay.fits(self.play.actions())
    }

    /// Takes one step in the running episode and stores it; returns the step's part of the return.
    fn act(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
    ) -> Result<f64, OutOfMemory> {
        // The memory advances with every step, also when the agent explores.
        self.engine.values(&self.play.observation, &mut self.memory, &mut self.values);
        let greedy = best(&self.values);
        let action = self.play.explore().unwrap_or(greedy);
        if let Some(observer) = &mut observer {
            let probabilities = self.play.probabilities(greedy);
            observer.chosen(&self.play.environment, &[action], &probabilities);
        }
        let (transition, outcome) = self.play.step(action, observer);
        let Play { observation, next_observation, .. } = &self.play;
        self.replay.push(observation, transition, next_observation)?;
        self.play.move_on();
        Ok(outcome)
    }
}

impl<E: RecurrentDqnEngine, Env: VectorEnvironment> Learner<Env> for RecurrentDqnLearner<E, Env> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        mut observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<Span, LearnerError> {
        if !self.play.environment.any_running() {
            self.play.begin();
            self.memory.fill(0.0);
        }
        while self.play.environment.any_running() {
            if pause() {
                return Ok(Span::BrokenOff);
            }
            let outcome = self.act(reborrowed(&mut observer))?;
            let may_update = self.play.count_step(outcome);
            if may_update && self.replay.episodes() >= self.play.parameters.batch as usize {
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

resumable!([E: RecurrentDqnEngine, Env: VectorEnvironment] RecurrentDqnLearner<E, Env> { parts engine, replay, play; fixed memory; check fits, "actions" });
