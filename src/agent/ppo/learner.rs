//! PPO in training.

use crate::agent::actor::{Actor, StepObserver};
use crate::agent::learner::{Actions, Diverged, Learner, LearnerError, SpanEnd, TrainedEpisode};
use crate::agent::memory::{OutOfMemory, reserve};
use crate::agent::policy::{Choice, NetworkActor, sample, sampling_probabilities};
use crate::agent::ppo::minibatch::Minibatch;
use crate::agent::ppo::rollout::LaneSteps;
use crate::agent::ppo::{AtHorizon, Losses, Ppo, PpoEngine};
use crate::agent::weights::Weights;
use crate::env::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Observations, Simulated, VectorEnvironment,
};
use crate::kernel::math;
use crate::rng::{Purpose, Stream};

/// PPO in training, one rollout at a time.
///
/// The budget is met exactly: a lane whose episode ends begins another in the next step, until as
/// many episodes as declared have begun. After that, lanes without an episode are idle, and their
/// steps are not learned from. The last rollout ends with the last episode. The step size of a
/// rollout is annealed by the share of episodes that ended before it. If every rollout consists of
/// whole episodes, this is CleanRL's rule.
///
/// # Panics
/// Training panics if the caller requests more episodes than the budget has.
pub struct PpoLearner<E, Env = Simulated> {
    pub(super) engine: E,
    pub(super) parameters: Ppo,
    pub(super) environment: Env,
    pub(super) environment_streams: LaneStreams,
    pub(super) exploration_stream: Stream,
    pub(super) minibatch_stream: Stream,
    /// Number of episodes that have begun.
    pub(super) begun: u32,
    /// Number of episodes that had ended before the rollout.
    pub(super) ended: u32,
    pub(super) updates: u64,
    /// Number, return so far and length so far of each lane's episode, \[lanes\].
    pub(super) numbers: Vec<u32>,
    pub(super) totals: Vec<f64>,
    pub(super) lengths: Vec<u32>,
    /// The networks' memory of each lane's episode, \[lanes, memory\].
    pub(super) memory: Vec<f32>,
    pub(super) rollout: LaneSteps,
    /// Episodes that have ended in the rollout.
    pub(super) finished: Vec<TrainedEpisode>,
    /// Sum of the losses of the updates since an episode was last reported (`loss_sum`), and their
    /// number (`losses`).
    pub(super) loss_sum: f64,
    pub(super) losses: u32,
    /// Progress of the learning from the rollout; `None` while the rollout is collected.
    pub(super) learning: Option<Learning>,
    workspace: Workspace,
}

/// Progress of the learning from a rollout.
#[derive(Clone, Debug, Default)]
pub(super) struct Learning {
    pub(super) epoch: u32,
    /// Number of minibatches of the epoch that have been used.
    pub(super) parts: usize,
    /// Rows of the rollout, or lanes for networks with memory, in the order of the epoch.
    pub(super) order: Vec<u32>,
}

/// Buffers that are reused, so that a step allocates nothing.
struct Workspace {
    observations: Observations,
    /// A copy of the networks' memory, for observations that are evaluated only for their value.
    memory: Vec<f32>,
    logits: Vec<f32>,
    values: Vec<f32>,
    /// \[lanes\].
    actions: Vec<Action>,
    /// \[lanes, actions\].
    probabilities: Vec<f64>,
    /// \[lanes\].
    rewards: Vec<f64>,
    restarted: Vec<bool>,
    /// \[lanes\]: whether the step is the first of an episode, and whether the agent chooses in it.
    marks: [Vec<bool>; 2],
    halves: Vec<u32>,
    order: Vec<u32>,
    minibatch: Minibatch,
}

impl<E: PpoEngine, Env: VectorEnvironment> PpoLearner<E, Env> {
    /// A learner before its first step, in an environment with as many lanes as its parameters say.
    pub fn new(engine: E, parameters: &Ppo, environment: Env, seed: u64) -> Self {
        let none = environment.observation_spec().observations();
        let (lanes, count) = (environment.lanes(), environment.action_spec().count);
        PpoLearner {
            parameters: parameters.clone(),
            environment,
            environment_streams: LaneStreams::Shared(Stream::new(seed, Purpose::Environment)),
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            minibatch_stream: Stream::new(seed, Purpose::Replay),
            begun: 0,
            ended: 0,
            updates: 0,
            numbers: vec![0; lanes],
            totals: vec![0.0; lanes],
            lengths: vec![0; lanes],
            memory: vec![0.0; lanes * engine.memory()],
            rollout: LaneSteps::new(lanes, none.clone()),
            finished: Vec::new(),
            loss_sum: 0.0,
            losses: 0,
            learning: None,
            engine,
            workspace: Workspace {
                observations: none.clone(),
                memory: Vec::new(),
                logits: Vec::new(),
                values: Vec::new(),
                actions: vec![Action::default(); lanes],
                probabilities: vec![0.0; lanes * count],
                rewards: vec![0.0; lanes],
                restarted: vec![false; lanes],
                marks: [vec![false; lanes], vec![false; lanes]],
                halves: Vec::new(),
                order: Vec::new(),
                minibatch: Minibatch::new(none),
            },
        }
    }

    /// Begins episodes in lanes without a running one, as long as the budget lasts.
    fn restart(&mut self) {
        let Workspace { restarted, .. } = &mut self.workspace;
        let mut any = false;
        let width = self.engine.memory();
        for (lane, status) in self.environment.statuses().iter().enumerate() {
            restarted[lane] =
                *status != EpisodeStatus::Running && self.begun < self.parameters.episodes;
            if restarted[lane] {
                self.begun += 1;
                self.numbers[lane] = self.begun;
                self.totals[lane] = 0.0;
                self.lengths[lane] = 0;
                self.memory[lane * width..(lane + 1) * width].fill(0.0);
                any = true;
            }
        }
        if any {
            self.environment.reset(LaneSet::Masked(restarted), &mut self.environment_streams);
        }
    }

    /// Collects the steps of a rollout, or its remaining steps after a pause.
    fn collect(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<SpanEnd, OutOfMemory> {
        while self.rollout.steps() < self.parameters.steps as usize {
            self.restart();
            if !self.environment.any_running() {
                break;
            }
            if pause() {
                return Ok(SpanEnd::BrokenOff);
            }
            self.choose()?;
            let Workspace { actions, probabilities, rewards, .. } = &mut self.workspace;
            if let Some(observer) = &mut observer {
                observer.chosen(&self.environment, actions, probabilities);
            }
            self.environment.step(actions, rewards, &mut self.environment_streams);
            if let Some(observer) = &mut observer {
                observer.paid(&self.environment, rewards);
            }
            self.pay()?;
        }
        Ok(SpanEnd::Whole)
    }

    /// Chooses the actions of a step.
    fn choose(&mut self) -> Result<(), OutOfMemory> {
        let Workspace {
            observations, logits, values, actions, probabilities, halves, marks, ..
        } = &mut self.workspace;
        self.rollout.reserve()?;
        if self.rollout.steps() == 0 {
            self.rollout.memory.clone_from(&self.memory);
        }
        self.environment.observe(observations);
        self.engine.evaluate(observations, &mut self.memory, logits, values);
        sample(self.engine.isa(), logits, actions, halves, &mut self.exploration_stream);
        // [`sample`] has replaced the logits by the preferences that it sampled from.
        let count = logits.len() / actions.len();
        sampling_probabilities(logits, count, probabilities);
        let unavailable = self.parameters.unavailable;
        unavailable.withhold(&self.environment, actions, probabilities);
        let each = probabilities.chunks_exact(count).zip(&*actions);
        let log_probabilities = each.map(|(p, action)| math::ln(p[action.index()]) as f32);
        let [firsts, chosen] = marks;
        for (lane, length) in self.lengths.iter().enumerate() {
            firsts[lane] = *length == 0;
            chosen[lane] = unavailable.chooses(&self.environment, lane);
        }
        let (marks, statuses) = ([&firsts[..], &chosen[..]], self.environment.statuses());
        self.rollout.choose(observations, actions, log_probabilities, values, marks, statuses);
        Ok(())
    }

    /// Records the rewards of a step and the episodes that it ended.
    fn pay(&mut self) -> Result<(), OutOfMemory> {
        let statuses = self.environment.statuses();
        let values_last = self.parameters.at_horizon == AtHorizon::Truncation
            && self
                .rollout
                .acted()
                .iter()
                .zip(statuses)
                .any(|(acted, status)| *acted && *status == EpisodeStatus::Truncated);
        if values_last {
            self.value_present();
        }
        let statuses = self.environment.statuses();
        let Workspace { values, rewards, .. } = &self.workspace;
        let Ppo { gamma, reward_scale, .. } = self.parameters;
        reserve(&mut self.finished, rewards.len(), "the episodes of a rollout")?;
        let outcomes = self.environment.outcomes(rewards);
        let first = self.rollout.real.len() - self.rollout.lanes;
        for (lane, status) in statuses.iter().enumerate() {
            let acted = self.rollout.real[first + lane];
            let ended = acted && *status != EpisodeStatus::Running;
            let mut reward = rewards[lane] / reward_scale;
            if acted {
                self.totals[lane] += outcomes[lane];
                self.lengths[lane] += 1;
            }
            if ended {
                if values_last && *status == EpisodeStatus::Truncated {
                    reward += gamma * f64::from(values[lane]);
                }
                self.finished.push(TrainedEpisode {
                    number: Some(self.numbers[lane]),
                    total_reward: self.totals[lane],
                    length: self.lengths[lane],
                    terminated: *status == EpisodeStatus::Terminated,
                    ..TrainedEpisode::default()
                });
            }
            self.rollout.rewards.push(reward);
            self.rollout.ended.push(ended);
        }
        Ok(())
    }

    /// Computes the values of the current observations without advancing the memory.
    fn value_present(&mut self) {
        let Workspace { observations, memory, logits, values, .. } = &mut self.workspace;
        memory.clone_from(&self.memory);
        self.environment.observe(observations);
        self.engine.evaluate(observations, memory, logits, values);
    }

    /// Computes the advantages of a complete rollout and prepares to learn from it.
    fn begin_learning(&mut self) -> Result<(), OutOfMemory> {
        self.value_present();
        let Workspace { values, order, .. } = &mut self.workspace;
        self.rollout.finish(values, self.parameters.gamma, self.parameters.gae_lambda)?;
        order.clear();
        reserve(order, self.rollout.real.len(), "a rollout")?;
        // A lane without a real first step had no episode when the rollout began.
        let rows = if self.engine.memory() > 0 { self.rollout.lanes } else { usize::MAX };
        let real = self.rollout.real.iter().take(rows).enumerate().filter(|(_, real)| **real);
        order.extend(real.map(|(row, _)| row as u32));
        shuffle(order, &mut self.minibatch_stream);
        self.learning = Some(Learning { epoch: 0, parts: 0, order: std::mem::take(order) });
        Ok(())
    }

    /// Learns from the rollout until the last epoch has ended.
    fn learn(&mut self, pause: &dyn Fn() -> bool) -> Result<SpanEnd, LearnerError> {
        while let Some(mut learning) = self.learning.take() {
            if pause() {
                self.learning = Some(learning);
                return Ok(SpanEnd::BrokenOff);
            }
            let losses = self.update(&learning)?;
            learning.parts += 1;
            let Ppo { minibatches, epochs, target_kl, .. } = self.parameters;
            if learning.parts < (minibatches as usize).min(learning.order.len()) {
                self.learning = Some(learning);
                continue;
            }
            let too_far = target_kl > 0.0 && f64::from(losses.approx_kl) > target_kl;
            if learning.epoch + 1 < epochs && !too_far {
                learning.parts = 0;
                learning.epoch += 1;
                shuffle(&mut learning.order, &mut self.minibatch_stream);
                self.learning = Some(learning);
            } else {
                // Keeps the allocation for the next rollout.
                self.workspace.order = learning.order;
            }
        }
        Ok(SpanEnd::Whole)
    }

    /// Performs one update with the next minibatch.
    fn update(&mut self, learning: &Learning) -> Result<Losses, LearnerError> {
        let Ppo { episodes, learning_rate, anneal, norm_adv, minibatches, .. } = self.parameters;
        let rows = learning.order.len();
        let parts = (minibatches as usize).min(rows);
        // Sizes of minibatches differ by one row, or one lane, at most.
        let rows = learning.parts * rows / parts..(learning.parts + 1) * rows / parts;
        let minibatch = &mut self.workspace.minibatch;
        if self.engine.memory() > 0 {
            minibatch.gather_lanes(&self.rollout, &learning.order[rows])?;
        } else {
            minibatch.gather(&self.rollout, &learning.order[rows])?;
        }
        if norm_adv {
            minibatch.normalise();
        }
        let left = 1.0 - f64::from(self.ended) / f64::from(episodes);
        let rate = if anneal { learning_rate * left } else { learning_rate };
        let losses = self.engine.update(minibatch, rate);
        self.updates += 1;
        if !losses.loss.is_finite() {
            return Err(Diverged { update: self.updates, loss: losses.loss }.into());
        }
        self.loss_sum += f64::from(losses.loss);
        self.losses += 1;
        Ok(losses)
    }

    /// Reports the episodes of the rollout. The last one carries the losses since the previous
    /// report.
    fn report(&mut self, finished: &mut Vec<TrainedEpisode>) {
        self.ended += self.finished.len() as u32;
        if let Some(last) = self.finished.last_mut() {
            last.loss_sum = std::mem::take(&mut self.loss_sum);
            last.updates = std::mem::take(&mut self.losses);
        }
        finished.append(&mut self.finished);
        self.rollout.clear();
    }
}

/// Shuffles numbers so that every order is equally likely.
///
/// **Source**: Fisher and Yates, in Durstenfeld's form, 1964.
fn shuffle(numbers: &mut [u32], stream: &mut Stream) {
    for last in (1..numbers.len()).rev() {
        numbers.swap(last, stream.below(last as u32 + 1) as usize);
    }
}

impl<E: PpoEngine, Env: VectorEnvironment> Learner<Env> for PpoLearner<E, Env> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<SpanEnd, LearnerError> {
        if self.learning.is_none() {
            assert!(
                self.ended < self.parameters.episodes,
                "every declared episode has been played"
            );
            if self.collect(observer, pause)? == SpanEnd::BrokenOff {
                return Ok(SpanEnd::BrokenOff);
            }
            self.begin_learning()?;
        }
        if self.learn(pause)? == SpanEnd::BrokenOff {
            return Ok(SpanEnd::BrokenOff);
        }
        self.report(finished);
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
