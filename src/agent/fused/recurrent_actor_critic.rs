//! PPO's policy and value with a shared GRU.

use crate::agent::fused::ppo_loss::{Objective, PpoLoss, ROWS, Sums};
use crate::agent::fused::ppo_network::FusedPpoNetwork;
use crate::agent::fused::recurrent::RecurrentLayers;
use crate::agent::fused::recurrent_network::RecurrentNetwork;
use crate::agent::fused::sequences::{Between, Through};
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Losses, Minibatch, Ppo, Sequences};
use crate::agent::{Weights, WeightsError, layers};
use crate::env::{Action, Observations};
use crate::kernel::{Aligned, Isa};

/// A policy and a value that share a GRU, in a flat array; as an [`ActionNetwork`] it is the
/// policy.
#[derive(Clone, Debug)]
pub struct FusedRecurrentActorCritic(RecurrentNetwork);

impl FusedRecurrentActorCritic {
    /// Networks with these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn new(
        parameters: &Ppo,
        inputs: usize,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let layers = layers::Recurrent::actor_critic(parameters, inputs);
        RecurrentNetwork::new(layers, parameters.activation, weights, isa)
            .map(FusedRecurrentActorCritic)
    }
}

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

impl FusedPpoNetwork for FusedRecurrentActorCritic {
    fn from_weights(
        parameters: &Ppo,
        inputs: usize,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        FusedRecurrentActorCritic::new(parameters, inputs, weights, isa)
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
        let (mut logits, mut values) = ([0.0; ROWS * Action::COUNT], [0.0; ROWS]);
        let mut sums = Sums::default();
        let blocks = heads.chunks(ROWS * width).zip(by_heads.chunks_mut(ROWS * width));
        for (block, (heads, by_heads)) in blocks.enumerate() {
            let count = heads.len() / width;
            let (logits, values) = (&mut logits[..count * Action::COUNT], &mut values[..count]);
            let each = logits.chunks_exact_mut(Action::COUNT).zip(&mut *values);
            for ((logits, value), row) in each.zip(heads.chunks_exact(width)) {
                let outputs = RecurrentLayers::outputs(row);
                logits.copy_from_slice(outputs.0);
                *value = outputs.1;
            }
            loss.load(minibatch, block * ROWS..block * ROWS + count);
            loss.load_outputs(logits, values);
            sums.add(&loss.compute(*isa, objective, steps));
            loss.store(logits, values);
            let each = logits.chunks_exact(Action::COUNT).zip(&*values);
            for ((logits, value), row) in each.zip(by_heads.chunks_exact_mut(width)) {
                row.fill(0.0);
                row[..Action::COUNT].copy_from_slice(logits);
                row[Action::COUNT] = *value;
            }
        }
        layers.backward(*isa, parameters, through, between, gradient);
        sums.losses(objective, steps)
    }
}
