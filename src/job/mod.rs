//! Jobs: what a training and its test consist of, how jobs are identified, and how their runs end.
//!
//! In: environments, agents and the values of their keys. Out: a [`Job`] with its [`JobKey`], [`Condition`]s
//! on jobs, and the [`Outcome`] of a run as plain data. The module reads no manifests, and knows neither the
//! clock, the disk nor what has run.

mod condition;
mod content;
mod estimate;
mod evaluation;
mod identity;
mod implied;
pub mod metric;
mod named;
mod outcome;
mod participant_range;
mod runnable;
mod scalar;
mod state_names;
mod trial;

pub use condition::{Condition, Described, short_beside, short_name};
pub use content::{Job, JobError, NoWeights};
pub use estimate::{
    AGENT, CONSTANT, Effect, Estimate, EstimateDeclaration, Estimates, Estimator, GROSS_REWARD,
    Messages, REWARD, STEP, StandardErrors, TargetPolicy, Treatment, VALUE_TERMS,
};
pub use evaluation::{
    EvaluatedOn, Evaluation, RecordedDecisions, RecordedEpisodes, RecordedQuartiles, TestActions,
};
pub use identity::{
    CanonicalForm, JobKey, Versions, agent_text, environment_text, people_text, seed_of, text,
    without_seed,
};
pub use implied::{ImpliedParameter, implied_parameters};
pub use metric::{Measure, MetricName, MetricPlace, MetricUnit};
pub use named::{PlannedJob, counted, shown, value_of};
pub use outcome::{
    ActionCount, CurvePoint, DataPart, Decision, Failure, FailureKind, HeldDeviation, Metric,
    Outcome, ParticipantValue, Phase, Provenance, RecordedPosterior, Results, Score, TestEpisode,
};
pub use participant_range::ParticipantRange;
pub use runnable::{RunnableJob, UnknownFile};
pub use scalar::Scalar;
pub use state_names::StateNames;
pub use trial::{Calendar, Pooling, ROWS, STAYS, Stay, Trial, UpdateData};

/// The items without repetitions, in order of first appearance.
pub fn distinct<T: PartialEq>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut kept = Vec::new();
    for item in items {
        if !kept.contains(&item) {
            kept.push(item);
        }
    }
    kept
}
