//! The features of a state, on which the reward is regressed.

use crate::agent::linear_thompson::BanditFeatures;
use crate::env::{ObservationSpec, Observations};

/// The mapping from observations to features.
#[derive(Clone, Debug)]
pub struct Design {
    features: BanditFeatures,
    letters: usize,
    one_hot: usize,
}

impl Design {
    /// The mapping for observations with this specification.
    pub fn new(features: BanditFeatures, spec: &ObservationSpec) -> Self {
        Design { features, letters: spec.features.len(), one_hot: spec.one_hot }
    }

    /// Number of features of a state.
    pub fn width(&self) -> usize {
        let pairs = match self.features {
            BanditFeatures::Linear => 0,
            BanditFeatures::Interactions => self.letters * (self.letters.max(1) - 1) / 2,
        };
        1 + self.letters + self.one_hot + pairs
    }

    /// Replaces `out` by the features of a row: 1, the observation with its one-hot expanded, and
    /// with interactions the products of pairs of features.
    pub fn fill(&self, observations: &Observations, row: usize, out: &mut Vec<f64>) {
        let letters = observations.row(row);
        out.clear();
        out.push(1.0);
        out.extend(letters.iter().copied().map(f64::from));
        out.resize(1 + self.letters + self.one_hot, 0.0);
        if let Some(moment) = observations.moment(row) {
            out[1 + self.letters + moment as usize] = 1.0;
        }
        match self.features {
            BanditFeatures::Linear => {}
            BanditFeatures::Interactions => {
                for (place, one) in letters.iter().enumerate() {
                    let others = letters[place + 1..].iter();
                    out.extend(others.map(|other| f64::from(*one) * f64::from(*other)));
                }
            }
        }
    }
}
