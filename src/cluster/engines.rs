//! Which file carries out what an engine is called for.

use super::engine::{Engine, EngineKind};
use super::script::Order;
use super::slurm::{self, Slurm};

/// The engine as this machine reaches it; nothing is called yet.
pub fn connect(kind: EngineKind) -> Box<dyn Engine> {
    match kind {
        EngineKind::Slurm => Box::new(Slurm),
    }
}

/// The script that an engine is given for an order.
pub(super) fn script(kind: EngineKind, order: &Order<'_>) -> String {
    match kind {
        EngineKind::Slurm => slurm::script(order),
    }
}
