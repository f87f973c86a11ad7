//! REINFORCE: Monte-Carlo policy gradient with the discounted reward to go, without a baseline.
//!
//! **Source**: Williams, "Simple statistical gradient-following algorithms for connectionist
//! reinforcement learning", 1992; Karine et al. (2023), equations 1 to 3. Equation 3 prints the
//! discount as gamma^(t-k); gamma^(k-t) is meant.

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Int, Tensor, TensorData, activation};

use crate::agent::policy::{Policy, SoftmaxPolicy, matrix};
use crate::agent::{
    Actions, Diverged, Learner, PolicyNetwork, Span, TrainedEpisode, Weights, device,
};
use crate::env::{Action, Ending, Episodes, Observer};
use crate::manifest::{Environment, Reinforce, Scenario};
use crate::rng::{Purpose, Stream};

/// Steps of sampled trajectories; row i of every array belongs to step i.
#[derive(Clone, Debug, Default)]
pub struct Trajectories {
    /// \[rows, width\], row by row.
    pub observations: Vec<f32>,
    /// \[rows\].
    pub actions: Vec<Action>,
    /// Discounted rewards to go G_t = Σ_k≥t gamma^(k-t) r_k, \[rows\].
    pub returns_to_go: Vec<f32>,
}

impl Trajectories {
    /// −(1/divisor) Σ G_t log π(a_t | s_t); a tensor of one element.
    pub fn loss(&self, network: &PolicyNetwork, divisor: f64, device: &Device) -> Tensor<1> {
        let rows = self.actions.len();
        let actions: Vec<i64> = self.actions.iter().map(|a| a.index() as i64).collect();
        let actions = Tensor::<2, Int>::from_data(TensorData::new(actions, [rows, 1]), device);
        let returns = matrix(self.returns_to_go.clone(), rows, device);
        let logits = network.forward(matrix(self.observations.clone(), rows, device));
        let chosen = activation::log_softmax(logits, 1).gather(1, actions);
        (chosen * returns).sum().neg().div_scalar(divisor)
    }
}

/// Discounted rewards to go of trajectories in lockstep.
///
/// **Shapes**: `rewards` and the result are \[time, lanes\], row by row.
pub fn returns_to_go(rewards: &[f64], lanes: usize, gamma: f64) -> Vec<f64> {
    let mut returns = rewards.to_vec();
    for earlier in (0..returns.len().saturating_sub(lanes)).rev() {
        returns[earlier] += gamma * returns[earlier + lanes];
    }
    returns
}

/// REINFORCE in training, one update at a time.
pub struct ReinforceLearner {
    parameters: Reinforce,
    device: Device,
    network: PolicyNetwork,
    optimizer: ModuleOptimizer,
    updates: u64,
    observer: Observer,
    episodes: Episodes,
    environment_stream: Stream,
    exploration_stream: Stream,
}

/// What the sampled trajectories of an update were, by step and lane.
struct Sampled {
    trajectories: Trajectories,
    finished: Vec<TrainedEpisode>,
}

impl ReinforceLearner {
    /// A learner before its first update.
    pub fn new(
        parameters: &Reinforce,
        environment: &Environment,
        scenario: &Scenario,
        seed: u64,
    ) -> Self {
        let observer = Observer::new(environment, scenario);
        let device = device::training();
        let mut weights_stream = Stream::new(seed, Purpose::InitialWeights);
        let lanes = parameters.trajectories_per_update as usize;
        let mut environment_stream = Stream::new(seed, Purpose::Environment);
        ReinforceLearner {
            network: PolicyNetwork::initial(
                parameters,
                observer.width(),
                &mut weights_stream,
                &device,
            ),
            optimizer: AdamConfig::new().with_epsilon(1e-8).init(),
            updates: 0,
            episodes: Episodes::start(environment, lanes, &mut environment_stream),
            observer,
            environment_stream,
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            device,
            parameters: parameters.clone(),
        }
    }

    /// Samples the trajectories of one update, all in lockstep; `None` if it was to stop.
    fn sample(&mut self, stop: &dyn Fn() -> bool) -> Option<Sampled> {
        let (lanes, width) = (self.episodes.lanes(), self.observer.width());
        let policy = self.policy(Actions::AsTrained);
        self.episodes.restart(&mut self.environment_stream);
        let mut trajectories = Trajectories::default();
        // Position [time, lane] of every row: a lane that has ended has no rows.
        let mut positions = Vec::new();
        let mut rewards = Vec::new();
        let mut lengths = vec![0; lanes];
        let mut observations = vec![0.0; lanes * width];
        let mut actions = vec![Action::NONE; lanes];
        while self.episodes.any_running() {
            if stop() {
                return None;
            }
            self.observer.observe(&self.episodes, &mut observations);
            policy.act(&observations, &mut actions, &mut self.exploration_stream);
            let start = rewards.len();
            rewards.resize(start + lanes, 0.0);
            for (lane, _) in running(&self.episodes) {
                let row = &observations[lane * width..(lane + 1) * width];
                trajectories.observations.extend_from_slice(row);
                trajectories.actions.push(actions[lane]);
                positions.push(start + lane);
                lengths[lane] += 1;
            }
            self.episodes.step(&actions, &mut rewards[start..], &mut self.environment_stream);
        }
        let returns = returns_to_go(&rewards, lanes, self.parameters.gamma);
        trajectories.returns_to_go = positions.iter().map(|&at| returns[at] as f32).collect();
        let finished = lengths
            .into_iter()
            .enumerate()
            .map(|(lane, length)| TrainedEpisode {
                total_reward: rewards.iter().skip(lane).step_by(lanes).sum(),
                length,
                disengaged: self.episodes.endings()[lane] == Ending::Terminated,
                loss_sum: 0.0,
                updates: 0,
                epsilon: None,
            })
            .collect();
        Some(Sampled { trajectories, finished })
    }
}

fn running(episodes: &Episodes) -> impl Iterator<Item = (usize, &Ending)> {
    episodes.endings().iter().enumerate().filter(|(_, ending)| **ending == Ending::Running)
}

impl Learner for ReinforceLearner {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        stop: &dyn Fn() -> bool,
    ) -> Result<Span, Diverged> {
        let Some(mut sampled) = self.sample(stop) else {
            return Ok(Span::BrokenOff);
        };
        let loss =
            sampled.trajectories.loss(&self.network, self.parameters.loss_divisor, &self.device);
        let value: f32 = loss.clone().into_scalar();
        self.updates += 1;
        if !value.is_finite() {
            return Err(Diverged { update: self.updates, loss: value });
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
        // The optimiser takes the module and gives it back.
        let learning_rate = self.parameters.learning_rate;
        self.network = self.optimizer.step(learning_rate, self.network.clone(), gradients);
        if let Some(last) = sampled.finished.last_mut() {
            last.loss_sum = f64::from(value);
            last.updates = 1;
        }
        finished.append(&mut sampled.finished);
        Ok(Span::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Policy> {
        Box::new(SoftmaxPolicy::new(self.network.valid(), actions))
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rewards_to_go_by_hand() {
        // Two lanes: rewards 1, 2, 4 and 3, 0, 8; gamma 0.5.
        let returns = returns_to_go(&[1.0, 3.0, 2.0, 0.0, 4.0, 8.0], 2, 0.5);
        assert_eq!(returns, [3.0, 5.0, 4.0, 4.0, 4.0, 8.0]);
        assert!(returns_to_go(&[], 1, 0.5).is_empty());
    }
}
