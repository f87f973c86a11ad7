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
use super::moments::{Moments, Sums, largest};
use super::steps::{expected, ln_density, relative};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::noise::DrawnNoise;
use crate::env::step_count::parameters::{RewardHabituation, StepCount};
use crate::env::variates::Expansion;
use crate::env::vector::Action;
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
    /// The particles after the step.
    next: Particles,
    /// \[particles + 1\]: the particle that comes to a place; the last entry is for particles without one.
    from: Vec<usize>,
}

impl Draws {
    /// Room for `count` particles in an environment.
    pub(super) fn new(environment: &StepCount, count: usize) -> Draws {
        Draws {
            noise: DrawnNoise::of_state(environment, count),
            contexts: vec![0; count],
            resample: 0,
            next: Particles::new(count),
            from: vec![0; count + 1],
        }
    }

    /// Draws all words of a step from one word.
    #[inline(always)]
    pub(super) fn expand(&mut self, word: u64) {
        let mut words = Expansion(word);
        self.resample = words.bits();
        for word in &mut self.contexts {
            *word = words.bits();
        }
        self.noise.expand(&mut words);
    }
}

impl Particles {
    /// `count` particles, a multiple of [`SIDE`], before the first episode.
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
        let Draws { noise, contexts, resample, next, from } = draws;
        next.habituate(self, noise, &dynamics, evidence.action);
        if person.reward_habituation == RewardHabituation::Drawn {
            noise.habituations(&dynamics, &mut next.habituation);
        }
        match evidence.steps {
            Some(steps) => next.weigh(self, person, &dynamics, evidence.action, steps),
            None => {
                next.zero.copy_from_slice(&self.zero);
                next.one.copy_from_slice(&self.one);
            }
        }
        if person.reward_habituation == RewardHabituation::Expected {
            noise.habituations(&dynamics, &mut next.habituation);
        }
        next.choose(contexts);
        next.annoy(self, noise, &dynamics, evidence.action);
        noise.risks(&dynamics, &mut next.risk);
        next.look(&dynamics, seen, evidence);
        let sums = next.sums(&dynamics);
        let moments = sums.moments()?;
        let weight = sums.weight();
        if 2.0 * weight * weight < sums.squares() * self.risk.len() as f64 {
            self.resample(next, weight, unit_from_bits(*resample), from);
        } else {
            std::mem::swap(self, next);
            self.scale(1.0 / weight);
        }
        Some(moments)
    }

    /// Finds habituations without the noise of the state after an action.
    #[inline(always)]
    fn habituate(
        &mut self,
        before: &Particles,
        noise: &DrawnNoise,
        dynamics: &Dynamics,
        action: Action,
    ) {
        let all = self.habituation.iter_mut().zip(&before.habituation);
        noise.for_each(dynamics, all, |dynamics, (after, before)| {
            *after = dynamics.apply(0, action, *before, 0.0).habituation;
        });
    }

    /// Weighs the contexts of the particles before the step by the steps walked, given habituation after the step.
    #[inline(always)]
    fn weigh(
        &mut self,
        before: &Particles,
        person: &StepCount,
        dynamics: &Dynamics,
        action: Action,
        steps: f64,
    ) {
        // Likelihoods are relative to the largest of those that count.
        let counting = |ln: f64, weight: f64| if weight > 0.0 { ln } else { f64::MIN };
        let Particles { habituation, zero: zeros, one: ones, .. } = self;
        let weights = before.zero.iter().zip(&before.one);
        let densities = zeros.iter_mut().zip(&mut *ones);
        for (((zero, one), habituation), before) in densities.zip(habituation).zip(weights) {
            let expected = expected(person, dynamics, action, *habituation);
            *zero = counting(ln_density(dynamics, expected[0], steps), *before.0);
            *one = counting(ln_density(dynamics, expected[1], steps), *before.1);
        }
        let most = f64::max(largest(zeros), largest(ones));
        for (own, before) in [(zeros, &before.zero), (ones, &before.one)] {
            for (own, before) in own.iter_mut().zip(before) {
                *own = before * relative(*own - most);
            }
        }
    }

    /// Chooses the contexts of the step in proportion to their weights.
    #[inline(always)]
    fn choose(&mut self, words: &[u64]) {
        for ((zero, one), word) in self.zero.iter_mut().zip(&mut self.one).zip(words) {
            let weight = *zero + *one;
            let is_one = unit_from_bits(*word) * weight >= *zero;
            [*zero, *one] = if is_one { [0.0, weight] } else { [weight, 0.0] };
        }
    }

    /// Finds disengagement risks without the noise of the state after an action in the chosen contexts.
    #[inline(always)]
    fn annoy(
        &mut self,
        before: &Particles,
        noise: &DrawnNoise,
        dynamics: &Dynamics,
        action: Action,
    ) {
        let all = self.risk.iter_mut().zip(&before.risk).zip(&self.one);
        noise.for_each(dynamics, all, |dynamics, ((after, before), weight)| {
            let zero = dynamics.apply(0, action, 0.0, *before).disengagement;
            let one = dynamics.apply(1, action, 0.0, *before).disengagement;
            *after = if *weight > 0.0 { one } else { zero };
        });
    }

    /// Drops the particles that do not agree with the evidence, and weighs the next contexts.
    #[inline(always)]
    fn look(&mut self, dynamics: &Dynamics, seen: &Feature, evidence: &Evidence) {
        let [low, high] = evidence.risks(dynamics);
        for ((zero, one), risk) in self.zero.iter_mut().zip(&mut self.one).zip(&self.risk) {
            let next = seen.after([*zero, *one]);
            let agrees = (*risk >= low) & (*risk < high);
            [*zero, *one] = if agrees { next } else { [0.0; 2] };
        }
    }

    #[inline(always)]
    fn sums(&self, dynamics: &Dynamics) -> Sums {
        let mut sums = Sums::from(self.habituation[0], self.risk[0]);
        let weights = self.zero.as_chunks().0.iter().zip(self.one.as_chunks().0);
        let states = self.habituation.as_chunks().0.iter().zip(self.risk.as_chunks().0);
        for ((zero, one), (habituation, risk)) in weights.zip(states) {
            sums.add(dynamics, [zero, one], habituation, risk);
        }
        sums
    }

    /// Multiplies all weights.
    #[inline(always)]
    fn scale(&mut self, by: f64) {
        for weights in [&mut self.zero, &mut self.one] {
            for weight in weights {
                *weight *= by;
            }
        }
    }

    /// Takes particles in proportion to their weights, whose sum is `sum`, each with the same weight: those at evenly
    /// spaced places, from a share `start` of the first space.
    #[inline(always)]
    fn resample(&mut self, others: &Particles, sum: f64, start: f64, from: &mut [usize]) {
        let count = self.risk.len();
        from.fill(0);
        // Marks the first place of every particle. One without a place is replaced by the next.
        let (mut weight, mut place) = (0.0, 0);
        for (of, (zero, one)) in others.zero.iter().zip(&others.one).enumerate() {
            from[place.min(count)] = of;
            weight += zero + one;
            place = (weight * (count as f64 / sum) - start + 1.0) as usize;
        }
        let share = 1.0 / count as f64;
        let mut of = 0;
        for (place, first) in from[..count].iter().enumerate() {
            of = of.max(*first);
            (self.habituation[place], self.risk[place]) = (others.habituation[of], others.risk[of]);
            let (zero, one) = (others.zero[of], others.one[of]);
            let scale = if zero + one > 0.0 { share / (zero + one) } else { 0.0 };
            (self.zero[place], self.one[place]) = (zero * scale, one * scale);
        }
    }
}

resumable!([] Particles { fixed habituation, risk, zero, one });

#[cfg(test)]
mod tests {
    use super::*;

    /// Points at 1/8, 3/8, 5/8 and 7/8 of weights of a third each: the second particle owns two, and the last, without
    /// a weight, none.
    #[test]
    fn particles_without_weight_are_not_resampled() {
        let third = 1.0 / 3.0;
        let before = Particles {
            habituation: vec![0.1, 0.2, 0.3, 0.4],
            risk: vec![0.0; 4],
            zero: vec![third, 0.0, third, 0.0],
            one: vec![0.0, third, 0.0, 0.0],
        };
        let mut after = Particles::new(4);
        after.resample(&before, 1.0, 0.5, &mut [0; 5]);
        assert_eq!(after.habituation, [0.1, 0.2, 0.2, 0.3]);
        assert_eq!(after.zero, [0.25, 0.0, 0.0, 0.25]);
        assert_eq!(after.one, [0.0, 0.25, 0.25, 0.0]);
    }
}
