//! The dotted names of what jobs differ in.

use std::fmt;

/// Something that a grid can vary, as zips and exclusions name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Parameter {
    /// `scenario`.
    Scenario,
    /// `seed`.
    Seed,
    /// `environment.<key>`.
    Environment(&'static str),
    /// `agent.<key>`, of whichever agents have the key.
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
            Parameter::Environment(key) | Parameter::Agent(key) | Parameter::Evaluation(key) => key,
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Parameter::Scenario => f.write_str("scenario"),
            Parameter::Seed => f.write_str("seed"),
            Parameter::Environment(key) => write!(f, "environment.{key}"),
            Parameter::Agent(key) => write!(f, "agent.{key}"),
            Parameter::Evaluation(key) => write!(f, "evaluation.{key}"),
        }
    }
}
