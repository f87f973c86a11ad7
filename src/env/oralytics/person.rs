//! One person: the model of a brushing, given the features of the moment and the action.

use crate::env::oralytics::feature::Weights;
use crate::env::oralytics::parameters::{Rounding, TestBed};
use crate::env::variates::{Expansion, poisson};
use crate::kernel::math;

/// The parameters of a person.
#[derive(Clone, Debug, PartialEq)]
pub struct Person {
    /// Standard deviation of the root of the seconds; `None` if the seconds are a Poisson variate.
    pub(super) sigma: Option<f64>,
    /// Probability of opening the app on a day.
    pub(super) opens_app: f64,
    /// Weights of the probability of not brushing, on the logit scale.
    pub(super) bernoulli: Weights,
    /// Weights of the seconds: of the logarithm of their mean, or of the mean of their root.
    pub(super) amount: Weights,
    /// Weights of the effects of a prompt on both.
    pub(super) bernoulli_effect: Weights,
    pub(super) amount_effect: Weights,
}

/// The most seconds of a brushing that count.
pub(super) const MOST_SECONDS: f64 = 180.0;

impl Person {
    /// The seconds of a brushing.
    pub(super) fn brushes(
        &self,
        features: &Weights,
        is_prompted: bool,
        responsiveness: f64,
        (test_bed, rounding): (TestBed, Rounding),
        words: &mut Expansion,
    ) -> f64 {
        let mut logit = dot(&self.bernoulli, features);
        let mut amount = dot(&self.amount, features);
        if is_prompted {
            let on_brushing = responsiveness * dot(&self.bernoulli_effect, features);
            logit += match test_bed {
                TestBed::V2 => -on_brushing.max(0.0),
                TestBed::V3 | TestBed::V4 => on_brushing.min(0.0),
            };
            amount += (responsiveness * dot(&self.amount_effect, features)).max(0.0);
        }
        // The probability of brushing is 1 - sigmoid(logit).
        let brushes = words.open_unit() < 1.0 / (1.0 + math::exp(logit.clamp(-700.0, 700.0)));
        if !brushes {
            return 0.0;
        }
        let seconds = match self.sigma {
            None => poisson(math::exp(amount.clamp(-700.0, MOST_LOG)), words),
            Some(sigma) => {
                let root = amount + sigma * words.normal();
                match rounding {
                    Rounding::Nearest => (root * root).round(),
                    Rounding::Down => (root * root).floor(),
                }
            }
        };
        seconds.min(MOST_SECONDS)
    }
}

/// The largest logarithm of a mean: far above the most seconds that count.
const MOST_LOG: f64 = 10.0;

fn dot(one: &Weights, other: &Weights) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}
