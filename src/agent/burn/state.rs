//! Saves and restores modules and their optimisers, in Burn's own format.
//!
//! The optimiser stores its moments by the ids of a module's parameters, and every new module draws
//! new ids. Modules and moments are therefore saved together and restored with the saved ids.

use std::io;

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::store::ModuleRecord;
use burn::tensor::Bytes;

use crate::state::{StateError, StateReader, StateWriter};

pub(super) fn save_module(module: &impl Module, out: &mut StateWriter<'_>) -> io::Result<()> {
    let bytes = module.clone().into_record().into_bytes().map_err(io::Error::other)?;
    out.many(&bytes[..])
}

/// Replaces the parameters of a module by saved parameters of a module of the same structure.
pub(super) fn restore_module<M: Module>(
    module: &mut M,
    from: &mut StateReader<'_>,
) -> Result<(), StateError> {
    let misfit = |_| StateError::Misfit("weights");
    let record = ModuleRecord::from_bytes(bytes(from, "weights")?).map_err(misfit)?;
    // Loading a record consumes a module and returns it.
    *module = module.clone().try_load_record(record).map_err(misfit)?;
    Ok(())
}

pub(super) fn save_optimizer(
    optimizer: &ModuleOptimizer,
    out: &mut StateWriter<'_>,
) -> io::Result<()> {
    out.many(&optimizer.into_bytes().map_err(io::Error::other)?[..])
}

pub(super) fn restore_optimizer(
    optimizer: &mut ModuleOptimizer,
    from: &mut StateReader<'_>,
) -> Result<(), StateError> {
    let bytes = bytes(from, "moments")?;
    *optimizer = optimizer.clone().from_bytes(bytes).map_err(|_| StateError::Misfit("moments"))?;
    Ok(())
}

fn bytes(from: &mut StateReader<'_>, what: &'static str) -> Result<Bytes, StateError> {
    Ok(Bytes::from_bytes_vec(from.many(usize::MAX, what)?))
}
