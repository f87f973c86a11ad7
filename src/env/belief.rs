//! What a scenario lets an agent know of the context.

use crate::env::{ContextDraw, inference_error};
use crate::env::{Environment, Feature, Scenario};

/// The most that the letters of a scenario tell of the context.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Belief {
    /// `C`: all of it.
    Certain,
    /// `P`: its inferred probability.
    Inferred {
        /// Feature noise, above 0.
        sigma: f64,
    },
    /// `L`: the most likely one, which is wrong now and then.
    Likely {
        /// How often: the context inference error, in (0, 0.5].
        error: f64,
    },
    /// None of the letters: both contexts are equally likely.
    Ignorant,
}

impl Belief {
    /// What a scenario tells in an environment.
    pub fn new(environment: &Environment, scenario: &Scenario) -> Belief {
        let shows = |feature| scenario.features().contains(&feature);
        let (probability, likely) = (shows(Feature::Probability), shows(Feature::Likely));
        let error = inference_error(environment.sigma);
        if shows(Feature::Context) || ((probability || likely) && error == 0.0) {
            Belief::Certain
        } else if probability {
            Belief::Inferred { sigma: environment.sigma }
        } else if likely {
            Belief::Likely { error }
        } else {
            Belief::Ignorant
        }
    }

    /// The probability of context 0 given what the scenario shows of the draw.
    pub fn probability_of_zero(self, draw: &ContextDraw) -> f64 {
        match self {
            Belief::Certain => f64::from(1 - draw.context),
            Belief::Inferred { .. } => draw.probability_of_zero,
            Belief::Likely { error } if draw.likely == 0 => 1.0 - error,
            Belief::Likely { error } => error,
            Belief::Ignorant => 0.5,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_telling_letter_counts() {
        let belief = |sigma: f64, scenario: &str| {
            let belief = Belief::new(&Environment::paper(sigma), &scenario.parse().unwrap());
            belief.probability_of_zero(&ContextDraw::new(1, 0.7))
        };
        assert_eq!(belief(1.0, "L-P-C"), 0.0);
        assert_eq!(belief(1.0, "L-P-T"), 0.7);
        assert_eq!(belief(1.0, "H-D"), 0.5);
        // Phi(1 / 2) from a table of the normal distribution.
        assert!((belief(1.0, "L-H-D") - 0.691_462_461_274_013).abs() < 1e-14);
        assert_eq!([belief(0.0, "P"), belief(0.0, "L")], [0.0, 0.0]);
    }
}
