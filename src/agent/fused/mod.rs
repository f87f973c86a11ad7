//! Training by kernels: the same arithmetic as Burn's, in a fraction of the time.
//!
//! In: weights and hyper-parameters. Out: engines for the algorithms. Weights and Adam's moments
//! stay in flat arrays for the duration of a job, padded to whole registers. Gradients are derived
//! by hand. Tests compare them with Burn's automatic differentiation and with PyTorch, and check
//! that every instruction set gives bit-identical results. The module uses neither replay buffers
//! nor random numbers.

mod actor_critic;
mod dense;
mod dueling_dqn;
mod network;
mod ppo;
mod ppo_loss;
mod ppo_network;
mod recurrent;
mod recurrent_actor_critic;
mod recurrent_dqn;
mod recurrent_network;
mod reinforce;
mod sequences;
mod stack;

use crate::kernel::Adam;
use crate::state::resumable;

pub use actor_critic::FusedActorCritic;
pub use dueling_dqn::{FusedDuelingDqn, FusedDuelingNetwork};
pub use network::FusedNetwork;
pub use ppo::FusedPpo;
#[cfg(all(test, feature = "burn"))]
pub use ppo_network::FusedPpoNetwork;
pub use recurrent_actor_critic::FusedRecurrentActorCritic;
pub use recurrent_dqn::FusedRecurrentDuelingNetwork;
pub use reinforce::{FusedPolicyNetwork, FusedReinforce};

/// The dueling DQN with a GRU.
pub type FusedRecurrentDqn = FusedDuelingDqn<FusedRecurrentDuelingNetwork>;

resumable!([] Adam { fixed first, second, powers, decays });
