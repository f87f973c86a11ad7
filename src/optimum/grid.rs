//! Values of states on a grid of habituation and disengagement risk, and backward induction on it.
//!
//! The value is continuous in habituation and jumps in disengagement risk: a wrong message ends the
//! episode from threshold - epsilon_d on. Every jump is carried to the states that lead to it, by
//! decay or by an increment, and there it is as large or smaller. The grid has a line at each of the
//! largest, so that nothing is interpolated across them. In habituation, an increment leads from line
//! to line, and what a decay leads to is interpolated by cubics.
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

use crate::env::{Action, Belief, respond};
use crate::kernel::Isa;
use crate::manifest::{Environment, FirstContext};

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

/// Rows whose values are computed at once.
const AT_ONCE: usize = 4;
/// Values of a layer for which it is worth to wake a thread.
const WORTH_A_THREAD: usize = 2_000;

/// A variable of the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Variable {
    Habituation,
    Disengagement,
}

/// How fine a grid is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
}

impl Resolution {
    /// The variables that have steps.
    pub fn variables(self) -> &'static [Variable] {
        match self.disengagement {
            0 => &[Variable::Habituation],
            _ => &[Variable::Habituation, Variable::Disengagement],
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

    /// Twice as fine in every variable.
    pub fn refined(self) -> Resolution {
        self.variables().iter().fold(self, |finer, variable| finer.finer_in(*variable))
    }

    fn habituation_axis(self, environment: &Environment) -> Axis {
        Axis::with_stride(environment.epsilon_h, self.habituation)
    }

    fn disengagement_axis(self, e: &Environment) -> Axis {
        let threshold = e.disengagement_threshold;
        match levels(e, self.levels) {
            Some(levels) => Axis::through(levels, threshold),
            None => {
                let lines = lines(e, self.disengagement);
                Axis::with_jumps(threshold, &lines, &jumps(e, self.jumps), APART)
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

    fn by(later: &[f64], now: &[f64]) -> Added {
        let one = |later: f64, now: f64| Added { least: now - later, most: now - later };
        // Several at once that do not wait for each other, so that they become vector code.
        let mut several = [Added::NOTHING; 4];
        let (laters, last_laters) = later.as_chunks::<4>();
        let (nows, last_nows) = now.as_chunks::<4>();
        for (later, now) in laters.iter().zip(nows) {
            for (i, added) in several.iter_mut().enumerate() {
                *added = added.or(one(later[i], now[i]));
            }
        }
        let last = last_laters.iter().zip(last_nows).map(|(later, now)| one(*later, *now));
        several.into_iter().chain(last).fold(Added::NOTHING, Added::or)
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

/// Backward induction under way.
#[derive(Clone, Debug)]
struct Course {
    /// The last layer.
    values: Vec<f64>,
    /// Room for the next.
    next: Vec<f64>,
    /// What the last step added.
    added: Added,
    /// The last layers in a row: how many.
    stretch: u32,
    /// The layer before them.
    before: Vec<f64>,
    /// Their sum.
    sum: Vec<f64>,
    /// What they added.
    added_by_stretch: Added,
}

impl Course {
    fn new(values: Vec<f64>) -> Course {
        let sum = vec![0.0; values.len()];
        let (next, before) = (values.clone(), values.clone());
        let (added, added_by_stretch) = (Added::ANYTHING, Added::ANYTHING);
        Course { values, next, added, stretch: 0, before, sum, added_by_stretch }
    }

    /// Computes the next layer; what this step and the one before it add, and further ones.
    fn step(&mut self, grid: &Grid) -> Added {
        let (later, part) = (&self.values, grid.part());
        let earlier = self.next.chunks_mut(part).zip(self.sum.chunks_mut(part));
        let parts = later.chunks(part).zip(self.before.chunks(part)).zip(earlier).enumerate();
        let added = in_parallel(parts, |(i, ((part_of_later, before), (now, sum)))| {
            let mut by_both = [Added::NOTHING; 2];
            // While they are in the nearest caches.
            grid.part_back(i * part, later, now, |range, now| {
                let sum = sum[range.clone()].iter_mut();
                sum.zip(now).for_each(|(sum, value)| *sum += value);
                for (by, later) in by_both.iter_mut().zip([part_of_later, before]) {
                    *by = by.or(Added::by(&later[range.clone()], now));
                }
            });
            by_both
        });
        let all = |which: usize| {
            added.iter().fold(Added::NOTHING, |all, part| all.or(part[which])).and_further()
        };
        let added_before = mem::replace(&mut self.added, all(0));
        self.added_by_stretch = all(1);
        self.stretch += 1;
        mem::swap(&mut self.values, &mut self.next);
        self.added.or(added_before)
    }

    fn begin_stretch(&mut self) {
        self.stretch = 0;
        self.before.copy_from_slice(&self.values);
        self.sum.fill(0.0);
    }

    /// What a step of the stretch adds in the mean, and further ones.
    fn added_in_mean(&self) -> Added {
        let Added { least, most } = self.added_by_stretch;
        let steps = f64::from(self.stretch);
        Added { least: least / steps, most: most / steps }
    }

    /// The mean of the stretch's layers.
    fn mean(&self) -> Vec<f64> {
        self.sum.iter().map(|sum| sum / f64::from(self.stretch)).collect()
    }
}

/// The states that have a value, and where actions lead from them.
///
/// **Shapes**: a layer of values is \[habituation, disengagement\], row by row.
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
    baseline: [f64; 2],
    expectation: Expectation,
    habituation: Axis,
    disengagement: Axis,
    rows: Vec<Row>,
    columns: Vec<Column>,
}

/// Where the states of one habituation lead.
#[derive(Clone, Copy, Debug)]
struct Row {
    messaged: Among,
    rested: Among,
    /// Reward of an untailored and of a suitable message, the baseline aside.
    untailored: f64,
    suitable: f64,
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
        let row = |h: &f64| {
            let of = |action| respond(e, 0, action, *h, 0.0);
            let suitable = of(Action::tailored_to(0));
            Row {
                messaged: habituation.among(suitable.habituation),
                rested: habituation.among(of(Action::NONE).habituation),
                untailored: of(Action::UNTAILORED).reward,
                suitable: suitable.reward,
            }
        };
        let rows = habituation.nodes().iter().map(row).collect();
        let column = |(node, d): (usize, &f64)| {
            let side = disengagement.side(node);
            let calm = respond(e, 0, Action::tailored_to(0), 0.0, *d).disengagement;
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
            settled: f64::min(SETTLED_IN_ALL, SETTLED * f64::from(e.horizon)),
            baseline,
            expectation,
            habituation,
            disengagement,
            rows,
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
        self.rows.len() * self.columns.len()
    }

    /// Computes the values with 0, 1, 2, … steps left, at most one fewer than the horizon, and shows
    /// `see` each layer. They end sooner if the steps before them would all add the same.
    ///
    /// Where the best choices nearly repeat after some steps, what a step adds settles much later
    /// than what it adds in the mean over a stretch of steps. Then the mean values of the stretch,
    /// which have no such ripple, are taken further until a step of theirs settles.
    pub fn induce(&self, mut see: impl FnMut(u32, &[f64])) -> Induced {
        let most_left = self.environment.horizon - 1;
        let mut course = Course::new(vec![0.0; self.nodes()]);
        see(0, &course.values);
        let (mut smoothed, mut next_try) = (0, 0);
        for left in 1..=most_left {
            let added = course.step(self);
            see(left, &course.values);
            if self.is_settled(added, most_left - left) {
                let (layer, gain) = (course.values, added.middle());
                return Induced { left, layer, gain, steps: left + smoothed };
            }
            let is_promising = course.added_in_mean().spread() * f64::from(most_left - left)
                < WORTH_SMOOTHING * self.allowed();
            if left >= next_try && is_promising {
                let (steps, smooth) = self.smooth(&course, left);
                smoothed += steps;
                if let Some((layer, gain)) = smooth {
                    return Induced { left, layer, gain, steps: left + smoothed };
                }
                next_try = 2 * left;
            }
            if course.stretch > SHORTEST_STRETCH.max(left / 4) {
                course.begin_stretch();
            }
        }
        Induced { left: most_left, layer: course.values, gain: 0.0, steps: most_left + smoothed }
    }

    /// Takes the mean values of a stretch further, at most half as many steps as are `left`, until the
    /// steps before them would all add the same; every as many steps as the stretch has, their mean
    /// is taken again. How many steps that took, and the values on the level of the stretch's last,
    /// unless they are too far from those, with what each step before them adds.
    fn smooth(&self, course: &Course, left: u32) -> (u32, Option<(Vec<f64>, f64)>) {
        let mut smooth = Course::new(course.mean());
        for steps in 1..=left / 2 {
            let added = smooth.step(self);
            if self.is_settled(added, self.environment.horizon - 1 - left) {
                let apart = Added::by(&smooth.values, &course.values);
                let values = smooth.values.iter().map(|value| value + apart.middle()).collect();
                // The policy that goes over from the ones to the others does not choose when.
                let is_near = apart.spread() < self.allowed();
                return (steps, is_near.then_some((values, added.middle())));
            }
            if smooth.stretch == course.stretch {
                smooth = Course::new(smooth.mean());
            }
        }
        (left / 2, None)
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
    pub fn step_back(&self, later: &[f64], now: &mut [f64]) {
        let part = self.part();
        let parts = now.chunks_mut(part).enumerate();
        in_parallel(parts, |(i, now)| self.part_back(i * part, later, now, |_, _| ()));
    }

    /// How many values a thread computes: some rows.
    fn part(&self) -> usize {
        let threads = self.threads.min(self.nodes() / WORTH_A_THREAD).max(1);
        self.rows.len().div_ceil(threads) * self.columns.len()
    }

    /// The values of some rows one step earlier, the first of which begins with value `from`. Shows
    /// `see` a few rows at a time, and where among those of `now` they stand.
    fn part_back(
        &self,
        from: usize,
        later: &[f64],
        now: &mut [f64],
        mut see: impl FnMut(Range<usize>, &[f64]),
    ) {
        let columns = self.columns.len();
        let rows = &self.rows[from / columns..][..now.len() / columns];
        let mut room = [vec![[0.0; AT_ONCE]; columns], vec![[0.0; AT_ONCE]; columns]];
        let mut start = 0;
        for (rows, now) in rows.chunks(AT_ONCE).zip(now.chunks_mut(AT_ONCE * columns)) {
            self.isa.run(RowsBack { grid: self, rows, later, room: &mut room, now });
            see(start..start + now.len(), now);
            start += now.len();
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
        let of_row = |i: usize| column.of(&values.layer[(rows.node + i) * columns..][..columns]);
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
        let effect = |action| respond(&self.environment, 0, action, habituation, disengagement);
        let [nothing, untailored, suitable, unsuitable] =
            [Action::NONE, Action::UNTAILORED, Action::tailored_to(0), Action::tailored_to(1)]
                .map(effect);
        // An untailored message leads to the same state as a suitable one.
        let calmed = later(suitable.habituation, suitable.disengagement);
        Prospects {
            nothing: nothing.reward + later(nothing.habituation, nothing.disengagement),
            untailored: untailored.reward + calmed,
            suitable: suitable.reward + calmed,
            unsuitable: unsuitable.reward + later(unsuitable.habituation, unsuitable.disengagement),
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

/// The values of some rows one step earlier, at most [`AT_ONCE`].
struct RowsBack<'a> {
    grid: &'a Grid,
    rows: &'a [Row],
    later: &'a [f64],
    /// For every column, what resting brings in each row, and then the result; and what a message
    /// leads to.
    room: &'a mut [Vec<[f64; AT_ONCE]>; 2],
    now: &'a mut [f64],
}

impl WithSimd for RowsBack<'_> {
    type Output = ();

    /// Compiled for the instruction set, which takes an array of [`AT_ONCE`] as a register. Without
    /// fused operations, so that each number is what it would be alone.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let RowsBack { grid, rows, later, room: [values, messaged], now } = self;
        // The last stands for those that are not there.
        let rows: [Row; AT_ONCE] = array::from_fn(|r| rows[r.min(rows.len() - 1)]);
        blend(rows.map(|row| row.rested), later, values);
        blend(rows.map(|row| row.messaged), later, messaged);
        let [untailored, suitable] = [rows.map(|row| row.untailored), rows.map(|row| row.suitable)];
        for (column, value) in grid.columns.iter().zip(&mut *values) {
            let calm = column.calmed.of_each(messaged);
            let annoyed = column.annoyed.map_or([0.0; AT_ONCE], |place| place.of_each(messaged));
            *value = grid.expectation.of_best_each(
                *value,
                array::from_fn(|r| untailored[r] + calm[r]),
                array::from_fn(|r| suitable[r] + calm[r]),
                annoyed,
            );
        }
        let baseline = grid.baseline();
        for (r, now) in now.chunks_exact_mut(values.len()).enumerate() {
            for (now, value) in now.iter_mut().zip(&*values) {
                *now = baseline + value[r];
            }
        }
    }
}

/// Rows of a layer, each among four of its rows.
#[inline(always)]
fn blend(places: [Among; AT_ONCE], layer: &[f64], out: &mut [[f64; AT_ONCE]]) {
    let columns = out.len();
    for (r, place) in places.into_iter().enumerate() {
        let row = |i: usize| &layer[(place.node + i) * columns..][..columns];
        let (a, b, c, d) = (row(0), row(1), row(2), row(3));
        for (column, out) in out.iter_mut().enumerate() {
            out[r] = place.of([a[column], b[column], c[column], d[column]]);
        }
    }
}

/// Values with one number of steps left.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment<'a> {
    /// Those of the nodes.
    pub layer: &'a [f64],
    /// What all of them are more than that.
    pub more: f64,
}

/// The values of the most steps left that were computed.
#[derive(Clone, Debug)]
pub(super) struct Induced {
    /// Steps that are left.
    pub left: u32,
    pub layer: Vec<f64>,
    /// What each step before them adds; of no meaning if there is none.
    pub gain: f64,
    /// How many layers were computed.
    pub steps: u32,
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
    let annoyed = |d: &f64| Some(respond(e, 0, Action::tailored_to(1), 0.0, *d).disengagement);
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
    fn the_least_and_the_most_are_found_wherever_they_are() {
        for len in 1..10 {
            for (least, most) in (0..len).flat_map(|i| (0..len).map(move |j| (i, j))) {
                let later: Vec<f64> = (0..len).map(f64::from).collect();
                let mut now: Vec<f64> = later.iter().map(|x| x + 1.0).collect();
                now[most as usize] += 2.0;
                now[least as usize] -= 7.0;
                let added = Added::by(&later, &now);
                let expected = match (len, least == most) {
                    (1, _) => [-4.0, -4.0],
                    (_, true) => [-4.0, 1.0],
                    (_, false) => [-6.0, 3.0],
                };
                assert_eq!([added.least, added.most], expected, "{len} {least} {most}");
            }
        }
    }
}
