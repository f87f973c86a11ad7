//! The registration of the dueling DQN.

use crate::agent::actor::Actor;
use crate::agent::burn::device::inference;
use crate::agent::burn::{BurnDuelingDqn, DuelingQNetwork};
use crate::agent::constraint::{
    Assignment, CURVE_FITS, Constraint, DECISIONS_FIT, EPISODES, HORIZON, LAYERS, ONE_HOT,
    batch_fits, network_fits, replay_fits,
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

use super::algorithm::{AlgorithmParameters, PER_STEP, Start, StartError, Task, Work, unless_fit};

const TRUNK: Parameter = Parameter::Agent("trunk");
const BATCH: Parameter = Parameter::Agent("batch");
const BUFFER: Parameter = Parameter::Agent("buffer");
const EPSILON_START: Parameter = Parameter::Agent("epsilon_start");
const EPSILON_FLOOR: Parameter = Parameter::Agent("epsilon_floor");

/// Stacks of hidden layers.
fn stacks(assignment: &Assignment) -> u64 {
    if assignment.is_word(TRUNK, "separate") { 2 } else { 1 }
}

impl AlgorithmParameters for DuelingDqn {
    const NAME: &'static str = "dueling_dqn";
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[BATCH, BUFFER],
            violation: |assignment| {
                let violated = assignment.whole(BATCH) > assignment.whole(BUFFER);
                violated.then(|| assignment.contradiction(BATCH, "must not exceed", BUFFER))
            },
        },
        Constraint {
            parameters: &[EPSILON_FLOOR, EPSILON_START],
            violation: |assignment| {
                let violated = assignment.real(EPSILON_FLOOR) > assignment.real(EPSILON_START);
                violated.then(|| {
                    assignment.contradiction(EPSILON_FLOOR, "must not exceed", EPSILON_START)
                })
            },
        },
        Constraint {
            parameters: &[Parameter::Scenario, LAYERS, TRUNK, HORIZON, ONE_HOT],
            violation: |assignment| {
                network_fits(assignment.network_parameters(stacks(assignment), 5))
            },
        },
        Constraint {
            parameters: &[Parameter::Scenario, BATCH, LAYERS, TRUNK, HORIZON, ONE_HOT],
            violation: |assignment| {
                let each = stacks(assignment) * assignment.row_numbers();
                batch_fits(assignment.whole(BATCH).saturating_mul(each))
            },
        },
        Constraint {
            parameters: &[Parameter::Scenario, BUFFER, EPISODES, HORIZON, ONE_HOT],
            violation: |assignment| {
                let steps = assignment.whole(EPISODES).saturating_mul(assignment.whole(HORIZON));
                replay_fits(assignment, assignment.whole(BUFFER).min(steps))
            },
        },
        CURVE_FITS,
        DECISIONS_FIT,
    ];

    fn version(&self) -> u32 {
        2
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    /// One update a step, and one row to choose its action. The target network sees a transition once
    /// in a period, which counts as nothing.
    fn work(&self, task: &Task) -> Work {
        let weights = layers::weights(&layers::dueling(self, task.observations().inputs())) as u64;
        let steps = task.steps(self.episodes);
        Work::of_network(weights, steps.saturating_mul(u64::from(self.batch)), steps)
            .plus(steps.saturating_mul(weights + PER_STEP))
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        Ok(Start::Learner(learner_in(self, task.simulation(LANES), task.seed)?))
    }

    fn trained(
        &self,
        task: &Task,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        trained(self, &task.observations(), weights, actions)
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
