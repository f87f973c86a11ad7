//! The environment's parameters, as one job holds them: single values, every key present.

use serde::{Deserialize, Serialize};

/// Longest horizon, in steps, for which an optimum is computed.
pub const LONGEST_OPTIMUM: u32 = 200;

/// Parameters of the physical-activity simulation.
///
/// Symbols and values are those of Karine et al. (2023), section 3.1 and table 3. The keys below
/// `horizon` are where the paper is silent or its published code differs from its text; their
/// defaults are what the published curves and tables were made with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Environment {
    /// Habituation decay a step without a message, in [0, 1].
    pub delta_h: f64,
    /// Habituation increment a message, in [0, 1].
    pub epsilon_h: f64,
    /// Disengagement-risk decay a suitable message, in [0, 1].
    pub delta_d: f64,
    /// Disengagement-risk increment a wrongly tailored message, in [0, 1].
    pub epsilon_d: f64,
    /// Base reward of an untailored message, in surplus steps.
    pub rho_1: f64,
    /// Base reward of a message tailored to the true context, in surplus steps.
    pub rho_2: f64,
    /// Baseline surplus steps in context 0 and in context 1.
    pub mu: [f64; 2],
    /// Standard deviation of the context feature; 0 means that the context probability is exact.
    pub sigma: f64,
    /// Most steps an episode can have.
    pub horizon: u32,
    /// Habituation at the start of an episode, in [0, 1].
    pub initial_habituation: f64,
    /// Disengagement risk at the start of an episode, in [0, 1].
    pub initial_disengagement: f64,
    /// Disengagement risk at which an episode ends, in (0, 1].
    pub disengagement_threshold: f64,
    /// How the context of the first step comes about.
    pub first_context: FirstContext,
    /// Which clock the time indicator and the one-hot of time read.
    pub time_indicator: TimeIndicator,
    /// Period of the time indicator, in steps (the paper's k).
    pub time_indicator_period: u32,
    /// Whether every observation also carries a one-hot of the time (`horizon` entries).
    pub time_one_hot: bool,
    /// Which context the observed probability (letter P) is of: 0 or 1.
    pub observed_probability: u8,
}

impl Environment {
    /// The published settings at a feature noise of `sigma`.
    pub fn paper(sigma: f64) -> Self {
        Environment {
            delta_h: 0.1,
            epsilon_h: 0.05,
            delta_d: 0.1,
            epsilon_d: 0.4,
            rho_1: 50.0,
            rho_2: 200.0,
            mu: [0.1, 0.1],
            sigma,
            horizon: 50,
            initial_habituation: 0.1,
            initial_disengagement: 0.1,
            disengagement_threshold: 1.0,
            first_context: FirstContext::Fixed,
            time_indicator: TimeIndicator::Lagged,
            time_indicator_period: 2,
            time_one_hot: false,
            observed_probability: 0,
        }
    }
}

/// How the context of an episode's first step comes about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FirstContext {
    /// Context 0, shown as p = (0.5, 0.5) and l = 0, as the authors' code starts.
    Fixed,
    /// Drawn like every other context, as the paper's text says.
    Sampled,
}

/// Which clock an observation shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeIndicator {
    /// The time of the step before: the authors' code builds the observation before the clock
    /// moves, so steps 0 and 1 look alike.
    Lagged,
    /// The time of the step itself, as the paper's text says.
    Exact,
}
