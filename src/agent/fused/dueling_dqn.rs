//! Updates of the dueling DQN.

use std::ops::Range;

use crate::agent::DuelingDqn;
use crate::agent::dueling_dqn::{DuelingDqnEngine, Experience, Transitions};
use crate::agent::fused::network::FusedNetwork;
use crate::agent::fused::stack::{StackLayout, Workspace, blocks};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::replay::Batch;
use crate::agent::{Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Adam, Aligned, Isa};
use crate::state::resumable;

/// A dueling network in flat arrays.
#[derive(Clone, Debug)]
pub struct FusedDuelingNetwork {
    isa: Isa,
    /// One stack with the outputs V, A_0, A_1 …, or one stack for V and one for the advantages.
    stacks: Vec<StackLayout>,
    parameters: Aligned,
    workspaces: Vec<Workspace>,
    actions: usize,
}

impl FusedDuelingNetwork {
    fn forward(&mut self, observations: &Observations, rows: Range<usize>) {
        for (stack, workspace) in self.stacks.iter().zip(&mut self.workspaces) {
            stack.forward(self.isa, &self.parameters, (observations, rows.clone()), workspace);
        }
    }

    /// Sets the derivatives by the outputs of a row, given the derivative by the value of one
    /// action.
    fn derive_outputs(&mut self, row: usize, action: usize, by_value: f32) {
        let (last, mean) = (self.stacks.len() - 1, 1.0 / self.actions as f32);
        self.workspaces[0].by_outputs[row * self.stacks[0].outputs()] = by_value;
        let end = (row + 1) * self.stacks[last].outputs();
        let by_advantages = &mut self.workspaces[last].by_outputs[end - self.actions..end];
        for (other, by_advantage) in by_advantages.iter_mut().enumerate() {
            *by_advantage = by_value * (f32::from(u8::from(other == action)) - mean);
        }
    }

    /// V and the advantages of a row after [`FusedDuelingNetwork::forward`].
    fn streams(&self, row: usize) -> (f32, &[f32]) {
        let outputs = |stack: usize| {
            let width = self.stacks[stack].outputs();
            &self.workspaces[stack].outputs[row * width..(row + 1) * width]
        };
        let last = outputs(self.stacks.len() - 1);
        (outputs(0)[0], &last[last.len() - self.actions..])
    }
}

/// Q = V + A - mean A, \[actions\].
pub(super) fn action_values((value, advantages): (f32, &[f32])) -> impl Iterator<Item = f32> {
    let mean = mean_of(advantages);
    advantages.iter().map(move |advantage| value + (advantage - mean))
}

/// Q of one action; see [`action_values`].
pub(super) fn action_value((value, advantages): (f32, &[f32]), action: usize) -> f32 {
    value + (advantages[action] - mean_of(advantages))
}

fn mean_of(advantages: &[f32]) -> f32 {
    advantages.iter().sum::<f32>() * (1.0 / advantages.len() as f32)
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

/// A network that the dueling DQN trains, in a flat array.
pub trait FusedQNetwork: FusedNetwork<Parameters = DuelingDqn> {
    /// What the network learns from.
    type Experience: Experience;

    /// Replaces `out` by the action values in the states of a batch, \[rows, actions\].
    fn values(&mut self, states: &StatesOf<Self>, out: &mut Vec<f32>);

    /// Returns the loss of a batch and adds its gradient to `gradient`.
    fn differentiate(&mut self, batch: &BatchOf<Self>, gradient: &mut [f32]) -> f32;
}

type BatchOf<N> = <<N as FusedQNetwork>::Experience as Experience>::Batch;
type StatesOf<N> = <<N as FusedQNetwork>::Experience as Experience>::States;

resumable!([] FusedDuelingNetwork { fixed parameters });

impl FusedNetwork for FusedDuelingNetwork {
    type Parameters = DuelingDqn;

    fn from_weights(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let mut stacks: Vec<StackLayout> = Vec::new();
        for layers in layers::dueling(parameters, shape) {
            let start = stacks.last().map_or(0, StackLayout::end);
            stacks.push(StackLayout::new(layers, parameters.activation, start));
        }
        let mut flat = Aligned::zeros(stacks.last().map_or(0, StackLayout::end));
        for stack in &stacks {
            stack.load(weights, &mut flat)?;
        }
        let workspaces = stacks.iter().map(StackLayout::workspace).collect();
        Ok(FusedDuelingNetwork {
            isa,
            stacks,
            parameters: flat,
            workspaces,
            actions: shape.actions,
        })
    }

    fn isa(&self) -> Isa {
        self.isa
    }

    fn parameters(&self) -> &Aligned {
        &self.parameters
    }

    fn parameters_mut(&mut self) -> &mut Aligned {
        &mut self.parameters
    }

    fn named(&self, flat: &[f32]) -> Weights {
        let mut weights = Weights::default();
        self.stacks.iter().for_each(|stack| stack.store(flat, &mut weights));
        weights
    }
}

impl FusedQNetwork for FusedDuelingNetwork {
    type Experience = Transitions;

    fn values(&mut self, states: &Observations, out: &mut Vec<f32>) {
        self.evaluate(states, out);
    }

    fn differentiate(&mut self, batch: &Batch, gradient: &mut [f32]) -> f32 {
        let rows = batch.actions.len();
        for (stack, workspace) in self.stacks.iter().zip(&mut self.workspaces) {
            stack.prepare(&self.parameters, workspace);
        }
        let mut squares = 0.0;
        for block in blocks(rows) {
            self.forward(&batch.observations, block.clone());
            for (row, position) in block.clone().enumerate() {
                let action = batch.actions[position].index();
                let error = action_value(self.streams(row), action) - batch.targets[position];
                squares += f64::from(error) * f64::from(error);
                self.derive_outputs(row, action, 2.0 * error / rows as f32);
            }
            for (stack, workspace) in self.stacks.iter().zip(&mut self.workspaces) {
                let observations = (&batch.observations, block.clone());
                stack.backward(self.isa, &self.parameters, observations, workspace, gradient);
            }
        }
        (squares / rows as f64) as f32
    }
}

/// A dueling network with its target network and its optimiser.
#[derive(Clone, Debug)]
pub struct FusedDuelingDqn<N = FusedDuelingNetwork> {
    network: N,
    target: N,
    gradient: Aligned,
    adam: Adam,
}

impl<N: FusedQNetwork> FusedDuelingDqn<N> {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &DuelingDqn,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let network = N::from_weights(parameters, shape, weights, isa)?;
        let numbers = network.parameters().len();
        Ok(FusedDuelingDqn {
            gradient: Aligned::zeros(numbers),
            adam: Adam::new(parameters.learning_rate, numbers),
            target: network.clone(),
            network,
        })
    }

    /// The gradient of the loss of a batch, by the names of the weights.
    pub fn gradient(&mut self, batch: &BatchOf<N>) -> Weights {
        self.gradient.fill(0.0);
        self.network.differentiate(batch, &mut self.gradient);
        let gradient = self.network.named(&self.gradient);
        self.gradient.fill(0.0);
        gradient
    }
}

impl<N: FusedQNetwork> DuelingDqnEngine for FusedDuelingDqn<N> {
    type Network = N;
    type Experience = N::Experience;

    fn memory(&self) -> usize {
        self.network.memory()
    }

    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        self.network.recall(observations, memory, out);
    }

    fn target_values(&mut self, states: &StatesOf<N>, out: &mut Vec<f32>) {
        self.target.values(states, out);
    }

    fn renew_target(&mut self) {
        self.target.parameters_mut().copy_from_slice(self.network.parameters());
    }

    fn update(&mut self, batch: &BatchOf<N>) -> f32 {
        let loss = self.network.differentiate(batch, &mut self.gradient);
        let isa = self.network.isa();
        self.adam.update(isa, self.network.parameters_mut(), &mut self.gradient);
        loss
    }

    fn network(&self) -> N {
        self.network.clone()
    }

    fn weights(&self) -> Weights {
        self.network.weights()
    }
}

// The gradient is not saved, because it is 0 between updates.
resumable!([N: FusedQNetwork] FusedDuelingDqn<N> { parts adam, network, target });
