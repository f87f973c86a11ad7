//! The belief about disengagement risk without noise: a finite mixture.
//!
//! A tailored message lowers the risk in one context and raises it in the other, so that every risk that a phone holds
//! possible has two successors. While an episode runs, risks that would have ended it are dropped. Up to [`ATOMS`]
//! atoms, the mixture is exact.
//!
//! More successors are merged within cells about 1/[`ATOMS`] wide, none of which reaches across the risk from which a
//! wrong message ends the episode. Merging keeps the probability and the mean of a cell. A test compares the result
//! with a mixture of a hundred times as many atoms.

use pulp::Simd;

use super::contexts::Feature;
use super::evidence::Evidence;
use super::moments::{Block, Moments, SIDE, Sums};
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
/// Every array is \[atoms\], with place for [`SIDE`] more than `most`, because [`Mixture::append`] writes beyond the last
/// atom. Atoms without a weight, and risks beyond `count`, have no meaning, but all risks are in \[0, 1\].
#[derive(Clone, Debug)]
pub(super) struct Mixture {
    most: usize,
    /// The number of atoms that are in use, a multiple of [`SIDE`].
    count: usize,
    risk: Vec<f64>,
    /// The probabilities of a risk with context 0, and with context 1; their sum over `count` atoms is 1.
    weights: [Vec<f64>; 2],
}

/// The successors of the atoms of a mixture, and room to merge them.
#[derive(Clone, Debug)]
pub(super) struct Successors {
    /// By the context of the step.
    of: [Successor; 2],
    cells: Cells,
}

/// What follows if the step had a certain context; every array is \[atoms\], with place for as many as a mixture has.
#[derive(Clone, Debug)]
struct Successor {
    /// The number of atoms that are in use, a multiple of [`SIDE`].
    count: usize,
    risk: Vec<f64>,
    /// Probabilities up to a common factor.
    weight: Vec<f64>,
    /// Room for the cells of the risks, as numbers whose low bits are the cell.
    cell: Vec<f64>,
    /// Room for the products of risk and weight.
    product: Vec<f64>,
}

/// Sums within cells; every array is \[cells\], and 0 between steps.
#[derive(Clone, Debug)]
struct Cells {
    /// The weights of the successors of context 0, and of context 1.
    weights: [Vec<f64>; 2],
    product: Vec<f64>,
}

impl Mixture {
    /// A mixture of at most `most` atoms, before the first episode: a multiple of [`SIDE`] below 2^16.
    pub(super) fn new(most: usize) -> Self {
        debug_assert!(most > 0 && most.is_multiple_of(SIDE) && most < 1 << 16);
        let room = || vec![0.0; most + SIDE];
        let mut mixture = Mixture { most, count: SIDE, risk: room(), weights: [room(), room()] };
        mixture.begin(0.0, 0.5);
        mixture
    }

    /// Begins an episode at a risk, where context 0 has the probability `zero`.
    pub(super) fn begin(&mut self, risk: f64, zero: f64) {
        self.count = SIDE;
        self.risk[0] = risk;
        for (weights, weight) in self.weights.iter_mut().zip([zero, 1.0 - zero]) {
            weights[..SIDE].fill(0.0);
            weights[0] = weight;
        }
    }

    /// The risks that are possible, with their probabilities.
    #[cfg(test)]
    pub(super) fn atoms(&self) -> impl Iterator<Item = (f64, f64)> {
        let weights = self.weights[0].iter().zip(&self.weights[1]).map(|(zero, one)| zero + one);
        self.risk[..self.count].iter().copied().zip(weights).filter(|(_, weight)| *weight > 0.0)
    }

    /// Updates the mixture after a step, given the likelihoods of the contexts by the steps walked. Returns `None`,
    /// and leaves the mixture as it is, if nothing that it holds possible agrees with the evidence, which only merged
    /// atoms can bring about.
    #[inline(always)]
    pub(super) fn update<S: Simd>(
        &mut self,
        simd: S,
        dynamics: &Dynamics,
        seen: &Feature,
        steps: [f64; 2],
        evidence: &Evidence,
        room: &mut Successors,
    ) -> Option<Moments> {
        let ahead = [seen.ahead(0), seen.ahead(1)];
        for (context, successor) in room.of.iter_mut().enumerate() {
            let likelihood = steps[context] * ahead[context].0;
            successor.follow(simd, self, context, dynamics, likelihood, evidence);
        }
        let next = [ahead[0].1, ahead[1].1];
        let origin = room.origin()?;
        let [zero, one] = &room.of;
        let parts = [zero.sums(simd, dynamics, origin), one.sums(simd, dynamics, origin)];
        let sums = Sums::of_risk(origin, parts, [next[0][0], next[1][0]]);
        let moments = sums.moments()?;
        let scale = 1.0 / sums.weight();
        let [[a, b], [c, d]] = next;
        let next = [[a * scale, b * scale], [c * scale, d * scale]];
        if evidence.action == Action::NONE || evidence.action == Action::UNTAILORED {
            self.take(&room.of);
            self.look(next);
        } else if room.of[0].filled() + room.of[1].filled() <= self.most {
            self.append(&room.of);
            self.look(next);
        } else {
            room.merge(simd, dynamics, self.most);
            self.collect(simd, &mut room.cells, next);
        }
        Some(moments)
    }

    /// Takes successors that have the same risk in both contexts.
    #[inline(always)]
    fn take(&mut self, successors: &[Successor; 2]) {
        self.count = successors[0].count.max(successors[1].count);
        for (own, Successor { count, risk, weight, .. }) in self.weights.iter_mut().zip(successors)
        {
            self.risk[..*count].copy_from_slice(&risk[..*count]);
            own[..*count].copy_from_slice(&weight[..*count]);
            own[*count..self.count].fill(0.0);
        }
    }

    /// Takes the successors of both contexts that have a weight, of which there are at most `most`.
    ///
    /// Which have one is unpredictable, so the loop has no branches: the next successor replaces one without.
    #[inline(always)]
    fn append(&mut self, [zero, one]: &[Successor; 2]) {
        let room = self.risk.len();
        let (risks, [zeros, ones]) = (&mut self.risk[..], &mut self.weights);
        let (zeros, ones) = (&mut zeros[..room], &mut ones[..room]);
        let mut place = 0;
        for (risk, weight) in zero.risk[..zero.count].iter().zip(&zero.weight) {
            (risks[place], zeros[place], ones[place]) = (*risk, *weight, 0.0);
            place += usize::from(*weight > 0.0);
        }
        for (risk, weight) in one.risk[..one.count].iter().zip(&one.weight) {
            (risks[place], zeros[place], ones[place]) = (*risk, 0.0, *weight);
            place += usize::from(*weight > 0.0);
        }
        self.count = place.next_multiple_of(SIDE);
        zeros[place..self.count].fill(0.0);
        ones[place..self.count].fill(0.0);
    }

    /// Replaces the contexts of the step by the next contexts, given what a weight of each context of the step adds to
    /// the weights of the next.
    #[inline(always)]
    fn look(&mut self, next: [[f64; 2]; 2]) {
        let [zeros, ones] = &mut self.weights;
        for (zero, one) in zeros[..self.count].iter_mut().zip(ones) {
            let of = |then: usize| *zero * next[0][then] + *one * next[1][then];
            (*zero, *one) = (of(0), of(1));
        }
    }

    /// Takes the mean and the weights of every cell, replaces the contexts as [`Mixture::look`] does, and clears the
    /// cells.
    #[inline(always)]
    fn collect<S: Simd>(&mut self, simd: S, cells: &mut Cells, next: [[f64; 2]; 2]) {
        self.count = self.most;
        let [from_zero, from_one] = [splat(simd, next[0]), splat(simd, next[1])];
        let [none, full] = splat(simd, [0.0, 1.0]);
        let Mixture { most, risk, weights: [zero, one], .. } = self;
        let risk = registers::<S>(&mut risk[..*most]);
        let own = registers::<S>(zero).iter_mut().zip(registers::<S>(one)).zip(risk);
        let Cells { weights: [of_zero, of_one], product } = cells;
        let of = registers::<S>(of_zero).iter_mut().zip(registers::<S>(of_one));
        let of = of.zip(registers::<S>(product));
        for (((zero, one), risk), ((of_zero, of_one), product)) in own.zip(of) {
            let weight = simd.add_f64s(*of_zero, *of_one);
            // Rounding could take the mean of risks near 1 beyond it.
            let mean = simd.min_f64s(simd.div_f64s(*product, weight), full);
            *risk = simd.select_f64s(simd.greater_than_f64s(weight, none), mean, none);
            let then_zero = simd.mul_f64s(*of_zero, from_zero[0]);
            let then_one = simd.mul_f64s(*of_zero, from_zero[1]);
            *zero = simd.add_f64s(then_zero, simd.mul_f64s(*of_one, from_one[0]));
            *one = simd.add_f64s(then_one, simd.mul_f64s(*of_one, from_one[1]));
            (*of_zero, *of_one, *product) = (none, none, none);
        }
    }
}

/// Numbers in all lanes of a register each.
///
/// `array::map` takes a closure, and closures are not compiled for the instruction set.
#[inline(always)]
fn splat<S: Simd, const N: usize>(simd: S, numbers: [f64; N]) -> [S::f64s; N] {
    let mut all = [simd.splat_f64s(0.0); N];
    for (register, number) in all.iter_mut().zip(numbers) {
        *register = simd.splat_f64s(number);
    }
    all
}

/// The numbers as registers; a remainder is left out.
#[inline(always)]
fn registers<S: Simd>(numbers: &mut [f64]) -> &mut [S::f64s] {
    S::as_mut_simd_f64s(numbers).0
}

resumable!([] Mixture { parts count; fixed risk; each weights; check fits, "beliefs" });

impl Mixture {
    /// Whether the numbers of atoms and their risks are possible.
    fn fits(&self) -> bool {
        (1..=self.most).contains(&self.count)
            && self.count.is_multiple_of(SIDE)
            && self.weights.iter().all(|weights| weights.len() == self.risk.len())
            && self.risk.iter().all(|risk| (0.0..=1.0).contains(risk))
    }
}

impl Successor {
    fn new(most: usize) -> Self {
        let room = || vec![0.0; most];
        Successor { count: 0, risk: room(), weight: room(), cell: room(), product: room() }
    }

    /// Finds what follows a mixture after a step in a context, whose likelihood is given.
    #[inline(always)]
    fn follow<S: Simd>(
        &mut self,
        simd: S,
        mixture: &Mixture,
        context: usize,
        dynamics: &Dynamics,
        likelihood: f64,
        evidence: &Evidence,
    ) {
        self.count = mixture.count;
        let [factor, rise] = splat(simd, dynamics.annoyance(context as u8, evidence.action));
        let [low, high] = splat(simd, evidence.risks(dynamics));
        let [likelihood, least, none, full] = splat(simd, [likelihood, LEAST, 0.0, 1.0]);
        let count = mixture.count;
        let (risks, weights) = (&mixture.risk[..count], &mixture.weights[context][..count]);
        let from = S::as_simd_f64s(risks).0.iter().zip(S::as_simd_f64s(weights).0);
        let to = registers::<S>(&mut self.risk).iter_mut().zip(registers::<S>(&mut self.weight));
        for ((risk, weight), (to_risk, to_weight)) in from.zip(to) {
            let risk = simd.add_f64s(simd.mul_f64s(*risk, factor), rise);
            let risk = simd.min_f64s(risk, full);
            let weight = simd.mul_f64s(*weight, likelihood);
            let is_above = simd.greater_than_or_equal_f64s(risk, low);
            let is_allowed = simd.and_m64s(is_above, simd.less_than_f64s(risk, high));
            let is_kept = simd.and_m64s(is_allowed, simd.greater_than_f64s(weight, least));
            *to_weight = simd.select_f64s(is_kept, weight, none);
            *to_risk = risk;
        }
        // Many of the last risks of merged atoms are dropped, because the cells are in order.
        while let Some(last) = self.weight[..self.count].last_chunk::<SIDE>()
            && last.iter().fold(0, |bits, weight| bits | weight.to_bits()) == 0
        {
            self.count -= SIDE;
        }
    }

    /// The number of atoms with a weight.
    #[inline(always)]
    fn filled(&self) -> usize {
        self.weight[..self.count].iter().filter(|weight| **weight > 0.0).count()
    }

    /// The terms of [`Sums::of_risk`], with risks measured from `origin`.
    #[inline(always)]
    fn sums<S: Simd>(&self, simd: S, dynamics: &Dynamics, origin: f64) -> [Block; 4] {
        match S::F64_LANES {
            8 => self.sums_in::<S, 1>(simd, dynamics, origin),
            4 => self.sums_in::<S, 2>(simd, dynamics, origin),
            2 => self.sums_in::<S, 4>(simd, dynamics, origin),
            _ => self.sums_in::<S, SIDE>(simd, dynamics, origin),
        }
    }

    /// The same, with V registers for each sum, which hold its [`SIDE`] accumulators.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn sums_in<S: Simd, const V: usize>(
        &self,
        simd: S,
        dynamics: &Dynamics,
        origin: f64,
    ) -> [Block; 4] {
        let test = Near::of(simd, dynamics);
        let [origin, none] = splat(simd, [origin, 0.0]);
        let mut sums = [[none; V]; 4];
        let risks = self.risk[..self.count].chunks_exact(SIDE);
        for (risk, weight) in risks.zip(self.weight.chunks_exact(SIDE)) {
            let (risk, weight) = (S::as_simd_f64s(risk).0, S::as_simd_f64s(weight).0);
            for v in 0..V {
                let distance = simd.sub_f64s(risk[v], origin);
                let first = simd.mul_f64s(weight[v], distance);
                let near = simd.select_f64s(test.is(risk[v]), weight[v], none);
                sums[0][v] = simd.add_f64s(sums[0][v], weight[v]);
                sums[1][v] = simd.add_f64s(sums[1][v], near);
                sums[2][v] = simd.add_f64s(sums[2][v], first);
                sums[3][v] = simd.add_f64s(sums[3][v], simd.mul_f64s(first, distance));
            }
        }
        let mut blocks = [[0.0; SIDE]; 4];
        for (block, sums) in blocks.iter_mut().zip(sums) {
            S::as_mut_simd_f64s(block).0.copy_from_slice(&sums);
        }
        blocks
    }

    /// Finds the cells of all risks, which are below `most`, and the products of risk and weight.
    #[inline(always)]
    fn place<S: Simd>(&mut self, simd: S, dynamics: &Dynamics, most: usize) {
        let cut = dynamics.disengagement_threshold - dynamics.epsilon_d;
        let cells = (most - 3) as f64;
        // Half a cell turns the nearest whole number into the next lower one.
        let lowest = (-cut * cells).floor() + 0.5;
        let near = Near::of(simd, dynamics);
        let [cut, cells, lowest] = splat(simd, [cut, cells, lowest]);
        let [none, one] = splat(simd, [0.0, 1.0]);
        let Successor { count, risk, weight, cell, product } = self;
        let from = S::as_simd_f64s(risk).0.iter().zip(S::as_simd_f64s(weight).0);
        let cells_of = registers::<S>(&mut cell[..*count]).iter_mut();
        let to = cells_of.zip(registers::<S>(product));
        for ((cell, product), (risk, weight)) in to.zip(from) {
            let place = simd.mul_f64s(simd.sub_f64s(*risk, cut), cells);
            let place = math::nearest(simd, simd.sub_f64s(place, lowest));
            *cell = simd.add_f64s(place, simd.select_f64s(near.is(*risk), one, none));
            *product = simd.mul_f64s(*risk, *weight);
        }
    }
}

/// The test [`is_near`](super::moments::is_near) in registers.
#[derive(Clone, Copy)]
struct Near<S: Simd> {
    simd: S,
    rise: S::f64s,
    threshold: S::f64s,
    full: S::f64s,
}

impl<S: Simd> Near<S> {
    #[inline(always)]
    fn of(simd: S, dynamics: &Dynamics) -> Self {
        let Dynamics { epsilon_d, disengagement_threshold, .. } = *dynamics;
        let [rise, threshold, full] = splat(simd, [epsilon_d, disengagement_threshold, 1.0]);
        Near { simd, rise, threshold, full }
    }

    #[inline(always)]
    fn is(&self, risk: S::f64s) -> S::m64s {
        let annoyed = self.simd.min_f64s(self.simd.add_f64s(risk, self.rise), self.full);
        self.simd.greater_than_or_equal_f64s(annoyed, self.threshold)
    }
}

impl Successors {
    /// Room for the successors of mixtures of at most `most` atoms.
    pub(super) fn new(most: usize) -> Self {
        let room = || vec![0.0; most];
        Successors {
            of: [Successor::new(most), Successor::new(most)],
            cells: Cells { weights: [room(), room()], product: room() },
        }
    }

    /// The first risk that has a weight, if there is one.
    #[inline(always)]
    fn origin(&self) -> Option<f64> {
        let mut all = self.of.iter().flat_map(|of| of.risk[..of.count].iter().zip(&of.weight));
        all.find(|(_, weight)| **weight > 0.0).map(|(risk, _)| *risk)
    }

    /// Sums the successors of both contexts within at most `most` cells.
    #[inline(always)]
    fn merge<S: Simd>(&mut self, simd: S, dynamics: &Dynamics, most: usize) {
        let Cells { weights, product: products } = &mut self.cells;
        for (weights, successor) in weights.iter_mut().zip(&mut self.of) {
            successor.place(simd, dynamics, most);
            // Of equal lengths, so that a single check of the bounds is enough.
            let (weights, products) = (&mut weights[..most], &mut products[..most]);
            let Successor { count, weight, cell, product, .. } = successor;
            for ((cell, weight), product) in cell[..*count].iter().zip(weight).zip(product) {
                let cell = math::low_bits(*cell);
                weights[cell] += *weight;
                products[cell] += *product;
            }
        }
    }
}
