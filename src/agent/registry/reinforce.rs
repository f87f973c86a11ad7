//! The registration of REINFORCE.

use crate::agent::architecture::NetworkPolicy;
#[cfg(feature = "burn")]
use crate::agent::burn::device::inference;
#[cfg(feature = "burn")]
use crate::agent::burn::{BurnNetwork, BurnReinforce, PolicyNetwork};
use crate::agent::constraint::{ENGINE_IS_BUILT, EPISODES};
use crate::agent::fused::{FusedPolicyNetwork, FusedReinforce};
use crate::agent::layers::{self, Shape};
use crate::agent::learner::Learner;
use crate::agent::network::Engine;
#[cfg(not(feature = "burn"))]
use crate::agent::network::NoEngine;
use crate::agent::policy::{ActionNetwork, Choice};
use crate::agent::reinforce::{Reinforce, ReinforceLearner};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::VectorEnvironment;
use crate::kernel::Isa;
use crate::key::{Constraint, Parameter, Size};

use super::algorithm::{AlgorithmParameters, PER_STEP, Start, StartError, Task, Work, unless_fit};

const TRAJECTORIES_PER_UPDATE: Parameter = Parameter::Agent("trajectories_per_update");

impl AlgorithmParameters for Reinforce {
    const NAME: &'static str = "reinforce";
    const CONSTRAINTS: &'static [Constraint] = &[
        ENGINE_IS_BUILT,
        Constraint {
            parameters: &[EPISODES, TRAJECTORIES_PER_UPDATE],
            violation: |assignment| {
                let each = assignment.whole(TRAJECTORIES_PER_UPDATE);
                let violated = !assignment.whole(EPISODES).is_multiple_of(each);
                violated.then(|| {
                    assignment.contradiction(
                        EPISODES,
                        "must be a multiple of",
                        TRAJECTORIES_PER_UPDATE,
                    )
                })
            },
        },
    ];

    fn sizes(&self, task: &Task) -> Vec<Size> {
        let layers = layers::listed(&[layers::policy(self, task.shape())]);
        layers::sizes(&layers, task.steps(self.trajectories_per_update)).to_vec()
    }

    fn version(&self) -> u32 {
        match self.engine {
            Engine::Fused => 2,
            Engine::Burn => 4,
        }
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    /// Counts one update per batch of trajectories. The network processes every step twice: to
    /// choose an action, and to learn.
    fn work(&self, task: &Task) -> Work {
        let weights = layers::weights(&[layers::policy(self, task.shape())]) as u64;
        let steps = task.steps(self.episodes);
        let updates = self.episodes.div_ceil(self.trajectories_per_update.max(1));
        Work::of_network(weights, steps, updates.into())
            .plus(steps.saturating_mul(weights))
            .plus(task.steps(updates).saturating_mul(PER_STEP))
    }

    fn speed(&self) -> f64 {
        self.engine.speed()
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        let lanes = self.trajectories_per_update as usize;
        Ok(Start::Learner(learner_in(self, task.simulation(lanes), task.seed)?))
    }

    fn network(&self, shape: Shape, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
        let network: Box<dyn ActionNetwork + Send> = match self.engine {
            Engine::Fused => {
                Box::new(FusedPolicyNetwork::new(self, shape, weights, Isa::chosen())?)
            }
            #[cfg(feature = "burn")]
            Engine::Burn => {
                Box::new(PolicyNetwork::from_weights(self, shape, weights, &inference())?)
            }
            #[cfg(not(feature = "burn"))]
            Engine::Burn => return Err(NoEngine.into()),
        };
        let stacks = [layers::policy(self, shape)];
        let architecture = Some(layers::architecture(self.activation, stacks));
        Ok(NetworkPolicy { network, choice: Choice::Softmax, architecture })
    }
}

/// REINFORCE before its first update in any environment of `trajectories_per_update` lanes, on the
/// engine given by its parameters.
///
/// **Errors**: the environment does not have this number of lanes and 2 to 256 actions; memory for the
/// network is short.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &Reinforce,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, parameters.trajectories_per_update as usize)?;
    let shape = Shape::from(&environment.interface());
    let stacks = [layers::policy(parameters, shape)];
    let weights = layers::initial(&stacks, COPIES + parameters.engine.further_copies(), seed)?;
    Ok(match parameters.engine {
        Engine::Fused => {
            let engine = FusedReinforce::new(parameters, shape, &weights, Isa::chosen());
            let engine = engine.expect(layers::DRAWN);
            Box::new(ReinforceLearner::new(engine, parameters, environment, seed))
        }
        #[cfg(feature = "burn")]
        Engine::Burn => {
            let engine = BurnReinforce::new(parameters, shape, &weights).expect(layers::DRAWN);
            Box::new(ReinforceLearner::new(engine, parameters, environment, seed))
        }
        #[cfg(not(feature = "burn"))]
        Engine::Burn => return Err(NoEngine.into()),
    })
}

/// Copies of the network in memory: the initial weights, the trained weights, their gradient, and
/// Adam's two moments.
const COPIES: usize = 5;
