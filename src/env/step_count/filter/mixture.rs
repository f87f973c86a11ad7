//! The belief about disengagement risk without noise: a finite mixture.
//!
//! A tailored message lowers the risk in one context and raises it in the other, so that every risk that a phone holds
//! possible has two successors. While an episode runs, risks that would have ended it are dropped. Up to [`ATOMS`]
//! atoms, the mixture is exact.
//!
//! More successors are merged within cells about 1/[`ATOMS`] wide, none of which reaches across the risk from which a
//! wrong message ends the episode. Merging keeps the probability and the mean of a cell. A test compares the result
//! with a mixture of a hundred times as many atoms.

use super::contexts::Feature;
use super::evidence::Evidence;
use super::moments::{Moments, SIDE, Sums, is_near, of};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::vector::Action;
use crate::kernel::math;
use crate::state::resumable;

/// The largest number of atoms, a multiple of [`SIDE`].
pub(super) const ATOMS: usize = 64;
/// Less probable atoms are dropped: their sum is far below the rounding of the others.
const LEAST: f64 = 1e-60;

/// A distribution of disengagement risk and of the context of the present step.
///
/// Every array is \[atoms\], at most `most` and a multiple of [`SIDE`]. Atoms without a weight have no meaning.
#[derive(Clone, Debug)]
pub(super) struct Mixture {
    most: usize,
    risk: Vec<f64>,
    /// The probabilities of a risk with context 0, and with context 1; their sum over all is 1.
    weights: [Vec<f64>; 2],
}

/// The successors of the atoms of a mixture by the context of the step.
#[derive(Clone, Debug, Default)]
pub(super) struct Successors {
    of: [Successor; 2],
}

/// What follows if the step had a certain context; every array is \[atoms\].
#[derive(Clone, Debug, Default)]
struct Successor {
    risk: Vec<f64>,
    /// Probabilities up to a common factor.
    weight: Vec<f64>,
    /// The probabilities of the next contexts, given the feature; 0 where no weight is left.
    next: [f64; 2],
    /// Room for the cells of the risks.
    cell: Vec<u64>,
}

impl Mixture {
    /// A mixture of at most `most` atoms, before the first episode.
    pub(super) fn new(most: usize) -> Self {
        let room = || Vec::with_capacity(most + SIDE);
        let mut mixture = Mixture { most, risk: room(), weights: [room(), room()] };
        mixture.begin(0.0, 0.5);
        mixture
    }

    /// Begins an episode at a risk, where context 0 has the probability `zero`.
    pub(super) fn begin(&mut self, risk: f64, zero: f64) {
        self.clear(SIDE);
        self.risk[0] = risk;
        self.weights[0][0] = zero;
        self.weights[1][0] = 1.0 - zero;
    }

    /// Makes place for a number of atoms, all without a weight, at the risk 0.
    #[inline(always)]
    fn clear(&mut self, count: usize) {
        for array in [&mut self.risk].into_iter().chain(&mut self.weights) {
            array.clear();
            array.resize(count, 0.0);
        }
    }

    /// The risks that are possible, with their probabilities.
    #[cfg(test)]
    pub(super) fn atoms(&self) -> impl Iterator<Item = (f64, f64)> {
        let weights = self.weights[0].iter().zip(&self.weights[1]).map(|(zero, one)| zero + one);
        self.risk.iter().copied().zip(weights).filter(|(_, weight)| *weight > 0.0)
    }

    /// Updates the mixture after a step, given the likelihoods of the contexts by the steps walked. Returns `None`,
    /// and leaves the mixture as it is, if nothing that it holds possible agrees with the evidence, which only merged
    /// atoms can bring about.
    #[inline(always)]
    pub(super) fn update(
        &mut self,
        dynamics: &Dynamics,
        seen: &Feature,
        steps: [f64; 2],
        evidence: &Evidence,
        room: &mut Successors,
    ) -> Option<Moments> {
        for (context, successor) in room.of.iter_mut().enumerate() {
            let (likelihood, next) = seen.ahead(context);
            successor.next = next;
            successor.follow(self, context, dynamics, steps[context] * likelihood, evidence);
        }
        let sums = room.sums(dynamics)?;
        let moments = sums.moments()?;
        let count = room.of.iter().map(Successor::count).sum();
        if evidence.action == Action::NONE || evidence.action == Action::UNTAILORED {
            self.take(&room.of);
        } else if count <= self.most {
            self.append(&room.of, count);
        } else {
            self.merge(&mut room.of, dynamics);
        }
        self.look(&room.of, 1.0 / sums.weight());
        Some(moments)
    }

    /// Takes successors that have the same risk in both contexts.
    #[inline(always)]
    fn take(&mut self, successors: &[Successor; 2]) {
        self.clear(successors[0].risk.len().max(successors[1].risk.len()));
        for (own, Successor { risk, weight, .. }) in self.weights.iter_mut().zip(successors) {
            self.risk[..risk.len()].copy_from_slice(risk);
            own[..weight.len()].copy_from_slice(weight);
        }
    }

    /// Takes the successors of both contexts that have a weight, whose number is `count`.
    ///
    /// Which have one is unpredictable, so the loop has no branches: the next successor replaces one without.
    #[inline(always)]
    fn append(&mut self, successors: &[Successor; 2], count: usize) {
        self.clear(count + SIDE);
        let mut place = 0;
        for (own, successor) in self.weights.iter_mut().zip(successors) {
            for (risk, weight) in successor.risk.iter().zip(&successor.weight) {
                (self.risk[place], own[place]) = (*risk, *weight);
                place += usize::from(*weight > 0.0);
            }
        }
        let count = count.next_multiple_of(SIDE);
        self.risk.truncate(count);
        self.weights.iter_mut().for_each(|weights| weights.truncate(count));
    }

    /// Takes the successors of both contexts, merged within cells.
    #[inline(always)]
    fn merge(&mut self, successors: &mut [Successor; 2], dynamics: &Dynamics) {
        self.clear(self.most);
        for (own, successor) in self.weights.iter_mut().zip(successors) {
            successor.place(dynamics, self.most);
            // Of equal lengths, so that a single check of the bounds is enough.
            let (weights, firsts) = (&mut own[..self.most], &mut self.risk[..self.most]);
            let Successor { risk, weight, cell, .. } = successor;
            for ((risk, weight), cell) in risk.iter().zip(weight).zip(cell) {
                weights[*cell as usize] += *weight;
                firsts[*cell as usize] += *weight * risk;
            }
        }
        let [zero, one] = &self.weights;
        for ((risk, zero), one) in self.risk.iter_mut().zip(zero).zip(one) {
            let weight = zero + one;
            *risk = if weight > 0.0 { *risk / weight } else { 0.0 };
        }
    }

    /// Replaces the contexts of the step by the next contexts, and multiplies all weights by `scale`.
    #[inline(always)]
    fn look(&mut self, successors: &[Successor; 2], scale: f64) {
        let [from_zero, from_one] = [0, 1].map(|i: usize| successors[i].next.map(|x| x * scale));
        let [zeros, ones] = &mut self.weights;
        for (zero, one) in zeros.iter_mut().zip(ones) {
            let of = |next: usize| *zero * from_zero[next] + *one * from_one[next];
            (*zero, *one) = (of(0), of(1));
        }
    }
}

resumable!([] Mixture { grown risk; parts weights; check fits, "beliefs" });

impl Mixture {
    /// Whether the number of atoms and their risks are possible.
    fn fits(&self) -> bool {
        let count = self.risk.len();
        (1..=self.most).contains(&count)
            && count.is_multiple_of(SIDE)
            && self.weights.iter().all(|weights| weights.len() == count)
            && self.risk.iter().all(|risk| (0.0..=1.0).contains(risk))
    }
}

impl Successor {
    /// Finds what follows a mixture after a step in a context, whose likelihood is given.
    #[inline(always)]
    fn follow(
        &mut self,
        mixture: &Mixture,
        context: usize,
        dynamics: &Dynamics,
        likelihood: f64,
        evidence: &Evidence,
    ) {
        self.risk.clear();
        self.risk.extend(
            mixture.risk.iter().map(|risk| {
                dynamics.apply(context as u8, evidence.action, 0.0, *risk).disengagement
            }),
        );
        self.weight.clear();
        let weights = mixture.weights[context].iter().zip(&self.risk);
        self.weight.extend(weights.map(|(weight, risk)| {
            let weight = weight * likelihood;
            if evidence.agrees(dynamics, *risk) & (weight > LEAST) { weight } else { 0.0 }
        }));
        // Many of the last risks of merged atoms are dropped, because the cells are in order.
        while self.weight.last_chunk() == Some(&[0.0; SIDE]) {
            self.risk.truncate(self.risk.len() - SIDE);
            self.weight.truncate(self.weight.len() - SIDE);
        }
    }

    /// The number of atoms with a weight.
    #[inline(always)]
    fn count(&self) -> usize {
        self.weight.iter().filter(|weight| **weight > 0.0).count()
    }

    /// Finds the cells of all risks, which are below `most`.
    #[inline(always)]
    fn place(&mut self, dynamics: &Dynamics, most: usize) {
        let cut = dynamics.disengagement_threshold - dynamics.epsilon_d;
        let cells = (most - 3) as f64;
        // Half a cell turns the nearest whole number into the next lower one.
        let lowest = (-cut * cells).floor() + 0.5;
        self.cell.clear();
        self.cell.extend(self.risk.iter().map(|risk| {
            let cell = math::nearest((risk - cut) * cells - lowest);
            cell + u64::from(is_near(dynamics, *risk))
        }));
    }
}

impl Successors {
    /// Sums over all; `None` if there are none.
    #[inline(always)]
    fn sums(&self, dynamics: &Dynamics) -> Option<Sums> {
        let mut all = self.of.iter().flat_map(|of| of.risk.iter().zip(&of.weight));
        let (origin, _) = all.find(|(_, weight)| **weight > 0.0)?;
        let mut sums = Sums::from(0.0, *origin);
        for Successor { risk, weight, next, .. } in &self.of {
            for (risk, weight) in risk.as_chunks().0.iter().zip(weight.as_chunks().0) {
                let zero = of([weight, weight], |[weight, _]| weight * next[0]);
                let one = of([weight, weight], |[weight, _]| weight * next[1]);
                sums.add(dynamics, [&zero, &one], &[0.0; SIDE], risk);
            }
        }
        Some(sums)
    }
}
