//! Jobs as they were under an earlier default of a key.

use crate::agent::Agent;
use crate::job::{CanonicalForm, Job};

/// A key of an algorithm whose default has changed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChangedDefault {
    /// The algorithm.
    pub algorithm: &'static str,
    /// The key.
    pub key: &'static str,
    /// The default, as a manifest writes it.
    pub now: String,
    /// The default of earlier releases.
    pub before: String,
}

/// The canonical form of a job under the earlier default of a key of its agent; `None` unless the agent has
/// such a key at its default.
pub fn under_earlier_default(job: &Job) -> Option<(ChangedDefault, CanonicalForm)> {
    let algorithm = job.agent.algorithm();
    let is_changed = |index: &usize| {
        let key = &algorithm.keys()[*index];
        key.earlier.is_some() && key.default().as_ref() == Some(&job.agent.values()[*index])
    };
    let index = (0..algorithm.keys().len()).find(is_changed)?;
    let key = &algorithm.keys()[index];
    let (mut values, before) = (job.agent.values().to_vec(), key.earlier_default()?);
    let written = [&values[index], &before].map(ToString::to_string);
    values[index] = before;
    let agent = Agent::with_values(algorithm, values)?;
    let [now, before] = written;
    let changed = ChangedDefault { algorithm: algorithm.name(), key: key.name, now, before };
    Some((changed, Job { agent, ..job.clone() }.form()))
}
