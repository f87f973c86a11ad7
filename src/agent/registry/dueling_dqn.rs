//! The registration of the dueling DQN.

use crate::agent::actor::Actor;
use crate::agent::burn::device::inference;
use crate::agent::burn::{BurnDuelingDqn, DuelingQNetwork};
use crate::agent::constraint::{
    CURVE_FITS, Chosen, Constraint, EPISODES, HORIZON, LAYERS, ONE_HOT, batch_fits, network_fits,
    replay_fits,
};
use crate::agent::dueling_dqn::{DuelingDqn, DuelingDqnLearner};
use crate::agent::fused::{FusedDuelingDqn, FusedDuelingNetwork};
use crate::agent::layers;
use crate::agent::learner::{Actions, Learner};
use crate::agent::network::Engine;
use crate::agent::policy::EpsilonGreedy;
use crate::agent::weights::{Weights, WeightsError};
use crate::env::{ObservationSpec, VectorEnvironment};
use crate::kernel::Isa;
use crate::key::Parameter;

use super::algorithm::{AlgorithmParameters, Setting, Start, StartError, unless_fit};

const TRUNK: Parameter = Parameter::Agent("trunk");
const BATCH: Parameter = Parameter::Agent("batch");
const BUFFER: Parameter = Parameter::Agent("buffer");
const EPSILON_START: Parameter = Parameter::Agent("epsilon_start");
const EPSILON_FLOOR: Parameter = Parameter::Agent("epsilon_floor");

/// Stacks of hidden layers.
fn stacks(chosen: &Chosen) -> u64 {
    if chosen.is_word(TRUNK, "separate") { 2 } else { 1 }
}

impl AlgorithmParameters for DuelingDqn {
    const NAME: &'static str = "dueling_dqn";
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[BATCH, BUFFER],
            violation: |chosen| {
                let violated = chosen.whole(BATCH) > chosen.whole(BUFFER);
                violated.then(|| chosen.contradiction(BATCH, "must not exceed", BUFFER))
            },
        },
        Constraint {
            parameters: &[EPSILON_FLOOR, EPSILON_START],
            violation: |chosen| {
                let violated = chosen.real(EPSILON_FLOOR) > chosen.real(EPSILON_START);
                violated
                    .then(|| chosen.contradiction(EPSILON_FLOOR, "must not exceed", EPSILON_START))
            },
        },
        Constraint {
            parameters: &[Parameter::Scenario, LAYERS, TRUNK, HORIZON, ONE_HOT],
            violation: |chosen| network_fits(chosen.network_parameters(stacks(chosen), 5)),
        },
        Constraint {
            parameters: &[Parameter::Scenario, BATCH, LAYERS, TRUNK, HORIZON, ONE_HOT],
            violation: |chosen| {
                let each = stacks(chosen) * chosen.row_numbers();
                batch_fits(chosen.whole(BATCH).saturating_mul(each))
            },
        },
        Constraint {
            parameters: &[Parameter::Scenario, BUFFER, EPISODES, HORIZON, ONE_HOT],
            violation: |chosen| {
                let steps = chosen.whole(EPISODES).saturating_mul(chosen.whole(HORIZON));
                replay_fits(chosen, chosen.whole(BUFFER).min(steps))
            },
        },
        CURVE_FITS,
    ];

    fn version(&self) -> u32 {
        2
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    fn start(&self, setting: &Setting) -> Result<Start, StartError> {
        Ok(Start::Learner(learner_in(self, setting.simulation(LANES), setting.seed)?))
    }

    fn trained(
        &self,
        setting: &Setting,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        trained(self, &setting.observations(), weights, actions)
    }
}

/// A dueling DQN before its first episode in any environment of one lane, on the engine that its
/// parameters name.
///
/// **Errors**: the environment does not have one lane and four actions; there is no memory for the
/// network.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &DuelingDqn,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, LANES)?;
    let inputs = environment.observation_spec().inputs();
    let stacks = layers::dueling(parameters, inputs);
    let weights = layers::initial(&stacks, COPIES, seed)?;
    Ok(match parameters.engine {
        Engine::Fused => {
            let engine = FusedDuelingDqn::new(parameters, inputs, &weights, Isa::chosen());
            let engine = engine.expect(layers::DRAWN);
            Box::new(DuelingDqnLearner::new(engine, parameters, environment, seed))
        }
        Engine::Burn => {
            let engine = BurnDuelingDqn::new(parameters, inputs, &weights).expect(layers::DRAWN);
            Box::new(DuelingDqnLearner::new(engine, parameters, environment, seed))
        }
    })
}

/// The policy of a dueling DQN that was trained before, on the engine that trained it. As trained, it
/// explores at the rate that is kept with its weights.
///
/// **Errors**: the weights do not fit the network.
pub fn trained<Env: VectorEnvironment>(
    parameters: &DuelingDqn,
    observations: &ObservationSpec,
    weights: &Weights,
    actions: Actions,
) -> Result<Box<dyn Actor<Env>>, WeightsError> {
    let inputs = observations.inputs();
    let observations = observations.observations();
    let epsilon = match actions {
        Actions::AsTrained => weights.number("epsilon")?,
        Actions::Greedy => 0.0,
    };
    Ok(match parameters.engine {
        Engine::Fused => Box::new(EpsilonGreedy::new(
            FusedDuelingNetwork::new(parameters, inputs, weights, Isa::chosen())?,
            epsilon,
            observations,
        )),
        Engine::Burn => Box::new(EpsilonGreedy::new(
            DuelingQNetwork::from_weights(parameters, inputs, weights, &inference())?,
            epsilon,
            observations,
        )),
    })
}

/// Lanes that it trains on.
const LANES: usize = 1;
/// The weights as drawn and as trained, their gradient, Adam's two moments, and the target network.
const COPIES: usize = 6;
