//! The dotted names of parameters in which jobs can differ.

use std::fmt;

/// A parameter in which jobs can differ, as zips, conditions and filters name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Parameter {
    /// A parameter of the job itself: [`Parameter::SCENARIO`] or [`Parameter::SEED`].
    Job(&'static str),
    /// `environment.<key>`.
    Environment(&'static str),
    /// `population.<key>`.
    Population(&'static str),
    /// `agent.<key>`, for every agent that has the key.
    Agent(&'static str),
    /// `evaluation.<key>`.
    Evaluation(&'static str),
    /// `trial.<key>`.
    Trial(&'static str),
}

impl Parameter {
    /// `scenario`.
    pub const SCENARIO: Parameter = Parameter::Job("scenario");
    /// `seed`.
    pub const SEED: Parameter = Parameter::Job("seed");
    /// `agent.name`: the agent's name in its manifest, which is not part of the job.
    pub const AGENT_NAME: Parameter = Parameter::Agent("name");
    /// `agent.algorithm`.
    pub const ALGORITHM: Parameter = Parameter::Agent("algorithm");

    /// The last part of its dotted name, as its section writes it.
    pub fn key(self) -> &'static str {
        match self {
            Parameter::Job(key)
            | Parameter::Environment(key)
            | Parameter::Population(key)
            | Parameter::Agent(key)
            | Parameter::Evaluation(key)
            | Parameter::Trial(key) => key,
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Parameter::Job(key) => f.write_str(key),
            Parameter::Environment(key) => write!(f, "environment.{key}"),
            Parameter::Population(key) => write!(f, "population.{key}"),
            Parameter::Agent(key) => write!(f, "agent.{key}"),
            Parameter::Evaluation(key) => write!(f, "evaluation.{key}"),
            Parameter::Trial(key) => write!(f, "trial.{key}"),
        }
    }
}
