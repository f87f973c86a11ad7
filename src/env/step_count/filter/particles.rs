//! The belief about disengagement risk, and about habituation and contexts under noise: a particle filter.
//!
//! A particle has a habituation, a disengagement risk and the weights of both contexts. In a step, it draws habituation
//! and parameters, and weighs the contexts by the steps walked. A tailored message changes disengagement risk by the
//! context, so that one particle for either context follows. The chain of contexts and the feature then weigh the next
//! contexts without a draw. Particles are resampled where there is no room for all, and under noise where less than
//! half of them count. Without noise, an episode begins with one particle, and all are exact until there is no room.
//!
//! **Source**: Gordon, Salmond and Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", 1993;
//! Doucet and Johansen, "A tutorial on particle filtering and smoothing", 2009, section 4.

use super::contexts::Feature;
use super::evidence::Evidence;
use super::moments::{Moments, SIDE, Sums, largest};
use super::steps::{expected, ln_density, of_contexts, relative};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::noise::DrawnNoise;
use crate::env::step_count::parameters::{RewardHabituation, StepCount};
use crate::env::variates::Expansion;
use crate::env::vector::Action;
use crate::rng::unit_from_bits;
use crate::state::resumable;

/// The steps towards the weight from which particles are kept; see [`Particles::heavy`].
const PASSES: u32 = 4;

/// Particles of a lane; every array is \[particles\].
///
/// All habituations and risks are in \[0, 1\]; beyond `count`, and without a weight, they have no meaning.
#[derive(Clone, Debug)]
pub(super) struct Particles {
    /// The number of particles in use, a multiple of [`SIDE`].
    count: usize,
    habituation: Vec<f64>,
    risk: Vec<f64>,
    /// The weights of a particle with context 0 and with context 1.
    zero: Vec<f64>,
    one: Vec<f64>,
}

/// Room for a step of one lane, and what is drawn for it.
#[derive(Clone, Debug)]
pub(super) struct Draws {
    /// Whether the state has noise.
    is_noisy: bool,
    /// Whether particles need a disengagement risk.
    has_risk: bool,
    /// The noise of particle i at place i.
    noise: DrawnNoise,
    /// The word from which the next words of the step come.
    words: u64,
    /// \[2 particles\]: the particles after the step, and the risks that a wrong message in the next step would lead to.
    next: Particles,
    wrong: Vec<f64>,
    /// The particles of `next` that have a weight.
    filled: Vec<usize>,
}

impl Draws {
    /// Room for at most `most` particles, a multiple of [`SIDE`], in an environment.
    pub(super) fn new(environment: &StepCount, has_risk: bool, most: usize) -> Draws {
        Draws {
            is_noisy: environment.has_noise_of_state(),
            has_risk,
            noise: DrawnNoise::of_state(environment, most),
            words: 0,
            next: Particles::new(2 * most),
            wrong: vec![0.0; 2 * most],
            filled: Vec::with_capacity(2 * most),
        }
    }

    /// Draws all words of a step from one word.
    #[inline(always)]
    pub(super) fn expand(&mut self, word: u64) {
        let mut words = Expansion(word);
        self.noise.expand(&mut words);
        self.words = words.bits();
    }

    /// The probability that a wrong message at this risk would reach the threshold.
    pub(super) fn near(&mut self, dynamics: &Dynamics, risk: f64) -> f64 {
        self.words = 0;
        self.next.risk.fill(risk);
        let count = self.wrong.len() / 2;
        self.annoy(dynamics, count, count);
        let threshold = dynamics.disengagement_threshold;
        let near = self.wrong[..count].iter().filter(|risk| **risk >= threshold).count();
        near as f64 / count as f64
    }

    /// Finds the risks of the first `all` of the next particles after a wrong message, with noise of its own; those of
    /// the same `count` have the same.
    #[inline(always)]
    fn annoy(&mut self, dynamics: &Dynamics, count: usize, all: usize) {
        let Draws { noise, words, next, wrong, .. } = self;
        noise.expand(&mut Expansion(*words));
        let blocks = wrong[..all].chunks_mut(count).zip(next.risk.chunks(count));
        for (wrong, risk) in blocks {
            noise.for_each(dynamics, wrong.iter_mut().zip(risk), |dynamics, (wrong, risk)| {
                *wrong = dynamics.annoyed(*risk);
            });
            noise.risks(dynamics, wrong);
        }
    }
}

impl Particles {
    /// At most `most` particles, a multiple of [`SIDE`], before the first episode.
    pub(super) fn new(most: usize) -> Particles {
        let zeros = vec![0.0; most];
        Particles {
            count: SIDE,
            habituation: zeros.clone(),
            risk: zeros.clone(),
            zero: zeros.clone(),
            one: zeros,
        }
    }

    /// Begins an episode at this habituation and risk, where context 0 has the probability `zero`: with all particles if
    /// the state has noise, and with one if it has none.
    pub(super) fn begin(&mut self, habituation: f64, risk: f64, zero: f64, draws: &Draws) {
        let filled = if draws.is_noisy { self.risk.len() } else { 1 };
        let share = 1.0 / filled as f64;
        self.habituation.fill(habituation);
        self.risk.fill(risk);
        self.zero[..filled].fill(zero * share);
        self.one[..filled].fill((1.0 - zero) * share);
        self.end(filled);
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
        let (count, action, has_risk) = (self.count, evidence.action, draws.has_risk);
        let Draws { noise, next, .. } = draws;
        next.count = count;
        next.habituate(self, noise, &dynamics, action);
        if person.reward_habituation == RewardHabituation::Drawn {
            noise.habituations(&dynamics, &mut next.habituation[..count]);
        }
        match evidence.steps {
            Some(steps) if draws.is_noisy => next.weigh(self, person, &dynamics, action, steps),
            _ => {
                let habituation = next.habituation[0];
                let steps = of_contexts(person, &dynamics, habituation, evidence);
                next.weigh_all(self, steps);
            }
        }
        if person.reward_habituation == RewardHabituation::Expected {
            noise.habituations(&dynamics, &mut next.habituation[..count]);
        }
        if has_risk {
            if action != Action::NONE && action != Action::UNTAILORED {
                next.split();
            }
            next.annoy(self, noise, &dynamics, action);
        } else {
            next.risk[..count].copy_from_slice(&self.risk[..count]);
        }
        next.look(&dynamics, seen, evidence);
        let all = next.count;
        if has_risk {
            draws.annoy(&dynamics, count, all);
        }
        let Draws { next, wrong, filled, is_noisy, words, .. } = draws;
        filled.clear();
        filled.extend((0..all).filter(|i| next.weight(*i) > 0.0));
        let sums = next.sums(&dynamics, *filled.first()?, wrong);
        let moments = sums.moments()?;
        let (sum, most) = (sums.weight(), self.risk.len());
        let is_depleted = *is_noisy && 2.0 * sum * sum < sums.squares() * most as f64;
        if is_depleted || filled.len() > most {
            let start = unit_from_bits(Expansion(!*words).bits());
            self.resample(next, filled, sum, start, *is_noisy);
        } else {
            for (place, from) in filled.iter().enumerate() {
                self.take(place, next, *from, 1.0 / sum);
            }
            self.end(filled.len());
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
        let all = self.habituation.iter_mut().zip(&before.habituation[..before.count]);
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
        let count = before.count;
        let Particles { habituation, zero, one, .. } = self;
        let (zeros, ones) = (&mut zero[..count], &mut one[..count]);
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

    /// Weighs the contexts before the step by likelihoods that all particles share.
    #[inline(always)]
    fn weigh_all(&mut self, before: &Particles, likelihoods: [f64; 2]) {
        let weights = [(&mut self.zero, &before.zero), (&mut self.one, &before.one)];
        for ((own, before), likelihood) in weights.into_iter().zip(likelihoods) {
            for (own, before) in own[..self.count].iter_mut().zip(before) {
                *own = before * likelihood;
            }
        }
    }

    /// Makes two particles of each, one for either context of the step: those of context 1 stand behind those of
    /// context 0.
    #[inline(always)]
    fn split(&mut self) {
        let count = self.count;
        self.habituation.copy_within(..count, count);
        self.zero[count..2 * count].fill(0.0);
        self.one.copy_within(..count, count);
        self.one[..count].fill(0.0);
        self.count = 2 * count;
    }

    /// Finds disengagement risks after an action in the contexts of the particles.
    #[inline(always)]
    fn annoy(
        &mut self,
        before: &Particles,
        noise: &DrawnNoise,
        dynamics: &Dynamics,
        action: Action,
    ) {
        let blocks = self.risk[..self.count].chunks_mut(before.count);
        for (context, block) in blocks.enumerate() {
            let all = block.iter_mut().zip(&before.risk);
            noise.for_each(dynamics, all, |dynamics, (after, before)| {
                *after = dynamics.apply(context as u8, action, 0.0, *before).disengagement;
            });
            noise.risks(dynamics, block);
        }
    }

    /// Drops the particles that do not agree with the evidence, and weighs the next contexts.
    #[inline(always)]
    fn look(&mut self, dynamics: &Dynamics, seen: &Feature, evidence: &Evidence) {
        let [low, high] = evidence.risks(dynamics);
        let weights = self.zero[..self.count].iter_mut().zip(&mut self.one);
        for ((zero, one), risk) in weights.zip(&self.risk) {
            let next = seen.after([*zero, *one]);
            let agrees = (*risk >= low) & (*risk < high);
            [*zero, *one] = if agrees { next } else { [0.0; 2] };
        }
    }

    /// Sums over all particles, measured from one of them.
    #[inline(always)]
    fn sums(&self, dynamics: &Dynamics, from: usize, wrong: &[f64]) -> Sums {
        let mut sums = Sums::from(self.habituation[from], self.risk[from]);
        let weights = self.zero[..self.count].as_chunks().0.iter().zip(self.one.as_chunks().0);
        let states = self.habituation.as_chunks().0.iter().zip(self.risk.as_chunks().0);
        for (((zero, one), (habituation, risk)), wrong) in
            weights.zip(states).zip(wrong.as_chunks().0)
        {
            sums.add(dynamics, [zero, one], habituation, [risk, wrong]);
        }
        sums
    }

    #[inline(always)]
    fn weight(&self, place: usize) -> f64 {
        self.zero[place] + self.one[place]
    }

    /// Takes a particle of others, with its weights times `scale`.
    #[inline(always)]
    fn take(&mut self, place: usize, others: &Particles, from: usize, scale: f64) {
        self.habituation[place] = others.habituation[from];
        self.risk[place] = others.risk[from];
        self.zero[place] = others.zero[from] * scale;
        self.one[place] = others.one[from] * scale;
    }

    /// Ends after `filled` particles.
    #[inline(always)]
    fn end(&mut self, filled: usize) {
        self.count = filled.next_multiple_of(SIDE);
        self.zero[filled..self.count].fill(0.0);
        self.one[filled..self.count].fill(0.0);
    }

    /// Takes as many particles of the `filled` others, whose weights add up to `sum`, as there is room for.
    ///
    /// With noise of the state, particles are copied in proportion to their weights, each with the same weight. Without,
    /// copies would stay equal: heavy particles are kept with their weights, and light ones, in the order of their
    /// risks, with the least weight of a heavy one or not at all.
    #[inline(always)]
    fn resample(
        &mut self,
        others: &Particles,
        filled: &mut [usize],
        sum: f64,
        start: f64,
        is_noisy: bool,
    ) {
        let most = self.risk.len();
        let mut heavy = sum / most as f64;
        if !is_noisy {
            filled.sort_by(|a, b| others.risk[*a].total_cmp(&others.risk[*b]));
            heavy = others.heavy(filled, heavy, most);
        }
        let (mut place, mut owed) = (0, start);
        for from in filled {
            let weight = others.weight(*from);
            let is_kept = !is_noisy && weight >= heavy;
            let kept = if is_kept { weight } else { heavy };
            owed += if is_kept { 1.0 } else { weight / heavy };
            while owed >= 1.0 && place < most {
                self.take(place, others, *from, kept / (weight * sum));
                owed -= 1.0;
                place += 1;
            }
        }
        self.end(place);
    }

    /// The weight c from which particles are kept as they are, where the sum of min(1, weight / c) is `most`; the first
    /// guess is too large. A c that is somewhat too large leaves places empty and is as good.
    ///
    /// **Source**: Fearnhead and Clifford, "On-line inference for hidden Markov models via particle filters", 2003,
    /// section 3.
    #[inline(always)]
    fn heavy(&self, filled: &[usize], guess: f64, most: usize) -> f64 {
        let mut heavy = guess;
        for _ in 0..PASSES {
            let (mut kept, mut light) = (0, 0.0);
            for place in filled {
                let weight = self.weight(*place);
                kept += usize::from(weight >= heavy);
                light += if weight >= heavy { 0.0 } else { weight };
            }
            if kept < most {
                heavy = light / (most - kept) as f64;
            }
        }
        heavy
    }
}

resumable!([] Particles { parts count; fixed habituation, risk, zero, one; check fits, "beliefs" });

impl Particles {
    /// Whether the number of particles and their states are possible.
    fn fits(&self) -> bool {
        let is_unit = |x: &f64| (0.0..=1.0).contains(x);
        (1..=self.risk.len()).contains(&self.count)
            && self.count.is_multiple_of(SIDE)
            && self.risk.iter().chain(&self.habituation).all(is_unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight particles with these weights, and with risks of 1/8, 2/8, ...
    fn with_weights(weights: [f64; 8]) -> Particles {
        Particles {
            count: 8,
            habituation: vec![0.0; 8],
            risk: (1..9).map(|i| f64::from(i) / 8.0).collect(),
            zero: weights.to_vec(),
            one: vec![0.0; 8],
        }
    }

    /// Points at 1/16, 3/16, ... of weights of a third each: the second particle owns three, the third two, the fifth
    /// three, and those without a weight none.
    #[test]
    fn particles_are_copied_in_proportion_to_their_weights() {
        let third = 1.0 / 3.0;
        let before = with_weights([0.0, third, third, 0.0, third, 0.0, 0.0, 0.0]);
        let mut after = Particles::new(8);
        after.resample(&before, &mut [1, 2, 4], 1.0, 0.5, true);
        assert_eq!(after.risk, [0.25, 0.25, 0.25, 0.375, 0.375, 0.625, 0.625, 0.625]);
        assert_eq!(after.zero, [0.125; 8]);
    }

    /// Sixteen particles in eight places, without noise: the heavy one keeps its weight, and seven of the fifteen light
    /// ones share the rest.
    #[test]
    fn heavy_particles_without_noise_keep_their_weights() {
        let mut before = Particles::new(16);
        before.count = 16;
        before.risk = (0..16).map(|i| f64::from(i) / 16.0).collect();
        before.zero = [vec![0.02; 15], vec![0.7]].concat();
        let mut after = Particles::new(8);
        let mut filled: Vec<usize> = (0..16).rev().collect();
        after.resample(&before, &mut filled, 1.0, 0.5, false);
        let risks = [1, 3, 5, 7, 9, 11, 13, 15].map(|i| f64::from(i) / 16.0);
        assert_eq!(after.risk, risks);
        assert!(after.zero[..7].iter().all(|weight| (weight - 0.3 / 7.0).abs() < 1e-15));
        assert_eq!(after.zero[7], 0.7);
    }
}
