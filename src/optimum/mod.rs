//! The optimum: the highest mean undiscounted return of any policy, and a policy that reaches it.
//!
//! In: an environment and a scenario that shows habituation and disengagement risk. Out: an [`Optimum`],
//! whose error is stated, or an [`OptimalPolicy`]. The module knows no agents and no runs. It stands
//! before the agents because the optimal policy is one of the decision rules that agents are compared
//! with.
//!
//! # State and recursion
//!
//! The state of an episode is the number of steps left n, habituation h and disengagement risk d. The
//! context is drawn anew in every step, so the policy's probability p of context 0 is not part of the
//! state. With `C`, p is 0 or 1; with `P`, it follows from the context feature; with `L`, it is the
//! accuracy of the inference or its complement; with none of them, it is 1/2. A message leads to
//! h' = min(h + epsilon_h, 1). V is 0 where n = 0 or d is at least the threshold. Otherwise
//!
//! ```text
//! nothing      N = V(n-1, (1 - delta_h) h, d)
//! untailored   U = (1 - h') rho_1 + V(n-1, h', (1 - delta_d) d)
//! suitable     S = (1 - h') rho_2 + V(n-1, h', (1 - delta_d) d)
//! unsuitable   F = V(n-1, h', d + epsilon_d)
//! V(n, h, d) = (mu_0 + mu_1) / 2 + E_p max(N, U, p S + (1 - p) F, (1 - p) S + p F)
//! ```
//!
//! The mean over p has a closed form (`expectation.rs`). The policy takes the action that attains the
//! maximum. It knows the first context where `first_context` is fixed.
//!
//! # Grid
//!
//! V is computed for n = 1, 2, … at the nodes of a grid of h and d (`solution.rs`). In h the value is
//! continuous: a message leads from node to node, and a cubic interpolates where a step without one
//! leads. In d the value jumps, because a wrong message ends the episode from threshold - epsilon_d on,
//! and each jump reappears at the risks that lead to it. The largest jumps have two nodes, one on either
//! side, and interpolation is linear between neighbouring nodes (`axis.rs`).
//!
//! # The number and its error
//!
//! The policy looks one step further than the grid: it maximises action values by V~, where V~ is not
//! interpolated but computed by the recursion from the interpolated V of the step after. Its mean return
//! follows from simulated episodes (`simulation.rs`) with states s_t, where T V~ is the right-hand side of
//! the recursion with V~ for V:
//!
//! ```text
//! mean return = V~(s_0) + E sum over t > 0 of [T V~(s_t) - V~(s_t)]
//! ```
//!
//! All other terms cancel, because T V~ is the mean of reward and V~ of the next state under this policy.
//! The brackets are small errors of interpolation, so a few hundred episodes give the mean return to a few
//! hundredths of a step. Up to this noise, it is a lower bound of the optimum.
//!
//! This is done on two grids, one with half the spacing of the other, and the larger mean return counts. Its
//! error is the difference of the two plus two standard errors: a still finer grid usually gains less than
//! the last refinement did. The error is an estimate, not a bound.
//!
//! # Limits and cost
//!
//! Horizons are at most [`LONGEST_OPTIMUM`] steps, because the values of all steps are kept. An optimum
//! takes 0.1 s of one core and 45 MB at the paper's horizon, and 0.6 s and up to 250 MB at 200 steps.
//! There is one thread and no fused operation, so every machine computes the same bits.

mod axis;
mod expectation;
mod several;
mod simulation;
mod solution;

use crate::env::{Action, Belief};
use crate::env::{Environment, Feature, Scenario};

pub use several::several;
use simulation::MeanReturn;
use solution::{Resolution, Solution};

/// Longest horizon, in steps, for which an optimum is computed.
pub const LONGEST_OPTIMUM: u32 = 200;

/// Simulated episodes per grid.
const EPISODES: u64 = 400;

/// The highest mean return in an environment for a policy that observes a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optimum {
    /// Mean undiscounted return of the best policy found, in steps walked.
    pub mean_return: f64,
    /// Estimated distance from the best possible policy's mean return, in steps walked.
    pub error: f64,
}

/// Why no optimum is computed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoOptimum {
    /// The scenario hides a part of the state.
    #[error(
        "no optimum is computed for {scenario}, which does not show both habituation (H) and \
         disengagement risk (D); that of {shown} is an upper bound"
    )]
    StateHidden {
        /// The scenario.
        scenario: Scenario,
        /// The scenario with the features that it lacks.
        shown: String,
    },
    /// Episodes are too long.
    #[error(
        "no optimum is computed for a horizon of {horizon} steps; {LONGEST_OPTIMUM} are the most"
    )]
    TooLong {
        /// Steps of an episode.
        horizon: u32,
    },
}

/// Whether an optimum can be computed.
///
/// **Errors**: the scenario hides a part of the state, or the horizon is too long.
pub fn check(environment: &Environment, scenario: &Scenario) -> Result<(), NoOptimum> {
    if !scenario.shows_state() {
        let hidden = |feature: &Feature| !scenario.features().contains(feature);
        let state = [Feature::Habituation, Feature::Disengagement].into_iter();
        let lacking: String = state.filter(hidden).map(|f| format!("-{}", f.letter())).collect();
        let shown = format!("{scenario}{lacking}");
        return Err(NoOptimum::StateHidden { scenario: scenario.clone(), shown });
    }
    let horizon = environment.horizon;
    if horizon > LONGEST_OPTIMUM { Err(NoOptimum::TooLong { horizon }) } else { Ok(()) }
}

/// The optimum of a scenario in an environment.
///
/// **Errors**: see [`check`].
pub fn optimum(environment: &Environment, scenario: &Scenario) -> Result<Optimum, NoOptimum> {
    check(environment, scenario)?;
    let belief = Belief::new(environment, scenario);
    let fine = Resolution::fine(environment, belief);
    let [coarse, fine] = [fine.coarser(), fine].map(|resolution| {
        simulation::mean_return(&Solution::new(environment, belief, resolution), EPISODES)
    });
    Ok(better_of(coarse, fine))
}

/// The optimum by the mean returns of the policies of two grids.
fn better_of(coarse: MeanReturn, fine: MeanReturn) -> Optimum {
    let better = if coarse.mean > fine.mean { coarse } else { fine };
    let error = (fine.mean - coarse.mean).abs() + 2.0 * better.standard_error;
    Optimum { mean_return: better.mean, error }
}

/// The value of each action in a state: its reward, the baseline aside, and the mean return after it, in
/// steps walked.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ActionValues {
    /// Nothing is sent.
    nothing: f64,
    /// A message that is not tailored.
    untailored: f64,
    /// A message tailored to the true context.
    suitable: f64,
    /// A message tailored to the other context.
    unsuitable: f64,
}

impl ActionValues {
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
        Action::from_index(best).expect("one value per action")
    }
}

/// The policy whose mean return is the optimum, up to the error of the grid.
#[derive(Clone, Debug)]
pub struct OptimalPolicy(Solution);

impl OptimalPolicy {
    /// The optimal policy of a scenario in an environment. It takes less than 0.1 s and 45 MB at the
    /// paper's horizon.
    ///
    /// **Errors**: see [`check`].
    pub fn new(environment: &Environment, scenario: &Scenario) -> Result<Self, NoOptimum> {
        check(environment, scenario)?;
        let belief = Belief::new(environment, scenario);
        let resolution = Resolution::fine(environment, belief);
        Ok(OptimalPolicy(Solution::new(environment, belief, resolution)))
    }

    /// The best action in a state where context 0 has the probability `believed`, in [0, 1]; the lowest
    /// numbered of equals. `time` counts from 0 and is below the horizon.
    pub fn choose(&self, time: u32, believed: f64, habituation: f64, disengagement: f64) -> Action {
        self.0.choose(time, believed, habituation, disengagement)
    }
}

#[cfg(test)]
mod tests;
