//! Dueling DQN: Q-learning from a replay buffer with a slower copy of the network as target.
//!
//! **Source**: Mnih et al., "Playing Atari with deep reinforcement learning", 2013; Wang et al.,
//! 2016 (the network); the maximum is over the target network's own values (not double Q-learning).

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::agent::policy::{EpsilonGreedy, Policy, matrix};
use crate::agent::{
    Actions, Diverged, DuelingQNetwork, Learner, Replay, Span, TrainedEpisode, Transition, Weights,
    device,
};
use crate::env::{Action, Ending, Episodes, Observer};
use crate::manifest::{DuelingDqn, Environment, Scenario, TerminalTarget};
use crate::rng::{Purpose, Stream};

/// Transitions to learn from; row i of every array belongs to transition i.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// \[rows, width\], row by row.
    pub observations: Vec<f32>,
    /// \[rows\].
    pub transitions: Vec<Transition>,
    /// \[rows, width\], row by row.
    pub next_observations: Vec<f32>,
}

impl Batch {
    fn gather(replay: &Replay, positions: &[usize]) -> Self {
        let mut batch = Batch::default();
        for &position in positions {
            let (before, after) = replay.observations(position);
            batch.observations.extend_from_slice(before);
            batch.transitions.push(replay.transition(position));
            batch.next_observations.extend_from_slice(after);
        }
        batch
    }

    /// Regression targets: r + gamma max Q(s', ·), and on an episode's end as `terminal_target`
    /// says.
    ///
    /// **Shapes**: \[rows\].
    pub fn targets(
        &self,
        target: &DuelingQNetwork,
        gamma: f64,
        terminal_target: TerminalTarget,
        device: &Device,
    ) -> Vec<f32> {
        let next = matrix(self.next_observations.clone(), self.transitions.len(), device);
        let best: Vec<f32> = target
            .forward(next)
            .max_dim(1)
            .into_data()
            .try_to_vec()
            .expect("networks compute in f32");
        let row = |(transition, best): (&Transition, f32)| {
            let bootstrapped = transition.reward + gamma as f32 * best;
            match (transition.ending, terminal_target) {
                (Ending::Running, _) | (Ending::Truncated, TerminalTarget::Standard) => {
                    bootstrapped
                }
                (Ending::Terminated, TerminalTarget::Standard) => transition.reward,
                (Ending::Terminated | Ending::Truncated, TerminalTarget::Zero) => 0.0,
            }
        };
        self.transitions.iter().zip(best).map(row).collect()
    }

    /// Mean squared difference of Q(s, a) from the targets; a tensor of one element.
    pub fn loss(&self, network: &DuelingQNetwork, targets: &[f32], device: &Device) -> Tensor<1> {
        let rows = self.transitions.len();
        let actions: Vec<i64> = self.transitions.iter().map(|t| t.action.index() as i64).collect();
        let actions = Tensor::<2, Int>::from_data(TensorData::new(actions, [rows, 1]), device);
        let targets = matrix(targets.to_vec(), rows, device);
        let values = network.forward(matrix(self.observations.clone(), rows, device));
        (values.gather(1, actions) - targets).square().mean()
    }
}

/// A dueling DQN in training, one episode at a time.
pub struct DuelingDqnLearner {
    parameters: DuelingDqn,
    device: Device,
    network: DuelingQNetwork,
    target: DuelingQNetwork,
    optimizer: ModuleOptimizer,
    replay: Replay,
    epsilon: f64,
    updates: u64,
    observer: Observer,
    episodes: Episodes,
    environment_stream: Stream,
    exploration_stream: Stream,
    replay_stream: Stream,
}

impl DuelingDqnLearner {
    /// A learner before its first episode.
    pub fn new(
        parameters: &DuelingDqn,
        environment: &Environment,
        scenario: &Scenario,
        seed: u64,
    ) -> Self {
        let observer = Observer::new(environment, scenario);
        let device = device::training();
        let mut weights_stream = Stream::new(seed, Purpose::InitialWeights);
        let network =
            DuelingQNetwork::initial(parameters, observer.width(), &mut weights_stream, &device);
        let mut environment_stream = Stream::new(seed, Purpose::Environment);
        DuelingDqnLearner {
            target: network.valid(),
            network,
            optimizer: AdamConfig::new().with_epsilon(1e-8).init(),
            replay: Replay::new(parameters.buffer as usize, observer.width()),
            epsilon: parameters.epsilon_start,
            updates: 0,
            episodes: Episodes::start(environment, 1, &mut environment_stream),
            observer,
            environment_stream,
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            replay_stream: Stream::new(seed, Purpose::Replay),
            device,
            parameters: parameters.clone(),
        }
    }

    /// One update from a batch of the buffer; returns its loss.
    fn update(&mut self) -> Result<f32, Diverged> {
        if self.updates.is_multiple_of(u64::from(self.parameters.target_period)) {
            self.target = self.network.valid();
        }
        let mut positions = vec![0; self.parameters.batch as usize];
        self.replay.draw(&mut self.replay_stream, &mut positions);
        let batch = Batch::gather(&self.replay, &positions);
        let DuelingDqn { gamma, terminal_target, learning_rate, .. } = self.parameters;
        let targets = batch.targets(&self.target, gamma, terminal_target, &device::inference());
        let loss = batch.loss(&self.network, &targets, &self.device);
        let value: f32 = loss.clone().into_scalar();
        self.updates += 1;
        if !value.is_finite() {
            return Err(Diverged { update: self.updates, loss: value });
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
        // The optimiser takes the module and gives it back.
        self.network = self.optimizer.step(learning_rate, self.network.clone(), gradients);
        self.epsilon =
            (self.epsilon - self.parameters.epsilon_decrement).max(self.parameters.epsilon_floor);
        Ok(value)
    }

    fn observe(&self) -> Vec<f32> {
        let mut observation = vec![0.0; self.observer.width()];
        self.observer.observe(&self.episodes, &mut observation);
        observation
    }
}

impl Learner for DuelingDqnLearner {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        stop: &dyn Fn() -> bool,
    ) -> Result<Span, Diverged> {
        self.episodes.restart(&mut self.environment_stream);
        let mut episode = TrainedEpisode {
            total_reward: 0.0,
            length: 0,
            disengaged: false,
            loss_sum: 0.0,
            updates: 0,
            epsilon: None,
        };
        let mut observation = self.observe();
        while self.episodes.any_running() {
            if stop() {
                return Ok(Span::BrokenOff);
            }
            let mut action = [Action::NONE];
            EpsilonGreedy::new(self.network.valid(), self.epsilon).act(
                &observation,
                &mut action,
                &mut self.exploration_stream,
            );
            let mut reward = [0.0];
            self.episodes.step(&action, &mut reward, &mut self.environment_stream);
            let next = self.observe();
            let transition = Transition {
                action: action[0],
                reward: reward[0] as f32,
                ending: self.episodes.endings()[0],
            };
            self.replay.push(&observation, transition, &next);
            observation = next;
            episode.total_reward += reward[0];
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
        Box::new(EpsilonGreedy::new(self.network.valid(), epsilon))
    }

    fn weights(&self) -> Weights {
        let mut weights = self.network.weights();
        weights.numbers.insert("epsilon".to_owned(), self.epsilon);
        weights
    }
}
