//! Training by kernels: the same arithmetic as Burn's, in a fraction of the time.
//!
//! In: weights and hyper-parameters. Out: engines for the algorithms. Weights and Adam's moments
//! stay in flat arrays for the life of a job, padded so that rows fill whole registers; gradients
//! are written out by hand. Tests hold them against Burn's automatic differentiation and against
//! PyTorch, and hold equal the bits of every instruction set. It knows no replay buffer and no
//! random number.

mod dueling_dqn;
mod reinforce;
mod stack;
mod state;

pub use dueling_dqn::{FusedDuelingDqn, FusedDuelingNetwork};
pub use reinforce::{FusedPolicyNetwork, FusedReinforce};
