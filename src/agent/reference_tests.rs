//! Losses, gradients and updates against numbers from PyTorch (`tests/data/torch`) and against
//! finite differences.

use burn::module::{Module, ModuleMapper, Param};
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Tensor, activation};
use serde_json::Value;

use crate::agent::dueling_dqn::Batch;
use crate::agent::network::{DuelingQNetwork, PolicyNetwork};
use crate::agent::reinforce::{Trajectories, returns_to_go};
use crate::agent::replay::Transition;
use crate::agent::weights::{Tensor as WeightTensor, Weights};
use crate::agent::{device, policy};
use crate::env::{Action, Ending};
use crate::manifest::{DuelingDqn, Reinforce};

const WIDTH: usize = 3;

fn reference() -> Value {
    serde_json::from_str(include_str!("../../tests/data/torch/reference.json")).unwrap()
}

fn cases(name: &str) -> Vec<Value> {
    reference()[name].as_array().unwrap().clone()
}

/// The numbers of nested lists, in order.
fn numbers(value: &Value) -> Vec<f32> {
    match value.as_array() {
        Some(list) => list.iter().flat_map(numbers).collect(),
        None => vec![value.as_f64().unwrap() as f32],
    }
}

fn tensor(value: &Value) -> WeightTensor {
    let rows = value.as_array().unwrap();
    let shape = match rows[0].as_array() {
        Some(row) => vec![rows.len(), row.len()],
        None => vec![rows.len()],
    };
    WeightTensor { shape, values: numbers(value) }
}

/// Weights from the reference's form: stacks are lists of layers, heads are layers.
fn weights(value: &Value) -> Weights {
    let mut weights = Weights::default();
    let mut add = |name: &str, layer: &Value| {
        for kind in ["weight", "bias"] {
            weights.tensors.insert(format!("{name}.{kind}"), tensor(&layer[kind]));
        }
    };
    for (name, part) in value.as_object().unwrap() {
        match part.as_array() {
            Some(stack) => {
                for (i, layer) in stack.iter().enumerate() {
                    add(&format!("{name}.{i}"), layer);
                }
            }
            None => add(name, part),
        }
    }
    weights
}

fn assert_close(ours: &[f32], theirs: &[f32], relative: f32, what: &str) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    let scale = theirs.iter().fold(1e-3f32, |m, v| m.max(v.abs()));
    for (a, b) in ours.iter().zip(theirs) {
        assert!((a - b).abs() <= relative * scale, "{what}: {ours:?}\nexpected {theirs:?}");
    }
}

fn assert_weights_close(ours: &Weights, theirs: &Weights, relative: f32, what: &str) {
    assert_eq!(
        ours.tensors.keys().collect::<Vec<_>>(),
        theirs.tensors.keys().collect::<Vec<_>>(),
        "{what}"
    );
    for (name, tensor) in &ours.tensors {
        let expected = &theirs.tensors[name].values;
        assert_close(&tensor.values, expected, relative, &format!("{what}, {name}"));
    }
}

/// Replaces every parameter by its gradient.
struct ToGradients(GradientsParams);

impl ModuleMapper for ToGradients {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, _, mapper) = param.consume();
        let gradient = self.0.remove::<D>(id).expect("every parameter has a gradient");
        Param::from_mapped_value(id, gradient, mapper)
    }
}

fn gradients<M: Module>(network: &M, loss: Tensor<1>) -> M {
    let gradients = GradientsParams::from_grads(loss.backward(), network);
    network.clone().map(&mut ToGradients(gradients))
}

fn adam() -> ModuleOptimizer {
    AdamConfig::new().with_epsilon(1e-8).init()
}

struct DqnCase {
    name: String,
    case: Value,
    parameters: DuelingDqn,
    batch: Batch,
}

impl DqnCase {
    fn all() -> Vec<DqnCase> {
        cases("dueling_dqn").into_iter().map(DqnCase::new).collect()
    }

    fn new(case: Value) -> Self {
        let word = |key: &str| serde_json::from_value(case[key].clone()).unwrap();
        let parameters = DuelingDqn {
            layers: serde_json::from_value(case["layers"].clone()).unwrap(),
            activation: serde_json::from_value(case["activation"].clone()).unwrap(),
            trunk: serde_json::from_value(case["trunk"].clone()).unwrap(),
            terminal_target: serde_json::from_value(case["terminal_target"].clone()).unwrap(),
            gamma: case["gamma"].as_f64().unwrap(),
            learning_rate: case["learning_rate"].as_f64().unwrap(),
            ..DuelingDqn::default()
        };
        let batch = &case["batch"];
        let endings = batch["endings"].as_array().unwrap().iter().map(|e| match e.as_str() {
            Some("running") => Ending::Running,
            Some("terminated") => Ending::Terminated,
            Some("truncated") => Ending::Truncated,
            other => panic!("ending {other:?}"),
        });
        let transitions = numbers(&batch["actions"]).into_iter().zip(numbers(&batch["rewards"]));
        let transitions = transitions.zip(endings).map(|((action, reward), ending)| Transition {
            action: Action::from_index(action as usize).unwrap(),
            reward,
            ending,
        });
        let batch = Batch {
            observations: numbers(&batch["observations"]),
            transitions: transitions.collect(),
            next_observations: numbers(&batch["next_observations"]),
        };
        DqnCase { name: word("name"), case, parameters, batch }
    }

    fn network(&self, which: &str) -> DuelingQNetwork {
        self.with_weights(&weights(&self.case[which]))
    }

    fn with_weights(&self, weights: &Weights) -> DuelingQNetwork {
        DuelingQNetwork::from_weights(&self.parameters, WIDTH, weights, &device::training())
            .unwrap()
    }

    fn targets(&self) -> Vec<f32> {
        let DuelingDqn { gamma, terminal_target, .. } = self.parameters;
        let target = self.network("target").valid();
        self.batch.targets(&target, gamma, terminal_target, &device::inference())
    }

    fn loss(&self, network: &DuelingQNetwork) -> Tensor<1> {
        self.batch.loss(network, &self.targets(), &device::training())
    }
}

#[test]
fn dueling_dqn_values_targets_loss_and_gradients_are_those_of_pytorch() {
    for case in DqnCase::all() {
        let network = case.network("network");
        let rows = case.batch.transitions.len();
        let observations = case.batch.observations.clone();
        let q = network.forward(policy::matrix(observations, rows, &device::training()));
        let q = q.into_data().try_to_vec::<f32>().unwrap();
        assert_close(&q, &numbers(&case.case["q"]), 1e-5, &case.name);
        assert_close(&case.targets(), &numbers(&case.case["targets"]), 1e-5, &case.name);
        let loss = case.loss(&network);
        let value: f32 = loss.clone().into_scalar();
        assert_close(&[value], &numbers(&case.case["loss"]), 1e-5, &case.name);
        let ours = gradients(&network, loss).weights();
        assert_weights_close(&ours, &weights(&case.case["gradients"]), 1e-5, &case.name);
    }
}

#[test]
fn dueling_dqn_updates_are_those_of_pytorch() {
    for case in DqnCase::all() {
        let mut network = case.network("network");
        let mut optimizer = adam();
        for _ in 0..3 {
            let gradients = GradientsParams::from_grads(case.loss(&network).backward(), &network);
            network = optimizer.step(case.parameters.learning_rate, network, gradients);
        }
        let expected = weights(&case.case["after_3_adam_steps"]);
        assert_weights_close(&network.weights(), &expected, 2e-6, &case.name);
    }
}

struct ReinforceCase {
    name: String,
    case: Value,
    parameters: Reinforce,
    trajectories: Trajectories,
}

impl ReinforceCase {
    fn all() -> Vec<ReinforceCase> {
        cases("reinforce").into_iter().map(ReinforceCase::new).collect()
    }

    fn new(case: Value) -> Self {
        let parameters = Reinforce {
            layers: serde_json::from_value(case["layers"].clone()).unwrap(),
            activation: serde_json::from_value(case["activation"].clone()).unwrap(),
            gamma: case["gamma"].as_f64().unwrap(),
            loss_divisor: case["loss_divisor"].as_f64().unwrap(),
            learning_rate: case["learning_rate"].as_f64().unwrap(),
            ..Reinforce::default()
        };
        let rows = &case["rows"];
        let actions = numbers(&rows["actions"]).into_iter();
        let trajectories = Trajectories {
            observations: numbers(&rows["observations"]),
            actions: actions.map(|a| Action::from_index(a as usize).unwrap()).collect(),
            returns_to_go: numbers(&case["returns_to_go"]),
        };
        let name = case["name"].as_str().unwrap().to_owned();
        ReinforceCase { name, case, parameters, trajectories }
    }

    fn network(&self) -> PolicyNetwork {
        self.with_weights(&weights(&self.case["network"]))
    }

    fn with_weights(&self, weights: &Weights) -> PolicyNetwork {
        PolicyNetwork::from_weights(&self.parameters, WIDTH, weights, &device::training()).unwrap()
    }

    fn loss(&self, network: &PolicyNetwork) -> Tensor<1> {
        self.trajectories.loss(network, self.parameters.loss_divisor, &device::training())
    }
}

#[test]
fn reinforce_returns_loss_and_gradients_are_those_of_pytorch() {
    for case in ReinforceCase::all() {
        let rows = &case.case["rows"];
        let trajectory = numbers(&rows["trajectory"]);
        let rewards: Vec<f64> = numbers(&rows["rewards"]).into_iter().map(f64::from).collect();
        let mut returns = Vec::new();
        for of_one in trajectory.chunk_by(|a, b| a == b) {
            let rewards = &rewards[returns.len()..returns.len() + of_one.len()];
            returns.extend(returns_to_go(rewards, 1, case.parameters.gamma));
        }
        let returns: Vec<f32> = returns.into_iter().map(|g| g as f32).collect();
        assert_close(&returns, &case.trajectories.returns_to_go, 1e-6, &case.name);

        let network = case.network();
        let rows = case.trajectories.actions.len();
        let observations = case.trajectories.observations.clone();
        let logits = network.forward(policy::matrix(observations, rows, &device::training()));
        let ours = activation::log_softmax(logits, 1).into_data().try_to_vec::<f32>().unwrap();
        assert_close(&ours, &numbers(&case.case["log_probabilities"]), 1e-6, &case.name);
        let loss = case.loss(&network);
        let value: f32 = loss.clone().into_scalar();
        assert_close(&[value], &numbers(&case.case["loss"]), 1e-5, &case.name);
        let ours = gradients(&network, loss).weights();
        assert_weights_close(&ours, &weights(&case.case["gradients"]), 1e-5, &case.name);
    }
}

#[test]
fn reinforce_updates_are_those_of_pytorch() {
    for case in ReinforceCase::all() {
        let mut network = case.network();
        let mut optimizer = adam();
        for _ in 0..3 {
            let gradients = GradientsParams::from_grads(case.loss(&network).backward(), &network);
            network = optimizer.step(case.parameters.learning_rate, network, gradients);
        }
        let expected = weights(&case.case["after_3_adam_steps"]);
        assert_weights_close(&network.weights(), &expected, 2e-6, &case.name);
    }
}

/// A module of nothing but numbers, to watch the optimiser alone.
#[derive(Module, Debug)]
struct Numbers {
    values: Param<Tensor<1>>,
}

#[test]
fn adam_steps_are_those_of_pytorch() {
    let case = &reference()["adam"];
    let device = device::training();
    let start = numbers(&case["weights"]);
    let mut module =
        Numbers { values: Param::from_tensor(Tensor::from_floats(start.as_slice(), &device)) };
    let mut optimizer = adam();
    let learning_rate = case["learning_rate"].as_f64().unwrap();
    let steps = case["gradients"].as_array().unwrap().iter();
    for (gradient, expected) in steps.zip(case["after_each_step"].as_array().unwrap()) {
        let gradient = Tensor::<1>::from_floats(numbers(gradient).as_slice(), &device::inference());
        let mut gradients = GradientsParams::new();
        gradients.register(module.values.id, gradient);
        module = optimizer.step(learning_rate, module, gradients);
        let ours = module.values.val().into_data().try_to_vec::<f32>().unwrap();
        for (a, b) in ours.iter().zip(numbers(expected)) {
            assert!((a - b).abs() <= 3e-6 * b.abs(), "{ours:?} {expected}");
        }
    }
}

/// Central differences of a loss in every weight, against its gradients.
///
/// In f32 the loss is good to about 1e-7, so a step of 1e-2 leaves about 1e-5 and the cubic term.
fn assert_finite_differences(
    start: &Weights,
    gradients: &Weights,
    what: &str,
    loss: impl Fn(&Weights) -> f32,
) {
    const STEP: f32 = 1e-2;
    for (name, tensor) in &start.tensors {
        for i in 0..tensor.values.len() {
            let moved = |by: f32| {
                let mut weights = start.clone();
                weights.tensors.get_mut(name).unwrap().values[i] += by;
                f64::from(loss(&weights))
            };
            let difference = (moved(STEP) - moved(-STEP)) / (2.0 * f64::from(STEP));
            let gradient = f64::from(gradients.tensors[name].values[i]);
            assert!(
                (difference - gradient).abs() < 1e-3 + 0.01 * gradient.abs(),
                "{what}, {name}[{i}]: difference {difference}, gradient {gradient}"
            );
        }
    }
}

// Only tanh networks: a ReLU has no derivative where a step crosses its corner.
#[test]
fn gradients_are_finite_differences_of_the_losses() {
    for case in DqnCase::all().iter().filter(|case| case.name.contains("tanh")) {
        let network = case.network("network");
        let gradients = gradients(&network, case.loss(&network)).weights();
        assert_finite_differences(&network.weights(), &gradients, &case.name, |weights| {
            case.loss(&case.with_weights(weights)).into_scalar()
        });
    }
    for case in ReinforceCase::all().iter().filter(|case| case.name.contains("tanh")) {
        let network = case.network();
        let gradients = gradients(&network, case.loss(&network)).weights();
        assert_finite_differences(&network.weights(), &gradients, &case.name, |weights| {
            case.loss(&case.with_weights(weights)).into_scalar()
        });
    }
}
