//! The environment's parameters, as one job holds them: single values, every key present.

use crate::key::{Keyed, Kind, Value, choices, keys};

keys! {
    /// Parameters of the physical-activity simulation.
    ///
    /// Symbols and values follow Karine et al. (2023), section 3.1 and table 3. The keys below
    /// `horizon` cover choices that the paper leaves open, or where its published code differs from
    /// its text; their defaults are the settings of the published curves and tables.
    pub struct StepCount {
        /// standard deviation of the context feature; 0: the context probability is exact
        sigma: f64, in Kind::NON_NEGATIVE;
        /// habituation decay per step without a message
        delta_h: f64 = 0.1, in Kind::PROBABILITY;
        /// habituation increment per message
        epsilon_h: f64 = 0.05, in Kind::PROBABILITY;
        /// disengagement-risk decay per suitable message
        delta_d: f64 = 0.1, in Kind::PROBABILITY;
        /// disengagement-risk increment per wrongly tailored message
        epsilon_d: f64 = 0.4, in Kind::PROBABILITY;
        /// base reward of an untailored message, in steps
        rho_1: f64 = 50.0, in Kind::ANY_REAL;
        /// base reward of a message tailored to the true context, in steps
        rho_2: f64 = 200.0, in Kind::ANY_REAL;
        /// baseline reward in context 0 and in context 1, in steps
        mu: [f64; 2] = [0.1, 0.1], in Kind::ANY_REAL_PAIR;
        /// maximum number of steps in an episode
        horizon: u32 = 50, in Kind::Integer { min: 1, max: 10_000 };
        /// habituation at the start of an episode
        initial_habituation: f64 = 0.1, in Kind::PROBABILITY;
        /// disengagement risk at the start of an episode
        initial_disengagement: f64 = 0.1, in Kind::PROBABILITY;
        /// disengagement risk at which an episode ends
        disengagement_threshold: f64 = 1.0, in Kind::PositiveReal { max: 1.0 };
        /// context of the first step: 0 shown as p = 0.5 (the authors' code) or drawn like the
        /// others (the paper)
        first_context: FirstContext = FirstContext::Fixed;
        /// clock of the time indicator: of the step before (the authors' code) or of the step
        /// itself (the paper)
        time_indicator: TimeIndicator = TimeIndicator::Lagged;
        /// period of the time indicator, in steps (the paper's k)
        time_indicator_period: u32 = 2, in Kind::Integer { min: 1, max: 10_000 };
        /// whether every observation also carries a one-hot of the time
        time_one_hot: bool = false;
        /// the context whose probability the letters P and F show
        observed_probability: u8 = 0, in Kind::Integer { min: 0, max: 1 };
        /// noise of habituation and disengagement risk: "uniform" around their next values, or "beta"
        /// with these as means
        state_noise: StateNoise = StateNoise::None, before StateNoise::None;
        /// width of the uniform noise, relative to the value (the official code's chosen_a); read with
        /// state_noise = "uniform"
        state_spread: f64 = SPREAD, before SPREAD, in SPREADS;
        /// concentration of the beta noise of habituation: alpha + beta; required with state_noise =
        /// "beta", 0 without
        kappa_h: f64 = 0.0, before 0.0, in Kind::NON_NEGATIVE;
        /// concentration of the beta noise of disengagement risk: alpha + beta; required with
        /// state_noise = "beta", 0 without
        kappa_d: f64 = 0.0, before 0.0, in Kind::NON_NEGATIVE;
        /// noise of the steps walked: "gamma" with the noise-free steps as mean
        step_noise: StepNoise = StepNoise::None, before StepNoise::None;
        /// standard deviation of the steps walked; required with step_noise = "gamma", 0 without
        sigma_s: f64 = 0.0, before 0.0, in Kind::NON_NEGATIVE;
        /// width of uniform noise of delta_h, epsilon_h, delta_d and epsilon_d, relative to their
        /// values, drawn anew in each step
        parameter_spread: f64 = 0.0, before 0.0, in SPREADS;
        /// habituation that the reward depends on: the next one without its noise (the official code)
        /// or as drawn (its text)
        reward_habituation: RewardHabituation = RewardHabituation::Expected,
            before RewardHabituation::Expected;
        /// base reward of a wrongly tailored message, in steps
        rho_3: f64 = 0.0, before 0.0, in Kind::ANY_REAL;
        /// reward of the step on which a participant disengages: the usual reward, or 0
        disengagement_reward: DisengagementReward = DisengagementReward::Paid,
            before DisengagementReward::Paid;
        /// whether fewer than 0 steps count as 0
        steps_cut_at_zero: bool = false, before false;
        /// whether an episode that reaches the horizon ends one step later, with a step of reward 0
        unpaid_last_step: bool = false, before false;
        /// probability of context 1
        context_probability: f64 = 0.5, before 0.5, in Kind::PROBABILITY;
        /// correlation of consecutive contexts: the probability that a context is kept instead of
        /// drawn anew
        context_persistence: f64 = 0.0, before 0.0, in Kind::PROBABILITY;
        /// probability that a message can be sent at a step; otherwise action 0 is taken
        availability: f64 = 1.0, before 1.0, in Kind::PROBABILITY;
        /// cost of a message in the reward that agents learn from, in steps
        message_cost: f64 = 0.0, before 0.0, in Kind::NON_NEGATIVE;
        /// maximum number of messages in an episode; action 0 is taken afterwards
        message_budget: u32 = MOST_MESSAGES, before MOST_MESSAGES,
            in Kind::Integer { min: 0, max: MOST_MESSAGES as u64 };
        /// number of particles of the beliefs that have no exact numbers, rounded up to a multiple of 8
        belief_particles: u32 = PARTICLES, before PARTICLES, in Kind::Integer { min: 8, max: 4096 };
    }
}

/// The default width of uniform noise.
const SPREAD: f64 = 0.01;
/// The range of widths of relative noise; at 2, values reach down to 0.
const SPREADS: Kind = Kind::Real { min: 0.0, max: 2.0 };
/// The default number of particles.
const PARTICLES: u32 = 128;
/// The default message budget: the longest horizon, which no episode exceeds.
const MOST_MESSAGES: u32 = 10_000;

/// The version of the simulation and its random streams. It is raised whenever a change makes the
/// same job produce different results.
pub const VERSION: u32 = 1;

impl StepCount {
    /// The published settings at a feature noise of `sigma`.
    pub fn paper(sigma: f64) -> Self {
        StepCount::with_required(&[Value::Real(sigma)])
    }

    /// Whether habituation and disengagement risk have noise, of their own or of their parameters.
    pub(super) fn has_noise_of_state(&self) -> bool {
        self.state_noise != StateNoise::None || self.parameter_spread > 0.0
    }

    /// Whether contexts are drawn as in the paper: equally likely and independent.
    pub fn has_independent_fair_contexts(&self) -> bool {
        self.context_probability == 0.5 && self.context_persistence == 0.0
    }

    /// Whether the budget of messages can be spent before the last step.
    pub fn can_spend_budget(&self) -> bool {
        self.message_budget < self.longest_episode()
    }

    /// Whether the reward of a step can be 0 regardless of the steps walked.
    pub(super) fn can_pay_nothing(&self) -> bool {
        self.unpaid_last_step || self.disengagement_reward == DisengagementReward::Zero
    }

    /// The number of steps in an episode that does not end in disengagement.
    pub fn longest_episode(&self) -> u32 {
        self.horizon + u32::from(self.unpaid_last_step)
    }
}

choices! {
    /// How the context of an episode's first step comes about.
    pub enum FirstContext {
        /// Context 0, shown as p = (0.5, 0.5) and l = 0, as the authors' code starts.
        Fixed = "fixed",
        /// Drawn like every other context, as the paper's text says.
        Sampled = "sampled",
    }
}

choices! {
    /// Which clock an observation shows.
    pub enum TimeIndicator {
        /// The time of the step before: the authors' code builds the observation before the clock
        /// moves, so steps 0 and 1 look alike.
        Lagged = "lagged",
        /// The time of the step itself, as the paper's text says.
        Exact = "exact",
    }
}

choices! {
    /// The noise of habituation and disengagement risk.
    pub enum StateNoise {
        /// None: both follow from the action.
        None = "none",
        /// Uniform within a share of the noise-free value.
        Uniform = "uniform",
        /// Beta with the noise-free value as mean.
        Beta = "beta",
    }
}

choices! {
    /// The noise of the steps walked.
    pub enum StepNoise {
        /// None: they follow from the action and the state.
        None = "none",
        /// Gamma with the noise-free steps as mean.
        Gamma = "gamma",
    }
}

choices! {
    /// Which habituation after the step the reward depends on.
    pub enum RewardHabituation {
        /// Without its noise.
        Expected = "expected",
        /// As drawn.
        Drawn = "drawn",
    }
}

choices! {
    /// The reward of the step that disengages.
    pub enum DisengagementReward {
        /// The reward of any other step.
        Paid = "paid",
        /// Zero.
        Zero = "zero",
    }
}
