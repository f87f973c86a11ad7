//! Updates of REINFORCE.

use pulp::{Simd, WithSimd};

use crate::agent::Reinforce;
use crate::agent::fused::stack::{BLOCK, StackLayout, Workspace, blocks};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::reinforce::{ReinforceEngine, Trajectories};
use crate::agent::{Weights, WeightsError};
use crate::env::{Action, Observations};
use crate::kernel::{Adam, Aligned, Isa, LANES, math};
use crate::state::resumable;

/// A policy network in flat arrays.
#[derive(Clone, Debug)]
pub struct FusedPolicyNetwork {
    isa: Isa,
    stack: StackLayout,
    parameters: Aligned,
    workspace: Workspace,
}

impl FusedPolicyNetwork {
    /// A network with these weights, of this shape.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub fn new(
        parameters: &Reinforce,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let stack = StackLayout::new(layers::policy(parameters, shape), parameters.activation, 0);
        let mut flat = Aligned::zeros(stack.end());
        stack.load(weights, &mut flat)?;
        Ok(FusedPolicyNetwork { isa, workspace: stack.workspace(), stack, parameters: flat })
    }

    /// The weights, by name.
    pub fn weights(&self) -> Weights {
        self.named(&self.parameters)
    }

    /// The values of a flat array laid out like the parameters, by the names of the weights.
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
            let count = rows.len() * self.stack.outputs();
            let observations = (observations, rows);
            self.stack.forward(self.isa, &self.parameters, observations, &mut self.workspace);
            out.extend_from_slice(&self.workspace.outputs[..count]);
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
    /// Buffer for the probabilities of the actions taken, then for their logarithms.
    likelihoods: [f64; BLOCK],
}

impl FusedReinforce {
    /// An engine that starts from these weights, of this shape.
    ///
    /// **Errors**: the weights do not fit the network.
    pub fn new(
        parameters: &Reinforce,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let network = FusedPolicyNetwork::new(parameters, shape, weights, isa)?;
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

    /// Returns the loss of trajectories and adds its gradient to the stored gradient.
    fn differentiate(&mut self, trajectories: &Trajectories) -> f32 {
        let FusedReinforce { network, gradient, likelihoods, .. } = self;
        let FusedPolicyNetwork { isa, stack, parameters, workspace } = network;
        let scale = (1.0 / self.loss_divisor) as f32;
        let (count, width) = (trajectories.actions.len(), stack.outputs());
        assert_eq!(trajectories.preferences.len(), count * width, "preferences for every action");
        stack.prepare(parameters, workspace);
        let mut loss = 0.0;
        for block in blocks(count) {
            let observations = (&trajectories.observations, block.clone());
            stack.remember(*isa, parameters, observations.clone(), workspace);
            loss += isa.run(Likelihoods {
                preferences: &trajectories.preferences[block.start * width..block.end * width],
                actions: &trajectories.actions[block.clone()],
                returns: &trajectories.returns_to_go[block],
                scale,
                derivatives: &mut workspace.by_outputs,
                likelihoods,
            });
            stack.backward(*isa, parameters, observations, workspace, gradient);
        }
        (loss / self.loss_divisor) as f32
    }
}

/// Computes the loss of steps, before division, from the likelihoods of their actions, and the
/// derivatives of the divided loss by the logits.
///
/// **Shapes**: `preferences` is \[rows, actions\], `actions` and `returns` are \[rows\]; `derivatives`, by row and
/// action, and `likelihoods` have room for [`BLOCK`] rows.
struct Likelihoods<'a> {
    preferences: &'a [f32],
    actions: &'a [Action],
    returns: &'a [f32],
    /// 1 / the loss divisor.
    scale: f32,
    derivatives: &'a mut [f32],
    likelihoods: &'a mut [f64; BLOCK],
}

impl WithSimd for Likelihoods<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Likelihoods { preferences, actions, returns, scale, derivatives, likelihoods } = self;
        let likelihoods = &mut likelihoods[..actions.len()];
        let width = preferences.len() / actions.len();
        let given = actions.iter().zip(returns.iter().map(|sum| sum * scale));
        let given = given.zip(likelihoods.iter_mut());
        if width == 4 {
            // Rows of a known width keep their numbers in registers.
            let (rows, derivatives) =
                (preferences.as_chunks::<4>().0, derivatives.as_chunks_mut::<4>().0);
            for ((row, by), ((action, weight), likelihood)) in
                rows.iter().zip(derivatives).zip(given)
            {
                let total = (row[0] + row[1]) + (row[2] + row[3]);
                *likelihood = differentiate(row, total, *action, weight, by);
            }
        } else {
            let rows = preferences.chunks_exact(width).zip(derivatives.chunks_exact_mut(width));
            for ((row, by), ((action, weight), likelihood)) in rows.zip(given) {
                *likelihood = differentiate(row, row.iter().sum(), *action, weight, by);
            }
        }
        likelihoods.iter_mut().for_each(|likelihood| *likelihood = math::ln(*likelihood));
        let mut sums = [0.0; LANES];
        for (terms, returns) in likelihoods.chunks(LANES).zip(returns.chunks(LANES)) {
            let terms = terms.iter().zip(returns);
            sums.iter_mut()
                .zip(terms)
                .for_each(|(sum, (ln, weight))| *sum -= ln * f64::from(*weight));
        }
        sums.iter().sum()
    }
}

/// Writes the derivatives of a step by its logits, whose exponentials, `row`, have the sum `total`; returns the
/// likelihood of its action.
#[inline(always)]
fn differentiate(row: &[f32], total: f32, action: Action, weight: f32, by: &mut [f32]) -> f64 {
    let inverse = 1.0 / total;
    let mut of_taken = 0.0;
    for (j, (preference, by)) in row.iter().zip(by).enumerate() {
        let likelihood = preference * inverse;
        let taken = action.index() == j;
        *by = weight * (likelihood - if taken { 1.0 } else { 0.0 });
        of_taken = if taken { likelihood } else { of_taken };
    }
    f64::from(of_taken)
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

// The gradient is not saved, because it is 0 between updates.
resumable!([] FusedReinforce { parts adam; fixed network.parameters });
