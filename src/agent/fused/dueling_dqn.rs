//! Updates of the dueling DQN.

use std::io;
use std::ops::Range;

use crate::agent::DuelingDqn;
use crate::agent::dueling_dqn::DuelingDqnEngine;
use crate::agent::fused::stack::{Stack, Workspace, blocks};
use crate::agent::policy::ActionNetwork;
use crate::agent::replay::Batch;
use crate::agent::{Weights, WeightsError, layers};
use crate::env::{Action, Observations};
use crate::kernel::{Adam, Aligned, Isa};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// A dueling network in flat arrays.
#[derive(Clone, Debug)]
pub struct FusedDuelingNetwork {
    isa: Isa,
    /// One stack with the outputs V, A_0 … A_3, or one stack for V and one for the advantages.
    stacks: Vec<Stack>,
    parameters: Aligned,
    workspaces: Vec<Workspace>,
}

impl FusedDuelingNetwork {
    /// A network with these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn new(
        parameters: &DuelingDqn,
        inputs: usize,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let mut stacks: Vec<Stack> = Vec::new();
        for layers in layers::dueling(parameters, inputs) {
            let start = stacks.last().map_or(0, Stack::end);
            stacks.push(Stack::new(layers, parameters.activation, start));
        }
        let mut flat = Aligned::zeros(stacks.last().map_or(0, Stack::end));
        for stack in &stacks {
            stack.load(weights, &mut flat)?;
        }
        let workspaces = stacks.iter().map(Stack::workspace).collect();
        Ok(FusedDuelingNetwork { isa, stacks, parameters: flat, workspaces })
    }

    /// The weights, by name.
    pub fn weights(&self) -> Weights {
        self.named(&self.parameters)
    }

    /// The values of a flat array laid out like the parameters, by the names of the weights.
    fn named(&self, flat: &[f32]) -> Weights {
        let mut weights = Weights::default();
        self.stacks.iter().for_each(|stack| stack.store(flat, &mut weights));
        weights
    }

    fn forward(&mut self, observations: &Observations, rows: Range<usize>) {
        for (stack, workspace) in self.stacks.iter().zip(&mut self.workspaces) {
            stack.forward(self.isa, &self.parameters, (observations, rows.clone()), workspace);
        }
    }

    /// Sets the derivatives by the outputs of a row, given the derivative by the value of one
    /// action.
    fn derive_outputs(&mut self, row: usize, action: usize, by_value: f32) {
        let last = self.stacks.len() - 1;
        let mut set = |stack: usize, from: usize, derivatives: &[f32]| {
            let at = row * self.stacks[stack].outputs() + from;
            self.workspaces[stack].by_outputs[at..at + derivatives.len()]
                .copy_from_slice(derivatives);
        };
        set(0, 0, &[by_value]);
        let by_advantages: [f32; Action::COUNT] = std::array::from_fn(|other| {
            by_value * (f32::from(u8::from(other == action)) - 1.0 / Action::COUNT as f32)
        });
        set(last, if last == 0 { 1 } else { 0 }, &by_advantages);
    }

    /// V and the advantages of a row after [`FusedDuelingNetwork::forward`].
    fn streams(&self, row: usize) -> (f32, &[f32]) {
        let outputs = |stack: usize| {
            let width = self.stacks[stack].outputs();
            &self.workspaces[stack].outputs[row * width..(row + 1) * width]
        };
        let last = outputs(self.stacks.len() - 1);
        (outputs(0)[0], &last[last.len() - Action::COUNT..])
    }
}

/// Q = V + A - mean A, \[actions\].
pub(super) fn action_values((value, advantages): (f32, &[f32])) -> [f32; Action::COUNT] {
    let mean = advantages.iter().sum::<f32>() * (1.0 / Action::COUNT as f32);
    std::array::from_fn(|action| value + (advantages[action] - mean))
}

impl ActionNetwork for FusedDuelingNetwork {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        out.clear();
        for rows in blocks(observations.rows()) {
            self.forward(observations, rows.clone());
            out.extend((0..rows.len()).flat_map(|row| action_values(self.streams(row))));
        }
    }
}

/// A dueling network with its target network and its optimiser.
#[derive(Clone, Debug)]
pub struct FusedDuelingDqn {
    network: FusedDuelingNetwork,
    target: FusedDuelingNetwork,
    gradient: Aligned,
    adam: Adam,
}

impl FusedDuelingDqn {
    /// An engine that starts from these weights, for observations of `inputs` entries.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        inputs: usize,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let network = FusedDuelingNetwork::new(parameters, inputs, weights, isa)?;
        Ok(FusedDuelingDqn {
            gradient: Aligned::zeros(network.parameters.len()),
            adam: Adam::new(parameters.learning_rate, network.parameters.len()),
            target: network.clone(),
            network,
        })
    }

    /// The gradient of the loss of a batch, by the names of the weights.
    pub fn gradient(&mut self, batch: &Batch) -> Weights {
        self.gradient.fill(0.0);
        self.differentiate(batch);
        let gradient = self.network.named(&self.gradient);
        self.gradient.fill(0.0);
        gradient
    }

    /// Returns the loss of a batch and adds its gradient to the stored gradient.
    fn differentiate(&mut self, batch: &Batch) -> f32 {
        let FusedDuelingDqn { network, gradient, .. } = self;
        let rows = batch.actions.len();
        for (stack, workspace) in network.stacks.iter().zip(&mut network.workspaces) {
            stack.prepare(&network.parameters, workspace);
        }
        let mut squares = 0.0;
        for block in blocks(rows) {
            network.forward(&batch.observations, block.clone());
            for (row, position) in block.clone().enumerate() {
                let action = batch.actions[position].index();
                let error = action_values(network.streams(row))[action] - batch.targets[position];
                squares += f64::from(error) * f64::from(error);
                network.derive_outputs(row, action, 2.0 * error / rows as f32);
            }
            for (stack, workspace) in network.stacks.iter().zip(&mut network.workspaces) {
                let observations = (&batch.observations, block.clone());
                stack.backward(network.isa, &network.parameters, observations, workspace, gradient);
            }
        }
        (squares / rows as f64) as f32
    }
}

impl DuelingDqnEngine for FusedDuelingDqn {
    type Network = FusedDuelingNetwork;

    fn values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.network.evaluate(observations, out);
    }

    fn target_values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        self.target.evaluate(observations, out);
    }

    fn renew_target(&mut self) {
        self.target.parameters.copy_from_slice(&self.network.parameters);
    }

    fn update(&mut self, batch: &Batch) -> f32 {
        let loss = self.differentiate(batch);
        self.adam.update(self.network.isa, &mut self.network.parameters, &mut self.gradient);
        loss
    }

    fn network(&self) -> FusedDuelingNetwork {
        self.network.clone()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

impl Resumable for FusedDuelingDqn {
    // The gradient is not saved, because it is 0 between updates.
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.many(&self.network.parameters)?;
        out.many(&self.target.parameters)?;
        self.adam.save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        from.fill(&mut self.network.parameters, "weights")?;
        from.fill(&mut self.target.parameters, "weights")?;
        self.adam.restore(from)
    }
}
