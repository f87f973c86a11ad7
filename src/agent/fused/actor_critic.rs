//! Policy and value of PPO, each with layers of its own.

use crate::agent::fused::network::FusedNetwork;
use crate::agent::fused::ppo_loss::{LossSums, Objective, PpoLoss, ROWS};
use crate::agent::fused::ppo_network::FusedPpoNetwork;
use crate::agent::fused::stack::{BLOCK, StackLayout, Workspace, blocks};
use crate::agent::layers::{self, Shape};
use crate::agent::policy::ActionNetwork;
use crate::agent::ppo::{Losses, Minibatch, Ppo};
use crate::agent::{Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Aligned, Isa};
use crate::state::resumable;

/// Policy and value networks of PPO in flat arrays; as an [`ActionNetwork`] it is the policy.
#[derive(Clone, Debug)]
pub struct FusedActorCritic {
    isa: Isa,
    policy: StackLayout,
    value: StackLayout,
    parameters: Aligned,
    policy_workspace: Workspace,
    value_workspace: Workspace,
}

impl FusedActorCritic {
    /// Replaces `out` by the values of observations, \[rows\].
    fn values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        out.clear();
        for rows in blocks(observations.rows()) {
            let count = rows.len();
            let observations = (observations, rows);
            self.value.forward(self.isa, &self.parameters, observations, &mut self.value_workspace);
            out.extend_from_slice(&self.value_workspace.outputs[..count]);
        }
    }
}

impl ActionNetwork for FusedActorCritic {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        out.clear();
        for rows in blocks(observations.rows()) {
            let count = rows.len() * self.policy.outputs();
            let observations = (observations, rows);
            let workspace = &mut self.policy_workspace;
            self.policy.forward(self.isa, &self.parameters, observations, workspace);
            out.extend_from_slice(&workspace.outputs[..count]);
        }
    }
}

resumable!([] FusedActorCritic { fixed parameters });

impl FusedNetwork for FusedActorCritic {
    type Parameters = Ppo;

    fn from_weights(
        parameters: &Ppo,
        shape: Shape,
        weights: &Weights,
        isa: Isa,
    ) -> Result<Self, WeightsError> {
        let [policy, value] = layers::actor_critic(parameters, shape);
        let policy = StackLayout::new(policy, parameters.activation, 0);
        let value = StackLayout::new(value, parameters.activation, policy.end());
        let mut flat = Aligned::zeros(value.end());
        policy.load(weights, &mut flat)?;
        value.load(weights, &mut flat)?;
        Ok(FusedActorCritic {
            isa,
            policy_workspace: policy.workspace(),
            value_workspace: value.workspace(),
            policy,
            value,
            parameters: flat,
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
        self.policy.store(flat, &mut weights);
        self.value.store(flat, &mut weights);
        weights
    }
}

impl FusedPpoNetwork for FusedActorCritic {
    fn outputs(
        &mut self,
        observations: &Observations,
        _: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    ) {
        self.evaluate(observations, logits);
        self.values(observations, values);
    }

    fn differentiate(
        &mut self,
        minibatch: &Minibatch,
        objective: &Objective,
        loss: &mut PpoLoss,
        gradient: &mut [f32],
    ) -> Losses {
        let FusedActorCritic { isa, policy, value, parameters, policy_workspace, value_workspace } =
            self;
        policy.prepare(parameters, policy_workspace);
        value.prepare(parameters, value_workspace);
        let mut sums = LossSums::default();
        for block in blocks(minibatch.rows()) {
            let observations = (&minibatch.observations, block.clone());
            policy.forward(*isa, parameters, observations.clone(), policy_workspace);
            value.forward(*isa, parameters, observations.clone(), value_workspace);
            loss.load(minibatch, block.clone());
            let (width, values) = (policy.outputs(), &value_workspace.outputs[..block.len()]);
            let values = values.iter().copied();
            loss.load_outputs(policy_workspace.outputs.chunks_exact(width).zip(values));
            sums.add(&loss.compute(*isa, objective, minibatch.rows()));
            let by_values = &mut value_workspace.by_outputs[..block.len()];
            loss.store(policy_workspace.by_outputs.chunks_exact_mut(width).zip(by_values));
            policy.backward(*isa, parameters, observations.clone(), policy_workspace, gradient);
            value.backward(*isa, parameters, observations, value_workspace, gradient);
        }
        sums.losses(objective, minibatch.rows())
    }
}

// A block of rows of the layers is also a block of rows of the loss.
const _: () = assert!(BLOCK == ROWS);
