//! The dotted names of parameters in which jobs can differ.

use std::fmt;

/// A parameter that a grid can vary, as zips and exclusions name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Parameter {
    /// `scenario`.
    Scenario,
    /// `seed`.
    Seed,
    /// `environment.<key>`.
    Environment(&'static str),
    /// `population.<key>`.
    Population(&'static str),
    /// `agent.<key>`, for every agent that has the key.
    Agent(&'static str),
    /// `evaluation.<key>`.
    Evaluation(&'static str),
}

impl Parameter {
    /// The last part of its dotted name, as its section writes it.
    pub fn key(self) -> &'static str {
        match self {
            Parameter::Scenario => "scenario",
            Parameter::Seed => "seed",
            Parameter::Environment(key)
            | Parameter::Population(key)
            | Parameter::Agent(key)
            | Parameter::Evaluation(key) => key,
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Parameter::Scenario => f.write_str("scenario"),
            Parameter::Seed => f.write_str("seed"),
            Parameter::Environment(key) => write!(f, "environment.{key}"),
            Parameter::Population(key) => write!(f, "population.{key}"),
            Parameter::Agent(key) => write!(f, "agent.{key}"),
            Parameter::Evaluation(key) => write!(f, "evaluation.{key}"),
        }
    }
}
