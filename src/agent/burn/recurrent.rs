//! Networks with a GRU, as Burn modules.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use crate::agent::burn::network::{
    Affine, BurnNetwork, HiddenLayers, affine, linear, store_linear,
};
use crate::agent::burn::{device, gates, input, matrix, values};
use crate::agent::layers::{self, Layer, Shape};
use crate::agent::weights::{Weights, WeightsError};
use crate::agent::{Activation, DuelingDqn, Ppo};
use crate::env::Observations;

/// A GRU between hidden layers, with a head for the actions and one for the state value.
///
/// **Source**: Cho et al., "Learning phrase representations using RNN encoder-decoder for
/// statistical machine translation", 2014, in PyTorch's form: the reset gate multiplies the output
/// of the linear layer on the state, bias included, instead of the state itself.
#[derive(Module, Debug)]
pub(super) struct GruLayers {
    trunk: HiddenLayers,
    gru_input: Linear,
    gru_hidden: Linear,
    trunk_after: HiddenLayers,
    actions: Linear,
    value: Linear,
}

/// The number of steps whose input is computed at once. A larger block takes fewer operations, but
/// Burn makes the gradient of each step's slice as large as the block.
const STEPS_PER_BLOCK: usize = 4;

/// Sequences of observations, side by side.
pub(super) struct Unrolled<'a> {
    pub(super) observations: &'a Observations,
    /// The number of sequences.
    pub(super) lanes: usize,
    /// \[lanes, units\]: the states before the first step; `None` for zeros.
    pub(super) memory: Option<&'a [f32]>,
    /// \[rows\]: whether a step is the first of an episode, at which the state is zero.
    pub(super) firsts: &'a [bool],
    /// \[rows\]: whether no gradient passes from a step to the step before; empty if all gradients
    /// pass.
    pub(super) cuts: &'a [bool],
}

impl GruLayers {
    fn from_weights(
        layers: &layers::Recurrent,
        activation: Activation,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let hidden =
            |layers: &[Layer]| HiddenLayers::from_weights(layers, activation, weights, device);
        Ok(GruLayers {
            trunk: hidden(&layers.before)?,
            gru_input: linear(&layers.gru[0], weights, device)?,
            gru_hidden: linear(&layers.gru[1], weights, device)?,
            trunk_after: hidden(&layers.after)?,
            actions: linear(&layers.heads[0], weights, device)?,
            value: linear(&layers.heads[1], weights, device)?,
        })
    }

    /// Units of the GRU.
    pub(super) fn units(&self) -> usize {
        self.gru_hidden.weight.dims()[0]
    }

    /// Advances the memory of episodes, \[rows, units\], by one step; returns the new states.
    pub(super) fn recalled(&self, observations: &Observations, memory: &mut [f32]) -> Tensor<2> {
        let device = device::inference();
        let states = matrix(memory.to_vec(), observations.rows(), &device);
        let states = self.step(input(observations, &device), states);
        memory.copy_from_slice(&values(&states));
        states
    }

    /// The states after observations, given the states before.
    ///
    /// **Shapes**: \[rows, width\] and \[rows, units\] to \[rows, units\].
    fn step(&self, observations: Tensor<2>, states: Tensor<2>) -> Tensor<2> {
        let from_input = self.contribution(observations);
        let from_state = affine(&self.gru_hidden, states.clone());
        gates::step(from_input, from_state, states)
    }

    /// What observations contribute to the gates, \[rows, 3 units\].
    fn contribution(&self, observations: Tensor<2>) -> Tensor<2> {
        affine(&self.gru_input, self.trunk.forward(observations))
    }

    /// The states after every step of sequences, \[rows, units\].
    pub(super) fn unroll(&self, sequences: &Unrolled<'_>, device: &Device) -> Tensor<2> {
        let Unrolled { observations, lanes, memory, firsts, cuts } = *sequences;
        assert_eq!(observations.rows() % lanes, 0, "whole steps");
        let written = observations.written_out();
        let width = written.len() / observations.rows();
        let blocks = written.chunks(STEPS_PER_BLOCK * lanes * width).flat_map(|block| {
            let rows = block.len() / width;
            let from_input = self.contribution(matrix(block.to_vec(), rows, device));
            let starts = (0..rows).step_by(lanes);
            starts.map(move |start| from_input.clone().narrow(0, start, lanes))
        });
        let gru_hidden = Affine::new(&self.gru_hidden, lanes);
        let zeros = || vec![0.0; lanes * self.units()];
        let mut states = matrix(memory.map_or_else(zeros, <[f32]>::to_vec), lanes, device);
        let marked = |marks: &[bool]| {
            let marks = marks.iter().map(|mark| f32::from(*mark)).collect();
            matrix(marks, lanes, device)
        };
        let each = blocks.enumerate().map(|(step, from_input)| {
            let rows = step * lanes..(step + 1) * lanes;
            let firsts = &firsts[rows.clone()];
            if firsts.contains(&true) {
                let kept: Vec<bool> = firsts.iter().map(|first| !first).collect();
                states = states.clone() * marked(&kept);
            }
            if let Some(cuts) = cuts.get(rows).filter(|cuts| cuts.contains(&true)) {
                let cut = marked(cuts);
                let passed = cut.clone().neg().add_scalar(1.0);
                states = states.clone() * passed + states.clone().detach() * cut;
            }
            let from_state = gru_hidden.forward(states.clone());
            states = gates::step(from_input, from_state, states.clone());
            states.clone()
        });
        Tensor::cat(each.collect(), 0)
    }

    /// The outputs of the heads in states.
    ///
    /// **Shapes**: \[rows, units\] to \[rows, actions\] and \[rows, 1\].
    pub(super) fn heads(&self, states: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
        let shared = self.trunk_after.forward(states);
        (affine(&self.actions, shared.clone()), affine(&self.value, shared))
    }

    /// The weights by name; `actions` names the head for the actions.
    fn weights(&self, actions: &str) -> Weights {
        let mut weights = Weights::default();
        self.trunk.store("trunk", &mut weights);
        self.trunk_after.store("trunk_after", &mut weights);
        store_linear("gru_input", &self.gru_input, &mut weights);
        store_linear("gru_hidden", &self.gru_hidden, &mut weights);
        store_linear(actions, &self.actions, &mut weights);
        store_linear("value", &self.value, &mut weights);
        weights
    }
}

/// A policy and a state value that share a GRU between hidden layers.
#[derive(Module, Debug)]
pub struct RecurrentActorCritic {
    pub(super) layers: GruLayers,
}

impl BurnNetwork for RecurrentActorCritic {
    type Parameters = Ppo;

    fn from_weights(
        parameters: &Ppo,
        shape: Shape,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let layers = layers::Recurrent::actor_critic(parameters, shape);
        let layers = GruLayers::from_weights(&layers, parameters.activation, weights, device)?;
        Ok(RecurrentActorCritic { layers })
    }

    fn weights(&self) -> Weights {
        self.layers.weights("logits")
    }
}

/// Action values Q = V + A - mean A behind a GRU.
#[derive(Module, Debug)]
pub struct RecurrentDuelingQNetwork {
    pub(super) layers: GruLayers,
}

impl BurnNetwork for RecurrentDuelingQNetwork {
    type Parameters = DuelingDqn;

    fn from_weights(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
        device: &Device,
    ) -> Result<Self, WeightsError> {
        let layers = layers::Recurrent::dueling(parameters, shape);
        let layers = GruLayers::from_weights(&layers, parameters.activation, weights, device)?;
        Ok(RecurrentDuelingQNetwork { layers })
    }

    fn weights(&self) -> Weights {
        self.layers.weights("advantage")
    }
}

impl RecurrentDuelingQNetwork {
    /// Action values in states.
    ///
    /// **Shapes**: \[rows, units\] to \[rows, actions\].
    pub(super) fn values(&self, states: Tensor<2>) -> Tensor<2> {
        let (advantage, value) = self.layers.heads(states);
        value + advantage.clone() - advantage.mean_dim(1)
    }
}
