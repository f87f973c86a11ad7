//! Names, sizes and initial weights of the networks' layers, independent of the engine.

use crate::agent::architecture::{Architecture, GruNames, StackNames};
use crate::agent::constraint::{batch_size, network_size};
use crate::agent::memory::{self, OutOfMemory};
use crate::agent::weights::{Tensor, Weights};
use crate::agent::{Activation, DuelingDqn, Ppo, Recurrent as Memory, Reinforce, Trunk};
use crate::env::Interface;
use crate::kernel::GATES;
use crate::key::Size;
use crate::rng::{Purpose, Stream};

/// The sizes between which a network lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Entries of an observation.
    pub inputs: usize,
    /// Number of actions.
    pub actions: usize,
}

impl From<&Interface> for Shape {
    fn from(interface: &Interface) -> Self {
        Shape { inputs: interface.observations.inputs(), actions: interface.actions }
    }
}

#[cfg(test)]
impl Shape {
    /// The sizes for observations of this many entries, and four actions.
    pub(super) fn of_four(inputs: usize) -> Self {
        Shape { inputs, actions: 4 }
    }
}

/// Name and size of a linear layer.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub(super) name: String,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
}

impl Layer {
    pub(super) fn weight(&self) -> String {
        format!("{}.weight", self.name)
    }

    pub(super) fn bias(&self) -> String {
        format!("{}.bias", self.name)
    }

    /// Number of values that an update holds per row of input: the outputs, and for a GRU the
    /// contributions of input and state to three gates, the derivatives by them, the gates
    /// themselves, and the states before and after the step.
    fn row_numbers(&self) -> usize {
        match self.name.as_str() {
            GRU_HIDDEN => 8 * (self.outputs / GATES),
            _ => self.outputs,
        }
    }
}

/// Hidden layers, input side first, and linear heads on the last hidden layer.
#[derive(Clone, Debug)]
pub(super) struct Stack {
    pub(super) hidden: Vec<Layer>,
    pub(super) heads: Vec<Layer>,
}

impl Stack {
    pub(super) fn new(name: &str, inputs: usize, widths: &[u32], heads: &[(&str, usize)]) -> Self {
        let mut width = inputs;
        let mut layer = |name: String, outputs: usize| {
            let inputs = std::mem::replace(&mut width, outputs);
            Layer { name, inputs, outputs }
        };
        let hidden: Vec<Layer> = widths
            .iter()
            .enumerate()
            .map(|(i, &outputs)| layer(format!("{name}.{i}"), outputs as usize))
            .collect();
        let head = |&(name, outputs): &(&str, usize)| Layer {
            name: name.to_owned(),
            inputs: width,
            outputs,
        };
        Stack { hidden, heads: heads.iter().map(head).collect() }
    }
}

/// The stacks of a dueling network: one stack with both heads, or one stack per head, the value's
/// first.
pub(super) fn dueling(parameters: &DuelingDqn, shape: Shape) -> Vec<Stack> {
    let (value, advantage) = (("value", 1), ("advantage", shape.actions));
    let stack = |name, heads: &[_]| Stack::new(name, shape.inputs, &parameters.layers, heads);
    match parameters.trunk {
        Trunk::Shared => vec![stack("trunk", &[value, advantage])],
        Trunk::Separate => {
            vec![stack("value_trunk", &[value]), stack("advantage_trunk", &[advantage])]
        }
    }
}

/// The stack of a policy network.
pub(super) fn policy(parameters: &Reinforce, shape: Shape) -> Stack {
    Stack::new("trunk", shape.inputs, &parameters.layers, &[("logits", shape.actions)])
}

/// The stacks of actor and critic, which share no layers; the actor's first.
pub(super) fn actor_critic(parameters: &Ppo, shape: Shape) -> [Stack; 2] {
    let stack = |name, head| Stack::new(name, shape.inputs, &parameters.layers, &[head]);
    [stack("policy_trunk", ("logits", shape.actions)), stack("value_trunk", ("value", 1))]
}

/// The name of the linear layer of a GRU on its state.
const GRU_HIDDEN: &str = "gru_hidden";

/// Hidden layers around a GRU, and two linear heads that share all of them.
#[derive(Clone, Debug)]
pub(super) struct Recurrent {
    /// Hidden layers in front of the GRU, input side first; at least one.
    pub(super) before: Vec<Layer>,
    /// The linear layers of the GRU's gates on the input and on the state. Each has the outputs of
    /// the reset gate, the update gate and the candidate state side by side.
    pub(super) gru: [Layer; 2],
    /// Hidden layers behind the GRU.
    pub(super) after: Vec<Layer>,
    /// One output per action, and one for the state value.
    pub(super) heads: [Layer; 2],
}

/// Widths of hidden layers, the number of them in front of the GRU, and the units of the GRU.
struct Around<'p>(&'p [u32], u32, u32);

impl Recurrent {
    /// The layers of an actor-critic with a GRU.
    pub(super) fn actor_critic(parameters: &Ppo, shape: Shape) -> Self {
        let Ppo { layers, layers_before_gru, units, .. } = parameters;
        Recurrent::new(Around(layers, *layers_before_gru, *units), shape, "logits")
    }

    /// The layers of a dueling network with a GRU.
    pub(super) fn dueling(parameters: &DuelingDqn, shape: Shape) -> Self {
        let DuelingDqn { layers, layers_before_gru, units, .. } = parameters;
        Recurrent::new(Around(layers, *layers_before_gru, *units), shape, "advantage")
    }

    fn new(Around(layers, before, units): Around<'_>, shape: Shape, of_actions: &str) -> Self {
        let (before, after) = layers.split_at(layers.len().min(before as usize));
        let units = units as usize;
        let before = Stack::new("trunk", shape.inputs, before, &[]).hidden;
        let last = before.last().map_or(shape.inputs, |layer| layer.outputs);
        let heads = [(of_actions, shape.actions), ("value", 1)];
        let after = Stack::new("trunk_after", units, after, &heads);
        let gate =
            |name: &str, inputs| Layer { name: name.to_owned(), inputs, outputs: GATES * units };
        Recurrent {
            before,
            gru: [gate("gru_input", last), gate(GRU_HIDDEN, units)],
            after: after.hidden,
            heads: after.heads.try_into().expect("two heads were given"),
        }
    }

    /// All layers, input side first.
    pub(super) fn layers(&self) -> impl Iterator<Item = &Layer> {
        self.before.iter().chain(&self.gru).chain(&self.after).chain(&self.heads)
    }
}

/// All layers of PPO's networks, in the order in which their weights are drawn.
pub(super) fn ppo(parameters: &Ppo, shape: Shape) -> Vec<Layer> {
    match parameters.recurrent {
        Memory::None => listed(&actor_critic(parameters, shape)),
        Memory::Gru => Recurrent::actor_critic(parameters, shape).layers().cloned().collect(),
    }
}

/// All layers of a dueling network, in the order in which their weights are drawn.
pub(super) fn dueling_layers(parameters: &DuelingDqn, shape: Shape) -> Vec<Layer> {
    match parameters.recurrent {
        Memory::None => listed(&dueling(parameters, shape)),
        Memory::Gru => Recurrent::dueling(parameters, shape).layers().cloned().collect(),
    }
}

/// Number of weights and biases of layers.
pub(super) fn numbers<'l>(layers: impl IntoIterator<Item = &'l Layer>) -> usize {
    layers.into_iter().map(|layer| (layer.inputs + 1) * layer.outputs).sum()
}

/// Number of weights and biases of the layers of stacks.
pub(super) fn weights(stacks: &[Stack]) -> usize {
    numbers(&listed(stacks))
}

/// The layers of stacks in the order in which their weights are drawn.
pub(super) fn listed(stacks: &[Stack]) -> Vec<Layer> {
    let hidden = stacks.iter().flat_map(|stack| &stack.hidden);
    hidden.chain(stacks.iter().flat_map(|stack| &stack.heads)).cloned().collect()
}

/// The sizes of networks of these layers, and of a batch of `rows` rows.
pub(super) fn sizes(layers: &[Layer], rows: u64) -> [Size; 2] {
    // Stacks without a layer between them and the observation share it.
    let inputs = layers.first().map_or(0, |layer| layer.inputs);
    let each = layers.iter().fold(inputs, |sum, layer| sum + layer.row_numbers());
    [network_size(numbers(layers) as u64), batch_size(rows, each as u64)]
}

/// The names of stacks' layers.
pub(super) fn architecture(
    activation: Activation,
    stacks: impl IntoIterator<Item = Stack>,
) -> Architecture {
    let names = |layers: Vec<Layer>| layers.into_iter().map(|layer| layer.name).collect();
    let named = |stack: Stack| StackNames {
        hidden: names(stack.hidden),
        heads: names(stack.heads),
        gru: None,
    };
    Architecture { activation, stacks: stacks.into_iter().map(named).collect() }
}

/// The names of the layers around a GRU, with these heads.
pub(super) fn recurrent_architecture(
    activation: Activation,
    layers: Recurrent,
    heads: &[&str],
) -> Architecture {
    let Recurrent { before, gru: [input, state], after, .. } = layers;
    let gru = GruNames { before: before.len(), input: input.name, state: state.name };
    let hidden = before.into_iter().chain(after).map(|layer| layer.name).collect();
    let heads = heads.iter().map(|head| (*head).to_owned()).collect();
    Architecture { activation, stacks: vec![StackNames { hidden, heads, gru: Some(gru) }] }
}

/// Why engines accept the weights from [`initial`].
pub(super) const DRAWN: &str = "the weights were drawn for this network";

/// The initial weights, drawn from the seed's own stream.
///
/// **Errors**: there is not enough memory for `copies` copies of the network's weights.
pub(super) fn initial(stacks: &[Stack], copies: usize, seed: u64) -> Result<Weights, OutOfMemory> {
    memory::require(copies * size_of::<f32>() * weights(stacks), "the network")?;
    Ok(draw(stacks, &mut Stream::new(seed, Purpose::InitialWeights)))
}

/// Draws the weights of stacks as PyTorch's `Linear` does: weight and bias uniform in
/// ±1/sqrt(inputs), layer by layer, the hidden layers of every stack before the heads, the weight
/// of a layer before its bias.
pub(super) fn draw(stacks: &[Stack], stream: &mut Stream) -> Weights {
    let mut weights = Weights::default();
    for layer in listed(stacks) {
        for (name, shape) in [
            (layer.weight(), vec![layer.inputs, layer.outputs]),
            (layer.bias(), vec![layer.outputs]),
        ] {
            weights.tensors.insert(name, uniform(shape, layer.inputs, stream));
        }
    }
    weights
}

/// Initial matrices: uniform in ±1/sqrt(rows), drawn one after the other from the seed's own stream.
#[cfg(feature = "burn")]
pub(super) fn draw_matrices(shapes: &[[usize; 2]], seed: u64) -> Vec<Tensor> {
    let mut stream = Stream::new(seed, Purpose::InitialWeights);
    shapes.iter().map(|shape| uniform(shape.to_vec(), shape[0], &mut stream)).collect()
}

/// Draws an array uniformly in ±1/sqrt(inputs).
fn uniform(shape: Vec<usize>, inputs: usize, stream: &mut Stream) -> Tensor {
    let bound = 1.0 / (inputs as f64).sqrt();
    let count = shape.iter().product();
    let values = (0..count).map(|_| ((2.0 * stream.unit() - 1.0) * bound) as f32).collect();
    Tensor { shape, values }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_weights_are_uniform_as_in_pytorch() {
        let parameters = Reinforce { layers: vec![400], ..Reinforce::default() };
        let mut stream = Stream::new(4, Purpose::InitialWeights);
        let weights = draw(&[policy(&parameters, Shape::of_four(16))], &mut stream);
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
    fn sizes_are_counted_by_hand() {
        let dqn = DuelingDqn { layers: vec![128, 64], ..DuelingDqn::default() };
        let parameters = |dqn: &DuelingDqn| {
            sizes(&dueling_layers(dqn, Shape::of_four(56)), 2).map(|size| size.size)
        };
        let [network, batch] = parameters(&dqn);
        assert_eq!(network, 57 * 128 + 129 * 64 + 65 * 5);
        assert_eq!(batch, 2 * (56 + 128 + 64 + 5));
        let separate = DuelingDqn { trunk: Trunk::Separate, ..dqn.clone() };
        assert_eq!(parameters(&separate)[0], 2 * (57 * 128 + 129 * 64) + 65 * 5);
        let gru = DuelingDqn { recurrent: Memory::Gru, units: 10, ..dqn };
        let [network, batch] = parameters(&gru);
        assert_eq!(network, 57 * 128 + 129 * 30 + 11 * 30 + 11 * 64 + 65 * 5);
        assert_eq!(batch, 2 * (56 + 128 + 11 * 10 + 64 + 5));
    }

    #[test]
    fn layers_follow_each_other() {
        let parameters = DuelingDqn { layers: vec![5, 7], ..DuelingDqn::default() };
        let sizes = |stacks: Vec<Stack>| -> Vec<(String, usize, usize)> {
            let layers = stacks.iter().flat_map(|stack| stack.hidden.iter().chain(&stack.heads));
            layers.map(|layer| (layer.name.clone(), layer.inputs, layer.outputs)).collect()
        };
        assert_eq!(
            sizes(dueling(&parameters, Shape::of_four(3))),
            [
                ("trunk.0".to_owned(), 3, 5),
                ("trunk.1".to_owned(), 5, 7),
                ("value".to_owned(), 7, 1),
                ("advantage".to_owned(), 7, 4),
            ]
        );
        let separate = DuelingDqn { trunk: Trunk::Separate, ..parameters };
        assert_eq!(sizes(dueling(&separate, Shape::of_four(3))).len(), 6);
    }
}
