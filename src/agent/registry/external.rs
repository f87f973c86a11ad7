//! The registration of outside programs, whose parameters the user names.
//!
//! Each set of names is a separate [`Algorithm`]: the algorithm of [`External`] with an additional
//! key `parameters.<name>` for each name. Sweeps, filters, views and labels then treat the
//! parameters of a program like the keys of any algorithm. Names and sets stay in memory until the
//! process ends.

use crate::agent::architecture::NetworkPolicy;
use crate::agent::external::External;
use crate::agent::layers::Shape;
use crate::agent::weights::{Weights, WeightsError};
use crate::key::{Value, WithFreeKeys, free_keys, free_values};

use super::algorithm::{Agent, Algorithm, AlgorithmParameters, Start, StartError, Task};

/// The algorithms of programs, by the names of their parameters.
static ALGORITHMS: WithFreeKeys<Algorithm> = WithFreeKeys::none();

impl Algorithm {
    /// Whether its agents are outside programs.
    pub fn is_external(&self) -> bool {
        self.name() == External::NAME
    }

    /// The algorithm of outside programs whose parameters have these keys. `None` if a key is not
    /// of the form of [`free_key`](crate::key::free_key), or if there are too many keys.
    pub fn external<'n>(keys: impl IntoIterator<Item = &'n str>) -> Option<&'static Algorithm> {
        let base = Algorithm::named(External::NAME)?;
        let free = free_keys(keys)?;
        if free.is_empty() {
            return Some(base);
        }
        Some(ALGORITHMS.of(base.keys(), &free, |keys| base.with_keys(keys)))
    }
}

impl Agent {
    /// The parameters of an outside program, by the names that the user gave them.
    pub fn free_parameters(&self) -> impl Iterator<Item = (&'static str, &Value)> {
        free_values(self.algorithm().keys(), self.values())
    }
}

impl AlgorithmParameters for External {
    const NAME: &'static str = "external";
    const HAS_WEIGHTS: bool = false;
    const UNREAD_IN_TRIALS: Option<&'static [&'static str]> = Some(&[]);

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
        let with_names = |names: &[&str]| Algorithm::external(names.iter().copied()).unwrap();
        let both = with_names(&["parameters.rate", "parameters.depth"]);
        assert!(std::ptr::eq(both, with_names(&["parameters.depth", "parameters.rate"])));
        assert_ne!(both, with_names(&["parameters.rate"]));
        assert_eq!(with_names(&[]), Algorithm::named("external").unwrap());
        let names: Vec<&str> = both.keys().iter().map(|key| key.name).collect();
        let expected =
            ["command", "version", "episodes", "history", "parameters.depth", "parameters.rate"];
        assert_eq!(names, expected);
        assert_eq!(both.name(), "external");
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
