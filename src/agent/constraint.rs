//! Constraints between the keys of a job: requirements that one key has on another, and limits on
//! the memory that several keys together make a training use.
//!
//! In: the values of some keys in one cell of a grid. Out: the violation, if there is one. The
//! module uses neither grids nor positions in a file; each algorithm lists its own constraints.

use crate::env::Scenario;
use crate::key::{Parameter, Value};

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

/// A constraint on the jobs of an algorithm.
#[derive(Debug)]
pub struct Constraint {
    /// The parameters concerned.
    pub parameters: &'static [Parameter],
    /// The violation by the values of these parameters, if there is one.
    pub violation: fn(&Assignment) -> Option<Violation>,
}

/// How values violate a constraint.
#[derive(Debug)]
pub enum Violation {
    /// Two keys contradict each other; the text says how.
    Contradiction(String),
    /// The values demand something impossible.
    Impossible {
        /// The fault.
        says: String,
        /// The remedy.
        help: String,
    },
    /// The keys together exceed a limit: "`what` `size` `unit`; the maximum is `most`".
    TooLarge {
        /// The quantity that is too large, as in "the network has".
        what: &'static str,
        /// The unit, as in "parameters".
        unit: &'static str,
        /// The actual size.
        size: u64,
        /// The maximum size.
        most: u64,
    },
}

/// The values that a cell assigns to the parameters of a constraint.
#[derive(Debug)]
pub struct Assignment<'v> {
    /// The cell's scenario.
    pub scenario: Scenario,
    /// The constraint's keys with their values.
    pub keys: Vec<(Parameter, &'v Value)>,
}

/// Number of steps after which an episode ends.
pub const HORIZON: Parameter = Parameter::Environment("horizon");
/// Whether a step without reward follows the horizon.
pub const UNPAID_LAST_STEP: Parameter = Parameter::Environment("unpaid_last_step");
/// Whether observations contain a one-hot of the time.
pub const ONE_HOT: Parameter = Parameter::Environment("time_one_hot");
/// Number of observations that an agent sees at a time.
pub const HISTORY: Parameter = Parameter::Agent("history");
/// Number of training episodes.
pub const EPISODES: Parameter = Parameter::Agent("episodes");
/// Widths of hidden layers.
pub const LAYERS: Parameter = Parameter::Agent("layers");
/// The memory of the episode.
pub const RECURRENT: Parameter = Parameter::Agent("recurrent");
/// Units of a GRU.
pub const UNITS: Parameter = Parameter::Agent("units");
/// Hidden layers in front of a GRU.
const LAYERS_BEFORE_GRU: Parameter = Parameter::Agent("layers_before_gru");
/// Number of training episodes per point of the learning curve.
pub const CURVE_STRIDE: Parameter = Parameter::Evaluation("curve_stride");

/// The learning curve has at most as many points as a store should hold.
pub const CURVE_FITS: Constraint = Constraint {
    parameters: &[EPISODES, CURVE_STRIDE],
    violation: |assignment| {
        let size = assignment.whole(EPISODES).div_ceil(assignment.whole(CURVE_STRIDE));
        too_large("the learning curve has", "points", size, MOST_CURVE_POINTS)
    },
};

/// The number of hidden layers in front of a GRU does not exceed the number of hidden layers.
pub const GRU_HAS_ITS_LAYERS: Constraint = Constraint {
    parameters: &[RECURRENT, LAYERS_BEFORE_GRU, LAYERS],
    violation: |assignment| {
        let violated =
            has_gru(assignment) && assignment.whole(LAYERS_BEFORE_GRU) > assignment.hidden_layers();
        violated.then(|| {
            assignment.contradiction(LAYERS_BEFORE_GRU, "must not exceed the number of", LAYERS)
        })
    },
};

/// Whether the network has a GRU.
pub fn has_gru(assignment: &Assignment) -> bool {
    assignment.is_word(RECURRENT, "gru")
}

/// Upper bound of the number of weights and biases of the GRU, for an input as wide as the
/// observation and all hidden layers together; 0 without a GRU.
pub fn gru_parameters(assignment: &Assignment) -> u64 {
    if !has_gru(assignment) {
        return 0;
    }
    let units = assignment.whole(UNITS);
    (3 * units).saturating_mul((units + 2).saturating_add(assignment.row_numbers()))
}

/// Number of values that the GRU holds per row of input: three arrays of three gates each (the
/// gates, the contribution of the state, and derivatives), and the states before and after the
/// step; 0 without a GRU.
pub fn gru_row_numbers(assignment: &Assignment) -> u64 {
    if has_gru(assignment) { 11 * assignment.whole(UNITS) } else { 0 }
}

/// Number of test episodes.
const TEST_EPISODES: Parameter = Parameter::Evaluation("test_episodes");
/// Which decisions are recorded.
const RECORD_DECISIONS: Parameter = Parameter::Evaluation("record_decisions");

/// The number of decisions of an agent that trains is at most what a job can record.
pub const DECISIONS_FIT: Constraint = Constraint {
    parameters: &[EPISODES, TEST_EPISODES, HORIZON, UNPAID_LAST_STEP, RECORD_DECISIONS],
    violation: |assignment| decisions_fit(assignment, assignment.whole(EPISODES)),
};

/// The number of decisions of an agent that does not train is at most what a job can record.
pub const TEST_DECISIONS_FIT: Constraint = Constraint {
    parameters: &[TEST_EPISODES, HORIZON, UNPAID_LAST_STEP, RECORD_DECISIONS],
    violation: |assignment| decisions_fit(assignment, 0),
};

/// Numbers of first episodes whose mean return is a metric.
const FIRST_EPISODES: Parameter = Parameter::Evaluation("first_episodes");

/// An agent trains for at least as many first episodes as metrics need.
pub const FIRST_TRAINED: Constraint = Constraint {
    parameters: &[FIRST_EPISODES, EPISODES],
    violation: |assignment| first_fit(assignment, EPISODES),
};

/// An agent that does not train has at least as many test episodes as metrics of first episodes
/// need.
pub const FIRST_TESTED: Constraint = Constraint {
    parameters: &[FIRST_EPISODES, TEST_EPISODES],
    violation: |assignment| first_fit(assignment, TEST_EPISODES),
};

fn first_fit(assignment: &Assignment, episodes: Parameter) -> Option<Violation> {
    let Some(Value::Wholes(numbers)) = assignment.value(FIRST_EPISODES) else { return None };
    let most = numbers.last().map_or(0, |most| u64::from(*most));
    let violated = most > assignment.whole(episodes);
    violated.then(|| assignment.contradiction(FIRST_EPISODES, "must not exceed", episodes))
}

fn decisions_fit(assignment: &Assignment, training_episodes: u64) -> Option<Violation> {
    let test = assignment.whole(TEST_EPISODES);
    let episodes = if assignment.is_word(RECORD_DECISIONS, "all") {
        test.saturating_add(training_episodes)
    } else if assignment.is_word(RECORD_DECISIONS, "test") {
        test
    } else {
        0
    };
    let size = episodes.saturating_mul(assignment.longest_episode());
    too_large("the record of decisions can have", "steps", size, MOST_DECISIONS)
}

/// A violation if `size` is above `most`.
fn too_large(what: &'static str, unit: &'static str, size: u64, most: u64) -> Option<Violation> {
    (size > most).then_some(Violation::TooLarge { what, unit, size, most })
}

/// The violation of a network with this number of parameters, if it is too large to train.
pub fn network_fits(parameters: u64) -> Option<Violation> {
    too_large("the network has", "parameters", parameters, MOST_NETWORK_PARAMETERS)
}

/// The violation of a batch whose inputs and hidden layers hold this number of values, if it is too
/// large.
pub fn batch_fits(numbers: u64) -> Option<Violation> {
    too_large("the batch of an update holds", "numbers of 4 bytes", numbers, MOST_BATCH_NUMBERS)
}

/// The violation of a replay buffer of this number of transitions of the scenario, if it is too
/// large.
pub fn replay_fits(assignment: &Assignment, transitions: u64) -> Option<Violation> {
    // The features of the state; reward; target; moment, action and status together. The state
    // after a truncation may be stored as well.
    let numbers = transitions.saturating_mul(2 * assignment.features() + 3);
    too_large("the replay buffer holds up to", "numbers of 4 bytes", numbers, MOST_BUFFER_NUMBERS)
}

impl Assignment<'_> {
    fn value(&self, parameter: Parameter) -> Option<&Value> {
        self.keys.iter().find(|(known, _)| *known == parameter).map(|(_, value)| *value)
    }

    /// The value of an integer key; 1 for other keys.
    pub fn whole(&self, key: Parameter) -> u64 {
        if let Some(Value::Integer(whole)) = self.value(key) { *whole } else { 1 }
    }

    /// The value of a real-valued key; 0 for other keys.
    pub fn real(&self, key: Parameter) -> f64 {
        if let Some(Value::Real(real)) = self.value(key) { *real } else { 0.0 }
    }

    /// Whether a key has this word.
    pub fn is_word(&self, key: Parameter, word: &'static str) -> bool {
        self.value(key) == Some(&Value::Choice(word))
    }

    /// Whether a flag is set.
    pub fn is_set(&self, key: Parameter) -> bool {
        self.value(key) == Some(&Value::Flag(true))
    }

    /// Number of steps of an episode that does not end in disengagement.
    pub fn longest_episode(&self) -> u64 {
        self.whole(HORIZON).saturating_add(u64::from(self.is_set(UNPAID_LAST_STEP)))
    }

    fn widths(&self) -> impl Iterator<Item = u64> {
        let widths = match self.value(LAYERS) {
            Some(Value::Wholes(widths)) => &widths[..],
            _ => &[],
        };
        widths.iter().map(|width| u64::from(*width))
    }

    /// Number of entries of an observation without its one-hot, but at least the paper's six
    /// letters, so that shorter scenarios have the same limit.
    fn features(&self) -> u64 {
        const PAPER: u64 = 6;
        PAPER.max(self.letters())
    }

    /// Number of entries of an observation without its one-hot.
    pub fn letters(&self) -> u64 {
        (self.scenario.width() as u64).saturating_mul(self.whole(HISTORY))
    }

    /// Number of entries of the one-hot of time; 0 without one.
    pub fn one_hot(&self) -> u64 {
        if self.is_set(ONE_HOT) { self.whole(HORIZON) } else { 0 }
    }

    /// Number of entries of an observation, with at least the paper's six letters.
    fn inputs(&self) -> u64 {
        self.features() + self.one_hot()
    }

    /// The number of hidden layers.
    pub fn hidden_layers(&self) -> u64 {
        self.widths().count() as u64
    }

    /// Number of values that a network holds per row of input.
    pub fn row_numbers(&self) -> u64 {
        self.widths().fold(self.inputs(), u64::saturating_add)
    }

    /// Number of weights and biases of stacks of hidden layers, with `outputs` linear outputs in
    /// total.
    pub fn network_parameters(&self, stacks: u64, outputs: u64) -> u64 {
        let mut before = self.inputs();
        let mut parameters = 0u64;
        for width in self.widths() {
            parameters = parameters.saturating_add(stacks * (before + 1) * width);
            before = width;
        }
        parameters.saturating_add((before + 1) * outputs)
    }

    /// The value of a key as a manifest writes it.
    pub fn shown(&self, key: Parameter) -> String {
        self.value(key).map(ToString::to_string).unwrap_or_default()
    }

    /// The violation "`first` `says` `second`", with the values found.
    pub fn contradiction(&self, first: Parameter, says: &str, second: Parameter) -> Violation {
        let (one, other) = (self.shown(first), self.shown(second));
        let (first, second) = (first.key(), second.key());
        Violation::Contradiction(format!("`{first}` {says} `{second}`, found {one} and {other}"))
    }

    /// All keys that add to the size with their values, as a manifest writes them.
    pub fn listed(&self) -> String {
        let counted = self.keys.iter().filter(|(key, _)| !self.is_off(*key));
        let pairs = counted.map(|(key, value)| format!("{} = {value}", key.key()));
        pairs.collect::<Vec<_>>().join(", ")
    }

    /// Whether a key belongs to a GRU, a history or a last step that the job does not have.
    fn is_off(&self, key: Parameter) -> bool {
        match key {
            RECURRENT | UNITS | LAYERS_BEFORE_GRU => !has_gru(self),
            HISTORY => self.whole(HISTORY) == 1,
            UNPAID_LAST_STEP => !self.is_set(UNPAID_LAST_STEP),
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Feature;

    #[test]
    fn keys_of_a_gru_and_a_history_are_listed_where_the_agent_has_them() {
        let listed = |recurrent: &'static str, history: u64| {
            let values = [
                Value::Wholes(vec![64]),
                Value::Choice(recurrent),
                Value::Integer(64),
                Value::Integer(history),
            ];
            let keys = [LAYERS, RECURRENT, UNITS, HISTORY].into_iter().zip(&values).collect();
            Assignment { scenario: Scenario::of(Feature::Context), keys }.listed()
        };
        assert_eq!(listed("none", 1), "layers = [64]");
        assert_eq!(listed("none", 2), "layers = [64], history = 2");
        assert_eq!(listed("gru", 1), "layers = [64], recurrent = \"gru\", units = 64");
    }

    #[test]
    fn parameters_of_a_network_are_counted_by_hand() {
        let (layers, one_hot, horizon) =
            (Value::Wholes(vec![128, 64]), Value::Flag(true), Value::Integer(50));
        let assignment = Assignment {
            scenario: Scenario::of(Feature::Context),
            keys: vec![(LAYERS, &layers), (ONE_HOT, &one_hot), (HORIZON, &horizon)],
        };
        // Six letters and fifty entries of the one-hot; one bias per unit.
        assert_eq!(assignment.inputs(), 56);
        assert_eq!(assignment.network_parameters(1, 4), 57 * 128 + 129 * 64 + 65 * 4);
        assert_eq!(assignment.network_parameters(2, 5), 2 * (57 * 128 + 129 * 64) + 65 * 5);
        assert_eq!(assignment.row_numbers(), 56 + 128 + 64);
        let scenario = "C-P-L-H-D-T-A-B-M-S".parse().unwrap();
        assert_eq!(Assignment { scenario, ..assignment }.inputs(), 63);
    }
}
