//! The network of a trained agent, and its structure for programs that compute it elsewhere.

use crate::agent::actor::Actor;
use crate::agent::learner::Actions;
use crate::agent::network::Activation;
use crate::agent::policy::{ActionNetwork, Choice, NetworkActor};
use crate::agent::weights::Weights;
use crate::env::{Observations, VectorEnvironment};

/// A trained network, and how its outputs become actions.
pub struct NetworkPolicy {
    /// The network.
    pub network: Box<dyn ActionNetwork + Send>,
    /// The choice of actions from its outputs.
    pub choice: Choice,
    /// Its layers; `None` for a network of another structure, which cannot be exported.
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
        Box::new(NetworkActor::new(self.network, self.choice, actions, observations))
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

impl Architecture {
    /// Whether these weights have an array of weights and biases for every layer.
    pub fn fits(&self, weights: &Weights) -> bool {
        let names = self.stacks.iter().flat_map(|stack| {
            let gru = stack.gru.iter().flat_map(|gru| [&gru.input, &gru.state]);
            stack.hidden.iter().chain(gru).chain(&stack.heads)
        });
        let mut arrays = names.flat_map(|name| [format!("{name}.weight"), format!("{name}.bias")]);
        arrays.all(|array| weights.tensors.contains_key(&array))
    }
}

/// The layers of a stack by the names of their weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StackNames {
    /// Hidden layers, input side first.
    pub hidden: Vec<String>,
    /// Linear layers on the last hidden layer.
    pub heads: Vec<String>,
    /// The GRU between the hidden layers, if there is one.
    pub gru: Option<GruNames>,
}

/// A gated recurrent unit. The layers have the outputs of the gates side by side: reset r, update z and new n.
/// With a of the input and b of the state h, r = σ(a + b), z = σ(a + b), n = tanh(a + r b), and the next state is
/// n + z (h - n).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GruNames {
    /// Number of hidden layers in front of it.
    pub before: usize,
    /// The linear layer on its input.
    pub input: String,
    /// The linear layer on its state.
    pub state: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::registry::AlgorithmParameters;
    use crate::agent::{
        Agent, DuelingDqn, LinearThompson, Ppo, Recurrent, Reinforce, Shape, Start, StartError,
        Task, Trunk, WeightsError, layers, orthogonal,
    };

    /// The policy of an agent with the initial weights of these layers.
    fn policy(agent: &Agent, layers: &[layers::Layer]) -> NetworkPolicy {
        let mut weights = orthogonal::initial(layers, 1, 1).unwrap();
        weights.numbers.insert("epsilon".to_owned(), 0.1);
        agent.network(Shape::of_four(1), &weights).unwrap()
    }

    #[test]
    fn layers_are_named_as_their_weights() {
        let of_dqn = |dqn: DuelingDqn| {
            policy(&Agent::of(&dqn), &layers::dueling_layers(&dqn, Shape::of_four(1)))
        };
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
        let actor = policy(&Agent::of(&ppo), &layers::ppo(&ppo, Shape::of_four(1)));
        assert_eq!(actor.choice, Choice::Softmax);
        let stacks = actor.architecture.unwrap().stacks;
        assert_eq!(stacks.len(), 1, "the critic chooses no action");
        assert_eq!(
            (stacks[0].hidden[0].as_str(), stacks[0].heads[0].as_str()),
            ("policy_trunk.0", "logits")
        );
    }

    #[test]
    fn a_memory_stands_between_hidden_layers() {
        let recurrent = Recurrent::Gru;
        let ppo = Ppo { recurrent, ..Ppo::default() };
        let dqn = DuelingDqn { recurrent, ..DuelingDqn::default() };
        for policy in [
            policy(&Agent::of(&ppo), &layers::ppo(&ppo, Shape::of_four(1))),
            policy(&Agent::of(&dqn), &layers::dueling_layers(&dqn, Shape::of_four(1))),
        ] {
            assert_eq!(policy.network.memory(), 64);
            let [stack] = &policy.architecture.unwrap().stacks[..] else { panic!("one stack") };
            assert_eq!(stack.hidden, ["trunk.0", "trunk_after.0"]);
            assert_eq!(
                stack.gru.as_ref().map(|gru| (gru.before, gru.input.as_str())),
                Some((1, "gru_input"))
            );
        }
        let refused =
            Agent::of(&LinearThompson::default()).network(Shape::of_four(1), &Weights::default());
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

        fn network(&self, shape: Shape, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
            Reinforce::default().network(shape, weights)
        }
    }

    #[test]
    fn an_algorithm_of_a_user_has_a_network_without_being_registered() {
        let stack = layers::policy(&Reinforce::default(), Shape::of_four(1));
        let layers: Vec<layers::Layer> = stack.hidden.into_iter().chain(stack.heads).collect();
        let agent = Agent::of(&Own { episodes: 10 });
        let architecture = policy(&agent, &layers).architecture.unwrap();
        assert_eq!(architecture.stacks[0].heads, ["logits"]);
        assert!(architecture.fits(&orthogonal::initial(&layers, 1, 1).unwrap()));
        assert!(!architecture.fits(&Weights::default()));
    }
}
