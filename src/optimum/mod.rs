//! The optimum: the best undiscounted return that any policy can reach, and a policy that reaches it.
//!
//! In: an environment and a scenario that shows habituation and disengagement risk. Out: an
//! [`Optimum`] with the error of its numbers, or an [`OptimalPolicy`]. It knows no agent, no run and
//! no random stream: the expectation over the context signal is exact.
//!
//! The state of an episode is (time, habituation, disengagement risk). The context signal is drawn
//! anew in every step, so backward induction over the state, with the signal integrated out, is
//! exact but for the grid on which the values are kept.
//!
//! It stands before the agents and not with the analyses, because the optimal policy is one of the
//! rules that agents are compared with.

mod axis;
mod expectation;
mod grid;

use crate::env::{Action, Belief};
use crate::manifest::{Environment, Feature, FirstContext, Scenario};

use grid::{Grid, Resolution};

/// The grid of the value; its numbers are within 0.1 of the limit for the paper's parameters.
const OF_VALUE: Resolution = Resolution { habituation: 400, disengagement: 400, jumps: 120 };
/// The grid of the policy, which keeps the values of every step.
const OF_POLICY: Resolution = Resolution { habituation: 120, disengagement: 120, jumps: 60 };
/// Most values that are computed for an optimum: a few seconds.
const MOST_COMPUTED: usize = 300_000_000;
/// Most values that a policy keeps: 80 MB.
const MOST_KEPT: usize = 10_000_000;

/// The best that can be done in an environment by who observes a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optimum {
    /// Mean undiscounted return of the optimal policy, in steps walked.
    pub mean_return: f64,
    /// How far that may be off, because values are kept on a grid, in steps walked: the correction
    /// that a second grid suggested, which is made.
    pub grid_error: f64,
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
pub fn optimum(environment: &Environment, scenario: &Scenario) -> Result<Optimum, StateHidden> {
    shows_state(scenario)?;
    let belief = Belief::new(environment, scenario);
    let resolution = OF_VALUE.within(environment.horizon, MOST_COMPUTED);
    let fine = Grid::new(environment, belief, resolution).best_return();
    let coarse = Grid::new(environment, belief, resolution.halved()).best_return();
    // Between the nodes values are interpolated linearly, so half the steps have a quarter of the
    // error, and the two differ by three times what is left (Richardson 1911).
    let correction = (fine - coarse) / 3.0;
    Ok(Optimum { mean_return: fine + correction, grid_error: correction.abs() })
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
    /// By the number of steps that are left, from 0; more steps than there are entries are as many
    /// as the last one's.
    values: Vec<Vec<f64>>,
}

impl OptimalPolicy {
    /// The optimal policy of a scenario in an environment. Takes about a tenth of a second at the
    /// paper's horizon.
    ///
    /// **Errors**: the scenario does not show habituation and disengagement risk.
    pub fn new(environment: &Environment, scenario: &Scenario) -> Result<Self, StateHidden> {
        shows_state(scenario)?;
        let resolution = OF_POLICY.within(environment.horizon, MOST_KEPT);
        let grid = Grid::new(environment, Belief::new(environment, scenario), resolution);
        let mut values = Vec::new();
        grid.induce(|_, layer| values.push(layer.to_vec()));
        Ok(OptimalPolicy { grid, values })
    }

    /// The best action in a state where context 0 has the probability `believed`, in [0, 1]; the
    /// lowest numbered of equals. `time` counts from 0 and is below the horizon.
    pub fn choose(&self, time: u32, believed: f64, habituation: f64, disengagement: f64) -> Action {
        let environment = self.grid.environment();
        let left = environment.horizon.saturating_sub(time + 1) as usize;
        let later = &self.values[left.min(self.values.len() - 1)];
        let is_known = time == 0 && environment.first_context == FirstContext::Fixed;
        self.grid.prospects(later, habituation, disengagement).best(if is_known {
            1.0
        } else {
            believed
        })
    }
}

#[cfg(test)]
mod tests;
