//! Exports trained policies as files for other programs: a description, weights, and an ONNX graph.
//!
//! In: the weights of a completed job. Out: the content of each file, identical for equal policies.
//! `docs/python.md` describes the files.

mod description;
mod onnx;
mod protobuf;

use std::path::Path;

use serde_json::Value as Json;

use crate::agent::{BanditPolicy, LinearThompson, NetworkPolicy, Weights, WeightsError};
use crate::job::NoWeights;
use crate::store::{Reader, StoredWeights};

/// A policy as files.
#[derive(Clone, Debug)]
pub struct PortablePolicy {
    /// `policy.json`: the meaning of observations and actions, the architecture or the posterior, and the provenance of
    /// the policy.
    pub description: Json,
    /// The other files of a network with their names: `weights.safetensors`, arrays by name, \[inputs, outputs\] and
    /// \[outputs\]; and `policy.onnx`. A bandit has none.
    pub files: Vec<(&'static str, Vec<u8>)>,
}

/// Why the policy of a job cannot be exported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PortableError {
    /// The job's agent has no network that maps observations to actions.
    #[error(
        "job {key} has no network to export: agents of the algorithm `{algorithm}` do not map \
         observations to actions by a network"
    )]
    NoNetwork {
        /// The job.
        key: String,
        /// The algorithm.
        algorithm: &'static str,
    },
    /// The job's agent is no bandit, so that it has no posterior.
    #[error(
        "job {key} has no posterior: its agent has the algorithm `{algorithm}`, and only jobs of `linear_thompson` \
         have one"
    )]
    NoBandit {
        /// The job.
        key: String,
        /// The algorithm.
        algorithm: &'static str,
    },
    /// The job has no weights.
    #[error("job {key} has no stored policy: {reason}")]
    NoWeights {
        /// The job.
        key: String,
        /// The reason.
        reason: NoWeights,
    },
    /// The store lacks the weights of the job.
    #[error("job {key} lacks its weights: the store is damaged; examine it with `jitai doctor`")]
    Missing {
        /// The job.
        key: String,
    },
    /// The network does not consist of the layers that the files can hold.
    #[error(
        "the network of job {key} cannot be exported: agents of the algorithm `{algorithm}` do not \
         state layers with the names of their weights"
    )]
    NoLayers {
        /// The job.
        key: String,
        /// The algorithm.
        algorithm: &'static str,
    },
    /// The weights do not fit the job.
    #[error("the policy of job {key} cannot be used: {error}")]
    Weights {
        /// The job.
        key: String,
        /// The mismatch.
        error: WeightsError,
    },
}

/// The weights of a completed job.
///
/// **Errors**: the job has no weights, or they cannot be read.
pub fn weights_of(stored: &StoredWeights) -> Result<Weights, PortableError> {
    let key = stored.job_key.to_string();
    match (&stored.safetensors, stored.job.no_weights()) {
        (Some(bytes), _) => {
            Weights::from_bytes(bytes).map_err(|error| PortableError::Weights { key, error })
        }
        (None, Some(reason)) => Err(PortableError::NoWeights { key, reason }),
        (None, None) => Err(PortableError::Missing { key }),
    }
}

/// The network of a completed job with its weights.
///
/// **Errors**: the job has no weights or no network, or the weights do not fit.
pub fn network_of(stored: &StoredWeights) -> Result<(Weights, NetworkPolicy), PortableError> {
    let key = || stored.job_key.to_string();
    let refused = |error| match error {
        WeightsError::NoNetwork => {
            PortableError::NoNetwork { key: key(), algorithm: stored.job.algorithm() }
        }
        error => PortableError::Weights { key: key(), error },
    };
    let weights = weights_of(stored)?;
    let policy = stored.job.agent.network(stored.job.task().shape(), &weights).map_err(refused)?;
    Ok((weights, policy))
}

/// The policy of a completed bandit with the weights that hold its posterior.
///
/// **Errors**: the job has another agent or no weights, or the weights do not fit.
pub fn bandit_of(stored: &StoredWeights) -> Result<(Weights, BanditPolicy), PortableError> {
    let key = || stored.job_key.to_string();
    let job = &stored.job;
    let parameters: LinearThompson = job
        .agent
        .parameters()
        .ok_or_else(|| PortableError::NoBandit { key: key(), algorithm: job.algorithm() })?;
    let weights = weights_of(stored)?;
    let policy = BanditPolicy::new(&parameters, &job.task().interface(), &weights, job.seed);
    let policy = policy.map_err(|error| PortableError::Weights { key: key(), error })?;
    Ok((weights, policy))
}

/// The description of a completed bandit without the draws of its probabilities: all that another bandit takes as its
/// prior.
///
/// **Errors**: as [`bandit_of`].
pub fn bandit_posterior(stored: &StoredWeights) -> Result<String, PortableError> {
    let (weights, _) = bandit_of(stored)?;
    Ok(description::describe_bandit(stored, &weights, &[]).to_string())
}

/// [`bandit_posterior`] of the only completed job in a store whose key begins with `key`; the error says why there
/// is none.
pub fn posterior_in(store: &Path, key: &str) -> Result<String, String> {
    let reader = Reader::open(store).map_err(|error| error.to_string())?;
    let stored = reader.weights(key).map_err(|error| error.to_string())?;
    bandit_posterior(&stored).map_err(|error| error.to_string())
}

/// The policy of a completed job as files.
///
/// **Errors**: the job has no weights, or neither a network nor a posterior, or the network does not state its layers,
/// or the weights do not fit.
pub fn portable(stored: &StoredWeights) -> Result<PortablePolicy, PortableError> {
    if stored.job.agent.parameters::<LinearThompson>().is_some() {
        let (weights, policy) = bandit_of(stored)?;
        let description = description::describe_bandit(stored, &weights, policy.deviates());
        return Ok(PortablePolicy { description, files: Vec::new() });
    }
    let (weights, NetworkPolicy { choice, architecture, .. }) = network_of(stored)?;
    let architecture = architecture.filter(|architecture| architecture.fits(&weights));
    let architecture = architecture.ok_or_else(|| PortableError::NoLayers {
        key: stored.job_key.to_string(),
        algorithm: stored.job.algorithm(),
    })?;
    let onnx = onnx::model(&weights, (&architecture, choice), stored.job.task().shape());
    let weights = weights.to_bytes();
    let files = [&weights[..], &onnx[..]];
    let description = description::describe(stored, (&architecture, choice), files);
    let files = vec![("weights.safetensors", weights), ("policy.onnx", onnx)];
    Ok(PortablePolicy { description, files })
}

pub use description::{describe_job, describe_observations};
