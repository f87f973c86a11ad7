//! How trained agents are tested, as one job holds it: single values, every key present.

use crate::agent::Actions;
use crate::key::{Keyed, Kind};
use crate::{choices, keys};

keys! {
    /// How a trained agent is tested and what is kept of its training.
    pub struct Evaluation {
        /// test episodes after training
        test_episodes: u32 = 1000, in Kind::EPISODES;
        /// how actions are chosen in the test episodes
        test_actions: TestActions = TestActions::AsTrained;
        /// training episodes a point of the learning curve averages over
        curve_stride: u32 = 10, in Kind::EPISODES;
    }
}

impl Default for Evaluation {
    fn default() -> Self {
        Evaluation::with_required(&[])
    }
}

choices! {
    /// How actions are chosen in the test episodes.
    pub enum TestActions {
        /// As at the end of training: DQN explores at its last rate, REINFORCE samples.
        AsTrained = "as_trained",
        /// The action of highest value or probability; the lowest numbered of equals.
        Greedy = "greedy",
    }
}

impl From<TestActions> for Actions {
    fn from(actions: TestActions) -> Self {
        match actions {
            TestActions::AsTrained => Actions::AsTrained,
            TestActions::Greedy => Actions::Greedy,
        }
    }
}
