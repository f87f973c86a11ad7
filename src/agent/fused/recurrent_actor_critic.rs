//! PPO's policy and value with a shared GRU.

use crate::agent::fused::network::FusedNetwork;
use crate::agent::fused::ppo_loss::{LossSums, Objective, PpoLoss, ROWS};
use crate::agent::fused::ppo_network::FusedPpoNetwork;
use crate::agent::fused::recurrent_network::RecurrentNetwork;
use crate::agent::fused::sequences::{Between, Through};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Losses, Minibatch, Ppo, Sequences};
use crate::agent::{Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Aligned, Isa};
use crate::state::resumable;

/// A policy and a value that share a GRU, in a flat array; as an [`ActionNetwork`] it is the
/// policy.
#[derive(Clone, Debug)]
pub struct FusedRecurrentActorCritic(RecurrentNetwork);

impl ActionNetwork for FusedRecurrentActorCritic {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        let mut memory = vec![0.0; observations.rows() * self.memory()];
        self.recall(observations, &mut memory, out);
    }

    fn memory(&self) -> usize {
        self.0.units()
    }

    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        out.clear();
        self.0.step(observations, memory, |logits, _| out.extend_from_slice(logits));
    }
}

resumable!([] FusedRecurrentActorCritic { fixed 0.parameters });

impl FusedNetwork for FusedRecurrentActorCritic {
    type Parameters = Ppo;

    fn from_weights(
        parameters: &Ppo,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let layers = layers::Recurrent::actor_critic(parameters, shape);
        RecurrentNetwork::new(layers, parameters.activation, weights, isa)
            .map(FusedRecurrentActorCritic)
    }

    fn isa(&self) -> Isa {
        self.0.isa
    }

    fn parameters(&self) -> &Aligned {
        &self.0.parameters
    }

    fn parameters_mut(&mut self) -> &mut Aligned {
        &mut self.0.parameters
    }

    fn named(&self, flat: &[f32]) -> Weights {
        self.0.layers.store(flat)
    }
}

impl FusedPpoNetwork for FusedRecurrentActorCritic {
    fn outputs(
        &mut self,
        observations: &Observations,
        memory: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    ) {
        logits.clear();
        values.clear();
        self.0.step(observations, memory, |of_actions, value| {
            logits.extend_from_slice(of_actions);
            values.push(value);
        });
    }

    fn differentiate(
        &mut self,
        minibatch: &Minibatch,
        objective: &Objective,
        loss: &mut PpoLoss,
        gradient: &mut [f32],
    ) -> Losses {
        let RecurrentNetwork { isa, layers, parameters, between } = &mut self.0;
        let sequences = minibatch.sequences.as_ref().expect("a network with memory has sequences");
        let Sequences { lanes, memory, firsts, .. } = sequences;
        let observations = &minibatch.observations;
        let through = Through { observations, lanes: *lanes, memory, firsts, cuts: &[] };
        layers.forward(*isa, parameters, through, between);
        let (rows, steps, width) = (minibatch.rows(), minibatch.steps(), layers.width());
        let Between { heads, by_heads, .. } = &mut *between;
        let (heads, by_heads) = (heads.known(rows * width), by_heads.of(rows * width));
        let mut sums = LossSums::default();
        let blocks = heads.chunks(ROWS * width).zip(by_heads.chunks_mut(ROWS * width));
        for (block, (heads, by_heads)) in blocks.enumerate() {
            let start = block * ROWS;
            loss.load(minibatch, start..start + heads.len() / width);
            loss.load_outputs(heads.chunks_exact(width).map(|row| layers.outputs(row)));
            sums.add(&loss.compute(*isa, objective, steps));
            by_heads.fill(0.0);
            loss.store(by_heads.chunks_exact_mut(width).map(|row| layers.outputs_mut(row)));
        }
        layers.backward(*isa, parameters, through, between, gradient);
        sums.losses(objective, steps)
    }
}
