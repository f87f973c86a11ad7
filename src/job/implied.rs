//! Parameters that canonical forms omit at the value that earlier jobs had.

use super::{Evaluation, Scalar};
use crate::agent::Algorithm;
use crate::env::Family;
use crate::key::{Key, Keyed};

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
    fn in_section(
        section: &str,
        algorithm: Option<&'static str>,
        keys: &[Key],
    ) -> Vec<ImpliedParameter> {
        let implied = |key: &Key| {
            let value = Scalar::from(&key.before()?);
            Some(ImpliedParameter { name: format!("{section}.{}", key.name), algorithm, value })
        };
        keys.iter().filter_map(implied).collect()
    }
    let algorithms = Algorithm::all().into_iter();
    let of_agents = algorithms.map(|one| in_section("agent", Some(one.name()), one.keys()));
    let of_all = [
        in_section("environment", None, Family::first().keys),
        in_section("population", None, Family::first().people),
        in_section("evaluation", None, Evaluation::KEYS),
    ];
    of_all.into_iter().chain(of_agents).flatten().collect()
}
