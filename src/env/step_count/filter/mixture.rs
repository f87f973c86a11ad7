//! The belief about disengagement risk without noise: a finite mixture.
//!
//! A tailored message lowers the risk in one context and raises it in the other, so that every risk that a phone holds
//! possible has two successors. Equal risks are one atom. While an episode runs, risks that would have ended it are
//! dropped. Up to [`ATOMS`] atoms, the mixture is exact.
//!
//! More atoms are merged within cells about 1/[`ATOMS`] wide, none of which reaches across the risk from which a wrong
//! message ends the episode. Merging keeps the probability and the mean of a cell. A test compares the result with a
//! mixture of a hundred times as many atoms.

use std::hint::select_unpredictable;

use super::contexts::Feature;
use super::evidence::Evidence;
use super::moments::{Moments, Sums, is_near};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::vector::Action;
use crate::state::resumable;

/// The largest number of atoms.
pub(super) const ATOMS: usize = 64;
/// Less probable atoms are dropped: their sum is far below the rounding of the others.
const LEAST: f64 = 1e-60;

/// A disengagement risk with its probability, jointly with the context of the present step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Atom {
    pub(super) risk: f64,
    /// The probability of the risk and context 0, and of the risk and context 1.
    pub(super) weights: [f64; 2],
}

impl Atom {
    /// Stands behind the last atom.
    const END: Atom = Atom { risk: f64::INFINITY, weights: [0.0; 2] };

    #[inline(always)]
    pub(super) fn weight(&self) -> f64 {
        self.weights[0] + self.weights[1]
    }

    /// Adds another atom: the sum of the weights, at the mean risk.
    fn join(&mut self, other: &Atom) {
        let weight = other.weight();
        self.risk += (other.risk - self.risk) * weight / (self.weight() + weight);
        self.weights = [0, 1].map(|context| self.weights[context] + other.weights[context]);
    }
}

resumable!([] Atom { parts risk, weights });

/// A distribution of disengagement risk and of the context.
#[derive(Clone, Debug)]
pub(super) struct Mixture {
    /// The largest number of atoms.
    most: usize,
    /// At least one atom: different risks in ascending order. The sum of all weights is 1.
    atoms: Vec<Atom>,
}

/// Room for the successors of a mixture.
#[derive(Clone, Debug, Default)]
pub(super) struct Successors {
    /// Those whose risk falls or stays, and those whose risk rises; each in ascending order.
    calm: Vec<Atom>,
    annoyed: Vec<Atom>,
    /// Both in ascending order, behind an atom without meaning.
    all: Vec<Atom>,
}

impl Mixture {
    /// A mixture of at most `most` atoms, before the first episode.
    pub(super) fn new(most: usize) -> Self {
        let mut atoms = Vec::with_capacity(most);
        atoms.push(Atom { risk: 0.0, weights: [0.5; 2] });
        Mixture { most, atoms }
    }

    /// Begins an episode at a risk, where context 0 has the probability `zero`.
    pub(super) fn begin(&mut self, risk: f64, zero: f64) {
        self.atoms.clear();
        self.atoms.push(Atom { risk, weights: [zero, 1.0 - zero] });
    }

    /// The atoms.
    #[cfg(test)]
    pub(super) fn atoms(&self) -> &[Atom] {
        &self.atoms
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
        let action = evidence.action;
        let is_tailored = action != Action::NONE && action != Action::UNTAILORED;
        let is_wrong = [0, 1].map(|context| is_tailored && action != Action::tailored_to(context));
        let share =
            |context: usize, of: bool| if is_wrong[context] == of { steps[context] } else { 0.0 };
        let agrees = |risk: f64| evidence.agrees(dynamics, risk);
        let succeed =
            |share: [f64; 2], change: &mut dyn FnMut(f64) -> f64, into: &mut Vec<Atom>| {
                into.clear();
                if share != [0.0; 2] {
                    for Atom { risk, weights: [zero, one] } in &self.atoms {
                        let risk = change(*risk);
                        let weights = seen.after([zero * share[0], one * share[1]]);
                        let atom = Atom { risk, weights };
                        if agrees(risk) && atom.weight() > LEAST {
                            into.push(atom);
                        }
                    }
                }
            };
        let calmed = |risk: f64| if action == Action::NONE { risk } else { dynamics.calmed(risk) };
        succeed([share(0, false), share(1, false)], &mut { calmed }, &mut room.calm);
        succeed(
            [share(0, true), share(1, true)],
            &mut |risk| dynamics.annoyed(risk),
            &mut room.annoyed,
        );
        let sums = room.merge(dynamics);
        let moments = sums.moments()?;
        self.take(&room.all[1..], 1.0 / sums.weight, dynamics);
        Some(moments)
    }

    /// Replaces the atoms by others, whose weights are multiplied by `scale`.
    #[inline(always)]
    fn take(&mut self, others: &[Atom], scale: f64, dynamics: &Dynamics) {
        self.atoms.clear();
        let scaled = |atom: &Atom| Atom { weights: atom.weights.map(|x| x * scale), ..*atom };
        if others.len() <= self.most {
            self.atoms.extend(others.iter().map(scaled));
            return;
        }
        let cut = dynamics.disengagement_threshold - dynamics.epsilon_d;
        let cells = (self.most - 3) as f64;
        let cell = |risk: f64| (((risk - cut) * cells).floor(), is_near(dynamics, risk));
        let mut last = None;
        for atom in others {
            let of = Some(cell(atom.risk));
            match self.atoms.last_mut() {
                Some(joined) if of == last => joined.join(&scaled(atom)),
                _ => self.atoms.push(scaled(atom)),
            }
            last = of;
        }
    }
}

resumable!([] Mixture { parts atoms; check fits, "beliefs" });

impl Mixture {
    /// Whether the number of atoms is possible.
    fn fits(&self) -> bool {
        (1..=self.most).contains(&self.atoms.len())
    }
}

impl Successors {
    /// Merges both lists into `all`, where equal risks become one atom, and sums over them.
    ///
    /// Which list comes next is unpredictable, so the loop has no branches.
    #[inline(always)]
    fn merge(&mut self, dynamics: &Dynamics) -> Sums {
        let count = self.calm.len() + self.annoyed.len();
        self.calm.push(Atom::END);
        self.annoyed.push(Atom::END);
        self.all.resize(count + 1, Atom::default());
        let origin = if count == 0 { 0.0 } else { self.calm[0].risk.min(self.annoyed[0].risk) };
        let mut sums = Sums::from(0.0, origin);
        let mut last = Atom { risk: f64::NEG_INFINITY, weights: [0.0; 2] };
        let (mut calm, mut place) = (0, 0);
        for taken in 0..count {
            let (low, high) = (self.calm[calm], self.annoyed[taken - calm]);
            let takes_calm = low.risk <= high.risk;
            let next = select_unpredictable(takes_calm, low, high);
            calm += usize::from(takes_calm);
            sums.add(dynamics, next.weights, 0.0, next.risk);
            let is_new = next.risk > last.risk;
            let before = |context: usize| select_unpredictable(is_new, 0.0, last.weights[context]);
            let weights = [before(0) + next.weights[0], before(1) + next.weights[1]];
            last = Atom { risk: next.risk, weights };
            place += usize::from(is_new);
            self.all[place] = last;
        }
        self.all.truncate(place + 1);
        sums
    }
}
