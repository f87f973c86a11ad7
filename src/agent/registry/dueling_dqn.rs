//! The registration of the dueling DQN.

use crate::agent::architecture::NetworkPolicy;
#[cfg(feature = "burn")]
use crate::agent::burn::device::inference;
#[cfg(feature = "burn")]
use crate::agent::burn::{
    BurnDuelingDqn, BurnNetwork, BurnRecurrentDqn, DuelingQNetwork, RecurrentDuelingQNetwork,
};
use crate::agent::constraint::{
    ENGINE_IS_BUILT, GRU_HAS_ITS_LAYERS, HORIZON, RECURRENT, UNPAID_LAST_STEP, has_gru,
    longest_episode, replay_size,
};
use crate::agent::dueling_dqn::{DuelingDqn, DuelingDqnEngine, DuelingDqnLearner};
use crate::agent::fused::{
    FusedDuelingDqn, FusedDuelingNetwork, FusedNetwork, FusedRecurrentDqn,
    FusedRecurrentDuelingNetwork,
};
use crate::agent::layers::{self, Shape};
use crate::agent::learner::Learner;
#[cfg(not(feature = "burn"))]
use crate::agent::network::NoEngine;
use crate::agent::network::{Engine, Recurrent};
use crate::agent::orthogonal;
use crate::agent::policy::{ActionNetwork, Choice};
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::{Weights, WeightsError};
use crate::env::VectorEnvironment;
use crate::kernel::Isa;
use crate::key::{Constraint, Parameter, Size, Violation};

use super::algorithm::{AlgorithmParameters, PER_STEP, Start, StartError, Task, Work, unless_fit};

const TRUNK: Parameter = Parameter::Agent("trunk");
const BATCH: Parameter = Parameter::Agent("batch");
const BUFFER: Parameter = Parameter::Agent("buffer");
const SEQUENCE: Parameter = Parameter::Agent("sequence");
const BURN_IN: Parameter = Parameter::Agent("burn_in");
const EPSILON_START: Parameter = Parameter::Agent("epsilon_start");
const EPSILON_FLOOR: Parameter = Parameter::Agent("epsilon_floor");

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
        ENGINE_IS_BUILT,
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
                let most = episodes.saturating_mul(longest_episode(assignment));
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
    ];

    fn sizes(&self, task: &Task) -> Vec<Size> {
        let (spec, episode) = (task.observations(), task.steps(1));
        // With a GRU, a batch holds episodes with the state after each.
        let each = if self.recurrent == Recurrent::Gru { episode + 1 } else { 1 };
        let rows = u64::from(self.batch).saturating_mul(each);
        let layers = layers::dueling_layers(self, task.shape());
        let transitions = u64::from(self.buffer).min(task.steps(self.episodes));
        let replay = replay_size(transitions, spec.features.len() as u64);
        layers::sizes(&layers, rows).into_iter().chain([replay]).collect()
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

    /// One forward row per choice of an action, and updates from batches. The target network
    /// evaluates a transition once per period, which is neglected; with a GRU it evaluates every
    /// batch.
    fn work(&self, task: &Task) -> Work {
        let layers = layers::dueling_layers(self, task.shape());
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

    fn network(&self, shape: Shape, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
        let isa = Isa::chosen();
        let network: Box<dyn ActionNetwork + Send> = match (self.engine, self.recurrent) {
            (Engine::Fused, Recurrent::None) => {
                Box::new(FusedDuelingNetwork::from_weights(self, shape, weights, isa)?)
            }
            (Engine::Fused, Recurrent::Gru) => {
                Box::new(FusedRecurrentDuelingNetwork::from_weights(self, shape, weights, isa)?)
            }
            #[cfg(feature = "burn")]
            (Engine::Burn, Recurrent::None) => {
                Box::new(DuelingQNetwork::from_weights(self, shape, weights, &inference())?)
            }
            #[cfg(feature = "burn")]
            (Engine::Burn, Recurrent::Gru) => {
                let device = inference();
                Box::new(RecurrentDuelingQNetwork::from_weights(self, shape, weights, &device)?)
            }
            #[cfg(not(feature = "burn"))]
            (Engine::Burn, _) => return Err(NoEngine.into()),
        };
        // The exploration rate at the end of training.
        let choice = Choice::EpsilonGreedy { epsilon: weights.number("epsilon")? };
        let architecture = match self.recurrent {
            Recurrent::None => {
                Some(layers::architecture(self.activation, layers::dueling(self, shape)))
            }
            Recurrent::Gru => {
                let layers = layers::Recurrent::dueling(self, shape);
                let heads = ["value", "advantage"];
                Some(layers::recurrent_architecture(self.activation, layers, &heads))
            }
        };
        Ok(NetworkPolicy { network, choice, architecture })
    }
}

/// A dueling DQN before its first episode in any environment of one lane, on the engine given by
/// its parameters.
///
/// **Errors**: the environment does not have one lane and 2 to 256 actions; memory for the network is
/// short.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &DuelingDqn,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, LANES)?;
    let shape = Shape::from(&environment.interface());
    let copies = COPIES + parameters.engine.further_copies();
    let weights = match parameters.recurrent {
        Recurrent::None => layers::initial(&layers::dueling(parameters, shape), copies, seed)?,
        Recurrent::Gru => {
            orthogonal::initial(&layers::dueling_layers(parameters, shape), copies, seed)?
        }
    };
    let isa = Isa::chosen();
    let of = (parameters, environment, seed);
    Ok(match (parameters.engine, parameters.recurrent) {
        (Engine::Fused, Recurrent::None) => {
            boxed(FusedDuelingDqn::<FusedDuelingNetwork>::new(parameters, shape, &weights, isa), of)
        }
        (Engine::Fused, Recurrent::Gru) => {
            boxed(FusedRecurrentDqn::new(parameters, shape, &weights, isa), of)
        }
        #[cfg(feature = "burn")]
        (Engine::Burn, Recurrent::None) => {
            boxed(BurnDuelingDqn::new(parameters, shape, &weights), of)
        }
        #[cfg(feature = "burn")]
        (Engine::Burn, Recurrent::Gru) => {
            boxed(BurnRecurrentDqn::new(parameters, shape, &weights), of)
        }
        #[cfg(not(feature = "burn"))]
        (Engine::Burn, _) => return Err(NoEngine.into()),
    })
}

/// The learner with an engine that starts from drawn weights.
fn boxed<E: DuelingDqnEngine + 'static, Env: VectorEnvironment + 'static>(
    engine: Result<E, WeightsError>,
    (parameters, environment, seed): (&DuelingDqn, Env, u64),
) -> Box<dyn Learner<Env>> {
    let engine = engine.expect(layers::DRAWN);
    Box::new(DuelingDqnLearner::new(engine, parameters, environment, seed))
}

/// Number of lanes in training.
const LANES: usize = 1;
/// Copies of the network in memory: the initial weights, the trained weights, their gradient,
/// Adam's two moments, and the target network.
const COPIES: usize = 6;
