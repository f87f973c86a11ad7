//! The registry: every algorithm that a manifest can name, in one list.
//!
//! In: types that implement [`AlgorithmParameters`]. Out: [`Algorithm`]s by name. A program that
//! uses the library adds its own algorithms with [`register_algorithm`]. No other module lists
//! algorithms.

mod algorithm;
mod dueling_dqn;
mod external;
mod linear_thompson;
mod ppo;
mod reinforce;
mod rule;
mod size;

use std::sync::{PoisonError, RwLock};

use crate::agent::dueling_dqn::DuelingDqn;
use crate::agent::external::External;
use crate::agent::linear_thompson::LinearThompson;
use crate::agent::ppo::Ppo;
use crate::agent::reinforce::Reinforce;
use crate::agent::rule::RuleParameters;

pub use algorithm::{
    Agent, Algorithm, AlgorithmParameters, Sharing, Start, StartError, StudyPlan, Task, Trained,
    Work,
};
pub use dueling_dqn::learner_in as dueling_dqn_learner;
pub use linear_thompson::{
    learner_in as linear_thompson_learner, trained as trained_linear_thompson,
};
pub use ppo::learner_in as ppo_learner;
pub use reinforce::learner_in as reinforce_learner;

/// The algorithms that come with the library, in the order of the documentation.
static BUILT_IN: [Algorithm; 6] = [
    Algorithm::of::<DuelingDqn>(),
    Algorithm::of::<Reinforce>(),
    Algorithm::of::<LinearThompson>(),
    Algorithm::of::<Ppo>(),
    Algorithm::of::<RuleParameters>(),
    Algorithm::of::<External>(),
];

/// The algorithms that programs have registered, in order of registration.
static REGISTERED: RwLock<Vec<&'static Algorithm>> = RwLock::new(Vec::new());

/// Why an algorithm cannot be registered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RegistrationError {
    /// Another algorithm has its name.
    #[error("an algorithm called `{0}` is already registered")]
    NameTaken(&'static str),
    /// One of its keys has a name that manifests use for something else.
    #[error("`{0}` cannot be a key of an algorithm, because manifests use it for every agent")]
    ReservedKey(&'static str),
}

/// Names in the table of an agent that are not keys of its own algorithm.
const RESERVED: [&str; 3] = ["algorithm", "history", "name"];

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

    /// The registered algorithm with this name.
    pub fn named(name: &str) -> Option<&'static Algorithm> {
        Algorithm::all().into_iter().find(|algorithm| algorithm.name() == name)
    }
}
