//! What an agent in a trial knows about the effect of a message after an update.

use crate::state::resumable;

/// The posterior of the effect of a message after an update.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EffectPosterior {
    /// The number of the update, from 1.
    pub update: u32,
    /// The number of steps of the trial before the update.
    pub step: u32,
    /// The person, from 1, with partial pooling; 0 for everybody, or for what people have in common.
    pub person: u32,
    /// The message: the number of an action above 0.
    pub action: u8,
    /// The means of the coefficients, \[features\].
    pub mean: Vec<f64>,
    /// Their covariances, \[features, features\].
    pub covariance: Vec<f64>,
    /// The standard deviations of people's coefficients around common ones, \[features\]; empty for a person, and without
    /// partial pooling.
    pub deviation: Vec<f64>,
}

resumable!([] EffectPosterior {
    parts update, step, person, action;
    grown mean, covariance, deviation
});
