//! The context process and its inference.

use std::hint::select_unpredictable;

use pulp::{Simd, WithSimd};

use crate::env::parameters::Environment;
use crate::kernel::{Isa, math};
use crate::rng::{Stream, unit_from_bits};

/// The context of a step with its inference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContextDraw {
    /// True context c, 0 or 1.
    pub context: u8,
    /// Inferred probability of context 0, in [0, 1].
    pub probability_of_zero: f64,
    /// Most likely context l, 0 or 1; 0 where both are equally likely.
    pub likely: u8,
}

impl ContextDraw {
    /// The first step of the authors' simulator: context 0, both contexts equally likely.
    pub const FIXED_FIRST: ContextDraw =
        ContextDraw { context: 0, probability_of_zero: 0.5, likely: 0 };

    /// A context with the inference that a probability of context 0 makes.
    pub fn new(context: u8, probability_of_zero: f64) -> Self {
        ContextDraw { context, probability_of_zero, likely: u8::from(probability_of_zero < 0.5) }
    }

    /// Draws c ~ Bernoulli(0.5) and x ~ N(c, sigma^2); infers P(C = 0 | x). Takes one word of the
    /// stream.
    pub fn draw(sigma: f64, stream: &mut Stream) -> Self {
        let bits = stream.bits();
        let deviate = deviate(squared_radius(bits), bits);
        ContextDraw::new(context(bits), probability_of_zero(context(bits), deviate, sigma, 1.0))
    }
}

/// The context that 64 random bits make: bit 0.
#[inline(always)]
fn context(bits: u64) -> u8 {
    (bits & 1) as u8
}

/// Minus twice the logarithm of the uniform number that bits 1 to 31 make; see [`deviate`].
#[inline(always)]
pub(super) fn squared_radius(bits: u64) -> f64 {
    // Halfway between multiples of 2^-31: never 0, which the logarithm could not take.
    let uniform = (f64::from((bits >> 1) as i32 & i32::MAX) + 0.5) * (1.0 / 2_147_483_648.0);
    -2.0 * math::ln(uniform)
}

/// The standard normal deviate, at most 6.7 in size, that 64 random bits make by the method of Box
/// and Muller (1958): the angle comes from bits 32 to 63.
#[inline(always)]
pub(super) fn deviate(squared_radius: f64, bits: u64) -> f64 {
    // In [-1/2, 1/2).
    let turns = f64::from((bits >> 32) as i32) * (1.0 / 4_294_967_296.0);
    math::root(squared_radius) * math::cos_turns(turns)
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

/// How contexts follow each other: a Markov chain of two states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ContextChain {
    /// Probability of context 1 over all steps.
    probability: f64,
    /// Probability that a context is kept instead of drawn anew.
    persistence: f64,
}

impl ContextChain {
    /// The chain of an environment; `None` where both contexts are equally likely in every step.
    pub(super) fn of(environment: &Environment) -> Option<Self> {
        let chain = ContextChain {
            probability: environment.context_probability,
            persistence: environment.context_persistence,
        };
        (!environment.has_independent_fair_contexts()).then_some(chain)
    }

    /// A word of the stream that makes the context after `before`, or the first one, according to a
    /// word of [`Companion::Context`](crate::rng::Companion::Context). The feature's bits stay.
    pub(super) fn word(self, word: u64, companion: u64, before: Option<u8>) -> u64 {
        let anew = (1.0 - self.persistence) * self.probability;
        let probability = match before {
            None => self.probability,
            Some(context) => self.persistence.mul_add(f64::from(context), anew),
        };
        (word & !1) | u64::from(unit_from_bits(companion) < probability)
    }
}

/// Prior odds of context 1: those of its probability over all steps. 1 where both are equally likely.
pub(super) fn prior_odds(environment: &Environment) -> f64 {
    environment.context_probability / (1.0 - environment.context_probability)
}

/// Draws of many contexts at once, each as [`ContextDraw::draw`] makes it.
///
/// **Shapes**: every array is as long as `words`, the words of the stream.
pub(super) struct Draws<'a> {
    /// Where draws are written; other entries stay as they are.
    pub(super) drawn: &'a [bool],
    pub(super) sigma: f64,
    /// Prior odds of context 1.
    pub(super) odds: f64,
    pub(super) words: &'a [u64],
    pub(super) contexts: &'a mut [u8],
    pub(super) probabilities: &'a mut [f64],
    pub(super) likely: &'a mut [u8],
}

impl WithSimd for Draws<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Short loops: a long chain of operations does not pipeline, and a loop over many arrays is not
        // vectorised.
        let mut numbers = [0.0; BLOCK];
        let shown = self.contexts.chunks_mut(BLOCK).zip(self.likely.chunks_mut(BLOCK));
        let masked = self.words.chunks(BLOCK).zip(self.drawn.chunks(BLOCK));
        let draws = masked.zip(self.probabilities.chunks_mut(BLOCK));
        for (((words, drawn), probabilities), (contexts, likely)) in draws.zip(shown) {
            for (number, word) in numbers.iter_mut().zip(words) {
                *number = squared_radius(*word);
            }
            for (number, word) in numbers.iter_mut().zip(words) {
                *number = deviate(*number, *word);
            }
            for (number, word) in numbers.iter_mut().zip(words) {
                *number = probability_of_zero(context(*word), *number, self.sigma, self.odds);
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

/// Draws per round of the loops of [`Draws`].
const BLOCK: usize = 64;

/// Context draws of the words that come next in a stream, both contexts equally likely, for callers that
/// take one at a time:
/// computing two registers of draws takes hardly longer than computing one draw.
#[derive(Clone, Debug)]
pub struct ContextDrawsAhead {
    sigma: f64,
    words: [u64; AHEAD],
    contexts: [u8; AHEAD],
    probabilities: [f64; AHEAD],
    likely: [u8; AHEAD],
    /// Draws of these that have been taken.
    taken: usize,
}

/// Draws computed at a time.
const AHEAD: usize = 16;

impl ContextDrawsAhead {
    /// Nothing computed ahead yet.
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

    /// The next draw of the stream, as [`ContextDraw::draw`] makes it. Draws computed ahead are
    /// recognised by their words, so that every call may pass another stream.
    #[inline]
    pub fn take(&mut self, isa: Isa, stream: &mut Stream) -> ContextDraw {
        let word = stream.bits();
        if self.words.get(self.taken) != Some(&word) {
            self.words[0] = word;
            stream.peek(&mut self.words[1..]);
            isa.run(Draws {
                drawn: &[true; AHEAD],
                sigma: self.sigma,
                odds: 1.0,
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

/// The exact rate at which the most likely context is wrong where both are equally likely:
/// Phi(-1 / (2 sigma)).
pub fn inference_error(sigma: f64) -> f64 {
    if sigma == 0.0 {
        return 0.0;
    }
    // Phi(-z) = erfc(z / sqrt 2) / 2.
    0.5 * libm::erfc(std::f64::consts::FRAC_1_SQRT_2 / (2.0 * sigma))
}

/// The exact rates at which context 1 is the most likely one in context 0, and context 0 in context 1.
///
/// With prior odds o of context 1, it is the most likely one for features above 1/2 - sigma^2 ln o.
pub(super) fn errors_by_context(environment: &Environment) -> [f64; 2] {
    let sigma = environment.sigma;
    if environment.context_probability == 0.5 || sigma == 0.0 {
        return [inference_error(sigma); 2];
    }
    let cut = 0.5 - sigma * sigma * libm::log(prior_odds(environment));
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
            // Long and short turns, some words of the stream taken by others.
            let stream = &mut streams[turn % 2];
            for taken in 0..(turn * 7) % 40 {
                let expected = ContextDraw::draw(0.7, &mut stream.clone());
                let first = ahead.taken == AHEAD;
                assert_eq!(ahead.take(Isa::chosen(), stream), expected);
                // What was made ahead is used, but for the first of a turn.
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
    fn contexts_are_fair_and_features_have_their_moments() {
        let mut stream = Stream::new(5, Purpose::Environment);
        let sigma = 0.8;
        let n = 200_000;
        let (mut ones, mut sum, mut squares) = (0, 0.0, 0.0);
        for _ in 0..n {
            let draw = ContextDraw::draw(sigma, &mut stream);
            let p = draw.probability_of_zero;
            // The feature, got back from the probability.
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
