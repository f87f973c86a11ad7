//! The registration of the dueling DQN.

use crate::agent::actor::Actor;
use crate::agent::burn::device::inference;
use crate::agent::burn::{
    BurnDuelingDqn, BurnRecurrentDqn, DuelingQNetwork, RecurrentDuelingQNetwork,
};
use crate::agent::constraint::{
    Assignment, CURVE_FITS, Constraint, DECISIONS_FIT, EPISODES, GRU_HAS_ITS_LAYERS, HISTORY,
    HORIZON, LAYERS, ONE_HOT, RECURRENT, UNITS, UNPAID_LAST_STEP, Violation, batch_fits,
    gru_parameters, gru_row_numbers, has_gru, network_fits, replay_fits,
};
use crate::agent::dueling_dqn::{DuelingDqn, DuelingDqnLearner, RecurrentDqnLearner};
use crate::agent::fused::{
    FusedDuelingDqn, FusedDuelingNetwork, FusedRecurrentDqn, FusedRecurrentDuelingNetwork,
};
use crate::agent::learner::{Actions, Learner};
use crate::agent::network::{Engine, Recurrent};
use crate::agent::policy::EpsilonGreedy;
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::{Weights, WeightsError};
use crate::agent::{layers, orthogonal};
use crate::env::{ObservationSpec, VectorEnvironment};
use crate::kernel::Isa;
use crate::key::Parameter;

use super::algorithm::{AlgorithmParameters, PER_STEP, Start, StartError, Task, Work, unless_fit};

const TRUNK: Parameter = Parameter::Agent("trunk");
const BATCH: Parameter = Parameter::Agent("batch");
const BUFFER: Parameter = Parameter::Agent("buffer");
const SEQUENCE: Parameter = Parameter::Agent("sequence");
const BURN_IN: Parameter = Parameter::Agent("burn_in");
const EPSILON_START: Parameter = Parameter::Agent("epsilon_start");
const EPSILON_FLOOR: Parameter = Parameter::Agent("epsilon_floor");

/// Number of stacks of hidden layers.
fn stacks(assignment: &Assignment) -> u64 {
    if assignment.is_word(TRUNK, "separate") { 2 } else { 1 }
}

/// Number of rows of a batch: transitions, or with a GRU episodes with the state after each.
fn batch_rows(assignment: &Assignment) -> u64 {
    let each = if has_gru(assignment) { assignment.longest_episode().saturating_add(1) } else { 1 };
    assignment.whole(BATCH).saturating_mul(each)
}

/// The violation `says` unless the condition holds.
fn unless(holds: bool, says: &str) -> Option<Violation> {
    (!holds).then(|| Violation::Contradiction(says.to_owned()))
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
        GRU_HAS_ITS_LAYERS,
        Constraint {
            parameters: &[RECURRENT, TRUNK],
            violation: |assignment| {
                let holds = !has_gru(assignment) || assignment.is_word(TRUNK, "shared");
                unless(
                    holds,
                    "`recurrent = \"gru\"` needs `trunk = \"shared\"`, found \"separate\"",
                )
            },
        },
        Constraint {
            parameters: &[BURN_IN, SEQUENCE],
            violation: |assignment| {
                let holds = assignment.whole(BURN_IN) == 0 || assignment.whole(SEQUENCE) > 0;
                let burn_in = assignment.shown(BURN_IN);
                unless(
                    holds,
                    &format!(
                        "`burn_in` is the number of steps before a sequence: it needs `sequence` above 0, \
                     found {burn_in}"
                    ),
                )
            },
        },
        Constraint {
            parameters: &[SEQUENCE, RECURRENT],
            violation: |assignment| {
                let holds = assignment.whole(SEQUENCE) == 0 || has_gru(assignment);
                unless(holds, "`sequence` needs `recurrent = \"gru\"`, found \"none\"")
            },
        },
        Constraint {
            parameters: &[RECURRENT, BATCH, BUFFER, HORIZON, UNPAID_LAST_STEP],
            violation: |assignment| {
                let episodes = assignment.whole(BATCH).saturating_add(1);
                let most = episodes.saturating_mul(assignment.longest_episode());
                let holds = !has_gru(assignment) || most <= assignment.whole(BUFFER);
                let [batch, buffer, horizon] =
                    [BATCH, BUFFER, HORIZON].map(|key| assignment.shown(key));
                let unpaid = match assignment.is_set(UNPAID_LAST_STEP) {
                    true => " with `unpaid_last_step`",
                    false => "",
                };
                unless(
                    holds,
                    &format!(
                        "with a GRU the `buffer` must hold one episode more than a `batch`, which is {most} \
                     steps for `batch` = {batch} and `horizon` = {horizon}{unpaid}, found {buffer}"
                    ),
                )
            },
        },
        Constraint {
            parameters: &[
                Parameter::SCENARIO,
                LAYERS,
                TRUNK,
                RECURRENT,
                UNITS,
                HORIZON,
                ONE_HOT,
                HISTORY,
            ],
            violation: |assignment| {
                let layers = assignment.network_parameters(stacks(assignment), 5);
                network_fits(layers.saturating_add(gru_parameters(assignment)))
            },
        },
        Constraint {
            parameters: &[
                Parameter::SCENARIO,
                BATCH,
                LAYERS,
                TRUNK,
                RECURRENT,
                UNITS,
                HORIZON,
                UNPAID_LAST_STEP,
                ONE_HOT,
                HISTORY,
            ],
            violation: |assignment| {
                let layers = stacks(assignment) * assignment.row_numbers();
                let each = layers.saturating_add(gru_row_numbers(assignment));
                batch_fits(batch_rows(assignment).saturating_mul(each))
            },
        },
        Constraint {
            parameters: &[
                Parameter::SCENARIO,
                BUFFER,
                EPISODES,
                HORIZON,
                UNPAID_LAST_STEP,
                ONE_HOT,
                HISTORY,
            ],
            violation: |assignment| {
                let steps = assignment.whole(EPISODES).saturating_mul(assignment.longest_episode());
                replay_fits(assignment, assignment.whole(BUFFER).min(steps))
            },
        },
        CURVE_FITS,
        DECISIONS_FIT,
    ];

    fn version(&self) -> u32 {
        match self.engine {
            Engine::Fused => 2,
            Engine::Burn => 4,
        }
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    /// One forward row per choice of an action, and updates from batches. The target network
    /// evaluates a transition once per period, which is neglected; with a GRU it evaluates every
    /// batch.
    fn work(&self, task: &Task) -> Work {
        let layers = layers::dueling_layers(self, task.observations().inputs());
        let weights = layers::numbers(&layers) as u64;
        let steps = task.steps(self.episodes);
        let updates = steps / u64::from(self.update_interval.max(1));
        let batch = u64::from(self.batch);
        let acting = steps.saturating_mul(weights + PER_STEP);
        let (rows, of_target) = match self.recurrent {
            Recurrent::None => (updates.saturating_mul(batch), 0),
            Recurrent::Gru => {
                let sequence = u64::from(self.sequence + self.burn_in);
                let whole = task.steps(1);
                let each = if self.sequence == 0 { whole } else { sequence.min(whole) };
                let rows = updates.saturating_mul(batch).saturating_mul(each);
                (rows, rows.saturating_mul(weights))
            }
        };
        Work::of_network(weights, rows, updates).plus(acting).plus(of_target)
    }

    fn speed(&self) -> f64 {
        self.engine.speed()
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        // After the last step, a budget for every step may be spent, although no message was withheld.
        let unavailable = if task.can_withhold() { self.unavailable } else { Unavailable::Chosen };
        let parameters = DuelingDqn { unavailable, ..self.clone() };
        Ok(Start::Learner(learner_in(&parameters, task.simulation(LANES), task.seed)?))
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

/// A dueling DQN before its first episode in any environment of one lane, on the engine given by
/// its parameters.
///
/// **Errors**: the environment does not have one lane and four actions; memory for the network is
/// short.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &DuelingDqn,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, LANES)?;
    let inputs = environment.observation_spec().inputs();
    if parameters.recurrent == Recurrent::Gru {
        return recurrent_learner(parameters, environment, seed);
    }
    let stacks = layers::dueling(parameters, inputs);
    let weights = layers::initial(&stacks, COPIES + parameters.engine.further_copies(), seed)?;
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

/// [`learner_in`] with a GRU.
fn recurrent_learner<Env: VectorEnvironment + 'static>(
    parameters: &DuelingDqn,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    let inputs = environment.observation_spec().inputs();
    let layers = layers::dueling_layers(parameters, inputs);
    let weights = orthogonal::initial(&layers, COPIES + parameters.engine.further_copies(), seed)?;
    Ok(match parameters.engine {
        Engine::Fused => {
            let engine = FusedRecurrentDqn::new(parameters, inputs, &weights, Isa::chosen());
            let engine = engine.expect(layers::DRAWN);
            Box::new(RecurrentDqnLearner::new(engine, parameters, environment, seed))
        }
        Engine::Burn => {
            let engine = BurnRecurrentDqn::new(parameters, inputs, &weights).expect(layers::DRAWN);
            Box::new(RecurrentDqnLearner::new(engine, parameters, environment, seed))
        }
    })
}

/// The policy of a previously trained dueling DQN, on the engine that trained it. With
/// [`Actions::AsTrained`], it explores at the rate stored with its weights.
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
    let isa = Isa::chosen();
    Ok(match (parameters.engine, parameters.recurrent) {
        (Engine::Fused, Recurrent::None) => {
            let network = FusedDuelingNetwork::new(parameters, inputs, weights, isa)?;
            Box::new(EpsilonGreedy::new(network, epsilon, observations))
        }
        (Engine::Fused, Recurrent::Gru) => {
            let network = FusedRecurrentDuelingNetwork::new(parameters, inputs, weights, isa)?;
            Box::new(EpsilonGreedy::new(network, epsilon, observations))
        }
        (Engine::Burn, Recurrent::None) => {
            let network = DuelingQNetwork::from_weights(parameters, inputs, weights, &inference())?;
            Box::new(EpsilonGreedy::new(network, epsilon, observations))
        }
        (Engine::Burn, Recurrent::Gru) => {
            let device = inference();
            let network =
                RecurrentDuelingQNetwork::from_weights(parameters, inputs, weights, &device)?;
            Box::new(EpsilonGreedy::new(network, epsilon, observations))
        }
    })
}

/// Number of lanes in training.
const LANES: usize = 1;
/// Copies of the network in memory: the initial weights, the trained weights, their gradient,
/// Adam's two moments, and the target network.
const COPIES: usize = 6;
