//! The belief about disengagement risk, and about habituation and contexts under noise: a particle filter.
//!
//! A particle has a habituation, a disengagement risk and the weights of both contexts. In a step, it draws habituation
//! and parameters, and weighs the contexts by the steps walked. A tailored message changes disengagement risk by the
//! context, so that one particle for either context follows. The chain of contexts and the feature then weigh the next
//! contexts without a draw.
//!
//! Without noise, an episode begins with one particle, and all are exact until there is no room. Copies would then stay
//! equal, so that particles are joined within cells of risk. Joining keeps the probability and the mean of a cell. Under
//! noise, particles are resampled where there is no room, and where less than half of them count.
//!
//! **Source**: Gordon, Salmond and Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", 1993;
//! Doucet and Johansen, "A tutorial on particle filtering and smoothing", 2009, section 4.

use super::contexts::ContextEvidence;
use super::evidence::Evidence;
use super::moments::{BeliefMoments, SIDE, StateSums, largest};
use super::steps::{expected, ln_density, of_contexts, relative};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::noise::DrawnNoise;
use crate::env::step_count::parameters::{RewardHabituation, StepCount};
use crate::env::variates::Expansion;
use crate::env::vector::Action;
use crate::kernel::math;
use crate::rng::unit_from_bits;
use crate::state::resumable;

/// Without noise, less probable particles are dropped: their sum is far below the rounding of the others.
const LEAST: f64 = 1e-60;

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
pub(super) struct ParticleScratch {
    /// Whether the state has noise.
    is_noisy: bool,
    /// Whether particles need a disengagement risk.
    has_risk: bool,
    /// The noise of particle i at index i.
    noise: DrawnNoise,
    /// The word from which the next words of the step come.
    words: u64,
    /// \[2 particles\]: the particles after the step, and the risks that a wrong message in the next step would lead to.
    next: Particles,
    wrong: Vec<f64>,
    /// \[2 particles + 1\]: the particles of `next` that come to the next slots; the last entry is for those without one.
    from: Vec<u32>,
    /// \[2 particles\]: the cells of particles, as numbers whose low bits are the cell.
    cells_of: Vec<f64>,
    /// \[particles\]: sums within cells, of the weights of both contexts and of risk times weight; 0 between steps.
    cells: Vec<[f64; 4]>,
}

impl ParticleScratch {
    /// Room for at most `most` particles, a multiple of [`SIDE`], in an environment.
    pub(super) fn new(environment: &StepCount, has_risk: bool, most: usize) -> ParticleScratch {
        ParticleScratch {
            is_noisy: environment.has_noise_of_state(),
            has_risk,
            noise: DrawnNoise::of_state(environment, most),
            words: 0,
            next: Particles::new(2 * most),
            wrong: vec![0.0; 2 * most],
            from: vec![0; 2 * most + 1],
            cells_of: vec![0.0; 2 * most],
            cells: vec![[0.0; 4]; most],
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
        let ParticleScratch { noise, words, next, wrong, .. } = self;
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
    pub(super) fn begin(
        &mut self,
        habituation: f64,
        risk: f64,
        zero: f64,
        draws: &ParticleScratch,
    ) {
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
        seen: &ContextEvidence,
        evidence: &Evidence,
        draws: &mut ParticleScratch,
    ) -> Option<BeliefMoments> {
        let dynamics = Dynamics::of(person);
        let (count, action, has_risk) = (self.count, evidence.action, draws.has_risk);
        let ParticleScratch { noise, next, .. } = draws;
        next.count = count;
        next.habituate(self, noise, &dynamics, action, draws.is_noisy);
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
                next.split(draws.is_noisy);
            }
            next.annoy(self, noise, &dynamics, action);
        } else {
            next.risk[..count].copy_from_slice(&self.risk[..count]);
        }
        next.look(&dynamics, seen, evidence, draws.is_noisy);
        next.trim();
        let all = next.count;
        if has_risk {
            draws.annoy(&dynamics, count, all);
        }
        let ParticleScratch { next, wrong, from, cells_of, cells, is_noisy, words, .. } = draws;
        let first = (0..all).find(|index| next.zero[*index] + next.one[*index] > 0.0)?;
        let sums = next.sums(&dynamics, first, wrong, *is_noisy);
        let moments = sums.moments()?;
        let (sum, most) = (sums.weight(), self.risk.len());
        let is_depleted = *is_noisy && 2.0 * sum * sum < sums.squares() * most as f64;
        if !is_depleted && (all <= most || next.filled() <= most) {
            let filled = next.list(from);
            self.take(next, &from[..filled], *is_noisy);
            self.scale(1.0 / sum);
        } else if *is_noisy {
            let start = unit_from_bits(Expansion(!*words).bits());
            next.draw(first, sum, start, &mut from[..=most]);
            self.take(next, &from[..most], true);
            self.level();
        } else {
            next.find_cells(&dynamics, wrong, most, cells_of);
            self.join(next, cells_of, cells, sum);
        }
        Some(moments)
    }

    /// Finds habituations without the noise of the state after an action: of the first particles alone where all have
    /// the same.
    #[inline(always)]
    fn habituate(
        &mut self,
        before: &Particles,
        noise: &DrawnNoise,
        dynamics: &Dynamics,
        action: Action,
        is_noisy: bool,
    ) {
        let count = if is_noisy { before.count } else { SIDE };
        let all = self.habituation.iter_mut().zip(&before.habituation[..count]);
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
    fn split(&mut self, is_noisy: bool) {
        let count = self.count;
        if is_noisy {
            self.habituation.copy_within(..count, count);
        }
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
    fn look(
        &mut self,
        dynamics: &Dynamics,
        seen: &ContextEvidence,
        evidence: &Evidence,
        is_noisy: bool,
    ) {
        let [low, high] = evidence.risks(dynamics);
        let least = if is_noisy { 0.0 } else { LEAST };
        let weights = self.zero[..self.count].iter_mut().zip(&mut self.one);
        for ((zero, one), risk) in weights.zip(&self.risk) {
            let next = seen.after([*zero, *one]);
            let agrees = (*risk >= low) & (*risk < high) & (next[0] + next[1] > least);
            [*zero, *one] = if agrees { next } else { [0.0; 2] };
        }
    }

    /// Leaves out the last particles, as far as they have no weight: without noise, those of the largest risks.
    #[inline(always)]
    fn trim(&mut self) {
        while self.count > SIDE
            && self.zero[..self.count].ends_with(&[0.0; SIDE])
            && self.one[..self.count].ends_with(&[0.0; SIDE])
        {
            self.count -= SIDE;
        }
    }

    /// The number of particles that have a weight.
    #[inline(always)]
    fn filled(&self) -> usize {
        let mut filled = 0;
        for (zero, one) in self.zero[..self.count].iter().zip(&self.one) {
            filled += usize::from(*zero + *one > 0.0);
        }
        filled
    }

    /// Sums over all particles, measured from one of them.
    #[inline(always)]
    fn sums(&self, dynamics: &Dynamics, from: usize, wrong: &[f64], is_noisy: bool) -> StateSums {
        let mut sums = StateSums::from(self.habituation[from], self.risk[from]);
        let weights = self.zero[..self.count].as_chunks().0.iter().zip(self.one.as_chunks().0);
        let risks = self.risk.as_chunks().0.iter().zip(wrong.as_chunks().0);
        if is_noisy {
            let all = weights.zip(risks).zip(self.habituation.as_chunks().0);
            for (((zero, one), (risk, wrong)), habituation) in all {
                sums.add(dynamics, [zero, one], [risk, wrong]);
                sums.add_noisy([zero, one], habituation);
            }
        } else {
            for ((zero, one), (risk, wrong)) in weights.zip(risks) {
                sums.add(dynamics, [zero, one], [risk, wrong]);
            }
        }
        sums
    }

    /// Lists the particles that have a weight. Returns their number.
    #[inline(always)]
    fn list(&self, slots: &mut [u32]) -> usize {
        let mut filled = 0;
        for (of, (zero, one)) in self.zero[..self.count].iter().zip(&self.one).enumerate() {
            // Which have one is unpredictable, so there are no branches: the next replaces one without.
            slots[filled] = of as u32;
            filled += usize::from(*zero + *one > 0.0);
        }
        filled
    }

    /// Takes these particles of others.
    #[inline(always)]
    fn take(&mut self, others: &Particles, from: &[u32], is_noisy: bool) {
        let count = others.count;
        let (risks, zeros, ones) =
            (&others.risk[..count], &others.zero[..count], &others.one[..count]);
        let own = self.risk.iter_mut().zip(&mut self.zero).zip(&mut self.one);
        for (((risk, zero), one), of) in own.zip(from) {
            let of = *of as usize;
            (*risk, *zero, *one) = (risks[of], zeros[of], ones[of]);
        }
        if is_noisy {
            for (habituation, of) in self.habituation.iter_mut().zip(from) {
                *habituation = others.habituation[*of as usize];
            }
        } else {
            self.habituation[..SIDE].copy_from_slice(&others.habituation[..SIDE]);
        }
        self.end(from.len());
    }

    /// Multiplies all weights.
    #[inline(always)]
    fn scale(&mut self, by: f64) {
        for (zero, one) in self.zero[..self.count].iter_mut().zip(&mut self.one) {
            *zero *= by;
            *one *= by;
        }
    }

    /// Gives all particles the same weight.
    #[inline(always)]
    fn level(&mut self) {
        let share = 1.0 / self.count as f64;
        for (zero, one) in self.zero[..self.count].iter_mut().zip(&mut self.one) {
            let scale = share / (*zero + *one);
            *zero *= scale;
            *one *= scale;
        }
    }

    /// Finds the particles of all `slots` but the last in proportion to their weights, which add up to `sum`: those at
    /// evenly spaced points, from a share `start` of the first space. The first particle with a weight is known.
    #[inline(always)]
    fn draw(&self, first: usize, sum: f64, start: f64, slots: &mut [u32]) {
        let most = slots.len() - 1;
        slots.fill(0);
        // Marks the first slot of every particle. One without a slot is replaced by the next.
        let (mut weight, mut index, mut last) = (0.0, 0, first as u32);
        for (of, (zero, one)) in self.zero[..self.count].iter().zip(&self.one).enumerate() {
            last = if *zero + *one > 0.0 { of as u32 } else { last };
            slots[usize::min(index, most)] = last;
            weight += zero + one;
            index = (weight * (most as f64 / sum) - start + 1.0) as usize;
        }
        let mut of = 0;
        for index in slots {
            of = u32::max(of, *index);
            *index = of;
        }
    }

    /// Finds the cells of all risks, which are below `most`. No cell reaches across the risk from which a wrong message
    /// ends the episode.
    #[inline(always)]
    fn find_cells(&self, dynamics: &Dynamics, wrong: &[f64], most: usize, cells_of: &mut [f64]) {
        let threshold = dynamics.disengagement_threshold;
        let (cut, cells) = (threshold - dynamics.epsilon_d, (most - 3) as f64);
        // Half a cell turns the nearest whole number into the next lower one.
        let lowest = (-cut * cells).floor() + 0.5;
        for ((cell, risk), wrong) in cells_of[..self.count].iter_mut().zip(&self.risk).zip(wrong) {
            let near = if *wrong >= threshold { 1.0 } else { 0.0 };
            *cell = math::nearest((*risk - cut) * cells - lowest) + near;
        }
    }

    /// Joins the particles of others within cells, which keeps the probability and the mean of a cell.
    #[inline(always)]
    fn join(&mut self, others: &Particles, cells_of: &[f64], cells: &mut [[f64; 4]], sum: f64) {
        let states = others.zero[..others.count].iter().zip(&others.one).zip(&others.risk);
        for (((zero, one), risk), cell) in states.zip(cells_of) {
            let [a, b, c, _] = &mut cells[math::low_bits(*cell)];
            (*a, *b, *c) = (*a + *zero, *b + *one, *c + (*zero + *one) * *risk);
        }
        // Of equal lengths, so that a single check of the bounds is enough.
        let most = cells.len();
        let (zeros, ones) = (&mut self.zero[..most], &mut self.one[..most]);
        let (risks, mut filled) = (&mut self.risk[..most], 0);
        for cell in cells {
            let [zero, one, product, _] = *cell;
            *cell = [0.0; 4];
            (zeros[filled], ones[filled], risks[filled]) = (zero, one, product);
            filled += usize::from(zero + one > 0.0);
        }
        let scale = 1.0 / sum;
        let weights = zeros[..filled].iter_mut().zip(&mut *ones);
        for (risk, (zero, one)) in risks.iter_mut().zip(weights) {
            // Rounding could take the mean of risks near 1 beyond it.
            let mean = *risk / (*zero + *one);
            *risk = if mean < 1.0 { mean } else { 1.0 };
            (*zero, *one) = (*zero * scale, *one * scale);
        }
        self.habituation[..SIDE].copy_from_slice(&others.habituation[..SIDE]);
        self.end(filled);
    }

    /// Ends after `filled` particles.
    #[inline(always)]
    fn end(&mut self, filled: usize) {
        self.count = filled.next_multiple_of(SIDE);
        self.zero[filled..self.count].fill(0.0);
        self.one[filled..self.count].fill(0.0);
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

    /// As many particles with these weights, half of them in context 1, and with these risks.
    fn with(weights: &[f64], risks: &[f64]) -> Particles {
        let mut particles = Particles::new(weights.len());
        particles.count = weights.len();
        particles.risk.copy_from_slice(risks);
        particles.zero = weights.iter().map(|weight| 0.5 * weight).collect();
        particles.one.clone_from(&particles.zero);
        particles
    }

    /// Points at 1/16, 3/16, ... of weights of a third each: the second particle owns three, the third two, the fifth
    /// three, and those without a weight none.
    #[test]
    fn particles_are_drawn_in_proportion_to_their_weights() {
        let third = 1.0 / 3.0;
        let before = with(&[0.0, third, third, 0.0, third, 0.0, 0.0, 0.0], &[0.5; 8]);
        let mut slots = [0; 9];
        before.draw(1, 1.0, 0.5, &mut slots);
        assert_eq!(slots[..8], [1, 1, 1, 2, 2, 4, 4, 4]);
        // Without a first space, the first point is where the second particle begins.
        before.draw(1, 1.0, 0.0, &mut slots);
        assert_eq!(slots[0], 1);
        let mut after = Particles::new(8);
        after.take(&before, &slots[..8], true);
        after.level();
        assert!(after.zero.iter().chain(&after.one).all(|weight| *weight == 0.0625));
    }

    /// Cells are a fifth wide, from 0.6 in both directions, from which a wrong message leads to the threshold.
    #[test]
    fn particles_without_noise_are_joined_within_cells() {
        let e = StepCount { epsilon_d: 0.4, ..StepCount::paper(0.6) };
        let dynamics = Dynamics::of(&e);
        let weights = [0.25, 0.25, 0.0, 0.25, 0.25, 0.5, 0.5, 0.0];
        let risks = [0.0, 0.1, 0.3, 0.55, 0.59, 0.61, 0.99, 1.0];
        let before = with(&weights, &risks);
        let wrong = risks.map(|risk| dynamics.annoyed(risk));
        let (mut cells_of, mut cells) = ([0.0; 8], [[0.0; 4]; 8]);
        before.find_cells(&dynamics, &wrong, 8, &mut cells_of);
        let mut after = Particles::new(8);
        after.join(&before, &cells_of, &mut cells, 2.0);
        let near = |of: &[f64], to: &[f64]| of.iter().zip(to).all(|(x, y)| (x - y).abs() < 1e-12);
        assert!(near(&after.risk[..4], &[0.05, 0.57, 0.61, 0.99]), "{:?}", after.risk);
        assert_eq!(after.zero[..5], [0.125, 0.125, 0.125, 0.125, 0.0]);
        assert_eq!(cells, [[0.0; 4]; 8]);
    }
}
