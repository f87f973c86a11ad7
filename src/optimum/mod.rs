//! The optimum: the highest mean undiscounted return of any policy, less the cost of messages, and a policy that
//! reaches it.
//!
//! In: an environment and a scenario that shows habituation and disengagement risk. Out: an [`Optimum`] with
//! an error estimate, or an [`OptimalPolicy`]. The module does not depend on agents or runs. It
//! comes before the agents in the import order because the optimal policy is one of the decision
//! rules that agents are compared with.
//!
//! # State and recursion
//!
//! The state of an episode consists of the number of steps left n, habituation h and disengagement risk d.
//! The context is drawn anew in every step, so the policy's probability p of context 0 is not part of the
//! state. With `C`, p is 0 or 1; with `P`, it follows from the context feature; with `L`, it is the accuracy
//! of the inference or its complement; with none of them, it is 1/2. A message leads to h' = min(h +
//! epsilon_h, 1). V is 0 if n = 0 or d reaches the threshold. Otherwise
//!
//! ```text
//! nothing      N = V(n-1, (1 - delta_h) h, d)
//! untailored   U = (1 - h') rho_1 - c + V(n-1, h', (1 - delta_d) d)
//! suitable     S = (1 - h') rho_2 - c + V(n-1, h', (1 - delta_d) d)
//! unsuitable   F = (1 - h') rho_3 - c + V(n-1, h', d + epsilon_d)
//! V(n, h, d) = (mu_0 + mu_1) / 2 + E_p max(N, U, p S + (1 - p) F, (1 - p) S + p F)
//! ```
//!
//! c is `message_cost`. With `disengagement_reward = "zero"`, F is minus the baseline and c if d + epsilon_d ends
//! the episode.
//! Gamma-distributed steps have the noise-free mean and change nothing. The recursion does not cover noise of
//! the state, persistent or unequal contexts that are not known, availability and budgets, so [`check`] rejects them.
//!
//! The mean over p has a closed form (`expectation.rs`). The policy takes the action that attains the
//! maximum. It knows the first context if `first_context` is fixed.
//!
//! # Grid
//!
//! V is computed for n = 1, 2, … at the nodes of a grid of h and d (`solution.rs`). The value is continuous
//! in h: a message leads from node to node, and a cubic interpolates where a step without a message leads.
//! The value has jumps in d, because a wrong message ends the episode from threshold - epsilon_d, and each
//! jump reappears at the risks that lead to it. The largest jumps have two nodes, one on either side, and
//! interpolation is linear between neighbouring nodes (`axis.rs`).
//!
//! # The number and its error
//!
//! The policy looks one step further ahead than the grid: it maximises action values under V~, where V~ is
//! computed by the recursion from the interpolated V of the next step, without interpolation. Its mean return
//! follows from simulated episodes (`simulation.rs`) with states s_t, where T V~ is the right-hand side of
//! the recursion with V~ for V:
//!
//! ```text
//! mean return = V~(s_0) + E sum over t > 0 of [T V~(s_t) - V~(s_t)]
//! ```
//!
//! All other terms cancel, because T V~ is the mean of the reward and the V~ of the next state under this
//! policy. The terms in brackets are small interpolation errors, so a few hundred episodes give the mean
//! return to a few hundredths of a step. Up to this noise, it is a lower bound of the optimum.
//!
//! This is done on two grids (`two_grids.rs`), one with half the spacing of the other, and the larger mean
//! return is reported. Its error is the difference between the two plus two standard errors, because a
//! further refinement usually gains less than the last one did. The error is an estimate, not a bound.
//!
//! # Limits and cost
//!
//! Horizons are limited to [`LONGEST_OPTIMUM`] steps, because the values of all steps are kept. An optimum
//! takes 0.1 s on one core and 45 MB at the paper's horizon, and 0.6 s and up to 250 MB at 200
//! steps. The computation uses one thread and no fused operations, so results are bit-identical on
//! every machine.

mod action_values;
mod axis;
mod expectation;
mod limits;
mod policy;
mod several;
mod simulation;
mod solution;
#[cfg(test)]
mod tests;
mod two_grids;

pub use limits::{LONGEST_OPTIMUM, NoOptimum, check, check_people};
pub use policy::OptimalPolicy;
pub use several::several;
pub use two_grids::{Optimum, optimum};
