//! # jitai
//!
//! Reinforcement-learning experiments for just-in-time adaptive interventions: declared in a manifest,
//! run to reproducible results.
//!
//! ```text
//! env, agent ─► job ─► manifest ─► plan ─► train ─► store ─► schedule ─► analyse ─► report
//!  what can     one     what an     what    a job,   one      who runs    pure       tables
//!  be simulated job's   author      should  with its SQLite   it and      numbers    and
//!  and learned  content declares    run     estimates file    when                   figures
//! ```
//!
//! A **manifest** is a TOML file that declares an experiment. It expands into **jobs**, each with one
//! environment, scenario, agent, seed, budget and evaluation. The **job key** is a hash of that content
//! and of the versions of the code. A **run** is one attempt at a job; a job has at most one completed
//! run. `docs/architecture.md` describes the modules, invariants and recipes.
//!
//! # Example
//!
//! ```
//! use std::sync::atomic::AtomicBool;
//!
//! use jitai::experiment::{self, Event, Options, Selection, Store};
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
//! let selection = Selection::new(&manifests, None)?;
//! let mut ignore = |_: Event<'_>| {};
//! let ended = experiment::run(&mut store, &selection, Options::default(), &stop, &mut ignore)?;
//! assert_eq!(ended.map(|ended| ended.end.completed()), Some(2));
//!
//! let jobs = experiment::jobs(&manifests[0]);
//! let data = Reader::open(&path)?.data_set(&manifests[0].name, jobs, Parts::default())?;
//! assert_eq!(summarise_arms(&data.jobs)[0].returns.n(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Modules
//!
//! - [`experiment`] declares and runs jobs.
//! - [`results`] reads results and makes reports.
//! - [`fits`] estimates the people of a model from data.
//! - [`findings`] holds the numbers that reports draw, and [`statistics`] the functions that compute
//!   them.
//! - [`environment`] and [`policy`] simulate without a store.
//! - [`algorithm`] trains, declares keys (with [`keys!`] and [`choices!`]) and registers algorithms.
//!
//! Three programs in `examples/` show how to write a sweep, an environment and an algorithm. All other
//! modules serve the program, its tests and its benchmarks; they are not part of the stable interface.

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
pub mod estimate;
#[doc(hidden)]
pub mod external;
#[doc(hidden)]
pub mod fit;
#[doc(hidden)]
pub mod job;
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
pub mod portable;
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
mod text;
#[doc(hidden)]
pub mod train;
#[doc(hidden)]
pub mod watch;

/// Experiments: read a manifest, expand it into jobs, and run them against a store.
pub mod experiment {
    pub use crate::job::{
        CanonicalForm, Job, JobError, JobKey, PlannedJob, RunnableJob, Scalar, UnknownFile,
        Versions,
    };
    pub use crate::job::{
        Condition, DataPart, Described, Evaluation, ParticipantRange, TestActions,
    };
    pub use crate::job::{
        CurvePoint, Metric, Outcome, ParticipantValue, Phase, Results, TestEpisode,
    };
    pub use crate::manifest::kind::{Contrast, Pairing, Recovery};
    pub use crate::manifest::{
        Analysis, AnalysisKind, CurveAxis, DeclaredAgent, DeclaredEstimate, Draw, Exclusion, Fault,
        Faults, Leaving, Manifest, Overridden, Override, Parameters, Position, Published,
        PublishedRow, Runs, Search, Section, Sides, Stage, Zip, hints, load, load_with, parse,
        parse_with, same_name, schema,
    };
    pub use crate::plan::{
        Cost, Entrant, Factors, Fate, Filter, FilterError, Lead, Race, RaceJobs, RaceOutcome,
        Races, Reference, Rung, Shard, ShardError, Swept, count, expand, jobs, race_jobs,
        race_line,
    };
    pub use crate::schedule::{
        Caller, Cause, CheckpointNote, End, EndedRun, Estimated, Event, EventLog, EventSink, Found,
        MOST_WORKERS, OnFailure, Options, Preview, Queued, QueuedFor, Remaining, Selection, Speeds,
        Survey, Surveyed, SweepError, Tally, command, race_notes, races_ended, removal,
        run_manifests as run,
    };
    pub use crate::store::{
        Command, Conflict, Counts, Damage, MergeProgress, Merged, Origin, OtherManifest,
        RetryFailed, Sources, Store, StoreError, merge, stores_of,
    };
    pub use crate::train::{CheckpointError, TrainingProgress};
}

/// Results: read them from a store, summarise arms, query in SQL, make a report.
pub mod results {
    pub use crate::analyse::declared::{
        AgentSummary, Arm, ArmId, ArmSummary, summarise_agents, summarise_arms,
    };
    pub use crate::job::metric::{METRICS, first_return, metrics_of};
    pub use crate::job::{
        ActionCount, Effect, Estimate, EstimateDeclaration, Estimates, Failure, FailureKind,
        Measure, Messages, MetricName, MetricPlace, MetricUnit, Provenance, RecordedPosterior,
        Scalar, Score, StandardErrors, Treatment,
    };
    pub use crate::record::{
        AmongParticipants, CompletedRun, DataSet, JobRecord, JobStatus, PersonDecision, Settings,
    };
    pub use crate::report::{
        AssembleError, AssemblyWork, Hosts, ReportFigure, ReportFile, ReportedExperiment,
        ReportedRace, assemble, figures, report, splits,
    };
    pub use crate::store::{
        Answer, ColumnType, ExperimentCounts, FailedJob, Interrupter, JobState, Pace, Parts,
        QueryError, Reader, SqlValue, StoredWeights, VIEWS,
    };
}

/// Environments: the contract and its tests, and the simulation from the paper.
pub mod environment {
    pub use crate::env::contract::{Clause, ContractViolation, check};
    pub use crate::env::outside;
    pub use crate::env::{
        Action, ActionSpec, ContextDraw, Environment, EpisodeStatus, Family, Feature, FeatureSpec,
        FirstContext, Interface, LaneSet, LaneStreams, Model, OPTIONS, ObservationSpec,
        Observations, ParticipantSampler, PhysicalActivity, Population, PopulationPhases, Scenario,
        ScenarioError, Simulated, Simulation, StateColumn, StepCount, StepCountModel,
        TimeIndicator, VectorEnvironment,
    };
    pub use crate::key::{Column, Distribution, NumberRange, Rows};
    pub use crate::rng::{Purpose, Stream};
    pub use crate::state::{Number, Resumable, StateError, StateReader, StateWriter};
}

/// Policies: actors, decision rules, and the episodes that they play.
pub mod policy {
    pub use crate::agent::{
        ActionNetwork, Actions, Actor, Architecture, BanditPolicy, Choice, DecisionRule,
        EffectPosterior, GruNames, NetworkActor, NetworkPolicy, Rewards, RuleParameters,
        RulePolicy, RuleState, StackNames,
    };
    pub use crate::job::NoWeights;
    pub use crate::optimum::NoOptimum;
    pub use crate::portable::{
        PortableError, PortablePolicy, bandit_of, describe_job, network_of, portable, posterior_in,
    };
    pub use crate::train::{RollStreams, Rollout, StepObserver, begin, play, roll};
}

/// Algorithms: train them in any environment, declare their keys, and register new ones.
pub mod algorithm {
    pub use crate::agent::{
        Activation, Agent, Algorithm, AlgorithmParameters, AtHorizon, BanditDraw, BanditFeatures,
        BanditPosterior, BanditUpdate, Diverged, DuelingDqn, Engine, Learner, LearnerError,
        LinearThompson, LinearThompsonLearner, Losses, Minibatch, OutOfMemory, Ppo, PpoEngine,
        PpoLearner, Recurrent, RegistrationError, Reinforce, ReinforceEngine, ReinforceLearner,
        Shape, SpanEnd, Start, StartError, Task, TerminalTarget, Trained, TrainedEpisode,
        Trajectories, Trunk, Unavailable, WeightTensor, Weights, WeightsError, Work,
        dueling_dqn_learner, linear_thompson_learner, ppo_learner, register_algorithm,
        reinforce_learner, trained_linear_thompson,
    };
    #[cfg(feature = "burn")]
    pub use crate::agent::{
        AutodiffPolicy, PolicyGradient, action_tensor, inference_device, observation_tensor,
        training_device,
    };
    pub use crate::kernel::Isa;
    pub use crate::key::{
        Assignment, CanonicalError, Constraint, Key, KeyType, Keyed, Kind, Parameter, SectionName,
        SettingError, Size, Value, Violation,
    };
}

/// Fits: the people of a model, estimated from the decisions of a pilot.
pub mod fits {
    pub use crate::env::declared::Pilot;
    pub use crate::fit::{DrawnFrom, FitRequest, Fitted, NoFit, NoPilot, Standing, read};
    pub use crate::report::{PlainPage, ReportFigure, ReportFile, plain_figures};
}

/// Findings: the results of declared analyses, as reports draw them.
pub mod findings {
    pub use crate::analyse::declared::{
        ActionPanel, BinShares, Comparison, ContrastFigure, ContrastRow, CurveFigure, CurveLine,
        Distance, ErrorFigure, ErrorPoint, Finding, FindingContent, HeatFigure, HeatTile,
        JobCounts, LearningFigure, LearningLine, LearningPanel, LinePoint, RecoveryRow,
        Reproduction, Scale,
    };
}

/// Statistics over seeds: pure functions of samples.
pub mod statistics {
    pub use crate::analyse::{
        Aggregate, Agreement, Contrast, Corrected, Detectable, DuplicateSeed, FEW_SEEDS, HedgesG,
        Improvement, Interval, LEVEL, Likeness, Lost, MOST_ARRANGEMENTS, Moments, POWER, RESAMPLES,
        Recovered, Sample, SeedPairing, TTest, UncertainNumber, Undefined, Verdict, agreement,
        correct, detectable, hedges_g, improvement, interquartile_mean, lower_quartile,
        mean_and_sd, mean_interval, moving_mean, paired_hedges_g, paired_improvement,
        paired_permutation_p, paired_t_test, permutation_p, quantile, recovered, share_interval,
        student_t_test, t_test, unpaired_t_test,
    };
}
