//! The running episode of a dueling DQN: plays one episode at a time, explores, and counts updates. It handles neither networks nor replay buffers.

use std::mem;

use crate::agent::actor::{Actor, StepObserver};
use crate::agent::dueling_dqn::DuelingDqn;
use crate::agent::learner::{Actions, Diverged, LearnerError, TrainedEpisode};
use crate::agent::policy::{
    ActionNetwork, Choice, NetworkActor, epsilon_greedy_probabilities, explore,
};
use crate::agent::replay::Transition;
use crate::agent::unavailable::certain;
use crate::agent::weights::Weights;
use crate::env::{Action, EpisodeStatus, LaneSet, LaneStreams, Observations, VectorEnvironment};
use crate::rng::{Purpose, Stream};
use crate::state::resumable;

/// The running episode of a dueling DQN, and its progress in training.
pub(super) struct Play<Env> {
    pub(super) parameters: DuelingDqn,
    pub(super) epsilon: f64,
    updates: u64,
    /// The running episode, if there is one: its environment, and its record so far.
    pub(super) environment: Env,
    episode: TrainedEpisode,
    environment_streams: LaneStreams,
    exploration_stream: Stream,
    pub(super) replay_stream: Stream,
    /// The current observation; between a step and [`Play::move_on`], the observation before the
    /// step.
    pub(super) observation: Observations,
    /// The observation after a step.
    pub(super) next_observation: Observations,
}

impl<Env: VectorEnvironment> Play<Env> {
    /// The state before the first episode, in an environment of one lane.
    pub(super) fn new(parameters: &DuelingDqn, environment: Env, seed: u64) -> Self {
        let none = environment.observation_spec().observations();
        Play {
            parameters: parameters.clone(),
            epsilon: parameters.epsilon_start,
            updates: 0,
            environment,
            episode: TrainedEpisode::default(),
            environment_streams: LaneStreams::Shared(Stream::new(seed, Purpose::Environment)),
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            replay_stream: Stream::new(seed, Purpose::Replay),
            observation: none.clone(),
            next_observation: none,
        }
    }

    /// The action that does not depend on the values, if there is one: action 0 where the agent does not
    /// choose, and a random action where it explores.
    pub(super) fn explore(&mut self) -> Option<Action> {
        // Drawn in every step, so that later choices do not depend on earlier availability.
        let explored = explore(self.epsilon, self.actions(), &mut self.exploration_stream);
        if self.chooses() { explored } else { Some(Action::default()) }
    }

    /// Whether the agent chooses in the current state.
    pub(super) fn chooses(&self) -> bool {
        self.parameters.unavailable.chooses(&self.environment, 0)
    }

    /// Number of actions.
    pub(super) fn actions(&self) -> usize {
        self.environment.action_spec().count
    }

    /// The probabilities of the actions, of which `greedy` has the highest value.
    pub(super) fn probabilities(&self, greedy: Action) -> Vec<f64> {
        let mut probabilities = vec![0.0; self.actions()];
        match self.chooses() {
            true => epsilon_greedy_probabilities(self.epsilon, greedy, &mut probabilities),
            false => certain(Action::default(), &mut probabilities),
        }
        probabilities
    }

    /// Begins an episode.
    pub(super) fn begin(&mut self) {
        self.environment.reset(LaneSet::All, &mut self.environment_streams);
        self.environment.observe(&mut self.observation);
        self.episode = TrainedEpisode::default();
    }

    /// Takes a step; returns the transition for the replay buffer, and the step's part of the
    /// return.
    pub(super) fn step(
        &mut self,
        action: Action,
        observer: Option<&mut dyn StepObserver<Env>>,
    ) -> (Transition, f64) {
        let mut reward = [0.0];
        self.environment.step(&[action], &mut reward, &mut self.environment_streams);
        if let Some(observer) = observer {
            observer.paid(&self.environment, &reward);
        }
        let status = self.environment.statuses()[0];
        let scaled = (reward[0] / self.parameters.reward_scale) as f32;
        self.environment.observe(&mut self.next_observation);
        let outcome = self.environment.outcomes(&reward)[0];
        let is_withheld = !self.chooses();
        (Transition { action, reward: scaled, status, is_withheld }, outcome)
    }

    /// Between steps, the environment itself gives the current observation.
    fn observe(&mut self) {
        self.environment.observe(&mut self.observation);
    }

    /// Makes the observation after a step the current one.
    pub(super) fn move_on(&mut self) {
        mem::swap(&mut self.observation, &mut self.next_observation);
    }

    /// Adds a step to the record of the episode; returns whether an update may follow.
    pub(super) fn count_step(&mut self, outcome: f64) -> bool {
        self.episode.total_reward += outcome;
        self.episode.length += 1;
        self.episode.length.is_multiple_of(self.parameters.update_interval)
    }

    /// Whether the target network is renewed before the next update.
    pub(super) fn renews_target(&self) -> bool {
        self.updates.is_multiple_of(u64::from(self.parameters.target_period))
    }

    /// Counts an update and lowers the exploration rate.
    ///
    /// **Errors**: the loss is not finite.
    pub(super) fn count_update(&mut self, loss: f32) -> Result<(), LearnerError> {
        self.updates += 1;
        if !loss.is_finite() {
            return Err(Diverged { update: self.updates, loss }.into());
        }
        self.epsilon =
            (self.epsilon - self.parameters.epsilon_decrement).max(self.parameters.epsilon_floor);
        self.episode.loss_sum += f64::from(loss);
        self.episode.updates += 1;
        Ok(())
    }

    /// The record of the episode that has ended.
    pub(super) fn finished(&mut self) -> TrainedEpisode {
        self.episode.terminated = self.environment.statuses()[0] == EpisodeStatus::Terminated;
        self.episode.epsilon = Some(self.epsilon);
        self.episode
    }

    /// The policy of a network, with the current exploration rate.
    pub(super) fn policy(
        &self,
        network: impl ActionNetwork + Send + 'static,
        actions: Actions,
    ) -> Box<dyn Actor<Env>> {
        let choice = Choice::EpsilonGreedy { epsilon: self.epsilon };
        let observations = self.environment.observation_spec().observations();
        Box::new(NetworkActor::new(network, choice, actions, observations))
    }

    /// The weights of a network, with the current exploration rate.
    pub(super) fn weights(&self, mut weights: Weights) -> Weights {
        weights.numbers.insert("epsilon".to_owned(), self.epsilon);
        weights
    }
}

resumable!([Env: VectorEnvironment] Play<Env> {
    parts epsilon, updates, environment, episode, environment_streams, exploration_stream, replay_stream;
    then observe
});
