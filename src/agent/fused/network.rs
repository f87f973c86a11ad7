//! The interface that trained networks share.

use crate::agent::policy::ActionNetwork;
use crate::agent::{Shape, Weights, WeightsError};
use crate::kernel::{Aligned, Isa};
use crate::state::Resumable;

/// A network that is trained, in a flat array.
pub trait FusedNetwork: ActionNetwork + Resumable + Clone + Send + 'static {
    /// The hyper-parameters of the algorithm.
    type Parameters;

    /// A network with these weights, of this shape.
    ///
    /// **Errors**: an array is missing or of another shape.
    fn from_weights(
        parameters: &Self::Parameters,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError>;

    /// The instruction set of its kernels.
    fn isa(&self) -> Isa;

    /// All parameters.
    fn parameters(&self) -> &Aligned;

    /// All parameters, mutable.
    fn parameters_mut(&mut self) -> &mut Aligned;

    /// The values of a flat array laid out like the parameters, by the names of the weights.
    fn named(&self, flat: &[f32]) -> Weights;

    /// The weights, by name.
    fn weights(&self) -> Weights {
        self.named(self.parameters())
    }
}
