//! Exports trained policies as files for other programs: a description, weights, and an ONNX graph.
//!
//! In: the weights of a completed job. Out: the content of each file, identical for equal policies.
//! `docs/python.md` describes the files.

mod description;
mod onnx;
mod protobuf;

use serde_json::Value as Json;

use crate::agent::{NetworkPolicy, Weights, WeightsError};
use crate::store::StoredWeights;
pub use description::digest;

/// A policy as files.
#[derive(Clone, Debug)]
pub struct PortablePolicy {
    /// The meaning of observations and actions, the architecture, and the provenance of the policy.
    pub description: Json,
    /// `weights.safetensors`: arrays by name, \[inputs, outputs\] and \[outputs\].
    pub weights: Vec<u8>,
    /// `policy.onnx`.
    pub onnx: Vec<u8>,
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
    /// The network has a recurrent memory.
    #[error(
        "the policy of job {key} has a memory of the episode (`recurrent = \"gru\"`), and the \
         exported files cannot hold its state: they describe networks of one observation; \
         simulate it with `jitai simulate --policy run:{key}`, or export an agent with `history` instead"
    )]
    HasMemory {
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

/// The network of a completed job with its weights.
///
/// **Errors**: the job has no network, or the network has a memory, or the weights do not fit.
pub fn network_of(stored: &StoredWeights) -> Result<(Weights, NetworkPolicy), PortableError> {
    let key = || stored.job_key.to_string();
    let refused = |error| match error {
        WeightsError::NoNetwork => {
            PortableError::NoNetwork { key: key(), algorithm: stored.job.algorithm() }
        }
        error => PortableError::Weights { key: key(), error },
    };
    let bytes = stored.safetensors.as_ref().ok_or_else(|| refused(WeightsError::NoNetwork))?;
    let weights = Weights::from_bytes(bytes).map_err(refused)?;
    let policy = stored.job.agent.network(stored.job.task().shape(), &weights).map_err(refused)?;
    if policy.network.memory() > 0 {
        return Err(PortableError::HasMemory { key: key() });
    }
    Ok((weights, policy))
}

/// The policy of a completed job as files.
///
/// **Errors**: the job has no network, or the network has a memory or does not state its layers, or
/// the weights do not fit.
pub fn portable(stored: &StoredWeights) -> Result<PortablePolicy, PortableError> {
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
    Ok(PortablePolicy { description, weights, onnx })
}

pub use description::describe_observations;
