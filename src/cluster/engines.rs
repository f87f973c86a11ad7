//! The available engines.

use super::engine::{Engine, EngineKind};
use super::script::Order;
use super::slurm::{self, Slurm};

/// The engine of this kind. Makes no call of the engine.
pub fn connect(kind: EngineKind) -> Box<dyn Engine> {
    match kind {
        EngineKind::Slurm => Box::new(Slurm),
    }
}

/// The engine's script for an order.
pub(super) fn script(kind: EngineKind, order: &Order<'_>) -> String {
    match kind {
        EngineKind::Slurm => slurm::script(order),
    }
}
