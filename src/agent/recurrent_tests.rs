//! Tests of PPO with a GRU on both engines: against numbers from PyTorch
//! (`tests/data/torch/ppo.json`), against finite differences, against each other, and of the
//! effects of padding and resets.

use crate::agent::burn::BurnNetwork;
use crate::agent::burn::device;
use crate::agent::engine_tests::actions;
use crate::agent::layers::Shape;
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Minibatch, Ppo, PpoEngine, Sequences};
use crate::agent::ppo_tests::{Case, SHAPE, WIDTH, cases, flags, parts};
use crate::agent::reference_tests::{
    assert_close, assert_finite_differences, assert_weights_close, gradients, numbers, weights,
};
use crate::agent::{
    Activation, BurnPpo, FusedPpo, FusedRecurrentActorCritic, Recurrent, RecurrentActorCritic,
    Weights, layers, orthogonal,
};
use crate::env::{Action, Observations};
use crate::kernel::Isa;
use crate::rng::{Purpose, Stream};

fn recurrent_cases() -> Vec<Case> {
    let cases = cases("recurrent").into_iter().map(|case| {
        let mut case = Case::new(case);
        case.parameters.recurrent = Recurrent::Gru;
        case.parameters.units = case.case["units"].as_u64().unwrap() as u32;
        case.parameters.layers_before_gru = case.case["layers_before_gru"].as_u64().unwrap() as u32;
        case.minibatch.sequences = Some(Sequences {
            lanes: case.case["states"].as_array().unwrap().len(),
            memory: numbers(&case.case["states"]),
            firsts: flags(&case.case["firsts"]),
            real: flags(&case.case["real"]),
        });
        case
    });
    cases.collect()
}

fn network(parameters: &Ppo, shape: Shape, weights: &Weights) -> RecurrentActorCritic {
    RecurrentActorCritic::from_weights(parameters, shape, weights, &device::training()).unwrap()
}

fn burn(parameters: &Ppo, shape: Shape, weights: &Weights) -> BurnPpo<RecurrentActorCritic> {
    BurnPpo::new(parameters, network(parameters, shape, weights))
}

fn fused(
    parameters: &Ppo,
    shape: Shape,
    weights: &Weights,
    isa: Isa,
) -> FusedPpo<FusedRecurrentActorCritic> {
    FusedPpo::new(parameters, shape, weights, isa).unwrap()
}

/// Acts along the sequences, then performs three updates.
fn check(case: &Case, mut engine: impl PpoEngine) {
    let sequences = case.minibatch.sequences.as_ref().unwrap();
    let (lanes, units) = (sequences.lanes, engine.memory());
    let mut memory = sequences.memory.clone();
    let (mut logits, mut values, mut states) = (Vec::new(), Vec::new(), Vec::new());
    let mut policy = engine.network();
    for step in 0..case.minibatch.rows() / lanes {
        let rows = step * lanes..(step + 1) * lanes;
        let firsts = &sequences.firsts[rows.clone()];
        let each = memory.chunks_exact_mut(units).zip(firsts);
        each.filter(|(_, first)| **first).for_each(|(memory, _)| memory.fill(0.0));
        let mut observations = Observations::new(WIDTH, 0);
        observations.extend(&case.minibatch.observations, rows);
        let (mut of_actions, mut of_states, mut of_policy) = (Vec::new(), Vec::new(), Vec::new());
        policy.recall(&observations, &mut memory.clone(), &mut of_policy);
        engine.evaluate(&observations, &mut memory, &mut of_actions, &mut of_states);
        assert_eq!(of_policy, of_actions);
        logits.extend(of_actions);
        values.extend(of_states);
        states.extend_from_slice(&memory);
    }
    assert_close(&states, &numbers(&case.case["states_after"]), 1e-5, &case.name);
    assert_close(&logits, &numbers(&case.case["logits"]), 1e-5, &case.name);
    assert_close(&values, &numbers(&case.case["state_values"]), 1e-5, &case.name);
    let losses = engine.update(&case.minibatch, case.parameters.learning_rate);
    let expected = ["loss", "policy", "value", "entropy", "approx_kl"]
        .map(|name| numbers(&case.case["losses"][name])[0]);
    assert_close(&parts(losses), &expected, 1e-6, &case.name);
    engine.update(&case.minibatch, case.parameters.learning_rate);
    engine.update(&case.minibatch, case.parameters.learning_rate);
    let expected = weights(&case.case["after_3_steps"]);
    assert_weights_close(&engine.weights(), &expected, 3e-6, &case.name);
}

#[test]
fn both_engines_compute_the_gru_as_pytorch_does() {
    for case in recurrent_cases() {
        check(&case, burn(&case.parameters, SHAPE, &case.start()));
        for isa in Isa::available() {
            check(&case, fused(&case.parameters, SHAPE, &case.start(), isa));
        }
    }
}

#[test]
fn gradients_through_the_gru_are_those_of_pytorch() {
    for case in recurrent_cases() {
        let expected = weights(&case.case["gradients"]);
        let network = network(&case.parameters, SHAPE, &case.start());
        let loss = BurnPpo::loss(&network, &case.minibatch, &case.parameters).loss;
        assert_weights_close(&gradients(&network, loss).weights(), &expected, 1e-5, &case.name);
        for isa in Isa::available() {
            let mut engine = fused(&case.parameters, SHAPE, &case.start(), isa);
            let ours = engine.gradient(&case.minibatch);
            assert_weights_close(&ours, &expected, 1e-5, &case.name);
        }
    }
}

// Five steps, with a reset in the middle of one lane. The limits of the ratio are too wide for any
// step to cross.
#[test]
fn gradients_through_the_gru_are_finite_differences() {
    for case in recurrent_cases().iter().filter(|case| case.name.contains("tanh")) {
        let parameters = Ppo { clip: 10.0, ..case.parameters.clone() };
        let mut engine = fused(&parameters, SHAPE, &case.start(), Isa::chosen());
        let gradients = engine.gradient(&case.minibatch);
        assert_finite_differences(&case.start(), &gradients, &case.name, |weights| {
            let mut engine = fused(&parameters, SHAPE, weights, Isa::chosen());
            engine.update(&case.minibatch, 0.0).loss
        });
    }
}

/// Sequences of random numbers.
struct Drawn {
    parameters: Ppo,
    width: usize,
    one_hot: usize,
    actions: usize,
    stream: Stream,
}

impl Drawn {
    fn new(i: u64) -> Drawn {
        let layers: [&[u32]; 4] = [&[64], &[5, 3], &[16, 20, 7], &[33]];
        Drawn {
            parameters: Ppo {
                layers: layers[i as usize % 4].to_vec(),
                layers_before_gru: 1 + u32::from(i % 4 == 2),
                activation: if i.is_multiple_of(2) { Activation::Tanh } else { Activation::Relu },
                recurrent: Recurrent::Gru,
                units: [64, 3, 17, 16][i as usize % 4],
                ..Ppo::default()
            },
            width: 2 + i as usize % 3,
            one_hot: if i.is_multiple_of(3) { 5 } else { 0 },
            actions: actions(i as usize, 8),
            stream: Stream::new(i, Purpose::Replay),
        }
    }

    fn all() -> impl Iterator<Item = Drawn> {
        (0..12).map(Drawn::new)
    }

    fn shape(&self) -> Shape {
        Shape { inputs: self.width + self.one_hot, actions: self.actions }
    }

    fn weights(&self) -> Weights {
        orthogonal::initial(&layers::ppo(&self.parameters, self.shape()), 1, 3).unwrap()
    }

    fn many(&mut self, count: usize, low: f64, high: f64) -> Vec<f32> {
        (0..count).map(|_| (low + (high - low) * self.stream.unit()) as f32).collect()
    }

    /// Sequences in which episodes begin at random steps.
    fn minibatch(&mut self, lanes: usize, steps: usize) -> Minibatch {
        let rows = lanes * steps;
        let mut observations = Observations::new(self.width, self.one_hot);
        for _ in 0..rows {
            let row = self.many(self.width, -1.0, 1.0);
            let moment = (self.one_hot > 0).then(|| self.stream.below(self.one_hot as u32));
            observations.push(&row, moment);
        }
        let units = self.parameters.units as usize;
        Minibatch {
            observations,
            actions: (0..rows).map(|_| Action::uniform(self.stream.bits(), self.actions)).collect(),
            chosen: (0..rows).map(|_| self.stream.below(4) > 0).collect(),
            log_probabilities: self.many(rows, -1.6, -1.2),
            values: self.many(rows, -1.0, 1.0),
            advantages: self.many(rows, -2.0, 2.0),
            returns: self.many(rows, 0.0, 5.0),
            sequences: Some(Sequences {
                lanes,
                memory: self.many(lanes * units, -0.5, 0.5),
                firsts: (0..rows).map(|_| self.stream.below(4) == 0).collect(),
                real: vec![true; rows],
            }),
        }
    }
}

#[test]
fn fused_ppo_with_a_gru_learns_as_burns_does() {
    for (i, mut case) in Drawn::all().enumerate() {
        let (weights, shape, name) = (case.weights(), case.shape(), format!("case {i}"));
        let mut fused = fused(&case.parameters, shape, &weights, Isa::chosen());
        let mut burn = burn(&case.parameters, shape, &weights);
        let minibatch = case.minibatch(5, 13);
        let network = network(&case.parameters, shape, &weights);
        let loss = BurnPpo::loss(&network, &minibatch, &case.parameters).loss;
        let expected = gradients(&network, loss).weights();
        assert_weights_close(&fused.gradient(&minibatch), &expected, 1e-5, &name);
        for step in 0..20 {
            // Sizes vary, so that buffers are reused.
            let minibatch = case.minibatch(1 + step % 7, 1 + step % 4);
            let [ours, theirs] = [fused.update(&minibatch, 1e-3), burn.update(&minibatch, 1e-3)];
            assert_close(&parts(ours), &parts(theirs), 1e-4, &name);
        }
        assert_weights_close(&fused.weights(), &burn.weights(), 1e-3, &name);
    }
}

#[test]
fn every_instruction_set_learns_the_gru_to_the_same_bits() {
    for mut case in Drawn::all() {
        let (weights, shape) = (case.weights(), case.shape());
        let minibatch = case.minibatch(5, 6);
        let mut learned = Isa::available().into_iter().map(|isa| {
            let mut engine = fused(&case.parameters, shape, &weights, isa);
            let losses = [(); 3].map(|()| engine.update(&minibatch, 1e-3).loss.to_bits());
            (losses, engine.weights().to_bytes())
        });
        let first = learned.next().unwrap();
        assert!(learned.all(|other| other == first));
    }
}

/// The losses and the gradient of a minibatch.
fn learned(case: &Drawn, minibatch: &Minibatch) -> ([f32; 5], Weights) {
    let weights = case.weights();
    let mut engine = fused(&case.parameters, case.shape(), &weights, Isa::chosen());
    let gradient = engine.gradient(minibatch);
    (parts(engine.update(minibatch, 0.0)), gradient)
}

#[test]
fn longer_padding_changes_nothing() {
    for i in 0..8 {
        let mut case = Drawn::new(i);
        let (lanes, steps) = (3, 6);
        let mut whole = case.minibatch(lanes, steps + 4);
        let rows = lanes * steps;
        // The last four steps do not count.
        whole.sequences.as_mut().unwrap().real[rows..].fill(false);
        let mut cut = whole.clone();
        cut.observations.clear();
        cut.observations.extend(&whole.observations, 0..rows);
        cut.actions.truncate(rows);
        cut.chosen.truncate(rows);
        cut.log_probabilities.truncate(rows);
        let sequences = cut.sequences.as_mut().unwrap();
        sequences.firsts.truncate(rows);
        sequences.real.truncate(rows);
        let ((losses, gradient), (expected, other)) =
            (learned(&case, &whole), learned(&case, &cut));
        assert_close(&losses, &expected, 1e-6, "losses");
        assert_weights_close(&gradient, &other, 1e-6, "padding");
    }
}

#[test]
fn two_episodes_in_one_lane_are_the_two_apart() {
    for i in 0..8 {
        let mut case = Drawn::new(i);
        let mut both = case.minibatch(1, 9);
        let sequences = both.sequences.as_mut().unwrap();
        sequences.firsts.fill(false);
        (sequences.firsts[0], sequences.firsts[4]) = (true, true);
        let (losses, gradient) = learned(&case, &both);
        let part = |rows: std::ops::Range<usize>| {
            let mut part = both.clone();
            part.observations.clear();
            part.observations.extend(&both.observations, rows.clone());
            let cut = |numbers: &[f32]| numbers[rows.clone()].to_vec();
            part.actions = both.actions[rows.clone()].to_vec();
            part.chosen = both.chosen[rows.clone()].to_vec();
            part.log_probabilities = cut(&both.log_probabilities);
            part.values = cut(&both.values);
            part.advantages = cut(&both.advantages);
            part.returns = cut(&both.returns);
            let sequences = part.sequences.as_mut().unwrap();
            // An episode that begins must ignore the memory before it.
            sequences.memory.fill(9.0);
            sequences.firsts = vec![false; rows.len()];
            sequences.firsts[0] = true;
            sequences.real = vec![true; rows.len()];
            learned(&case, &part)
        };
        let (first, second) = (part(0..4), part(4..9));
        let mean = |a: f32, b: f32| (4.0 * a + 5.0 * b) / 9.0;
        let expected: [f32; 5] = std::array::from_fn(|i| mean(first.0[i], second.0[i]));
        assert_close(&losses, &expected, 1e-6, "losses");
        let mut expected = first.1.clone();
        for (name, tensor) in &mut expected.tensors {
            let other = &second.1.tensors[name].values;
            tensor.values.iter_mut().zip(other).for_each(|(a, b)| *a = mean(*a, *b));
        }
        assert_weights_close(&gradient, &expected, 1e-5, "gradient");
    }
}
