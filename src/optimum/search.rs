//! Finer and finer grids, until their policies become no better, or until time is up.

use crate::env::Belief;
use crate::env::Environment;

use super::grid::{Grid, Resolution, Variable};
use super::walk::{self, Walked};
use super::{Effort, Optimum};

/// Error that is small enough, in units of the grid.
const SMALL: f64 = 0.1;
/// Steps of episodes on the coarsest grid, or so; on others they grow with the root of the values.
const STEPS: f64 = 125_000.0;
/// Fewest and most episodes of a grid, unless noise asks for more.
const EPISODES: (usize, usize) = (50, 2_000);
/// Most episodes of a grid.
const MOST_EPISODES: usize = 20_000;
/// How many times the time of the episodes that noise asks for that of a grid's values is, or more. Of
/// the noise on the coarsest grid, nothing is known before.
pub(super) const OF_NOISY_EPISODES: usize = 3;
/// How many times more must be to come of another variable, for finer lines in one not to be kept.
const NEGLIGIBLE: f64 = 4.0;
/// Values that are computed in the time of a step of an episode, where the context is not inferred.
const VALUES_A_STEP: usize = 100;
/// Most values that are computed for an optimum by the usual effort, in all, unless the first grids take
/// more: a dozen seconds of a core or so, or twice that of a slow one.
pub(super) const MOST_COMPUTED: usize = 5_200_000_000;
/// Most values that a search keeps at a time, or so, by whatever effort: 1.3 GB.
const MOST_KEPT: usize = 160_000_000;

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
    /// [`Grid::stretches_after`] of it.
    stretches_after: u32,
    /// How many values a layer has.
    nodes: usize,
    /// The steps of episodes that were asked for, at least.
    steps: f64,
    walked: Walked,
}

impl Tried {
    /// How many episodes it takes for two standard errors to be what is allowed.
    fn episodes_for(&self, allowed: f64) -> usize {
        let excess = 2.0 * self.walked.standard_error / allowed;
        let episodes = (self.walked.episodes as f64 * excess * excess) as usize;
        episodes.min(MOST_EPISODES)
    }
}

/// What finer lines in a variable have changed.
#[derive(Clone, Copy, Debug)]
struct Changes {
    variable: Variable,
    /// When they were made finer the last time, and the time before: of the same lines, where they were
    /// given up again in between.
    last: Option<f64>,
    before: Option<f64>,
}

impl Changes {
    fn none_in(variable: Variable) -> Changes {
        Changes { variable, last: None, before: None }
    }

    fn add(&mut self, change: f64) {
        (self.last, self.before) = (Some(change), self.last);
    }

    /// What finer and finer lines would still change; infinite if none were tried.
    ///
    /// The policy of lines twice as fine misses a third of what the one before it misses, or less. That
    /// both miss the same is unlikely, but it happens; the change before tells of it.
    fn still_to_come(&self) -> f64 {
        match (self.last, self.before) {
            (Some(last), Some(before)) => f64::max(last, before / 3.0) / 2.0,
            (Some(last), None) => last,
            (None, _) => f64::INFINITY,
        }
    }
}

impl<'a> Search<'a> {
    pub fn new(environment: &'a Environment, belief: Belief, effort: Effort) -> Self {
        let most_computed = MOST_COMPUTED.saturating_mul(effort.times.get() as usize);
        Search { environment, belief, threads: effort.threads.get(), computed: 0, most_computed }
    }

    /// The best policy of finer and finer grids, from the coarsest on. Each is twice as fine as the one
    /// before it in the variable of which the most is still to come, until that is little, and no
    /// variable owes that to a coincidence, or until there is no time. Finer lines are given up again,
    /// for now, where the other variable has much more to come. They are coarser where the episodes of
    /// the grid before hardly were.
    pub fn best_from(mut self, coarsest: Resolution) -> Optimum {
        let grid = self.grid(coarsest, 0);
        let small = SMALL * grid.unit();
        let mut last = self.walk(coarsest, &grid, STEPS, MOST_EPISODES);
        let mut best = last;
        let mut changes: Vec<Changes> =
            coarsest.variables().iter().map(|variable| Changes::none_in(*variable)).collect();
        while let Some(most) = most_to_come(&changes, small) {
            let variable = changes[most].variable;
            let from = Resolution { region: last.walked.region, ..last.resolution };
            let resolution = from.with_more_lines(variable, self.environment);
            let grid = self.grid(resolution, last.walked.stretches_after);
            let growth = grid.nodes() as f64 / last.nodes as f64;
            let steps = last.steps * growth.sqrt();
            let needed = last.episodes_for(small / 2.0);
            if missed(&changes).is_finite()
                && !self.affords(&grid, last.walked.layers, steps, needed)
            {
                break;
            }
            let next = self.walk(resolution, &grid, steps, needed);
            let change = (next.walked.mean_return - last.walked.mean_return).abs();
            changes[most].add(change);
            best = better(best, next);
            let missed = missed(&changes);
            let to_come = changes[most].still_to_come();
            // Where the others have more to come, it is their turn next.
            let is_negligible = NEGLIGIBLE * to_come < missed - to_come;
            if !(missed.is_finite() && missed >= small && is_negligible) {
                last = next;
            }
        }
        // The policy of a grid that is coarser in a variable is only better than the last one's where
        // this is flawed, or by chance.
        if best.resolution.is_coarser_in_one(last.resolution) {
            best = better(self.walked_longer(best, small), last);
        }
        let flawed = best.walked.mean_return - last.walked.mean_return;
        let missed = f64::max(missed(&changes), flawed);
        let allowed = f64::max(small - missed, f64::max(small, missed) / 2.0);
        let walked = self.walked_longer(best, allowed).walked;
        Optimum { mean_return: walked.mean_return, error: missed + 2.0 * walked.standard_error }
    }

    /// The policy of a grid, over as many more episodes as it needs for two standard errors to be what
    /// is allowed, or as there is time for.
    fn walked_longer(&mut self, tried: Tried, allowed: f64) -> Tried {
        let layers = self.values(tried.nodes, tried.walked.layers);
        let left = self.most_computed.saturating_sub(self.computed + layers);
        let affordable = left / self.stepping(1);
        let episodes = tried.episodes_for(allowed).min(affordable);
        if episodes < 2 * tried.walked.episodes {
            return tried;
        }
        self.computed += layers + self.stepping(episodes);
        let walked =
            walk::mean_return(&self.grid(tried.resolution, tried.stretches_after), |_| episodes);
        Tried { walked, ..tried }
    }

    fn grid(&self, resolution: Resolution, stretches_after: u32) -> Grid {
        let mut grid = Grid::new(self.environment, self.belief, resolution);
        (grid.threads, grid.stretches_after) = (self.threads, stretches_after);
        grid
    }

    /// The policy of a grid, over episodes of so many steps in all, or over more if so many episodes are
    /// `needed`.
    fn walk(&mut self, resolution: Resolution, grid: &Grid, steps: f64, needed: usize) -> Tried {
        let nodes = grid.nodes();
        let episodes = |layers| self.episodes(nodes, layers, steps, needed);
        let walked = walk::mean_return(grid, episodes);
        self.computed += self.values(nodes, walked.layers) + self.stepping(walked.episodes);
        Tried { resolution, stretches_after: grid.stretches_after, nodes, steps, walked }
    }

    /// How many episodes of so many steps in all, or of more if so many episodes are needed: at most as
    /// many as take a fraction of the time of the values.
    fn episodes(&self, nodes: usize, layers: usize, steps: f64, needed: usize) -> usize {
        let (fewest, most) = EPISODES;
        let usual = ((steps / f64::from(self.environment.horizon)) as usize).clamp(fewest, most);
        let affordable = self.values(nodes, layers) / (OF_NOISY_EPISODES * self.stepping(1));
        usual.max(needed.min(affordable))
    }

    /// The values of layers of so many nodes. Where the context is inferred, a value takes twice the
    /// time, and counts as much.
    pub fn values(&self, nodes: usize, layers: usize) -> usize {
        nodes * layers * if self.infers() { 2 } else { 1 }
    }

    /// Values that are computed in the time of so many episodes.
    fn stepping(&self, episodes: usize) -> usize {
        let a_step = if self.infers() { VALUES_A_STEP * 3 / 2 } else { VALUES_A_STEP };
        a_step * episodes * self.environment.horizon as usize
    }

    fn infers(&self) -> bool {
        matches!(self.belief, Belief::Inferred { .. })
    }

    /// Whether there is time and room for a grid with so many layers or somewhat more, and for its
    /// episodes.
    fn affords(&self, grid: &Grid, layers: usize, steps: f64, needed: usize) -> bool {
        let (nodes, layers) = (grid.nodes(), layers * 5 / 4);
        let episodes = self.episodes(nodes, layers, steps, needed);
        let takes = self.values(nodes, layers) + self.stepping(episodes);
        // Layers are computed twice; at most three times the root of their number are kept.
        self.computed + takes <= self.most_computed && nodes * 3 * (layers / 2).isqrt() <= MOST_KEPT
    }
}

/// What finer and finer lines would still change, in all variables.
fn missed(changes: &[Changes]) -> f64 {
    changes.iter().map(Changes::still_to_come).sum()
}

/// The variable of which most is still to come; if that is small in all of them, one that was made
/// finer only once, if any.
fn most_to_come(changes: &[Changes], small: f64) -> Option<usize> {
    if missed(changes) < small {
        return changes.iter().position(|changes| changes.before.is_none());
    }
    // Of equals the last: habituation first, which makes episodes less noisy.
    let by_need =
        |i: &usize, j: &usize| changes[*i].still_to_come().total_cmp(&changes[*j].still_to_come());
    (0..changes.len()).max_by(by_need)
}

/// The better of a policy and a finer grid's: the latter, unless the former is better beyond chance,
/// which happens where the value of a finer grid is flawed in a place that its policy prefers.
fn better(best: Tried, next: Tried) -> Tried {
    let (by, other) = (best.walked, next.walked);
    let chance = 2.0 * (by.standard_error + other.standard_error);
    if by.mean_return - other.mean_return > chance { best } else { next }
}

#[cfg(test)]
mod tests {
    use super::super::grid::Region;
    use super::*;

    fn changed(variable: Variable, changes: &[f64]) -> Changes {
        let mut all = Changes::none_in(variable);
        changes.iter().for_each(|change| all.add(*change));
        all
    }

    #[test]
    fn what_is_still_to_come_is_told_by_the_last_two_changes() {
        let of = |changes: &[f64]| changed(Variable::Disengagement, changes).still_to_come();
        assert_eq!((of(&[]), of(&[0.4])), (f64::INFINITY, 0.4));
        // A sixth of the change before is more than half of the last, or less.
        assert_eq!((of(&[0.3, 0.05]), of(&[0.3, 0.2])), (0.3 / 3.0 / 2.0, 0.1));
        // The same lines tried again, beside finer ones in the other variable, tell more than the
        // coarse ones did.
        assert_eq!(of(&[9.0, 0.6, 0.1]), 0.6 / 3.0 / 2.0);
    }

    #[test]
    fn the_variable_with_the_most_to_come_is_next() {
        let next = |disengagement: &[f64], habituation: &[f64]| {
            let changes = [
                changed(Variable::Disengagement, disengagement),
                changed(Variable::Habituation, habituation),
            ];
            most_to_come(&changes, 0.1)
        };
        // Of equals habituation.
        assert_eq!(next(&[], &[]), Some(1));
        assert_eq!(next(&[], &[5.0]), Some(0));
        assert_eq!((next(&[2.0], &[5.0]), next(&[5.0], &[2.0])), (Some(1), Some(0)));
        // Little may be a coincidence, once.
        assert_eq!(
            (next(&[0.01], &[0.03, 0.02]), next(&[0.02, 0.01], &[0.02])),
            (Some(0), Some(1))
        );
        assert_eq!(next(&[0.02, 0.01], &[0.03, 0.02]), None);
    }

    #[test]
    fn a_finer_grid_s_policy_is_kept_unless_the_other_is_better_beyond_chance() {
        let tried = |mean_return, standard_error| Tried {
            resolution: Resolution {
                habituation: 20,
                disengagement: 75,
                jumps: 50,
                levels: 0,
                region: Region::ALL,
            },
            stretches_after: 0,
            nodes: 1,
            steps: 1.0,
            walked: Walked {
                mean_return,
                standard_error,
                episodes: 100,
                layers: 1,
                stretches_after: 0,
                region: Region::ALL,
            },
        };
        let kept = |coarse, fine| better(coarse, fine).walked.mean_return;
        assert_eq!(kept(tried(101.0, 0.2), tried(100.0, 0.2)), 101.0);
        assert_eq!(kept(tried(101.0, 0.3), tried(100.0, 0.3)), 100.0);
        assert_eq!(kept(tried(99.0, 0.1), tried(100.0, 0.1)), 100.0);
        // Twice the error that is allowed takes four times the episodes; no more than the most.
        assert_eq!(tried(1.0, 0.5).episodes_for(0.5), 400);
        assert_eq!(tried(1.0, 0.5).episodes_for(1e-9), MOST_EPISODES);
    }
}
