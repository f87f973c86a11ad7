//! A step with all features of the manifest: noise, availability, cost and budget of messages, other endings,
//! and the memory of the last step.

use pulp::{Simd, WithSimd};

use crate::env::scenario::Scenario;
use crate::env::step_count::dynamics::{Dynamics, LaneDynamics, StateChange};
use crate::env::step_count::intervention::OPTIONS;
use crate::env::step_count::noise::Noise;
use crate::env::step_count::parameters::{
    DisengagementReward, RewardHabituation, StateNoise, StepCount, StepNoise,
};
use crate::env::step_count::scenario::Feature;
use crate::env::vector::{Action, EpisodeStatus};
use crate::state::resumable;

/// The steps walked before an episode, as the official code shows them.
pub const INITIAL_STEPS: f64 = 0.1;

/// Whether a step needs more than the paper's equations, the endings of its code and uniform noise of the state.
pub(super) fn is_needed(e: &StepCount, scenario: &Scenario) -> bool {
    let remembered =
        [Feature::Available, Feature::Budget, Feature::PreviousAction, Feature::PreviousSteps];
    let paper = StepCount::paper(e.sigma);
    scenario.features().iter().any(|feature| remembered.contains(feature))
        || e.state_noise == StateNoise::Beta
        || e.step_noise != StepNoise::None
        || e.parameter_spread > 0.0
        || e.disengagement_reward != DisengagementReward::Paid
        || e.steps_cut_at_zero
        || e.unpaid_last_step
        || e.availability < 1.0
        || e.message_cost > 0.0
        || e.message_budget != paper.message_budget
}

/// The state of the lanes beyond the paper's simulation; every array is \[lanes\].
#[derive(Clone, Debug)]
pub(super) struct Memory {
    /// Whether a message can be sent in the current step.
    pub(super) available: Vec<bool>,
    /// The number of messages sent in the episode.
    pub(super) messages: Vec<u32>,
    /// The action taken in the last step; `None` in the first.
    pub(super) actions: Vec<Option<Action>>,
    /// The steps walked in the last step.
    pub(super) steps: Vec<f64>,
    /// The steps walked in the last call; in contrast to `steps`, 0 in lanes that had ended.
    pub(super) walked: Vec<f64>,
}

impl Memory {
    pub(super) fn new(lanes: usize) -> Self {
        Memory {
            available: vec![true; lanes],
            messages: vec![0; lanes],
            actions: vec![None; lanes],
            steps: vec![INITIAL_STEPS; lanes],
            walked: vec![0.0; lanes],
        }
    }

    /// Clears the memory of a lane for a new episode.
    pub(super) fn reset(&mut self, lane: usize) {
        self.available[lane] = true;
        self.messages[lane] = 0;
        self.actions[lane] = None;
        self.steps[lane] = INITIAL_STEPS;
    }

    /// The action that is taken if an agent chooses `action`: no message without availability or budget.
    #[inline(always)]
    pub(super) fn taken(&self, budget: u32, lane: usize, action: Action) -> Action {
        if self.available[lane] && self.messages[lane] < budget { action } else { Action::NONE }
    }
}

resumable!([] Memory { each available, actions; fixed messages, steps; check fits, "actions" });

impl Memory {
    /// Whether the actions are actions of the environment.
    fn fits(&self) -> bool {
        self.actions.iter().flatten().all(|action| action.index() < OPTIONS)
    }
}

/// The full step of all lanes; every array is \[lanes\] or longer.
pub(super) struct FullStep<'a, P, N> {
    pub(super) environment: &'a StepCount,
    pub(super) dynamics: &'a P,
    pub(super) noise: &'a N,
    pub(super) contexts: &'a [u8],
    pub(super) actions: &'a [Action],
    pub(super) times: &'a mut [u32],
    pub(super) habituation: &'a mut [f64],
    pub(super) disengagement: &'a mut [f64],
    pub(super) statuses: &'a mut [EpisodeStatus],
    pub(super) memory: &'a mut Memory,
    pub(super) rewards: &'a mut [f64],
}

impl<P: LaneDynamics, N: Noise> FullStep<'_, P, N> {
    /// The state after an action, and the steps walked.
    #[inline(always)]
    fn effect(&self, lane: usize, dynamics: &Dynamics, action: Action) -> StateChange {
        let context = self.contexts[lane];
        let drawn = self.noise.dynamics(lane, dynamics);
        let expected =
            drawn.apply(context, action, self.habituation[lane], self.disengagement[lane]);
        let next = [expected.habituation, expected.disengagement];
        let [habituation, disengagement] =
            self.noise.state(lane, dynamics, next).map(|x| cut(x, 0.0, 1.0));
        let steps = match self.environment.reward_habituation {
            RewardHabituation::Expected => expected.reward,
            RewardHabituation::Drawn => drawn.reward(context, action, habituation),
        };
        let steps = self.noise.steps(lane, dynamics, steps);
        StateChange { habituation, disengagement, reward: steps }
    }

    #[inline(always)]
    fn lane(&mut self, lane: usize) {
        let e = self.environment;
        let dynamics = *self.dynamics.of(lane);
        let action = self.memory.taken(e.message_budget, lane, self.actions[lane]);
        let StateChange { habituation, disengagement, reward: steps } =
            self.effect(lane, &dynamics, action);
        let time = self.times[lane] + 1;
        let disengaged = disengagement >= dynamics.disengagement_threshold;
        let unpaid =
            time > e.horizon || (disengaged && e.disengagement_reward == DisengagementReward::Zero);
        let steps = if e.steps_cut_at_zero { cut(steps, 0.0, f64::INFINITY) } else { steps };
        let steps = if unpaid { 0.0 } else { steps };
        let sends = action != Action::NONE;
        self.times[lane] = time;
        self.habituation[lane] = habituation;
        self.disengagement[lane] = disengagement;
        self.statuses[lane] = if disengaged {
            EpisodeStatus::Terminated
        } else if time >= e.longest_episode() {
            EpisodeStatus::Truncated
        } else {
            EpisodeStatus::Running
        };
        self.memory.messages[lane] += u32::from(sends);
        self.memory.actions[lane] = Some(action);
        self.memory.steps[lane] = steps;
        self.memory.walked[lane] = steps;
        self.rewards[lane] = if sends { steps - dynamics.message_cost } else { steps };
    }
}

impl<P: LaneDynamics, N: Noise> WithSimd for FullStep<'_, P, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        for lane in 0..self.statuses.len() {
            if self.statuses[lane] == EpisodeStatus::Running {
                self.lane(lane);
            } else {
                self.rewards[lane] = 0.0;
                self.memory.walked[lane] = 0.0;
            }
        }
    }
}

/// `x`, or the nearest number from `low` to `high`.
#[inline(always)]
pub(super) fn cut(x: f64, low: f64, high: f64) -> f64 {
    let x = if x > low { x } else { low };
    if x < high { x } else { high }
}
