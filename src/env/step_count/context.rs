//! The context process and its inference.

use std::hint::select_unpredictable;

use pulp::{Simd, WithSimd};

use crate::env::step_count::parameters::StepCount;
use crate::env::variates::{deviate, squared_radius};
use crate::kernel::{Isa, math};
use crate::rng::{Stream, unit_from_bits};

/// The context of a step and what is inferred about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContextDraw {
    /// True context c, 0 or 1.
    pub context: u8,
    /// Inferred probability of context 0, in [0, 1].
    pub probability_of_zero: f64,
    /// Most likely context l, 0 or 1; 0 if both are equally likely.
    pub likely: u8,
}

impl ContextDraw {
    /// The first step of the authors' simulator: context 0, both contexts equally likely.
    pub const FIXED_FIRST: ContextDraw =
        ContextDraw { context: 0, probability_of_zero: 0.5, likely: 0 };

    /// A context, with the inference for a probability of context 0.
    pub fn new(context: u8, probability_of_zero: f64) -> Self {
        ContextDraw { context, probability_of_zero, likely: u8::from(probability_of_zero < 0.5) }
    }

    /// Draws c ~ Bernoulli(0.5) and x ~ N(c, sigma^2) and infers P(C = 0 | x). Consumes one word of the
    /// stream.
    pub fn draw(sigma: f64, stream: &mut Stream) -> Self {
        let bits = stream.bits();
        let deviate = deviate(squared_radius(bits), bits);
        ContextDraw::new(context(bits), probability_of_zero(context(bits), deviate, sigma, 1.0))
    }
}

/// The context for 64 random bits: bit 0.
#[inline(always)]
fn context(bits: u64) -> u8 {
    (bits & 1) as u8
}

/// P(C = 0 | x) for the feature x = context + sigma * deviate.
///
/// With prior odds o of context 1, p_0 = 1 / (1 + o N(x; 1, s^2) / N(x; 0, s^2))
/// = 1 / (1 + o exp((2x - 1) / 2s^2)). `sigma = 0` is exact: 1 in context 0 and 0 in context 1.
#[inline(always)]
pub fn probability_of_zero(context: u8, deviate: f64, sigma: f64, odds: f64) -> f64 {
    if sigma == 0.0 {
        return f64::from(1 - context);
    }
    let feature = f64::from(context) + sigma * deviate;
    let steepness = 1.0 / (2.0 * sigma * sigma);
    1.0 / (1.0 + odds * math::exp((2.0 * feature - 1.0) * steepness))
}

/// The parameters of context inference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Inference {
    pub(super) sigma: f64,
    /// Prior odds of context 1.
    pub(super) odds: f64,
}

impl Inference {
    /// The parameters for an environment.
    pub(super) fn of(environment: &StepCount) -> Self {
        Inference { sigma: environment.sigma, odds: prior_odds(environment) }
    }
}

/// The parameters of context inference in every lane.
pub(super) trait LaneInference {
    /// The parameters in a lane.
    fn of(&self, lane: usize) -> Inference;
}

/// The same parameters in all lanes.
impl LaneInference for Inference {
    #[inline(always)]
    fn of(&self, _: usize) -> Inference {
        *self
    }
}

/// The context process: a Markov chain with two states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ContextChain {
    /// Probability of context 1 over all steps.
    probability: f64,
    /// Probability that a context is kept instead of redrawn.
    persistence: f64,
}

impl ContextChain {
    /// The chain for an environment.
    pub(super) fn of(environment: &StepCount) -> Self {
        ContextChain {
            probability: environment.context_probability,
            persistence: environment.context_persistence,
        }
    }

    /// A copy of the stream's `word` whose bit 0 is the context after `before`, or the first context. A word
    /// of [`Companion::Context`](crate::rng::Companion::Context) decides the context; the bits of the feature
    /// stay the same.
    pub(super) fn word(self, word: u64, companion: u64, before: Option<u8>) -> u64 {
        let anew = (1.0 - self.persistence) * self.probability;
        let probability = match before {
            None => self.probability,
            Some(context) => self.persistence.mul_add(f64::from(context), anew),
        };
        (word & !1) | u64::from(unit_from_bits(companion) < probability)
    }
}

/// Prior odds of context 1: the odds of its probability over all steps, 1 if both contexts are equally
/// likely.
fn prior_odds(environment: &StepCount) -> f64 {
    environment.context_probability / (1.0 - environment.context_probability)
}

/// Draws of many contexts at once, each equal to [`ContextDraw::draw`].
///
/// **Shapes**: every array has the length of `words`, the words of the stream.
pub(super) struct ContextDraws<'a, I> {
    /// The lanes to write draws to; other entries stay as they are.
    pub(super) drawn: &'a [bool],
    pub(super) inference: I,
    pub(super) words: &'a [u64],
    pub(super) contexts: &'a mut [u8],
    pub(super) probabilities: &'a mut [f64],
    pub(super) likely: &'a mut [u8],
}

impl<I: LaneInference> WithSimd for ContextDraws<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Several short loops: a long chain of operations does not pipeline, and a loop over many arrays is
        // not vectorised.
        let mut numbers = [0.0; BLOCK];
        let shown = self.contexts.chunks_mut(BLOCK).zip(self.likely.chunks_mut(BLOCK));
        let masked = self.words.chunks(BLOCK).zip(self.drawn.chunks(BLOCK));
        let draws = masked.zip(self.probabilities.chunks_mut(BLOCK));
        for (block, (((words, drawn), probabilities), (contexts, likely))) in
            draws.zip(shown).enumerate()
        {
            for (number, word) in numbers.iter_mut().zip(words) {
                *number = squared_radius(*word);
            }
            for (number, word) in numbers.iter_mut().zip(words) {
                *number = deviate(*number, *word);
            }
            for (lane, (number, word)) in (block * BLOCK..).zip(numbers.iter_mut().zip(words)) {
                let Inference { sigma, odds } = self.inference.of(lane);
                *number = probability_of_zero(context(*word), *number, sigma, odds);
            }
            for ((shown, word), drawn) in contexts.iter_mut().zip(words).zip(drawn) {
                *shown = select_unpredictable(*drawn, context(*word), *shown);
            }
            for ((shown, number), drawn) in likely.iter_mut().zip(&numbers).zip(drawn) {
                *shown = select_unpredictable(*drawn, u8::from(*number < 0.5), *shown);
            }
            for ((shown, number), drawn) in probabilities.iter_mut().zip(&numbers).zip(drawn) {
                *shown = select_unpredictable(*drawn, *number, *shown);
            }
        }
    }
}

/// Draws per iteration of the outer loop of [`ContextDraws`].
const BLOCK: usize = 64;

/// Context draws for the next words of a stream, with both contexts equally likely, for callers that take one
/// draw at a time. Computing two registers of draws takes hardly longer than computing one draw.
#[derive(Clone, Debug)]
pub struct ContextDrawsAhead {
    sigma: f64,
    words: [u64; AHEAD],
    contexts: [u8; AHEAD],
    probabilities: [f64; AHEAD],
    likely: [u8; AHEAD],
    /// The number of these draws that have been taken.
    taken: usize,
}

/// The number of draws that are computed ahead.
const AHEAD: usize = 16;

impl ContextDrawsAhead {
    /// Starts with nothing computed ahead.
    pub fn new(sigma: f64) -> Self {
        ContextDrawsAhead {
            sigma,
            words: [0; AHEAD],
            contexts: [0; AHEAD],
            probabilities: [0.0; AHEAD],
            likely: [0; AHEAD],
            taken: AHEAD,
        }
    }

    /// The next draw of the stream, equal to [`ContextDraw::draw`]. Draws computed ahead are matched by their
    /// words, so each call may pass another stream.
    #[inline]
    pub fn take(&mut self, isa: Isa, stream: &mut Stream) -> ContextDraw {
        let word = stream.bits();
        if self.words.get(self.taken) != Some(&word) {
            self.words[0] = word;
            stream.peek(&mut self.words[1..]);
            isa.run(ContextDraws {
                drawn: &[true; AHEAD],
                inference: Inference { sigma: self.sigma, odds: 1.0 },
                words: &self.words,
                contexts: &mut self.contexts,
                probabilities: &mut self.probabilities,
                likely: &mut self.likely,
            });
            self.taken = 0;
        }
        let at = self.taken;
        self.taken += 1;
        ContextDraw {
            context: self.contexts[at],
            probability_of_zero: self.probabilities[at],
            likely: self.likely[at],
        }
    }
}

/// The exact error rate of the most likely context if both contexts are equally likely: Phi(-1 / (2 sigma)).
pub fn inference_error(sigma: f64) -> f64 {
    if sigma == 0.0 {
        return 0.0;
    }
    // Phi(-z) = erfc(z / sqrt 2) / 2.
    0.5 * libm::erfc(std::f64::consts::FRAC_1_SQRT_2 / (2.0 * sigma))
}

/// The exact error rate of the most likely context, given the probability of context 1.
pub fn context_error(sigma: f64, context_probability: f64) -> f64 {
    let [in_zero, in_one] = errors(sigma, context_probability);
    // If the rates are equal, returns one of them, because a weighted mean could round differently.
    if in_zero == in_one {
        return in_zero;
    }
    (1.0 - context_probability) * in_zero + context_probability * in_one
}

/// The exact error rates of the most likely context by true context: of inferring 1 in context 0, and of
/// inferring 0 in context 1.
pub(super) fn errors_by_context(environment: &StepCount) -> [f64; 2] {
    errors(environment.sigma, environment.context_probability)
}

/// The error rates by true context. With prior odds o of context 1, context 1 is the most likely one for
/// features above 1/2 - sigma^2 ln o.
fn errors(sigma: f64, context_probability: f64) -> [f64; 2] {
    if context_probability == 0.5 || sigma == 0.0 {
        return [inference_error(sigma); 2];
    }
    let odds = context_probability / (1.0 - context_probability);
    let cut = 0.5 - sigma * sigma * libm::log(odds);
    // Phi(-z) = erfc(z / sqrt 2) / 2.
    let above = |z: f64| 0.5 * libm::erfc(std::f64::consts::FRAC_1_SQRT_2 * z);
    [above(cut / sigma), above((1.0 - cut) / sigma)]
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{Continuous, Normal};

    use super::*;
    use crate::rng::Purpose;

    #[test]
    fn probabilities_are_the_ratio_of_normal_densities() {
        for sigma in [0.4, 0.6, 1.0, 2.0] {
            for context in [0, 1] {
                for deviate in [-3.0, -0.7, 0.0, 0.2, 2.5] {
                    let x = f64::from(context) + sigma * deviate;
                    let density = |mean| Normal::new(mean, sigma).unwrap().pdf(x);
                    let expected = density(0.0) / (density(0.0) + density(1.0));
                    let ours = probability_of_zero(context, deviate, sigma, 1.0);
                    assert!((ours - expected).abs() < 1e-14, "{ours} {expected}");
                }
            }
        }
    }

    #[test]
    fn without_noise_the_probability_is_exact() {
        let mut stream = Stream::new(3, Purpose::Environment);
        for _ in 0..1000 {
            let draw = ContextDraw::draw(0.0, &mut stream);
            assert_eq!(draw.probability_of_zero, 1.0 - f64::from(draw.context));
            assert_eq!(draw.likely, draw.context);
        }
        assert_eq!(inference_error(0.0), 0.0);
    }

    #[test]
    fn draws_computed_ahead_are_those_of_the_stream_that_comes() {
        let mut ahead = ContextDrawsAhead::new(0.7);
        let mut streams = [1, 2].map(|seed| Stream::new(seed, Purpose::Environment));
        for turn in 0..200 {
            // Turns of different lengths, between which other callers consume words of the stream.
            let stream = &mut streams[turn % 2];
            for taken in 0..(turn * 7) % 40 {
                let expected = ContextDraw::draw(0.7, &mut stream.clone());
                let first = ahead.taken == AHEAD;
                assert_eq!(ahead.take(Isa::chosen(), stream), expected);
                // Draws computed ahead are used, except for the first draw of a turn.
                assert!(first || taken == 0 || ahead.taken > 1);
            }
            (0..turn % 3).for_each(|_| _ = stream.bits());
        }
    }

    #[test]
    fn the_empirical_error_rate_is_the_exact_one() {
        const DRAWS: u32 = 1_000_000;
        for sigma in [0.4, 0.6, 0.8, 1.0, 2.0] {
            let mut stream = Stream::new(11, Purpose::Environment);
            let wrong = (0..DRAWS)
                .map(|_| ContextDraw::draw(sigma, &mut stream))
                .filter(|draw| draw.likely != draw.context)
                .count();
            let exact = inference_error(sigma);
            let rate = wrong as f64 / f64::from(DRAWS);
            let standard_error = (exact * (1.0 - exact) / f64::from(DRAWS)).sqrt();
            assert!((rate - exact).abs() < 4.0 * standard_error, "{sigma}: {rate} {exact}");
        }
    }

    #[test]
    fn the_error_of_unequal_contexts_is_that_of_simulated_ones() {
        assert_eq!(context_error(0.6, 0.5), inference_error(0.6));
        assert_eq!((context_error(0.0, 0.2), context_error(0.6, 1.0)), (0.0, 0.0));
        const DRAWS: u32 = 400_000;
        for (sigma, probability) in [(0.6, 0.2), (1.0, 0.9), (0.4, 0.35)] {
            let odds = probability / (1.0 - probability);
            let mut stream = Stream::new(12, Purpose::Environment);
            let is_wrong = |_: &u32| {
                let context = u8::from(stream.unit() < probability);
                let bits = stream.bits();
                let deviate = deviate(squared_radius(bits), bits);
                let zero = probability_of_zero(context, deviate, sigma, odds);
                u8::from(zero < 0.5) != context
            };
            let rate = f64::from((0..DRAWS).filter(is_wrong).count() as u32) / f64::from(DRAWS);
            let exact = context_error(sigma, probability);
            let standard_error = (exact * (1.0 - exact) / f64::from(DRAWS)).sqrt();
            assert!((rate - exact).abs() < 4.0 * standard_error, "{sigma}: {rate} {exact}");
        }
    }

    #[test]
    fn contexts_are_fair_and_features_have_their_moments() {
        let mut stream = Stream::new(5, Purpose::Environment);
        let sigma = 0.8;
        let n = 200_000;
        let (mut ones, mut sum, mut squares) = (0, 0.0, 0.0);
        for _ in 0..n {
            let draw = ContextDraw::draw(sigma, &mut stream);
            let p = draw.probability_of_zero;
            // The feature, recovered from the probability.
            let x = sigma * sigma * ((1.0 - p) / p).ln() + 0.5;
            let noise = (x - f64::from(draw.context)) / sigma;
            ones += u32::from(draw.context);
            sum += noise;
            squares += noise * noise;
        }
        let n = f64::from(n);
        assert!((f64::from(ones) / n - 0.5).abs() < 4.0 * (0.25 / n).sqrt());
        assert!((sum / n).abs() < 4.0 / n.sqrt());
        assert!((squares / n - 1.0).abs() < 4.0 * (2.0 / n).sqrt());
    }
}
