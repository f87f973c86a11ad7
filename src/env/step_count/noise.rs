//! The noise of a step: of its parameters, of the resulting state, and of the steps walked.

use crate::env::companion_words::CompanionWords;
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::parameters::{StateNoise, StepCount, StepNoise};
use crate::env::variates::{Expansion, beta, first_beta, gamma};
use crate::env::vector::{LaneSet, LaneStreams};
use crate::rng::{Companion, unit_from_bits};

/// The official code's lower bound for parameters of beta distributions and for mean steps.
pub(super) const FLOOR: f64 = 1e-5;

/// A source of noise for all lanes.
pub(super) trait Noise {
    /// The parameters of a lane's step.
    fn dynamics(&self, lane: usize, dynamics: &Dynamics) -> Dynamics;

    /// Habituation and disengagement risk after a lane's step, given their noise-free values; results may lie
    /// outside [0, 1].
    fn state(&self, lane: usize, dynamics: &Dynamics, expected: [f64; 2]) -> [f64; 2];

    /// The steps walked in a lane, given their noise-free number.
    fn steps(&self, lane: usize, dynamics: &Dynamics, expected: f64) -> f64;
}

/// No noise, whatever the environment says.
pub(super) struct Silence;

impl Noise for Silence {
    #[inline(always)]
    fn dynamics(&self, _: usize, dynamics: &Dynamics) -> Dynamics {
        *dynamics
    }

    #[inline(always)]
    fn state(&self, _: usize, _: &Dynamics, expected: [f64; 2]) -> [f64; 2] {
        expected
    }

    #[inline(always)]
    fn steps(&self, _: usize, _: &Dynamics, expected: f64) -> f64 {
        expected
    }
}

/// The recorded outcome of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForcedNoise {
    /// Habituation and disengagement risk after the step, both in [0, 1]; `None` for the noise-free values.
    pub state: Option<[f64; 2]>,
    /// The steps walked; `None` for the noise-free number.
    pub steps: Option<f64>,
}

impl Noise for ForcedNoise {
    fn dynamics(&self, _: usize, dynamics: &Dynamics) -> Dynamics {
        *dynamics
    }

    fn state(&self, _: usize, _: &Dynamics, expected: [f64; 2]) -> [f64; 2] {
        self.state.unwrap_or(expected)
    }

    fn steps(&self, _: usize, _: &Dynamics, expected: f64) -> f64 {
        self.steps.unwrap_or(expected)
    }
}

/// Noise from the words of streams. Noise that is not drawn has no words.
#[derive(Clone, Debug)]
pub(super) struct DrawnNoise {
    state_noise: StateNoise,
    parameters: CompanionWords,
    state: CompanionWords,
    steps: CompanionWords,
}

impl DrawnNoise {
    /// The noise of an environment with `lanes` lanes, before the first draw.
    pub(super) fn new(environment: &StepCount, lanes: usize) -> Self {
        let words = |is_drawn: bool, companion: Companion| {
            CompanionWords::new(companion, if is_drawn { lanes } else { 0 })
        };
        let StepCount { state_noise, step_noise, parameter_spread, .. } = *environment;
        DrawnNoise {
            state_noise,
            parameters: words(parameter_spread > 0.0, Companion::ParameterNoise),
            state: words(state_noise != StateNoise::None, Companion::StateNoise),
            steps: words(step_noise != StepNoise::None, Companion::StepNoise),
        }
    }

    /// The noise of the state and of its parameters alone, for `count` particles instead of lanes.
    pub(super) fn of_state(environment: &StepCount, count: usize) -> Self {
        let without_steps = StepCount { step_noise: StepNoise::None, ..environment.clone() };
        DrawnNoise::new(&without_steps, count)
    }

    /// Draws the words of the next step from other words.
    #[inline(always)]
    pub(super) fn expand(&mut self, words: &mut Expansion) {
        for drawn in [&mut self.parameters, &mut self.state] {
            for word in drawn.words_mut() {
                *word = words.bits();
            }
        }
    }

    /// Calls `step` with the parameters of every lane's step and the lane's item.
    #[inline(always)]
    pub(super) fn for_each<T>(
        &self,
        dynamics: &Dynamics,
        items: impl Iterator<Item = T>,
        step: impl Fn(&Dynamics, T),
    ) {
        if self.parameters.words().is_empty() {
            for item in items {
                step(dynamics, item);
            }
        } else {
            for (lane, item) in items.enumerate() {
                step(&self.dynamics(lane, dynamics), item);
            }
        }
    }

    /// Draws habituation in every lane, given its noise-free value.
    #[inline(always)]
    pub(super) fn habituations(&self, dynamics: &Dynamics, values: &mut [f64]) {
        self.states::<0>(dynamics.state_spread, dynamics.kappa_h, values);
    }

    /// Draws disengagement risk in every lane, given its noise-free value.
    #[inline(always)]
    pub(super) fn risks(&self, dynamics: &Dynamics, values: &mut [f64]) {
        self.states::<1>(dynamics.state_spread, dynamics.kappa_d, values);
    }

    /// Draws a part of the state in every lane, given its noise-free value, from the word at an index.
    #[inline(always)]
    fn states<const PLACE: usize>(&self, width: f64, concentration: f64, values: &mut [f64]) {
        let all_words = self.state.words().as_chunks::<2>().0;
        let all = values.iter_mut().zip(all_words);
        match self.state_noise {
            StateNoise::None => {}
            StateNoise::Uniform => {
                for (value, words) in all {
                    *value = around_up_to_one(*value, width, words[PLACE]);
                }
            }
            StateNoise::Beta => {
                // A value with another sign waits for a variate that needs more trials.
                for (value, words) in all {
                    let (drawn, is_drawn) = first_beta(shapes(*value, concentration), words[PLACE]);
                    *value = if is_drawn { drawn } else { -*value };
                }
                for (value, words) in values.iter_mut().zip(all_words) {
                    if value.is_sign_negative() {
                        *value = beta(shapes(-*value, concentration), words[PLACE]);
                    }
                }
            }
        }
    }

    /// The words of the state, \[lanes\].
    pub(super) fn state_words(&self) -> &[[u64; 2]] {
        self.state.words().as_chunks().0
    }

    /// Draws the words of the next step.
    pub(super) fn draw(&mut self, drawn: &[bool], streams: &LaneStreams) {
        for words in [&mut self.parameters, &mut self.state, &mut self.steps] {
            if !words.words().is_empty() {
                words.fill(streams, LaneSet::All, drawn);
            }
        }
    }
}

impl Noise for DrawnNoise {
    #[inline(always)]
    fn dynamics(&self, lane: usize, dynamics: &Dynamics) -> Dynamics {
        let Some([delta_h, epsilon_h, delta_d, epsilon_d]) =
            self.parameters.words().as_chunks().0.get(lane)
        else {
            return *dynamics;
        };
        let near = |value, word| around_up_to_one(value, dynamics.parameter_spread, word);
        let mut drawn = *dynamics;
        drawn.delta_h = near(dynamics.delta_h, *delta_h);
        drawn.epsilon_h = near(dynamics.epsilon_h, *epsilon_h);
        drawn.delta_d = near(dynamics.delta_d, *delta_d);
        drawn.epsilon_d = near(dynamics.epsilon_d, *epsilon_d);
        drawn
    }

    #[inline(always)]
    fn state(&self, lane: usize, dynamics: &Dynamics, expected: [f64; 2]) -> [f64; 2] {
        let words = || self.state.words().as_chunks::<2>().0[lane];
        match self.state_noise {
            StateNoise::None => expected,
            StateNoise::Uniform => uniform_state(dynamics.state_spread, expected, words()),
            StateNoise::Beta => {
                let [habituation, disengagement] = expected;
                let [h, d] = words();
                [
                    beta(shapes(habituation, dynamics.kappa_h), h),
                    beta(shapes(disengagement, dynamics.kappa_d), d),
                ]
            }
        }
    }

    #[inline(always)]
    fn steps(&self, lane: usize, dynamics: &Dynamics, expected: f64) -> f64 {
        let mean = if expected > FLOOR { expected } else { FLOOR };
        // No closure: it would be compiled without the instructions that the caller chose.
        match self.steps.words().get(lane) {
            Some(word) => gamma(mean, dynamics.sigma_s, *word),
            None => expected,
        }
    }
}

/// Habituation and disengagement risk drawn uniformly around their noise-free values; see [`Noise::state`].
#[inline(always)]
pub(super) fn uniform_state(width: f64, expected: [f64; 2], words: [u64; 2]) -> [f64; 2] {
    let ([habituation, disengagement], [h, d]) = (expected, words);
    [around(habituation, width, h), around(disengagement, width, d)]
}

/// A value drawn uniformly between (1 - width / 2) and (1 + width / 2) times `value`.
#[inline(always)]
fn around(value: f64, width: f64, word: u64) -> f64 {
    let (low, high) = ((1.0 - 0.5 * width) * value, (1.0 + 0.5 * width) * value);
    low + (high - low) * unit_from_bits(word)
}

/// The same, cut at 1.
#[inline(always)]
fn around_up_to_one(value: f64, width: f64, word: u64) -> f64 {
    let drawn = around(value, width, word);
    if drawn < 1.0 { drawn } else { 1.0 }
}

/// The parameters of a beta distribution with this mean and this sum of parameters; both are at least `FLOOR`.
#[inline(always)]
fn shapes(mean: f64, concentration: f64) -> [f64; 2] {
    let floored = |x: f64| if x > FLOOR { x } else { FLOOR };
    [floored(concentration * mean), floored(concentration * (1.0 - mean))]
}
