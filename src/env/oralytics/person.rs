//! One person: the model of a brushing, given the features of the moment and the action.

use crate::env::oralytics::feature::{Feature, Weights};
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
    #[inline(always)]
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

/// Mean and variance of the features of effects in V3 and V4, over the moments for which an effect without a state is
/// made to resemble the original: every combination of 0 and 1, and of -0.75, 0 and 0.75.
const MOMENTS: [(Feature, f64, f64); 6] = [
    (Feature::TimeOfDay, 0.5, 0.25),
    (Feature::Brushing, 0.0, 0.375),
    (Feature::Dosage, 0.0, 0.375),
    (Feature::App, 0.5, 0.25),
    (Feature::Weekend, 0.5, 0.25),
    (Feature::Day, 0.0, 0.375),
];

impl Person {
    /// Removes the effects of a prompt at a state in V3 or V4: time of day, average of brushing, average of prompts, and
    /// whether the app was opened on the day before. The day is the middle of the study, and 2 of 7 days are weekend.
    ///
    /// The new weights are 0 there and, subject to this, closest to the old ones in mean square over [`MOMENTS`].
    ///
    /// **Source**: the environments of Figure 5 of arXiv 2409.02069.
    pub(super) fn remove_effect_at(
        &mut self,
        &[time, brushing, dosage, app]: &[f64; 4],
        has_day: bool,
    ) {
        let state = [time, brushing, dosage, app, 2.0 / 7.0, 0.0];
        // The day is the last.
        let moments = || MOMENTS.iter().zip(state).take(if has_day { 6 } else { 5 });
        let squares: f64 =
            moments().map(|((_, mean, variance), x)| (x - mean) * (x - mean) / variance).sum();
        let one = Feature::One as usize;
        for effect in [&mut self.bernoulli_effect, &mut self.amount_effect] {
            let at_state: f64 =
                moments().map(|((feature, ..), x)| effect[*feature as usize] * x).sum();
            // In terms of deviations from the means, the features are uncorrelated.
            let step = -(at_state + effect[one]) / (1.0 + squares);
            effect[one] += step;
            for ((feature, mean, variance), x) in moments() {
                let change = step * (x - mean) / variance;
                effect[*feature as usize] += change;
                effect[one] -= mean * change;
            }
        }
    }
}

/// The largest logarithm of a mean: far above the most seconds that count.
const MOST_LOG: f64 = 10.0;

#[inline(always)]
fn dot(one: &Weights, other: &Weights) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::oralytics::feature::FEATURES;

    /// A person with an intercept in each weight, for whom all features are 1.
    fn person(sigma: Option<f64>, bernoulli: f64, amount: f64, effects: [f64; 2]) -> Person {
        let one = |weight: f64| {
            let mut weights = [0.0; FEATURES];
            weights[FEATURES - 1] = weight;
            weights
        };
        Person {
            sigma,
            opens_app: 0.7,
            bernoulli: one(bernoulli),
            amount: one(amount),
            bernoulli_effect: one(effects[0]),
            amount_effect: one(effects[1]),
        }
    }

    const ONES: Weights = [1.0; FEATURES];
    const DRAWS: u64 = 40_000;

    /// The share of brushings, and the mean of the seconds of these.
    fn brushed(person: &Person, is_prompted: bool, k: f64, test_bed: TestBed) -> (f64, f64) {
        let how = (test_bed, Rounding::Nearest);
        let seconds = |word: u64| {
            let mut words = Expansion(word.wrapping_mul(0x9E37_79B9_7F4A_7C15));
            person.brushes(&ONES, is_prompted, k, how, &mut words)
        };
        let all: Vec<f64> = (1..=DRAWS).map(seconds).collect();
        let some = all.iter().filter(|seconds| **seconds > 0.0).count() as f64;
        (some / DRAWS as f64, all.iter().sum::<f64>() / some)
    }

    fn close(found: f64, expected: f64, error: f64) {
        assert!((found - expected).abs() < error, "{found}, expected {expected}");
    }

    fn sigmoid(x: f64) -> f64 {
        1.0 / (1.0 + (-x).exp())
    }

    #[test]
    fn a_prompt_raises_the_probability_of_brushing_and_the_seconds() {
        // Of an effect, only the part that helps counts.
        for (test_bed, effects, gains) in [
            (TestBed::V2, [0.8, 0.2], [0.8, 0.2]),
            (TestBed::V2, [-0.8, -0.2], [0.0, 0.0]),
            (TestBed::V3, [-0.8, 0.2], [0.8, 0.2]),
            (TestBed::V4, [0.8, -0.2], [0.0, 0.0]),
        ] {
            let person = person(None, 0.5, 4.0, effects);
            let (share, seconds) = brushed(&person, false, 1.0, test_bed);
            close(share, 1.0 - sigmoid(0.5), 0.01);
            close(seconds, 4_f64.exp(), 0.3);
            for k in [1.0, 0.5] {
                let (share, seconds) = brushed(&person, true, k, test_bed);
                close(share, 1.0 - sigmoid(0.5 - k * gains[0]), 0.01);
                close(seconds, (4.0 + k * gains[1]).exp(), 0.3);
            }
        }
    }

    #[test]
    fn an_effect_is_removed_at_a_state_and_changed_as_little_as_possible_elsewhere() {
        use nalgebra::{DMatrix, DVector};
        let weights = |seed: f64| {
            let mut weights = [0.0; FEATURES];
            let named = MOMENTS.iter().map(|(feature, ..)| *feature).chain([Feature::One]);
            for (index, feature) in named.enumerate() {
                weights[feature as usize] = seed * (index as f64 + 0.3).sin();
            }
            weights
        };
        let full = Person {
            bernoulli_effect: weights(-0.7),
            amount_effect: weights(0.4),
            ..person(None, 0.0, 4.0, [0.0; 2])
        };
        let state = [1.0, -0.7, -0.1, 0.0];
        let mut without = full.clone();
        without.remove_effect_at(&state, true);
        let moments = |weights: &Weights| {
            let named = MOMENTS.iter().map(|(feature, ..)| weights[*feature as usize]);
            DVector::from_iterator(7, named.chain([weights[Feature::One as usize]]))
        };
        // The least squares by the sum over every moment.
        let (two, three) = ([0.0, 1.0], [-0.75, 0.0, 0.75]);
        let values: [&[f64]; 6] = [&two, &three, &three, &two, &two, &three];
        let mut squares = DMatrix::zeros(7, 7);
        for index in 0..216 {
            let mut rest = index;
            let moment = values.iter().map(|values| {
                let value = values[rest % values.len()];
                rest /= values.len();
                value
            });
            let moment = DVector::from_iterator(7, moment.chain([1.0]));
            squares += &moment * moment.transpose() / 216.0;
        }
        let [time, brushing, dosage, app] = state;
        let x = DVector::from_row_slice(&[time, brushing, dosage, app, 2.0 / 7.0, 0.0, 1.0]);
        let solved = squares.lu().solve(&x).unwrap();
        for (before, after) in [
            (full.bernoulli_effect, without.bernoulli_effect),
            (full.amount_effect, without.amount_effect),
        ] {
            let (before, after) = (moments(&before), moments(&after));
            let expected = &before - &solved * (x.dot(&before) / x.dot(&solved));
            assert!((&after - &expected).amax() < 1e-12, "{after} {expected}");
            assert!(x.dot(&after).abs() < 1e-12 && x.dot(&before).abs() > 0.1);
        }
        // Without weights of the day, none appears.
        let mut stationary = full;
        stationary.bernoulli_effect[Feature::Day as usize] = 0.0;
        stationary.remove_effect_at(&state, false);
        assert_eq!(stationary.bernoulli_effect[Feature::Day as usize], 0.0);
        assert!(x.dot(&moments(&stationary.bernoulli_effect)).abs() < 1e-12);
    }

    #[test]
    fn seconds_are_squares_of_normal_variates_for_some_people() {
        let person = person(Some(0.5), -20.0, 9.0, [0.0, 0.0]);
        let (share, seconds) = brushed(&person, false, 1.0, TestBed::V2);
        assert_eq!(share, 1.0);
        close(seconds, 9.0 * 9.0 + 0.25, 0.3);
        let tall = Person { sigma: Some(0.0), ..person };
        let exactly = |amount: f64, rounding| {
            let mut weights = [0.0; FEATURES];
            weights[FEATURES - 1] = amount;
            let person = Person { amount: weights, ..tall.clone() };
            person.brushes(&ONES, false, 1.0, (TestBed::V2, rounding), &mut Expansion(1))
        };
        // 1.3² = 1.69.
        assert_eq!(exactly(1.3, Rounding::Nearest), 2.0);
        assert_eq!(exactly(1.3, Rounding::Down), 1.0);
        assert_eq!(exactly(14.0, Rounding::Nearest), MOST_SECONDS);
    }
}
