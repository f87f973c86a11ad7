//! REINFORCE: Monte-Carlo policy gradient with discounted rewards to go, without a baseline.
//!
//! **Source**: Williams, "Simple statistical gradient-following algorithms for connectionist
//! reinforcement learning", 1992; Karine et al. (2023), equations 1 to 3. Equation 3 prints the
//! discount as gamma^(t-k), but means gamma^(k-t).

use std::ops::Range;

use crate::agent::actor::{Actor, StepObserver};
use crate::agent::learner::{Actions, Diverged, Learner, LearnerError, SpanEnd, TrainedEpisode};
use crate::agent::memory::{self, OutOfMemory, reserve};
use crate::agent::network::{Activation, Engine, LAYER_WIDTHS, LEARNING_RATE};
use crate::agent::policy::{ActionNetwork, Choice, NetworkActor, sample, sampling_probabilities};
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::Weights;
use crate::env::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Observations, Simulated, VectorEnvironment,
};
use crate::kernel::Isa;
use crate::key::{Keyed, Kind, keys};
use crate::rng::{Purpose, Stream};
use crate::state::{Resumable, resumable};

keys! {
    /// Hyper-parameters of REINFORCE; the defaults reproduce the published figures.
    pub struct Reinforce {
        /// episodes of training, a multiple of trajectories_per_update
        episodes: u32 = 15_000, in Kind::EPISODES;
        /// widths of the hidden layers, input side first
        layers: Vec<u32> = vec![128], in LAYER_WIDTHS;
        /// activation of the hidden layers
        activation: Activation = Activation::Relu;
        /// Adam's step size
        learning_rate: f64 = 6e-4, in LEARNING_RATE;
        /// discount factor per step
        gamma: f64 = 0.99, in Kind::PROBABILITY;
        /// episodes sampled for one update
        trajectories_per_update: u32 = 1, in Kind::Integer { min: 1, max: 10_000 };
        /// divisor of the summed loss of an update
        loss_divisor: f64 = 50.0, in Kind::POSITIVE;
        /// which code performs the updates: "fused", kernels with the same results on every
        /// processor, or "burn", Burn's modules and gradients, many times slower, with results that depend
        /// on the processor
        engine: Engine = Engine::Fused;
        /// what the agent does where no message can be sent: "masked", it makes no choice and learns
        /// from none, or "chosen", it chooses, and learns as if its choice had been taken
        unavailable: Unavailable = Unavailable::Masked, before Unavailable::Masked;
    }
}

impl Default for Reinforce {
    fn default() -> Self {
        Reinforce::with_required(&[])
    }
}

/// Steps of sampled trajectories; row i of every array belongs to step i.
#[derive(Clone, Debug)]
pub struct Trajectories {
    /// The states.
    pub observations: Observations,
    /// \[rows\]: the actions taken in these states.
    pub actions: Vec<Action>,
    /// The preferences from which the actions were sampled: exp(logit) relative to the highest of
    /// the row, \[rows, actions\].
    pub preferences: Vec<f32>,
    /// Discounted rewards to go G_t = Σ_k≥t gamma^(k-t) r_k, \[rows\].
    pub returns_to_go: Vec<f32>,
}

/// Name of the memory in messages.
const TRAJECTORIES: &str = "the trajectories of an update";

/// The number of steps for which room is reserved at once.
const STEPS_AHEAD: usize = 16;

impl Trajectories {
    /// Reserves room for `rows` more rows of this number of actions.
    fn reserve(&mut self, rows: usize, actions: usize) -> Result<(), OutOfMemory> {
        let more = rows * self.observations.width();
        let bytes = (self.observations.features().len() + more) * size_of::<f32>();
        let refused = OutOfMemory { what: TRAJECTORIES, bytes };
        memory::permit(bytes, TRAJECTORIES)?;
        self.observations.try_reserve(rows).map_err(|_| refused)?;
        reserve(&mut self.actions, rows, TRAJECTORIES)?;
        reserve(&mut self.preferences, rows * actions, TRAJECTORIES)
    }

    /// Appends the rows of some lanes of a step.
    fn extend(
        &mut self,
        lanes: Range<usize>,
        observations: &Observations,
        actions: &[Action],
        preferences: &[f32],
    ) {
        let count = preferences.len() / actions.len();
        self.preferences.extend_from_slice(&preferences[lanes.start * count..lanes.end * count]);
        self.actions.extend_from_slice(&actions[lanes.clone()]);
        self.observations.extend(observations, lanes);
    }
}

/// The engine of REINFORCE, which trains a policy network.
pub trait ReinforceEngine: Resumable {
    /// The network at the time of the call, which chooses actions.
    type Network: ActionNetwork + Send + 'static;

    /// The instruction set for the algorithm's computations outside the engine.
    fn isa(&self) -> Isa {
        Isa::chosen()
    }

    /// Replaces `out` by the logits of the actions for every observation, \[rows, actions\].
    fn logits(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.network().evaluate(observations, out);
    }

    /// One step of Adam on −(1/divisor) Σ G_t log π(a_t | s_t); returns this loss. The current
    /// network sampled the trajectories; an engine may use their preferences. If the loss is not
    /// finite, the engine may leave the network unchanged.
    fn update(&mut self, trajectories: &Trajectories) -> f32;

    /// The current network.
    fn network(&self) -> Self::Network;

    /// The weights of the current network.
    fn weights(&self) -> Weights;
}

/// Replaces rewards in place by discounted rewards to go.
///
/// **Shapes**: `rewards` is \[time, lanes\], row by row.
pub fn returns_to_go(rewards: &mut [f64], lanes: usize, gamma: f64) {
    let mut later: &[f64] = &[];
    for earlier in rewards.rchunks_exact_mut(lanes) {
        earlier.iter_mut().zip(later).for_each(|(sum, later)| *sum += gamma * later);
        later = earlier;
    }
}

/// REINFORCE in training, one update at a time.
pub struct ReinforceLearner<E, Env = Simulated> {
    engine: E,
    parameters: Reinforce,
    updates: u64,
    environment: Env,
    environment_streams: LaneStreams,
    exploration_stream: Stream,
    workspace: Workspace,
}

/// Buffers that are reused, so that an update allocates nothing.
struct Workspace {
    trajectories: Trajectories,
    /// Positions \[time, lane\] of the rows, as ranges. A lane that has ended, or whose agent did not
    /// choose, has no row.
    positions: Vec<Range<usize>>,
    /// \[time, lane\].
    rewards: Vec<f64>,
    /// Undiscounted returns, \[lane\].
    totals: Vec<f64>,
    /// \[lane\].
    lengths: Vec<u32>,
    /// \[lane\].
    actions: Vec<Action>,
    observations: Observations,
    logits: Vec<f32>,
    halves: Vec<u32>,
    /// Whether a lane's step is one to learn from, \[lane\].
    learned: Vec<bool>,
}

impl Workspace {
    /// Prepares for the trajectories of another update.
    fn clear(&mut self) {
        self.trajectories.observations.clear();
        self.trajectories.actions.clear();
        self.trajectories.preferences.clear();
        self.positions.clear();
        self.rewards.clear();
        self.totals.fill(0.0);
        self.lengths.fill(0);
    }
}

impl<E: ReinforceEngine, Env: VectorEnvironment> ReinforceLearner<E, Env> {
    /// A learner before its first update, in an environment with one lane per trajectory of an
    /// update.
    pub fn new(engine: E, parameters: &Reinforce, environment: Env, seed: u64) -> Self {
        let none = environment.observation_spec().observations();
        let lanes = environment.lanes();
        ReinforceLearner {
            engine,
            updates: 0,
            workspace: Workspace {
                trajectories: Trajectories {
                    observations: none.clone(),
                    actions: Vec::new(),
                    preferences: Vec::new(),
                    returns_to_go: Vec::new(),
                },
                positions: Vec::new(),
                rewards: Vec::new(),
                totals: vec![0.0; lanes],
                lengths: vec![0; lanes],
                actions: vec![Action::default(); lanes],
                observations: none,
                logits: Vec::new(),
                halves: Vec::new(),
                learned: Vec::new(),
            },
            environment,
            environment_streams: LaneStreams::Shared(Stream::new(seed, Purpose::Environment)),
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            parameters: parameters.clone(),
        }
    }

    /// Samples the trajectories of one update in lockstep, or their remaining steps after a pause.
    fn sample(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<SpanEnd, OutOfMemory> {
        if !self.environment.any_running() {
            self.environment.reset(LaneSet::All, &mut self.environment_streams);
            self.workspace.clear();
        }
        let Workspace {
            trajectories,
            positions,
            rewards,
            totals,
            lengths,
            actions,
            observations,
            logits,
            halves,
            learned,
        } = &mut self.workspace;
        let unavailable = self.parameters.unavailable;
        let (lanes, count) = (self.environment.lanes(), self.environment.action_spec().count);
        // Steps for which there is room.
        let mut ahead = 0;
        while self.environment.any_running() {
            if pause() {
                return Ok(SpanEnd::BrokenOff);
            }
            self.environment.observe(observations);
            self.engine.logits(observations, logits);
            sample(self.engine.isa(), logits, actions, halves, &mut self.exploration_stream);
            if let Some(observer) = &mut observer {
                let mut probabilities = vec![0.0; logits.len()];
                sampling_probabilities(logits, count, &mut probabilities);
                unavailable.withhold(&self.environment, actions, &mut probabilities);
                observer.chosen(&self.environment, actions, &probabilities);
            }
            if ahead == 0 {
                ahead = STEPS_AHEAD;
                trajectories.reserve(lanes * ahead, count)?;
                reserve(rewards, lanes * ahead, TRAJECTORIES)?;
                reserve(positions, lanes * ahead, TRAJECTORIES)?;
            }
            ahead -= 1;
            let start = rewards.len();
            rewards.resize(start + lanes, 0.0);
            learned.clear();
            for (lane, status) in self.environment.statuses().iter().enumerate() {
                let is_running = *status == EpisodeStatus::Running;
                lengths[lane] += u32::from(is_running);
                learned.push(is_running && unavailable.chooses(&self.environment, lane));
            }
            // Each run of adjacent lanes with a choice to learn from is copied at once.
            let mut lane = 0;
            for run in learned.chunk_by(|a, b| a == b) {
                let lanes = lane..lane + run.len();
                lane = lanes.end;
                if run[0] {
                    positions.push(start + lanes.start..start + lanes.end);
                    trajectories.extend(lanes, observations, actions, logits);
                }
            }
            let paid = &mut rewards[start..];
            self.environment.step(actions, paid, &mut self.environment_streams);
            let outcomes = self.environment.outcomes(paid);
            totals.iter_mut().zip(outcomes).for_each(|(total, outcome)| *total += *outcome);
            if let Some(observer) = &mut observer {
                observer.paid(&self.environment, paid);
            }
        }
        Ok(SpanEnd::Whole)
    }

    /// The records of the sampled episodes.
    fn finished(&self) -> impl Iterator<Item = TrainedEpisode> {
        let Workspace { totals, lengths, .. } = &self.workspace;
        totals.iter().zip(lengths).zip(self.environment.statuses()).map(
            |((total_reward, length), status)| TrainedEpisode {
                total_reward: *total_reward,
                length: *length,
                terminated: *status == EpisodeStatus::Terminated,
                ..TrainedEpisode::default()
            },
        )
    }
}

impl<E: ReinforceEngine, Env: VectorEnvironment> Learner<Env> for ReinforceLearner<E, Env> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<SpanEnd, LearnerError> {
        if self.sample(observer, pause)? == SpanEnd::BrokenOff {
            return Ok(SpanEnd::BrokenOff);
        }
        finished.extend(self.finished());
        let Workspace { trajectories, positions, rewards, .. } = &mut self.workspace;
        returns_to_go(rewards, self.environment.lanes(), self.parameters.gamma);
        trajectories.returns_to_go.clear();
        reserve(&mut trajectories.returns_to_go, trajectories.actions.len(), TRAJECTORIES)?;
        for rows in positions {
            let returns = rewards[rows.clone()].iter();
            trajectories.returns_to_go.extend(returns.map(|&sum| sum as f32));
        }
        // Without a single choice there is nothing to learn.
        let is_empty = trajectories.actions.is_empty();
        let loss = if is_empty { 0.0 } else { self.engine.update(trajectories) };
        self.updates += 1;
        if !loss.is_finite() {
            return Err(Diverged { update: self.updates, loss }.into());
        }
        if let Some(last) = finished.last_mut() {
            last.loss_sum = f64::from(loss);
            last.updates = 1;
        }
        Ok(SpanEnd::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>> {
        let observations = self.environment.observation_spec().observations();
        Box::new(NetworkActor::new(self.engine.network(), Choice::Softmax, actions, observations))
    }

    fn weights(&self) -> Weights {
        self.engine.weights()
    }
}

resumable!([E: ReinforceEngine, Env: VectorEnvironment] ReinforceLearner<E, Env> {
    parts engine, updates, environment_streams, exploration_stream, environment, workspace;
    check fits, "trajectories"
});

impl<E: ReinforceEngine, Env: VectorEnvironment> ReinforceLearner<E, Env> {
    /// Whether the trajectories consist of actions of the environment.
    fn fits(&self) -> bool {
        let count = self.environment.action_spec().count;
        let Trajectories { actions, preferences, .. } = &self.workspace.trajectories;
        preferences.len() == actions.len() * count
            && actions.iter().all(|action| action.index() < count)
    }
}

// Saves the trajectories sampled so far.
resumable!([] Workspace {
    parts trajectories.observations, trajectories.actions, positions;
    grown trajectories.preferences, rewards;
    fixed totals, lengths;
    check fits, "trajectories"
});

impl Workspace {
    /// Whether the trajectories are consistent.
    fn fits(&self) -> bool {
        let (rows, paid) = (self.trajectories.observations.rows(), self.rewards.len());
        self.trajectories.actions.len() == rows
            && paid.is_multiple_of(self.lengths.len())
            && self.positions.iter().all(|rows| rows.start <= rows.end && rows.end <= paid)
            && self.positions.iter().map(Range::len).sum::<usize>() == rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rewards_to_go_by_hand() {
        // Two lanes: rewards 1, 2, 4 and 3, 0, 8; gamma 0.5.
        let mut rewards = [1.0, 3.0, 2.0, 0.0, 4.0, 8.0];
        returns_to_go(&mut rewards, 2, 0.5);
        assert_eq!(rewards, [3.0, 5.0, 4.0, 4.0, 4.0, 8.0]);
        returns_to_go(&mut [], 1, 0.5);
    }
}
