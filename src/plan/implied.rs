//! The parameters that canonical forms leave out at the value of earlier jobs.

use super::Scalar;
use crate::manifest::Section;

/// A parameter that was added after jobs had been stored, with the value that it has in every job
/// whose canonical form does not mention it.
#[derive(Clone, Debug, PartialEq)]
pub struct ImpliedParameter {
    /// Dotted name.
    pub name: String,
    /// The algorithm whose key it is; `None` for a parameter of every job.
    pub algorithm: Option<&'static str>,
    /// The value.
    pub value: Scalar,
}

/// Every such parameter of this program.
pub fn implied_parameters() -> Vec<ImpliedParameter> {
    let of = |section: Section| {
        let algorithm = match section {
            Section::Agent(algorithm) => Some(algorithm.name()),
            Section::Environment | Section::Evaluation => None,
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
