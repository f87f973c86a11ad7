//! How trained agents are tested, as one job holds it: single values, every key present.

use serde::{Deserialize, Serialize};

use crate::agent::Actions;

/// How a trained agent is tested and what is kept of its training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluation {
    /// Test episodes after training.
    pub test_episodes: u32,
    /// How actions are chosen in the test episodes.
    pub test_actions: TestActions,
    /// Training episodes a point of the learning curve averages over.
    pub curve_stride: u32,
}

impl Default for Evaluation {
    fn default() -> Self {
        Evaluation { test_episodes: 1000, test_actions: TestActions::AsTrained, curve_stride: 10 }
    }
}

/// How actions are chosen in the test episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TestActions {
    /// As at the end of training: DQN explores at its last rate, REINFORCE samples.
    AsTrained,
    /// The action of highest value or probability; the lowest numbered of equals.
    Greedy,
}

impl From<TestActions> for Actions {
    fn from(actions: TestActions) -> Self {
        match actions {
            TestActions::AsTrained => Actions::AsTrained,
            TestActions::Greedy => Actions::Greedy,
        }
    }
}
