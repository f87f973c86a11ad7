//! What an algorithm declares of itself, and the agent that a job holds.

use std::any::TypeId;
use std::fmt;

use crate::agent::actor::Actor;
use crate::agent::constraint::Constraint;
use crate::agent::learner::{Actions, Learner};
use crate::agent::memory::OutOfMemory;
use crate::agent::weights::{Weights, WeightsError};
use crate::env::{
    Action, Environment, ObservationSpec, Observer, PhysicalActivity, Scenario, VectorEnvironment,
};
use crate::key::{Key, Keyed, Value};
use crate::optimum::NoOptimum;

/// What an agent is to learn or to act in: an environment, what it observes of it, and a seed.
#[derive(Clone, Copy, Debug)]
pub struct Task<'s> {
    /// Parameters of the simulation.
    pub environment: &'s Environment,
    /// What the agent observes.
    pub scenario: &'s Scenario,
    /// Seed of the job's random streams.
    pub seed: u64,
}

impl Task<'_> {
    /// What an agent observes.
    pub fn observations(&self) -> ObservationSpec {
        Observer::new(self.environment, self.scenario).spec()
    }

    /// Steps of this number of episodes, if none ends early.
    pub fn steps(&self, episodes: u32) -> u64 {
        u64::from(episodes) * u64::from(self.environment.horizon)
    }

    /// The simulation with this number of lanes.
    pub fn simulation(&self, lanes: usize) -> PhysicalActivity {
        PhysicalActivity::new(self.environment, self.scenario, lanes)
    }
}

/// Why an agent cannot begin.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// There is no memory for what it needs.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// It acts optimally, and the optimum is not computed.
    #[error(transparent)]
    NoOptimum(#[from] NoOptimum),
    /// The environment has another number of actions.
    #[error(
        "the environment has {actions} actions; the agents choose among exactly {}",
        Action::COUNT
    )]
    Actions {
        /// Its actions.
        actions: usize,
    },
    /// The environment has another number of lanes.
    #[error("the environment has {lanes} lanes; this agent trains on {expected}")]
    Lanes {
        /// Its lanes.
        lanes: usize,
        /// The lanes that the agent trains on.
        expected: usize,
    },
    /// What starts is not what the algorithm declares.
    #[error(
        "the algorithm `{algorithm}` declares {}",
        if *learns {
            "LEARNS = true, so that it starts a learner and has training episodes"
        } else {
            "LEARNS = false, so that it starts an actor and has no training episodes"
        }
    )]
    Inconsistent {
        /// The algorithm.
        algorithm: &'static str,
        /// What it declares.
        learns: bool,
    },
}

/// Fails unless an environment has the expected lanes, and as many actions as agents have.
pub(super) fn unless_fit(
    environment: &impl VectorEnvironment,
    expected: usize,
) -> Result<(), StartError> {
    let (actions, lanes) = (environment.action_spec().count, environment.lanes());
    if actions != Action::COUNT {
        return Err(StartError::Actions { actions });
    }
    if lanes == expected { Ok(()) } else { Err(StartError::Lanes { lanes, expected }) }
}

/// An agent before its first episode.
pub enum Start {
    /// An agent that has to be trained.
    Learner(Box<dyn Learner>),
    /// An agent that acts without training, such as a decision rule.
    Actor(Box<dyn Actor>),
}

/// The actor of an agent that was trained before.
///
/// **Errors**: the weights do not fit the agent; an algorithm that does not train has none.
pub type Trained = Result<Box<dyn Actor>, WeightsError>;

/// How much arithmetic an agent takes where no episode ends early, in multiply-adds. What is no
/// multiply-add counts as the multiply-adds that take as long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Work {
    /// The whole training, the simulation aside.
    pub training: u64,
    /// A choice of an action by the trained agent.
    pub choice: u64,
}

/// Multiply-adds that take as long as what a step of training costs, however few lanes take it
/// together.
pub(super) const PER_STEP: u64 = 3500;

/// Multiply-adds that take as long as an optimiser's update of one weight.
const PER_UPDATED_WEIGHT: u64 = 14;

impl Work {
    /// That of an agent which trains a network of so many weights: `rows` rows of a batch in all,
    /// `updates` times.
    pub fn of_network(weights: u64, rows: u64, updates: u64) -> Work {
        // Forward; and backward once for the weights and once for the layer before.
        let passes = rows.saturating_mul(3).saturating_mul(weights);
        let steps = updates.saturating_mul(PER_UPDATED_WEIGHT).saturating_mul(weights);
        Work { training: passes.saturating_add(steps), choice: weights }
    }

    /// This with so much more training.
    pub fn plus(self, training: u64) -> Work {
        Work { training: self.training.saturating_add(training), ..self }
    }
}

/// Weights of a network of two hidden layers of 128 units.
const USUAL_WEIGHTS: u64 = 128 * 128;

/// The hyper-parameters of an algorithm, and with them everything that the program has to know of
/// it.
pub trait AlgorithmParameters: Keyed + 'static {
    /// The word that manifests, jobs and the store write.
    const NAME: &'static str;
    /// Whether it trains, so that its completed jobs have weights; true unless declared otherwise.
    const LEARNS: bool = true;
    /// What its jobs must satisfy beyond the ranges of single keys; nothing unless declared.
    const CONSTRAINTS: &'static [Constraint] = &[];

    /// The version of its code, 1 unless declared; raise it whenever a change gives the same job
    /// other results.
    fn version(&self) -> u32 {
        1
    }

    /// Episodes of training: the job's budget. 0 for an algorithm that does not train.
    fn episodes(&self) -> u32;

    /// How much arithmetic it takes, from which times are estimated and shards are cut. Unless
    /// declared, that of a network with two hidden layers of 128 units, updated at every step.
    fn work(&self, task: &Task) -> Work {
        let steps = task.steps(self.episodes());
        Work::of_network(USUAL_WEIGHTS, steps, steps).plus(steps.saturating_mul(PER_STEP))
    }

    /// An agent at the start of its job.
    ///
    /// **Errors**: there is no memory for what it needs, or it is a rule that cannot be computed.
    fn start(&self, task: &Task) -> Result<Start, StartError>;

    /// The actor of an agent that was trained before, on the engine that trained it.
    ///
    /// **Errors**: the weights do not fit the agent; an algorithm that does not train has none.
    fn trained(
        &self,
        task: &Task,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError>;
}

/// A registered algorithm: what [`AlgorithmParameters`] declare, for all types alike.
pub struct Algorithm {
    name: &'static str,
    parameters: TypeId,
    keys: &'static [Key],
    learns: bool,
    constraints: &'static [Constraint],
    are_values: fn(&[Value]) -> bool,
    version: fn(&[Value]) -> u32,
    episodes: fn(&[Value]) -> u32,
    work: fn(&[Value], &Task) -> Work,
    start: fn(&[Value], &Task) -> Result<Start, StartError>,
    trained: TrainedBy,
}

/// [`AlgorithmParameters::trained`] of the parameters with these values.
type TrainedBy = fn(&[Value], &Task, &Weights, Actions) -> Trained;

impl Algorithm {
    /// The algorithm of these hyper-parameters.
    pub const fn of<P: AlgorithmParameters>() -> Algorithm {
        Algorithm {
            name: P::NAME,
            parameters: TypeId::of::<P>(),
            keys: P::KEYS,
            learns: P::LEARNS,
            constraints: P::CONSTRAINTS,
            are_values: |values| P::from_values(values).is_some(),
            version: |values| typed::<P>(values).version(),
            episodes: |values| typed::<P>(values).episodes(),
            work: |values, task| typed::<P>(values).work(task),
            start: |values, task| typed::<P>(values).start(task),
            trained: |values, task, weights, actions| {
                typed::<P>(values).trained(task, weights, actions)
            },
        }
    }

    /// The word that manifests, jobs and the store write.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Its keys, in the order the documentation lists them.
    pub fn keys(&self) -> &'static [Key] {
        self.keys
    }

    /// Whether it trains, so that its completed jobs have weights.
    pub fn learns(&self) -> bool {
        self.learns
    }

    /// What its jobs must satisfy beyond the ranges of single keys.
    pub fn constraints(&self) -> &'static [Constraint] {
        self.constraints
    }
}

fn typed<P: Keyed>(values: &[Value]) -> P {
    P::from_values(values).expect("an agent's values are of the types of its keys")
}

// An algorithm is the type that declares it: two that are not registered may have one name.
impl PartialEq for Algorithm {
    fn eq(&self, other: &Self) -> bool {
        self.parameters == other.parameters
    }
}

impl Eq for Algorithm {}

impl fmt::Debug for Algorithm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// An algorithm with its hyper-parameters, as a job holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct Agent {
    algorithm: &'static Algorithm,
    values: Vec<Value>,
}

impl Agent {
    /// The agent with these hyper-parameters.
    pub fn of<P: AlgorithmParameters>(parameters: &P) -> Agent {
        Agent { algorithm: const { &Algorithm::of::<P>() }, values: parameters.to_values() }
    }

    /// The agent with these values, one for each of the algorithm's keys in their order; `None` if
    /// one is of another type, or if there are too many or too few.
    pub fn with_values(algorithm: &'static Algorithm, values: Vec<Value>) -> Option<Agent> {
        (algorithm.are_values)(&values).then_some(Agent { algorithm, values })
    }

    /// The algorithm.
    pub fn algorithm(&self) -> &'static Algorithm {
        self.algorithm
    }

    /// The value of each of the algorithm's keys, in their order.
    pub fn values(&self) -> &[Value] {
        &self.values
    }

    /// The hyper-parameters, if they are of this type.
    pub fn parameters<P: AlgorithmParameters>(&self) -> Option<P> {
        let is_of_type = self.algorithm.parameters == TypeId::of::<P>();
        if is_of_type { P::from_values(&self.values) } else { None }
    }

    /// The version of the algorithm's code; see [`AlgorithmParameters::version`].
    pub fn version(&self) -> u32 {
        (self.algorithm.version)(&self.values)
    }

    /// Episodes of training; see [`AlgorithmParameters::episodes`].
    pub fn episodes(&self) -> u32 {
        (self.algorithm.episodes)(&self.values)
    }

    /// How much arithmetic it takes; see [`AlgorithmParameters::work`].
    pub fn work(&self, task: &Task) -> Work {
        (self.algorithm.work)(&self.values, task)
    }

    /// The agent at the start of its job.
    ///
    /// **Errors**: there is no memory for what it needs, it is a rule that cannot be computed, or its
    /// algorithm does not start what it declares.
    pub fn start(&self, task: &Task) -> Result<Start, StartError> {
        let start = (self.algorithm.start)(&self.values, task)?;
        let (algorithm, learns) = (self.algorithm.name, self.algorithm.learns);
        let consistent = match start {
            Start::Learner(_) => learns && self.episodes() > 0,
            Start::Actor(_) => !learns && self.episodes() == 0,
        };
        if consistent { Ok(start) } else { Err(StartError::Inconsistent { algorithm, learns }) }
    }

    /// The actor of an agent that was trained before; see [`AlgorithmParameters::trained`].
    ///
    /// **Errors**: the weights do not fit the agent; an algorithm that does not train has none.
    pub fn trained(
        &self,
        task: &Task,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        (self.algorithm.trained)(&self.values, task, weights, actions)
    }
}
