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

/// The grid of the value, for up to about 800 steps; for more it is coarser.
const OF_VALUE: Resolution = Resolution { habituation: 160, disengagement: 2000, jumps: 400 };
/// The grid of the policy, which keeps the values of every step.
const OF_POLICY: Resolution = Resolution { habituation: 80, disengagement: 240, jumps: 80 };
/// The grid where nobody's disengagement risk ever grows.
const OF_HABITUATION: Resolution = Resolution { habituation: 2000, disengagement: 1, jumps: 1 };
/// Most values that are computed on a grid: a few seconds.
const MOST_COMPUTED: usize = 360_000_000;
/// Most values that a policy keeps: 80 MB.
const MOST_KEPT: usize = 10_000_000;

/// The best that can be done in an environment by who observes a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optimum {
    /// Mean undiscounted return of the optimal policy, in steps walked.
    pub mean_return: f64,
    /// How far that may be off, because values are kept on a grid, in steps walked: what halving the
    /// grid's fineness changes, or a quarter of what halving it once more does, if that is more.
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
    let (horizon, belief) = (environment.horizon, Belief::new(environment, scenario));
    let finest = finest(environment, belief, OF_VALUE);
    let affordable = finest.within(horizon, MOST_COMPUTED);
    let of_resolution =
        |resolution, most_steps| Grid::new(environment, belief, resolution).best_return(most_steps);
    // Where steps come to add the same, fewer are computed than an episode has, and the grid can be
    // finer; a coarse grid shows how many, more or less.
    let most_steps = if affordable == finest {
        horizon
    } else {
        let seen = of_resolution(affordable.scaled(0.5), horizon);
        seen.map_or(horizon, |(_, steps)| horizon.min(steps.saturating_mul(3)))
    };
    let of_three = |finest: Resolution, most_steps| {
        let of = |share| of_resolution(finest.scaled(share), most_steps);
        Some([of(0.25)?.0, of(0.5)?.0, of(1.0)?.0])
    };
    let [coarse, medium, fine] = of_three(finest.within(most_steps, MOST_COMPUTED), most_steps)
        .or_else(|| of_three(affordable, horizon))
        .expect("every step may be computed");
    // Half the steps have a quarter of the error, or so: values are interpolated linearly, but
    // across the jumps that have no line. The two changes tell it twice.
    let grid_error = f64::max((fine - medium).abs(), (medium - coarse).abs() / 4.0);
    Ok(Optimum { mean_return: fine, grid_error })
}

/// The finest grid of an environment for who knows so much of the context.
fn finest(environment: &Environment, belief: Belief, usual: Resolution) -> Resolution {
    // Whoever is certain never sends what does not suit, if nothing is gained by an early end.
    let harmless = environment.rho_2 >= 0.0 && environment.mu[0] + environment.mu[1] >= 0.0;
    if belief == Belief::Certain && harmless { OF_HABITUATION } else { usual }
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
        let (horizon, belief) = (environment.horizon, Belief::new(environment, scenario));
        let resolution = finest(environment, belief, OF_POLICY).within(horizon, MOST_KEPT);
        let grid = Grid::new(environment, belief, resolution);
        let mut values = Vec::new();
        grid.induce(horizon, |_, layer| values.push(layer.to_vec()));
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
