//! The registration of PPO.

use crate::agent::architecture::NetworkPolicy;
#[cfg(feature = "burn")]
use crate::agent::burn::device::{inference, training};
#[cfg(feature = "burn")]
use crate::agent::burn::{ActorCritic, BurnNetwork, BurnPpo, RecurrentActorCritic};
use crate::agent::constraint::{ENGINE_IS_BUILT, GRU_HAS_ITS_LAYERS, RECURRENT, has_gru};
use crate::agent::fused::{FusedActorCritic, FusedNetwork, FusedPpo, FusedRecurrentActorCritic};
use crate::agent::layers::{self, Shape};
use crate::agent::learner::Learner;
#[cfg(not(feature = "burn"))]
use crate::agent::network::NoEngine;
use crate::agent::network::{Engine, Recurrent};
use crate::agent::orthogonal;
use crate::agent::policy::{ActionNetwork, Choice};
use crate::agent::ppo::{Ppo, PpoEngine, PpoLearner};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::VectorEnvironment;
use crate::kernel::Isa;
use crate::key::{Constraint, Parameter, Size, Violation};

use super::algorithm::{AlgorithmParameters, PER_STEP, Start, StartError, Task, Work, unless_fit};

const LANES: Parameter = Parameter::Agent("lanes");
const STEPS: Parameter = Parameter::Agent("steps");
const MINIBATCHES: Parameter = Parameter::Agent("minibatches");

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
                    Violation::Contradiction(format!(
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
        ENGINE_IS_BUILT,
        GRU_HAS_ITS_LAYERS,
    ];

    fn sizes(&self, task: &Task) -> Vec<Size> {
        let rows = u64::from(self.lanes).saturating_mul(u64::from(self.steps));
        layers::sizes(&layers::ppo(self, task.shape()), rows).to_vec()
    }

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
        let weights = layers::numbers(&layers::ppo(self, task.shape())) as u64;
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

    fn network(&self, shape: Shape, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
        let isa = Isa::chosen();
        let network: Box<dyn ActionNetwork + Send> = match (self.engine, self.recurrent) {
            (Engine::Fused, Recurrent::None) => {
                Box::new(FusedActorCritic::from_weights(self, shape, weights, isa)?)
            }
            (Engine::Fused, Recurrent::Gru) => {
                Box::new(FusedRecurrentActorCritic::from_weights(self, shape, weights, isa)?)
            }
            #[cfg(feature = "burn")]
            (Engine::Burn, Recurrent::None) => {
                Box::new(ActorCritic::from_weights(self, shape, weights, &inference())?)
            }
            #[cfg(feature = "burn")]
            (Engine::Burn, Recurrent::Gru) => {
                Box::new(RecurrentActorCritic::from_weights(self, shape, weights, &inference())?)
            }
            #[cfg(not(feature = "burn"))]
            (Engine::Burn, _) => return Err(NoEngine.into()),
        };
        let architecture = match self.recurrent {
            Recurrent::None => {
                // The critic chooses no action.
                let [policy, _] = layers::actor_critic(self, shape);
                Some(layers::architecture(self.activation, [policy]))
            }
            Recurrent::Gru => {
                let layers = layers::Recurrent::actor_critic(self, shape);
                Some(layers::recurrent_architecture(self.activation, layers, &["logits"]))
            }
        };
        Ok(NetworkPolicy { network, choice: Choice::Softmax, architecture })
    }
}

/// PPO before its first step in any environment of `lanes` lanes, on the engine given by its
/// parameters.
///
/// **Errors**: the environment does not have this number of lanes and 2 to 256 actions; memory for the
/// networks is short.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &Ppo,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, parameters.lanes as usize)?;
    let shape = Shape::from(&environment.interface());
    let weights = orthogonal::initial(
        &layers::ppo(parameters, shape),
        COPIES + parameters.engine.further_copies(),
        seed,
    )?;
    let isa = Isa::chosen();
    Ok(match (parameters.engine, parameters.recurrent) {
        (Engine::Fused, Recurrent::None) => {
            let engine = FusedPpo::<FusedActorCritic>::new(parameters, shape, &weights, isa);
            learner(engine, parameters, environment, seed)
        }
        (Engine::Fused, Recurrent::Gru) => {
            let engine =
                FusedPpo::<FusedRecurrentActorCritic>::new(parameters, shape, &weights, isa);
            learner(engine, parameters, environment, seed)
        }
        #[cfg(feature = "burn")]
        (Engine::Burn, Recurrent::None) => {
            let network = ActorCritic::from_weights(parameters, shape, &weights, &training());
            let engine = network.map(|network| BurnPpo::new(parameters, network));
            learner(engine, parameters, environment, seed)
        }
        #[cfg(feature = "burn")]
        (Engine::Burn, Recurrent::Gru) => {
            let device = training();
            let network = RecurrentActorCritic::from_weights(parameters, shape, &weights, &device);
            let engine = network.map(|network| BurnPpo::new(parameters, network));
            learner(engine, parameters, environment, seed)
        }
        #[cfg(not(feature = "burn"))]
        (Engine::Burn, _) => return Err(NoEngine.into()),
    })
}

fn learner<E: PpoEngine + 'static, Env: VectorEnvironment + 'static>(
    engine: Result<E, WeightsError>,
    parameters: &Ppo,
    environment: Env,
    seed: u64,
) -> Box<dyn Learner<Env>> {
    let engine = engine.expect(layers::DRAWN);
    Box::new(PpoLearner::new(engine, parameters, environment, seed))
}

/// Copies of the networks in memory: the initial weights, the trained weights, their gradient, and
/// Adam's two moments.
const COPIES: usize = 5;
