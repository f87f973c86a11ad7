//! What a scenario reveals about the context.

use crate::env::step_count::context::{ContextDraw, errors_by_context};
use crate::env::{Feature, Scenario, StepCount};

/// The most precise information about the context among the letters of a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Belief {
    /// `C`: the context itself.
    Certain,
    /// `P` or `F`: its inferred probability.
    Inferred {
        /// Feature noise, above 0.
        sigma: f64,
    },
    /// `L`: the most likely context, which is sometimes wrong.
    Likely {
        /// The probability that it is wrong, where it is context 0 and where it is context 1.
        errors: [f64; 2],
    },
    /// None of these letters: only the probability of context 0 over all steps.
    Ignorant {
        /// The probability of context 0.
        zero: f64,
    },
}

impl Belief {
    /// The belief that a policy can hold in an environment from what the scenario shows.
    pub fn new(environment: &StepCount, scenario: &Scenario) -> Belief {
        let shows = |feature| scenario.features().contains(&feature);
        let probability = shows(Feature::Probability) || shows(Feature::Filtered);
        let likely = shows(Feature::Likely);
        let certain = errors_by_context(environment) == [0.0; 2];
        let zero = 1.0 - environment.context_probability;
        if shows(Feature::Context) || ((probability || likely) && certain) {
            Belief::Certain
        } else if probability {
            Belief::Inferred { sigma: environment.sigma }
        } else if likely {
            Belief::Likely { errors: errors_by_likely(environment) }
        } else {
            Belief::Ignorant { zero }
        }
    }

    /// The probability of context 0 given what the scenario shows of the draw.
    pub fn probability_of_zero(self, draw: &ContextDraw) -> f64 {
        match self {
            Belief::Certain => f64::from(1 - draw.context),
            Belief::Inferred { .. } => draw.probability_of_zero,
            Belief::Likely { errors: [error, _] } if draw.likely == 0 => 1.0 - error,
            Belief::Likely { errors: [_, error] } => error,
            Belief::Ignorant { zero } => zero,
        }
    }
}

/// The probability that the most likely context is wrong, where it is context 0 and where it is context 1.
/// For a context that is never the most likely one, this is the prior probability of the other context.
fn errors_by_likely(environment: &StepCount) -> [f64; 2] {
    let one = environment.context_probability;
    let [false_one, false_zero] = errors_by_context(environment);
    if one == 0.5 {
        return [false_zero, false_one];
    }
    let share = |wrong: f64, right: f64, unseen: f64| {
        if wrong + right > 0.0 { wrong / (wrong + right) } else { unseen }
    };
    [
        share(one * false_zero, (1.0 - one) * (1.0 - false_one), one),
        share((1.0 - one) * false_one, one * (1.0 - false_zero), 1.0 - one),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_telling_letter_counts() {
        let belief = |sigma: f64, scenario: &str| {
            let belief = Belief::new(&StepCount::paper(sigma), &scenario.parse().unwrap());
            belief.probability_of_zero(&ContextDraw::new(1, 0.7))
        };
        assert_eq!(belief(1.0, "L-P-C"), 0.0);
        assert_eq!(belief(1.0, "L-P-T"), 0.7);
        assert_eq!(belief(1.0, "H-D"), 0.5);
        // Phi(1 / 2), from a table of the normal distribution.
        assert!((belief(1.0, "L-H-D") - 0.691_462_461_274_013).abs() < 1e-14);
        assert_eq!([belief(0.0, "P"), belief(0.0, "L")], [0.0, 0.0]);
        assert_eq!([belief(1.0, "F-E-R"), belief(0.0, "F")], [0.7, 0.0]);
    }
}
