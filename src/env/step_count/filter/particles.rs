//! The belief about contexts, habituation and disengagement risk under noise: a particle filter.
//!
//! A particle has a habituation, a disengagement risk and the weights of both contexts. In a step, it draws habituation
//! and parameters, weighs the contexts by the steps walked, draws one of them, and draws the disengagement risk that
//! follows. The chain of contexts and the feature then weigh the next contexts without a draw. Particles are
//! resampled systematically where less than half of them count.
//!
//! **Source**: Gordon, Salmond and Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", 1993;
//! Doucet and Johansen, "A tutorial on particle filtering and smoothing", 2009, section 4.

use super::contexts::Feature;
use super::evidence::Evidence;
use super::moments::{Moments, Sums};
use super::steps::{expected, ln_density, relative};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::full_step::cut;
use crate::env::step_count::noise::{DrawnNoise, Noise};
use crate::env::step_count::parameters::{RewardHabituation, StepCount};
use crate::env::variates::Expansion;
use crate::rng::unit_from_bits;
use crate::state::resumable;

/// The number of particles.
pub(super) const PARTICLES: usize = 256;

/// Particles of a lane; every array is \[particles\].
#[derive(Clone, Debug)]
pub(super) struct Particles {
    habituation: Vec<f64>,
    risk: Vec<f64>,
    /// The weights of a particle with context 0 and with context 1; their sum over all is 1.
    zero: Vec<f64>,
    one: Vec<f64>,
}

/// Room for a step of one lane, and what is drawn for it.
#[derive(Clone, Debug)]
pub(super) struct Draws {
    /// The noise of particle i at place i.
    noise: DrawnNoise,
    /// \[particles\]: the words that choose the contexts.
    contexts: Vec<u64>,
    /// The word that resamples.
    resample: u64,
    /// \[particles\]: the likelihoods of both contexts by the steps walked.
    steps: Vec<[f64; 2]>,
    /// The particles after the step.
    next: Particles,
}

impl Draws {
    /// Room for `count` particles in an environment.
    pub(super) fn new(environment: &StepCount, count: usize) -> Draws {
        Draws {
            noise: DrawnNoise::of_state(environment, count),
            contexts: vec![0; count],
            resample: 0,
            steps: vec![[1.0; 2]; count],
            next: Particles::new(count),
        }
    }

    /// Draws all words of a step from one word.
    #[inline(always)]
    pub(super) fn expand(&mut self, word: u64) {
        let mut words = Expansion(word);
        self.resample = words.bits();
        self.contexts.iter_mut().for_each(|word| *word = words.bits());
        self.noise.expand(&mut words);
    }
}

impl Particles {
    /// `count` particles, before the first episode.
    pub(super) fn new(count: usize) -> Particles {
        let zeros = vec![0.0; count];
        Particles {
            habituation: zeros.clone(),
            risk: zeros.clone(),
            zero: zeros.clone(),
            one: zeros,
        }
    }

    /// Begins an episode at this habituation and risk, where context 0 has the probability `zero`.
    pub(super) fn begin(&mut self, habituation: f64, risk: f64, zero: f64) {
        let share = 1.0 / self.risk.len() as f64;
        self.habituation.fill(habituation);
        self.risk.fill(risk);
        self.zero.fill(zero * share);
        self.one.fill((1.0 - zero) * share);
    }

    /// Updates the particles after a step. Returns `None`, and leaves them as they are, if no particle agrees with the
    /// evidence.
    #[inline(always)]
    pub(super) fn update(
        &mut self,
        person: &StepCount,
        seen: &Feature,
        evidence: &Evidence,
        draws: &mut Draws,
    ) -> Option<Moments> {
        let dynamics = Dynamics::of(person);
        if let Some(steps) = evidence.steps {
            self.weigh(person, &dynamics, evidence, steps, draws);
        }
        let has_steps = evidence.steps.is_some();
        let Draws { noise, contexts, steps, next, .. } = draws;
        let mut sums: Option<Sums> = None;
        let mut squares = 0.0;
        for place in 0..self.risk.len() {
            let likelihoods = if has_steps { steps[place] } else { [1.0; 2] };
            let zero = self.zero[place] * likelihoods[0];
            let weight = zero + self.one[place] * likelihoods[1];
            let context = u8::from(unit_from_bits(contexts[place]) * weight >= zero);
            let (before, risk) = (self.habituation[place], self.risk[place]);
            let effect =
                noise.dynamics(place, &dynamics).apply(context, evidence.action, before, risk);
            let expected = [effect.habituation, effect.disengagement];
            let [habituation, risk] =
                noise.state(place, &dynamics, expected).map(|x| cut(x, 0.0, 1.0));
            let weight = if evidence.agrees(&dynamics, risk) { weight } else { 0.0 };
            let is_zero = f64::from(1 - context);
            let weights = seen.after([weight * is_zero, weight * (1.0 - is_zero)]);
            let sums = sums.get_or_insert_with(|| Sums::from(habituation, risk));
            sums.add(&dynamics, weights, habituation, risk);
            let weight = weights[0] + weights[1];
            squares += weight * weight;
            (next.habituation[place], next.risk[place]) = (habituation, risk);
            [next.zero[place], next.one[place]] = weights;
        }
        let sums = sums?;
        let moments = sums.moments()?;
        if 2.0 * sums.weight * sums.weight < squares * self.risk.len() as f64 {
            self.resample(next, sums.weight, unit_from_bits(draws.resample));
        } else {
            self.take(next, 1.0 / sums.weight);
        }
        Some(moments)
    }

    /// Writes the likelihoods of both contexts of every particle by the steps walked, up to a common factor.
    #[inline(always)]
    fn weigh(
        &self,
        person: &StepCount,
        dynamics: &Dynamics,
        evidence: &Evidence,
        steps: f64,
        draws: &mut Draws,
    ) {
        let Draws { noise, steps: likelihoods, .. } = draws;
        let mut most = f64::NEG_INFINITY;
        for (place, likelihood) in likelihoods.iter_mut().enumerate() {
            let drawn = noise.dynamics(place, dynamics);
            let before = self.habituation[place];
            let habituation = drawn.apply(0, evidence.action, before, 0.0).habituation;
            let habituation = match person.reward_habituation {
                RewardHabituation::Expected => habituation,
                RewardHabituation::Drawn => {
                    cut(noise.state(place, dynamics, [habituation, 0.0])[0], 0.0, 1.0)
                }
            };
            let [zero, one] = expected(person, dynamics, evidence.action, habituation);
            let first = ln_density(dynamics, zero, steps);
            let second = if one == zero { first } else { ln_density(dynamics, one, steps) };
            *likelihood = [first, second];
            let larger = if first > second { first } else { second };
            most = if larger > most { larger } else { most };
        }
        for likelihood in likelihoods {
            *likelihood = likelihood.map(|ln| relative(ln - most));
        }
    }

    /// Takes other particles, whose weights are multiplied by `scale`.
    #[inline(always)]
    fn take(&mut self, others: &Particles, scale: f64) {
        self.habituation.copy_from_slice(&others.habituation);
        self.risk.copy_from_slice(&others.risk);
        let scaled = |own: &mut [f64], others: &[f64]| {
            own.iter_mut().zip(others).for_each(|(own, other)| *own = other * scale);
        };
        scaled(&mut self.zero, &others.zero);
        scaled(&mut self.one, &others.one);
    }

    /// Takes particles in proportion to their weights, each with the same weight: those at evenly spaced places, from
    /// a share `start` of the first space.
    #[inline(always)]
    fn resample(&mut self, others: &Particles, sum: f64, start: f64) {
        let last = self.risk.len() - 1;
        let share = 1.0 / self.risk.len() as f64;
        let space = sum * share;
        let (mut of, mut below) = (0, others.zero[0] + others.one[0]);
        for place in 0..=last {
            let at = (place as f64 + start) * space;
            while below <= at && of < last {
                of += 1;
                below += others.zero[of] + others.one[of];
            }
            (self.habituation[place], self.risk[place]) = (others.habituation[of], others.risk[of]);
            let (zero, one) = (others.zero[of], others.one[of]);
            let scale = if zero + one > 0.0 { share / (zero + one) } else { 0.0 };
            (self.zero[place], self.one[place]) = (zero * scale, one * scale);
        }
    }
}

resumable!([] Particles { fixed habituation, risk, zero, one });
