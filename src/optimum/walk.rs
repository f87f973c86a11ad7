//! Episodes of the policy that values make best: what the values' grid leaves out.
//!
//! Were the values exact, the value of a state would be the mean over the signal of what the best
//! choice brings. What that mean exceeds it by is the error of the value in this one state. Over an
//! episode of the policy, these errors add up, in the mean, to exactly the difference between the
//! policy's mean return and the value of the start: rewards and values of the states on the way
//! cancel out. So a few hundred episodes tell a mean return that a simulation of returns would need
//! millions for.
//!
//! This holds whatever the values are. Those of the policy that is walked are not interpolated: each
//! is the mean of the best choice by the interpolated values of the step after it. Such a policy
//! looks one step further, and misses a fraction of what one misses that trusts interpolation.

use std::ops::Range;

use crate::env::{ContextDraw, ContextDrawsAhead, apply_action};
use crate::env::{Environment, FirstContext};
use crate::rng::{Purpose, Stream};

use super::Prospects;
use super::grid::{Grid, Induced, Lanes, Moment, Region, in_parallel};

/// What episodes told.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walked {
    /// Mean return of the policy, in steps walked.
    pub mean_return: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// How many episodes told it.
    pub episodes: usize,
    /// Layers that were computed.
    pub layers: usize,
    /// [`Grid::stretches_after`] of a finer grid, which is as likely to settle by single steps as this.
    pub stretches_after: u32,
    /// The states that the episodes hardly left, and what a step leads to from there, mistakes aside.
    pub region: Region,
}

/// How many equal parts of a variable are told apart in which episodes were.
const PARTS: usize = 100;
/// The part of the steps that may lead beyond each end of a region that episodes hardly leave.
const HARDLY: f64 = 0.002;

/// In how many steps episodes were in each part of a variable.
#[derive(Clone, Copy, Debug)]
struct Visits([u64; PARTS]);

impl Visits {
    const NONE: Visits = Visits([0; PARTS]);

    /// Counts a number from 0 to the last, as a share of that.
    fn count(&mut self, share: f64) {
        self.0[((share * PARTS as f64) as usize).min(PARTS - 1)] += 1;
    }

    fn add(&mut self, others: &Visits) {
        self.0.iter_mut().zip(others.0).for_each(|(ours, others)| *ours += others);
    }

    /// From where to where nearly all of them were, and a part more at either end, as shares of the last
    /// number.
    fn extent(&self) -> [f64; 2] {
        let few = (HARDLY * self.0.iter().sum::<u64>() as f64) as u64;
        let (below, above) = (leading(self.0.iter(), few), leading(self.0.iter().rev(), few));
        let (from, to) = (below.saturating_sub(1), PARTS - above.saturating_sub(1));
        [from, to].map(|part| part as f64 / PARTS as f64)
    }
}

/// How many of the first numbers add up to at most a `few`.
fn leading<'a>(numbers: impl Iterator<Item = &'a u64>, few: u64) -> usize {
    let add = |sum: &mut u64, number: &u64| {
        *sum += number;
        Some(*sum)
    };
    numbers.scan(0, add).take_while(|sum| *sum <= few).count()
}

/// The mean return of the policy that makes the best choices by the values on a grid, over so many
/// `episodes`, at least two, given how many layers are computed. Every call rolls the same ones.
///
/// Episodes meet the values in the opposite order to the one in which they are computed, and there
/// is no room for all. So layers are kept at distances, and those between computed again.
pub(super) fn mean_return(grid: &Grid, episodes: impl FnOnce(usize) -> usize) -> Walked {
    let e = grid.environment();
    let (mut kept, mut distance) = (Vec::<Vec<Lanes>>::new(), 8);
    let induced = grid.induce(|left, layer| {
        if left.is_multiple_of(distance) {
            kept.push(layer.to_vec());
        }
        // As many as there are between two.
        if kept.len() > 2 * distance as usize {
            let mut is_even = false;
            kept.retain(|_| {
                is_even = !is_even;
                is_even
            });
            distance *= 2;
        }
    });
    let computed = (2 * induced.left + induced.smoothed) as usize + 2;
    let seeds = 1..=episodes(computed) as u64;
    let mut episodes: Vec<Episode> = seeds.map(|seed| Episode::start(e, seed)).collect();
    let mut visits = [Visits::NONE; 2];
    let settled = |left| induced.before(left);
    roll(&mut episodes, &mut visits, grid, induced.left..e.horizon, settled);
    let mut end = induced.left;
    let mut layers = vec![grid.zeros(); distance as usize - 1];
    for (i, first) in kept.iter().enumerate().rev() {
        let start = i as u32 * distance;
        layers[0].copy_from_slice(first);
        // No episode asks for the values with `end` - 1 steps left.
        for left in 2..(end - start) as usize {
            let (later, now) = layers.split_at_mut(left - 1);
            grid.step_back(&later[left - 2], &mut now[0]);
        }
        roll(&mut episodes, &mut visits, grid, start..end, |left| Moment {
            layer: &layers[(left - start) as usize],
            more: 0.0,
        });
        end = start;
    }
    let left_out = moments(episodes.iter().map(|episode| episode.left_out));
    let ahead = Ahead { grid, left: induced.left..e.horizon, kept: &settled };
    let first = ahead.prospects(e.horizon - 1, e.initial_habituation, e.initial_disengagement);
    let of_start = grid.mean_return(&first);
    Walked {
        mean_return: of_start + left_out.0,
        standard_error: left_out.1,
        episodes: episodes.len(),
        layers: computed,
        stretches_after: match induced {
            Induced { smoothed: 0, left, .. } if 2 * left < e.horizon - 1 => 2 * left,
            Induced { left, .. } => left / 2,
        },
        region: region(e, visits.map(|visits| visits.extent())),
    }
}

/// From where to where episodes were in habituation and in disengagement risk, and what a step leads to
/// from there, mistakes aside. Disengagement risks are given as shares of the threshold.
fn region(e: &Environment, [habituation, disengagement]: [[f64; 2]; 2]) -> Region {
    let ([rested, habituated], [calm, at_risk]) = (habituation, disengagement);
    Region {
        habituation: [rested * (1.0 - e.delta_h), habituated + e.epsilon_h],
        disengagement: [calm * (1.0 - e.delta_d), at_risk].map(|x| x * e.disengagement_threshold),
    }
}

/// Takes the steps of episodes after which so many are `left`, given the values that are kept with
/// each number of steps left, by the number. Counts where they begin: in habituation and in
/// disengagement risk.
fn roll<'a>(
    episodes: &mut [Episode],
    visits: &mut [Visits; 2],
    grid: &Grid,
    left: Range<u32>,
    kept: impl Fn(u32) -> Moment<'a> + Sync,
) {
    let part = episodes.len().div_ceil(grid.threads);
    let threshold = grid.environment().disengagement_threshold;
    let of_parts = in_parallel(episodes.chunks_mut(part), |episodes| {
        let ahead = Ahead { grid, left: left.clone(), kept: &kept };
        let mut visits = [Visits::NONE; 2];
        for left in left.clone().rev() {
            for episode in episodes.iter_mut().filter(|episode| !episode.has_ended) {
                visits[0].count(episode.habituation);
                visits[1].count(episode.disengagement / threshold);
                episode.step(&ahead, left);
            }
        }
        visits
    });
    for of_part in &of_parts {
        visits.iter_mut().zip(of_part).for_each(|(visits, others)| visits.add(others));
    }
}

/// The values of states by those that are kept with one step less left.
///
/// Only those with the fewest steps left of a range are taken as they are kept: there is no step less
/// at hand.
struct Ahead<'g, F> {
    grid: &'g Grid,
    left: Range<u32>,
    kept: &'g F,
}

impl<'a, F: Fn(u32) -> Moment<'a>> Ahead<'_, F> {
    /// The value of a state with so many steps left; 0 where the episode has ended.
    fn value(&self, left: u32, habituation: f64, disengagement: f64) -> f64 {
        let grid = self.grid;
        if disengagement >= grid.environment().disengagement_threshold {
            return 0.0;
        }
        if left == self.left.start {
            return grid.value((self.kept)(left), habituation, disengagement);
        }
        let prospects = grid.prospects((self.kept)(left - 1), habituation, disengagement);
        grid.mean_of_best(&prospects)
    }

    /// What each choice brings in a state after which so many steps are left.
    fn prospects(&self, left: u32, habituation: f64, disengagement: f64) -> Prospects {
        let later = |habituation, disengagement| self.value(left, habituation, disengagement);
        self.grid.prospects_by(later, habituation, disengagement)
    }
}

/// An episode under way.
struct Episode {
    stream: Stream,
    ahead: ContextDrawsAhead,
    habituation: f64,
    disengagement: f64,
    /// The value of this state, but at the start.
    value: f64,
    has_ended: bool,
    /// The sum of the errors of values on its way.
    left_out: f64,
}

impl Episode {
    fn start(e: &Environment, seed: u64) -> Episode {
        Episode {
            stream: Stream::new(seed, Purpose::Optimum),
            ahead: ContextDrawsAhead::new(e.sigma),
            habituation: e.initial_habituation,
            disengagement: e.initial_disengagement,
            value: 0.0,
            has_ended: false,
            left_out: 0.0,
        }
    }

    /// Takes a step after which so many are left; it has not ended.
    fn step<'a>(&mut self, ahead: &Ahead<'_, impl Fn(u32) -> Moment<'a>>, left: u32) {
        let (grid, e) = (ahead.grid, ahead.grid.environment());
        let (habituation, disengagement) = (self.habituation, self.disengagement);
        let states = grid.states_after(habituation, disengagement);
        let values = states.map(|[h, d]| ahead.value(left, h, d));
        let prospects = grid.prospects_of(values, habituation, disengagement);
        let is_first = left + 1 == e.horizon;
        // The value of the start is what the best choice there brings.
        if !is_first {
            self.left_out += grid.mean_of_best(&prospects) - self.value;
        }
        let (signal, believed) = if is_first && e.first_context == FirstContext::Fixed {
            (ContextDraw::FIXED_FIRST, 1.0)
        } else {
            let signal = self.ahead.take(grid.isa, &mut self.stream);
            (signal, grid.belief.probability_of_zero(&signal))
        };
        let action = prospects.best(believed);
        let effect = apply_action(e, signal.context, action, habituation, disengagement);
        (self.habituation, self.disengagement) = (effect.habituation, effect.disengagement);
        let led_to = Grid::led_to(signal.context, action);
        debug_assert_eq!(states[led_to], [self.habituation, self.disengagement]);
        self.value = values[led_to];
        self.has_ended = effect.disengagement >= e.disengagement_threshold;
    }
}

/// The mean of numbers, at least two of them, and its standard error.
fn moments(numbers: impl ExactSizeIterator<Item = f64> + Clone) -> (f64, f64) {
    let n = numbers.len() as f64;
    let mean = numbers.clone().sum::<f64>() / n;
    let variance = numbers.map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_extent_leaves_out_a_few_visits_at_either_end() {
        let mut visits = Visits::NONE;
        // At 1 they are in the last part.
        for (share, count) in [(0.0, 1), (0.105, 2), (0.3, 990), (0.7, 5), (1.0, 2)] {
            (0..count).for_each(|_| visits.count(share));
        }
        // Of a thousand, two are a few, but three are not.
        assert_eq!(visits.extent(), [0.09, 0.72]);
        let mut twice = visits;
        twice.add(&visits);
        assert_eq!((twice.0[30], twice.extent()), (1980, [0.09, 0.72]));
        let mut once = Visits::NONE;
        once.count(0.425);
        assert_eq!(once.extent(), [0.41, 0.44]);
        let mut everywhere = Visits::NONE;
        (0..PARTS).for_each(|part| everywhere.count(part as f64 / PARTS as f64));
        assert_eq!(everywhere.extent(), [0.0, 1.0]);
    }

    #[test]
    fn a_region_is_led_to_by_a_step() {
        let paper = Environment::paper(0.8);
        let e = Environment { delta_h: 0.1, epsilon_h: 0.05, delta_d: 0.2, ..paper };
        let e = Environment { disengagement_threshold: 0.5, ..e };
        let Region { habituation, disengagement } = region(&e, [[0.2, 0.6], [0.5, 1.0]]);
        let are_near = |ours: [f64; 2], others: [f64; 2]| {
            ours.iter().zip(others).all(|(one, other)| (one - other).abs() < 1e-12)
        };
        assert!(are_near(habituation, [0.18, 0.65]) && are_near(disengagement, [0.2, 0.5]));
    }
}
