//! The available engines.

use serde::{Deserialize, Serialize};

use super::engine::{Declaration, Engine, Limits};
use super::slurm::SLURM;
use crate::choices;

choices! {
    /// The supported engines.
    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum EngineKind {
        /// Slurm.
        Slurm = "slurm",
    }
}

impl EngineKind {
    /// All engines; the first is the default.
    pub const ALL: [EngineKind; 1] = [EngineKind::Slurm];

    /// The limits where the configuration of the cluster is unknown.
    pub fn usual_limits(self) -> Limits {
        self.declaration().usual
    }

    pub(super) fn declaration(self) -> &'static Declaration {
        match self {
            EngineKind::Slurm => &SLURM,
        }
    }
}

/// The engine of this kind. Makes no call of the engine.
pub fn connect<'a>(kind: EngineKind) -> Box<dyn Engine + 'a> {
    (kind.declaration().connect)()
}
