//! The belief about disengagement risk without noise: a finite mixture.
//!
//! A tailored message lowers the risk in one context and raises it in the other, so that every risk that a phone holds
//! possible has two successors. While an episode runs, risks that would have ended it are dropped. Up to [`ATOMS`]
//! atoms, the mixture is exact.
//!
//! More atoms are merged within cells about 1/[`ATOMS`] wide, none of which reaches across the risk from which a wrong
//! message ends the episode. Merging keeps the probability and the mean of a cell. A test compares the result with a
//! mixture of a hundred times as many atoms.

use super::contexts::Feature;
use super::evidence::Evidence;
use super::moments::{Moments, Sums, is_near};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::vector::Action;
use crate::state::resumable;

/// The largest number of atoms.
pub(super) const ATOMS: usize = 48;
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
    #[inline(always)]
    pub(super) fn weight(&self) -> f64 {
        self.weights[0] + self.weights[1]
    }
}

resumable!([] Atom { parts risk, weights });

/// A distribution of disengagement risk and of the context.
#[derive(Clone, Debug)]
pub(super) struct Mixture {
    /// The largest number of atoms.
    most: usize,
    /// At least one atom, in any order. The sum of all weights is 1.
    atoms: Vec<Atom>,
}

/// Room for a step of one mixture.
#[derive(Clone, Debug, Default)]
pub(super) struct Successors {
    /// The successors of all atoms.
    atoms: Vec<Atom>,
    /// The sums of the weights of a cell, and of the risks times their weight.
    cells: Vec<Atom>,
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
        let calmed = |risk: f64| if action == Action::NONE { risk } else { dynamics.calmed(risk) };
        let mut sums = Sums::from(0.0, calmed(self.atoms[0].risk));
        room.atoms.clear();
        let shares = [share(0, false), share(1, false)];
        self.succeed(shares, seen, calmed, (dynamics, evidence), &mut room.atoms, &mut sums);
        let (shares, annoyed) = ([share(0, true), share(1, true)], |risk| dynamics.annoyed(risk));
        self.succeed(shares, seen, annoyed, (dynamics, evidence), &mut room.atoms, &mut sums);
        let moments = sums.moments()?;
        room.scale(1.0 / sums.weight);
        if room.atoms.len() > self.most {
            room.merge(self.most, dynamics);
        }
        self.atoms.clear();
        self.atoms.extend_from_slice(&room.atoms);
        Some(moments)
    }

    /// Adds the successors whose risk changes in one way, with `shares` of the weights of both contexts.
    #[inline(always)]
    fn succeed(
        &self,
        shares: [f64; 2],
        seen: &Feature,
        change: impl Fn(f64) -> f64,
        (dynamics, evidence): (&Dynamics, &Evidence),
        successors: &mut Vec<Atom>,
        sums: &mut Sums,
    ) {
        if shares == [0.0; 2] {
            return;
        }
        // What a weight of each context adds to the weights of the next contexts.
        let of_zero = seen.after([shares[0], 0.0]);
        let of_one = seen.after([0.0, shares[1]]);
        let next =
            |context: usize, [zero, one]: [f64; 2]| of_zero[context] * zero + of_one[context] * one;
        for Atom { risk, weights } in &self.atoms {
            let risk = change(*risk);
            let weights = [next(0, *weights), next(1, *weights)];
            if evidence.agrees(dynamics, risk) && weights[0] + weights[1] > LEAST {
                sums.add_risk(dynamics, weights, risk);
                successors.push(Atom { risk, weights });
            }
        }
    }
}

impl Successors {
    /// Multiplies all weights.
    #[inline(always)]
    fn scale(&mut self, by: f64) {
        self.atoms
            .iter_mut()
            .for_each(|atom| atom.weights = atom.weights.map(|weight| weight * by));
    }

    /// Replaces the atoms of every cell by one, of which there are at most `most`.
    #[inline(always)]
    fn merge(&mut self, most: usize, dynamics: &Dynamics) {
        let per_risk = (most - 3) as f64;
        let cut = dynamics.disengagement_threshold - dynamics.epsilon_d;
        let first = (-cut * per_risk).floor();
        let cell = |risk: f64| ((risk - cut) * per_risk - first) as usize;
        // The cell that begins at the cut; rounding must not take an atom across.
        let at = if first < 0.0 { -first as usize } else { 0 };
        self.cells.clear();
        self.cells.resize(most, Atom::default());
        for Atom { risk, weights } in &self.atoms {
            let place = match is_near(dynamics, *risk) {
                true => cell(*risk).max(at),
                false => cell(*risk).min(at.saturating_sub(1)),
            };
            let cell = &mut self.cells[place];
            cell.risk += risk * (weights[0] + weights[1]);
            cell.weights = [cell.weights[0] + weights[0], cell.weights[1] + weights[1]];
        }
        self.atoms.clear();
        let filled = self.cells.iter().filter(|cell| cell.weight() > 0.0);
        self.atoms.extend(filled.map(|cell| Atom { risk: cell.risk / cell.weight(), ..*cell }));
    }
}

resumable!([] Mixture { parts atoms; check fits, "beliefs" });

impl Mixture {
    /// Whether the number of atoms is possible.
    fn fits(&self) -> bool {
        (1..=self.most).contains(&self.atoms.len())
    }
}
