//! Exports a policy as an ONNX graph.
//!
//! Input: `observations`, \[rows, inputs\]. Outputs: `values`, the network's output for each action,
//! \[rows, actions\]; `probabilities`, the probability of each action, \[rows, actions\]; and `best`, the
//! action with the highest value, \[rows\]. With a GRU, each row is an episode: the further input `state`,
//! \[rows, units\], is 0 at its first observation, and the further output `next_state` is the state of the next.
//!
//! **Source**: `onnx.proto3` of ONNX 1.10 (IR version 8), operators of opset 13.

use crate::agent::{Activation, Architecture, Choice, GruNames, Shape, WeightTensor, Weights};

use super::protobuf::ProtobufMessage;

const IR_VERSION: u64 = 8;
const OPSET: u64 = 13;

// Types of tensors and attributes.
const FLOAT: u64 = 1;
const INT64: u64 = 7;
const INT_ATTRIBUTE: u64 = 2;
const INTS_ATTRIBUTE: u64 = 7;

const OBSERVATIONS: &str = "observations";
const VALUES: &str = "values";
const PROBABILITIES: &str = "probabilities";
const BEST: &str = "best";
const STATE: &str = "state";
const NEXT_STATE: &str = "next_state";

/// A graph under construction.
#[derive(Default)]
struct Graph {
    nodes: Vec<ProtobufMessage>,
    initializers: Vec<ProtobufMessage>,
}

/// The value of an attribute, with the attribute's name: one whole number or several.
enum Attribute {
    Int(&'static str, u64),
    Ints(&'static str, &'static [u64]),
}

impl Attribute {
    fn message(&self) -> ProtobufMessage {
        match self {
            Attribute::Int(name, value) => ProtobufMessage::default()
                .bytes(1, name)
                .number(3, *value)
                .number(20, INT_ATTRIBUTE),
            Attribute::Ints(name, values) => {
                let named = ProtobufMessage::default().bytes(1, name);
                let valued = values.iter().fold(named, |all, value| all.number(8, *value));
                valued.number(20, INTS_ATTRIBUTE)
            }
        }
    }
}

impl Graph {
    /// Adds an operation.
    fn node(&mut self, operator: &str, inputs: &[&str], output: &str, attributes: &[Attribute]) {
        self.node_with_outputs(operator, inputs, &[output], attributes);
    }

    /// Adds an operation, which is called after its first output.
    fn node_with_outputs(
        &mut self,
        operator: &str,
        inputs: &[&str],
        outputs: &[&str],
        attributes: &[Attribute],
    ) {
        let message = ProtobufMessage::default();
        let message = inputs.iter().fold(message, |all, input| all.bytes(1, input));
        let message = outputs.iter().fold(message, |all, output| all.bytes(2, output));
        let message = message.bytes(3, outputs[0]).bytes(4, operator);
        let attributes: Vec<_> = attributes.iter().map(Attribute::message).collect();
        self.nodes.push(message.messages(5, &attributes));
    }

    /// Adds a constant.
    fn constant(&mut self, name: &str, shape: &[usize], data_type: u64, bytes: &[u8]) {
        let message = ProtobufMessage::default();
        let message = shape.iter().fold(message, |all, length| all.number(1, *length as u64));
        self.initializers.push(message.number(2, data_type).bytes(8, name).bytes(9, bytes));
    }

    fn reals(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.constant(name, shape, FLOAT, &bytes);
    }

    /// Adds a linear layer, with its weights, and returns the name of its output.
    fn layer(&mut self, name: &str, input: &str, weights: &Weights) -> String {
        let (weight, bias, output) =
            (format!("{name}.weight"), format!("{name}.bias"), format!("{name}.out"));
        for array in [&weight, &bias] {
            if let Some(WeightTensor { shape, values }) = weights.tensors.get(array) {
                self.reals(array, shape, values);
            }
        }
        self.node("Gemm", &[input, &weight, &bias], &output, &[]);
        output
    }

    /// Adds a gated recurrent unit on an input; its output is the next state.
    fn gru(&mut self, GruNames { input, state, .. }: &GruNames, from: &str, weights: &Weights) {
        let of_input = self.layer(input, from, weights);
        let of_state = self.layer(state, STATE, weights);
        let along_units = [Attribute::Int("axis", 1)];
        self.node_with_outputs("Split", &[&of_input], &["a.r", "a.z", "a.n"], &along_units);
        self.node_with_outputs("Split", &[&of_state], &["b.r", "b.z", "b.n"], &along_units);
        for (operator, inputs, output) in [
            ("Add", &["a.r", "b.r"][..], "sum.r"),
            ("Sigmoid", &["sum.r"], "r"),
            ("Add", &["a.z", "b.z"], "sum.z"),
            ("Sigmoid", &["sum.z"], "z"),
            ("Mul", &["r", "b.n"], "reset.n"),
            ("Add", &["a.n", "reset.n"], "sum.n"),
            ("Tanh", &["sum.n"], "n"),
            ("Sub", &[STATE, "n"], "h.less.n"),
            ("Mul", &["z", "h.less.n"], "kept"),
            ("Add", &["n", "kept"], NEXT_STATE),
        ] {
            self.node(operator, inputs, output, &[]);
        }
    }

    /// The layers of every stack; returns the outputs of the heads.
    fn stacks(&mut self, architecture: &Architecture, weights: &Weights) -> Vec<String> {
        let activation = match architecture.activation {
            Activation::Relu => "Relu",
            Activation::Tanh => "Tanh",
        };
        let mut heads = Vec::new();
        for stack in &architecture.stacks {
            let mut last = OBSERVATIONS.to_owned();
            for index in 0..=stack.hidden.len() {
                if let Some(gru) = stack.gru.as_ref().filter(|gru| gru.before == index) {
                    self.gru(gru, &last, weights);
                    last = NEXT_STATE.to_owned();
                }
                let Some(name) = stack.hidden.get(index) else { break };
                let output = self.layer(name, &last, weights);
                last = format!("{name}.active");
                self.node(activation, &[&output], &last, &[]);
            }
            heads.extend(stack.heads.iter().map(|name| self.layer(name, &last, weights)));
        }
        heads
    }

    /// Adds the probabilities of epsilon-greedy choices; the best actions must have been added.
    fn epsilon_greedy(&mut self, epsilon: f64, actions: usize) {
        let explored = epsilon / actions as f64;
        let chosen = 1.0 - epsilon + explored;
        self.constant("actions", &[1], INT64, &(actions as i64).to_le_bytes());
        self.reals("explored_and_chosen", &[2], &[explored as f32, chosen as f32]);
        let inputs = [BEST, "actions", "explored_and_chosen"];
        self.node("OneHot", &inputs, PROBABILITIES, &[]);
    }
}

/// An input or output: a tensor with one row per observation on its first axis.
fn tensor(name: &str, element: u64, columns: Option<usize>) -> ProtobufMessage {
    let rows = ProtobufMessage::default().bytes(2, "rows");
    let columns = columns.map(|length| ProtobufMessage::default().number(1, length as u64));
    let axes: Vec<ProtobufMessage> = [rows].into_iter().chain(columns).collect();
    let shape = ProtobufMessage::default().messages(1, &axes);
    let tensor_type = ProtobufMessage::default().number(1, element).message(2, &shape);
    ProtobufMessage::default()
        .bytes(1, name)
        .message(2, &ProtobufMessage::default().message(1, &tensor_type))
}

/// The policy as an ONNX model.
pub(super) fn model(
    weights: &Weights,
    (architecture, choice): (&Architecture, Choice),
    shape: Shape,
) -> Vec<u8> {
    let mut graph = Graph::default();
    let heads = graph.stacks(architecture, weights);
    let along_actions = || Attribute::Int("axis", 1);
    match (choice, heads.as_slice()) {
        (Choice::EpsilonGreedy { epsilon }, [value, advantage]) => {
            let mean = [Attribute::Ints("axes", &[1]), Attribute::Int("keepdims", 1)];
            graph.node("ReduceMean", &[advantage], "advantage.mean", &mean);
            graph.node("Sub", &[advantage, "advantage.mean"], "advantage.centred", &[]);
            graph.node("Add", &[value, "advantage.centred"], VALUES, &[]);
            let best = [along_actions(), Attribute::Int("keepdims", 0)];
            graph.node("ArgMax", &[VALUES], BEST, &best);
            graph.epsilon_greedy(epsilon, shape.actions);
        }
        (_, heads) => {
            let logits: Vec<&str> = heads.iter().map(String::as_str).collect();
            graph.node("Identity", &logits, VALUES, &[]);
            let best = [along_actions(), Attribute::Int("keepdims", 0)];
            graph.node("ArgMax", &[VALUES], BEST, &best);
            graph.node("Softmax", &[VALUES], PROBABILITIES, &[along_actions()]);
        }
    }
    let mut inputs = vec![tensor(OBSERVATIONS, FLOAT, Some(shape.inputs))];
    let mut outputs = vec![
        tensor(VALUES, FLOAT, Some(shape.actions)),
        tensor(PROBABILITIES, FLOAT, Some(shape.actions)),
        tensor(BEST, INT64, None),
    ];
    for gru in architecture.stacks.iter().filter_map(|stack| stack.gru.as_ref()) {
        let state = weights.tensors.get(&format!("{}.weight", gru.state));
        let units = state.map(|weight| weight.shape[0]);
        inputs.push(tensor(STATE, FLOAT, units));
        outputs.push(tensor(NEXT_STATE, FLOAT, units));
    }
    let graph = ProtobufMessage::default()
        .messages(1, &graph.nodes)
        .bytes(2, "policy")
        .messages(5, &graph.initializers)
        .messages(11, &inputs)
        .messages(12, &outputs);
    let opset = ProtobufMessage::default().bytes(1, "").number(2, OPSET);
    ProtobufMessage::default()
        .number(1, IR_VERSION)
        .bytes(2, "jitai")
        .bytes(3, env!("CARGO_PKG_VERSION"))
        .message(7, &graph)
        .message(8, &opset)
        .into_bytes()
}
