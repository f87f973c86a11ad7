//! The networks, as Burn modules, and the names and shapes of their layers.

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, TensorData, activation};

use crate::agent::weights::{Tensor as WeightTensor, Weights, WeightsError};
use crate::env::Action;
use crate::manifest::{Activation, DuelingDqn, Reinforce, Trunk};
use crate::rng::Stream;

/// Name and size of a linear layer.
struct Layer {
    name: String,
    inputs: usize,
    outputs: usize,
}

/// Hidden layers `<name>.0`, `<name>.1`, … from `width` entries on.
fn hidden(name: &str, width: usize, widths: &[u32]) -> Vec<Layer> {
    let mut inputs = width;
    let layer = |(i, &outputs): (usize, &u32)| {
        let outputs = outputs as usize;
        let layer = Layer { name: format!("{name}.{i}"), inputs, outputs };
        inputs = outputs;
        layer
    };
    widths.iter().enumerate().map(layer).collect()
}

fn head(name: &str, hidden: &[Layer], outputs: usize) -> Layer {
    let inputs = hidden.last().expect("a network has at least one hidden layer").outputs;
    Layer { name: name.to_owned(), inputs, outputs }
}

/// Draws the weights of layers as PyTorch's `Linear` does: weight and bias uniform in
/// ±1/sqrt(inputs), layer by layer, the weight first.
fn draw<'a>(layers: impl Iterator<Item = &'a Layer>, stream: &mut Stream) -> Weights {
    let mut weights = Weights::default();
    for layer in layers {
        let bound = 1.0 / (layer.inputs as f64).sqrt();
        for (kind, shape) in
            [("weight", vec![layer.inputs, layer.outputs]), ("bias", vec![layer.outputs])]
        {
            let count = shape.iter().product();
            let values = (0..count).map(|_| ((2.0 * stream.unit() - 1.0) * bound) as f32).collect();
            weights
                .tensors
                .insert(format!("{}.{kind}", layer.name), WeightTensor { shape, values });
        }
    }
    weights
}

fn linear(layer: &Layer, weights: &Weights, device: &Device) -> Result<Linear, WeightsError> {
    let Layer { name, inputs, outputs } = layer;
    let weight = weights.tensor(&format!("{name}.weight"), &[*inputs, *outputs])?;
    let bias = weights.tensor(&format!("{name}.bias"), &[*outputs])?;
    let data = |t: &WeightTensor| TensorData::new(t.values.clone(), t.shape.clone());
    Ok(Linear {
        weight: Param::from_data(data(weight), device),
        bias: Some(Param::from_data(data(bias), device)),
    })
}

fn store_linear(name: &str, linear: &Linear, weights: &mut Weights) {
    let mut insert = |kind: &str, data: TensorData| {
        let shape = data.shape().as_slice().to_vec();
        let values = data.try_to_vec().expect("parameters are f32");
        weights.tensors.insert(format!("{name}.{kind}"), WeightTensor { shape, values });
    };
    insert("weight", linear.weight.val().into_data());
    if let Some(bias) = &linear.bias {
        insert("bias", bias.val().into_data());
    }
}

/// A stack of hidden layers, each with its activation.
#[derive(Module, Debug)]
struct HiddenLayers {
    layers: Vec<Linear>,
    #[module(skip)]
    activation: Activation,
}

impl HiddenLayers {
    fn from_weights(
        layers: &[Layer],
        activation: Activation,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let layers = layers.iter().map(|layer| linear(layer, weights, device));
        Ok(HiddenLayers { layers: layers.collect::<Result<_, _>>()?, activation })
    }

    /// **Shapes**: \[rows, width\] to \[rows, last layer's width\].
    fn forward(&self, input: Tensor<2>) -> Tensor<2> {
        self.layers.iter().fold(input, |x, layer| {
            let x = layer.forward(x);
            match self.activation {
                Activation::Relu => activation::relu(x),
                Activation::Tanh => activation::tanh(x),
            }
        })
    }

    fn store(&self, name: &str, weights: &mut Weights) {
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
    /// Hidden layers of the state value; of both streams when there is no second stack.
    value_trunk: HiddenLayers,
    /// Hidden layers of the advantages, when the streams are separate.
    advantage_trunk: Option<HiddenLayers>,
    value: Linear,
    advantage: Linear,
}

/// Names and sizes of the dueling network's layers.
struct DuelingLayers {
    /// Stacks of hidden layers: one when shared, that of the value first otherwise.
    trunks: Vec<Vec<Layer>>,
    value: Layer,
    advantage: Layer,
}

impl DuelingLayers {
    fn new(parameters: &DuelingDqn, width: usize) -> Self {
        let names: &[&str] = match parameters.trunk {
            Trunk::Shared => &["trunk"],
            Trunk::Separate => &["value_trunk", "advantage_trunk"],
        };
        let trunks: Vec<_> =
            names.iter().map(|name| hidden(name, width, &parameters.layers)).collect();
        let value = head("value", &trunks[0], 1);
        let advantage = head("advantage", &trunks[0], Action::COUNT);
        DuelingLayers { trunks, value, advantage }
    }

    fn iter(&self) -> impl Iterator<Item = &Layer> {
        self.trunks.iter().flatten().chain([&self.value, &self.advantage])
    }
}

impl DuelingQNetwork {
    /// A network with weights drawn from a stream, for observations of `width` entries.
    pub fn initial(
        parameters: &DuelingDqn,
        width: usize,
        stream: &mut Stream,
        device: &Device,
    ) -> Self {
        let weights = draw(DuelingLayers::new(parameters, width).iter(), stream);
        DuelingQNetwork::from_weights(parameters, width, &weights, device)
            .expect("the weights were drawn for this network")
    }

    /// A network with these weights.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn from_weights(
        parameters: &DuelingDqn,
        width: usize,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let layers = DuelingLayers::new(parameters, width);
        let mut trunks = layers
            .trunks
            .iter()
            .map(|trunk| HiddenLayers::from_weights(trunk, parameters.activation, weights, device));
        let value_trunk = trunks.next().expect("there is at least one stack")?;
        Ok(DuelingQNetwork {
            value_trunk,
            advantage_trunk: trunks.next().transpose()?,
            value: linear(&layers.value, weights, device)?,
            advantage: linear(&layers.advantage, weights, device)?,
        })
    }

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
        let advantage = self.advantage.forward(for_advantage);
        self.value.forward(for_value) + advantage.clone() - advantage.mean_dim(1)
    }

    /// The weights, by name.
    pub fn weights(&self) -> Weights {
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
    /// A network with weights drawn from a stream, for observations of `width` entries.
    pub fn initial(
        parameters: &Reinforce,
        width: usize,
        stream: &mut Stream,
        device: &Device,
    ) -> Self {
        let trunk = hidden("trunk", width, &parameters.layers);
        let logits = head("logits", &trunk, Action::COUNT);
        let weights = draw(trunk.iter().chain([&logits]), stream);
        PolicyNetwork::from_weights(parameters, width, &weights, device)
            .expect("the weights were drawn for this network")
    }

    /// A network with these weights.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn from_weights(
        parameters: &Reinforce,
        width: usize,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let trunk = hidden("trunk", width, &parameters.layers);
        let logits = linear(&head("logits", &trunk, Action::COUNT), weights, device)?;
        let trunk = HiddenLayers::from_weights(&trunk, parameters.activation, weights, device)?;
        Ok(PolicyNetwork { trunk, logits })
    }

    /// Logits of observations.
    ///
    /// **Shapes**: \[rows, width\] to \[rows, actions\].
    pub fn forward(&self, observations: Tensor<2>) -> Tensor<2> {
        self.logits.forward(self.trunk.forward(observations))
    }

    /// The weights, by name.
    pub fn weights(&self) -> Weights {
        let mut weights = Weights::default();
        self.trunk.store("trunk", &mut weights);
        store_linear("logits", &self.logits, &mut weights);
        weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::device;
    use crate::rng::Purpose;

    fn stream() -> Stream {
        Stream::new(4, Purpose::InitialWeights)
    }

    #[test]
    fn initial_weights_are_uniform_as_in_pytorch() {
        let parameters = Reinforce { layers: vec![400], ..Reinforce::default() };
        let weights =
            PolicyNetwork::initial(&parameters, 16, &mut stream(), &device::inference()).weights();
        for (name, bound) in
            [("trunk.0.weight", 0.25), ("trunk.0.bias", 0.25), ("logits.weight", 0.05)]
        {
            let values = &weights.tensors[name].values;
            let n = values.len() as f32;
            assert!(values.iter().all(|v| v.abs() <= bound));
            // A uniform distribution on ±b has mean 0 and variance b^2 / 3.
            let mean = values.iter().sum::<f32>() / n;
            let variance = values.iter().map(|v| v * v).sum::<f32>() / n;
            assert!(mean.abs() < 4.0 * bound / (3.0 * n).sqrt(), "{name}: {mean}");
            assert!((variance / (bound * bound / 3.0) - 1.0).abs() < 0.2, "{name}: {variance}");
        }
    }

    #[test]
    fn networks_read_their_weights_back() {
        for trunk in [Trunk::Shared, Trunk::Separate] {
            let parameters = DuelingDqn { trunk, layers: vec![5, 3], ..DuelingDqn::default() };
            let device = device::inference();
            let first = DuelingQNetwork::initial(&parameters, 3, &mut stream(), &device);
            let weights = first.weights();
            let second = DuelingQNetwork::from_weights(&parameters, 3, &weights, &device).unwrap();
            assert_eq!(second.weights(), weights);
            assert!(DuelingQNetwork::from_weights(&parameters, 4, &weights, &device).is_err());
        }
    }

    #[test]
    fn advantages_are_centred_by_hand() {
        // One hidden unit that passes x on, V = 2x, A = (1, 2, 3, 4)x: Q = 2x + A - 2.5x.
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
        let network = DuelingQNetwork::from_weights(&parameters, 1, &weights, &device).unwrap();
        let q = network.forward(Tensor::from_floats([[2.0], [-1.0]], &device)).into_data();
        assert_eq!(q.try_to_vec::<f32>().unwrap(), [1.0, 3.0, 5.0, 7.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
