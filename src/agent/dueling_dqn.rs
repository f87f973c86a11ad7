//! Dueling DQN: Q-learning from a replay buffer with a slower copy of the network as target.
//!
//! **Source**: Mnih et al., "Playing Atari with deep reinforcement learning", 2013; Wang et al.,
//! 2016 (the network); the maximum is over the target network's own values (not double Q-learning).

use std::{io, mem};

use crate::agent::actor::{Actor, StepObserver, reborrowed};
use crate::agent::learner::{Actions, Diverged, Learner, LearnerError, Span, TrainedEpisode};
use crate::agent::memory::OutOfMemory;
use crate::agent::network::{Activation, Engine, LAYER_WIDTHS, LEARNING_RATE};
use crate::agent::policy::{
    ActionNetwork, EpsilonGreedy, best, epsilon_greedy_probability, explore,
};
use crate::agent::replay::{Batch, Replay, TerminalTarget, Transition};
use crate::agent::weights::Weights;
use crate::env::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Observations, PhysicalActivity, VectorEnvironment,
};
use crate::key::{Keyed, Kind};
use crate::rng::{Purpose, Stream};
use crate::state::{Resumable, StateError, StateReader, StateWriter};
use crate::{choices, keys};

keys! {
    /// Hyper-parameters of the dueling DQN; the defaults reproduce the published figures.
    pub struct DuelingDqn {
        /// episodes of training
        episodes: u32 = 1000, in Kind::EPISODES;
        /// widths of the hidden layers, input side first
        layers: Vec<u32> = vec![128, 128], in LAYER_WIDTHS;
        /// activation of the hidden layers
        activation: Activation = Activation::Relu;
        /// whether state value and advantages share their hidden layers
        trunk: Trunk = Trunk::Shared;
        /// Adam's step size
        learning_rate: f64 = 5e-4, in LEARNING_RATE;
        /// discount factor a step
        gamma: f64 = 0.99, in Kind::PROBABILITY;
        /// transitions in a batch; learning starts once as many are stored
        batch: u32 = 64, in Kind::Integer { min: 1, max: 65_536 };
        /// most transitions that the replay buffer keeps
        buffer: u32 = 1_000_000, in Kind::Integer { min: 1, max: 100_000_000 };
        /// exploration rate at the start
        epsilon_start: f64 = 1.0, in Kind::PROBABILITY;
        /// decrease of the exploration rate an update
        epsilon_decrement: f64 = 1e-3, in Kind::PROBABILITY;
        /// exploration rate at which the decrease stops
        epsilon_floor: f64 = 0.01, in Kind::PROBABILITY;
        /// updates between two copies into the target network
        target_period: u32 = 1000, in Kind::Integer { min: 1, max: 1_000_000_000 };
        /// target of a transition that ends its episode: 0 on any end (the authors' code), or the
        /// reward, bootstrapped at the horizon
        terminal_target: TerminalTarget = TerminalTarget::Zero;
        /// which code performs the updates: "fused", kernels with the same results on every
        /// processor, or "burn", Burn's own operations, many times as slow, with results that depend
        /// on the processor
        engine: Engine = Engine::Fused;
    }
}

impl Default for DuelingDqn {
    fn default() -> Self {
        DuelingDqn::with_required(&[])
    }
}

choices! {
    /// Whether the two streams of the dueling network share their hidden layers.
    pub enum Trunk {
        /// One stack of hidden layers with two linear heads, as in the published code.
        Shared = "shared",
        /// A stack of hidden layers for each head, as the paper's words read.
        Separate = "separate",
    }
}

/// What trains a dueling network: the engine under the algorithm.
pub trait DuelingDqnEngine: Resumable {
    /// The network at one moment, to choose actions with.
    type Network: ActionNetwork + Send + 'static;

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
    match (transition.status, terminal_target) {
        (EpisodeStatus::Running, _) | (EpisodeStatus::Truncated, TerminalTarget::Standard) => {
            transition.reward + gamma as f32 * best_next
        }
        (EpisodeStatus::Terminated, TerminalTarget::Standard) => transition.reward,
        (EpisodeStatus::Terminated | EpisodeStatus::Truncated, TerminalTarget::Zero) => 0.0,
    }
}

/// A dueling DQN in training, one episode at a time.
pub struct DuelingDqnLearner<E, Env = PhysicalActivity> {
    engine: E,
    parameters: DuelingDqn,
    replay: Replay,
    epsilon: f64,
    updates: u64,
    /// The running episode, if there is one, and its figures so far.
    environment: Env,
    episode: TrainedEpisode,
    environment_streams: LaneStreams,
    exploration_stream: Stream,
    replay_stream: Stream,
    /// The present observation, and a buffer for the next one.
    observation: Observations,
    next_observation: Observations,
    workspace: Workspace,
}

/// Buffers that are reused, so that an update allocates nothing.
struct Workspace {
    positions: Vec<usize>,
    batch: Batch,
    /// Positions whose target is not known.
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
            epsilon: parameters.epsilon_start,
            updates: 0,
            environment,
            episode: TrainedEpisode::default(),
            environment_streams: LaneStreams::Shared(Stream::new(seed, Purpose::Environment)),
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            replay_stream: Stream::new(seed, Purpose::Replay),
            workspace: Workspace {
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
    fn update(&mut self) -> Result<f32, LearnerError> {
        if self.updates.is_multiple_of(u64::from(self.parameters.target_period)) {
            self.engine.renew_target();
            self.replay.forget_targets();
        }
        self.replay.draw(&mut self.replay_stream, &mut self.workspace.positions);
        self.learn_targets()?;
        let Workspace { positions, batch, .. } = &mut self.workspace;
        self.replay.gather(positions, batch);
        let loss = self.engine.update(batch);
        self.updates += 1;
        if !loss.is_finite() {
            return Err(Diverged { update: self.updates, loss }.into());
        }
        self.epsilon =
            (self.epsilon - self.parameters.epsilon_decrement).max(self.parameters.epsilon_floor);
        Ok(loss)
    }

    /// Computes the targets of the drawn transitions that are not known: the target network stands
    /// still, so that those of its period remain.
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
        let DuelingDqn { gamma, terminal_target, .. } = self.parameters;
        for (&position, values) in unknown.iter().zip(values.chunks_exact(Action::COUNT)) {
            let best_next = values[best(values).index()];
            let transition = self.replay.transition(position);
            let target = target(&transition, best_next, gamma, terminal_target);
            self.replay.set_target(position, target)?;
        }
        Ok(())
    }

    /// The action of the highest value in the present observation.
    fn greedy(&mut self) -> Action {
        self.engine.values(&self.observation, &mut self.workspace.values);
        best(&self.workspace.values)
    }

    /// Takes one step in the running episode and remembers it; returns what counts in the return.
    fn act(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
    ) -> Result<f64, OutOfMemory> {
        let explored = explore(self.epsilon, &mut self.exploration_stream);
        let action = match &mut observer {
            None => explored.unwrap_or_else(|| self.greedy()),
            Some(observer) => {
                let greedy = self.greedy();
                let action = explored.unwrap_or(greedy);
                let probability = epsilon_greedy_probability(self.epsilon, action == greedy);
                observer.chosen(&self.environment, &[action], &[probability]);
                action
            }
        };
        let mut reward = [0.0];
        self.environment.step(&[action], &mut reward, &mut self.environment_streams);
        if let Some(observer) = observer {
            observer.paid(&self.environment, &reward);
        }
        let status = self.environment.statuses()[0];
        let transition = Transition { action, reward: reward[0] as f32, status };
        self.environment.observe(&mut self.next_observation);
        self.replay.push(&self.observation, transition, &self.next_observation)?;
        mem::swap(&mut self.observation, &mut self.next_observation);
        Ok(self.environment.outcomes(&reward)[0])
    }

    /// Begins an episode.
    fn begin(&mut self) {
        self.environment.reset(LaneSet::All, &mut self.environment_streams);
        self.environment.observe(&mut self.observation);
    }
}

impl<E: DuelingDqnEngine, Env: VectorEnvironment> Learner<Env> for DuelingDqnLearner<E, Env> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        mut observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<Span, LearnerError> {
        if !self.environment.any_running() {
            self.begin();
            self.episode = TrainedEpisode::default();
        }
        while self.environment.any_running() {
            if pause() {
                return Ok(Span::BrokenOff);
            }
            self.episode.total_reward += self.act(reborrowed(&mut observer))?;
            self.episode.length += 1;
            if self.replay.len() >= self.parameters.batch as usize {
                self.episode.loss_sum += f64::from(self.update()?);
                self.episode.updates += 1;
            }
        }
        self.episode.terminated = self.environment.statuses()[0] == EpisodeStatus::Terminated;
        self.episode.epsilon = Some(self.epsilon);
        finished.push(self.episode);
        Ok(Span::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>> {
        let epsilon = match actions {
            Actions::AsTrained => self.epsilon,
            Actions::Greedy => 0.0,
        };
        let observations = self.environment.observation_spec().observations();
        Box::new(EpsilonGreedy::new(self.engine.network(), epsilon, observations))
    }

    fn weights(&self) -> Weights {
        let mut weights = self.engine.weights();
        weights.numbers.insert("epsilon".to_owned(), self.epsilon);
        weights
    }
}

impl<E: DuelingDqnEngine, Env: VectorEnvironment> Resumable for DuelingDqnLearner<E, Env> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.engine.save(out)?;
        self.replay.save(out)?;
        out.one(self.epsilon)?;
        out.one(self.updates)?;
        self.environment.save(out)?;
        self.episode.save(out)?;
        self.environment_streams.save(out)?;
        self.exploration_stream.save(out)?;
        self.replay_stream.save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.engine.restore(from)?;
        self.replay.restore(from)?;
        self.epsilon = from.one()?;
        self.updates = from.one()?;
        self.environment.restore(from)?;
        self.episode.restore(from)?;
        self.environment_streams.restore(from)?;
        self.exploration_stream.restore(from)?;
        self.replay_stream.restore(from)?;
        // Between two steps, this is the observation of the environment as it is.
        self.environment.observe(&mut self.observation);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{Environment, FirstContext, TimeIndicator};

    /// An engine whose values are a formula of the state and of how often the target was renewed,
    /// and which looks at what it is given to learn.
    struct Formula {
        parameters: DuelingDqn,
        renewals: u32,
        updates: u32,
        steps: Vec<Step>,
    }

    /// State, action, reward, status after it and next state.
    type Step = (Vec<f32>, Action, f32, EpisodeStatus, Vec<f32>);

    struct Nothing;

    impl ActionNetwork for Nothing {
        fn evaluate(&mut self, _: &Observations, _: &mut Vec<f32>) {
            unreachable!("nobody tests it");
        }
    }

    fn values(state: &[f32], renewals: u32) -> [f32; Action::COUNT] {
        let sum: f32 = state.iter().sum();
        std::array::from_fn(|action| sum * (action as f32 - 1.0) + renewals as f32)
    }

    /// The state of a row, its moment as a last number.
    fn state(observations: &Observations, row: usize) -> Vec<f32> {
        let moment = observations.moment(row).map(|moment| moment as f32);
        observations.row(row).iter().copied().chain(moment).collect()
    }

    impl DuelingDqnEngine for Formula {
        type Network = Nothing;

        fn values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
            *out = values(&state(observations, 0), 0).to_vec();
        }

        fn target_values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
            let rows = 0..observations.rows();
            *out = rows.flat_map(|row| values(&state(observations, row), self.renewals)).collect();
        }

        fn renew_target(&mut self) {
            assert_eq!(self.updates % self.parameters.target_period, 0);
            self.renewals += 1;
        }

        fn update(&mut self, batch: &Batch) -> f32 {
            assert_eq!(self.renewals, self.updates / self.parameters.target_period + 1);
            self.updates += 1;
            let stored = self.steps.len().saturating_sub(self.parameters.buffer as usize);
            for row in 0..batch.actions.len() {
                let before = state(&batch.observations, row);
                let matching =
                    self.steps[stored..].iter().filter(|(s, action, reward, status, next)| {
                        let DuelingDqn { gamma, terminal_target, .. } = self.parameters;
                        let best = values(next, self.renewals).into_iter().fold(f32::MIN, f32::max);
                        let (action, status) = (*action, *status);
                        let transition = Transition { action, reward: *reward, status };
                        let target = target(&transition, best, gamma, terminal_target);
                        (s, action, target.to_bits())
                            == (&before, batch.actions[row], batch.targets[row].to_bits())
                    });
                assert!(matching.count() > 0, "no stored step gives {before:?} and its target");
            }
            1.0
        }

        fn network(&self) -> Nothing {
            Nothing
        }

        fn weights(&self) -> Weights {
            Weights::default()
        }
    }

    impl Resumable for Formula {
        fn save(&self, _: &mut StateWriter<'_>) -> io::Result<()> {
            unreachable!("nobody saves it");
        }

        fn restore(&mut self, _: &mut StateReader<'_>) -> Result<(), StateError> {
            unreachable!("nobody restores it");
        }
    }

    #[test]
    fn batches_are_stored_steps_with_the_targets_of_their_period() {
        for (buffer, batch, target_period) in
            [(64, 64, 1), (100, 64, 7), (1, 1, 1), (1000, 32, 1000), (40, 8, 50)]
        {
            for terminal_target in [TerminalTarget::Zero, TerminalTarget::Standard] {
                for (horizon, time_one_hot) in [(1, false), (3, true), (50, false), (50, true)] {
                    let parameters = DuelingDqn {
                        buffer,
                        batch,
                        target_period,
                        terminal_target,
                        ..DuelingDqn::default()
                    };
                    let environment = Environment {
                        horizon,
                        time_one_hot,
                        first_context: FirstContext::Sampled,
                        time_indicator: TimeIndicator::Exact,
                        ..Environment::paper(0.6)
                    };
                    trains_on_what_it_did(parameters, &environment);
                }
            }
        }
    }

    /// Trains for some 300 steps and tells the engine every step.
    fn trains_on_what_it_did(parameters: DuelingDqn, environment: &Environment) {
        let engine =
            Formula { parameters: parameters.clone(), renewals: 0, updates: 0, steps: Vec::new() };
        let environment = PhysicalActivity::new(environment, &"P-H-D".parse().unwrap(), 1);
        let mut learner = DuelingDqnLearner::new(engine, &parameters, environment, 1);
        let mut steps = 0;
        while steps < 300 {
            learner.begin();
            while learner.environment.any_running() {
                let before = state(&learner.observation, 0);
                let reward = learner.act(None);
                let position = (steps % parameters.buffer) as usize;
                let transition = learner.replay.transition(position);
                assert_eq!(transition.reward, reward.unwrap() as f32);
                learner.engine.steps.push((
                    before,
                    transition.action,
                    transition.reward,
                    transition.status,
                    state(&learner.observation, 0),
                ));
                steps += 1;
                if learner.replay.len() >= parameters.batch as usize {
                    learner.update().unwrap();
                }
            }
        }
        assert!(learner.engine.updates > 100, "{}", learner.engine.updates);
    }
}
