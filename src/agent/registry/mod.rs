//! The registry: every algorithm that a manifest can name, in one list.
//!
//! In: types that implement [`AlgorithmParameters`]. Out: [`Algorithm`]s by name. A program that uses
//! the library adds its own with [`register`]; nothing else in the library lists algorithms.

mod algorithm;
mod dueling_dqn;
mod reinforce;
mod rule;

use std::sync::{PoisonError, RwLock};

use crate::agent::dueling_dqn::DuelingDqn;
use crate::agent::reinforce::Reinforce;
use crate::agent::rule::RuleParameters;

pub use algorithm::{
    Agent, Algorithm, AlgorithmParameters, Setting, Start, StartError, Trained, Work,
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

/// A name that another algorithm has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is an algorithm called `{0}` already")]
pub struct NameTaken(pub &'static str);

/// Adds an algorithm, so that manifests and stores that name it can be read.
///
/// **Errors**: its name is taken.
pub fn register<P: AlgorithmParameters>() -> Result<(), NameTaken> {
    let mut registered = REGISTERED.write().unwrap_or_else(PoisonError::into_inner);
    let is_taken = |algorithm: &Algorithm| algorithm.name() == P::NAME;
    if BUILT_IN.iter().any(is_taken) || registered.iter().any(|algorithm| is_taken(algorithm)) {
        return Err(NameTaken(P::NAME));
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
