//! Tests of the dueling DQN with a GRU on both engines: against numbers from PyTorch
//! (`tests/data/torch/recurrent_dqn.json`), against finite differences, against each other, and of
//! the effects of padding and burn-in.

use std::ops::Range;

use serde_json::Value;

use crate::agent::burn::device;
use crate::agent::burn::{BurnNetwork, BurnQNetwork};
use crate::agent::dueling_dqn::{DuelingDqnEngine, Episodes, SequenceBatch, target};
use crate::agent::engine_tests::Random;
use crate::agent::policy::{ActionNetwork, best};
use crate::agent::reference_tests::{
    SHAPE, WIDTH, actions, assert_close, assert_finite_differences, assert_weights_close, cases,
    flags, gradients, name, numbers, observations, parameters, weights,
};
use crate::agent::replay::Transition;
use crate::agent::{
    Activation, BurnRecurrentDqn, DuelingDqn, FusedRecurrentDqn, Recurrent,
    RecurrentDuelingQNetwork, TerminalTarget, Weights, layers, orthogonal,
};
use crate::env::{EpisodeStatus, Observations};
use crate::kernel::Isa;

struct Case {
    name: String,
    case: Value,
    parameters: DuelingDqn,
    batch: SequenceBatch,
}

impl Case {
    fn all() -> Vec<Case> {
        let file = include_str!("../../tests/data/torch/recurrent_dqn.json");
        cases(file, "cases").into_iter().map(Case::new).collect()
    }

    fn new(case: Value) -> Case {
        let parameters = DuelingDqn { recurrent: Recurrent::Gru, ..parameters(&case) };
        let lanes = case["lanes"].as_u64().unwrap() as usize;
        let learned = flags(&case["learned"]);
        let batch = SequenceBatch {
            lanes,
            observations: observations(&case["observations"]),
            actions: actions(&case["actions"]),
            targets: numbers(&case["targets"]),
            firsts: (0..learned.len()).map(|row| row < lanes).collect(),
            cuts: flags(&case["cuts"]),
            learned,
        };
        Case { name: name(&case), case, parameters, batch }
    }

    fn weights(&self, which: &str) -> Weights {
        weights(&self.case[which])
    }

    fn burn(&self, which: &str) -> BurnRecurrentDqn {
        BurnRecurrentDqn::new(&self.parameters, SHAPE, &self.weights(which)).unwrap()
    }

    fn fused(&self, weights: &Weights, isa: Isa) -> FusedRecurrentDqn {
        FusedRecurrentDqn::new(&self.parameters, SHAPE, weights, isa).unwrap()
    }

    /// Acts along the sequences, evaluates them, and performs three updates.
    fn check<E: DuelingDqnEngine<Experience = Episodes>>(&self, engine: impl Fn(&str) -> E) {
        let mut network = engine("network");
        let lanes = self.batch.lanes;
        let mut memory = vec![0.0; lanes * network.memory()];
        let mut policy = network.network();
        let (mut values, mut all) = (Vec::new(), Vec::new());
        for step in 0..self.batch.rows() / lanes {
            let mut present = Observations::new(WIDTH, 0);
            present.extend(&self.batch.observations, step * lanes..(step + 1) * lanes);
            let mut of_policy = Vec::new();
            policy.recall(&present, &mut memory.clone(), &mut of_policy);
            network.values(&present, &mut memory, &mut values);
            assert_eq!(of_policy, values);
            all.extend_from_slice(&values);
        }
        assert_close(&all, &numbers(&self.case["q"]), 1e-5, &self.name);
        // The target network of a new engine starts with its weights.
        engine("target").target_values(&self.batch, &mut values);
        assert_close(&values, &numbers(&self.case["target_q"]), 1e-5, &self.name);
        let loss = network.update(&self.batch);
        assert_close(&[loss], &numbers(&self.case["loss"]), 1e-5, &self.name);
        network.update(&self.batch);
        network.update(&self.batch);
        let expected = self.weights("after_3_steps");
        assert_weights_close(&network.weights(), &expected, 3e-6, &self.name);
        // The target network does not change until it is renewed.
        network.target_values(&self.batch, &mut values);
        assert_close(&values, &numbers(&self.case["q"]), 1e-5, &self.name);
        network.renew_target();
        let before = values.clone();
        network.target_values(&self.batch, &mut values);
        assert_ne!(values, before);
    }
}

#[test]
fn both_engines_compute_the_recurrent_dqn_as_pytorch_does() {
    for case in Case::all() {
        case.check(|which| case.burn(which));
        for isa in Isa::available() {
            case.check(|which| case.fused(&case.weights(which), isa));
        }
    }
}

#[test]
fn targets_are_those_of_pytorch() {
    for case in Case::all() {
        let lanes = case.batch.lanes;
        let (rewards, running) = (numbers(&case.case["rewards"]), flags(&case.case["running"]));
        let next = numbers(&case.case["target_q"]);
        for row in (0..case.batch.rows()).filter(|row| case.batch.learned[*row]) {
            let status =
                if running[row] { EpisodeStatus::Running } else { EpisodeStatus::Terminated };
            let transition = Transition {
                action: case.batch.actions[row],
                reward: rewards[row],
                status,
                is_withheld: false,
            };
            let next = &next[(row + lanes) * 4..][..4];
            let best_next = next[best(next).index()];
            let gamma = case.parameters.gamma;
            let ours = target(&transition, best_next, gamma, TerminalTarget::Standard);
            assert_close(&[ours], &[case.batch.targets[row]], 1e-6, &case.name);
        }
    }
}

#[test]
fn gradients_of_the_recurrent_dqn_are_those_of_pytorch() {
    for case in Case::all() {
        let expected = case.weights("gradients");
        let device = device::training();
        let start = case.weights("network");
        let network =
            RecurrentDuelingQNetwork::from_weights(&case.parameters, SHAPE, &start, &device)
                .unwrap();
        let loss = network.loss(&case.batch);
        assert_weights_close(&gradients(&network, loss).weights(), &expected, 1e-5, &case.name);
        for isa in Isa::available() {
            let ours = case.fused(&start, isa).gradient(&case.batch);
            assert_weights_close(&ours, &expected, 1e-5, &case.name);
        }
    }
}

// Without cuts: finite differences of the loss include the path through the burn-in, which the
// gradient omits.
#[test]
fn gradients_of_the_recurrent_dqn_are_finite_differences() {
    for case in Case::all().iter_mut().filter(|case| case.name.contains("tanh")) {
        case.batch.cuts.fill(false);
        let start = case.weights("network");
        let gradients = case.fused(&start, Isa::chosen()).gradient(&case.batch);
        assert_finite_differences(&start, &gradients, &case.name, |weights| {
            case.fused(weights, Isa::chosen()).update(&case.batch)
        });
    }
}

/// Sequences of random numbers, with random lengths.
struct Drawn {
    parameters: DuelingDqn,
    random: Random,
}

impl Drawn {
    fn all() -> impl Iterator<Item = Drawn> {
        let layers: [&[u32]; 4] = [&[64], &[5, 3], &[16, 20, 7], &[33]];
        (0..12).map(move |i| Drawn {
            parameters: DuelingDqn {
                layers: layers[i % 4].to_vec(),
                layers_before_gru: 1 + u32::from(i % 4 == 2),
                activation: if i % 2 == 0 { Activation::Tanh } else { Activation::Relu },
                recurrent: Recurrent::Gru,
                units: [64, 3, 17, 16][i % 4],
                ..DuelingDqn::default()
            },
            random: Random::new(i, if i % 3 == 0 { 5 } else { 0 }, 8),
        })
    }

    fn weights(&self) -> Weights {
        let layers = layers::dueling_layers(&self.parameters, self.random.shape());
        orthogonal::initial(&layers, 1, 3).unwrap()
    }

    fn fused(&self, isa: Isa) -> FusedRecurrentDqn {
        FusedRecurrentDqn::new(&self.parameters, self.random.shape(), &self.weights(), isa).unwrap()
    }

    /// Sequences of 1 to `steps` steps that count, some behind a step of burn-in.
    fn batch(&mut self, lanes: usize, steps: usize) -> SequenceBatch {
        let mut below = |most: usize| self.random.stream.below(most as u32) as usize;
        let learned: Vec<Range<usize>> = (0..lanes)
            .map(|_| {
                let skipped = below(2);
                skipped..skipped + 1 + below(steps)
            })
            .collect();
        let flags = |is: fn(usize, &Range<usize>) -> bool| {
            (0..steps + 2).flat_map(|step| learned.iter().map(move |of| is(step, of))).collect()
        };
        let rows = lanes * (steps + 2);
        SequenceBatch {
            lanes,
            observations: self.random.observations(rows),
            actions: self.random.actions(rows),
            targets: self.random.many(rows, -1.0, 1.0),
            learned: flags(|step, learned| learned.contains(&step)),
            firsts: flags(|step, _| step == 0),
            cuts: flags(|step, learned| step > 0 && step == learned.start),
        }
    }
}

#[test]
fn the_fused_recurrent_dqn_learns_as_burns_does() {
    for (i, mut case) in Drawn::all().enumerate() {
        let (weights, shape, name) = (case.weights(), case.random.shape(), format!("case {i}"));
        let mut fused = case.fused(Isa::chosen());
        let mut burn = BurnRecurrentDqn::new(&case.parameters, shape, &weights).unwrap();
        for step in 0..20 {
            let batch = case.batch(1 + step % 7, 1 + step % 4);
            let [ours, theirs] = [fused.update(&batch), burn.update(&batch)];
            assert_close(&[ours], &[theirs], 1e-4, &name);
        }
        assert_weights_close(&fused.weights(), &burn.weights(), 1e-3, &name);
    }
}

#[test]
fn every_instruction_set_learns_the_recurrent_dqn_to_the_same_bits() {
    for mut case in Drawn::all() {
        let batch = case.batch(5, 6);
        let mut learned = Isa::available().into_iter().map(|isa| {
            let mut engine = case.fused(isa);
            let losses = [(); 3].map(|()| engine.update(&batch).to_bits());
            (losses, engine.weights().to_bytes())
        });
        let first = learned.next().unwrap();
        assert!(learned.all(|other| other == first));
    }
}

#[test]
fn longer_padding_changes_no_loss_and_no_gradient() {
    for mut case in Drawn::all() {
        let batch = case.batch(4, 5);
        let mut longer = batch.clone();
        let mut noise = case.batch(4, 2);
        noise.learned.fill(false);
        noise.firsts.fill(false);
        longer.observations.extend(&noise.observations, 0..noise.rows());
        longer.actions.append(&mut noise.actions);
        longer.targets.append(&mut noise.targets);
        longer.learned.append(&mut noise.learned);
        longer.firsts.append(&mut noise.firsts);
        longer.cuts.append(&mut noise.cuts);
        let mut engine = case.fused(Isa::chosen());
        let [ours, expected] = [&longer, &batch].map(|batch| engine.gradient(batch));
        assert_weights_close(&ours, &expected, 1e-6, "gradient");
        let mut other = case.fused(Isa::chosen());
        assert_eq!(engine.update(&longer), other.update(&batch));
    }
}
