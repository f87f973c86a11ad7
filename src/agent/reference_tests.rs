//! Tests of losses, gradients and updates against numbers from PyTorch (`tests/data/torch`) and
//! against finite differences.

use burn::module::{Module, ModuleMapper, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Tensor, activation};
use serde_json::Value;

use crate::agent::burn::device;
use crate::agent::burn::{BurnNetwork, BurnQNetwork};
use crate::agent::dueling_dqn::{self, DuelingDqnEngine, Transitions};
use crate::agent::layers::Shape;
use crate::agent::policy::{self, ActionNetwork};
use crate::agent::reinforce::{ReinforceEngine, Trajectories, returns_to_go};
use crate::agent::replay::Batch;
use crate::agent::replay::Transition;
use crate::agent::weights::{Tensor as WeightTensor, Weights};
use crate::agent::{
    BurnDuelingDqn, BurnReinforce, DuelingDqn, DuelingQNetwork, FusedDuelingDqn, FusedReinforce,
    PolicyNetwork, Reinforce,
};
use crate::env::{Action, EpisodeStatus, Observations};
use crate::kernel::{Adam, Isa};
use crate::key::Keyed;

pub(super) const WIDTH: usize = 3;
pub(super) const SHAPE: Shape = Shape { inputs: WIDTH, actions: 4 };

const REFERENCE: &str = include_str!("../../tests/data/torch/reference.json");

/// The cases of this name in the text of a file.
pub(super) fn cases(file: &str, name: &str) -> Vec<Value> {
    let reference: Value = serde_json::from_str(file).unwrap();
    reference[name].as_array().unwrap().clone()
}

/// The name of a case.
pub(super) fn name(case: &Value) -> String {
    case["name"].as_str().unwrap().to_owned()
}

/// Default parameters, with the values of a case for the keys that it names.
pub(super) fn parameters<P: Keyed + Default>(case: &Value) -> P {
    let mut settings = case.as_object().unwrap().clone();
    // `batch` is also the name of the rows of a case.
    settings.retain(|name, json| !json.is_object() && P::KEYS.iter().any(|key| key.name == name));
    assert!(["layers", "activation"].iter().all(|name| settings.contains_key(*name)), "{case}");
    P::default().with_settings(&settings).unwrap()
}

/// The numbers of nested lists, flattened in order.
pub(super) fn numbers(value: &Value) -> Vec<f32> {
    match value.as_array() {
        Some(list) => list.iter().flat_map(numbers).collect(),
        None => vec![value.as_f64().unwrap() as f32],
    }
}

pub(super) fn flags(value: &Value) -> Vec<bool> {
    numbers(value).into_iter().map(|number| number != 0.0).collect()
}

pub(super) fn actions(value: &Value) -> Vec<Action> {
    let indices = numbers(value).into_iter();
    indices.map(|index| Action::from_index(index as usize).unwrap()).collect()
}

/// Observations from nested lists, one inner list per row.
pub(super) fn observations(value: &Value) -> Observations {
    let mut observations = Observations::new(WIDTH, 0);
    numbers(value).chunks_exact(WIDTH).for_each(|row| observations.push(row, None));
    observations
}

/// The outputs of a network for observations.
pub(super) fn evaluated(mut network: impl ActionNetwork, observations: &Observations) -> Vec<f32> {
    let mut out = Vec::new();
    network.evaluate(observations, &mut out);
    out
}

fn tensor(value: &Value) -> WeightTensor {
    let rows = value.as_array().unwrap();
    let shape = match rows[0].as_array() {
        Some(row) => vec![rows.len(), row.len()],
        None => vec![rows.len()],
    };
    WeightTensor { shape, values: numbers(value) }
}

/// Weights in the format of the reference data: stacks are lists of layers, heads are layers.
pub(super) fn weights(value: &Value) -> Weights {
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

pub(super) fn assert_close(ours: &[f32], theirs: &[f32], relative: f32, what: &str) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    let scale = theirs.iter().fold(1e-3f32, |m, v| m.max(v.abs()));
    for (i, (a, b)) in ours.iter().zip(theirs).enumerate() {
        assert!((a - b).abs() <= relative * scale, "{what}, number {i}: {a}, expected {b}");
    }
}

pub(super) fn assert_weights_close(ours: &Weights, theirs: &Weights, relative: f32, what: &str) {
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

pub(super) fn gradients<M: Module>(network: &M, loss: Tensor<1>) -> M {
    let gradients = GradientsParams::from_grads(loss.backward(), network);
    network.clone().map(&mut ToGradients(gradients))
}

struct DqnCase {
    name: String,
    case: Value,
    parameters: DuelingDqn,
    transitions: Vec<Transition>,
    batch: Batch,
}

impl DqnCase {
    fn all() -> Vec<DqnCase> {
        cases(REFERENCE, "dueling_dqn").into_iter().map(DqnCase::new).collect()
    }

    fn new(case: Value) -> Self {
        let batch = &case["batch"];
        let statuses = batch["endings"].as_array().unwrap().iter().map(|e| match e.as_str() {
            Some("running") => EpisodeStatus::Running,
            Some("terminated") => EpisodeStatus::Terminated,
            Some("truncated") => EpisodeStatus::Truncated,
            other => panic!("ending {other:?}"),
        });
        let actions = actions(&batch["actions"]);
        let transitions: Vec<Transition> = actions
            .iter()
            .zip(numbers(&batch["rewards"]))
            .zip(statuses)
            .map(|((&action, reward), status)| Transition {
                action,
                reward,
                status,
                is_withheld: false,
            })
            .collect();
        let batch = Batch {
            observations: observations(&batch["observations"]),
            actions,
            targets: numbers(&case["targets"]),
        };
        DqnCase { name: name(&case), parameters: parameters(&case), case, transitions, batch }
    }

    fn network(&self) -> DuelingQNetwork {
        self.with_weights(&weights(&self.case["network"]))
    }

    fn with_weights(&self, weights: &Weights) -> DuelingQNetwork {
        DuelingQNetwork::from_weights(&self.parameters, SHAPE, weights, &device::training())
            .unwrap()
    }

    fn burn(&self, which: &str) -> BurnDuelingDqn {
        BurnDuelingDqn::new(&self.parameters, SHAPE, &weights(&self.case[which])).unwrap()
    }

    fn fused(&self, which: &str, isa: Isa) -> FusedDuelingDqn {
        FusedDuelingDqn::new(&self.parameters, SHAPE, &weights(&self.case[which]), isa).unwrap()
    }

    /// Checks values, targets, loss and three updates of an engine against PyTorch's.
    fn check<E: DuelingDqnEngine<Experience = Transitions>>(&self, engine: impl Fn(&str) -> E) {
        let mut network = engine("network");
        let mut out = Vec::new();
        network.values(&self.batch.observations, &mut [], &mut out);
        assert_close(&out, &numbers(&self.case["q"]), 1e-5, &self.name);
        assert_eq!(evaluated(network.network(), &self.batch.observations), out);

        engine("target")
            .target_values(&observations(&self.case["batch"]["next_observations"]), &mut out);
        let DuelingDqn { gamma, terminal_target, .. } = self.parameters;
        let best = out.chunks_exact(4).map(|row| row[policy::best(row).index()]);
        let transitions = self.transitions.iter().zip(best);
        let targets: Vec<f32> = transitions
            .map(|(t, best)| dueling_dqn::target(t, best, gamma, terminal_target))
            .collect();
        assert_close(&targets, &self.batch.targets, 1e-5, &self.name);

        let loss = network.update(&self.batch);
        assert_close(&[loss], &numbers(&self.case["loss"]), 1e-5, &self.name);
        network.update(&self.batch);
        network.update(&self.batch);
        let expected = weights(&self.case["after_3_adam_steps"]);
        assert_weights_close(&network.weights(), &expected, 2e-6, &self.name);
        network.renew_target();
        network.values(&self.batch.observations, &mut [], &mut out);
        let values = out.clone();
        network.target_values(&self.batch.observations, &mut out);
        assert_eq!(out, values);
    }
}

#[test]
fn both_engines_compute_the_dueling_dqn_as_pytorch_does() {
    for case in DqnCase::all() {
        case.check(|which| case.burn(which));
        for isa in Isa::available() {
            case.check(|which| case.fused(which, isa));
        }
    }
}

#[test]
fn gradients_of_the_dueling_dqn_are_those_of_pytorch() {
    for case in DqnCase::all() {
        let expected = weights(&case.case["gradients"]);
        let network = case.network();
        let ours = gradients(&network, network.loss(&case.batch)).weights();
        assert_weights_close(&ours, &expected, 1e-5, &case.name);
        for isa in Isa::available() {
            let ours = case.fused("network", isa).gradient(&case.batch);
            assert_weights_close(&ours, &expected, 1e-5, &case.name);
        }
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
        cases(REFERENCE, "reinforce").into_iter().map(ReinforceCase::new).collect()
    }

    fn new(case: Value) -> Self {
        let rows = &case["rows"];
        let trajectories = Trajectories {
            observations: observations(&rows["observations"]),
            actions: actions(&rows["actions"]),
            preferences: Vec::new(),
            returns_to_go: numbers(&case["returns_to_go"]),
        };
        ReinforceCase { name: name(&case), parameters: parameters(&case), case, trajectories }
    }

    fn network(&self) -> PolicyNetwork {
        self.with_weights(&weights(&self.case["network"]))
    }

    fn with_weights(&self, weights: &Weights) -> PolicyNetwork {
        PolicyNetwork::from_weights(&self.parameters, SHAPE, weights, &device::training()).unwrap()
    }

    fn fused(&self, isa: Isa) -> FusedReinforce {
        let weights = weights(&self.case["network"]);
        FusedReinforce::new(&self.parameters, SHAPE, &weights, isa).unwrap()
    }

    fn burn(&self) -> BurnReinforce {
        BurnReinforce::new(&self.parameters, SHAPE, &weights(&self.case["network"])).unwrap()
    }

    /// Checks probabilities, loss and three updates of an engine against PyTorch's.
    fn check(&self, mut engine: impl ReinforceEngine) {
        let mut logits = Vec::new();
        engine.logits(&self.trajectories.observations, &mut logits);
        assert_eq!(evaluated(engine.network(), &self.trajectories.observations), logits);
        let logits = Tensor::<1>::from_floats(logits.as_slice(), &device::inference());
        let ours = activation::log_softmax(logits.reshape([-1, 4]), 1);
        let ours = ours.into_data().try_to_vec::<f32>().unwrap();
        assert_close(&ours, &numbers(&self.case["log_probabilities"]), 1e-6, &self.name);
        let mut update = || {
            let sampled = sampled_by(&mut engine, &self.trajectories);
            engine.update(&sampled)
        };
        assert_close(&[update()], &numbers(&self.case["loss"]), 1e-5, &self.name);
        update();
        update();
        let expected = weights(&self.case["after_3_adam_steps"]);
        assert_weights_close(&engine.weights(), &expected, 2e-6, &self.name);
    }

    fn loss(&self, network: &PolicyNetwork) -> Tensor<1> {
        BurnReinforce::loss(network, &self.trajectories, self.parameters.loss_divisor)
    }
}

#[test]
fn returns_to_go_are_those_of_pytorch() {
    for case in ReinforceCase::all() {
        let rows = &case.case["rows"];
        let trajectory = numbers(&rows["trajectory"]);
        let mut rewards: Vec<f64> = numbers(&rows["rewards"]).into_iter().map(f64::from).collect();
        let mut left = rewards.as_mut_slice();
        for of_one in trajectory.chunk_by(|a, b| a == b) {
            let (rewards, rest) = left.split_at_mut(of_one.len());
            returns_to_go(rewards, 1, case.parameters.gamma);
            left = rest;
        }
        let returns: Vec<f32> = rewards.into_iter().map(|g| g as f32).collect();
        assert_close(&returns, &case.trajectories.returns_to_go, 1e-6, &case.name);
    }
}

#[test]
fn both_engines_compute_reinforce_as_pytorch_does() {
    for case in ReinforceCase::all() {
        case.check(case.burn());
        for isa in Isa::available() {
            case.check(case.fused(isa));
        }
    }
}

#[test]
fn gradients_of_reinforce_are_those_of_pytorch() {
    for case in ReinforceCase::all() {
        let expected = weights(&case.case["gradients"]);
        let network = case.network();
        let ours = gradients(&network, case.loss(&network)).weights();
        assert_weights_close(&ours, &expected, 1e-5, &case.name);
        for isa in Isa::available() {
            let mut engine = case.fused(isa);
            let sampled = sampled_by(&mut engine, &case.trajectories);
            let ours = engine.gradient(&sampled);
            assert_weights_close(&ours, &expected, 1e-5, &case.name);
        }
    }
}

/// The trajectories with the preferences of this engine's network, as if it had sampled them.
pub(super) fn sampled_by(
    engine: &mut impl ReinforceEngine,
    trajectories: &Trajectories,
) -> Trajectories {
    let mut sampled = trajectories.clone();
    engine.logits(&sampled.observations, &mut sampled.preferences);
    let count = sampled.preferences.len() / sampled.actions.len();
    policy::exponentials(engine.isa(), &mut sampled.preferences, count);
    sampled
}

#[test]
fn adam_steps_are_those_of_pytorch() {
    let case = &serde_json::from_str::<Value>(REFERENCE).unwrap()["adam"];
    let learning_rate = case["learning_rate"].as_f64().unwrap();
    for isa in Isa::available() {
        let mut ours = numbers(&case["weights"]);
        let mut adam = Adam::new(learning_rate, ours.len());
        let steps = case["gradients"].as_array().unwrap().iter();
        for (gradient, expected) in steps.zip(case["after_each_step"].as_array().unwrap()) {
            adam.update(isa, &mut ours, &mut numbers(gradient));
            for (a, b) in ours.iter().zip(numbers(expected)) {
                assert!((a - b).abs() <= 3e-6 * b.abs(), "{ours:?} {expected}");
            }
        }
    }
}

/// Compares central differences of a loss in every weight with its gradients.
///
/// In f32 the loss is accurate to about 1e-7. A step of 1e-2 therefore leaves an error of about
/// 1e-5, plus the cubic term.
pub(super) fn assert_finite_differences(
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

// Only tanh networks: a finite difference across the kink of a ReLU is not a derivative.
#[test]
fn gradients_are_finite_differences_of_the_losses() {
    for case in DqnCase::all().iter().filter(|case| case.name.contains("tanh")) {
        let network = case.network();
        let loss = |network: &DuelingQNetwork| network.loss(&case.batch);
        let gradients = gradients(&network, loss(&network)).weights();
        assert_finite_differences(&network.weights(), &gradients, &case.name, |weights| {
            loss(&case.with_weights(weights)).into_scalar()
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
