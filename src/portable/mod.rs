//! Exports trained policies as files for other programs: a description, weights, and an ONNX graph.
//!
//! In: the weights of a completed job. Out: the content of each file, identical for equal policies.
//! `docs/python.md` describes the files.

mod description;
mod onnx;
mod protobuf;

use serde_json::Value as Json;

use crate::agent::{Architecture, Weights, WeightsError};
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
pub fn network_of(stored: &StoredWeights) -> Result<(Weights, Architecture), PortableError> {
    let key = || stored.job_key.to_string();
    let refused = |error| match error {
        WeightsError::NoNetwork => {
            PortableError::NoNetwork { key: key(), algorithm: stored.job.algorithm() }
        }
        WeightsError::HasMemory => PortableError::HasMemory { key: key() },
        error => PortableError::Weights { key: key(), error },
    };
    let bytes = stored.safetensors.as_ref().ok_or_else(|| refused(WeightsError::NoNetwork))?;
    let weights = Weights::from_bytes(bytes).map_err(refused)?;
    let architecture = stored.job.agent.architecture(&weights).map_err(refused)?;
    Ok((weights, architecture))
}

/// The policy of a completed job as files.
///
/// **Errors**: the job has no network, or the network has a memory, or the weights do not fit.
pub fn portable(stored: &StoredWeights) -> Result<PortablePolicy, PortableError> {
    let (weights, architecture) = network_of(stored)?;
    let inputs = stored.job.task().observations().inputs();
    // Reports weights that do not fit the network.
    stored
        .job
        .agent
        .network(inputs, &weights)
        .map_err(|error| PortableError::Weights { key: stored.job_key.to_string(), error })?;
    let onnx = onnx::model(&weights, &architecture, inputs);
    let weights = weights.to_bytes();
    let description = description::describe(stored, &architecture, &weights, &onnx);
    Ok(PortablePolicy { description, weights, onnx })
}

pub use description::describe_observations;
