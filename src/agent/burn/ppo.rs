//! Updates of PPO.

use burn::tensor::{Device, Tensor, activation};

use crate::agent::Weights;
use crate::agent::burn::network::BurnNetwork;
use crate::agent::burn::recurrent::Unrolled;
use crate::agent::burn::trainer::Trainer;
use crate::agent::burn::{
    ActorCritic, RecurrentActorCritic, column, device, input, matrix, numbers,
};
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{ADAM_EPSILON, Losses, Minibatch, Ppo, PpoEngine, Sequences};
use crate::env::Observations;
use crate::state::resumable;

/// A module that PPO trains.
pub trait BurnActorCritic: BurnNetwork<Parameters = Ppo> {
    /// Logits, \[rows, actions\], and values, \[rows, 1\], of the next observations of episodes;
    /// `memory` is as in [`ActionNetwork::recall`].
    fn outputs(&self, observations: &Observations, memory: &mut [f32]) -> (Tensor<2>, Tensor<2>);

    /// Logits and values as in [`BurnActorCritic::outputs`] for the rows of a minibatch. A network
    /// with memory replays their sequences.
    fn replay(&self, minibatch: &Minibatch, device: &Device) -> (Tensor<2>, Tensor<2>);
}

/// The policy and value networks with their optimiser.
pub struct BurnPpo<N = ActorCritic> {
    network: Trainer<N>,
    parameters: Ppo,
}

/// The loss and its parts, each a tensor of one element.
pub struct LossTensors {
    /// The loss that is minimised.
    pub loss: Tensor<1>,
    /// See [`Losses::policy`].
    pub policy: Tensor<1>,
    /// See [`Losses::value`].
    pub value: Tensor<1>,
    /// See [`Losses::entropy`].
    pub entropy: Tensor<1>,
    /// See [`Losses::approx_kl`].
    pub approx_kl: Tensor<1>,
}

impl<N: BurnActorCritic> BurnPpo<N> {
    /// An engine that starts from this network.
    pub fn new(parameters: &Ppo, network: N) -> Self {
        BurnPpo {
            network: Trainer::with_epsilon(network, parameters.learning_rate, ADAM_EPSILON.into()),
            parameters: parameters.clone(),
        }
    }

    /// The loss of a minibatch.
    pub fn loss(network: &N, minibatch: &Minibatch, parameters: &Ppo) -> LossTensors {
        let device = device::training();
        let rows = minibatch.rows();
        let column_of = |numbers: &[f32]| matrix(numbers.to_vec(), rows, &device);
        let steps = minibatch.steps() as f64;
        let real = minibatch.sequences.as_ref().map(|sequences| {
            let real: Vec<f32> = sequences.real.iter().map(|real| f32::from(*real)).collect();
            column_of(&real)
        });
        // The mean over the steps that count.
        let mean = |numbers: Tensor<2>| match &real {
            Some(real) => (numbers * real.clone()).sum().div_scalar(steps),
            None => numbers.mean(),
        };
        let withheld = minibatch.chosen.contains(&false).then(|| {
            let chosen: Vec<f32> =
                minibatch.chosen.iter().map(|chosen| f32::from(*chosen)).collect();
            column_of(&chosen)
        });
        // The same, with 0 for steps at which the agent did not choose.
        let mean_of_choices = |numbers: Tensor<2>| match &withheld {
            Some(chosen) => mean(numbers * chosen.clone()),
            None => mean(numbers),
        };
        let (logits, values) = network.replay(minibatch, &device);

        let logs = activation::log_softmax(logits, 1);
        let entropy = mean_of_choices((logs.clone().exp() * logs.clone()).sum_dim(1)).neg();
        let chosen = logs.gather(1, column(&minibatch.actions, &device));
        let log_ratio = chosen - column_of(&minibatch.log_probabilities);
        let ratio = log_ratio.clone().exp();
        let approx_kl = match &withheld {
            None => mean(ratio.clone() - log_ratio).sub_scalar(1.0),
            Some(_) => mean_of_choices((ratio.clone() - log_ratio).sub_scalar(1.0)),
        };
        let losses = column_of(&minibatch.advantages).neg();
        let bounded = ratio.clone().clamp(1.0 - parameters.clip, 1.0 + parameters.clip);
        let policy = mean_of_choices((ratio * losses.clone()).max_pair(bounded * losses));

        let returns = column_of(&minibatch.returns);
        let squares = (values.clone() - returns.clone()).square();
        let squares = if parameters.clip_value_loss {
            let old = column_of(&minibatch.values);
            let moved = (values - old.clone()).clamp(-parameters.clip, parameters.clip);
            squares.max_pair((old + moved - returns).square())
        } else {
            squares
        };
        let value = mean(squares).mul_scalar(0.5);

        let loss = policy.clone() - entropy.clone().mul_scalar(parameters.ent_coef)
            + value.clone().mul_scalar(parameters.vf_coef);
        LossTensors { loss, policy, value, entropy, approx_kl }
    }
}

impl<N: BurnActorCritic> PpoEngine for BurnPpo<N> {
    type Network = N;

    fn memory(&self) -> usize {
        self.network.module().memory()
    }

    fn evaluate(
        &mut self,
        observations: &Observations,
        memory: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    ) {
        let (of_actions, of_states) = self.network.evaluated().outputs(observations, memory);
        *logits = numbers(of_actions);
        *values = numbers(of_states);
    }

    fn update(&mut self, minibatch: &Minibatch, learning_rate: f64) -> Losses {
        let found = BurnPpo::loss(self.network.module(), minibatch, &self.parameters);
        let losses = Losses {
            loss: found.loss.clone().into_scalar(),
            policy: found.policy.into_scalar(),
            value: found.value.into_scalar(),
            entropy: found.entropy.into_scalar(),
            approx_kl: found.approx_kl.into_scalar(),
        };
        if losses.loss.is_finite() {
            self.network.set_learning_rate(learning_rate);
            self.network.step(&found.loss, Some(self.parameters.max_grad_norm as f32));
        }
        losses
    }

    fn network(&self) -> N {
        self.network.module().valid()
    }

    fn weights(&self) -> Weights {
        self.network.module().weights()
    }
}

impl BurnActorCritic for ActorCritic {
    fn outputs(&self, observations: &Observations, _: &mut [f32]) -> (Tensor<2>, Tensor<2>) {
        self.forward(input(observations, &device::inference()))
    }

    fn replay(&self, minibatch: &Minibatch, device: &Device) -> (Tensor<2>, Tensor<2>) {
        self.forward(input(&minibatch.observations, device))
    }
}

impl ActionNetwork for ActorCritic {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        *out = numbers(self.logits(input(observations, &device::inference())));
    }
}

impl BurnActorCritic for RecurrentActorCritic {
    fn outputs(&self, observations: &Observations, memory: &mut [f32]) -> (Tensor<2>, Tensor<2>) {
        self.layers.heads(self.layers.recalled(observations, memory))
    }

    fn replay(&self, minibatch: &Minibatch, device: &Device) -> (Tensor<2>, Tensor<2>) {
        let sequences = minibatch.sequences.as_ref().expect("a network with memory has sequences");
        let Sequences { lanes, memory, firsts, .. } = sequences;
        let sequences = Unrolled {
            observations: &minibatch.observations,
            lanes: *lanes,
            memory: Some(memory),
            firsts,
            cuts: &[],
        };
        self.layers.heads(self.layers.unroll(&sequences, device))
    }
}

impl ActionNetwork for RecurrentActorCritic {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.recall(observations, &mut vec![0.0; observations.rows() * self.layers.units()], out);
    }

    fn memory(&self) -> usize {
        self.layers.units()
    }

    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        *out = numbers(self.outputs(observations, memory).0);
    }
}

resumable!([N: BurnActorCritic] BurnPpo<N> { parts network });
