//! The structure of a trained agent, for programs that compute it elsewhere: its layers, and how
//! its outputs become actions.

use crate::agent::actor::Actor;
use crate::agent::burn::device::inference;
use crate::agent::burn::{ActorCritic, DuelingQNetwork, PolicyNetwork};
use crate::agent::dueling_dqn::DuelingDqn;
use crate::agent::fused::{FusedActorCritic, FusedDuelingNetwork, FusedPolicyNetwork};
use crate::agent::layers;
use crate::agent::learner::Actions;
use crate::agent::network::{Activation, Engine, Recurrent};
use crate::agent::policy::{ActionNetwork, best, epsilon_greedy_probabilities, exponentials};
use crate::agent::ppo::Ppo;
use crate::agent::registry::{Agent, trained_dueling_dqn, trained_ppo, trained_reinforce};
use crate::agent::reinforce::Reinforce;
use crate::agent::weights::{Weights, WeightsError};
use crate::env::{Action, ObservationSpec, VectorEnvironment};
use crate::kernel::Isa;

/// The network of a trained agent: stacks of hidden layers on the observation, each with linear heads.
#[derive(Clone, Debug, PartialEq)]
pub struct Architecture {
    /// The activation after every hidden layer.
    pub activation: Activation,
    /// The stacks; each takes the whole observation as input.
    pub stacks: Vec<StackNames>,
    /// The outputs of the heads, and the choice of actions from them.
    pub choice: Choice,
}

/// The layers of a stack by the names of their weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StackNames {
    /// Hidden layers, input side first.
    pub hidden: Vec<String>,
    /// Linear layers on the last hidden layer.
    pub heads: Vec<String>,
}

/// The outputs of a network's heads, and the choice of actions from them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Choice {
    /// The heads `value`, V, and `advantage`, A, give values V + A - mean A. The action with the
    /// highest value is taken; ties go to the lowest number. With this probability, a random action
    /// is taken instead.
    EpsilonGreedy {
        /// The exploration rate.
        epsilon: f64,
    },
    /// The head `logits` gives logits, and actions are drawn by their softmax.
    Softmax,
}

impl Choice {
    /// The probabilities of the actions, given outputs of the network.
    ///
    /// **Shapes**: `numbers` and the result are \[rows, actions\].
    pub fn probabilities(self, numbers: &[f32]) -> Vec<f64> {
        match self {
            Choice::EpsilonGreedy { epsilon } => {
                let row = |values| epsilon_greedy_probabilities(epsilon, best(values));
                numbers.chunks_exact(Action::COUNT).flat_map(row).collect()
            }
            Choice::Softmax => {
                let mut preferences = numbers.to_vec();
                exponentials(Isa::chosen(), &mut preferences);
                let row = |preferences: &[f32]| -> [f64; Action::COUNT] {
                    let total: f64 = preferences.iter().copied().map(f64::from).sum();
                    std::array::from_fn(|index| f64::from(preferences[index]) / total)
                };
                preferences.chunks_exact(Action::COUNT).flat_map(row).collect()
            }
        }
    }
}

/// The agents whose only network maps an observation to outputs.
enum Networked {
    DuelingDqn(DuelingDqn),
    Reinforce(Reinforce),
    Ppo(Ppo),
}

impl Networked {
    /// The network of an agent.
    ///
    /// **Errors**: the agent has no network, or its network has a memory of the episode.
    fn of(agent: &Agent) -> Result<Networked, WeightsError> {
        let (networked, recurrent) = if let Some(dqn) = agent.parameters::<DuelingDqn>() {
            let recurrent = dqn.recurrent;
            (Networked::DuelingDqn(dqn), recurrent)
        } else if let Some(ppo) = agent.parameters::<Ppo>() {
            let recurrent = ppo.recurrent;
            (Networked::Ppo(ppo), recurrent)
        } else {
            let reinforce = agent.parameters().ok_or(WeightsError::NoNetwork)?;
            (Networked::Reinforce(reinforce), Recurrent::None)
        };
        match recurrent {
            Recurrent::None => Ok(networked),
            Recurrent::Gru => Err(WeightsError::HasMemory),
        }
    }
}

impl Agent {
    /// The network of this agent after training.
    ///
    /// **Errors**: a number is missing beside the weights; the agent has no network, or its network
    /// has a memory of the episode.
    pub fn architecture(&self, weights: &Weights) -> Result<Architecture, WeightsError> {
        // The names do not depend on the number of inputs.
        let (stacks, activation, choice) = match Networked::of(self)? {
            Networked::DuelingDqn(dqn) => {
                let choice = Choice::EpsilonGreedy { epsilon: weights.number("epsilon")? };
                (layers::dueling(&dqn, 1), dqn.activation, choice)
            }
            Networked::Reinforce(reinforce) => {
                (vec![layers::policy(&reinforce, 1)], reinforce.activation, Choice::Softmax)
            }
            Networked::Ppo(ppo) => {
                let [policy, _] = layers::actor_critic(&ppo, 1);
                (vec![policy], ppo.activation, Choice::Softmax)
            }
        };
        let names = |layers: Vec<layers::Layer>| layers.into_iter().map(|layer| layer.name);
        let stack = |stack: layers::Stack| StackNames {
            hidden: names(stack.hidden).collect(),
            heads: names(stack.heads).collect(),
        };
        let stacks = stacks.into_iter().map(stack).collect();
        Ok(Architecture { activation, stacks, choice })
    }

    /// The network of this agent after training, on the engine that trained it.
    ///
    /// **Errors**: the weights do not fit, or the agent has no architecture.
    pub fn network(
        &self,
        inputs: usize,
        weights: &Weights,
    ) -> Result<Box<dyn ActionNetwork + Send>, WeightsError> {
        let isa = Isa::chosen();
        Ok(match Networked::of(self)? {
            Networked::DuelingDqn(dqn) => match dqn.engine {
                Engine::Fused => Box::new(FusedDuelingNetwork::new(&dqn, inputs, weights, isa)?),
                Engine::Burn => {
                    Box::new(DuelingQNetwork::from_weights(&dqn, inputs, weights, &inference())?)
                }
            },
            Networked::Reinforce(reinforce) => match reinforce.engine {
                Engine::Fused => {
                    Box::new(FusedPolicyNetwork::new(&reinforce, inputs, weights, isa)?)
                }
                Engine::Burn => Box::new(PolicyNetwork::from_weights(
                    &reinforce,
                    inputs,
                    weights,
                    &inference(),
                )?),
            },
            Networked::Ppo(ppo) => match ppo.engine {
                Engine::Fused => Box::new(FusedActorCritic::new(&ppo, inputs, weights, isa)?),
                Engine::Burn => {
                    Box::new(ActorCritic::from_weights(&ppo, inputs, weights, &inference())?)
                }
            },
        })
    }

    /// The actor of this agent after training, in any environment with these observations.
    ///
    /// **Errors**: the weights do not fit, or the agent has no architecture.
    pub fn acting_in<Env: VectorEnvironment>(
        &self,
        observations: &ObservationSpec,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor<Env>>, WeightsError> {
        match Networked::of(self)? {
            Networked::DuelingDqn(dqn) => trained_dueling_dqn(&dqn, observations, weights, actions),
            Networked::Reinforce(reinforce) => {
                trained_reinforce(&reinforce, observations, weights, actions)
            }
            Networked::Ppo(ppo) => trained_ppo(&ppo, observations, weights, actions),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{LinearThompson, Trunk};

    #[test]
    fn layers_are_named_as_their_weights() {
        let weights =
            Weights { numbers: [("epsilon".to_owned(), 0.1)].into(), ..Weights::default() };
        let architecture = |agent: Agent| agent.architecture(&weights).unwrap();
        let dqn = DuelingDqn { layers: vec![4, 4], ..DuelingDqn::default() };
        let shared = architecture(Agent::of(&dqn));
        assert_eq!(shared.stacks[0].hidden, ["trunk.0", "trunk.1"]);
        assert_eq!(shared.stacks[0].heads, ["value", "advantage"]);
        assert_eq!(shared.choice, Choice::EpsilonGreedy { epsilon: 0.1 });
        let separate = architecture(Agent::of(&DuelingDqn { trunk: Trunk::Separate, ..dqn }));
        assert_eq!(separate.stacks[1].hidden, ["advantage_trunk.0", "advantage_trunk.1"]);
        let policy = architecture(Agent::of(&Reinforce::default()));
        assert_eq!(
            (policy.stacks[0].heads[0].as_str(), policy.choice),
            ("logits", Choice::Softmax)
        );
        let actor = architecture(Agent::of(&Ppo { layers: vec![4], ..Ppo::default() }));
        assert_eq!(actor.stacks.len(), 1, "the critic chooses no action");
        assert_eq!(actor.stacks[0].hidden, ["policy_trunk.0"]);
        assert_eq!((actor.stacks[0].heads[0].as_str(), actor.choice), ("logits", Choice::Softmax));
    }

    #[test]
    fn a_memory_is_no_network_of_observations_alone() {
        let recurrent = Recurrent::Gru;
        for agent in [
            Agent::of(&Ppo { recurrent, ..Ppo::default() }),
            Agent::of(&DuelingDqn { recurrent, ..DuelingDqn::default() }),
        ] {
            let refused = agent.architecture(&Weights::default());
            assert!(matches!(refused, Err(WeightsError::HasMemory)));
            let refused = agent.network(3, &Weights::default());
            assert!(matches!(refused, Err(WeightsError::HasMemory)));
        }
        let refused = Agent::of(&LinearThompson::default()).architecture(&Weights::default());
        assert!(matches!(refused, Err(WeightsError::NoNetwork)));
    }

    #[test]
    fn probabilities_are_those_by_hand() {
        let greedy = Choice::EpsilonGreedy { epsilon: 0.2 };
        let drawn = greedy.probabilities(&[1.0, 3.0, 3.0, 0.0]);
        let expected = [0.05, 0.85, 0.05, 0.05];
        assert!(drawn.iter().zip(expected).all(|(p, e)| (p - e).abs() < 1e-12), "{drawn:?}");
        let logits = [1.0f32, 2.0, 3.0, 4.0].map(f32::ln);
        let drawn = Choice::Softmax.probabilities(&logits);
        let expected = [0.1, 0.2, 0.3, 0.4];
        assert!(drawn.iter().zip(expected).all(|(p, e)| (p - e).abs() < 1e-6), "{drawn:?}");
    }
}
