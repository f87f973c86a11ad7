//! The features of a state, on which the reward is regressed.

use crate::env::{ObservationSpec, Observations};
use crate::key::choices;

choices! {
    /// The regressors of the reward.
    pub enum BanditFeatures {
        /// An intercept, the features, and the one-hot of time if observations have one.
        Linear = "linear",
        /// Also the products of pairs of different features.
        Interactions = "interactions",
    }
}

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
        Design::of(features, spec.features.len(), spec.one_hot)
    }

    /// The number of regressions of an agent with this number of actions, and the number of regressors of each.
    ///
    /// With action centring, the regressors are blocks of features: one for the baseline, one for the probability of
    /// each action but action 0, and one for its centred indicator, whose coefficients are the effects.
    pub fn regressors(width: usize, actions: usize, is_centred: bool) -> (usize, usize) {
        if is_centred { (1, (2 * actions - 1) * width) } else { (actions, width) }
    }

    /// The mapping for observations of this number of letters, and a one-hot of this length.
    pub fn of(features: BanditFeatures, letters: usize, one_hot: usize) -> Self {
        Design { features, letters, one_hot }
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
        let letters = observations.row(row).iter().copied().map(f64::from);
        self.fill_from(letters, observations.moment(row), out);
    }

    /// Replaces `out` as [`Design::fill`] does, from the features of an observation in full precision.
    pub fn fill_exact(&self, letters: &[f64], moment: Option<u32>, out: &mut Vec<f64>) {
        self.fill_from(letters.iter().copied(), moment, out);
    }

    fn fill_from(
        &self,
        letters: impl Iterator<Item = f64>,
        moment: Option<u32>,
        out: &mut Vec<f64>,
    ) {
        out.clear();
        out.push(1.0);
        out.extend(letters);
        out.resize(1 + self.letters + self.one_hot, 0.0);
        if let Some(moment) = moment {
            out[1 + self.letters + moment as usize] = 1.0;
        }
        match self.features {
            BanditFeatures::Linear => {}
            BanditFeatures::Interactions => {
                for index in 1..=self.letters {
                    for other in index + 1..=self.letters {
                        out.push(out[index] * out[other]);
                    }
                }
            }
        }
    }
}
