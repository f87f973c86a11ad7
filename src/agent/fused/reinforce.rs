//! Updates of REINFORCE.

use std::io;

use crate::agent::fused::stack::{BLOCK, Room, Stack, blocks};
use crate::agent::policy::ActionNetwork;
use crate::agent::reinforce::{ReinforceEngine, Trajectories};
use crate::agent::{
    Resumable, StateError, StateReader, StateWriter, Weights, WeightsError, layers,
};
use crate::env::{Action, Observations};
use crate::kernel::{Adam, Aligned, Isa, math};
use crate::manifest::Reinforce;

/// A policy network in flat arrays.
#[derive(Clone, Debug)]
pub struct FusedPolicyNetwork {
    isa: Isa,
    stack: Stack,
    parameters: Aligned,
    room: Room,
}

impl FusedPolicyNetwork {
    /// A network with these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn new(
        parameters: &Reinforce,
        inputs: usize,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let stack = Stack::new(layers::policy(parameters, inputs), parameters.activation, 0);
        let mut flat = Aligned::zeros(stack.end());
        stack.load(weights, &mut flat)?;
        Ok(FusedPolicyNetwork { isa, room: stack.room(), stack, parameters: flat })
    }

    /// The weights, by name.
    pub fn weights(&self) -> Weights {
        self.named(&self.parameters)
    }

    /// Numbers that stand where the parameters do, by the names of the weights.
    fn named(&self, flat: &[f32]) -> Weights {
        let mut weights = Weights::default();
        self.stack.store(flat, &mut weights);
        weights
    }
}

impl ActionNetwork for FusedPolicyNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        out.clear();
        for rows in blocks(observations.rows()) {
            let count = rows.len() * Action::COUNT;
            let observations = (observations, rows);
            self.stack.forward(self.isa, &self.parameters, observations, &mut self.room);
            out.extend_from_slice(&self.room.outputs[..count]);
        }
    }
}

/// A policy network with its optimiser.
#[derive(Clone, Debug)]
pub struct FusedReinforce {
    network: FusedPolicyNetwork,
    gradient: Aligned,
    adam: Adam,
    loss_divisor: f64,
    /// Probabilities of the actions taken, then their logarithms, for [`BLOCK`] rows.
    likelihoods: [f64; BLOCK],
}

impl FusedReinforce {
    /// An engine that starts from these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &Reinforce,
        inputs: usize,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let network = FusedPolicyNetwork::new(parameters, inputs, weights, isa)?;
        Ok(FusedReinforce {
            gradient: Aligned::zeros(network.parameters.len()),
            adam: Adam::new(parameters.learning_rate, network.parameters.len()),
            network,
            loss_divisor: parameters.loss_divisor,
            likelihoods: [1.0; BLOCK],
        })
    }

    /// The gradient of the loss of trajectories, by the names of the weights.
    pub fn gradient(&mut self, trajectories: &Trajectories) -> Weights {
        self.gradient.fill(0.0);
        self.differentiate(trajectories);
        let gradient = self.network.named(&self.gradient);
        self.gradient.fill(0.0);
        gradient
    }

    /// The loss of trajectories; adds its gradient to the one in memory.
    fn differentiate(&mut self, trajectories: &Trajectories) -> f32 {
        let FusedReinforce { network, gradient, likelihoods, .. } = self;
        let FusedPolicyNetwork { isa, stack, parameters, room } = network;
        let scale = (1.0 / self.loss_divisor) as f32;
        let preferences = trajectories.preferences.as_chunks::<{ Action::COUNT }>().0;
        assert_eq!(preferences.len(), trajectories.actions.len(), "preferences for every action");
        stack.prepare(parameters, room);
        let mut loss = 0.0;
        for block in blocks(trajectories.actions.len()) {
            let observations = (&trajectories.observations, block.clone());
            stack.remember(*isa, parameters, observations.clone(), room);
            let count = block.len();
            let preferences = &preferences[block.clone()];
            let actions = &trajectories.actions[block.clone()];
            let returns = &trajectories.returns_to_go[block];
            for (i, row) in preferences.iter().enumerate() {
                let inverse = 1.0 / ((row[0] + row[1]) + (row[2] + row[3]));
                let weight = returns[i] * scale;
                let derivatives = &mut room.by_outputs[i * Action::COUNT..][..Action::COUNT];
                for (derivative, preference) in derivatives.iter_mut().zip(row) {
                    *derivative = weight * (preference * inverse);
                }
                let taken = actions[i].index();
                let likelihood = row[taken] * inverse;
                derivatives[taken] = weight * (likelihood - 1.0);
                likelihoods[i] = f64::from(likelihood);
            }
            math::ln_each(*isa, &mut likelihoods[..count]);
            let terms = likelihoods.iter().zip(returns);
            loss -= terms.map(|(ln, weight)| ln * f64::from(*weight)).sum::<f64>();
            stack.backward(*isa, parameters, observations, room, gradient);
        }
        (loss / self.loss_divisor) as f32
    }
}

impl ReinforceEngine for FusedReinforce {
    type Network = FusedPolicyNetwork;

    fn isa(&self) -> Isa {
        self.network.isa
    }

    fn logits(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.network.evaluate(observations, out);
    }

    fn update(&mut self, trajectories: &Trajectories) -> f32 {
        let loss = self.differentiate(trajectories);
        self.adam.update(self.network.isa, &mut self.network.parameters, &mut self.gradient);
        loss
    }

    fn network(&self) -> FusedPolicyNetwork {
        self.network.clone()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

impl Resumable for FusedReinforce {
    // The gradient is 0 between updates.
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.many(&self.network.parameters)?;
        self.adam.save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.fill(&mut self.network.parameters, "weights")?;
        self.adam.restore(from)
    }
}
