//! What the agents with networks declare alike.

use crate::choices;
use crate::key::Kind;

/// Widths of hidden layers.
pub const LAYER_WIDTHS: Kind = Kind::Widths { most: 32, max: 4096 };
/// Adam's step size.
pub const LEARNING_RATE: Kind = Kind::PositiveReal { max: 1.0 };

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
        /// Burn modules with Burn's automatic differentiation and Adam.
        Burn = "burn",
    }
}
