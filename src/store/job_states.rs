//! The states of many jobs, asked for in batches.

use std::collections::HashMap;

use crate::job::{CanonicalForm, JobKey, Versions};

use super::state::JobState;
use super::{Reader, StoreError};

/// The number of jobs that are looked up one by one. If there are more, all runs of the store are read.
const ASKED_SINGLY: usize = 10_000;

/// The states of jobs in a store, as they are read.
#[derive(Debug)]
pub struct JobStates<'r> {
    reader: &'r Reader,
    asked: usize,
    /// All jobs that have a run, once many jobs have been asked for.
    tried: Option<HashMap<JobKey, JobState>>,
}

impl<'r> JobStates<'r> {
    /// The number of jobs to ask for at once.
    pub const TOGETHER: usize = 1000;

    /// The states of the jobs of this store.
    pub fn of(reader: &'r Reader) -> JobStates<'r> {
        JobStates { reader, asked: 0, tried: None }
    }

    /// The state of each job, in the order of `keys`; a job unknown to the store is pending.
    pub fn ask(&mut self, keys: &[JobKey]) -> Result<Vec<JobState>, StoreError> {
        self.asked += keys.len();
        if self.asked > ASKED_SINGLY && self.tried.is_none() {
            let mut tried = HashMap::new();
            self.reader.tried(|key, state| {
                tried.insert(key, state);
            })?;
            self.tried = Some(tried);
        }
        let Some(tried) = &self.tried else { return self.reader.job_states(keys) };
        let state = |key| tried.get(key).copied().unwrap_or(JobState::Pending);
        Ok(keys.iter().map(state).collect())
    }

    /// The state of one job.
    pub fn state(&self, key: &JobKey) -> Result<JobState, StoreError> {
        let state = match &self.tried {
            Some(tried) => tried.get(key).copied(),
            None => self.reader.job_states([key])?.pop(),
        };
        Ok(state.unwrap_or(JobState::Pending))
    }

    /// The connection to the store.
    pub fn reader(&self) -> &'r Reader {
        self.reader
    }

    /// The latest of the earlier versions of the code under which the job's content was completed.
    pub fn superseded(&self, form: &CanonicalForm) -> Result<Option<Versions>, StoreError> {
        let Some(tried) = &self.tried else {
            return Ok(self.reader.superseded(form, form.versions())?.pop());
        };
        let is_completed = |versions: &Versions| {
            tried.get(&form.key_under(*versions)) == Some(&JobState::Completed)
        };
        Ok(form.versions().earlier().filter(is_completed).last())
    }
}
