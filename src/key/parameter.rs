//! The sections of a manifest, and the dotted names of parameters in which jobs can differ.

use std::fmt;
use std::ops::{Index, IndexMut};

use super::choices;

/// Declares the sections, and the parameters that are their keys.
macro_rules! sections {
    ($($(#[$doc:meta])+ $Section:ident = $word:literal, $(#[$of_key:meta])+;)+) => {
        choices! {
            /// A section of a manifest.
            #[derive(Hash)]
            pub enum SectionName {
                $($(#[$doc])+ $Section = $word,)+
            }
        }

        /// A parameter in which jobs can differ, as zips, conditions and filters name it.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Parameter {
            /// A parameter of the job itself: [`Parameter::SCENARIO`] or [`Parameter::SEED`].
            Job(&'static str),
            $($(#[$of_key])+ $Section(&'static str),)+
        }

        impl SectionName {
            /// Every section, in the order of grids.
            pub const ALL: [SectionName; SectionName::WORDS.len()] = [$(SectionName::$Section),+];

            /// The key of this name, as a parameter.
            pub const fn parameter(self, key: &'static str) -> Parameter {
                match self {
                    $(SectionName::$Section => Parameter::$Section(key),)+
                }
            }
        }

        impl Parameter {
            /// The section that has the key; `None` for a parameter of the job itself.
            pub const fn section(self) -> Option<SectionName> {
                match self {
                    Parameter::Job(_) => None,
                    $(Parameter::$Section(_) => Some(SectionName::$Section),)+
                }
            }

            /// The last part of its dotted name, as its section writes it.
            pub const fn key(self) -> &'static str {
                match self {
                    Parameter::Job(key) $(| Parameter::$Section(key))+ => key,
                }
            }
        }
    };
}

sections! {
    /// The simulation.
    Environment = "environment",
        /// `environment.<key>`.
    ;
    /// How participants differ.
    Population = "population",
        /// `population.<key>`.
    ;
    /// An agent, of which a manifest can have several.
    Agent = "agent",
        /// `agent.<key>`, for every agent that has the key.
    ;
    /// How jobs are tested and recorded.
    Evaluation = "evaluation",
        /// `evaluation.<key>`.
    ;
    /// The trial in which agents meet people.
    Trial = "trial",
        /// `trial.<key>`.
    ;
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
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.section() {
            None => f.write_str(self.key()),
            Some(section) => write!(f, "{}.{}", section.word(), self.key()),
        }
    }
}

/// One value for each section.
#[derive(Clone, Debug, PartialEq)]
pub struct PerSection<T>([T; SectionName::ALL.len()]);

impl<T> PerSection<T> {
    /// The values that `value_of` returns for the sections.
    pub fn of(value_of: impl FnMut(SectionName) -> T) -> PerSection<T> {
        PerSection(SectionName::ALL.map(value_of))
    }
}

impl<T> Index<SectionName> for PerSection<T> {
    type Output = T;

    fn index(&self, section: SectionName) -> &T {
        &self.0[section as usize]
    }
}

impl<T> IndexMut<SectionName> for PerSection<T> {
    fn index_mut(&mut self, section: SectionName) -> &mut T {
        &mut self.0[section as usize]
    }
}
