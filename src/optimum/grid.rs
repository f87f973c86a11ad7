//! Values of states on a grid of habituation and disengagement risk, and backward induction on it.
//!
//! The value is continuous in habituation and jumps in disengagement risk: a wrong message ends the
//! episode from threshold - epsilon_d on. Every jump is carried to the states that lead to it, by
//! decay or by an increment, and there it is as large or smaller. The grid has a line at each of the
//! largest, so that nothing is interpolated across them. In habituation, an increment leads from line
//! to line, and what a decay leads to is interpolated by cubics. Where episodes hardly come, there are
//! fewer lines: what a policy loses depends on the values that it meets.
//!
//! Where disengagement risk never decays, the few levels that it can have are the grid.

use std::array;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::iter;
use std::mem;
use std::ops::Range;

use pulp::{Simd, WithSimd};
use rayon::iter::{IndexedParallelIterator, IntoParallelIterator, ParallelIterator};

use crate::env::{Action, Belief, Effect, apply_action};
use crate::env::{Environment, FirstContext};
use crate::kernel::Isa;

use super::Prospects;
use super::axis::{Among, Axis, Place, Side};
use super::expectation::Expectation;

/// Jumps nearer to each other than this are one.
const APART: f64 = 1e-9;
/// How much smaller a jump becomes by a wrong message, in suitable ones: what it is worth to be
/// followed.
const DECAYS_A_MISTAKE: u32 = 7;
/// How much shorter than the steps that are asked for those may be that a decay leads along.
const SHORTEST_STEP: f64 = 0.25;
/// How far the steps before a step may still differ from it in what they add, for the induction to
/// take them as equal: in units ([`Grid::unit`]) for a step of the horizon, and in all. The policy that
/// does so loses far less: its choices are the best but where two are nearly as good.
pub(super) const SETTLED: f64 = 0.001;
const SETTLED_IN_ALL: f64 = 0.5;
/// How much farther the mean steps of a stretch may differ, for it to be worth to take their ripple
/// away.
const WORTH_SMOOTHING: f64 = 10.0;
/// Fewest layers that are tried as a stretch.
const SHORTEST_STRETCH: u32 = 40;
/// The largest reward of a step by the paper's parameters, in steps walked.
const USUAL_REWARD: f64 = 200.0;

/// How many times coarser a grid is elsewhere than in the region where it is fine: as many as leave it
/// enough steps.
const TIMES_COARSER: [usize; 2] = [4, 2];
/// How many are enough: of habituation and of disengagement risk.
pub(super) const COARSEST: [usize; 2] = [20, 75];

/// Rows whose values are computed at once.
const AT_ONCE: usize = 8;
/// Rows that are blended at once.
const BLENDED_AT_ONCE: usize = 4;
/// Values of a layer for which it is worth to wake a thread.
const WORTH_A_THREAD: usize = 2_000;

/// A number for each of some neighbouring rows.
pub(super) type Lanes = [f64; AT_ONCE];

/// A variable of the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Variable {
    Habituation,
    Disengagement,
}

/// The states with a habituation and a disengagement risk from one number to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Region {
    pub habituation: [f64; 2],
    pub disengagement: [f64; 2],
}

impl Region {
    /// All states.
    pub const ALL: Region = Region { habituation: [0.0, 1.0], disengagement: [0.0, 1.0] };
}

/// How fine a grid is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Resolution {
    /// Fewest steps of habituation from 0 to 1.
    pub habituation: usize,
    /// Steps of disengagement risk from 0 to the threshold, or so: see [`lines`].
    pub disengagement: usize,
    /// Most jumps of the value that have a line of their own.
    pub jumps: usize,
    /// How many [`levels`] of disengagement risk there are, if the grid has those alone, and no steps
    /// and jumps; else 0.
    pub levels: usize,
    /// Where it is that fine. Elsewhere it has up to four times fewer steps and jumps.
    pub region: Region,
}

impl Resolution {
    /// The variables that have steps.
    pub fn variables(self) -> &'static [Variable] {
        match self.disengagement {
            0 => &[Variable::Habituation],
            _ => &[Variable::Disengagement, Variable::Habituation],
        }
    }

    /// Twice as fine in one variable.
    fn finer_in(self, variable: Variable) -> Resolution {
        match variable {
            Variable::Habituation => Resolution { habituation: 2 * self.habituation, ..self },
            Variable::Disengagement => {
                let Resolution { disengagement, jumps, .. } = self;
                Resolution { disengagement: 2 * disengagement, jumps: 2 * jumps, ..self }
            }
        }
    }

    /// As fine in one variable as it takes in an environment for more lines than these: those of
    /// habituation stay where its increments are shorter than the steps that are asked for.
    pub fn with_more_lines(self, variable: Variable, environment: &Environment) -> Resolution {
        let lines = |resolution: Resolution| match variable {
            Variable::Habituation => resolution.habituation_axis(environment).nodes().len(),
            Variable::Disengagement => resolution.disengagement_axis(environment).nodes().len(),
        };
        let (mut finer, fewest) = (self.finer_in(variable), lines(self));
        while lines(finer) <= fewest {
            finer = finer.finer_in(variable);
        }
        finer
    }

    /// Whether it is coarser than another in habituation or in disengagement risk.
    pub fn is_coarser_in_one(self, other: Resolution) -> bool {
        self.habituation < other.habituation || self.disengagement < other.disengagement
    }

    /// Twice as fine in every variable.
    pub fn refined(self) -> Resolution {
        self.variables().iter().fold(self, |finer, variable| finer.finer_in(*variable))
    }

    /// How many times coarser it is elsewhere, where it has so many steps and `coarsest` are fewest.
    fn times_coarser(self, steps: usize, coarsest: usize) -> usize {
        if self.region == Region::ALL {
            return 1;
        }
        TIMES_COARSER.into_iter().find(|times| steps / times >= coarsest).unwrap_or(1)
    }

    fn habituation_axis(self, environment: &Environment) -> Axis {
        let times = self.times_coarser(self.habituation, COARSEST[0]);
        Axis::with_stride(environment.epsilon_h, self.habituation, self.region.habituation, times)
    }

    fn disengagement_axis(self, e: &Environment) -> Axis {
        let threshold = e.disengagement_threshold;
        match levels(e, self.levels) {
            Some(levels) => Axis::through(levels, threshold),
            None => {
                let times = self.times_coarser(self.disengagement, COARSEST[1]);
                let [from, to] = self.region.disengagement;
                let is_inside = |x: &f64| (from..=to).contains(x);
                let of_both = |fine: Vec<f64>, coarse: Vec<f64>| -> Vec<f64> {
                    let inside = fine.into_iter().filter(is_inside);
                    inside.chain(coarse.into_iter().filter(|x| !is_inside(x))).collect()
                };
                let steps = self.disengagement;
                let lines = of_both(lines(e, steps), lines(e, steps / times));
                let jumps = of_both(jumps(e, self.jumps), jumps(e, self.jumps / times));
                Axis::with_jumps(threshold, &lines, &jumps, APART)
            }
        }
    }
}

/// What a step adds to the values: the least and the most of all states.
#[derive(Clone, Copy, Debug)]
struct Added {
    least: f64,
    most: f64,
}

impl Added {
    const ANYTHING: Added = Added { least: f64::NEG_INFINITY, most: f64::INFINITY };
    const NOTHING: Added = Added { least: f64::INFINITY, most: f64::NEG_INFINITY };

    fn by(isa: Isa, later: &[Lanes], now: &[Lanes]) -> Added {
        let [added, _] = isa.run(Tally { later: [later, &[]], now, sum: &mut [] });
        added
    }

    #[inline(always)]
    fn by_vectors<S: Simd>(simd: S, later: &[Lanes], now: &[Lanes]) -> Added {
        let [(later, _), (now, _)] =
            [S::as_simd_f64s(later.as_flattened()), S::as_simd_f64s(now.as_flattened())];
        let mut least = simd.splat_f64s(Added::NOTHING.least);
        let mut most = simd.splat_f64s(Added::NOTHING.most);
        for (later, now) in later.iter().zip(now) {
            let added = simd.sub_f64s(*now, *later);
            least = simd.min_f64s(least, added);
            most = simd.max_f64s(most, added);
        }
        Added { least: simd.reduce_min_f64s(least), most: simd.reduce_max_f64s(most) }
    }

    /// What further steps add is between the two as well; below 0, between them and 0.
    fn and_further(self) -> Added {
        if self.least < 0.0 { self.or(Added { least: 0.0, most: 0.0 }) } else { self }
    }

    fn or(self, other: Added) -> Added {
        let least = if other.least < self.least { other.least } else { self.least };
        Added { least, most: if other.most > self.most { other.most } else { self.most } }
    }

    fn spread(self) -> f64 {
        self.most - self.least
    }

    fn middle(self) -> f64 {
        (self.least + self.most) / 2.0
    }
}

/// What some values of a layer are more than those of each of two later ones. They are added to a sum.
/// The second of those and the sum may be empty, for nothing.
struct Tally<'a> {
    later: [&'a [Lanes]; 2],
    now: &'a [Lanes],
    sum: &'a mut [Lanes],
}

impl WithSimd for Tally<'_> {
    type Output = [Added; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [Added; 2] {
        let Tally { later: [one, other], now, sum } = self;
        let (vectors, _) = S::as_simd_f64s(now.as_flattened());
        let (sum, _) = S::as_mut_simd_f64s(sum.as_flattened_mut());
        for (sum, now) in sum.iter_mut().zip(vectors) {
            *sum = simd.add_f64s(*sum, *now);
        }
        [Added::by_vectors(simd, one, now), Added::by_vectors(simd, other, now)]
    }
}

/// Backward induction under way.
#[derive(Clone, Debug)]
struct Course {
    /// The last layer.
    values: Vec<Lanes>,
    /// Room for the next.
    next: Vec<Lanes>,
    /// What the last step added.
    added: Added,
    /// The last layers in a row, if their mean is asked for.
    stretch: Option<Stretch>,
}

/// Layers in a row.
#[derive(Clone, Debug)]
struct Stretch {
    /// How many.
    layers: u32,
    /// The layer before them.
    before: Vec<Lanes>,
    /// Their sum.
    sum: Vec<Lanes>,
    /// What they added.
    added: Added,
}

impl Course {
    fn new(values: Vec<Lanes>) -> Course {
        Course { next: values.clone(), values, added: Added::ANYTHING, stretch: None }
    }

    /// Computes the next layer; what this step and the one before it add, and further ones.
    fn step(&mut self, grid: &Grid) -> Added {
        let (later, part) = (&self.values, grid.part());
        let parts = later.chunks(part).zip(self.next.chunks_mut(part));
        let stretches: Vec<Option<_>> = match &mut self.stretch {
            Some(Stretch { before, sum, .. }) => {
                before.chunks(part).zip(sum.chunks_mut(part)).map(Some).collect()
            }
            None => later.chunks(part).map(|_| None).collect(),
        };
        let parts = parts.zip(stretches).enumerate();
        let added = in_parallel(parts, |(i, ((part_of_later, now), mut stretch))| {
            let mut by_both = [Added::NOTHING; 2];
            // While they are in the nearest caches.
            grid.part_back(i * part, later, now, |range, now| {
                let (before, sum): (&[Lanes], &mut [Lanes]) = match &mut stretch {
                    Some((before, sum)) => (&before[range.clone()], &mut sum[range.clone()]),
                    None => (&[], &mut []),
                };
                let later = [&part_of_later[range], before];
                let added = grid.isa.run(Tally { later, now, sum });
                by_both = array::from_fn(|which| by_both[which].or(added[which]));
            });
            by_both
        });
        let all = |which: usize| {
            added.iter().fold(Added::NOTHING, |all, part| all.or(part[which])).and_further()
        };
        if let Some(stretch) = &mut self.stretch {
            stretch.layers += 1;
            stretch.added = all(1);
        }
        let added_before = mem::replace(&mut self.added, all(0));
        mem::swap(&mut self.values, &mut self.next);
        self.added.or(added_before)
    }

    /// Begins to count layers anew.
    fn begin_stretch(&mut self) {
        let stretch = self.stretch.get_or_insert_with(|| Stretch {
            layers: 0,
            before: self.values.clone(),
            sum: self.values.clone(),
            added: Added::ANYTHING,
        });
        stretch.layers = 0;
        stretch.before.copy_from_slice(&self.values);
        stretch.sum.fill([0.0; AT_ONCE]);
    }
}

impl Stretch {
    /// What a step adds in the mean, and further ones.
    fn added_in_mean(&self) -> Added {
        let (Added { least, most }, steps) = (self.added, f64::from(self.layers));
        Added { least: least / steps, most: most / steps }
    }

    /// The mean of the layers.
    fn mean(&self) -> Vec<Lanes> {
        self.sum.iter().map(|sums| sums.map(|sum| sum / f64::from(self.layers))).collect()
    }
}

/// The states that have a value, and where actions lead from them.
///
/// **Shapes**: a layer of values is \[rows in groups, disengagement, row of the group\], where rows are
/// those of habituation, in groups of [`AT_ONCE`]; where the last group has fewer, its last row stands
/// for those that it lacks.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Its baseline rewards are 0: they are the same whatever is done.
    environment: Environment,
    pub belief: Belief,
    /// What layers and signals are compiled for; it makes no difference to them.
    pub isa: Isa,
    /// Most threads that compute.
    pub threads: usize,
    /// How far the steps before a step may differ from it in what they add, in all and in units.
    pub settled: f64,
    /// How many steps are computed before a first stretch of them begins.
    pub stretches_after: u32,
    baseline: [f64; 2],
    expectation: Expectation,
    habituation: Axis,
    disengagement: Axis,
    groups: Vec<Group>,
    columns: Vec<Column>,
}

/// Where the states of some neighbouring rows lead.
#[derive(Clone, Debug)]
struct Group {
    messaged: Blend,
    rested: Blend,
    /// Reward of an untailored and of a suitable message, the baseline aside.
    untailored: Lanes,
    suitable: Lanes,
}

/// Sums of rows, one for each of a group: of some rows, each by so much for each of the group.
#[derive(Clone, Debug)]
struct Blend {
    parts: Vec<Part>,
}

/// Rows that are blended at once, and by how much for each of a group.
#[derive(Clone, Copy, Debug)]
struct Part {
    rows: [usize; BLENDED_AT_ONCE],
    shares: [Lanes; BLENDED_AT_ONCE],
}

impl Blend {
    /// The rows of places.
    fn new(places: [Among; AT_ONCE]) -> Blend {
        let of_each = places.iter().flat_map(|place| (place.node..).zip(place.weights));
        let with_weight = of_each.filter(|(_, weight)| *weight != 0.0);
        let mut rows: Vec<usize> = with_weight.map(|(row, _)| row).collect();
        rows.sort_unstable();
        rows.dedup();
        let share = |row: usize| {
            places.map(|place| {
                let which = row.checked_sub(place.node);
                which.and_then(|i| place.weights.get(i)).copied().unwrap_or(0.0)
            })
        };
        let part = |rows: &[usize]| Part {
            // By nothing of the last, where they are too few.
            rows: array::from_fn(|j| rows[j.min(rows.len() - 1)]),
            shares: array::from_fn(|j| rows.get(j).map_or([0.0; AT_ONCE], |row| share(*row))),
        };
        Blend { parts: rows.chunks(BLENDED_AT_ONCE).map(part).collect() }
    }

    /// The sums in a layer, for each of its columns. Without fused operations.
    ///
    /// By vectors of the instruction set: left to itself, the compiler gathers columns.
    #[inline(always)]
    fn of<S: Simd>(&self, simd: S, layer: &[Lanes], out: &mut [Lanes]) {
        let columns = out.len();
        let vectors = AT_ONCE / S::F64_LANES;
        let (out, _) = S::as_mut_simd_f64s(out.as_flattened_mut());
        for (i, Part { rows, shares }) in self.parts.iter().enumerate() {
            let shares = shares.each_ref().map(|shares| S::as_simd_f64s(shares).0);
            let rows = rows.map(|row| {
                let group: &[Lanes] = &layer[row / AT_ONCE * columns..][..columns];
                (group, row % AT_ONCE)
            });
            for vector in 0..vectors {
                let shares = shares.map(|shares| shares[vector]);
                for column in 0..columns {
                    let out = &mut out[column * vectors + vector];
                    let term = |j: usize| {
                        let (group, lane) = rows[j];
                        simd.mul_f64s(shares[j], simd.splat_f64s(group[column][lane]))
                    };
                    let mut sum = if i == 0 { term(0) } else { simd.add_f64s(*out, term(0)) };
                    for j in 1..BLENDED_AT_ONCE {
                        sum = simd.add_f64s(sum, term(j));
                    }
                    *out = sum;
                }
            }
        }
    }
}

/// Where the states of one disengagement risk lead.
#[derive(Clone, Copy, Debug)]
struct Column {
    calmed: Place,
    /// `None` where the episode ends.
    annoyed: Option<Place>,
}

impl Grid {
    /// The grid of an environment, for a policy that knows so much of the context.
    pub fn new(environment: &Environment, belief: Belief, resolution: Resolution) -> Grid {
        let e = &Environment { mu: [0.0; 2], ..environment.clone() };
        let habituation = resolution.habituation_axis(e);
        let threshold = e.disengagement_threshold;
        // Levels are what episodes meet, to the last bit.
        let rounding = if resolution.levels > 0 { 0.0 } else { APART / 2.0 };
        let disengagement = resolution.disengagement_axis(e);
        let groups = habituation.nodes().chunks(AT_ONCE);
        let group = |nodes: &[f64]| {
            // The last stands for those that are not there.
            let nodes: Lanes = array::from_fn(|r| nodes[r.min(nodes.len() - 1)]);
            let of = |action| nodes.map(|h| apply_action(e, 0, action, h, 0.0));
            let [nothing, untailored, suitable] =
                [Action::NONE, Action::UNTAILORED, Action::tailored_to(0)].map(of);
            let blend = |to: [Effect; AT_ONCE]| {
                Blend::new(to.map(|effect| habituation.among(effect.habituation)))
            };
            Group {
                messaged: blend(suitable),
                rested: blend(nothing),
                untailored: untailored.map(|effect| effect.reward),
                suitable: suitable.map(|effect| effect.reward),
            }
        };
        let groups = groups.map(group).collect();
        let column = |(node, d): (usize, &f64)| {
            let side = disengagement.side(node);
            let calm = apply_action(e, 0, Action::tailored_to(0), 0.0, *d).disengagement;
            // Without the cap at 1, at which a limit from below could not be told.
            let annoyed = d + e.epsilon_d;
            let ends = match side {
                Side::At => annoyed >= threshold - rounding,
                Side::Below => annoyed > threshold + rounding,
            };
            let annoyed = (!ends).then(|| disengagement.place(annoyed, side));
            Column { calmed: disengagement.place(calm, side), annoyed }
        };
        let columns = disengagement.nodes().iter().enumerate().map(column).collect();
        let (environment, baseline) = (e.clone(), environment.mu);
        let expectation = Expectation::new(belief);
        Grid {
            environment,
            belief,
            isa: Isa::chosen(),
            threads: 1,
            stretches_after: 0,
            settled: f64::min(SETTLED_IN_ALL, SETTLED * f64::from(e.horizon)),
            baseline,
            expectation,
            habituation,
            disengagement,
            groups,
            columns,
        }
    }

    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// The states that have a node of their own, limits aside.
    #[cfg(test)]
    pub fn states(&self) -> Vec<[f64; 2]> {
        let is_limit = |column: usize| self.disengagement.side(column) == Side::Below;
        let columns = self.disengagement.nodes().iter().enumerate();
        let of_column = |(column, d): (usize, &f64)| (!is_limit(column)).then_some(*d);
        let columns: Vec<f64> = columns.filter_map(of_column).collect();
        let of_row = |h: &f64| columns.iter().map(|d| [*h, *d]).collect::<Vec<_>>();
        self.habituation.nodes().iter().flat_map(of_row).collect()
    }

    /// What differences are measured by: a step walked, or less where messages bring less than the
    /// paper's.
    pub fn unit(&self) -> f64 {
        let reward = self.environment.rho_1.abs().max(self.environment.rho_2.abs());
        (reward / USUAL_REWARD).clamp(1e-9, 1.0)
    }

    /// How many values a layer has.
    pub fn nodes(&self) -> usize {
        self.groups.len() * self.columns.len() * AT_ONCE
    }

    /// The values of episodes that have ended.
    pub fn zeros(&self) -> Vec<Lanes> {
        vec![[0.0; AT_ONCE]; self.groups.len() * self.columns.len()]
    }

    /// Computes the values with 0, 1, 2, … steps left, at most one fewer than the horizon, and shows
    /// `see` each layer. They end sooner if the steps before them would all add the same.
    ///
    /// Where the best choices nearly repeat after some steps, what a step adds settles much later
    /// than what it adds in the mean over a stretch of steps. Then the mean values of the stretch,
    /// which have no such ripple, are taken further until a step of theirs settles.
    pub fn induce(&self, mut see: impl FnMut(u32, &[Lanes])) -> Induced {
        let most_left = self.environment.horizon - 1;
        let mut course = Course::new(self.zeros());
        see(0, &course.values);
        let (mut smoothed, mut next_try) = (0, 0);
        for left in 1..=most_left {
            if left > self.stretches_after
                && course.stretch.as_ref().is_none_or(|s| s.layers > SHORTEST_STRETCH.max(left / 4))
            {
                course.begin_stretch();
            }
            let added = course.step(self);
            see(left, &course.values);
            if self.is_settled(added, most_left - left) {
                let (layer, gain) = (course.values, added.middle());
                return Induced { left, layer, gain, smoothed };
            }
            let Some(stretch) = &course.stretch else {
                continue;
            };
            let is_promising = stretch.added_in_mean().spread() * f64::from(most_left - left)
                < WORTH_SMOOTHING * self.allowed();
            if left >= next_try && stretch.layers >= SHORTEST_STRETCH && is_promising {
                let (steps, smooth) = self.smooth(&course.values, stretch, left);
                smoothed += steps;
                if let Some((layer, gain)) = smooth {
                    return Induced { left, layer, gain, smoothed };
                }
                next_try = 2 * left;
            }
        }
        Induced { left: most_left, layer: course.values, gain: 0.0, smoothed }
    }

    /// Takes the mean values of a stretch further, at most half as many steps as are `left`, and no more
    /// than that can save, until the steps before them would all add the same; every as many steps as
    /// the stretch has, their mean is taken again. How many steps that took, and the values on the level
    /// of the stretch's last, unless they are too far from those, with what each step before them adds.
    fn smooth(
        &self,
        last: &[Lanes],
        stretch: &Stretch,
        left: u32,
    ) -> (u32, Option<(Vec<Lanes>, f64)>) {
        let mut smooth = Course::new(stretch.mean());
        let rest = self.environment.horizon - 1 - left;
        let most = rest.min(left / 2);
        for steps in 1..=most {
            if steps % stretch.layers == 1 {
                if let Some(stretch) = &smooth.stretch {
                    smooth = Course::new(stretch.mean());
                }
                smooth.begin_stretch();
            }
            let added = smooth.step(self);
            if self.is_settled(added, rest) {
                let apart = Added::by(self.isa, &smooth.values, last);
                let level = |values: &Lanes| values.map(|value| value + apart.middle());
                let values = smooth.values.iter().map(level).collect();
                // The policy that goes over from the ones to the others does not choose when.
                let is_near = apart.spread() < self.allowed();
                return (steps, is_near.then_some((values, added.middle())));
            }
        }
        (most, None)
    }

    /// Whether so many steps that add so much may be taken to add the same.
    ///
    /// Two steps that both add g >= 0 to every value show that: the second step's best choices would
    /// add less if they could end the episode, so they never do, and go on adding g. What lies below
    /// 0 is added less and less, as episodes end.
    fn is_settled(&self, added: Added, steps: u32) -> bool {
        added.spread() * f64::from(steps) < self.allowed()
    }

    /// How far the steps before a step may differ from it in what they add, in all.
    fn allowed(&self) -> f64 {
        self.settled * self.unit()
    }

    /// The values one step earlier.
    pub fn step_back(&self, later: &[Lanes], now: &mut [Lanes]) {
        let part = self.part();
        let parts = now.chunks_mut(part).enumerate();
        in_parallel(parts, |(i, now)| self.part_back(i * part, later, now, |_, _| ()));
    }

    /// How much of a layer a thread computes: some groups of rows, so that there is work for no more
    /// threads than groups.
    fn part(&self) -> usize {
        let threads = self.threads.min(self.nodes() / WORTH_A_THREAD).max(1);
        self.groups.len().div_ceil(threads) * self.columns.len()
    }

    /// The values of some groups one step earlier, the first of which begins at `from`. Shows `see`
    /// each group, and where in `now` it stands.
    fn part_back(
        &self,
        from: usize,
        later: &[Lanes],
        now: &mut [Lanes],
        mut see: impl FnMut(Range<usize>, &[Lanes]),
    ) {
        let columns = self.columns.len();
        let groups = &self.groups[from / columns..];
        let mut messaged = vec![[0.0; AT_ONCE]; columns];
        let mut start = 0;
        for (group, now) in groups.iter().zip(now.chunks_mut(columns)) {
            self.isa.run(GroupBack { grid: self, group, later, messaged: &mut messaged, now });
            see(start..start + columns, now);
            start += columns;
        }
    }

    /// The value of a state; 0 where the episode has ended.
    pub fn value(&self, values: Moment<'_>, habituation: f64, disengagement: f64) -> f64 {
        if disengagement >= self.environment.disengagement_threshold {
            return 0.0;
        }
        let rows = self.habituation.among(habituation);
        let columns = self.columns.len();
        let column = self.disengagement.place(disengagement, Side::At);
        let of_row = |i: usize| {
            let (group, lane) = ((rows.node + i) / AT_ONCE, (rows.node + i) % AT_ONCE);
            let group = &values.layer[group * columns..][..columns];
            column.between(group[column.node][lane], group[column.node + 1][lane])
        };
        rows.of(array::from_fn(of_row)) + values.more
    }

    /// What each choice brings in a state, given the values of the states after it.
    pub fn prospects(&self, later: Moment<'_>, habituation: f64, disengagement: f64) -> Prospects {
        self.prospects_by(|h, d| self.value(later, h, d), habituation, disengagement)
    }

    /// [`Grid::prospects`], given what tells the values of the states after it.
    pub fn prospects_by(
        &self,
        later: impl Fn(f64, f64) -> f64,
        habituation: f64,
        disengagement: f64,
    ) -> Prospects {
        let values = self.states_after(habituation, disengagement).map(|[h, d]| later(h, d));
        self.prospects_of(values, habituation, disengagement)
    }

    /// The states after a state, \[habituation, disengagement risk\]: where nothing is sent, after a
    /// message that suits or is not tailored, and after one that does not suit.
    pub fn states_after(&self, habituation: f64, disengagement: f64) -> [[f64; 2]; 3] {
        [Action::NONE, Action::tailored_to(0), Action::tailored_to(1)].map(|action| {
            let effect = apply_action(&self.environment, 0, action, habituation, disengagement);
            [effect.habituation, effect.disengagement]
        })
    }

    /// Which of [`Grid::states_after`] an action leads to.
    pub fn led_to(context: u8, action: Action) -> usize {
        if action == Action::NONE {
            0
        } else if [Action::UNTAILORED, Action::tailored_to(context)].contains(&action) {
            1
        } else {
            2
        }
    }

    /// [`Grid::prospects`], given the values of [`Grid::states_after`].
    pub fn prospects_of(
        &self,
        [rested, calmed, annoyed]: [f64; 3],
        habituation: f64,
        disengagement: f64,
    ) -> Prospects {
        let reward =
            |action| apply_action(&self.environment, 0, action, habituation, disengagement).reward;
        Prospects {
            nothing: reward(Action::NONE) + rested,
            untailored: reward(Action::UNTAILORED) + calmed,
            suitable: reward(Action::tailored_to(0)) + calmed,
            unsuitable: reward(Action::tailored_to(1)) + annoyed,
        }
    }

    /// The mean return of the best choices from the start of an episode on, given what each brings
    /// there.
    pub fn mean_return(&self, start: &Prospects) -> f64 {
        match self.environment.first_context {
            FirstContext::Fixed => self.baseline[0] + Expectation::Certain.of_best(start),
            FirstContext::Sampled => self.mean_of_best(start),
        }
    }

    /// The mean value of the best choice where it is made on the signal of a context that is drawn.
    pub fn mean_of_best(&self, prospects: &Prospects) -> f64 {
        self.baseline() + self.expectation.of_best(prospects)
    }

    /// Mean baseline reward of a step whose context is drawn.
    fn baseline(&self) -> f64 {
        (self.baseline[0] + self.baseline[1]) / 2.0
    }
}

/// The values of a group of rows one step earlier.
struct GroupBack<'a> {
    grid: &'a Grid,
    group: &'a Group,
    later: &'a [Lanes],
    /// Room for what a message leads to, for each column.
    messaged: &'a mut [Lanes],
    now: &'a mut [Lanes],
}

impl WithSimd for GroupBack<'_> {
    type Output = ();

    /// Compiled for the instruction set, which takes lanes as registers. Without fused operations, so
    /// that each number is what it would be alone.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let GroupBack { grid, group, later, messaged, now } = self;
        let Group { untailored, suitable, .. } = group;
        group.rested.of(simd, later, now);
        group.messaged.of(simd, later, messaged);
        let baseline = grid.baseline();
        for (column, now) in grid.columns.iter().zip(now) {
            let calm = column.calmed.of_each(messaged);
            let annoyed = column.annoyed.map_or([0.0; AT_ONCE], |place| place.of_each(messaged));
            let best = grid.expectation.of_best_each(
                *now,
                array::from_fn(|r| untailored[r] + calm[r]),
                array::from_fn(|r| suitable[r] + calm[r]),
                annoyed,
            );
            *now = best.map(|value| baseline + value);
        }
    }
}

/// Values with one number of steps left.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment<'a> {
    /// Those of the nodes.
    pub layer: &'a [Lanes],
    /// What all of them are more than that.
    pub more: f64,
}

/// The values of the most steps left that were computed.
#[derive(Clone, Debug)]
pub(super) struct Induced {
    /// Steps that are left.
    pub left: u32,
    pub layer: Vec<Lanes>,
    /// What each step before them adds; of no meaning if there is none.
    pub gain: f64,
    /// How many steps more were computed of means over stretches.
    pub smoothed: u32,
}

impl Induced {
    /// The values with so many steps left, which are at least as many as these have.
    pub fn before(&self, left: u32) -> Moment<'_> {
        Moment { layer: &self.layer, more: f64::from(left - self.left) * self.gain }
    }
}

/// The disengagement risks below the threshold that an episode can meet, increasing, where the risk
/// never decays: the first and what increments lead to, rounded as in an episode. `None` if it decays,
/// or if they are none, more than `most`, or too near to each other.
pub(super) fn levels(e: &Environment, most: usize) -> Option<Vec<f64>> {
    if e.delta_d != 0.0 {
        return None;
    }
    let annoyed = |d: &f64| Some(apply_action(e, 0, Action::tailored_to(1), 0.0, *d).disengagement);
    let met = iter::successors(Some(e.initial_disengagement), annoyed);
    let is_below = |d: &f64| *d < e.disengagement_threshold;
    let mut levels: Vec<f64> = met.take_while(is_below).take(most + 1).collect();
    // An increment may be nothing.
    levels.dedup();
    // Nearer ones would have one node.
    let are_apart = levels.windows(2).all(|pair| pair[1] - pair[0] > APART);
    (are_apart && (1..=most).contains(&levels.len())).then_some(levels)
}

/// The disengagement risk from which on a wrong message ends the episode.
fn danger(e: &Environment) -> f64 {
    (e.disengagement_threshold - e.epsilon_d).max(0.0)
}

/// How many lines lead from one to its decay, in steps of at most the threshold / `steps` up to where a
/// mistake would end the episode. `None` where that makes far shorter steps than those, or no sense.
fn lines_a_decay(e: &Environment, steps: usize) -> Option<f64> {
    let step = e.disengagement_threshold / steps as f64;
    let decay = -libm::log1p(-e.delta_d) * danger(e);
    let leads_on = decay > SHORTEST_STEP * step && e.delta_d < 1.0 && e.epsilon_d > 0.0;
    leads_on.then(|| (decay / step).ceil())
}

/// Disengagement risks below the threshold in steps of at most the threshold / `steps` up to where a
/// mistake would end the episode; further up there are as many between a line and its decay.
///
/// A decay leads from each to another, so that nothing is interpolated along decays: a flaw of the
/// values in between is the same after every decay, and none is taken for a gain. Where the steps of
/// such lines are far shorter than those that are asked for, near 0, the lines are in equal steps.
fn lines(e: &Environment, steps: usize) -> Vec<f64> {
    let (threshold, danger) = (e.disengagement_threshold, danger(e));
    let step = threshold / steps as f64;
    let up_to = |end: f64| {
        let parts = (end / step).ceil();
        (1..parts as u32).map(move |i| end * f64::from(i) / parts)
    };
    let Some(parts) = lines_a_decay(e, steps) else {
        return up_to(threshold).collect();
    };
    let ratio = libm::pow(1.0 - e.delta_d, 1.0 / parts);
    let above = iter::successors(Some(danger / ratio), |x| Some(x / ratio));
    let below = iter::successors(Some(danger), |x| Some(x * ratio));
    let is_long = |x: &f64| x * (1.0 - ratio) > SHORTEST_STEP * step;
    let mut lines: Vec<f64> = below.take_while(is_long).collect();
    let lowest = lines.last().copied().unwrap_or(danger);
    lines.extend(above.take_while(|x| *x < threshold));
    lines.extend(up_to(lowest));
    lines
}

/// The disengagement risks at which the value jumps, increasing: the largest jumps, at most so many.
///
/// From where a mistake would end the episode, hardly any is made, so that a jump there is taken to be
/// as large a decay further up.
fn jumps(e: &Environment, most: usize) -> Vec<f64> {
    let (threshold, danger) = (e.disengagement_threshold, danger(e));
    let mut found: Vec<f64> = Vec::new();
    // Numbers above 0 are in the order of their bits.
    let mut waiting = BinaryHeap::from([Reverse((0, danger.to_bits()))]);
    while found.len() < most
        && let Some(Reverse((smallness, bits))) = waiting.pop()
    {
        let jump = f64::from_bits(bits);
        let is_inside = jump > APART && jump < threshold - APART;
        if !is_inside || found.iter().any(|other| (other - jump).abs() < APART) {
            continue;
        }
        found.push(jump);
        // At 1 a suitable message leads to 0 from everywhere.
        if e.delta_d < 1.0 {
            let smaller = u32::from(jump < danger - APART);
            waiting.push(Reverse((smallness + smaller, (jump / (1.0 - e.delta_d)).to_bits())));
        }
        let mistaken = (jump - e.epsilon_d).max(0.0);
        waiting.push(Reverse((smallness + DECAYS_A_MISTAKE, mistaken.to_bits())));
    }
    found.sort_by(f64::total_cmp);
    found
}

/// What becomes of each part, at once by the threads of the pool in which this is called.
pub(super) fn in_parallel<P: Send, R: Send>(
    parts: impl ExactSizeIterator<Item = P>,
    of: impl Fn(P) -> R + Sync,
) -> Vec<R> {
    if parts.len() == 1 {
        return parts.map(of).collect();
    }
    let parts: Vec<P> = parts.collect();
    parts.into_par_iter().with_max_len(1).map(&of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(delta_d: f64, epsilon_d: f64, disengagement_threshold: f64) -> Environment {
        let paper = Environment::paper(0.8);
        Environment { delta_d, epsilon_d, disengagement_threshold, ..paper }
    }

    #[test]
    fn a_decay_leads_from_line_to_line() {
        for (environment, steps) in [
            (with(0.1, 0.4, 1.0), 75),
            (with(0.01, 0.4, 0.8), 75),
            (with(0.5, 0.1, 0.6), 300),
            (with(0.002, 0.05, 1.0), 1200),
        ] {
            let mut lines = lines(&environment, steps);
            lines.sort_by(f64::total_cmp);
            let threshold = environment.disengagement_threshold;
            let step = threshold / steps as f64;
            let below = lines.partition_point(|line| *line < danger(&environment) + 1e-12);
            assert!(lines[..below].windows(2).all(|pair| pair[1] - pair[0] < step + 1e-12));
            assert!(lines[0] < step + 1e-12 && lines.iter().all(|line| *line < threshold));
            let is_line = |x: f64| lines.iter().any(|line| (line - x).abs() < 1e-12);
            assert!(is_line(danger(&environment)));
            // Further down they are in equal steps.
            let parts = lines_a_decay(&environment, steps).unwrap();
            let share = 1.0 - libm::pow(1.0 - environment.delta_d, 1.0 / parts);
            let lowest = SHORTEST_STEP * step / share;
            let decays = lines.iter().map(|line| (1.0 - environment.delta_d) * line);
            let led_to: Vec<f64> = decays.filter(|x| *x > lowest).collect();
            assert!(led_to.len() > 5 && led_to.iter().all(|x| is_line(*x)), "{environment:?}");
        }
    }

    #[test]
    fn lines_are_in_equal_steps_where_decays_lead_nowhere() {
        let of = |delta_d, epsilon_d| lines(&with(delta_d, epsilon_d, 1.0), 4);
        for (delta_d, epsilon_d) in [(1e-9, 0.4), (1.0, 0.4), (0.1, 0.0), (0.1, 1.0), (0.0, 0.4)] {
            assert_eq!(of(delta_d, epsilon_d), [0.25, 0.5, 0.75], "{delta_d} {epsilon_d}");
        }
    }

    #[test]
    fn jumps_are_followed_upwards_first_where_no_mistake_is_made() {
        let environment = with(0.1, 0.4, 1.0);
        let of = |most| jumps(&environment, most);
        let upwards: Vec<f64> = (0..5).map(|i| 0.6 / 0.9_f64.powi(i)).collect();
        let are_near = |ours: &[f64], others: &[f64]| {
            ours.len() == others.len()
                && ours.iter().zip(others).all(|(one, other)| (one - other).abs() < 1e-12)
        };
        assert!(are_near(&of(3), &upwards[..3]) && are_near(&of(5), &upwards), "{:?}", of(5));
        // Then what leads there by one mistake.
        let mistaken: Vec<f64> = upwards.iter().map(|jump| jump - 0.4).collect();
        assert!(are_near(&of(10), &[mistaken, upwards].concat()), "{:?}", of(10));
        assert!(jumps(&with(0.1, 0.0, 1.0), 10).is_empty());
    }

    #[test]
    fn a_grid_has_all_lines_in_its_region_and_a_few_elsewhere() {
        let environment = Environment { epsilon_h: 0.025, ..with(0.1, 0.4, 0.8) };
        let (h, d) = ([0.2, 0.5], [0.1, 0.45]);
        let all = Resolution {
            habituation: 320,
            disengagement: 600,
            jumps: 400,
            levels: 0,
            region: Region::ALL,
        };
        let some = Resolution { region: Region { habituation: h, disengagement: d }, ..all };
        let split = |axis: &Axis, [from, to]: [f64; 2]| -> [Vec<f64>; 2] {
            let (inside, outside) = axis.nodes().iter().partition(|x| (from..=to).contains(*x));
            [inside, outside]
        };
        let axes = |of: fn(Resolution, &Environment) -> Axis, region| {
            let [fine, fewer] = [all, some].map(|resolution| of(resolution, &environment));
            [split(&fine, region), split(&fewer, region)]
        };
        // Increments are eight steps here, and two of the longer ones.
        let [[inside, outside], [as_fine, fewer]] = axes(Resolution::habituation_axis, h);
        let alike = inside.iter().zip(&as_fine).all(|(x, y)| (x - y).abs() < 1e-12);
        assert!(alike && inside.len() == as_fine.len() && inside.len() > 90);
        assert!(fewer.len() * 7 < outside.len() * 2, "{} {}", fewer.len(), outside.len());
        let [[inside, outside], [as_fine, fewer]] = axes(Resolution::disengagement_axis, d);
        assert!(inside == as_fine && inside.len() > 300);
        assert!(fewer.len() * 3 < outside.len(), "{} {}", fewer.len(), outside.len());
        let coarse = Resolution { disengagement: 150, jumps: 100, ..all };
        let [_, of_coarse] = split(&coarse.disengagement_axis(&environment), d);
        assert_eq!(fewer, of_coarse);
        // None becomes coarser than is enough.
        let coarsest = Resolution { habituation: 20, disengagement: 75, jumps: 50, ..some };
        let everywhere = Resolution { region: Region::ALL, ..coarsest };
        for of in [Resolution::habituation_axis, Resolution::disengagement_axis] {
            assert_eq!(of(coarsest, &environment).nodes(), of(everywhere, &environment).nodes());
        }
    }

    #[test]
    fn the_least_and_the_most_are_found_wherever_they_are() {
        let len = 3 * AT_ONCE;
        for (least, most) in (0..len).flat_map(|i| (0..len).map(move |j| (i, j))) {
            let later: Vec<f64> = (0..len).map(|i| i as f64).collect();
            let mut now: Vec<f64> = later.iter().map(|x| x + 1.0).collect();
            now[most] += 2.0;
            now[least] -= 7.0;
            let expected = if least == most { [-4.0, 1.0] } else { [-6.0, 3.0] };
            for isa in Isa::available() {
                let added = Added::by(isa, later.as_chunks().0, now.as_chunks().0);
                assert_eq!([added.least, added.most], expected, "{least} {most}");
            }
        }
    }
}
