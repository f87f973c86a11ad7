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
//! use std::sync::atomic::AtomicBool;
//!
//! use jitai::experiment::{self, Options, Store};
//! use jitai::results::{Parts, Reader, summarise_arms};
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
//! let manifests = [experiment::parse("rules.toml", text.as_bytes())?];
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("results.sqlite");
//! let mut store = Store::open(&path)?;
//! let stop = AtomicBool::new(false);
//! let tally = experiment::run(&mut store, &manifests, Options::default(), &stop, |_| {})?;
//! assert_eq!(tally.completed, 2);
//!
//! let data = Reader::open(&path)?.data_set(&manifests[0], Parts::default())?;
//! assert_eq!(summarise_arms(&data.jobs)[0].returns.n(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Modules
//!
//! [`experiment`] declares and runs jobs, [`results`] reads them and makes reports; [`findings`] is
//! what reports draw, [`statistics`] computes it. [`environment`] and [`policy`] simulate without a store.
//! [`algorithm`] trains, declares keys (with [`keys!`] and [`choices!`]) and registers algorithms.
//! `examples/` holds three programs that use them: a sweep, an environment and an algorithm of their
//! own. Other modules of the crate serve the program, its tests and its benches; no version promises
//! them.

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

/// Experiments: read a manifest, expand it into jobs, and run them against a store.
pub mod experiment {
    pub use crate::manifest::{
        Analysis, AnalysisKind, Condition, Contrast, CurveAxis, DataPart, DeclaredAgent, Described,
        Evaluation, Exclusion, Fault, Faults, Manifest, Pairing, Parameters, Position, Published,
        PublishedCurve, PublishedErrors, PublishedHeatMap, PublishedTest, Section, SelectionRule,
        Sides, TestActions, Zip, load, parse, schema,
    };
    pub use crate::plan::{
        CanonicalForm, Filter, FilterError, Job, JobError, JobKey, PlannedJob, Scalar, Shard,
        ShardError, Versions, count, expand, jobs,
    };
    pub use crate::record::{CurvePoint, Metric, Outcome, Results, TestEpisode};
    pub use crate::schedule::{
        CheckpointNote, Event, EventSink, Found, OnFailure, Options, Queued, SweepError, Tally,
        run_manifests as run,
    };
    pub use crate::store::{
        Conflict, Damage, MergeProgress, Merged, Origin, OtherManifest, RetryFailed, Store,
        StoreError, merge, stores_of,
    };
    pub use crate::train::{CheckpointError, TrainingProgress};
}

/// Results: read them from a store, summarise arms, ask in SQL, make a report.
pub mod results {
    pub use crate::analyse::declared::{
        AgentSummary, Arm, ArmId, ArmSummary, summarise_agents, summarise_arms,
    };
    pub use crate::manifest::Setting;
    pub use crate::record::{
        ActionCount, CURVE_METRICS, CompletedRun, DataSet, Failure, FailureKind, JobRecord,
        JobStatus, METRICS, Provenance,
    };
    pub use crate::report::{
        AssembleError, ReportFile, ReportedExperiment, Work, assemble, report,
    };
    pub use crate::store::{
        Answer, ExperimentCounts, FailedJob, Interrupter, JobState, Pace, Parts, QueryError,
        Reader, StoredWeights, Value as SqlValue,
    };
}

/// Environments: the contract, the check of it, and the simulation of the paper.
pub mod environment {
    pub use crate::env::contract::{Clause, Violation, check};
    pub use crate::env::{
        Action, ActionSpec, ContextDraw, Environment, EpisodeStatus, Feature, FeatureSpec,
        FirstContext, LaneSet, LaneStreams, ObservationSpec, Observations, PhysicalActivity,
        Scenario, ScenarioError, TimeIndicator, VectorEnvironment,
    };
    pub use crate::rng::{Purpose, Stream};
    pub use crate::state::{Number, Resumable, StateError, StateReader, StateWriter};
}

/// Policies: actors, decision rules, and the episodes that they play.
pub mod policy {
    pub use crate::agent::{
        ActionNetwork, Actions, Actor, DecisionRule, EpsilonGreedy, RuleParameters, RulePolicy,
        SoftmaxPolicy,
    };
    pub use crate::optimum::NoOptimum;
    pub use crate::train::{RollStreams, Rollout, StepObserver, begin, play, roll};
}

/// Algorithms: train those of the library in any environment, or register one; the keys that they
/// declare.
pub mod algorithm {
    pub use crate::agent::{
        Activation, Agent, Algorithm, AlgorithmParameters, Assignment, AutodiffPolicy, Constraint,
        Diverged, DuelingDqn, Engine, Learner, LearnerError, OutOfMemory, PolicyGradient,
        RegistrationError, Reinforce, ReinforceEngine, ReinforceLearner, Span, Start, StartError,
        Task, TerminalTarget, Trained, TrainedEpisode, Trajectories, Trunk, Violation,
        WeightTensor, Weights, WeightsError, Work, action_tensor, dueling_dqn_learner,
        inference_device, observation_tensor, register_algorithm, reinforce_learner,
        trained_dueling_dqn, trained_reinforce, training_device,
    };
    pub use crate::kernel::Isa;
    pub use crate::key::{
        CanonicalError, Key, KeyType, Keyed, Kind, Parameter, SettingError, Value,
    };
}

/// Findings: what declared analyses compute from results, as reports draw it.
pub mod findings {
    pub use crate::analyse::declared::{
        ActionPanel, BinShares, Candidate, Comparison, Content, ContrastRow, CurveFigure,
        CurveLine, CurvePoint, Distance, ErrorFigure, ErrorPoint, Finding, HeatFigure, HeatTile,
        JobCounts, LearningFigure, LearningLine, LearningPanel, Ranking, Reproduction, Scale,
        Subject,
    };
}

/// Statistics over seeds: pure functions of samples.
pub mod statistics {
    pub use crate::analyse::{
        Aggregate, Agreement, Contrast, Corrected, Design, DuplicateSeed, Estimate, FEW_SEEDS,
        HedgesG, Improvement, Interval, LEVEL, Likeness, Lost, MOST_ARRANGEMENTS, Moments, POWER,
        RESAMPLES, Sample, TTest, Tests, Undefined, Verdict, agreement, correct, detectable,
        hedges_g, improvement, interquartile_mean, lower_quartile, mean_and_sd, mean_interval,
        moving_mean, paired_detectable, paired_hedges_g, paired_improvement, paired_permutation_p,
        paired_t_test, permutation_p, quantile, student_t_test, welch_t_test,
    };
}
