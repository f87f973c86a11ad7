//! The declarations of an algorithm, and the agent of a job.

use std::any::TypeId;
use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;

use crate::agent::actor::{Actor, StudyAgent};
use crate::agent::architecture::NetworkPolicy;
use crate::agent::constraint::{OF_TESTING, OF_TRAINING};
use crate::agent::layers::Shape;
use crate::agent::learner::{Actions, Learner};
use crate::agent::memory::OutOfMemory;
use crate::agent::network::{Engine, NoEngine};
use crate::agent::rule::{DecisionRule, RuleParameters};
use crate::agent::unavailable::{UNAVAILABLE, Unavailable};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::{
    Action, Environment, Interface, ObservationSpec, Scenario, Simulated, StepCountModel,
    VectorEnvironment,
};
use crate::key::{Constraint, Key, Keyed, Kind, Parameter, Size, Value};
use crate::optimum::NoOptimum;

/// The task of an agent: an environment, the scenario that it observes, and a seed.
#[derive(Clone, Copy, Debug)]
pub struct Task<'s> {
    /// The environment, with its participants.
    pub environment: &'s Environment,
    /// The scenario that the agent observes.
    pub scenario: &'s Scenario,
    /// Seed of the job's random streams.
    pub seed: u64,
    /// Number of observations seen at a time: the current one and earlier ones. An [`Agent`] sets
    /// it to its own history.
    pub history: u32,
}

impl Task<'_> {
    /// The specification of the agent's observations.
    pub fn observations(&self) -> ObservationSpec {
        self.interface().observations
    }

    /// What the agent sees and chooses among.
    pub fn interface(&self) -> Interface {
        let Interface { observations, actions } = self.environment.interface(self.scenario);
        Interface { observations: observations.stacked(self.history as usize), actions }
    }

    /// The sizes of the agent's networks.
    pub fn shape(&self) -> Shape {
        Shape::from(&self.interface())
    }

    /// Number of steps of this number of episodes, if no episode ends early.
    pub fn steps(&self, episodes: u32) -> u64 {
        u64::from(episodes) * u64::from(self.environment.longest_episode())
    }

    /// Whether messages can be unavailable at some steps for anybody, for lack of availability or budget.
    pub fn can_withhold(&self) -> bool {
        self.environment.can_withhold()
    }

    /// The simulation for training, with this number of lanes.
    pub fn simulation(&self, lanes: usize) -> Simulated {
        self.environment.training(self.scenario, self.history as usize, lanes)
    }

    /// The simulation for the test, whose participants differ whatever the training meets.
    pub fn tested(&self, lanes: usize) -> Simulated {
        self.environment.testing(self.scenario, self.history as usize, lanes)
    }

    /// The environment.
    ///
    /// # Panics
    /// If it is of another family than `step_count`.
    pub fn model(&self) -> &StepCountModel {
        self.step_count().expect("an environment of step_count")
    }

    /// The environment, if it is of the family `step_count`.
    pub fn step_count(&self) -> Option<&StepCountModel> {
        self.environment.model()
    }
}

/// Why an agent cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// Memory is short.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// The agent acts optimally, and the optimum cannot be computed.
    #[error(transparent)]
    NoOptimum(#[from] NoOptimum),
    /// The rule acts on the state of another family of environments.
    #[error("rule = \"{rule}\" needs an environment of the family step_count")]
    Family {
        /// The rule.
        rule: &'static str,
    },
    /// The rule repeats the actions of a recorded trial, and the environment is another.
    #[error("rule = \"recorded\" needs a recorded trial")]
    NotRecorded,
    /// The program was built without the engine of the agent.
    #[error(transparent)]
    NoEngine(#[from] NoEngine),
    /// The environment has too few or too many actions.
    #[error("an environment needs 2 to 256 actions for its agents; this one has {actions}")]
    Actions {
        /// Number of actions.
        actions: usize,
    },
    /// A hyper-parameter does not suit the environment.
    #[error(transparent)]
    Unsuited(#[from] Unsuited),
    /// The environment has a different number of lanes.
    #[error("the environment has {lanes} lanes, but this agent trains on {expected}")]
    Lanes {
        /// Number of lanes.
        lanes: usize,
        /// Number of lanes that the agent trains on.
        expected: usize,
    },
    /// The agent is a user's program, which only a run starts.
    #[error("the agent is an outside program; only `jitai run` starts it")]
    Outside,
    /// The algorithm starts the wrong kind of agent, or its number of training episodes contradicts
    /// [`AlgorithmParameters::LEARNS`].
    #[error(
        "the algorithm `{algorithm}` declares {}",
        if *learns {
            "LEARNS = true, so it must start a learner and have training episodes"
        } else {
            "LEARNS = false, so it must start an actor and have no training episodes"
        }
    )]
    Inconsistent {
        /// The algorithm.
        algorithm: &'static str,
        /// The declared value of [`AlgorithmParameters::LEARNS`].
        learns: bool,
    },
}

/// A hyper-parameter that does not suit the environment of a job.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{}` does not suit an environment with {environment}: {says}", key.key())]
pub struct Unsuited {
    /// The hyper-parameter.
    pub key: Parameter,
    /// What the environment has, as in "4 actions".
    pub environment: String,
    /// What the hyper-parameter must be.
    pub says: Cow<'static, str>,
}

/// Fails unless an environment has the expected number of lanes, and actions to choose among.
pub(super) fn unless_fit(
    environment: &impl VectorEnvironment,
    expected: usize,
) -> Result<(), StartError> {
    let (actions, lanes) = (environment.action_spec().count, environment.lanes());
    if !Action::COUNTS.contains(&actions) {
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

/// The actor of a previously trained agent.
///
/// **Errors**: the weights do not fit the agent; an algorithm that does not train has no weights.
pub type Trained = Result<Box<dyn Actor>, WeightsError>;

/// Who learns from whom in a trial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// One agent learns from everybody.
    Everybody,
    /// One agent learns from everybody what people have in common, and from each person how the person differs.
    Partial,
    /// There are several agents, each of which learns from its own people, \[agents\]\[people of the agent\].
    Apart(Vec<Vec<usize>>),
}

/// The people of a trial, as agents meet them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StudyPlan {
    /// Number of people.
    pub people: usize,
    /// The largest number of decisions of a person.
    pub decisions: usize,
    /// Who learns from whom.
    pub sharing: Sharing,
    /// Whether the agent keeps what it has learned at every update; see [`StudyAgent::updates`].
    pub keeps_updates: bool,
}

/// The arithmetic of an agent in multiply-adds, if no episode ends early. Other operations count as
/// the number of multiply-adds that take equally long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Work {
    /// The whole training, without the simulation.
    pub training: u64,
    /// One choice of an action by the trained agent.
    pub choice: u64,
}

/// Fixed cost of a training step for any number of lanes, in multiply-adds.
pub(super) const PER_STEP: u64 = 3500;

/// Cost of an optimiser's update of one weight, in multiply-adds.
const PER_UPDATED_WEIGHT: u64 = 14;

impl Work {
    /// The work of training a network of `weights` weights on `rows` batch rows in total, with
    /// `updates` updates.
    pub fn of_network(weights: u64, rows: u64, updates: u64) -> Work {
        // Forward, and backward once for the weights and once for the previous layer.
        let passes = rows.saturating_mul(3).saturating_mul(weights);
        let steps = updates.saturating_mul(PER_UPDATED_WEIGHT).saturating_mul(weights);
        Work { training: passes.saturating_add(steps), choice: weights }
    }

    /// This work plus additional training.
    pub fn plus(self, training: u64) -> Work {
        Work { training: self.training.saturating_add(training), ..self }
    }
}

/// Weights of a network of two hidden layers of 128 units.
const USUAL_WEIGHTS: u64 = 128 * 128;

/// The hyper-parameters of an algorithm, and everything that the program needs to run it.
pub trait AlgorithmParameters: Keyed + 'static {
    /// The name in manifests, jobs and the store.
    const NAME: &'static str;
    /// Whether the algorithm trains; true by default.
    const LEARNS: bool = true;
    /// Whether completed jobs of the algorithm have weights; equal to
    /// [`AlgorithmParameters::LEARNS`] by default.
    const HAS_WEIGHTS: bool = Self::LEARNS;
    /// Constraints on jobs beyond the ranges of single keys; none by default.
    const CONSTRAINTS: &'static [Constraint] = &[];

    /// The keys that the algorithm does not read in trials; `None` if it cannot act in one.
    const UNREAD_IN_TRIALS: Option<&'static [&'static str]> = None;
    /// The keys that [`AlgorithmParameters::unsuited`] judges; none by default.
    const SUITED: &'static [Parameter] = &[];

    /// The first of these keys that does not suit what the agent sees and chooses among, although its value is
    /// in range.
    fn unsuited(&self, _: &Interface) -> Option<Unsuited> {
        None
    }

    /// The sizes of training that have limits, such as those of networks, batches and buffers; none
    /// by default. They must not depend on real-valued keys.
    fn sizes(&self, _: &Task) -> Vec<Size> {
        Vec::new()
    }

    /// The version of its code; 1 by default. Raise it whenever a change of the code changes results.
    fn version(&self) -> u32 {
        1
    }

    /// Number of training episodes, the budget of the job; 0 for an algorithm that does not train.
    fn episodes(&self) -> u32;

    /// The arithmetic of a job, used to estimate times and to balance shards. The default is a
    /// network with two hidden layers of 128 units and one update per step.
    fn work(&self, task: &Task) -> Work {
        let steps = task.steps(self.episodes());
        Work::of_network(USUAL_WEIGHTS, steps, steps).plus(steps.saturating_mul(PER_STEP))
    }

    /// Multiply-adds of training per second on one core of a recent server processor; see
    /// [`Engine::speed`]. Measured times in a store replace it.
    fn speed(&self) -> f64 {
        Engine::Fused.speed()
    }

    /// The agent at the start of its job.
    ///
    /// **Errors**: memory is short, or an optimal rule cannot be computed.
    fn start(&self, task: &Task) -> Result<Start, StartError>;

    /// The agent before the first step of a trial, in which all people are lanes of one environment. The default is
    /// an agent that acts without training.
    ///
    /// **Errors**: as [`AlgorithmParameters::start`].
    fn in_trial(&self, task: &Task, _: StudyPlan) -> Result<Box<dyn StudyAgent>, StartError> {
        match self.start(task)? {
            Start::Actor(actor) => Ok(Box::new(actor)),
            Start::Learner(_) => {
                let (algorithm, learns) = (Self::NAME, Self::LEARNS);
                Err(StartError::Inconsistent { algorithm, learns })
            }
        }
    }

    /// The network of a previously trained agent, on the engine that trained it. The default is
    /// an agent without a network.
    ///
    /// **Errors**: the weights do not fit the agent, or it has no network.
    fn network(&self, _shape: Shape, _weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
        Err(WeightsError::NoNetwork)
    }

    /// The actor of a previously trained agent; by default the policy of its network.
    ///
    /// **Errors**: the weights do not fit the agent; an algorithm that does not train has no
    /// weights.
    fn trained(&self, task: &Task, weights: &Weights, actions: Actions) -> Trained {
        let observations = task.observations().observations();
        Ok(self.network(task.shape(), weights)?.actor(observations, actions))
    }
}

/// A registered algorithm: the declarations of [`AlgorithmParameters`], independent of the type.
#[derive(Clone, Copy)]
pub struct Algorithm {
    name: &'static str,
    parameters: TypeId,
    keys: &'static [Key],
    /// Number of keys that the algorithm itself declares.
    own_keys: usize,
    learns: bool,
    has_weights: bool,
    constraints: &'static [Constraint],
    are_values: fn(&[Value]) -> bool,
    version: fn(&[Value]) -> u32,
    episodes: fn(&[Value]) -> u32,
    work: fn(&[Value], &Task) -> Work,
    speed: fn(&[Value]) -> f64,
    sizes: fn(&[Value], &Task) -> Vec<Size>,
    suited: &'static [Parameter],
    unsuited: fn(&[Value], &Interface) -> Option<Unsuited>,
    start: fn(&[Value], &Task) -> Result<Start, StartError>,
    unread_in_trials: Option<&'static [&'static str]>,
    in_trial: InTrial,
    network: NetworkOf,
    trained: TrainedBy,
}

/// [`AlgorithmParameters::in_trial`] of the parameters with these values.
type InTrial = fn(&[Value], &Task, StudyPlan) -> Result<Box<dyn StudyAgent>, StartError>;

/// [`AlgorithmParameters::network`] of the parameters with these values.
type NetworkOf = fn(&[Value], Shape, &Weights) -> Result<NetworkPolicy, WeightsError>;

/// [`AlgorithmParameters::trained`] of the parameters with these values.
type TrainedBy = fn(&[Value], &Task, &Weights, Actions) -> Trained;

impl Algorithm {
    /// The algorithm of these hyper-parameters.
    pub const fn of<P: AlgorithmParameters>() -> Algorithm {
        Algorithm {
            name: P::NAME,
            parameters: TypeId::of::<P>(),
            keys: KeysOf::<P>::ALL,
            own_keys: P::KEYS.len(),
            learns: P::LEARNS,
            has_weights: P::HAS_WEIGHTS,
            constraints: P::CONSTRAINTS,
            are_values: |values| {
                let own = values.get(..P::KEYS.len()).and_then(P::from_values);
                let history = values.get(P::KEYS.len());
                let fits = !P::LEARNS || history.is_some_and(|value| HISTORY.kind.admits(value));
                own.is_some() && fits
            },
            version: |values| typed::<P>(values).version(),
            episodes: |values| typed::<P>(values).episodes(),
            work: |values, task| typed::<P>(values).work(task),
            speed: |values| typed::<P>(values).speed(),
            sizes: |values, task| typed::<P>(values).sizes(task),
            suited: P::SUITED,
            unsuited: |values, interface| typed::<P>(values).unsuited(interface),
            start: |values, task| typed::<P>(values).start(task),
            unread_in_trials: P::UNREAD_IN_TRIALS,
            in_trial: |values, task, plan| typed::<P>(values).in_trial(task, plan),
            network: |values, shape, weights| typed::<P>(values).network(shape, weights),
            trained: |values, task, weights, actions| {
                typed::<P>(values).trained(task, weights, actions)
            },
        }
    }

    /// The keys whose values must suit the environment; see [`AlgorithmParameters::SUITED`].
    pub fn suited(&self) -> &'static [Parameter] {
        self.suited
    }

    /// The keys that the algorithm does not read in trials; `None` if it cannot act in one.
    pub fn unread_in_trials(&self) -> Option<&'static [&'static str]> {
        self.unread_in_trials
    }

    /// The name in manifests, jobs and the store.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Its keys, in the order of the documentation.
    pub fn keys(&self) -> &'static [Key] {
        self.keys
    }

    /// Whether it trains.
    pub fn learns(&self) -> bool {
        self.learns
    }

    /// Whether its completed jobs have weights.
    pub fn has_weights(&self) -> bool {
        self.has_weights
    }

    /// The same algorithm with different keys, whose values its functions receive unchanged.
    pub(super) fn with_keys(&self, keys: &'static [Key]) -> Algorithm {
        Algorithm { keys, ..*self }
    }

    /// Constraints on its jobs beyond the ranges of single keys.
    pub fn constraints(&self) -> impl Iterator<Item = &'static Constraint> {
        self.constraints.iter().chain(if self.learns { OF_TRAINING } else { OF_TESTING })
    }
}

/// Maximum number of keys of an algorithm.
const MOST_KEYS: usize = 64;

/// The key that all learning agents share.
const HISTORY: Key = Key {
    name: "history",
    kind: Kind::Integer { min: 1, max: 1000 },
    written_doc: " number of observations that the agent sees per step: the current one and its \
                  predecessors, oldest first, zeros before the first step",
    default: Some(|| Value::Integer(1)),
    before: Some(|| Value::Integer(1)),
    earlier: None,
};

/// The keys of an algorithm: its own, followed by the keys that all learning agents share.
struct KeysOf<P>(PhantomData<P>);

impl<P: AlgorithmParameters> KeysOf<P> {
    const FILLED: &'static [Key; MOST_KEYS] = &{
        let mut all = [HISTORY; MOST_KEYS];
        let mut index = 0;
        while index < P::KEYS.len() {
            all[index] = P::KEYS[index];
            index += 1;
        }
        all
    };
    const ALL: &'static [Key] = {
        let shared = if P::LEARNS { 1 } else { 0 };
        assert!(P::KEYS.len() < MOST_KEYS, "an algorithm has fewer keys");
        Self::FILLED.split_at(P::KEYS.len() + shared).0
    };
}

fn typed<P: Keyed>(values: &[Value]) -> P {
    P::from_values(&values[..P::KEYS.len()])
        .expect("an agent's values are of the types of its keys")
}

// Algorithms are compared by their type, because two unregistered algorithms may have the same
// name. Outside programs share a type and are compared by the names of their parameters.
impl PartialEq for Algorithm {
    fn eq(&self, other: &Self) -> bool {
        let names = |algorithm: &Algorithm| algorithm.keys.iter().map(|key| key.name);
        self.parameters == other.parameters && names(self).eq(names(other))
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
        let mut values = parameters.to_values();
        values.extend(P::LEARNS.then_some(Value::Integer(1)));
        Agent { algorithm: const { &Algorithm::of::<P>() }, values }
    }

    /// The same agent with this history, the number of observations at a time, at least 1. An agent
    /// that does not learn always has history 1.
    pub fn with_history(mut self, history: u32) -> Agent {
        if self.algorithm.learns {
            self.values[self.algorithm.own_keys] = Value::Integer(history.into());
        }
        self
    }

    /// Number of observations seen at a time.
    pub fn history(&self) -> u32 {
        match self.values.get(self.algorithm.own_keys).filter(|_| self.algorithm.learns) {
            Some(Value::Integer(history)) => (*history).try_into().unwrap_or(u32::MAX),
            Some(_) | None => 1,
        }
    }

    /// A task as this agent sees it.
    fn seen<'t>(&self, task: &Task<'t>) -> Task<'t> {
        Task { history: self.history(), ..*task }
    }

    /// The agent with these values, one for each of the algorithm's keys in their order. `None` if
    /// the number of values or a type is wrong.
    pub fn with_values(algorithm: &'static Algorithm, values: Vec<Value>) -> Option<Agent> {
        let fits = values.len() == algorithm.keys.len() && (algorithm.are_values)(&values);
        fits.then_some(Agent { algorithm, values })
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
        if is_of_type { Some(typed(&self.values)) } else { None }
    }

    /// The version of the algorithm's code; see [`AlgorithmParameters::version`].
    pub fn version(&self) -> u32 {
        (self.algorithm.version)(&self.values)
    }

    /// Whether the agent learns or acts otherwise in this task than earlier versions did, although its version
    /// is the same elsewhere.
    pub fn differs_in(&self, task: &Task) -> bool {
        // Where messages can be unavailable, agents learned otherwise before they had the key `unavailable`.
        let model = task.step_count();
        let learns_otherwise =
            || model.is_some() && self.value(UNAVAILABLE).is_some() && task.can_withhold();
        let rule: Option<RuleParameters> = self.parameters();
        let acts_otherwise = |rule: RuleParameters| {
            model.is_some_and(|model| rule.acts_otherwise(model, task.scenario))
        };
        rule.is_some_and(acts_otherwise) || learns_otherwise()
    }

    /// Whether the agent never draws an action by chance. Agents that draw may have probabilities of 0 and 1.
    pub fn never_draws(&self) -> bool {
        self.parameters().is_some_and(|rule: RuleParameters| {
            !matches!(rule.rule, DecisionRule::Random | DecisionRule::Recorded)
        })
    }

    /// Whether the agent chooses where no message can be sent. Agents without the key `unavailable` do.
    pub fn unavailable(&self) -> Unavailable {
        match self.value(UNAVAILABLE) {
            None => Unavailable::Chosen,
            Some(Value::Choice(word)) if *word == Unavailable::Chosen.word() => Unavailable::Chosen,
            Some(_) => Unavailable::Masked,
        }
    }

    /// The value of one of the algorithm's keys.
    fn value(&self, name: &str) -> Option<&Value> {
        let index = self.algorithm.keys.iter().position(|key| key.name == name)?;
        self.values.get(index)
    }

    /// Episodes of training; see [`AlgorithmParameters::episodes`].
    pub fn episodes(&self) -> u32 {
        (self.algorithm.episodes)(&self.values)
    }

    /// The arithmetic of a job; see [`AlgorithmParameters::work`].
    pub fn work(&self, task: &Task) -> Work {
        (self.algorithm.work)(&self.values, &self.seen(task))
    }

    /// The sizes of training that have limits; see [`AlgorithmParameters::sizes`].
    pub fn sizes(&self, task: &Task) -> Vec<Size> {
        (self.algorithm.sizes)(&self.values, &self.seen(task))
    }

    /// The first key that does not suit the task; see [`AlgorithmParameters::unsuited`].
    pub fn unsuited(&self, task: &Task) -> Option<Unsuited> {
        (self.algorithm.unsuited)(&self.values, &self.seen(task).interface())
    }

    /// Multiply-adds of training per second; see [`AlgorithmParameters::speed`].
    pub fn speed(&self) -> f64 {
        (self.algorithm.speed)(&self.values)
    }

    /// The agent at the start of its job.
    ///
    /// **Errors**: memory is short, an optimal rule cannot be computed, or the algorithm
    /// contradicts its declaration of whether it learns.
    pub fn start(&self, task: &Task) -> Result<Start, StartError> {
        let start = (self.algorithm.start)(&self.values, &self.seen(task))?;
        let (algorithm, learns) = (self.algorithm.name, self.algorithm.learns);
        let consistent = match start {
            Start::Learner(_) => learns && self.episodes() > 0,
            Start::Actor(_) => !learns && self.episodes() == 0,
        };
        if consistent { Ok(start) } else { Err(StartError::Inconsistent { algorithm, learns }) }
    }

    /// The agent before the first step of a trial; see [`AlgorithmParameters::in_trial`].
    ///
    /// **Errors**: as [`Agent::start`].
    pub fn in_trial(
        &self,
        task: &Task,
        plan: StudyPlan,
    ) -> Result<Box<dyn StudyAgent>, StartError> {
        (self.algorithm.in_trial)(&self.values, &self.seen(task), plan)
    }

    /// The network of a previously trained agent; see [`AlgorithmParameters::network`].
    ///
    /// **Errors**: the weights do not fit the agent, or it has no network.
    pub fn network(&self, shape: Shape, weights: &Weights) -> Result<NetworkPolicy, WeightsError> {
        (self.algorithm.network)(&self.values, shape, weights)
    }

    /// The actor of a previously trained agent; see [`AlgorithmParameters::trained`].
    ///
    /// **Errors**: the weights do not fit the agent; an algorithm that does not train has no
    /// weights.
    pub fn trained(
        &self,
        task: &Task,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        (self.algorithm.trained)(&self.values, &self.seen(task), weights, actions)
    }
}
