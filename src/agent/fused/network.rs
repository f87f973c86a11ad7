//! The interface that trained networks share.

use crate::agent::Weights;
use crate::agent::policy::ActionNetwork;
use crate::kernel::{Aligned, Isa};
use crate::state::Resumable;

/// A network that is trained, in a flat array.
pub trait FusedNetwork: ActionNetwork + Resumable + Clone + Send + 'static {
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
