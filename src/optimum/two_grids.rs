//! The value of an optimum and its error, from the policies of two grids.

use super::limits::{NoOptimum, check};
use super::simulation::{MeanReturn, mean_return};
use super::solution::{Resolution, Solution};
use crate::env::{Belief, Scenario, StepCount};

/// The number of simulated episodes per grid.
const EPISODES: u64 = 400;

/// The highest mean net return in an environment for a policy that observes a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optimum {
    /// Mean undiscounted return of the best policy found, in steps walked, less the cost of messages.
    pub mean_return: f64,
    /// The estimated difference from the best possible policy's mean return, in steps walked.
    pub error: f64,
}

/// The optimum of a scenario in an environment.
///
/// **Errors**: see [`check`].
pub fn optimum(environment: &StepCount, scenario: &Scenario) -> Result<Optimum, NoOptimum> {
    check(environment, scenario)?;
    let belief = Belief::new(environment, scenario);
    let fine = Resolution::fine(environment, belief);
    let [coarse, fine] = [fine.coarser(), fine]
        .map(|resolution| mean_return(&Solution::new(environment, belief, resolution), EPISODES));
    Ok(better_of(coarse, fine))
}

/// The optimum according to the mean returns of the policies of two grids.
pub(super) fn better_of(coarse: MeanReturn, fine: MeanReturn) -> Optimum {
    let better = if coarse.mean > fine.mean { coarse } else { fine };
    let error = (fine.mean - coarse.mean).abs() + 2.0 * better.standard_error;
    Optimum { mean_return: better.mean, error }
}
