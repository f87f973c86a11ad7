//! Tests of PPO without and with a GRU, on both engines: against numbers from PyTorch
//! (`tests/data/torch/ppo.json`), against finite differences, against each other, and on every
//! instruction set.

use serde_json::Value;

use crate::agent::burn::device;
use crate::agent::engine_tests::Random;
use crate::agent::fused::FusedPpoNetwork;
use crate::agent::layers::Shape;
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Losses, Minibatch, Ppo, PpoEngine, Sequences, advantages};
use crate::agent::reference_tests::{
    SHAPE, WIDTH, actions, assert_close, assert_finite_differences, assert_weights_close, cases,
    flags, gradients, name, numbers, observations, parameters, weights,
};
use crate::agent::{
    Activation, ActorCritic, BurnActorCritic, BurnPpo, FusedActorCritic, FusedPpo,
    FusedRecurrentActorCritic, Recurrent, RecurrentActorCritic, Weights, layers, orthogonal,
};
use crate::env::Observations;
use crate::kernel::Isa;

const FILE: &str = include_str!("../../tests/data/torch/ppo.json");

#[test]
fn advantages_are_those_of_cleanrl() {
    for case in cases(FILE, "advantages") {
        let rewards: Vec<f64> = numbers(&case["rewards"]).into_iter().map(f64::from).collect();
        let mut ours = vec![0.0; rewards.len()];
        advantages(
            &rewards,
            &numbers(&case["values"]),
            &flags(&case["ended"]),
            &numbers(&case["last_values"]),
            [case["gamma"].as_f64().unwrap(), case["gae_lambda"].as_f64().unwrap()],
            &mut ours,
        );
        assert_close(&ours, &numbers(&case["advantages"]), 1e-6, "advantages");
    }
}

fn parts(losses: Losses) -> [f32; 5] {
    let Losses { loss, policy, value, entropy, approx_kl } = losses;
    [loss, policy, value, entropy, approx_kl]
}

/// A case with PyTorch's numbers.
struct Case {
    name: String,
    case: Value,
    parameters: Ppo,
    minibatch: Minibatch,
}

impl Case {
    fn all(which: &str) -> Vec<Case> {
        cases(FILE, which).into_iter().map(Case::new).collect()
    }

    fn new(case: Value) -> Case {
        let sequences = case.get("states").map(|states| Sequences {
            lanes: states.as_array().unwrap().len(),
            memory: numbers(states),
            firsts: flags(&case["firsts"]),
            real: flags(&case["real"]),
        });
        let recurrent = if sequences.is_some() { Recurrent::Gru } else { Recurrent::None };
        let minibatch = Minibatch {
            observations: observations(&case["observations"]),
            actions: actions(&case["actions"]),
            chosen: vec![true; numbers(&case["log_probabilities"]).len()],
            log_probabilities: numbers(&case["log_probabilities"]),
            values: numbers(&case["values"]),
            advantages: numbers(&case["advantages"]),
            returns: numbers(&case["returns"]),
            sequences,
        };
        let parameters = Ppo { recurrent, ..parameters(&case) };
        Case { name: name(&case), case, parameters, minibatch }
    }

    fn weights(&self) -> Weights {
        weights(&self.case["network"])
    }

    /// Acts along the sequences, or in all rows at once, then performs three updates.
    fn check(&self, mut engine: impl PpoEngine) {
        let (rows, sequences) = (self.minibatch.rows(), self.minibatch.sequences.as_ref());
        let lanes = sequences.map_or(rows, |sequences| sequences.lanes);
        let mut memory = sequences.map_or_else(Vec::new, |sequences| sequences.memory.clone());
        let (mut logits, mut values, mut states) = (Vec::new(), Vec::new(), Vec::new());
        let mut policy = engine.network();
        for first in (0..rows).step_by(lanes) {
            let rows = first..first + lanes;
            if let Some(Sequences { firsts, .. }) = sequences {
                let each = memory.chunks_exact_mut(engine.memory()).zip(&firsts[rows.clone()]);
                each.filter(|(_, first)| **first).for_each(|(memory, _)| memory.fill(0.0));
            }
            let mut observations = Observations::new(WIDTH, 0);
            observations.extend(&self.minibatch.observations, rows);
            let (mut of_actions, mut of_states, mut of_policy) =
                (Vec::new(), Vec::new(), Vec::new());
            policy.recall(&observations, &mut memory.clone(), &mut of_policy);
            engine.evaluate(&observations, &mut memory, &mut of_actions, &mut of_states);
            assert_eq!(of_policy, of_actions);
            logits.extend(of_actions);
            values.extend(of_states);
            states.extend_from_slice(&memory);
        }
        if sequences.is_some() {
            assert_close(&states, &numbers(&self.case["states_after"]), 1e-5, &self.name);
        }
        assert_close(&logits, &numbers(&self.case["logits"]), 1e-5, &self.name);
        assert_close(&values, &numbers(&self.case["state_values"]), 1e-5, &self.name);
        let rate = self.parameters.learning_rate;
        let losses = engine.update(&self.minibatch, rate);
        // Compared together, because the loss is a difference of parts of magnitude 1.
        let expected = ["loss", "policy", "value", "entropy", "approx_kl"]
            .map(|name| numbers(&self.case["losses"][name])[0]);
        assert_close(&parts(losses), &expected, 1e-6, &self.name);
        engine.update(&self.minibatch, rate);
        engine.update(&self.minibatch, rate);
        let expected = weights(&self.case["after_3_steps"]);
        let relative = if sequences.is_some() { 3e-6 } else { 2e-6 };
        assert_weights_close(&engine.weights(), &expected, relative, &self.name);
    }
}

/// A random case. Some sizes fill whole registers, others do not.
pub(super) struct Drawn {
    parameters: Ppo,
    /// Of a minibatch; without a GRU, each row is a lane of one step.
    lanes: usize,
    steps: usize,
    random: Random,
}

impl Drawn {
    fn plain(i: usize) -> Drawn {
        let layers: [&[u32]; 6] = [&[64, 64], &[1], &[17, 5, 33], &[128], &[3, 3], &[16]];
        Drawn {
            parameters: Ppo {
                layers: layers[i % 6].to_vec(),
                activation: if i.is_multiple_of(2) { Activation::Tanh } else { Activation::Relu },
                clip_value_loss: i.is_multiple_of(3),
                ..Ppo::default()
            },
            lanes: [64, 1, 7, 65, 130, 50][(i / 6 + i) % 6],
            steps: 1,
            random: Random::new(i, if i.is_multiple_of(4) { 9 } else { 0 }, 24),
        }
    }

    pub(super) fn gru(i: usize, lanes: usize, steps: usize) -> Drawn {
        let layers: [&[u32]; 4] = [&[64], &[5, 3], &[16, 20, 7], &[33]];
        Drawn {
            parameters: Ppo {
                layers: layers[i % 4].to_vec(),
                layers_before_gru: 1 + u32::from(i % 4 == 2),
                activation: if i.is_multiple_of(2) { Activation::Tanh } else { Activation::Relu },
                recurrent: Recurrent::Gru,
                units: [64, 3, 17, 16][i % 4],
                ..Ppo::default()
            },
            lanes,
            steps,
            random: Random::new(i, if i.is_multiple_of(3) { 5 } else { 0 }, 8),
        }
    }

    fn has_gru(&self) -> bool {
        self.parameters.recurrent == Recurrent::Gru
    }

    fn name(&self) -> String {
        let Ppo { layers, activation, recurrent, .. } = &self.parameters;
        format!("{layers:?} {activation:?} {recurrent:?}, {:?}", self.random.shape())
    }

    fn weights(&self) -> Weights {
        let layers = layers::ppo(&self.parameters, self.random.shape());
        orthogonal::initial(&layers, 1, 3).unwrap()
    }

    /// With a GRU, sequences in which episodes begin at random steps.
    pub(super) fn minibatch(&mut self) -> Minibatch {
        let (lanes, rows, units) = (self.lanes, self.lanes * self.steps, self.parameters.units);
        let has_gru = self.has_gru();
        let random = &mut self.random;
        Minibatch {
            observations: random.observations(rows),
            actions: random.actions(rows),
            chosen: (0..rows).map(|_| random.stream.below(4) > 0).collect(),
            log_probabilities: random.many(rows, -2.0, -1.0),
            values: random.many(rows, -1.0, 1.0),
            advantages: random.many(rows, -2.0, 2.0),
            returns: random.many(rows, 0.0, 10.0),
            sequences: has_gru.then(|| Sequences {
                lanes,
                memory: random.many(lanes * units as usize, -0.5, 0.5),
                firsts: (0..rows).map(|_| random.stream.below(4) == 0).collect(),
                real: vec![true; rows],
            }),
        }
    }

    /// The losses of a minibatch and its gradient through the GRU.
    pub(super) fn learned(&self, minibatch: &Minibatch) -> ([f32; 5], Weights) {
        let (shape, weights) = (self.random.shape(), self.weights());
        let mut engine =
            fused::<FusedRecurrentActorCritic>(&self.parameters, shape, &weights, Isa::chosen());
        let gradient = engine.gradient(minibatch);
        (parts(engine.update(minibatch, 0.0)), gradient)
    }
}

fn burn<B: BurnActorCritic>(parameters: &Ppo, shape: Shape, weights: &Weights) -> B {
    B::from_weights(parameters, shape, weights, &device::training()).unwrap()
}

fn fused<F: FusedPpoNetwork>(
    parameters: &Ppo,
    shape: Shape,
    weights: &Weights,
    isa: Isa,
) -> FusedPpo<F> {
    FusedPpo::new(parameters, shape, weights, isa).unwrap()
}

fn computes_as_pytorch_does<B: BurnActorCritic, F: FusedPpoNetwork>(case: &Case) {
    let (parameters, weights) = (&case.parameters, case.weights());
    case.check(BurnPpo::new(parameters, burn::<B>(parameters, SHAPE, &weights)));
    for isa in Isa::available() {
        case.check(fused::<F>(parameters, SHAPE, &weights, isa));
    }
}

fn has_gradients_of_pytorch<B: BurnActorCritic, F: FusedPpoNetwork>(case: &Case) {
    let (parameters, start) = (&case.parameters, case.weights());
    let expected = weights(&case.case["gradients"]);
    let network = burn::<B>(parameters, SHAPE, &start);
    let loss = BurnPpo::loss(&network, &case.minibatch, parameters).loss;
    assert_weights_close(&gradients(&network, loss).weights(), &expected, 1e-5, &case.name);
    for isa in Isa::available() {
        let mut engine = fused::<F>(parameters, SHAPE, &start, isa);
        let ours = engine.gradient(&case.minibatch);
        assert_weights_close(&ours, &expected, 1e-5, &case.name);
    }
}

// The limits of the ratio are too wide for any step to cross.
fn has_finite_differences<F: FusedPpoNetwork>(case: &Case) {
    let parameters = Ppo { clip: 10.0, clip_value_loss: false, ..case.parameters.clone() };
    let engine = |weights: &Weights| fused::<F>(&parameters, SHAPE, weights, Isa::chosen());
    let gradients = engine(&case.weights()).gradient(&case.minibatch);
    assert_finite_differences(&case.weights(), &gradients, &case.name, |weights| {
        engine(weights).update(&case.minibatch, 0.0).loss
    });
}

fn learns_alike<B: BurnActorCritic, F: FusedPpoNetwork>(mut case: Drawn, updates: usize) {
    let (weights, shape, name) = (case.weights(), case.random.shape(), case.name());
    let mut fused = fused::<F>(&case.parameters, shape, &weights, Isa::chosen());
    let network = burn::<B>(&case.parameters, shape, &weights);
    let minibatch = case.minibatch();
    let loss = BurnPpo::loss(&network, &minibatch, &case.parameters).loss;
    let expected = gradients(&network, loss).weights();
    assert_weights_close(&fused.gradient(&minibatch), &expected, 1e-5, &name);
    let mut burn = BurnPpo::new(&case.parameters, network);
    for update in 0..updates {
        if case.has_gru() {
            // Sizes vary, so that buffers are reused.
            (case.lanes, case.steps) = (1 + update % 7, 1 + update % 4);
        }
        let minibatch = case.minibatch();
        let [ours, theirs] = [fused.update(&minibatch, 1e-3), burn.update(&minibatch, 1e-3)];
        assert_close(&parts(ours), &parts(theirs), 1e-4, &name);
    }
    assert_weights_close(&fused.weights(), &burn.weights(), 1e-3, &name);
}

fn learns_the_same_bits<F: FusedPpoNetwork>(mut case: Drawn) {
    let (weights, minibatch) = (case.weights(), case.minibatch());
    let mut learned = Isa::available().into_iter().map(|isa| {
        let mut engine = fused::<F>(&case.parameters, case.random.shape(), &weights, isa);
        let losses = [(); 3].map(|()| engine.update(&minibatch, 1e-3).loss.to_bits());
        let mut memory = vec![0.0; minibatch.rows() * engine.memory()];
        let mut logits = Vec::new();
        engine.network().recall(&minibatch.observations, &mut memory, &mut logits);
        let logits: Vec<u32> = logits.into_iter().map(f32::to_bits).collect();
        (losses, logits, engine.weights().to_bytes())
    });
    let first = learned.next().unwrap();
    assert!(learned.all(|other| other == first), "{}", case.name());
}
#[test]
fn both_engines_compute_ppo_as_pytorch_does() {
    Case::all("feed_forward")
        .iter()
        .for_each(computes_as_pytorch_does::<ActorCritic, FusedActorCritic>);
    Case::all("recurrent")
        .iter()
        .for_each(computes_as_pytorch_does::<RecurrentActorCritic, FusedRecurrentActorCritic>);
}

#[test]
fn gradients_of_ppo_are_those_of_pytorch() {
    Case::all("feed_forward")
        .iter()
        .for_each(has_gradients_of_pytorch::<ActorCritic, FusedActorCritic>);
    Case::all("recurrent")
        .iter()
        .for_each(has_gradients_of_pytorch::<RecurrentActorCritic, FusedRecurrentActorCritic>);
}

// Only tanh networks: a finite difference across the kink of a ReLU is not a derivative. With a
// GRU: five steps, with a reset in the middle of one lane.
#[test]
fn gradients_of_ppo_are_finite_differences() {
    let smooth = |which| Case::all(which).into_iter().filter(|case| case.name.contains("tanh"));
    smooth("feed_forward").for_each(|case| has_finite_differences::<FusedActorCritic>(&case));
    smooth("recurrent").for_each(|case| has_finite_differences::<FusedRecurrentActorCritic>(&case));
}

#[test]
fn fused_ppo_learns_as_burns_does() {
    (0..30).for_each(|i| learns_alike::<ActorCritic, FusedActorCritic>(Drawn::plain(i), 30));
    (0..12).for_each(|i| {
        learns_alike::<RecurrentActorCritic, FusedRecurrentActorCritic>(Drawn::gru(i, 5, 13), 20)
    });
}

#[test]
fn every_instruction_set_learns_ppo_to_the_same_bits() {
    (0..30).for_each(|i| learns_the_same_bits::<FusedActorCritic>(Drawn::plain(i)));
    (0..12).for_each(|i| learns_the_same_bits::<FusedRecurrentActorCritic>(Drawn::gru(i, 5, 6)));
}
