//! What has become of a job, over all its runs.

use rusqlite::types::{FromSql, FromSqlError, FromSqlResult, ValueRef};

/// What has become of a job, over all its runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobState {
    /// It was never tried.
    Pending,
    /// Its runs were interrupted, or their process died; it will run again.
    Interrupted,
    /// A run failed; it runs again only if asked for.
    Failed,
    /// A living process runs it.
    Running,
    /// It has its one completed run.
    Completed,
}

impl JobState {
    /// The word the command line uses.
    pub fn name(self) -> &'static str {
        match self {
            JobState::Pending => "pending",
            JobState::Interrupted => "interrupted",
            JobState::Failed => "failed",
            JobState::Running => "running",
            JobState::Completed => "completed",
        }
    }
}

/// How many jobs are in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Never tried.
    pub pending: u64,
    /// Tried, interrupted, to run again.
    pub interrupted: u64,
    /// Failed.
    pub failed: u64,
    /// Run by a living process.
    pub running: u64,
    /// Completed.
    pub completed: u64,
}

impl Counts {
    /// All jobs.
    pub fn total(&self) -> u64 {
        self.pending + self.interrupted + self.failed + self.running + self.completed
    }

    /// Counts so many jobs in a state in.
    pub fn add(&mut self, state: JobState, jobs: u64) {
        *match state {
            JobState::Pending => &mut self.pending,
            JobState::Interrupted => &mut self.interrupted,
            JobState::Failed => &mut self.failed,
            JobState::Running => &mut self.running,
            JobState::Completed => &mut self.completed,
        } += jobs;
    }
}

/// SQL for the state of the job with row id `{job}`, where `{alive}` is a JSON list of the living
/// sessions: the furthest that any run of it came, as [`JobState`] reads it. A failure outlasts a
/// later interruption, for the job would fail again.
pub(super) fn state_sql(job: &str, alive: &str) -> String {
    format!(
        "(SELECT max(CASE status
            WHEN 'completed' THEN 4
            WHEN 'running' THEN iif(session IN (SELECT value FROM json_each({alive})), 3, 1)
            WHEN 'failed' THEN 2
            WHEN 'interrupted' THEN 1 END) FROM run AS attempt WHERE attempt.job = {job})"
    )
}

impl FromSql for JobState {
    fn column_result(value: ValueRef<'_>) -> FromSqlResult<Self> {
        match value {
            ValueRef::Null => Ok(JobState::Pending),
            ValueRef::Integer(1) => Ok(JobState::Interrupted),
            ValueRef::Integer(2) => Ok(JobState::Failed),
            ValueRef::Integer(3) => Ok(JobState::Running),
            ValueRef::Integer(4) => Ok(JobState::Completed),
            _ => Err(FromSqlError::InvalidType),
        }
    }
}
