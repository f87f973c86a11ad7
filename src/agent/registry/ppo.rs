//! The registration of PPO.

use crate::agent::actor::Actor;
use crate::agent::burn::device::{inference, training};
use crate::agent::burn::{ActorCritic, BurnPpo, RecurrentActorCritic};
use crate::agent::constraint::{
    Assignment, CURVE_FITS, Constraint, DECISIONS_FIT, GRU_HAS_ITS_LAYERS, HISTORY, HORIZON,
    LAYERS, ONE_HOT, RECURRENT, UNITS, batch_fits, gru_parameters, gru_row_numbers, has_gru,
    network_fits,
};
use crate::agent::fused::{FusedActorCritic, FusedPpo, FusedRecurrentActorCritic};
use crate::agent::learner::{Actions, Learner};
use crate::agent::network::{Engine, Recurrent};
use crate::agent::policy::SoftmaxPolicy;
use crate::agent::ppo::{Ppo, PpoEngine, PpoLearner};
use crate::agent::weights::{Weights, WeightsError};
use crate::agent::{layers, orthogonal};
use crate::env::{ObservationSpec, VectorEnvironment};
use crate::kernel::Isa;
use crate::key::Parameter;

use super::algorithm::{AlgorithmParameters, PER_STEP, Start, StartError, Task, Work, unless_fit};

const LANES: Parameter = Parameter::Agent("lanes");
const STEPS: Parameter = Parameter::Agent("steps");
const MINIBATCHES: Parameter = Parameter::Agent("minibatches");

/// Number of weights and biases of all networks.
fn network_parameters(assignment: &Assignment) -> u64 {
    let stacks = if has_gru(assignment) { 1 } else { 2 };
    assignment.network_parameters(stacks, 5).saturating_add(gru_parameters(assignment))
}

/// Number of values that the networks hold per row of input.
fn row_numbers(assignment: &Assignment) -> u64 {
    let stacks = if has_gru(assignment) { 1 } else { 2 };
    (stacks * assignment.row_numbers()).saturating_add(gru_row_numbers(assignment))
}

impl AlgorithmParameters for Ppo {
    const NAME: &'static str = "ppo";
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[MINIBATCHES, LANES, STEPS],
            violation: |assignment| {
                let rows = assignment.whole(LANES).saturating_mul(assignment.whole(STEPS));
                let violated = assignment.whole(MINIBATCHES) > rows;
                violated.then(|| {
                    let [parts, lanes, steps] =
                        [MINIBATCHES, LANES, STEPS].map(|key| assignment.shown(key));
                    crate::agent::Violation::Contradiction(format!(
                        "`minibatches` must not exceed `lanes` times `steps`, found {parts}, \
                         {lanes} and {steps}"
                    ))
                })
            },
        },
        Constraint {
            parameters: &[RECURRENT, MINIBATCHES, LANES],
            violation: |assignment| {
                let violated =
                    has_gru(assignment) && assignment.whole(MINIBATCHES) > assignment.whole(LANES);
                violated.then(|| {
                    assignment.contradiction(MINIBATCHES, "with a GRU must not exceed", LANES)
                })
            },
        },
        GRU_HAS_ITS_LAYERS,
        Constraint {
            parameters: &[Parameter::SCENARIO, LAYERS, RECURRENT, UNITS, HORIZON, ONE_HOT, HISTORY],
            violation: |assignment| network_fits(network_parameters(assignment)),
        },
        Constraint {
            parameters: &[
                Parameter::SCENARIO,
                LANES,
                STEPS,
                LAYERS,
                RECURRENT,
                UNITS,
                HORIZON,
                ONE_HOT,
                HISTORY,
            ],
            violation: |assignment| {
                let rows = assignment.whole(LANES).saturating_mul(assignment.whole(STEPS));
                batch_fits(rows.saturating_mul(row_numbers(assignment)))
            },
        },
        CURVE_FITS,
        DECISIONS_FIT,
    ];

    fn version(&self) -> u32 {
        match self.engine {
            Engine::Fused => 1,
            Engine::Burn => 2,
        }
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    /// The networks process every step once for the choice of an action and once per epoch.
    fn work(&self, task: &Task) -> Work {
        let inputs = task.observations().inputs();
        let weights = layers::numbers(&layers::ppo(self, inputs)) as u64;
        let steps = task.steps(self.episodes);
        let rollouts = steps.div_ceil(u64::from(self.lanes.max(1)) * u64::from(self.steps.max(1)));
        let passes = u64::from(self.epochs);
        let updates = rollouts.saturating_mul(passes).saturating_mul(u64::from(self.minibatches));
        Work::of_network(weights, steps.saturating_mul(passes), updates)
            .plus(steps.saturating_mul(weights))
            .plus(steps.div_ceil(u64::from(self.lanes.max(1))).saturating_mul(PER_STEP))
    }

    fn speed(&self) -> f64 {
        self.engine.speed()
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        let lanes = self.lanes as usize;
        Ok(Start::Learner(learner_in(self, task.simulation(lanes), task.seed)?))
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

/// PPO before its first step in any environment of `lanes` lanes, on the engine given by its
/// parameters.
///
/// **Errors**: the environment does not have this number of lanes and four actions; memory for the
/// networks is short.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &Ppo,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, parameters.lanes as usize)?;
    let inputs = environment.observation_spec().inputs();
    let weights = orthogonal::initial(
        &layers::ppo(parameters, inputs),
        COPIES + parameters.engine.further_copies(),
        seed,
    )?;
    let isa = Isa::chosen();
    Ok(match (parameters.engine, parameters.recurrent) {
        (Engine::Fused, Recurrent::None) => {
            let engine = FusedPpo::<FusedActorCritic>::new(parameters, inputs, &weights, isa);
            learner(engine.expect(layers::DRAWN), parameters, environment, seed)
        }
        (Engine::Fused, Recurrent::Gru) => {
            let engine =
                FusedPpo::<FusedRecurrentActorCritic>::new(parameters, inputs, &weights, isa);
            learner(engine.expect(layers::DRAWN), parameters, environment, seed)
        }
        (Engine::Burn, Recurrent::None) => {
            let network = ActorCritic::from_weights(parameters, inputs, &weights, &training());
            let engine = BurnPpo::new(parameters, network.expect(layers::DRAWN));
            learner(engine, parameters, environment, seed)
        }
        (Engine::Burn, Recurrent::Gru) => {
            let network =
                RecurrentActorCritic::from_weights(parameters, inputs, &weights, &training());
            let engine = BurnPpo::new(parameters, network.expect(layers::DRAWN));
            learner(engine, parameters, environment, seed)
        }
    })
}

fn learner<E: PpoEngine + 'static, Env: VectorEnvironment + 'static>(
    engine: E,
    parameters: &Ppo,
    environment: Env,
    seed: u64,
) -> Box<dyn Learner<Env>> {
    Box::new(PpoLearner::new(engine, parameters, environment, seed))
}

/// The policy of previously trained PPO, on the engine that trained it.
///
/// **Errors**: the weights do not fit the networks.
pub fn trained<Env: VectorEnvironment>(
    parameters: &Ppo,
    observations: &ObservationSpec,
    weights: &Weights,
    actions: Actions,
) -> Result<Box<dyn Actor<Env>>, WeightsError> {
    let inputs = observations.inputs();
    let observations = observations.observations();
    let isa = Isa::chosen();
    Ok(match (parameters.engine, parameters.recurrent) {
        (Engine::Fused, Recurrent::None) => {
            let network = FusedActorCritic::new(parameters, inputs, weights, isa)?;
            Box::new(SoftmaxPolicy::new(network, actions, observations))
        }
        (Engine::Fused, Recurrent::Gru) => {
            let network = FusedRecurrentActorCritic::new(parameters, inputs, weights, isa)?;
            Box::new(SoftmaxPolicy::new(network, actions, observations))
        }
        (Engine::Burn, Recurrent::None) => {
            let network = ActorCritic::from_weights(parameters, inputs, weights, &inference())?;
            Box::new(SoftmaxPolicy::new(network, actions, observations))
        }
        (Engine::Burn, Recurrent::Gru) => {
            let device = inference();
            let network = RecurrentActorCritic::from_weights(parameters, inputs, weights, &device)?;
            Box::new(SoftmaxPolicy::new(network, actions, observations))
        }
    })
}

/// Copies of the networks in memory: the initial weights, the trained weights, their gradient, and
/// Adam's two moments.
const COPIES: usize = 5;
