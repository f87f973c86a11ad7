//! Declarations that agents with networks share.

use crate::key::{Kind, choices};

/// Widths of hidden layers.
pub const LAYER_WIDTHS: Kind = Kind::Widths { most: 32, max: 4096 };
/// Adam's step size.
pub const LEARNING_RATE: Kind = Kind::PositiveReal { max: 1.0 };

/// Units of a GRU.
pub const UNITS: Kind = Kind::Integer { min: 1, max: 1024 };
/// Hidden layers in front of a GRU.
pub const BEFORE_GRU: Kind = Kind::Integer { min: 1, max: 32 };

choices! {
    /// The memory of the episode.
    pub enum Recurrent {
        /// No memory: the network sees only the current observation.
        None = "none",
        /// A gated recurrent unit.
        Gru = "gru",
    }
}

choices! {
    /// Activation of a hidden layer.
    pub enum Activation {
        /// max(0, x).
        Relu = "relu",
        /// Hyperbolic tangent.
        Tanh = "tanh",
    }
}

choices! {
    /// Which code performs the training updates.
    pub enum Engine {
        /// Kernels written for these networks: the same arithmetic, many times as fast.
        Fused = "fused",
        /// Burn modules with Burn's automatic differentiation.
        Burn = "burn",
    }
}

/// The program was built without the engine that an agent asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "this program was built without `engine = \"burn\"`; build it with the feature `burn`, which is on by default"
)]
pub struct NoEngine;

/// Name and version of the tensor backend, for the provenance of a run.
pub fn backend_name() -> &'static str {
    match (cfg!(feature = "burn"), cfg!(feature = "burn-flex")) {
        (_, true) => "burn-flex 0.22.1",
        (true, false) => "burn-ndarray 0.22.1",
        (false, false) => "none",
    }
}

impl Engine {
    /// The engines of this build.
    pub const BUILT: &'static [Engine] = match cfg!(feature = "burn") {
        true => &[Engine::Fused, Engine::Burn],
        false => &[Engine::Fused],
    };

    /// Copies of the trained weights in memory beside those that every engine has.
    pub fn further_copies(self) -> usize {
        match self {
            Engine::Fused => 0,
            // The module and the array that its optimiser updates.
            Engine::Burn => 1,
        }
    }

    /// Multiply-adds of training per second on one core of a recent server processor, to the
    /// nearest half. Arithmetic is not the only bottleneck of networks this small.
    pub fn speed(self) -> f64 {
        match self {
            Engine::Fused => 5e10,
            Engine::Burn => 8e9,
        }
    }
}
