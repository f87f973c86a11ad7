//! The network of a trained agent, its structure for programs that compute it elsewhere, and how its
//! outputs become actions.

use crate::agent::actor::Actor;
use crate::agent::learner::Actions;
use crate::agent::network::Activation;
use crate::agent::policy::{
    ActionNetwork, EpsilonGreedy, SoftmaxPolicy, best, epsilon_greedy_probabilities, exponentials,
};
use crate::env::{Action, Observations, VectorEnvironment};
use crate::kernel::Isa;

/// A trained network, and how its outputs become actions.
pub struct NetworkPolicy {
    /// The network.
    pub network: Box<dyn ActionNetwork + Send>,
    /// The choice of actions from its outputs.
    pub choice: Choice,
    /// Its layers; `None` for a network with a memory or of another structure, which cannot be
    /// exported.
    pub architecture: Option<Architecture>,
}

impl NetworkPolicy {
    /// The policy in any environment with observations of this shape, which the network was made
    /// for.
    pub fn actor<Env: VectorEnvironment>(
        self,
        observations: Observations,
        actions: Actions,
    ) -> Box<dyn Actor<Env>> {
        match (self.choice, actions) {
            (Choice::EpsilonGreedy { epsilon }, Actions::AsTrained) => {
                Box::new(EpsilonGreedy::new(self.network, epsilon, observations))
            }
            (Choice::EpsilonGreedy { .. }, Actions::Greedy) => {
                Box::new(EpsilonGreedy::new(self.network, 0.0, observations))
            }
            (Choice::Softmax, _) => {
                Box::new(SoftmaxPolicy::new(self.network, actions, observations))
            }
        }
    }
}

/// The layers of a network: stacks of hidden layers on the observation, each with linear heads.
#[derive(Clone, Debug, PartialEq)]
pub struct Architecture {
    /// The activation after every hidden layer.
    pub activation: Activation,
    /// The stacks; each takes the whole observation as input.
    pub stacks: Vec<StackNames>,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::registry::AlgorithmParameters;
    use crate::agent::{
        Agent, DuelingDqn, LinearThompson, Ppo, Recurrent, Reinforce, Start, StartError, Task,
        Trunk, Weights, WeightsError, layers, orthogonal,
    };

    /// The policy of an agent with the initial weights of these layers.
    fn policy(agent: &Agent, layers: &[layers::Layer]) -> NetworkPolicy {
        let mut weights = orthogonal::initial(layers, 1, 1).unwrap();
        weights.numbers.insert("epsilon".to_owned(), 0.1);
        agent.network(1, &weights).unwrap()
    }

    #[test]
    fn layers_are_named_as_their_weights() {
        let of_dqn = |dqn: DuelingDqn| policy(&Agent::of(&dqn), &layers::dueling_layers(&dqn, 1));
        let dqn = DuelingDqn { layers: vec![4, 4], ..DuelingDqn::default() };
        let shared = of_dqn(dqn.clone());
        assert_eq!(shared.choice, Choice::EpsilonGreedy { epsilon: 0.1 });
        let stacks = shared.architecture.unwrap().stacks;
        assert_eq!(stacks[0].hidden, ["trunk.0", "trunk.1"]);
        assert_eq!(stacks[0].heads, ["value", "advantage"]);
        let separate = of_dqn(DuelingDqn { trunk: Trunk::Separate, ..dqn });
        let stacks = separate.architecture.unwrap().stacks;
        assert_eq!(stacks[1].hidden, ["advantage_trunk.0", "advantage_trunk.1"]);
        let ppo = Ppo { layers: vec![4], ..Ppo::default() };
        let actor = policy(&Agent::of(&ppo), &layers::ppo(&ppo, 1));
        assert_eq!(actor.choice, Choice::Softmax);
        let stacks = actor.architecture.unwrap().stacks;
        assert_eq!(stacks.len(), 1, "the critic chooses no action");
        assert_eq!(
            (stacks[0].hidden[0].as_str(), stacks[0].heads[0].as_str()),
            ("policy_trunk.0", "logits")
        );
    }

    #[test]
    fn a_memory_is_no_network_of_observations_alone() {
        let recurrent = Recurrent::Gru;
        let ppo = Ppo { recurrent, ..Ppo::default() };
        let dqn = DuelingDqn { recurrent, ..DuelingDqn::default() };
        for policy in [
            policy(&Agent::of(&ppo), &layers::ppo(&ppo, 1)),
            policy(&Agent::of(&dqn), &layers::dueling_layers(&dqn, 1)),
        ] {
            assert_eq!((policy.network.memory(), policy.architecture), (64, None));
        }
        let refused = Agent::of(&LinearThompson::default()).network(1, &Weights::default());
        assert!(matches!(refused, Err(WeightsError::NoNetwork)));
    }

    crate::key::keys! {
        /// An algorithm of a user that trains the network of REINFORCE in its own way.
        pub struct Own {
            /// episodes of training
            episodes: u32 = 10, in crate::key::Kind::EPISODES;
        }
    }

    impl AlgorithmParameters for Own {
        const NAME: &'static str = "own";

        fn episodes(&self) -> u32 {
            self.episodes
        }

        fn start(&self, task: &Task) -> Result<Start, StartError> {
            Reinforce::default().start(task)
        }

        fn network(&self, inputs: usize, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
            Reinforce::default().network(inputs, weights)
        }
    }

    #[test]
    fn an_algorithm_of_a_user_has_a_network_without_being_registered() {
        let stack = layers::policy(&Reinforce::default(), 1);
        let layers: Vec<layers::Layer> = stack.hidden.into_iter().chain(stack.heads).collect();
        let agent = Agent::of(&Own { episodes: 10 });
        assert_eq!(policy(&agent, &layers).architecture.unwrap().stacks[0].heads, ["logits"]);
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
