//! The keys of `[[estimate]]`.

use std::sync::Arc;

use serde_json::{Value as Json, json};

use crate::job::{
    CONSTANT, EstimateDeclaration, Estimator, Messages, REWARD, StandardErrors, TargetPolicy,
    Treatment,
};
use crate::key::{FixedKind, Kind, Value};
use crate::manifest::estimate::declared::DeclaredEstimate;
use crate::manifest::table::{Field, Fields, TableKey, TableReader, fields, name_key};
use crate::manifest::text::written::{list, quoted};
use crate::manifest::value::schema;
use crate::manifest::value::sweep::{Node, Reader, number, whole};
use crate::text::Fault;

/// The most features in a list.
const MOST_FEATURES: usize = 100;

/// All keys of an estimate.
pub(in crate::manifest) fn keys() -> Vec<TableKey> {
    let name = name_key("the name in the view `estimate` and in analyses");
    [vec![name], EstimateDeclaration::keys(), DeclaredEstimate::keys()].concat()
}

/// The keys of an estimate except its name and those that its estimator does not use, with their values, as a manifest
/// writes them.
pub(in crate::manifest) fn written(estimate: &DeclaredEstimate) -> Vec<(&'static str, String)> {
    let estimator = estimate.declaration.estimator;
    let mut keys = [Fields::written(&*estimate.declaration), Fields::written(estimate)].concat();
    keys.retain(|(key, _)| estimator.uses(key));
    keys
}

fields! {
    impl EstimateDeclaration {
        /// what is estimated: an effect by weighted and centred least squares ("wcls"), the log relative risk of a binary
        /// outcome or a count ("emee"), or the value of a policy ("value")
        estimator: Estimator = Estimator::Wcls, in Estimator::KIND;
        /// "reward" of the step less the cost of the message, "gross_reward" before it, or a name of the recorded
        /// state: its value before the next decision
        outcome: String = REWARD.to_owned(), in Kind::Text { most: 100 };
        /// what is compared with action 0: any message, each message, or the action of this number
        treatment: Treatment = Treatment::Messages(Messages::Any);
        /// features of the model of the outcome without treatment, beside the constant 1
        control: Vec<String> as Features = Vec::new();
        /// features that the effect depends on, beside the constant 1
        moderators: Vec<String> as Features = Vec::new();
        /// probability of treatment in the numerator of the weights; several treatments share it equally
        numerator: f64 as Share = 0.5;
        /// the policy whose value is estimated: the probability of a message, which several messages share equally; a list of
        /// the probabilities of all actions; a number of the recorded state that is the probability of a message; or "agent"
        policy: Option<TargetPolicy>;
        /// another such policy, whose value is subtracted: the estimate is the difference of both
        against: Option<TargetPolicy>;
        /// consecutive decisions that the policy makes; the value is their mean outcome
        steps: u32 = 1, in Kind::Integer { min: 1, max: 1000 };
        /// whether standard errors account for an agent that learned from everybody
        standard_errors: StandardErrors = StandardErrors::Nominal, in StandardErrors::KIND;
        /// whether the true effect in each trial is simulated, too
        truth: bool = false, in Kind::Flag;
    } with |table| { name: table.name.to_owned(), less_costs: false }
}

fields! {
    impl DeclaredEstimate {
        /// agents whose jobs have the estimate; all by default
        agents: Option<Vec<String>> as Option<AgentNames>;
    } with |table| { declaration: Arc::new(EstimateDeclaration::read(table)?) }
}

impl Field for Treatment {
    type Value = Treatment;

    fn schema(_: Option<Kind>) -> Json {
        let action = schema::value(Kind::Integer { min: 1, max: u8::MAX.into() });
        json!({ "anyOf": [{ "enum": Messages::WORDS }, action] })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Treatment> {
        let node = table.node(key)?;
        let action = || whole(node).and_then(|number| u8::try_from(number).ok());
        let treatment = match node.get_ref().as_str() {
            Some(word) => Messages::named(word).map(Treatment::Messages),
            None => action().filter(|action| *action > 0).map(Treatment::Action),
        };
        if treatment.is_none() {
            let words: Vec<String> = Messages::WORDS.iter().map(quoted).collect();
            let expected = format!("{} or the number of an action above 0", words.join(" or "));
            table.reader.expected(key, &expected, node);
        }
        treatment
    }

    fn written(value: &Treatment, key: &'static str) -> Vec<(&'static str, String)> {
        let text = match value {
            Treatment::Action(action) => action.to_string(),
            Treatment::Messages(messages) => quoted(messages.word()),
        };
        vec![(key, text)]
    }
}

impl Field for TargetPolicy {
    type Value = TargetPolicy;

    fn schema(_: Option<Kind>) -> Json {
        let probability = json!({ "type": "number", "minimum": 0, "maximum": 1 });
        let name = json!({ "type": "string", "minLength": 1 });
        // Two actions may have the same probability.
        let all = json!({ "type": "array", "minItems": 1, "items": probability });
        json!({ "anyOf": [probability, all, name] })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<TargetPolicy> {
        let node = table.node(key)?;
        if node.get_ref().as_str().is_some() {
            let name = table.reader.name(key, node).value;
            return (!name.is_empty()).then_some(TargetPolicy::Named(name));
        }
        let probability = |node: &Node| number(node).filter(|number| (0.0..=1.0).contains(number));
        let policy = match node.get_ref().as_array() {
            None => probability(node).map(TargetPolicy::Message),
            Some(items) => {
                let all = items.iter().map(probability).collect::<Option<Vec<f64>>>();
                let is_whole = |all: &Vec<f64>| (all.iter().sum::<f64>() - 1.0).abs() < 1e-9;
                all.filter(is_whole).map(TargetPolicy::Actions)
            }
        };
        if policy.is_none() {
            let expected = "the probability of a message, from 0 to 1, a list of the probabilities of all actions, whose \
                            sum is 1, the name of a number of the recorded state, or \"agent\"";
            table.reader.expected(key, expected, node);
        }
        policy
    }

    fn written(value: &TargetPolicy, key: &'static str) -> Vec<(&'static str, String)> {
        let text = match value {
            TargetPolicy::Message(probability) => format!("{probability:?}"),
            TargetPolicy::Named(name) => quoted(name),
            TargetPolicy::Actions(all) => Value::Reals(all.clone()).to_string(),
        };
        vec![(key, text)]
    }
}

/// A list of distinct features, which may be empty.
struct Features;

impl Field for Features {
    type Value = Vec<String>;

    fn schema(_: Option<Kind>) -> Json {
        let mut schema = schema::list(json!({ "type": "string", "minLength": 1 }));
        schema["minItems"] = json!(0);
        schema["maxItems"] = json!(MOST_FEATURES);
        schema
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Vec<String>> {
        let (node, reader) = (table.node(key)?, &mut *table.reader);
        let Some(items) = node.get_ref().as_array() else {
            reader.expected(key, "a list of features, as in [\"step\"]", node);
            return None;
        };
        if items.len() > MOST_FEATURES {
            let message =
                format!("`{key}`: at most {MOST_FEATURES} features, found {}", items.len());
            reader.faults.add(Fault::at(node.span().into(), message));
            return None;
        }
        Some(reader.distinct(key, items.iter(), |reader, item| {
            let name = reader.name(key, item);
            if name.value == CONSTANT {
                let message = format!("`{key}`: the constant 1 is always included");
                reader.faults.add(Fault::at(item.span().into(), message).help("remove it"));
            }
            Some(name.value).filter(|name| !name.is_empty())
        }))
    }

    fn written(value: &Vec<String>, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, list(&value.iter().map(quoted).collect::<Vec<_>>()))]
    }
}

/// A probability above 0 and below 1.
struct Share;

impl Field for Share {
    type Value = f64;

    fn schema(_: Option<Kind>) -> Json {
        json!({ "type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1 })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<f64> {
        let node = table.node(key)?;
        let share = number(node).filter(|share| *share > 0.0 && *share < 1.0);
        if share.is_none() {
            table.reader.expected(key, "a probability above 0 and below 1", node);
        }
        share
    }

    fn written(value: &f64, key: &'static str) -> Vec<(&'static str, String)> {
        vec![(key, format!("{value:?}"))]
    }
}

/// The name of an agent, or a list of distinct names.
struct AgentNames;

impl Field for AgentNames {
    type Value = Vec<String>;

    fn schema(_: Option<Kind>) -> Json {
        let name = json!({ "$ref": "#/$defs/name" });
        json!({ "anyOf": [name, schema::list(name.clone())] })
    }

    fn read(table: &mut TableReader<'_, '_>, key: &str, _: Option<Kind>) -> Option<Vec<String>> {
        let items = table.reader.items(key, table.node(key)?);
        let read = |reader: &mut Reader, item: &Node| {
            Some(reader.name(key, item).value).filter(|name| !name.is_empty())
        };
        Some(table.reader.distinct(key, items.into_iter(), read))
    }

    fn written(value: &Vec<String>, key: &'static str) -> Vec<(&'static str, String)> {
        Features::written(value, key)
    }
}
