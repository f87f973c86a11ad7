//! # jitai
//!
//! Reinforcement-learning experiments for just-in-time adaptive interventions, from a declaration
//! to results that can be trusted.
//!
//! ```text
//! env, agent ──► manifest ──► plan ──► train ──► store ──► schedule ──► analyse ──► report
//!  what can       what an     what     one job,  one        who runs     pure        tables
//!  be simulated   author      should   from its  SQLite     it and       numbers     and
//!  and learned    declares    run      content   file       when                     figures
//! ```
//!
//! A **manifest** is the TOML file that an author writes. It expands into **jobs**: one
//! (environment, scenario, agent, seed, budget, evaluation) each. The **job key** is a hash of that
//! content and of the code's versions. A **run** is one attempt at a job; a job has at most one
//! completed run. `docs/architecture.md` has the map of the modules, the invariants and recipes.
//!
//! # Example
//!
//! ```
//! use jitai::{DataParts, Options, Reader, Store, jobs, parse_manifest, run_manifests, summarise_arms};
//!
//! let text = r#"
//!     format = 1
//!     name = "rules"
//!     scenarios = ["P"]
//!     seeds = 2
//!     environment.sigma = 0.6
//!     evaluation.test_episodes = 20
//!     [[agent]]
//!     name = "tailored"
//!     algorithm = "rule"
//!     rule = "tailored"
//! "#;
//! let manifest = parse_manifest("rules.toml", text.as_bytes())?;
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("results.sqlite");
//! let manifests = [manifest];
//! let tally = run_manifests(&mut Store::open(&path)?, &manifests, Options::default(), |_| {})?;
//! assert_eq!(tally.completed, 2);
//!
//! let [manifest] = &manifests;
//! let reader = Reader::open(&path)?;
//! let data = reader.data_set(&manifest.name, jobs(manifest), DataParts::default(), |_| {})?;
//! assert_eq!(summarise_arms(&data.jobs)[0].returns.n(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The public names stand at the root of the crate. `examples/` holds three programs that use them: a
//! sweep, an environment and an algorithm of their own. Modules that are reachable but not documented
//! serve the program, its tests and its benches; no version promises them.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

#[doc(hidden)]
pub mod agent;
#[doc(hidden)]
pub mod analyse;
#[doc(hidden)]
pub mod cli;
#[doc(hidden)]
pub mod cluster;
#[doc(hidden)]
pub mod env;
#[doc(hidden)]
pub mod kernel;
#[doc(hidden)]
pub mod key;
#[doc(hidden)]
pub mod kill_point;
#[doc(hidden)]
pub mod manifest;
#[doc(hidden)]
pub mod optimum;
#[doc(hidden)]
pub mod plan;
#[doc(hidden)]
pub mod record;
mod report;
#[doc(hidden)]
pub mod rng;
#[doc(hidden)]
pub mod schedule;
#[doc(hidden)]
pub mod state;
#[doc(hidden)]
pub mod store;
#[doc(hidden)]
pub mod train;

// Read a manifest.
pub use manifest::{
    Evaluation, Fault, Faults, Manifest, load as load_manifest, parse as parse_manifest,
    schema as manifest_schema,
};

// Expand it.
pub use plan::{
    Filter, FilterError, Job, JobKey, PlannedJob, Shard, ShardError, count as count_jobs, expand,
    jobs,
};

// Run it against a store.
pub use schedule::{
    Event, EventSink, OnFailure, Options, Queued, SweepError, Tally, run_manifests,
};
pub use store::{RetryFailed, Store, StoreError};

// Bring stores together.
pub use store::{
    Conflict, Damage, MergeProgress, Merged, Origin, OtherManifest, merge as merge_stores,
    stores_of,
};

// Read results.
pub use analyse::declared::{ArmSummary, summarise_arms};
pub use analyse::{Sample, Undefined};
pub use record::{
    ActionCount, CURVE_METRICS, CompletedRun, DataSet, Failure, FailureKind, JobRecord, JobStatus,
    METRICS, Provenance,
};
pub use store::{
    Answer, JobState, Parts as DataParts, QueryError, Reader, StoredWeights, Value as SqlValue,
};

// Make a report.
pub use manifest::Published;
pub use report::{ReportFile, ReportedExperiment, Work, assemble, report};

// Simulate an environment, or write one.
pub use env::contract::{Clause, Violation as ContractViolation, check as check_environment};
pub use env::{
    Action, ActionSpec, Environment, EpisodeStatus, FeatureSpec, LaneSet, LaneStreams,
    ObservationSpec, Observations, PhysicalActivity, Scenario, VectorEnvironment,
};
pub use rng::{Purpose, Stream};
pub use state::{Resumable, StateError, StateReader, StateWriter};

// Roll a policy.
pub use agent::{Actor, DecisionRule, RuleParameters, RulePolicy};
pub use train::{Recording, RollStreams, StepObserver, begin, play, roll};

// Train an agent in any environment.
pub use agent::{
    DuelingDqn, Reinforce, TerminalTarget, dueling_dqn_learner, reinforce_learner,
    trained_dueling_dqn, trained_reinforce,
};

// Declare keys and register an algorithm; the macros `keys!` and `choices!` belong here.
pub use agent::{
    ActionNetwork, Actions, Agent, Algorithm, AlgorithmParameters, AutodiffPolicy, Chosen,
    Constraint, Diverged, EpsilonGreedy, Learner, LearnerError, NameTaken, PolicyGradient,
    ReinforceEngine, ReinforceLearner, Setting, SoftmaxPolicy, Span, Start, StartError, Trained,
    TrainedEpisode, Trajectories, Violation, WeightTensor, Weights, WeightsError,
    Work as AgentWork, action_tensor, inference_device, observation_tensor, register,
    training_device,
};
pub use key::{Key, KeyType, Keyed, Kind, Parameter, Value};
