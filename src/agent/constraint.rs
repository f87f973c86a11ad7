//! Constraints between the keys of a job: what two of them ask of each other, and limits on what
//! several together make a training hold in memory.
//!
//! In: the values that one cell of a grid gives some keys. Out: what is wrong with them, if
//! anything. It knows neither grids nor places in a file; each algorithm lists its own constraints.

use crate::env::Scenario;
use crate::key::{Parameter, Value};

/// Most parameters of a network. Training holds five numbers of four bytes for each: value,
/// gradient, two moments, and the target network's.
const MOST_NETWORK_PARAMETERS: u64 = 20_000_000;

/// Most numbers of four bytes in the inputs and hidden layers of one update's batch; the gradient
/// holds about as many again.
const MOST_BATCH_NUMBERS: u64 = 200_000_000;

/// Most numbers of four bytes in a replay buffer.
const MOST_BUFFER_NUMBERS: u64 = 500_000_000;

/// Most points of a learning curve.
const MOST_CURVE_POINTS: u64 = 1_000_000;

/// Most decisions that a job records. Training holds 56 bytes for each, and the store about 50.
const MOST_DECISIONS: u64 = 5_000_000;

/// Something that the jobs of an algorithm must satisfy.
#[derive(Debug)]
pub struct Constraint {
    /// The parameters that it is about.
    pub parameters: &'static [Parameter],
    /// How their values violate it, if they do.
    pub violation: fn(&Assignment) -> Option<Violation>,
}

/// How values violate a constraint.
#[derive(Debug)]
pub enum Violation {
    /// Two keys contradict each other; in words.
    Contradiction(String),
    /// The values ask for something that is not possible.
    Impossible {
        /// What is asked for.
        says: String,
        /// What to do about it.
        help: String,
    },
    /// The keys together make something too large: "`what` `size` `unit`, at most `most`".
    TooLarge {
        /// What is too large, as in "the network has".
        what: &'static str,
        /// In what it is counted, as in "parameters".
        unit: &'static str,
        /// How large it is.
        size: u64,
        /// How large it may be.
        most: u64,
    },
}

/// The values that a cell assigns to the parameters of a constraint.
#[derive(Debug)]
pub struct Assignment<'v> {
    /// The cell's scenario.
    pub scenario: &'v Scenario,
    /// The constraint's keys with their values.
    pub keys: Vec<(Parameter, &'v Value)>,
}

/// Most steps an episode can have.
pub const HORIZON: Parameter = Parameter::Environment("horizon");
/// Whether observations carry a one-hot of the time.
pub const ONE_HOT: Parameter = Parameter::Environment("time_one_hot");
/// Training episodes.
pub const EPISODES: Parameter = Parameter::Agent("episodes");
/// Widths of hidden layers.
pub const LAYERS: Parameter = Parameter::Agent("layers");
/// Training episodes of a point of the learning curve.
pub const CURVE_STRIDE: Parameter = Parameter::Evaluation("curve_stride");

/// The learning curve has no more points than a store should hold.
pub const CURVE_FITS: Constraint = Constraint {
    parameters: &[EPISODES, CURVE_STRIDE],
    violation: |assignment| {
        let size = assignment.whole(EPISODES).div_ceil(assignment.whole(CURVE_STRIDE));
        too_large("the learning curve has", "points", size, MOST_CURVE_POINTS)
    },
};

/// Test episodes.
const TEST_EPISODES: Parameter = Parameter::Evaluation("test_episodes");
/// Which decisions are recorded.
const RECORD_DECISIONS: Parameter = Parameter::Evaluation("record_decisions");

/// The decisions of an agent that trains are no more than a job can record.
pub const DECISIONS_FIT: Constraint = Constraint {
    parameters: &[EPISODES, TEST_EPISODES, HORIZON, RECORD_DECISIONS],
    violation: |assignment| decisions_fit(assignment, assignment.whole(EPISODES)),
};

/// The decisions of an agent that does not train are no more than a job can record.
pub const TEST_DECISIONS_FIT: Constraint = Constraint {
    parameters: &[TEST_EPISODES, HORIZON, RECORD_DECISIONS],
    violation: |assignment| decisions_fit(assignment, 0),
};

fn decisions_fit(assignment: &Assignment, training_episodes: u64) -> Option<Violation> {
    let test = assignment.whole(TEST_EPISODES);
    let episodes = if assignment.is_word(RECORD_DECISIONS, "all") {
        test.saturating_add(training_episodes)
    } else if assignment.is_word(RECORD_DECISIONS, "test") {
        test
    } else {
        0
    };
    let size = episodes.saturating_mul(assignment.whole(HORIZON));
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

/// The violation of a batch whose inputs and hidden layers hold `numbers`, if these are too many.
pub fn batch_fits(numbers: u64) -> Option<Violation> {
    too_large("the batch of an update holds", "numbers of 4 bytes", numbers, MOST_BATCH_NUMBERS)
}

/// The violation of a replay buffer of so many transitions of the scenario, if it is too large.
pub fn replay_fits(assignment: &Assignment, transitions: u64) -> Option<Violation> {
    // The features of a state; reward, target, and moment, action and ending together. What
    // follows a truncation may be kept as well.
    let numbers = transitions.saturating_mul(2 * assignment.features() + 3);
    too_large("the replay buffer comes to hold", "numbers of 4 bytes", numbers, MOST_BUFFER_NUMBERS)
}

impl Assignment<'_> {
    fn value(&self, parameter: Parameter) -> Option<&Value> {
        self.keys.iter().find(|(known, _)| *known == parameter).map(|(_, value)| *value)
    }

    /// A whole number; 1 for a key that is none.
    pub fn whole(&self, key: Parameter) -> u64 {
        if let Some(Value::Integer(whole)) = self.value(key) { *whole } else { 1 }
    }

    /// A number; 0 for a key that is none.
    pub fn real(&self, key: Parameter) -> f64 {
        if let Some(Value::Real(real)) = self.value(key) { *real } else { 0.0 }
    }

    /// Whether a key has this word.
    pub fn is_word(&self, key: Parameter, word: &'static str) -> bool {
        self.value(key) == Some(&Value::Choice(word))
    }

    fn widths(&self) -> impl Iterator<Item = u64> {
        let widths = match self.value(LAYERS) {
            Some(Value::Widths(widths)) => &widths[..],
            _ => &[],
        };
        widths.iter().map(|width| u64::from(*width))
    }

    /// Entries of an observation, its one-hot aside; never fewer than the paper has letters, so that short
    /// scenarios have one limit.
    fn features(&self) -> u64 {
        const PAPER: u64 = 6;
        PAPER.max(self.scenario.width() as u64)
    }

    /// Entries of an observation.
    fn inputs(&self) -> u64 {
        let one_hot = self.value(ONE_HOT) == Some(&Value::Flag(true));
        self.features() + if one_hot { self.whole(HORIZON) } else { 0 }
    }

    /// Numbers that a network holds for one row of its input.
    pub fn row_numbers(&self) -> u64 {
        self.widths().fold(self.inputs(), u64::saturating_add)
    }

    /// Weights and biases of stacks of hidden layers with `outputs` linear outputs in all.
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

    /// Every key with its value, as a manifest would write them.
    pub fn listed(&self) -> String {
        let pairs = self.keys.iter().map(|(key, value)| format!("{} = {value}", key.key()));
        pairs.collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Feature;

    #[test]
    fn parameters_of_a_network_are_counted_by_hand() {
        let (layers, one_hot, horizon) =
            (Value::Widths(vec![128, 64]), Value::Flag(true), Value::Integer(50));
        let assignment = Assignment {
            scenario: &Scenario::of(Feature::Context),
            keys: vec![(LAYERS, &layers), (ONE_HOT, &one_hot), (HORIZON, &horizon)],
        };
        // Six letters and fifty entries of the one-hot; a bias for each unit.
        assert_eq!(assignment.inputs(), 56);
        assert_eq!(assignment.network_parameters(1, 4), 57 * 128 + 129 * 64 + 65 * 4);
        assert_eq!(assignment.network_parameters(2, 5), 2 * (57 * 128 + 129 * 64) + 65 * 5);
        assert_eq!(assignment.row_numbers(), 56 + 128 + 64);
        let scenario = "C-P-L-H-D-T-A-B-M-S".parse().unwrap();
        assert_eq!(Assignment { scenario: &scenario, ..assignment }.inputs(), 63);
    }
}
