//! What has become of a job, over all its runs.

use std::cmp::Reverse;

use rusqlite::Connection;
use rusqlite::types::{FromSql, FromSqlError, FromSqlResult, ValueRef};

/// What has become of a job, over all its runs; ordered by how far they came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

/// The states of all jobs that have runs, ordered by row id. For counting: reading every run once is
/// many times faster than asking for every job by [`state_sql`], and jobs asked for in order are
/// found near each other, as they would not be in a table of hashes.
pub(super) struct States(Vec<(i64, JobState)>);

impl States {
    /// The states as they are now, where `alive` are the living sessions.
    pub(super) fn read(connection: &Connection, alive: &[i64]) -> rusqlite::Result<States> {
        let mut statement = connection.prepare_cached(
            "SELECT job, session, CASE status
                WHEN 'completed' THEN 4 WHEN 'running' THEN 3 WHEN 'failed' THEN 2 ELSE 1 END
             FROM run",
        )?;
        let mut rows = statement.query([])?;
        let mut states = Vec::new();
        while let Some(row) = rows.next()? {
            let mut state: JobState = row.get(2)?;
            if state == JobState::Running && !alive.contains(&row.get(1)?) {
                state = JobState::Interrupted;
            }
            states.push((row.get(0)?, state));
        }
        // Of a job's runs the furthest is the first, and stays.
        states.sort_by_key(|&(job, state)| (job, Reverse(state)));
        states.dedup_by_key(|&mut (job, _)| job);
        Ok(States(states))
    }

    /// The state of a job.
    pub(super) fn of(&self, job: i64) -> JobState {
        match self.0.binary_search_by_key(&job, |&(job, _)| job) {
            Ok(at) => self.0[at].1,
            Err(_) => JobState::Pending,
        }
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
