//! Rows during a copy between stores, with the ids of the source.

use std::sync::Arc;

use rusqlite::types::Value;

use crate::store::estimate;

use super::results::ResultRows;

/// How a run of the source ended. Runs in progress are not copied: their jobs run again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::store) enum Ended {
    /// With results.
    Completed,
    /// With a failure.
    Failed,
    /// Stopped from outside, without results.
    Interrupted,
}

impl Ended {
    /// The run's status in the tables.
    pub(super) fn status(self) -> &'static str {
        match self {
            Ended::Completed => "completed",
            Ended::Failed => "failed",
            Ended::Interrupted => "interrupted",
        }
    }

    /// How a run with this status ended; `None` for a run in progress.
    pub(super) fn of(status: &Value) -> Option<Ended> {
        let Value::Text(status) = status else { return None };
        [Ended::Completed, Ended::Failed, Ended::Interrupted]
            .into_iter()
            .find(|ended| ended.status() == status)
    }
}

/// A row that the text in its first column identifies in every store.
pub(in crate::store) struct NamedRow<const COLUMNS: usize> {
    pub(super) id: i64,
    pub(super) columns: [Value; COLUMNS],
}

/// `name`, `question`, `hypothesis`, `manifest`, `created_at`, `updated_at`, `estimates`.
pub(in crate::store) type ExperimentRow = NamedRow<7>;

/// The intact earlier manifests of an experiment of the source.
pub(in crate::store) struct EarlierManifests {
    pub(super) experiment: i64,
    pub(super) texts: Vec<[Value; 4]>,
}

/// `key`, `environment_version`, `algorithm_version`, `canonical`.
pub(in crate::store) type JobRow = NamedRow<4>;

/// Which experiment holds which job: `experiment`, `job`, `agent`, `position`.
pub(in crate::store) type MembershipRow = [Value; 4];

/// A conflict that an earlier merge found: its job, and the columns of [`crate::store::conflict::COLUMNS`].
pub(in crate::store) type ConflictRow = [Value; 8];

/// A session of the source.
pub(in crate::store) struct SessionRow {
    /// The columns of [`SESSION`].
    pub(super) identity: [Value; SESSION.len()],
    pub(super) heartbeat_at: Value,
    pub(super) ended_at: Value,
}

/// The columns that identify a session across stores, including the code and machine that made its runs.
pub(super) const SESSION: [&str; 10] = [
    "host",
    "boot_id",
    "pid_namespace",
    "process_id",
    "process_started",
    "code_version",
    "git_revision",
    "backend",
    "processor",
    "started_at",
];

/// A run of the source that has ended, with its results.
pub(in crate::store) struct CopiedRun {
    /// How the run ended.
    pub(in crate::store) ended: Ended,
    /// The key of the run's job; `None` if the job cannot be read or has changed since it was stored.
    pub(in crate::store) job_key: Option<String>,
    pub(super) job: i64,
    pub(super) attempt: Value,
    pub(super) session: i64,
    /// `None` if the session cannot be read.
    pub(super) session_row: Option<Arc<SessionRow>>,
    pub(super) started_at: Value,
    /// `ended_at`, `wall_seconds`, `failure_kind`, `failure_message`, `failure_episode`, `suspects`.
    pub(super) end: [Value; 6],
    pub(super) digest: Value,
    /// The files of outside programs.
    pub(super) programs: Value,
    pub(super) content: RunContent,
    /// The intact estimates of a completed run.
    pub(super) estimates: Vec<estimate::Row>,
}

/// The verified results of a run.
pub(super) enum RunContent {
    /// The results of a completed run.
    Results(ResultRows),
    /// No results: the run failed or was interrupted.
    Nothing,
    /// Results that were not read, because the target has this run.
    KnownToTarget,
    /// Results that do not verify; with the reason.
    Damaged(String),
}

/// The content of one transaction.
pub(in crate::store) enum CopyBatch {
    Experiments(Vec<ExperimentRow>, Vec<EarlierManifests>),
    Jobs(Vec<JobRow>),
    Memberships(Vec<MembershipRow>),
    Runs(Vec<CopiedRun>),
    Conflicts(Vec<ConflictRow>),
    /// The sessions of the source with their ends, after the last run.
    Sessions(Vec<Arc<SessionRow>>),
}
