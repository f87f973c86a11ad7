//! Tests of the kernels' engines against Burn's engines, and of the instruction sets against each
//! other.

use crate::agent::burn::device;
use crate::agent::burn::{BurnNetwork, BurnQNetwork};
use crate::agent::dueling_dqn::DuelingDqnEngine;
use crate::agent::layers::Shape;
use crate::agent::reference_tests::{assert_weights_close, gradients, sampled_by};
use crate::agent::reinforce::{ReinforceEngine, Trajectories};
use crate::agent::replay::Batch;
use crate::agent::{Activation, DuelingDqn, Reinforce, Trunk};
use crate::agent::{
    BurnDuelingDqn, BurnReinforce, DuelingQNetwork, FusedDuelingDqn, FusedDuelingNetwork,
    FusedReinforce, PolicyNetwork, Weights, layers,
};
use crate::env::{Action, Observations};
use crate::kernel::Isa;
use crate::rng::{Purpose, Stream};

/// Random numbers for networks of a shape.
pub(super) struct Random {
    width: usize,
    one_hot: usize,
    actions: usize,
    pub(super) stream: Stream,
}

impl Random {
    /// The numbers of case `i`: with four actions, and with other numbers of actions for the cases
    /// from `others` on.
    pub(super) fn new(i: usize, one_hot: usize, others: usize) -> Self {
        Random {
            width: 2 + i % 3,
            one_hot,
            actions: if i < others { 4 } else { [2, 3, 7, 20][i % 4] },
            stream: Stream::new(i as u64, Purpose::Replay),
        }
    }

    pub(super) fn shape(&self) -> Shape {
        Shape { inputs: self.width + self.one_hot, actions: self.actions }
    }

    pub(super) fn many(&mut self, count: usize, low: f64, high: f64) -> Vec<f32> {
        (0..count).map(|_| (low + (high - low) * self.stream.unit()) as f32).collect()
    }

    pub(super) fn observations(&mut self, rows: usize) -> Observations {
        let mut observations = Observations::new(self.width, self.one_hot);
        for _ in 0..rows {
            let row = self.many(self.width, -1.0, 1.0);
            let moment = (self.one_hot > 0).then(|| self.stream.below(self.one_hot as u32));
            observations.push(&row, moment);
        }
        observations
    }

    pub(super) fn actions(&mut self, rows: usize) -> Vec<Action> {
        (0..rows).map(|_| Action::uniform(self.stream.bits(), self.actions)).collect()
    }
}

/// A random case. Some sizes fill whole registers, others do not.
struct Case {
    layers: Vec<u32>,
    activation: Activation,
    trunk: Trunk,
    rows: usize,
    random: Random,
}

impl Case {
    fn all() -> impl Iterator<Item = Case> {
        let sizes: [&[u32]; 7] =
            [&[128, 128], &[128], &[1], &[17, 5, 33], &[64, 200], &[3, 3], &[16]];
        let rows = [64, 1, 7, 65, 130, 16, 50];
        (0..34).map(move |i| Case {
            layers: sizes[i % 7].to_vec(),
            activation: if i % 2 == 0 { Activation::Relu } else { Activation::Tanh },
            trunk: if i % 4 < 2 { Trunk::Shared } else { Trunk::Separate },
            rows: rows[(i / 7 + i) % 7],
            random: Random::new(i, if i % 3 == 0 { 9 } else { 0 }, 28),
        })
    }

    fn name(&self) -> String {
        let Case { layers, activation, trunk, rows, random } = self;
        format!("{layers:?} {activation:?} {trunk:?}, {:?}, {rows} rows", random.shape())
    }

    /// Random values of the magnitude of returns.
    fn returns(&mut self) -> Vec<f32> {
        self.random.many(self.rows, 0.0, 200.0)
    }

    fn batch(&mut self) -> Batch {
        let (observations, actions) =
            (self.random.observations(self.rows), self.random.actions(self.rows));
        Batch { observations, actions, targets: self.returns() }
    }

    fn trajectories(&mut self) -> Trajectories {
        let (observations, actions) =
            (self.random.observations(self.rows), self.random.actions(self.rows));
        let preferences = Vec::new();
        Trajectories { observations, actions, preferences, returns_to_go: self.returns() }
    }

    fn dueling_dqn(&self) -> DuelingDqn {
        DuelingDqn {
            layers: self.layers.clone(),
            activation: self.activation,
            trunk: self.trunk,
            ..DuelingDqn::default()
        }
    }

    fn reinforce(&self) -> Reinforce {
        Reinforce {
            layers: self.layers.clone(),
            activation: self.activation,
            ..Reinforce::default()
        }
    }
}

/// Asserts that every array is off by at most 1e-3 of its norm. Single weights may be off by more,
/// because Adam makes full steps even for gradients near 0.
fn assert_arrays_close(ours: &Weights, theirs: &Weights, what: &str) {
    for (name, tensor) in &ours.tensors {
        let expected = &theirs.tensors[name].values;
        let length = |values: &mut dyn Iterator<Item = f32>| {
            values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt()
        };
        let off = length(&mut tensor.values.iter().zip(expected).map(|(a, b)| a - b));
        let all = length(&mut expected.iter().copied());
        assert!(off <= 1e-3 * all.max(1e-3), "{what}, {name}: off by {off} of {all}");
    }
}

#[test]
fn fused_dueling_dqns_learn_as_burns_do() {
    for mut case in Case::all() {
        let (parameters, shape) = (case.dueling_dqn(), case.random.shape());
        let weights = layers::draw(&layers::dueling(&parameters, shape), &mut case.random.stream);
        let batch = case.batch();
        let device = device::training();
        let network = DuelingQNetwork::from_weights(&parameters, shape, &weights, &device).unwrap();
        let expected = gradients(&network, network.loss(&batch)).weights();
        let mut burn = BurnDuelingDqn::new(&parameters, shape, &weights).unwrap();
        let mut fused = FusedDuelingDqn::<FusedDuelingNetwork>::new(
            &parameters,
            shape,
            &weights,
            Isa::chosen(),
        )
        .unwrap();
        assert_weights_close(&fused.gradient(&batch), &expected, 1e-5, &case.name());
        let batches: Vec<Batch> = (0..10).map(|_| case.batch()).collect();
        (0..100).for_each(|i| assert!(burn.update(&batches[i % 10]).is_finite()));
        (0..100).for_each(|i| assert!(fused.update(&batches[i % 10]).is_finite()));
        assert_arrays_close(&fused.weights(), &burn.weights(), &case.name());
    }
}

#[test]
fn fused_policies_learn_as_burns_do() {
    for mut case in Case::all() {
        let (parameters, shape) = (case.reinforce(), case.random.shape());
        let weights = layers::draw(&[layers::policy(&parameters, shape)], &mut case.random.stream);
        let trajectories = case.trajectories();
        let device = device::training();
        let network = PolicyNetwork::from_weights(&parameters, shape, &weights, &device).unwrap();
        let loss = BurnReinforce::loss(&network, &trajectories, parameters.loss_divisor);
        let expected = gradients(&network, loss).weights();
        let mut burn = BurnReinforce::new(&parameters, shape, &weights).unwrap();
        let mut fused = FusedReinforce::new(&parameters, shape, &weights, Isa::chosen()).unwrap();
        let sampled = sampled_by(&mut fused, &trajectories);
        assert_weights_close(&fused.gradient(&sampled), &expected, 1e-5, &case.name());
        let samples: Vec<Trajectories> = (0..10).map(|_| case.trajectories()).collect();
        (0..100).for_each(|i| assert!(burn.update(&samples[i % 10]).is_finite()));
        for i in 0..100 {
            let sampled = sampled_by(&mut fused, &samples[i % 10]);
            assert!(fused.update(&sampled).is_finite());
        }
        assert_arrays_close(&fused.weights(), &burn.weights(), &case.name());
    }
}

#[test]
fn every_instruction_set_learns_the_same_bits() {
    for mut case in Case::all() {
        let (dqn, reinforce, shape) = (case.dueling_dqn(), case.reinforce(), case.random.shape());
        let q_weights = layers::draw(&layers::dueling(&dqn, shape), &mut case.random.stream);
        let p_weights = layers::draw(&[layers::policy(&reinforce, shape)], &mut case.random.stream);
        let (batch, trajectories) = (case.batch(), case.trajectories());
        let mut learned = Isa::available().into_iter().map(|isa| {
            let mut q =
                FusedDuelingDqn::<FusedDuelingNetwork>::new(&dqn, shape, &q_weights, isa).unwrap();
            let mut p = FusedReinforce::new(&reinforce, shape, &p_weights, isa).unwrap();
            let losses: Vec<u32> = (0..3)
                .flat_map(|_| {
                    let sampled = sampled_by(&mut p, &trajectories);
                    [q.update(&batch), p.update(&sampled)]
                })
                .map(f32::to_bits)
                .collect();
            (isa.name(), losses, q.weights().to_bytes(), p.weights().to_bytes())
        });
        let (_, losses, q, p) = learned.next().unwrap();
        for (isa, other_losses, other_q, other_p) in learned {
            assert_eq!(other_losses, losses, "{isa}: {}", case.name());
            assert!(other_q == q && other_p == p, "{isa}: {}", case.name());
        }
    }
}
