//! What keys of a job ask of each other: rules between two of them, and limits on what several
//! together make the training hold in memory.
//!
//! In: the values that one cell gives some keys. Out: what is wrong with them, if anything. It knows
//! neither grids nor places in a file.

use super::agent::Algorithm;
use super::environment::LONGEST_OPTIMUM;
use super::keys::Value;
use super::parameter::Parameter;
use super::scenario::Feature;

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

/// Something that the jobs of an algorithm are held to.
#[derive(Debug)]
pub(super) struct Rule {
    pub algorithm: Algorithm,
    /// The keys that the rule is about.
    pub keys: &'static [Parameter],
    /// What is wrong with their values.
    pub fault: fn(&Chosen) -> Option<Breach>,
}

/// How values break a rule.
#[derive(Debug)]
pub(super) enum Breach {
    /// Two keys contradict each other; in words.
    Contradiction(String),
    /// The keys together make something too large.
    TooLarge {
        /// What is too large, with its unit: "the network has … parameters".
        what: &'static str,
        unit: &'static str,
        size: u64,
        most: u64,
    },
}

/// The values that a cell gives the keys of a rule, in the same order.
#[derive(Debug)]
pub(super) struct Chosen<'v> {
    pub keys: &'static [Parameter],
    pub values: Vec<&'v Value>,
}

pub(super) const RULES: &[Rule] = &[
    Rule {
        algorithm: Algorithm::Reinforce,
        keys: &[EPISODES, TRAJECTORIES],
        fault: |chosen| {
            let (episodes, each) = (chosen.whole(EPISODES), chosen.whole(TRAJECTORIES));
            let broken = !episodes.is_multiple_of(each);
            broken.then(|| chosen.contradiction("must be a multiple of"))
        },
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: &[BATCH, BUFFER],
        fault: |chosen| {
            let broken = chosen.whole(BATCH) > chosen.whole(BUFFER);
            broken.then(|| chosen.contradiction("must not exceed"))
        },
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: &[EPSILON_FLOOR, EPSILON_START],
        fault: |chosen| {
            let broken = chosen.real(EPSILON_FLOOR) > chosen.real(EPSILON_START);
            broken.then(|| chosen.contradiction("must not exceed"))
        },
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: &[LAYERS, TRUNK, HORIZON, ONE_HOT],
        fault: |chosen| {
            let stacks = if chosen.is_word(TRUNK, "separate") { 2 } else { 1 };
            network_fits(chosen.network_parameters(stacks, 5))
        },
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: &[BATCH, LAYERS, TRUNK, HORIZON, ONE_HOT],
        fault: |chosen| {
            let stacks = if chosen.is_word(TRUNK, "separate") { 2 } else { 1 };
            batch_fits(chosen.whole(BATCH).saturating_mul(stacks * chosen.row_numbers()))
        },
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: &[BUFFER, EPISODES, HORIZON, ONE_HOT],
        fault: |chosen| {
            let steps = chosen.whole(EPISODES).saturating_mul(chosen.whole(HORIZON));
            let transitions = chosen.whole(BUFFER).min(steps);
            // The features of a state; reward, target, and moment, action and ending together. What
            // follows a truncation may be kept as well.
            let size = transitions.saturating_mul(2 * Feature::ALL.len() as u64 + 3);
            let most = MOST_BUFFER_NUMBERS;
            let (what, unit) = ("the replay buffer comes to hold", "numbers of 4 bytes");
            (size > most).then_some(Breach::TooLarge { what, unit, size, most })
        },
    },
    Rule {
        algorithm: Algorithm::DuelingDqn,
        keys: &[EPISODES, CURVE_STRIDE],
        fault: |chosen| chosen.long_curve(),
    },
    Rule {
        algorithm: Algorithm::Reinforce,
        keys: &[LAYERS, HORIZON, ONE_HOT],
        fault: |chosen| network_fits(chosen.network_parameters(1, 4)),
    },
    Rule {
        algorithm: Algorithm::Reinforce,
        keys: &[TRAJECTORIES, LAYERS, HORIZON, ONE_HOT],
        fault: |chosen| {
            let rows = chosen.whole(TRAJECTORIES).saturating_mul(chosen.whole(HORIZON));
            batch_fits(rows.saturating_mul(chosen.row_numbers()))
        },
    },
    Rule {
        algorithm: Algorithm::Reinforce,
        keys: &[EPISODES, CURVE_STRIDE],
        fault: |chosen| chosen.long_curve(),
    },
    Rule {
        algorithm: Algorithm::Rule,
        keys: &[RULE, HORIZON],
        fault: |chosen| {
            let (size, most) = (chosen.whole(HORIZON), u64::from(LONGEST_OPTIMUM));
            let (what, unit) = ("rule = \"optimal\" plans for a horizon of", "steps");
            let broken = chosen.is_word(RULE, "optimal") && size > most;
            broken.then_some(Breach::TooLarge { what, unit, size, most })
        },
    },
];

const HORIZON: Parameter = Parameter::Environment("horizon");
const ONE_HOT: Parameter = Parameter::Environment("time_one_hot");
const EPISODES: Parameter = Parameter::Agent("episodes");
const LAYERS: Parameter = Parameter::Agent("layers");
const TRUNK: Parameter = Parameter::Agent("trunk");
const BATCH: Parameter = Parameter::Agent("batch");
const BUFFER: Parameter = Parameter::Agent("buffer");
const EPSILON_START: Parameter = Parameter::Agent("epsilon_start");
const EPSILON_FLOOR: Parameter = Parameter::Agent("epsilon_floor");
const TRAJECTORIES: Parameter = Parameter::Agent("trajectories_per_update");
const RULE: Parameter = Parameter::Agent("rule");
const CURVE_STRIDE: Parameter = Parameter::Evaluation("curve_stride");

fn network_fits(size: u64) -> Option<Breach> {
    let most = MOST_NETWORK_PARAMETERS;
    let (what, unit) = ("the network has", "parameters");
    (size > most).then_some(Breach::TooLarge { what, unit, size, most })
}

fn batch_fits(size: u64) -> Option<Breach> {
    let most = MOST_BATCH_NUMBERS;
    let (what, unit) = ("the batch of an update holds", "numbers of 4 bytes");
    (size > most).then_some(Breach::TooLarge { what, unit, size, most })
}

impl Chosen<'_> {
    fn value(&self, key: Parameter) -> Option<&Value> {
        self.keys.iter().position(|known| *known == key).map(|place| self.values[place])
    }

    /// A whole number; 1 for what is none.
    fn whole(&self, key: Parameter) -> u64 {
        if let Some(Value::Integer(whole)) = self.value(key) { *whole } else { 1 }
    }

    /// A number; 0 for what is none.
    fn real(&self, key: Parameter) -> f64 {
        if let Some(Value::Real(real)) = self.value(key) { *real } else { 0.0 }
    }

    fn is_word(&self, key: Parameter, word: &'static str) -> bool {
        self.value(key) == Some(&Value::Choice(word))
    }

    fn widths(&self) -> impl Iterator<Item = u64> {
        let widths = match self.value(LAYERS) {
            Some(Value::Widths(widths)) => &widths[..],
            _ => &[],
        };
        widths.iter().map(|width| u64::from(*width))
    }

    /// Entries of an observation, if it has every letter.
    fn inputs(&self) -> u64 {
        let one_hot = self.value(ONE_HOT) == Some(&Value::Flag(true));
        Feature::ALL.len() as u64 + if one_hot { self.whole(HORIZON) } else { 0 }
    }

    /// Numbers that a network holds for one row of its input.
    fn row_numbers(&self) -> u64 {
        self.widths().fold(self.inputs(), u64::saturating_add)
    }

    /// Weights and biases of stacks of hidden layers with `outputs` linear outputs in all.
    fn network_parameters(&self, stacks: u64, outputs: u64) -> u64 {
        let mut before = self.inputs();
        let mut parameters = 0u64;
        for width in self.widths() {
            parameters = parameters.saturating_add(stacks * (before + 1) * width);
            before = width;
        }
        parameters.saturating_add((before + 1) * outputs)
    }

    fn long_curve(&self) -> Option<Breach> {
        let size = self.whole(EPISODES).div_ceil(self.whole(CURVE_STRIDE));
        let most = MOST_CURVE_POINTS;
        let (what, unit) = ("the learning curve has", "points");
        (size > most).then_some(Breach::TooLarge { what, unit, size, most })
    }

    fn contradiction(&self, says: &str) -> Breach {
        let names: Vec<String> = self.keys.iter().map(|key| key.key().to_owned()).collect();
        let values: Vec<String> = self.values.iter().map(ToString::to_string).collect();
        let (names, values) = (names.join(&format!("` {says} `")), values.join(" and "));
        Breach::Contradiction(format!("`{names}`, found {values}"))
    }

    /// Every key with its value, as a manifest would write them.
    pub fn listed(&self) -> String {
        let pairs = self.keys.iter().zip(&self.values);
        let pairs: Vec<String> =
            pairs.map(|(key, value)| format!("{} = {value}", key.key())).collect();
        pairs.join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_of_a_network_are_counted_by_hand() {
        let (layers, one_hot, horizon) =
            (Value::Widths(vec![128, 64]), Value::Flag(true), Value::Integer(50));
        let chosen =
            Chosen { keys: &[LAYERS, ONE_HOT, HORIZON], values: vec![&layers, &one_hot, &horizon] };
        // Six letters and fifty entries of the one-hot; a bias for each unit.
        assert_eq!(chosen.inputs(), 56);
        assert_eq!(chosen.network_parameters(1, 4), 57 * 128 + 129 * 64 + 65 * 4);
        assert_eq!(chosen.network_parameters(2, 5), 2 * (57 * 128 + 129 * 64) + 65 * 5);
        assert_eq!(chosen.row_numbers(), 56 + 128 + 64);
    }
}
