//! Tests of PPO on both engines: against numbers from PyTorch (`tests/data/torch/ppo.json`),
//! against finite differences, against each other, and on every instruction set.

use serde_json::Value;

use crate::agent::burn::BurnNetwork;
use crate::agent::burn::device;
use crate::agent::engine_tests::actions;
use crate::agent::layers::Shape;
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Losses, Minibatch, Ppo, PpoEngine, advantages};
use crate::agent::reference_tests::{
    assert_close, assert_finite_differences, assert_weights_close, evaluated, gradients, numbers,
    observations, weights,
};
use crate::agent::{
    Activation, ActorCritic, BurnPpo, FusedActorCritic, FusedPpo, Weights, layers, orthogonal,
};
use crate::env::{Action, Observations};
use crate::kernel::Isa;
use crate::rng::{Purpose, Stream};

pub(super) const WIDTH: usize = 3;
pub(super) const SHAPE: Shape = Shape { inputs: WIDTH, actions: 4 };

pub(super) fn cases(name: &str) -> Vec<Value> {
    let reference: Value =
        serde_json::from_str(include_str!("../../tests/data/torch/ppo.json")).unwrap();
    reference[name].as_array().unwrap().clone()
}

fn burn(parameters: &Ppo, shape: Shape, weights: &Weights) -> BurnPpo<ActorCritic> {
    let network = ActorCritic::from_weights(parameters, shape, weights, &device::training());
    BurnPpo::new(parameters, network.unwrap())
}

pub(super) fn flags(value: &Value) -> Vec<bool> {
    numbers(value).into_iter().map(|number| number != 0.0).collect()
}

#[test]
fn advantages_are_those_of_cleanrl() {
    for case in cases("advantages") {
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

pub(super) fn parts(losses: Losses) -> [f32; 5] {
    let Losses { loss, policy, value, entropy, approx_kl } = losses;
    [loss, policy, value, entropy, approx_kl]
}

/// A case with PyTorch's numbers.
pub(super) struct Case {
    pub(super) name: String,
    pub(super) case: Value,
    pub(super) parameters: Ppo,
    pub(super) minibatch: Minibatch,
}

impl Case {
    fn all() -> Vec<Case> {
        cases("feed_forward").into_iter().map(Case::new).collect()
    }

    pub(super) fn new(case: Value) -> Case {
        let number = |name: &str| case[name].as_f64().unwrap();
        let parameters = Ppo {
            layers: serde_json::from_value(case["layers"].clone()).unwrap(),
            activation: Activation::named(case["activation"].as_str().unwrap()).unwrap(),
            learning_rate: number("learning_rate"),
            clip: number("clip"),
            clip_value_loss: case["clip_value_loss"].as_bool().unwrap(),
            ent_coef: number("ent_coef"),
            vf_coef: number("vf_coef"),
            max_grad_norm: number("max_grad_norm"),
            ..Ppo::default()
        };
        let actions = numbers(&case["actions"]).into_iter();
        let minibatch = Minibatch {
            observations: observations(&case["observations"]),
            actions: actions.map(|a| Action::from_index(a as usize).unwrap()).collect(),
            chosen: vec![true; numbers(&case["log_probabilities"]).len()],
            log_probabilities: numbers(&case["log_probabilities"]),
            values: numbers(&case["values"]),
            advantages: numbers(&case["advantages"]),
            returns: numbers(&case["returns"]),
            sequences: None,
        };
        let name = case["name"].as_str().unwrap().to_owned();
        Case { name, case, parameters, minibatch }
    }

    fn network(&self, weights: &Weights) -> ActorCritic {
        ActorCritic::from_weights(&self.parameters, SHAPE, weights, &device::training()).unwrap()
    }

    pub(super) fn start(&self) -> Weights {
        weights(&self.case["network"])
    }

    fn check(&self, mut engine: impl PpoEngine) {
        let (mut logits, mut values) = (Vec::new(), Vec::new());
        engine.evaluate(&self.minibatch.observations, &mut [], &mut logits, &mut values);
        assert_close(&logits, &numbers(&self.case["logits"]), 1e-5, &self.name);
        assert_close(&values, &numbers(&self.case["state_values"]), 1e-5, &self.name);
        assert_eq!(evaluated(engine.network(), &self.minibatch.observations), logits);
        let rate = self.parameters.learning_rate;
        let losses = engine.update(&self.minibatch, rate);
        // Compared together, because the loss is a difference of parts of magnitude 1.
        let expected = ["loss", "policy", "value", "entropy", "approx_kl"]
            .map(|name| numbers(&self.case["losses"][name])[0]);
        assert_close(&parts(losses), &expected, 1e-6, &self.name);
        engine.update(&self.minibatch, rate);
        engine.update(&self.minibatch, rate);
        let expected = weights(&self.case["after_3_steps"]);
        assert_weights_close(&engine.weights(), &expected, 2e-6, &self.name);
    }
}

#[test]
fn both_engines_compute_ppo_as_pytorch_does() {
    for case in Case::all() {
        case.check(burn(&case.parameters, SHAPE, &case.start()));
        for isa in Isa::available() {
            case.check(
                FusedPpo::<FusedActorCritic>::new(&case.parameters, SHAPE, &case.start(), isa)
                    .unwrap(),
            );
        }
    }
}

#[test]
fn gradients_of_ppo_are_those_of_pytorch() {
    for case in Case::all() {
        let expected = weights(&case.case["gradients"]);
        let network = case.network(&case.start());
        let loss = BurnPpo::loss(&network, &case.minibatch, &case.parameters).loss;
        assert_weights_close(&gradients(&network, loss).weights(), &expected, 1e-5, &case.name);
        for isa in Isa::available() {
            let mut engine =
                FusedPpo::<FusedActorCritic>::new(&case.parameters, SHAPE, &case.start(), isa)
                    .unwrap();
            let ours = engine.gradient(&case.minibatch);
            assert_weights_close(&ours, &expected, 1e-5, &case.name);
        }
    }
}

// Only tanh networks: a finite difference across the kink of a ReLU is not a derivative. The same
// holds for a limit of the ratio, so the limits are set too wide for any step to cross.
#[test]
fn gradients_of_ppo_are_finite_differences() {
    for case in Case::all().iter().filter(|case| case.name.contains("tanh")) {
        let mut parameters = case.parameters.clone();
        (parameters.clip, parameters.clip_value_loss) = (10.0, false);
        let mut engine =
            FusedPpo::<FusedActorCritic>::new(&parameters, SHAPE, &case.start(), Isa::chosen())
                .unwrap();
        let gradients = engine.gradient(&case.minibatch);
        assert_finite_differences(&case.start(), &gradients, &case.name, |weights| {
            let engine =
                FusedPpo::<FusedActorCritic>::new(&parameters, SHAPE, weights, Isa::chosen());
            engine.unwrap().update(&case.minibatch, 0.0).loss
        });
    }
}

/// A random case. Some sizes fill whole registers, others do not.
struct Drawn {
    parameters: Ppo,
    width: usize,
    one_hot: usize,
    actions: usize,
    rows: usize,
    stream: Stream,
}

impl Drawn {
    fn all() -> impl Iterator<Item = Drawn> {
        let sizes: [&[u32]; 6] = [&[64, 64], &[1], &[17, 5, 33], &[128], &[3, 3], &[16]];
        let rows = [64, 1, 7, 65, 130, 50];
        (0..30).map(move |i| Drawn {
            parameters: Ppo {
                layers: sizes[i % 6].to_vec(),
                activation: if i % 2 == 0 { Activation::Tanh } else { Activation::Relu },
                clip_value_loss: i % 3 == 0,
                ..Ppo::default()
            },
            width: 2 + i % 3,
            one_hot: if i % 4 == 0 { 9 } else { 0 },
            actions: actions(i, 24),
            rows: rows[(i / 6 + i) % 6],
            stream: Stream::new(i as u64, Purpose::Replay),
        })
    }

    fn name(&self) -> String {
        let Ppo { layers, activation, .. } = &self.parameters;
        format!(
            "{layers:?} {activation:?}, {} + {} inputs, {} actions",
            self.width, self.one_hot, self.actions
        )
    }

    fn shape(&self) -> Shape {
        Shape { inputs: self.width + self.one_hot, actions: self.actions }
    }

    fn weights(&self) -> Weights {
        let layers = layers::ppo(&self.parameters, self.shape());
        orthogonal::initial(&layers, 1, self.rows as u64).unwrap()
    }

    fn many(&mut self, low: f64, high: f64) -> Vec<f32> {
        (0..self.rows).map(|_| (low + (high - low) * self.stream.unit()) as f32).collect()
    }

    fn minibatch(&mut self) -> Minibatch {
        let mut observations = Observations::new(self.width, self.one_hot);
        for _ in 0..self.rows {
            let row: Vec<f32> =
                (0..self.width).map(|_| 2.0 * self.stream.unit() as f32 - 1.0).collect();
            let moment = (self.one_hot > 0).then(|| self.stream.below(self.one_hot as u32));
            observations.push(&row, moment);
        }
        Minibatch {
            observations,
            actions: (0..self.rows)
                .map(|_| Action::uniform(self.stream.bits(), self.actions))
                .collect(),
            chosen: (0..self.rows).map(|_| self.stream.below(4) > 0).collect(),
            log_probabilities: self.many(-2.0, -1.0),
            values: self.many(-1.0, 1.0),
            advantages: self.many(-2.0, 2.0),
            returns: self.many(0.0, 10.0),
            sequences: None,
        }
    }
}

#[test]
fn fused_ppo_learns_as_burns_does() {
    for mut case in Drawn::all() {
        let (weights, shape, name) = (case.weights(), case.shape(), case.name());
        let mut burn = burn(&case.parameters, shape, &weights);
        let mut fused =
            FusedPpo::<FusedActorCritic>::new(&case.parameters, shape, &weights, Isa::chosen())
                .unwrap();
        let minibatch = case.minibatch();
        let device = device::training();
        let network =
            ActorCritic::from_weights(&case.parameters, shape, &weights, &device).unwrap();
        let loss = BurnPpo::loss(&network, &minibatch, &case.parameters).loss;
        let expected = gradients(&network, loss).weights();
        assert_weights_close(&fused.gradient(&minibatch), &expected, 1e-5, &name);
        for _ in 0..30 {
            let minibatch = case.minibatch();
            let [ours, theirs]: [Losses; 2] =
                [fused.update(&minibatch, 1e-3), burn.update(&minibatch, 1e-3)];
            assert_close(&parts(ours), &parts(theirs), 1e-4, &name);
        }
        assert_weights_close(&fused.weights(), &burn.weights(), 1e-3, &name);
    }
}

#[test]
fn every_instruction_set_learns_ppo_to_the_same_bits() {
    for mut case in Drawn::all() {
        let (weights, shape) = (case.weights(), case.shape());
        let minibatch = case.minibatch();
        let mut learned = Isa::available().into_iter().map(|isa| {
            let mut engine =
                FusedPpo::<FusedActorCritic>::new(&case.parameters, shape, &weights, isa).unwrap();
            let losses = [(); 3].map(|()| engine.update(&minibatch, 1e-3).loss.to_bits());
            let mut logits = Vec::new();
            engine.network().evaluate(&minibatch.observations, &mut logits);
            let logits: Vec<u32> = logits.into_iter().map(f32::to_bits).collect();
            (losses, logits, engine.weights().to_bytes())
        });
        let first = learned.next().unwrap();
        assert!(learned.all(|other| other == first), "{}", case.name());
    }
}
