//! The registration of outside programs, whose parameters the user names.
//!
//! Each set of names is a separate [`Algorithm`]: the algorithm of [`External`] with an additional
//! key `parameters.<name>` for each name. Sweeps, filters, views and labels then treat the
//! parameters of a program like the keys of any algorithm. Names and sets stay in memory until the
//! process ends.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use crate::agent::architecture::NetworkPolicy;
use crate::agent::external::External;
use crate::agent::layers::Shape;
use crate::agent::weights::{Weights, WeightsError};
use crate::key::{Key, Kind, Value};

use super::algorithm::{Agent, Algorithm, AlgorithmParameters, Start, StartError, Task};

/// Prefix of the keys of a program's parameters.
const PREFIX: &str = "parameters.";

/// Maximum length of a parameter's name, in characters.
const LONGEST_NAME: usize = 64;

/// Maximum number of parameters of a program.
const MOST_PARAMETERS: usize = 100;

/// The keys of programs' parameters, by their names including the prefix.
static KEYS: Mutex<BTreeMap<&'static str, &'static Key>> = Mutex::new(BTreeMap::new());

/// The algorithms of programs, by the names of their keys.
static ALGORITHMS: Mutex<BTreeMap<Vec<&'static str>, &'static Algorithm>> =
    Mutex::new(BTreeMap::new());

/// The key of an outside program's parameter: `parameters.<name>`. `None` unless `name` is a letter
/// or underscore followed by letters, digits and underscores.
pub fn free_key(name: &str) -> Option<&'static Key> {
    let own = name.strip_prefix(PREFIX)?;
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let begins = own.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if !begins || !own.chars().all(is_word) || own.len() > LONGEST_NAME {
        return None;
    }
    let mut keys = KEYS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(key) = keys.get(name) {
        return Some(key);
    }
    let name: &'static str = Box::leak(name.into());
    let key: &'static Key = Box::leak(Box::new(Key {
        name,
        kind: Kind::Scalar,
        written_doc: " a parameter of an outside program",
        default: None,
        before: None,
        earlier: None,
    }));
    keys.insert(name, key);
    Some(key)
}

impl Algorithm {
    /// Whether its agents are outside programs.
    pub fn is_external(&self) -> bool {
        self.name() == External::NAME
    }

    /// The algorithm of outside programs whose parameters have these keys. `None` if a key is not
    /// of the form of [`free_key`], or if there are too many keys.
    pub fn external<'n>(keys: impl IntoIterator<Item = &'n str>) -> Option<&'static Algorithm> {
        let base = Algorithm::named(External::NAME)?;
        let names: BTreeSet<&str> = keys.into_iter().collect();
        if names.is_empty() || names.len() > MOST_PARAMETERS {
            return names.is_empty().then_some(base);
        }
        let free: Vec<&Key> = names.into_iter().map(free_key).collect::<Option<_>>()?;
        let names: Vec<&'static str> = free.iter().map(|key| key.name).collect();
        let mut algorithms = ALGORITHMS.lock().unwrap_or_else(PoisonError::into_inner);
        let made = algorithms.entry(names).or_insert_with(|| {
            let keys: Vec<Key> = base.keys().iter().chain(free).copied().collect();
            Box::leak(Box::new(base.with_keys(Vec::leak(keys))))
        });
        Some(made)
    }
}

impl Agent {
    /// The parameters of an outside program, by the names that the user gave them.
    pub fn free_parameters(&self) -> impl Iterator<Item = (&'static str, &Value)> {
        let named = self.algorithm().keys().iter().zip(self.values());
        named.filter_map(|(key, value)| Some((key.name.strip_prefix(PREFIX)?, value)))
    }
}

impl AlgorithmParameters for External {
    const NAME: &'static str = "external";
    const HAS_WEIGHTS: bool = false;

    fn episodes(&self) -> u32 {
        self.episodes
    }

    fn start(&self, _: &Task) -> Result<Start, StartError> {
        Err(StartError::Outside)
    }

    fn network(&self, _: Shape, _: &Weights) -> Result<NetworkPolicy, WeightsError> {
        Err(WeightsError::Outside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::Keyed;

    #[test]
    fn programs_with_the_same_names_of_parameters_are_of_one_algorithm() {
        let of = |names: &[&str]| Algorithm::external(names.iter().copied()).unwrap();
        let both = of(&["parameters.rate", "parameters.depth"]);
        assert!(std::ptr::eq(both, of(&["parameters.depth", "parameters.rate"])));
        assert_ne!(both, of(&["parameters.rate"]));
        assert_eq!(of(&[]), Algorithm::named("external").unwrap());
        let names: Vec<&str> = both.keys().iter().map(|key| key.name).collect();
        let expected =
            ["command", "version", "episodes", "history", "parameters.depth", "parameters.rate"];
        assert_eq!(names, expected);
        assert_eq!(both.name(), "external");
    }

    #[test]
    fn names_of_parameters_are_words() {
        for name in ["parameters.", "parameters.9", "parameters.a-b", "parameters.a.b", "rate"] {
            assert!(free_key(name).is_none(), "{name}");
        }
        assert!(free_key(&format!("parameters.{}", "x".repeat(65))).is_none());
        assert_eq!(free_key("parameters._x9").unwrap().name, "parameters._x9");
    }

    #[test]
    fn an_agent_has_a_value_for_every_parameter() {
        let algorithm = Algorithm::external(["parameters.rate"]).unwrap();
        let command =
            External { command: vec!["true".to_owned()], version: "1".to_owned(), episodes: 5 };
        let mut values = command.to_values();
        values.push(Value::Integer(3));
        assert_eq!(Agent::with_values(algorithm, values.clone()), None);
        values.push(Value::Real(0.5));
        let agent = Agent::with_values(algorithm, values).unwrap();
        assert_eq!((agent.episodes(), agent.history()), (5, 3));
        assert_eq!(agent.clone().with_history(2).history(), 2);
        assert_eq!(agent.parameters::<External>(), Some(command));
        let free: Vec<_> = agent.free_parameters().collect();
        assert_eq!(free, [("rate", &Value::Real(0.5))]);
    }
}
