//! The registry: every algorithm that a manifest can name, in one list.
//!
//! In: types that implement [`AlgorithmParameters`]. Out: [`Algorithm`]s by name. A program that uses
//! the library adds its own with [`register_algorithm`]; nothing else in the library lists algorithms.

mod algorithm;
mod dueling_dqn;
mod reinforce;
mod rule;

use std::sync::{PoisonError, RwLock};

use crate::agent::dueling_dqn::DuelingDqn;
use crate::agent::reinforce::Reinforce;
use crate::agent::rule::RuleParameters;

pub use algorithm::{
    Agent, Algorithm, AlgorithmParameters, Start, StartError, Task, Trained, Work,
};
pub use dueling_dqn::{learner_in as dueling_dqn_learner, trained as trained_dueling_dqn};
pub use reinforce::{learner_in as reinforce_learner, trained as trained_reinforce};

/// The algorithms that come with the library, in the order the documentation lists them.
static BUILT_IN: [Algorithm; 3] = [
    Algorithm::of::<DuelingDqn>(),
    Algorithm::of::<Reinforce>(),
    Algorithm::of::<RuleParameters>(),
];

/// The algorithms that programs have added, in their order.
static REGISTERED: RwLock<Vec<&'static Algorithm>> = RwLock::new(Vec::new());

/// Why an algorithm cannot be registered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RegistrationError {
    /// Another algorithm has its name.
    #[error("there is an algorithm called `{0}` already")]
    NameTaken(&'static str),
    /// One of its keys has a name that manifests use for something else.
    #[error("`{0}` cannot be the name of a key of an algorithm; manifests use it for every agent")]
    ReservedKey(&'static str),
}

/// Names that the table of an agent in a manifest uses beside the keys of its algorithm.
const RESERVED: [&str; 2] = ["algorithm", "name"];

/// Adds an algorithm, so that manifests and stores that name it can be read.
///
/// **Errors**: its name is taken, or a key has a reserved name.
pub fn register_algorithm<P: AlgorithmParameters>() -> Result<(), RegistrationError> {
    if let Some(key) = P::KEYS.iter().find(|key| RESERVED.contains(&key.name)) {
        return Err(RegistrationError::ReservedKey(key.name));
    }
    let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    let is_taken = |algorithm: &Algorithm| algorithm.name() == P::NAME;
    if BUILT_IN.iter().any(is_taken) || registered.iter().any(|algorithm| is_taken(algorithm)) {
        return Err(RegistrationError::NameTaken(P::NAME));
    }
    registered.push(const { &Algorithm::of::<P>() });
    Ok(())
}

impl Algorithm {
    /// Every registered algorithm.
    pub fn all() -> Vec<&'static Algorithm> {
        let registered = REGISTERED.read().unwrap_or_else(PoisonError::into_inner);
        BUILT_IN.iter().chain(registered.iter().copied()).collect()
    }

    /// The registered algorithm of this name.
    pub fn named(name: &str) -> Option<&'static Algorithm> {
        Algorithm::all().into_iter().find(|algorithm| algorithm.name() == name)
    }
}
