//! Every key that a manifest may sweep, declared once: its section, its type and range, what it
//! means. Validation, the JSON Schema, `plan --resolved`, filters and the reference in
//! `docs/manifest.md` all read this table, so that they cannot disagree.

use std::fmt;
use std::hash::{Hash, Hasher};

use serde::Serialize;

use super::Evaluation;
use crate::agent::{Algorithm, DecisionRule, DuelingDqn, Reinforce, Rule};
use crate::env::Environment;

/// A single value of a key.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// A finite number; never -0, so that equal values have equal bits.
    Real(f64),
    /// A whole number.
    Integer(u64),
    /// `true` or `false`.
    Flag(bool),
    /// One of the key's choices.
    Choice(&'static str),
    /// Two finite numbers, for context 0 and context 1.
    RealPair([f64; 2]),
    /// Widths of layers, input side first.
    Widths(Vec<u32>),
}

// Values are finite and never -0, so equality is reflexive and agrees with the bits.
impl Eq for Value {}

impl Hash for Value {
    fn hash<H: Hasher>(&self, state: &mut H) {
        match self {
            Value::Real(real) => real.to_bits().hash(state),
            Value::Integer(whole) => whole.hash(state),
            Value::Flag(flag) => flag.hash(state),
            Value::Choice(word) => word.hash(state),
            Value::RealPair(pair) => pair.map(f64::to_bits).hash(state),
            Value::Widths(widths) => widths.hash(state),
        }
    }
}

impl fmt::Display for Value {
    /// Writes the value as a manifest does; it reads back equal.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Real(real) => write!(f, "{real:?}"),
            Value::Integer(whole) => write!(f, "{whole}"),
            Value::Flag(flag) => write!(f, "{flag}"),
            Value::Choice(word) => write!(f, "\"{word}\""),
            Value::RealPair([first, second]) => write!(f, "[{first:?}, {second:?}]"),
            Value::Widths(widths) => write!(f, "{widths:?}"),
        }
    }
}

/// The type of a key's values, with their range (both ends included unless said).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A finite number.
    Real {
        /// The smallest.
        min: f64,
        /// The largest.
        max: f64,
    },
    /// A finite number above 0.
    PositiveReal {
        /// The largest.
        max: f64,
    },
    /// A whole number.
    Integer {
        /// The smallest.
        min: u64,
        /// The largest.
        max: u64,
    },
    /// `true` or `false`.
    Flag,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// Two finite numbers.
    RealPair {
        /// The smallest of each.
        min: f64,
        /// The largest of each.
        max: f64,
    },
    /// A list of at least one layer width, each at least 1.
    Widths {
        /// The longest list.
        most: usize,
        /// The largest width.
        max: u32,
    },
}

impl Kind {
    /// The values in words, to follow "expected".
    pub fn expectation(self) -> String {
        match self {
            Kind::Real { min, max } => format!("a number from {min} to {max}"),
            Kind::PositiveReal { max } => format!("a number above 0 and at most {max}"),
            Kind::Integer { min, max } => format!("a whole number from {min} to {max}"),
            Kind::Flag => "true or false".to_owned(),
            Kind::Choice(words) => {
                let quoted: Vec<_> = words.iter().map(|word| format!("\"{word}\"")).collect();
                quoted.join(" or ")
            }
            Kind::RealPair { min, max } => {
                format!("two numbers from {min} to {max}, as in [0.1, 0.1]")
            }
            Kind::Widths { most, max } => {
                format!("a list of 1 to {most} layer widths, each a whole number from 1 to {max}")
            }
        }
    }

    /// The value that a typed struct's field has become as JSON.
    fn value(self, json: &serde_json::Value) -> Option<Value> {
        let real = |json: &serde_json::Value| json.as_f64();
        match self {
            Kind::Real { .. } | Kind::PositiveReal { .. } => real(json).map(Value::Real),
            Kind::Integer { .. } => json.as_u64().map(Value::Integer),
            Kind::Flag => json.as_bool().map(Value::Flag),
            Kind::Choice(words) => {
                words.iter().find(|word| json == **word).map(|word| Value::Choice(word))
            }
            Kind::RealPair { .. } => {
                let [first, second] = json.as_array()?.as_slice() else { return None };
                Some(Value::RealPair([real(first)?, real(second)?]))
            }
            Kind::Widths { .. } => {
                let width = |json: &serde_json::Value| u32::try_from(json.as_u64()?).ok();
                json.as_array()?.iter().map(width).collect::<Option<_>>().map(Value::Widths)
            }
        }
    }
}

/// The part of a manifest that a key belongs to, and the first part of its dotted name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Section {
    /// `[environment]`.
    Environment,
    /// `[[agent]]` with `algorithm = "dueling_dqn"`.
    DuelingDqn,
    /// `[[agent]]` with `algorithm = "reinforce"`.
    Reinforce,
    /// `[[agent]]` with `algorithm = "rule"`.
    Rule,
    /// `[evaluation]`.
    Evaluation,
}

impl Section {
    /// Every section, in the order of the grid.
    pub const ALL: [Section; 5] = [
        Section::Environment,
        Section::DuelingDqn,
        Section::Reinforce,
        Section::Rule,
        Section::Evaluation,
    ];

    /// The section's name in a manifest and in dotted names.
    pub fn name(self) -> &'static str {
        match self {
            Section::Environment => "environment",
            Section::DuelingDqn | Section::Reinforce | Section::Rule => "agent",
            Section::Evaluation => "evaluation",
        }
    }

    /// The section's keys, in the order the documentation lists them.
    pub fn keys(self) -> &'static [Key] {
        match self {
            Section::Environment => ENVIRONMENT,
            Section::DuelingDqn => DUELING_DQN,
            Section::Reinforce => REINFORCE,
            Section::Rule => RULE,
            Section::Evaluation => EVALUATION,
        }
    }

    /// The key called `name`, with its place in [`Section::keys`].
    pub fn find(self, name: &str) -> Option<(usize, &'static Key)> {
        self.keys().iter().enumerate().find(|(_, key)| key.name == name)
    }

    /// The value of each key when a manifest does not mention it, in the order of
    /// [`Section::keys`]; `None` where a manifest must.
    pub fn defaults(self) -> Vec<Option<Value>> {
        let json = match self {
            // Sigma is what studies vary, and the rule what such an agent is: the placeholders
            // given here are taken out below.
            Section::Environment => serde_json::to_value(Environment::paper(0.0)),
            Section::DuelingDqn => serde_json::to_value(DuelingDqn::default()),
            Section::Reinforce => serde_json::to_value(Reinforce::default()),
            Section::Rule => serde_json::to_value(DecisionRule::new(Rule::Never)),
            Section::Evaluation => serde_json::to_value(Evaluation::default()),
        };
        let json = json.expect("the structs hold finite numbers and string keys");
        let is_required = |key: &Key| matches!(key.name, "sigma" | "rule");
        let default =
            |key: &Key| (!is_required(key)).then(|| key.kind.value(&json[key.name])).flatten();
        self.keys().iter().map(default).collect()
    }
}

impl Algorithm {
    /// The section with the algorithm's keys.
    pub fn section(self) -> Section {
        match self {
            Algorithm::DuelingDqn => Section::DuelingDqn,
            Algorithm::Reinforce => Section::Reinforce,
            Algorithm::Rule => Section::Rule,
        }
    }
}

/// A key that takes a value or a sweep.
#[derive(Debug)]
pub struct Key {
    /// Its name in the manifest, the store and the command line.
    pub name: &'static str,
    /// Type and range of its values.
    pub kind: Kind,
    /// One line for editors and the reference.
    pub doc: &'static str,
}

const PROBABILITY: Kind = Kind::Real { min: 0.0, max: 1.0 };
const LARGE: f64 = 1e6;
const EPISODES: Kind = Kind::Integer { min: 1, max: 10_000_000 };
const LAYERS: Kind = Kind::Widths { most: 32, max: 4096 };
const ACTIVATION: Kind = Kind::Choice(&["relu", "tanh"]);
const LEARNING_RATE: Kind = Kind::PositiveReal { max: 1.0 };
const ENGINE_MEANING: &str = "which code performs the updates: \"fused\", kernels with the same \
    results on every processor, or \"burn\", Burn's own operations, many times as slow, with \
    results that depend on the processor";
const ENGINE: Kind = Kind::Choice(&["fused", "burn"]);

const fn key(name: &'static str, kind: Kind, doc: &'static str) -> Key {
    Key { name, kind, doc }
}

const ENVIRONMENT: &[Key] = &[
    key(
        "sigma",
        Kind::Real { min: 0.0, max: LARGE },
        "standard deviation of the context feature; 0: the context probability is exact",
    ),
    key("delta_h", PROBABILITY, "habituation decay a step without a message"),
    key("epsilon_h", PROBABILITY, "habituation increment a message"),
    key("delta_d", PROBABILITY, "disengagement-risk decay a suitable message"),
    key("epsilon_d", PROBABILITY, "disengagement-risk increment a wrongly tailored message"),
    key(
        "rho_1",
        Kind::Real { min: -LARGE, max: LARGE },
        "base reward of an untailored message, in steps",
    ),
    key(
        "rho_2",
        Kind::Real { min: -LARGE, max: LARGE },
        "base reward of a message tailored to the true context, in steps",
    ),
    key(
        "mu",
        Kind::RealPair { min: -LARGE, max: LARGE },
        "baseline reward in context 0 and in context 1, in steps",
    ),
    key("horizon", Kind::Integer { min: 1, max: 10_000 }, "most steps an episode can have"),
    key("initial_habituation", PROBABILITY, "habituation at the start of an episode"),
    key("initial_disengagement", PROBABILITY, "disengagement risk at the start of an episode"),
    key(
        "disengagement_threshold",
        Kind::PositiveReal { max: 1.0 },
        "disengagement risk at which an episode ends",
    ),
    key(
        "first_context",
        Kind::Choice(&["fixed", "sampled"]),
        "context of the first step: 0 shown as p = 0.5 (the authors' code) or drawn like the others (the paper)",
    ),
    key(
        "time_indicator",
        Kind::Choice(&["lagged", "exact"]),
        "clock of the time indicator: of the step before (the authors' code) or of the step itself (the paper)",
    ),
    key(
        "time_indicator_period",
        Kind::Integer { min: 1, max: 10_000 },
        "period of the time indicator, in steps (the paper's k)",
    ),
    key("time_one_hot", Kind::Flag, "whether every observation also carries a one-hot of the time"),
    key(
        "observed_probability",
        Kind::Integer { min: 0, max: 1 },
        "the context whose probability the letter P shows",
    ),
];

const DUELING_DQN: &[Key] = &[
    key("episodes", EPISODES, "episodes of training"),
    key("layers", LAYERS, "widths of the hidden layers, input side first"),
    key("activation", ACTIVATION, "activation of the hidden layers"),
    key(
        "trunk",
        Kind::Choice(&["shared", "separate"]),
        "whether state value and advantages share their hidden layers",
    ),
    key("learning_rate", LEARNING_RATE, "Adam's step size"),
    key("gamma", PROBABILITY, "discount factor a step"),
    key(
        "batch",
        Kind::Integer { min: 1, max: 65_536 },
        "transitions in a batch; learning starts once as many are stored",
    ),
    key(
        "buffer",
        Kind::Integer { min: 1, max: 100_000_000 },
        "most transitions that the replay buffer keeps",
    ),
    key("epsilon_start", PROBABILITY, "exploration rate at the start"),
    key("epsilon_decrement", PROBABILITY, "decrease of the exploration rate an update"),
    key("epsilon_floor", PROBABILITY, "exploration rate at which the decrease stops"),
    key(
        "target_period",
        Kind::Integer { min: 1, max: 1_000_000_000 },
        "updates between two copies into the target network",
    ),
    key(
        "terminal_target",
        Kind::Choice(&["zero", "standard"]),
        "target of a transition that ends its episode: 0 on any end (the authors' code), or the reward, bootstrapped at the horizon",
    ),
    key("engine", ENGINE, ENGINE_MEANING),
];

const REINFORCE: &[Key] = &[
    key("episodes", EPISODES, "episodes of training, a multiple of trajectories_per_update"),
    key("layers", LAYERS, "widths of the hidden layers, input side first"),
    key("activation", ACTIVATION, "activation of the hidden layers"),
    key("learning_rate", LEARNING_RATE, "Adam's step size"),
    key("gamma", PROBABILITY, "discount factor a step"),
    key(
        "trajectories_per_update",
        Kind::Integer { min: 1, max: 10_000 },
        "episodes sampled for one update",
    ),
    key(
        "loss_divisor",
        Kind::PositiveReal { max: LARGE },
        "what the summed loss of an update is divided by",
    ),
    key("engine", ENGINE, ENGINE_MEANING),
];

const RULE: &[Key] = &[
    key(
        "rule",
        Kind::Choice(&["never", "untailored", "tailored", "threshold", "random", "optimal"]),
        "the rule: \"never\" sends nothing, \"tailored\" tailors to the likelier context, \"threshold\" only where that is probable enough, \"optimal\" maximises the mean return",
    ),
    key(
        "threshold",
        Kind::Real { min: 0.5, max: 1.0 },
        "the least probability of the likelier context at which \"threshold\" sends a message",
    ),
];

const EVALUATION: &[Key] = &[
    key("test_episodes", EPISODES, "test episodes after training"),
    key(
        "test_actions",
        Kind::Choice(&["as_trained", "greedy"]),
        "how actions are chosen in the test episodes",
    ),
    key("curve_stride", EPISODES, "training episodes a point of the learning curve averages over"),
];

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(section: Section) -> serde_json::Value {
        match section {
            Section::Environment => serde_json::to_value(Environment::paper(0.4)),
            Section::DuelingDqn => serde_json::to_value(DuelingDqn::default()),
            Section::Reinforce => serde_json::to_value(Reinforce::default()),
            Section::Rule => serde_json::to_value(DecisionRule::new(Rule::Never)),
            Section::Evaluation => serde_json::to_value(Evaluation::default()),
        }
        .unwrap()
    }

    #[test]
    fn every_field_of_the_typed_structs_is_in_the_table_and_nothing_else_is() {
        for section in Section::ALL {
            let mut listed: Vec<_> = section.keys().iter().map(|key| key.name).collect();
            listed.sort_unstable();
            let fields = fields(section);
            let mut declared: Vec<_> = fields.as_object().unwrap().keys().collect();
            declared.sort_unstable();
            assert_eq!(listed, declared, "{section:?}");
        }
    }

    #[test]
    fn every_default_is_a_valid_value_and_only_sigma_and_the_rule_have_none() {
        for section in Section::ALL {
            let fields = fields(section);
            for (key, default) in section.keys().iter().zip(section.defaults()) {
                let Some(default) = default else {
                    assert!(["sigma", "rule"].contains(&key.name));
                    continue;
                };
                assert_eq!(serde_json::to_value(&default).unwrap(), fields[key.name]);
                let inside = match (key.kind, &default) {
                    (Kind::Real { min, max }, Value::Real(x)) => (min..=max).contains(x),
                    (Kind::PositiveReal { max }, Value::Real(x)) => *x > 0.0 && *x <= max,
                    (Kind::Integer { min, max }, Value::Integer(n)) => (min..=max).contains(n),
                    (Kind::RealPair { min, max }, Value::RealPair(pair)) => {
                        pair.iter().all(|x| (min..=max).contains(x))
                    }
                    (Kind::Widths { most, max }, Value::Widths(widths)) => {
                        let inside = widths.iter().all(|width| (1..=max).contains(width));
                        inside && (1..=most).contains(&widths.len())
                    }
                    (Kind::Flag, Value::Flag(_)) => true,
                    (Kind::Choice(words), Value::Choice(word)) => words.contains(word),
                    _ => false,
                };
                assert!(inside, "{} = {default}", key.name);
            }
        }
    }

    #[test]
    fn every_choice_of_the_table_is_a_variant_of_the_typed_struct() {
        for section in Section::ALL {
            for key in section.keys() {
                let Kind::Choice(words) = key.kind else { continue };
                for word in words {
                    let mut json = fields(section);
                    json[key.name] = (*word).into();
                    let read = match section {
                        Section::Environment => serde_json::from_value::<Environment>(json).err(),
                        Section::DuelingDqn => serde_json::from_value::<DuelingDqn>(json).err(),
                        Section::Reinforce => serde_json::from_value::<Reinforce>(json).err(),
                        Section::Rule => serde_json::from_value::<DecisionRule>(json).err(),
                        Section::Evaluation => serde_json::from_value::<Evaluation>(json).err(),
                    };
                    assert!(read.is_none(), "{} = {word}: {read:?}", key.name);
                }
            }
        }
    }

    #[test]
    fn keys_that_both_algorithms_have_are_of_one_kind() {
        for key in Section::DuelingDqn.keys() {
            if let Some((_, other)) = Section::Reinforce.find(key.name) {
                assert_eq!(key.kind, other.kind, "{}", key.name);
            }
        }
    }
}
