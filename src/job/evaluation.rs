//! How trained agents are tested, as one job holds it: single values, every key present.

use super::metric::{MetricName, first_return};
use crate::agent::Actions;
use crate::key::{Keyed, Kind, choices, keys};

keys! {
    /// How a trained agent is tested and its training recorded.
    pub struct Evaluation {
        /// test episodes after training; 0 with on = "trial"
        test_episodes: u32 = 1000, in Kind::Integer { min: 0, max: 10_000_000 };
        /// how actions are chosen in the test episodes
        test_actions: TestActions = TestActions::AsTrained;
        /// training episodes per point of the learning curve
        curve_stride: u32 = 10, in Kind::EPISODES;
        /// which decisions are stored, one row per step in the view `decision`: "none", only those
        /// of the "test", or "all" of training and test
        record_decisions: RecordedDecisions = RecordedDecisions::None, before RecordedDecisions::None;
        /// numbers of people: for each number n, the metric "mean_return_first_n" (such as
        /// mean_return_first_140) is the mean return of the first n training episodes, or of the first n test
        /// episodes of an agent that does not train
        first_episodes: Vec<u32> = Vec::new(), before Vec::new(), in Kind::Counts { most: 20, max: 10_000_000 };
        /// which results of single people are stored: "all", or "none", which leaves the metrics, the learning
        /// curve and the counts of actions, without episodes, participants and weights
        record_episodes: RecordedEpisodes = RecordedEpisodes::All, before RecordedEpisodes::All;
        /// which quartiles of the return are metrics where record_episodes = "none": the "lower" one, or "both";
        /// elsewhere analyses compute them from the episodes
        record_quartiles: RecordedQuartiles = RecordedQuartiles::Lower, before RecordedQuartiles::Lower;
        /// what the agent is evaluated on: "test" episodes after its training, or the people of the "trial" in
        /// which it learned
        on: EvaluatedOn = EvaluatedOn::Test, before EvaluatedOn::Test;
        /// whether the posterior of the effects of messages after every update of a trial is stored, one row per update
        /// and message in the view `posterior`, for linear_thompson with pooling = "full" and, for each person too, "partial"
        record_posteriors: bool = false, before false;
    }
}

impl Evaluation {
    /// The metrics of first episodes, fewest episodes first.
    pub fn first_returns(&self) -> impl Iterator<Item = MetricName> {
        self.first_episodes.iter().map(|episodes| first_return(*episodes))
    }
}

impl Default for Evaluation {
    fn default() -> Self {
        Evaluation::with_required(&[])
    }
}

choices! {
    /// What an agent is evaluated on.
    pub enum EvaluatedOn {
        /// Test episodes.
        Test = "test",
        /// The people of its trial.
        Trial = "trial",
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

choices! {
    /// Whether the results of single people are stored.
    pub enum RecordedEpisodes {
        /// Episodes, participants and weights.
        All = "all",
        /// Metrics alone.
        None = "none",
    }
}

choices! {
    /// Which quartiles of the return are metrics where episodes are not stored.
    pub enum RecordedQuartiles {
        /// The lower one.
        Lower = "lower",
        /// The lower and the upper one.
        Both = "both",
    }
}

choices! {
    /// Which decisions of a job are recorded.
    pub enum RecordedDecisions {
        /// No decisions.
        None = "none",
        /// The decisions of the test episodes.
        Test = "test",
        /// The decisions of the training episodes and of the test episodes.
        All = "all",
    }
}

impl RecordedDecisions {
    /// Whether the decisions of the training are recorded.
    pub fn of_training(self) -> bool {
        match self {
            RecordedDecisions::None | RecordedDecisions::Test => false,
            RecordedDecisions::All => true,
        }
    }

    /// Whether the decisions of the test are recorded.
    pub fn of_test(self) -> bool {
        match self {
            RecordedDecisions::None => false,
            RecordedDecisions::Test | RecordedDecisions::All => true,
        }
    }
}
