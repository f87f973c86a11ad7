//! What a bandit in a trial has learned about the effects of messages at every update.

use crate::agent::effect_posterior::EffectPosterior;
use crate::agent::linear_thompson::features::{BanditFeatures, Design};
use crate::agent::linear_thompson::posterior::Acting;
use crate::state::resumable;

/// The posteriors of the effects of all messages after the updates so far, by update and message.
#[derive(Clone, Debug, Default)]
pub struct Updates(pub Vec<EffectPosterior>);

resumable!([] Updates { parts 0 });

impl Updates {
    /// Adds the posteriors after an update that comes behind this number of steps of the trial: that of everybody, and
    /// with partial pooling those of people; and the deviations of people's effects, \[messages\]\[features\].
    pub fn push<'a>(
        &mut self,
        step: u32,
        features: usize,
        of: impl Iterator<Item = &'a Acting>,
        deviations: &[Vec<f64>],
    ) {
        let update = self.0.last().map_or(0, |last| last.update) + 1;
        for (person, acting) in (0..).zip(of) {
            for (action, (mean, covariance)) in (1..).zip(acting.effects(features)) {
                // The matrix is symmetric, so that the order of the axes does not matter.
                let covariance = covariance.as_slice().to_vec();
                let deviation = deviations.get(usize::from(action) - 1).filter(|_| person == 0);
                let deviation = deviation.cloned().unwrap_or_default();
                let posterior =
                    EffectPosterior { update, step, person, action, mean, covariance, deviation };
                self.0.push(posterior);
            }
        }
    }
}

/// The features of a state, the intercept first, for an agent with this number of features; `None` if no kind of
/// features has this number.
pub fn features_of_state(state: &[f64], width: usize) -> Option<Vec<f64>> {
    let kinds = [BanditFeatures::Linear, BanditFeatures::Interactions];
    let mut designs = kinds.into_iter().map(|kind| Design::of(kind, state.len(), 0));
    let design = designs.find(|design| design.width() == width)?;
    let mut features = Vec::new();
    design.fill_exact(state, None, &mut features);
    Some(features)
}
