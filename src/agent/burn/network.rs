//! The networks without memory, as Burn modules.

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use crate::agent::burn::activation;
use crate::agent::layers::{self, Layer, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::weights::{Tensor as WeightTensor, Weights, WeightsError};
use crate::agent::{Activation, DuelingDqn, Ppo, Reinforce};

/// A module that an algorithm trains.
pub trait BurnNetwork: Module + ActionNetwork + Send + 'static {
    /// The hyper-parameters of the algorithm.
    type Parameters;

    /// A network with these weights, of this shape.
    ///
    /// **Errors**: an array is missing or of another shape.
    fn from_weights(
        parameters: &Self::Parameters,
        shape: Shape,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError>;

    /// The weights, by name.
    fn weights(&self) -> Weights;
}

pub(super) fn linear(
    layer: &Layer,
    weights: &Weights,
    device: &Device,
) -> Result<Linear, WeightsError> {
    let weight = weights.tensor(&layer.weight(), &[layer.inputs, layer.outputs])?;
    let bias = weights.tensor(&layer.bias(), &[layer.outputs])?;
    Ok(Linear {
        weight: Param::from_tensor(weight.to_burn(device)),
        bias: Some(Param::from_tensor(bias.to_burn(device))),
    })
}

/// A linear layer for inputs with a fixed number of rows.
///
/// The bias is repeated for every row, by a product with ones. Adding one row to a matrix, with its
/// gradient, takes longer than the product with the weights.
pub(super) struct Affine {
    weight: Tensor<2>,
    bias: Tensor<2>,
}

impl Affine {
    pub(super) fn new(layer: &Linear, rows: usize) -> Self {
        let weight = layer.weight.val();
        let ones = Tensor::ones([rows, 1], &weight.device());
        let bias = layer.bias.as_ref().expect("every layer has a bias").val();
        Affine { weight, bias: ones.matmul(bias.unsqueeze()) }
    }

    /// **Shapes**: \[rows, inputs\] to \[rows, outputs\].
    pub(super) fn forward(&self, input: Tensor<2>) -> Tensor<2> {
        input.matmul(self.weight.clone()) + self.bias.clone()
    }
}

/// The output of a linear layer; shapes as in [`Affine::forward`].
pub(super) fn affine(layer: &Linear, input: Tensor<2>) -> Tensor<2> {
    Affine::new(layer, input.dims()[0]).forward(input)
}

pub(super) fn store_linear(name: &str, linear: &Linear, weights: &mut Weights) {
    let mut insert = |kind: &str, tensor: WeightTensor| {
        weights.tensors.insert(format!("{name}.{kind}"), tensor);
    };
    insert("weight", WeightTensor::of_burn(linear.weight.val()));
    if let Some(bias) = &linear.bias {
        insert("bias", WeightTensor::of_burn(bias.val()));
    }
}

/// A stack of hidden layers, each with its activation.
#[derive(Module, Debug)]
pub(super) struct HiddenLayers {
    layers: Vec<Linear>,
    #[module(skip)]
    activation: Activation,
}

impl HiddenLayers {
    pub(super) fn from_weights(
        layers: &[Layer],
        activation: Activation,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let layers = layers.iter().map(|layer| linear(layer, weights, device));
        Ok(HiddenLayers { layers: layers.collect::<Result<_, _>>()?, activation })
    }

    /// **Shapes**: \[rows, width\] to \[rows, last layer's width\].
    pub(super) fn forward(&self, input: Tensor<2>) -> Tensor<2> {
        self.layers
            .iter()
            .fold(input, |x, layer| activation::apply(self.activation, affine(layer, x)))
    }

    pub(super) fn store(&self, name: &str, weights: &mut Weights) {
        for (i, layer) in self.layers.iter().enumerate() {
            store_linear(&format!("{name}.{i}"), layer, weights);
        }
    }
}

/// Action values Q = V + A - mean A.
///
/// **Source**: Wang et al., "Dueling network architectures for deep reinforcement learning", 2016,
/// equation 9.
#[derive(Module, Debug)]
pub struct DuelingQNetwork {
    /// Hidden layers of the state value, and also of the advantages unless `advantage_trunk` is
    /// set.
    value_trunk: HiddenLayers,
    /// Hidden layers of the advantages if the streams are separate.
    advantage_trunk: Option<HiddenLayers>,
    value: Linear,
    advantage: Linear,
}

impl DuelingQNetwork {
    /// Action values of observations.
    ///
    /// **Shapes**: \[rows, width\] to \[rows, actions\].
    pub fn forward(&self, observations: Tensor<2>) -> Tensor<2> {
        let (for_value, for_advantage) = match &self.advantage_trunk {
            Some(trunk) => {
                (self.value_trunk.forward(observations.clone()), trunk.forward(observations))
            }
            None => {
                let shared = self.value_trunk.forward(observations);
                (shared.clone(), shared)
            }
        };
        let advantage = affine(&self.advantage, for_advantage);
        affine(&self.value, for_value) + advantage.clone() - advantage.mean_dim(1)
    }
}

impl BurnNetwork for DuelingQNetwork {
    type Parameters = DuelingDqn;

    fn from_weights(
        parameters: &Self::Parameters,
        shape: Shape,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let stacks = layers::dueling(parameters, shape);
        let mut trunks = stacks.iter().map(|stack| {
            HiddenLayers::from_weights(&stack.hidden, parameters.activation, weights, device)
        });
        let mut heads =
            stacks.iter().flat_map(|stack| &stack.heads).map(|head| linear(head, weights, device));
        Ok(DuelingQNetwork {
            value_trunk: trunks.next().expect("there is a stack")?,
            advantage_trunk: trunks.next().transpose()?,
            value: heads.next().expect("the value's head is the first")?,
            advantage: heads.next().expect("that of the advantages is the second")?,
        })
    }

    fn weights(&self) -> Weights {
        let mut weights = Weights::default();
        match &self.advantage_trunk {
            Some(trunk) => {
                self.value_trunk.store("value_trunk", &mut weights);
                trunk.store("advantage_trunk", &mut weights);
            }
            None => self.value_trunk.store("trunk", &mut weights),
        }
        store_linear("value", &self.value, &mut weights);
        store_linear("advantage", &self.advantage, &mut weights);
        weights
    }
}

/// Logits of a policy over the actions.
#[derive(Module, Debug)]
pub struct PolicyNetwork {
    trunk: HiddenLayers,
    logits: Linear,
}

impl PolicyNetwork {
    /// Logits of observations.
    ///
    /// **Shapes**: \[rows, width\] to \[rows, actions\].
    pub fn forward(&self, observations: Tensor<2>) -> Tensor<2> {
        affine(&self.logits, self.trunk.forward(observations))
    }
}

impl BurnNetwork for PolicyNetwork {
    type Parameters = Reinforce;

    fn from_weights(
        parameters: &Self::Parameters,
        shape: Shape,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let stack = layers::policy(parameters, shape);
        let trunk =
            HiddenLayers::from_weights(&stack.hidden, parameters.activation, weights, device)?;
        Ok(PolicyNetwork { trunk, logits: linear(&stack.heads[0], weights, device)? })
    }

    fn weights(&self) -> Weights {
        let mut weights = Weights::default();
        self.trunk.store("trunk", &mut weights);
        store_linear("logits", &self.logits, &mut weights);
        weights
    }
}

/// A policy and a state value with separate layers.
#[derive(Module, Debug)]
pub struct ActorCritic {
    policy_trunk: HiddenLayers,
    logits: Linear,
    value_trunk: HiddenLayers,
    value: Linear,
}

impl ActorCritic {
    /// Logits and values of observations.
    ///
    /// **Shapes**: \[rows, width\] to \[rows, actions\] and \[rows, 1\].
    pub fn forward(&self, observations: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
        let values = affine(&self.value, self.value_trunk.forward(observations.clone()));
        (self.logits(observations), values)
    }

    /// Logits of observations.
    ///
    /// **Shapes**: \[rows, width\] to \[rows, actions\].
    pub fn logits(&self, observations: Tensor<2>) -> Tensor<2> {
        affine(&self.logits, self.policy_trunk.forward(observations))
    }
}

impl BurnNetwork for ActorCritic {
    type Parameters = Ppo;

    fn from_weights(
        parameters: &Self::Parameters,
        shape: Shape,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let [policy, value] = layers::actor_critic(parameters, shape);
        let trunk = |stack: &layers::Stack| {
            HiddenLayers::from_weights(&stack.hidden, parameters.activation, weights, device)
        };
        Ok(ActorCritic {
            policy_trunk: trunk(&policy)?,
            logits: linear(&policy.heads[0], weights, device)?,
            value_trunk: trunk(&value)?,
            value: linear(&value.heads[0], weights, device)?,
        })
    }

    fn weights(&self) -> Weights {
        let mut weights = Weights::default();
        self.policy_trunk.store("policy_trunk", &mut weights);
        self.value_trunk.store("value_trunk", &mut weights);
        store_linear("logits", &self.logits, &mut weights);
        store_linear("value", &self.value, &mut weights);
        weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Trunk;
    use crate::agent::burn::device;
    use crate::rng::{Purpose, Stream};

    #[test]
    fn networks_read_their_weights_back() {
        for trunk in [Trunk::Shared, Trunk::Separate] {
            let parameters = DuelingDqn { trunk, layers: vec![5, 3], ..DuelingDqn::default() };
            let device = device::inference();
            let mut stream = Stream::new(4, Purpose::InitialWeights);
            let weights =
                layers::draw(&layers::dueling(&parameters, Shape::of_four(3)), &mut stream);
            let network =
                DuelingQNetwork::from_weights(&parameters, Shape::of_four(3), &weights, &device)
                    .unwrap();
            assert_eq!(network.weights(), weights);
            assert!(
                DuelingQNetwork::from_weights(&parameters, Shape::of_four(4), &weights, &device)
                    .is_err()
            );
        }
    }

    #[test]
    fn advantages_are_centred_by_hand() {
        // One hidden unit that passes x through, V = 2x, A = (1, 2, 3, 4)x: Q = 2x + A - 2.5x.
        let parameters = DuelingDqn { layers: vec![1], ..DuelingDqn::default() };
        let array = |shape: &[usize], values: &[f32]| WeightTensor {
            shape: shape.to_vec(),
            values: values.to_vec(),
        };
        let mut weights = Weights::default();
        for (name, tensor) in [
            ("trunk.0.weight", array(&[1, 1], &[1.0])),
            ("trunk.0.bias", array(&[1], &[0.0])),
            ("value.weight", array(&[1, 1], &[2.0])),
            ("value.bias", array(&[1], &[0.0])),
            ("advantage.weight", array(&[1, 4], &[1.0, 2.0, 3.0, 4.0])),
            ("advantage.bias", array(&[4], &[0.0; 4])),
        ] {
            weights.tensors.insert(name.to_owned(), tensor);
        }
        let device = device::inference();
        let network =
            DuelingQNetwork::from_weights(&parameters, Shape::of_four(1), &weights, &device)
                .unwrap();
        let q = network.forward(Tensor::from_floats([[2.0], [-1.0]], &device)).into_data();
        assert_eq!(q.try_to_vec::<f32>().unwrap(), [1.0, 3.0, 5.0, 7.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
