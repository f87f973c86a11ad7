//! Parameters that canonical forms omit at the value that earlier jobs had.

use super::Scalar;
use crate::manifest::Section;

/// A parameter that was added after jobs had been stored, with its value in every job whose canonical form
/// omits it.
#[derive(Clone, Debug, PartialEq)]
pub struct ImpliedParameter {
    /// Dotted name.
    pub name: String,
    /// The algorithm that the key belongs to; `None` for a parameter of every job.
    pub algorithm: Option<&'static str>,
    /// The value.
    pub value: Scalar,
}

/// All such parameters of this program.
pub fn implied_parameters() -> Vec<ImpliedParameter> {
    let of = |section: Section| {
        let algorithm = match section {
            Section::Agent(algorithm) => Some(algorithm.name()),
            Section::Environment | Section::Population | Section::Evaluation => None,
        };
        section.keys().iter().filter_map(move |key| {
            Some(ImpliedParameter {
                name: section.parameter(key.name).to_string(),
                algorithm,
                value: Scalar::of(&key.before()?),
            })
        })
    };
    Section::all().into_iter().flat_map(of).collect()
}
