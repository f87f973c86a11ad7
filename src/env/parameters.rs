//! The environment's parameters, as one job holds them: single values, every key present.

use crate::key::{Keyed, Kind, Value};
use crate::{choices, keys};

keys! {
    /// Parameters of the physical-activity simulation.
    ///
    /// Symbols and values are those of Karine et al. (2023), section 3.1 and table 3. The keys below
    /// `horizon` are where the paper is silent or its published code differs from its text; their
    /// defaults are what the published curves and tables were made with.
    pub struct Environment {
        /// standard deviation of the context feature; 0: the context probability is exact
        sigma: f64, in Kind::NON_NEGATIVE;
        /// habituation decay a step without a message
        delta_h: f64 = 0.1, in Kind::PROBABILITY;
        /// habituation increment a message
        epsilon_h: f64 = 0.05, in Kind::PROBABILITY;
        /// disengagement-risk decay a suitable message
        delta_d: f64 = 0.1, in Kind::PROBABILITY;
        /// disengagement-risk increment a wrongly tailored message
        epsilon_d: f64 = 0.4, in Kind::PROBABILITY;
        /// base reward of an untailored message, in steps
        rho_1: f64 = 50.0, in Kind::ANY_REAL;
        /// base reward of a message tailored to the true context, in steps
        rho_2: f64 = 200.0, in Kind::ANY_REAL;
        /// baseline reward in context 0 and in context 1, in steps
        mu: [f64; 2] = [0.1, 0.1], in Kind::ANY_REAL_PAIR;
        /// most steps an episode can have
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
        /// the context whose probability the letter P shows
        observed_probability: u8 = 0, in Kind::Integer { min: 0, max: 1 };
    }
}

/// The version of the simulation and its random streams; it is raised whenever a change makes the
/// same job end in other bits.
pub const VERSION: u32 = 1;

impl Environment {
    /// The published settings at a feature noise of `sigma`.
    pub fn paper(sigma: f64) -> Self {
        Environment::with_required(&[Value::Real(sigma)])
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
