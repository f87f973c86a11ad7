//! Dueling DQN: Q-learning from a replay buffer with a slower copy of the network as target.
//!
//! **Source**: Mnih et al., "Playing Atari with deep reinforcement learning", 2013; Wang et al.,
//! 2016 (the network); the maximum is over the target network's own values (not double Q-learning).

use std::mem;

use crate::agent::policy::{ActionNetwork, EpsilonGreedy, Policy, best, explore};
use crate::agent::{Actions, Diverged, Learner, Replay, Span, TrainedEpisode, Transition, Weights};
use crate::env::{Action, Ending, Episodes, Observations, Observer};
use crate::manifest::{DuelingDqn, Environment, Scenario, TerminalTarget};
use crate::rng::{Purpose, Stream};

/// What an update learns from; row i of every array belongs to transition i.
#[derive(Clone, Debug)]
pub struct Batch {
    /// The states.
    pub observations: Observations,
    /// \[rows\]: the actions taken in them.
    pub actions: Vec<Action>,
    /// \[rows\]: what the values of these actions should be.
    pub targets: Vec<f32>,
}

/// What trains a dueling network: the engine under the algorithm.
pub trait DuelingDqnEngine {
    /// The network at one moment, to choose actions with.
    type Network: ActionNetwork + 'static;

    /// Replaces `out` by the values of the actions in every observation, \[rows, actions\].
    fn values(&mut self, observations: &Observations, out: &mut Vec<f32>);

    /// Replaces `out` by the target network's values, \[rows, actions\].
    fn target_values(&mut self, observations: &Observations, out: &mut Vec<f32>);

    /// Copies the network into the target network.
    fn renew_target(&mut self);

    /// One step of Adam on the mean squared difference of Q(s, a) from the targets; returns that
    /// loss. Where it is not finite, the network may have been left as it was.
    fn update(&mut self, batch: &Batch) -> f32;

    /// The network as it is now.
    fn network(&self) -> Self::Network;

    /// Its weights.
    fn weights(&self) -> Weights;
}

/// The regression target of a transition: r + gamma max Q(s', ·), and on an episode's end as
/// `terminal_target` says.
pub fn target(
    transition: &Transition,
    best_next: f32,
    gamma: f64,
    terminal_target: TerminalTarget,
) -> f32 {
    match (transition.ending, terminal_target) {
        (Ending::Running, _) | (Ending::Truncated, TerminalTarget::Standard) => {
            transition.reward + gamma as f32 * best_next
        }
        (Ending::Terminated, TerminalTarget::Standard) => transition.reward,
        (Ending::Terminated | Ending::Truncated, TerminalTarget::Zero) => 0.0,
    }
}

/// A dueling DQN in training, one episode at a time.
pub struct DuelingDqnLearner<E> {
    engine: E,
    parameters: DuelingDqn,
    replay: Replay,
    epsilon: f64,
    updates: u64,
    observer: Observer,
    episodes: Episodes,
    environment_stream: Stream,
    exploration_stream: Stream,
    replay_stream: Stream,
    /// What the agent sees, and room for what it sees next.
    observation: Observations,
    next_observation: Observations,
    room: Room,
}

/// Room to work in, so that an update allocates nothing.
struct Room {
    positions: Vec<usize>,
    batch: Batch,
    /// Positions whose target is not known.
    unknown: Vec<usize>,
    next: Observations,
    values: Vec<f32>,
}

impl<E: DuelingDqnEngine> DuelingDqnLearner<E> {
    /// A learner before its first episode.
    pub fn new(
        engine: E,
        parameters: &DuelingDqn,
        environment: &Environment,
        scenario: &Scenario,
        seed: u64,
    ) -> Self {
        let observer = Observer::new(environment, scenario);
        let mut environment_stream = Stream::new(seed, Purpose::Environment);
        let none = observer.observations();
        DuelingDqnLearner {
            engine,
            replay: Replay::new(parameters.buffer as usize, &none, parameters.terminal_target),
            epsilon: parameters.epsilon_start,
            updates: 0,
            episodes: Episodes::start(environment, 1, &mut environment_stream),
            observer,
            environment_stream,
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            replay_stream: Stream::new(seed, Purpose::Replay),
            room: Room {
                positions: vec![0; parameters.batch as usize],
                batch: Batch {
                    observations: none.clone(),
                    actions: Vec::new(),
                    targets: Vec::new(),
                },
                unknown: Vec::new(),
                next: none.clone(),
                values: Vec::new(),
            },
            observation: none.clone(),
            next_observation: none,
            parameters: parameters.clone(),
        }
    }

    /// One update from a batch of the buffer; returns its loss.
    fn update(&mut self) -> Result<f32, Diverged> {
        if self.updates.is_multiple_of(u64::from(self.parameters.target_period)) {
            self.engine.renew_target();
            self.replay.forget_targets();
        }
        self.replay.draw(&mut self.replay_stream, &mut self.room.positions);
        self.learn_targets();
        let Room { positions, batch, .. } = &mut self.room;
        self.replay.gather(positions, batch);
        let loss = self.engine.update(batch);
        self.updates += 1;
        if !loss.is_finite() {
            return Err(Diverged { update: self.updates, loss });
        }
        self.epsilon =
            (self.epsilon - self.parameters.epsilon_decrement).max(self.parameters.epsilon_floor);
        Ok(loss)
    }

    /// Computes the targets of the drawn transitions that are not known: the target network stands
    /// still, so that those of its period remain.
    fn learn_targets(&mut self) {
        let Room { positions, unknown, next, values, .. } = &mut self.room;
        unknown.clear();
        next.clear();
        for &position in positions.iter() {
            if self.replay.target(position).is_none() {
                unknown.push(position);
                self.replay.push_after(position, next);
            }
        }
        if unknown.is_empty() {
            return;
        }
        self.engine.target_values(next, values);
        let DuelingDqn { gamma, terminal_target, .. } = self.parameters;
        for (&position, values) in unknown.iter().zip(values.chunks_exact(Action::COUNT)) {
            let best_next = values[best(values).index()];
            let transition = self.replay.transition(position);
            let target = target(&transition, best_next, gamma, terminal_target);
            self.replay.set_target(position, target);
        }
    }

    /// Takes one step in the running episode and remembers it; returns the reward.
    fn act(&mut self) -> f64 {
        let action = explore(self.epsilon, &mut self.exploration_stream).unwrap_or_else(|| {
            self.engine.values(&self.observation, &mut self.room.values);
            best(&self.room.values)
        });
        let mut reward = [0.0];
        self.episodes.step(&[action], &mut reward, &mut self.environment_stream);
        let ending = self.episodes.endings()[0];
        let transition = Transition { action, reward: reward[0] as f32, ending };
        self.observer.observe(&self.episodes, &mut self.next_observation);
        self.replay.push(&self.observation, transition, &self.next_observation);
        mem::swap(&mut self.observation, &mut self.next_observation);
        reward[0]
    }
}

impl<E: DuelingDqnEngine> Learner for DuelingDqnLearner<E> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        stop: &dyn Fn() -> bool,
    ) -> Result<Span, Diverged> {
        self.episodes.restart(&mut self.environment_stream);
        self.observer.observe(&self.episodes, &mut self.observation);
        let mut episode = TrainedEpisode::default();
        while self.episodes.any_running() {
            if stop() {
                return Ok(Span::BrokenOff);
            }
            episode.total_reward += self.act();
            episode.length += 1;
            if self.replay.len() >= self.parameters.batch as usize {
                episode.loss_sum += f64::from(self.update()?);
                episode.updates += 1;
            }
        }
        episode.disengaged = self.episodes.endings()[0] == Ending::Terminated;
        episode.epsilon = Some(self.epsilon);
        finished.push(episode);
        Ok(Span::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Policy> {
        let epsilon = match actions {
            Actions::AsTrained => self.epsilon,
            Actions::Greedy => 0.0,
        };
        Box::new(EpsilonGreedy::new(self.engine.network(), epsilon))
    }

    fn weights(&self) -> Weights {
        let mut weights = self.engine.weights();
        weights.numbers.insert("epsilon".to_owned(), self.epsilon);
        weights
    }
}
