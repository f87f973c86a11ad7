//! Collecting: merges handed-in parts into the store.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::PathBuf;

use super::error::ClusterError;
use super::folder::{Part, Submission, write_whole};
use crate::job::JobKey;
use crate::store::{self, JobState, MergeProgress, Merged, Sources, Store};

/// The list of the parts of a submission that were merged into its store.
const LIST: &str = "collected";

/// Merges new parts of submissions into their store.
///
/// A part counts as merged if the submission's list names it and every job of the part has ended in the
/// store. A new store therefore gets all parts again.
///
/// **Errors**: a part or the store cannot be used, or a list cannot be written.
pub fn collect<'s>(
    submissions: impl IntoIterator<Item = &'s Submission>,
    store: &mut Store,
    hear: impl FnMut(MergeProgress),
) -> Result<Merged, ClusterError> {
    let mut states = HashMap::new();
    store.reader()?.tried(|key, state| {
        states.insert(key, state);
    })?;
    let mut new: Vec<(&Submission, HashSet<String>, Vec<Part>)> = Vec::new();
    for submission in submissions {
        let listed = listed(submission);
        let is_new = |part: &Part| !(listed.contains(&name(part)) && is_known(part, &states));
        let parts: Vec<Part> = submission.parts()?.into_iter().filter(is_new).collect();
        if !parts.is_empty() {
            new.push((submission, listed, parts));
        }
    }
    let sources: Vec<PathBuf> =
        new.iter().flat_map(|(_, _, parts)| parts).map(|part| part.path.clone()).collect();
    if sources.is_empty() {
        return Ok(Merged::default());
    }
    let merged = store::merge(&Sources::open(sources)?, store, hear)?;
    for (submission, mut listed, parts) in new {
        listed.extend(parts.iter().map(name));
        let mut lines: Vec<String> = listed.into_iter().collect();
        lines.sort();
        let file = submission.path().join(LIST);
        write_whole(&file, lines.join("\n").as_bytes())
            .map_err(ClusterError::io("write", &file))?;
    }
    Ok(merged)
}

fn listed(submission: &Submission) -> HashSet<String> {
    let text = fs::read_to_string(submission.path().join(LIST)).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

fn name(part: &Part) -> String {
    part.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Whether every job of the part has ended in the store.
fn is_known(part: &Part, states: &HashMap<JobKey, JobState>) -> bool {
    part.jobs().is_some_and(|jobs| {
        jobs.iter()
            .all(|(key, _)| matches!(states.get(key), Some(JobState::Completed | JobState::Failed)))
    })
}
