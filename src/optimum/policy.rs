//! The optimal policy.

use super::limits::{NoOptimum, check};
use super::solution::{Resolution, Solution};
use crate::env::{Action, Belief, Scenario, StepCount};

/// The policy whose mean return is the optimum, up to the error of the grid.
#[derive(Clone, Debug)]
pub struct OptimalPolicy(Solution);

impl OptimalPolicy {
    /// The optimal policy of a scenario in an environment. At the paper's horizon, this takes less than 0.1 s
    /// and 45 MB.
    ///
    /// **Errors**: see [`check`].
    pub fn new(environment: &StepCount, scenario: &Scenario) -> Result<Self, NoOptimum> {
        check(environment, scenario)?;
        let belief = Belief::new(environment, scenario);
        let resolution = Resolution::fine(environment, belief);
        Ok(OptimalPolicy(Solution::new(environment, belief, resolution)))
    }

    /// The best action in a state where context 0 has the probability `believed`, in [0, 1]; ties go to the
    /// lowest number. `time` counts from 0.
    pub fn choose(&self, time: u32, believed: f64, habituation: f64, disengagement: f64) -> Action {
        self.0.choose(time, believed, habituation, disengagement)
    }
}
