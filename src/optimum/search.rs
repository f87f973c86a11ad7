//! Finer and finer grids, until their policies become no better, or until time is up.

use crate::env::Belief;
use crate::manifest::Environment;

use super::Optimum;
use super::grid::{Grid, Resolution};
use super::walk::{self, Walked};

/// Error that is small enough, in units of the grid.
const SMALL: f64 = 0.1;
/// Steps of episodes on the coarsest grid; on every further one they are twice as many.
const STEPS: u32 = 125_000;
/// Values that are computed in the time of a step of an episode.
const VALUES_A_STEP: usize = 150;
/// Most values that are computed for an optimum, in all, unless the first grids take more: twelve
/// seconds of a core or so.
pub(super) const MOST_COMPUTED: usize = 2_700_000_000;
/// Most values that a search keeps at a time: 640 MB.
const MOST_KEPT: usize = 80_000_000;

/// The search for the best policy of who knows so much of the context.
#[derive(Debug)]
pub(super) struct Search<'a> {
    environment: &'a Environment,
    belief: Belief,
    threads: usize,
    /// Values that were computed.
    computed: usize,
    /// Most of them, unless the first grids take more.
    pub most_computed: usize,
}

/// A grid whose policy was walked.
#[derive(Clone, Copy, Debug)]
struct Tried {
    resolution: Resolution,
    /// How many lines it has in habituation, and in disengagement.
    rows: usize,
    columns: usize,
    /// What differences are measured by.
    unit: f64,
    /// The steps of episodes that were asked for.
    steps: u32,
    walked: Walked,
}

impl<'a> Search<'a> {
    pub fn new(environment: &'a Environment, belief: Belief, threads: usize) -> Self {
        Search { environment, belief, threads, computed: 0, most_computed: MOST_COMPUTED }
    }

    /// The best policy of grids from the coarsest on, each twice as fine as the one before it.
    pub fn best_from(mut self, coarsest: Resolution) -> Optimum {
        let (mut tried, mut steps) = (Vec::new(), STEPS);
        let mut next = (coarsest, self.grid(coarsest));
        let missed = loop {
            let (resolution, grid) = next;
            let last = self.walk(resolution, &grid, steps);
            tried.push(last);
            let finer = resolution.refined(1);
            next = (finer, self.grid(finer));
            steps = steps.saturating_mul(2);
            let is_affordable = self.affords(next.1.nodes(), last);
            if let Some(missed) = missed(&tried)
                && (error(missed, &tried) < SMALL * last.unit || !is_affordable)
            {
                break missed;
            }
        };
        let missed = missed + self.missed_in_habituation(missed, &mut tried);
        Optimum { mean_return: best(&tried).mean_return, error: error(missed, &tried) }
    }

    /// What is missed in habituation, so much being missed besides, unless the grids have twice become
    /// finer in it. They have not where its increments are shorter than the steps that are asked for.
    ///
    /// Grids that are finer in it alone tell: than the finest grid, or, if there is no time for that,
    /// than a coarser one with as many lines.
    fn missed_in_habituation(&mut self, besides: f64, tried: &mut Vec<Tried>) -> f64 {
        let refined = tried.windows(2).filter(|pair| pair[0].rows < pair[1].rows).count();
        if refined >= 2 {
            return 0.0;
        }
        let finest = tried[tried.len() - 1];
        let alike = || tried.iter().rev().take_while(|other| other.rows == finest.rows).copied();
        let is_affordable = |other: &Tried| self.affords(self.with_more_rows(*other).1, *other);
        // It is taken even if there is no time: it has fewer nodes than all that were tried.
        let coarsest = alike().last().filter(|_| refined == 0);
        let Some(first) = alike().find(is_affordable).or(coarsest) else { return 0.0 };
        let is_finest = first.resolution == finest.resolution;
        let mut last = self.walk_with_more_rows(first);
        let mut changes = [apart(last.walked, first.walked), 0.0];
        for made in 1.. {
            if is_finest {
                tried.push(last);
            }
            let [change, before] = changes;
            let to_come = change_to_come(change, before);
            let is_little =
                refined + made >= 2 && to_come <= f64::max(besides, SMALL * last.unit / 2.0);
            let (_, nodes) = self.with_more_rows(last);
            if is_little || !self.affords(nodes, last) {
                // The number is that of the finest grid, which has none of what was gained.
                let gained = if is_finest { 0.0 } else { apart(last.walked, first.walked) };
                return gained + to_come;
            }
            let next = self.walk_with_more_rows(last);
            changes = [apart(next.walked, last.walked), change];
            last = next;
        }
        unreachable!("there is no time for ever finer grids")
    }

    fn grid(&self, resolution: Resolution) -> Grid {
        let mut grid = Grid::new(self.environment, self.belief, resolution);
        grid.threads = self.threads;
        grid
    }

    /// The next grid that is finer in habituation alone, and how many values a layer of it has.
    fn with_more_rows(&self, than: Tried) -> (Resolution, usize) {
        let mut resolution = than.resolution;
        loop {
            resolution = resolution.finer_in_habituation();
            let rows = resolution.rows(self.environment);
            if rows > than.rows {
                return (resolution, rows * than.columns);
            }
        }
    }

    fn walk_with_more_rows(&mut self, than: Tried) -> Tried {
        let (resolution, _) = self.with_more_rows(than);
        self.walk(resolution, &self.grid(resolution), than.steps)
    }

    fn walk(&mut self, resolution: Resolution, grid: &Grid, steps: u32) -> Tried {
        let walked = walk::mean_return(grid, steps);
        let [layers, steps_taken] = walked.work;
        self.computed += self.values(grid.nodes(), layers) + VALUES_A_STEP * steps_taken;
        let (rows, unit) = (resolution.rows(self.environment), grid.unit());
        Tried { resolution, rows, columns: grid.nodes() / rows, unit, steps, walked }
    }

    /// The values of layers of so many nodes. Where the context is inferred, a value takes twice the
    /// time, and counts as much.
    pub fn values(&self, nodes: usize, layers: usize) -> usize {
        let inferred = matches!(self.belief, Belief::Inferred { .. });
        nodes * layers * if inferred { 2 } else { 1 }
    }

    /// Whether there is time and room for a grid of so many nodes, finer than the one tried before.
    fn affords(&self, nodes: usize, before: Tried) -> bool {
        let [layers, steps] = before.walked.work;
        // A finer grid may take more steps to settle. Layers are computed twice; at most three times
        // the root of their number are kept.
        let takes = self.values(nodes, layers) * 5 / 4 + 2 * VALUES_A_STEP * steps;
        self.computed + takes <= self.most_computed && nodes * 3 * (layers / 2).isqrt() <= MOST_KEPT
    }
}

/// The best policy of finer and finer grids: the last, unless one before is better beyond chance,
/// which happens where the value of a finer grid is flawed in a place that its policy prefers.
fn best(tried: &[Tried]) -> Walked {
    let better = |best: Walked, next: &Tried| {
        let chance = 2.0 * (best.standard_error + next.walked.standard_error);
        let is_better = best.mean_return - next.walked.mean_return > chance;
        if is_better { best } else { next.walked }
    };
    tried.iter().skip(1).fold(tried[0].walked, better)
}

/// How far the best policy may be from the best there is, if so much is missed.
fn error(missed: f64, tried: &[Tried]) -> f64 {
    missed + 2.0 * best(tried).standard_error
}

/// What finer and finer grids would still change; `None` if fewer than three were tried.
fn missed(tried: &[Tried]) -> Option<f64> {
    let [before @ .., _, last] = tried else { return None };
    if before.is_empty() {
        return None;
    }
    let (first, second) = (best(before), best(&tried[..tried.len() - 1]));
    Some(change_to_come(apart(second, last.walked), apart(first, second)))
}

fn apart(one: Walked, other: Walked) -> f64 {
    (one.mean_return - other.mean_return).abs()
}

/// What finer and finer grids would still change, by what the last refinement did and the one before.
///
/// The policy of a grid twice as fine misses a third of what the one before it misses, or less. That
/// both miss the same is unlikely, but it happens; the change before tells of it.
fn change_to_come(last: f64, before: f64) -> f64 {
    f64::max(last, before / 3.0) / 2.0
}
