//! Constraints that several algorithms share, and limits on the memory of a training.
//!
//! In: the values of some keys in one cell of a grid, or sizes of networks and buffers. Out: the
//! violation, or the size with its limit. Each algorithm lists its own constraints.

use crate::agent::network::NoEngine;
use crate::key::{Assignment, Constraint, Parameter, Size, Value, Violation};

/// Maximum number of parameters of a network. Training holds five 4-byte numbers per parameter: its
/// value, its gradient, two moments, and its value in the target network.
const MOST_NETWORK_PARAMETERS: u64 = 20_000_000;

/// Maximum number of 4-byte values in the inputs and hidden layers of one update's batch; the
/// gradient takes about as many again.
const MOST_BATCH_NUMBERS: u64 = 200_000_000;

/// Maximum number of 4-byte values in a replay buffer.
const MOST_BUFFER_NUMBERS: u64 = 500_000_000;

/// Maximum number of points of a learning curve.
const MOST_CURVE_POINTS: u64 = 1_000_000;

/// Maximum number of decisions that a job records. Training holds 88 bytes per decision, and the
/// store 70 to 130.
const MOST_DECISIONS: u64 = 5_000_000;

/// Number of steps after which an episode ends.
pub const HORIZON: Parameter = Parameter::Environment("horizon");
/// Whether a step without reward follows the horizon.
pub const UNPAID_LAST_STEP: Parameter = Parameter::Environment("unpaid_last_step");
/// The engine that computes the network.
const ENGINE: Parameter = Parameter::Agent("engine");
/// Number of training episodes.
pub const EPISODES: Parameter = Parameter::Agent("episodes");
/// Widths of hidden layers.
const LAYERS: Parameter = Parameter::Agent("layers");
/// The memory of the episode.
pub const RECURRENT: Parameter = Parameter::Agent("recurrent");
/// Hidden layers in front of a GRU.
const LAYERS_BEFORE_GRU: Parameter = Parameter::Agent("layers_before_gru");
/// Number of training episodes per point of the learning curve.
const CURVE_STRIDE: Parameter = Parameter::Evaluation("curve_stride");

/// Constraints on every algorithm that trains.
pub const OF_TRAINING: &[Constraint] =
    &[CURVE_FITS, DECISIONS_FIT, DECISIONS_OF_EPISODES, QUARTILES_WITHOUT_EPISODES, FIRST_TRAINED];

/// Constraints on every algorithm that does not train.
pub const OF_TESTING: &[Constraint] =
    &[TEST_DECISIONS_FIT, DECISIONS_OF_EPISODES, QUARTILES_WITHOUT_EPISODES, FIRST_TESTED];

/// The learning curve has at most as many points as a store should hold.
const CURVE_FITS: Constraint = Constraint {
    parameters: &[EPISODES, CURVE_STRIDE],
    violation: |assignment| {
        let size = assignment.whole(EPISODES).div_ceil(assignment.whole(CURVE_STRIDE));
        let (what, unit) = ("the learning curve has", "points");
        Size { what, unit, size, most: MOST_CURVE_POINTS }.violation()
    },
};

/// The engine is part of this build.
pub const ENGINE_IS_BUILT: Constraint = Constraint {
    parameters: &[ENGINE],
    violation: |assignment| {
        let is_missing = !cfg!(feature = "burn") && assignment.is_word(ENGINE, "burn");
        is_missing.then(|| Violation::Contradiction(NoEngine.to_string()))
    },
};

/// The number of hidden layers in front of a GRU does not exceed the number of hidden layers.
pub const GRU_HAS_ITS_LAYERS: Constraint = Constraint {
    parameters: &[RECURRENT, LAYERS_BEFORE_GRU, LAYERS],
    violation: |assignment| {
        let layers = match assignment.value(LAYERS) {
            Some(Value::Wholes(widths)) => widths.len() as u64,
            Some(_) | None => 0,
        };
        let violated = has_gru(assignment) && assignment.whole(LAYERS_BEFORE_GRU) > layers;
        violated.then(|| {
            assignment.contradiction(LAYERS_BEFORE_GRU, "must not exceed the number of", LAYERS)
        })
    },
};

/// Whether the network has a GRU.
pub fn has_gru(assignment: &Assignment) -> bool {
    assignment.is_word(RECURRENT, "gru")
}

/// Number of test episodes.
const TEST_EPISODES: Parameter = Parameter::Evaluation("test_episodes");
/// Number of people in a trial; manifests without a trial have no such key.
const PEOPLE: Parameter = Parameter::Trial("people");
/// Which decisions are recorded.
const RECORD_DECISIONS: Parameter = Parameter::Evaluation("record_decisions");

/// The number of decisions of an agent that trains is at most what a job can record.
const DECISIONS_FIT: Constraint = Constraint {
    parameters: &[EPISODES, TEST_EPISODES, PEOPLE, HORIZON, UNPAID_LAST_STEP, RECORD_DECISIONS],
    violation: |assignment| decisions_fit(assignment, assignment.whole(EPISODES)),
};

/// The number of decisions of an agent that does not train is at most what a job can record.
const TEST_DECISIONS_FIT: Constraint = Constraint {
    parameters: &[TEST_EPISODES, PEOPLE, HORIZON, UNPAID_LAST_STEP, RECORD_DECISIONS],
    violation: |assignment| decisions_fit(assignment, 0),
};

/// Whether the results of single people are stored.
const RECORD_EPISODES: Parameter = Parameter::Evaluation("record_episodes");

/// Recorded decisions belong to recorded episodes.
const DECISIONS_OF_EPISODES: Constraint = Constraint {
    parameters: &[RECORD_EPISODES, RECORD_DECISIONS],
    violation: |assignment| {
        let violated = assignment.is_word(RECORD_EPISODES, "none")
            && !assignment.is_word(RECORD_DECISIONS, "none");
        let says = "leaves out the episodes of";
        violated.then(|| assignment.contradiction(RECORD_EPISODES, says, RECORD_DECISIONS))
    },
};

const RECORD_QUARTILES: Parameter = Parameter::Evaluation("record_quartiles");

/// Where episodes are stored, both quartiles are computed from them.
const QUARTILES_WITHOUT_EPISODES: Constraint = Constraint {
    parameters: &[RECORD_EPISODES, RECORD_QUARTILES],
    violation: |assignment| {
        let is_idle = assignment.is_word(RECORD_QUARTILES, "both")
            && assignment.is_word(RECORD_EPISODES, "all");
        is_idle.then(|| Violation::Impossible {
            says: "record_quartiles = \"both\" does nothing with record_episodes = \"all\": quartiles are computed from episodes"
                .to_owned(),
            help: "leave record_quartiles out, or set record_episodes = \"none\"".to_owned(),
        })
    },
};

/// Numbers of first episodes whose mean return is a metric.
const FIRST_EPISODES: Parameter = Parameter::Evaluation("first_episodes");

/// An agent trains for at least as many first episodes as metrics need.
const FIRST_TRAINED: Constraint = Constraint {
    parameters: &[FIRST_EPISODES, EPISODES, PEOPLE],
    violation: |assignment| first_fit(assignment, EPISODES),
};

/// An agent that does not train has at least as many test episodes as metrics of first episodes
/// need.
const FIRST_TESTED: Constraint = Constraint {
    parameters: &[FIRST_EPISODES, TEST_EPISODES, PEOPLE],
    violation: |assignment| first_fit(assignment, TEST_EPISODES),
};

fn first_fit(assignment: &Assignment, episodes: Parameter) -> Option<Violation> {
    let Some(Value::Wholes(numbers)) = assignment.value(FIRST_EPISODES) else { return None };
    let most = numbers.last().map_or(0, |most| u64::from(*most));
    let episodes = if assignment.value(PEOPLE).is_some() { PEOPLE } else { episodes };
    let violated = most > assignment.whole(episodes);
    violated.then(|| assignment.contradiction(FIRST_EPISODES, "must not exceed", episodes))
}

fn decisions_fit(assignment: &Assignment, training_episodes: u64) -> Option<Violation> {
    // A trial has an episode per person and no training.
    let (training_episodes, test) = match assignment.value(PEOPLE) {
        Some(_) => (0, assignment.whole(PEOPLE)),
        None => (training_episodes, assignment.whole(TEST_EPISODES)),
    };
    let episodes = if assignment.is_word(RECORD_DECISIONS, "all") {
        test.saturating_add(training_episodes)
    } else if assignment.is_word(RECORD_DECISIONS, "test") {
        test
    } else {
        0
    };
    recorded_decisions(episodes, longest_episode(assignment)).violation()
}

/// The size of the record of decisions of episodes with at most `longest` steps.
pub fn recorded_decisions(episodes: u64, longest: u64) -> Size {
    let (what, unit) = ("the record of decisions can have", "steps");
    Size { what, unit, size: episodes.saturating_mul(longest), most: MOST_DECISIONS }
}

/// The size of networks with this number of parameters.
pub fn network_size(parameters: u64) -> Size {
    let (what, unit) = ("the network has", "parameters");
    Size { what, unit, size: parameters, most: MOST_NETWORK_PARAMETERS }
}

/// The size of a batch of `rows` rows, for which the layers of networks hold `each` values per row.
pub fn batch_size(rows: u64, each: u64) -> Size {
    let (what, unit) = ("the batch of an update holds", "numbers of 4 bytes");
    Size { what, unit, size: rows.saturating_mul(each), most: MOST_BATCH_NUMBERS }
}

/// The size of a replay buffer of this number of transitions between observations of `features`
/// numbers.
pub fn replay_size(transitions: u64, features: u64) -> Size {
    // The features of the state; reward; target; moment, action and status together. The state
    // after a truncation may be stored as well.
    let size = transitions.saturating_mul(2 * features + 3);
    let (what, unit) = ("the replay buffer holds up to", "numbers of 4 bytes");
    Size { what, unit, size, most: MOST_BUFFER_NUMBERS }
}

/// Number of steps of an episode that does not end early.
pub fn longest_episode(assignment: &Assignment) -> u64 {
    let unpaid = u64::from(assignment.is_set(UNPAID_LAST_STEP));
    assignment.whole(HORIZON).saturating_add(unpaid)
}
