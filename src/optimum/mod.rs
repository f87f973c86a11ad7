//! The optimum: the best undiscounted return that any policy can reach, and a policy that reaches it.
//!
//! In: an environment and a scenario that shows habituation and disengagement risk. Out: an
//! [`Optimum`] with the error of its number, or an [`OptimalPolicy`]. It knows no agent and no run.
//!
//! The state of an episode is (time, habituation, disengagement risk). The context signal is drawn
//! anew in every step, so backward induction over the state, with the signal integrated out in
//! closed form, is exact but for the grid on which the values are kept. What the grid leaves out is
//! found by episodes of the policy that looks a step further than it, and a search refines grids until
//! that policy becomes no better, or until time is up.
//!
//! It stands before the agents and not with the analyses, because the optimal policy is one of the
//! rules that agents are compared with.

mod axis;
mod expectation;
mod grid;
mod search;
mod walk;

use std::iter;
use std::num::{NonZeroU32, NonZeroUsize};

use crate::env::{Action, Belief};
use crate::env::{Environment, Feature, FirstContext, Scenario};

use grid::{COARSEST, Grid, Induced, Lanes, Moment, Region, Resolution, SETTLED, levels};
use search::Search;

/// Most levels of a disengagement risk that never decays, for them to be the grid.
const MOST_LEVELS: usize = 200;
/// The coarsest grid where nobody's disengagement risk ever grows.
const COARSEST_OF_HABITUATION: Resolution =
    Resolution { habituation: 250, disengagement: 0, jumps: 0, levels: 0, region: Region::ALL };
/// How often the coarsest grid is refined for a policy, at most.
const POLICY_REFINED: usize = 3;
/// Most values that a policy keeps, or so: 80 MB.
const MOST_OF_POLICY: usize = 10_000_000;

/// The best that can be done in an environment by who observes a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optimum {
    /// Mean undiscounted return of the best policy that was found, in steps walked.
    pub mean_return: f64,
    /// How far that may be from the best policy's, in steps walked: for habituation and for
    /// disengagement risk, half of what the last refinement of the grid changed, or a sixth of what the
    /// one before did, if that is more, for the policy is a little worse, or all that the only one did;
    /// and two standard errors.
    pub error: f64,
}

/// How much may be computed for an optimum.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Most threads that compute.
    pub threads: NonZeroUsize,
    /// How many times as long it may take as it usually does at most, for a smaller error.
    pub times: NonZeroU32,
}

impl Effort {
    /// The usual effort, by at most so many threads: ten seconds of two cores or so at most.
    pub fn usual(threads: NonZeroUsize) -> Effort {
        Effort { threads, times: NonZeroU32::MIN }
    }
}

/// A scenario without an optimum that could be computed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no optimum is computed for {scenario}, which does not show both habituation (H) and \
     disengagement risk (D); that of {shown} is an upper bound"
)]
pub struct StateHidden {
    /// The scenario.
    pub scenario: Scenario,
    /// The scenario with what it lacks.
    pub shown: String,
}

/// Whether a scenario shows both habituation and disengagement risk, as an optimum needs.
///
/// **Errors**: it does not.
pub fn shows_state(scenario: &Scenario) -> Result<(), StateHidden> {
    if scenario.shows_state() {
        return Ok(());
    }
    let hidden = |feature: &Feature| !scenario.features().contains(feature);
    let state = [Feature::Habituation, Feature::Disengagement].into_iter();
    let lacking: String = state.filter(hidden).map(|f| format!("-{}", f.letter())).collect();
    let shown = format!("{scenario}{lacking}");
    Err(StateHidden { scenario: scenario.clone(), shown })
}

/// The optimum of a scenario in an environment.
///
/// The optimal policy knows which step it is at, and the first context where that is fixed.
///
/// **Errors**: the scenario does not show habituation and disengagement risk.
pub fn optimum(
    environment: &Environment,
    scenario: &Scenario,
    effort: Effort,
) -> Result<Optimum, StateHidden> {
    shows_state(scenario)?;
    let belief = Belief::new(environment, scenario);
    let coarsest = coarsest(environment, belief);
    let by = |effort| Search::new(environment, belief, effort).best_from(coarsest);
    let alone = Effort { threads: NonZeroUsize::MIN, ..effort };
    if effort.threads == alone.threads {
        return Ok(by(alone));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(effort.threads.get()).build();
    // A machine without threads to spare has this one.
    Ok(pool.map_or_else(|_| by(alone), |pool| pool.install(|| by(effort))))
}

/// The coarsest grid of an environment for who knows so much of the context.
fn coarsest(environment: &Environment, belief: Belief) -> Resolution {
    let [habituation, disengagement] = COARSEST;
    let region = Region::ALL;
    // Whoever is certain never sends what does not suit, if nothing is gained by an early end.
    let harmless = environment.rho_2 >= 0.0 && environment.mu[0] + environment.mu[1] >= 0.0;
    if belief == Belief::Certain && harmless {
        COARSEST_OF_HABITUATION
    } else if let Some(levels) = levels(environment, MOST_LEVELS) {
        Resolution { habituation, disengagement: 0, jumps: 0, levels: levels.len(), region }
    } else {
        let habituation = match belief {
            Belief::Inferred { .. } => habituation,
            // Values have kinks in it where the signal is one of few.
            _ => 2 * habituation,
        };
        Resolution { habituation, disengagement, jumps: 50, levels: 0, region }
    }
}

/// What each choice brings in a state, reward and everything after it; the baseline reward, which
/// is the same whatever is chosen, aside. In steps walked.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Prospects {
    /// Nothing is sent.
    nothing: f64,
    /// A message that is not tailored.
    untailored: f64,
    /// A message tailored to the true context.
    suitable: f64,
    /// A message tailored to the other context.
    unsuitable: f64,
}

impl Prospects {
    /// The best action where context 0 has this probability; the lowest numbered of equals.
    fn best(&self, probability_of_zero: f64) -> Action {
        let tailored = |p: f64| p * self.suitable + (1.0 - p) * self.unsuitable;
        let values = [
            self.nothing,
            self.untailored,
            tailored(probability_of_zero),
            tailored(1.0 - probability_of_zero),
        ];
        let better =
            |best: usize, other: usize| if values[other] > values[best] { other } else { best };
        let best = (1..Action::COUNT).fold(0, better);
        Action::from_index(best).expect("one value an action")
    }
}

/// A policy whose mean return is the optimum, but for the grid on which values are kept.
#[derive(Clone, Debug)]
pub struct OptimalPolicy {
    grid: Grid,
    /// By the number of steps that are left, from 0.
    layers: Vec<Vec<Lanes>>,
    /// The last of them, for more steps.
    last: Induced,
}

impl OptimalPolicy {
    /// The optimal policy of a scenario in an environment. Takes less than a tenth of a second at
    /// the paper's horizon.
    ///
    /// **Errors**: the scenario does not show habituation and disengagement risk.
    pub fn new(environment: &Environment, scenario: &Scenario) -> Result<Self, StateHidden> {
        shows_state(scenario)?;
        let belief = Belief::new(environment, scenario);
        let coarsest = coarsest(environment, belief);
        let on = |resolution| {
            let mut grid = Grid::new(environment, belief, resolution);
            // No tighter at a long horizon: a policy keeps all values until then.
            grid.settled = SETTLED * f64::from(environment.horizon);
            grid
        };
        // About as many as a finer grid takes.
        let steps = on(coarsest).induce(|_, _| ()).left as usize + 1;
        let finer = iter::successors(Some(coarsest), |resolution| Some(resolution.refined()));
        let finer: Vec<Resolution> = finer.skip(1).take(POLICY_REFINED).collect();
        let mut affordable =
            finer.into_iter().rev().map(on).filter(|grid| grid.nodes() * steps <= MOST_OF_POLICY);
        let grid = affordable.next().unwrap_or_else(|| on(coarsest));
        let mut layers = Vec::new();
        let last = grid.induce(|_, layer| layers.push(layer.to_vec()));
        Ok(OptimalPolicy { grid, layers, last })
    }

    /// The best action in a state where context 0 has the probability `believed`, in [0, 1]; the
    /// lowest numbered of equals. `time` counts from 0 and is below the horizon.
    pub fn choose(&self, time: u32, believed: f64, habituation: f64, disengagement: f64) -> Action {
        let environment = self.grid.environment();
        let left = environment.horizon.saturating_sub(time + 1);
        let later = match self.layers.get(left as usize) {
            Some(layer) => Moment { layer, more: 0.0 },
            None => self.last.before(left),
        };
        let is_known = time == 0 && environment.first_context == FirstContext::Fixed;
        let believed = if is_known { 1.0 } else { believed };
        self.grid.prospects(later, habituation, disengagement).best(believed)
    }
}

#[cfg(test)]
mod tests;
