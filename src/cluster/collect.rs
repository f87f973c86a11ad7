//! Collecting: merges handed-in parts into the store.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::PathBuf;

use super::error::ClusterError;
use super::folder::{Part, Submission, write_whole};
use crate::job::JobKey;
use crate::store::{self, JobState, MergeProgress, Merged, Reader, Sources, Store};

/// The list of the parts of a submission that were merged into its store.
const LIST: &str = "collected";

/// The list of the jobs whose results were merged and then removed from the store on request.
const FORGOTTEN: &str = "forgotten";

/// Merges new parts of submissions into their store.
///
/// A part counts as merged if the submission's list names it and every job of the part has ended in the
/// store or was [forgotten](forget()). A new store therefore gets all other parts again.
///
/// **Errors**: a part or the store cannot be used, or a list cannot be written.
pub fn collect<'s>(
    submissions: impl IntoIterator<Item = &'s Submission>,
    store: &mut Store,
    hear: impl FnMut(MergeProgress),
) -> Result<Merged, ClusterError> {
    let states = states(&store.reader()?)?;
    let mut new: Vec<(&Submission, HashSet<String>, Vec<Part>)> = Vec::new();
    for submission in submissions {
        let listed = listed(submission, LIST);
        let parts = new_parts(submission, &listed, &states)?;
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
        write_list(submission, LIST, listed)?;
    }
    Ok(merged)
}

/// Whether the store lacks a part that a submission has handed in.
///
/// **Errors**: the submission or the store cannot be read.
pub fn has_new_parts(submission: &Submission, reader: &Reader) -> Result<bool, ClusterError> {
    let listed = listed(submission, LIST);
    Ok(!new_parts(submission, &listed, &states(reader)?)?.is_empty())
}

/// Records that the results of jobs are being removed from the store, so that merged parts do not bring them back.
///
/// **Errors**: a submission cannot be read, or a list cannot be written.
pub fn forget<'s>(
    submissions: impl IntoIterator<Item = &'s Submission>,
    removed: &HashSet<JobKey>,
) -> Result<(), ClusterError> {
    for submission in submissions {
        let parts = submission.parts()?;
        let jobs = parts.iter().filter_map(Part::jobs).flatten().map(|(key, _)| key);
        let mut keys: HashSet<String> =
            jobs.filter(|key| removed.contains(key)).map(|key| key.to_string()).collect();
        if !keys.is_empty() {
            keys.extend(listed(submission, FORGOTTEN));
            write_list(submission, FORGOTTEN, keys)?;
        }
    }
    Ok(())
}

fn states(reader: &Reader) -> Result<HashMap<JobKey, JobState>, ClusterError> {
    let mut states = HashMap::new();
    reader.tried(|key, state| {
        states.insert(key, state);
    })?;
    Ok(states)
}

fn new_parts(
    submission: &Submission,
    merged: &HashSet<String>,
    states: &HashMap<JobKey, JobState>,
) -> Result<Vec<Part>, ClusterError> {
    let forgotten = listed(submission, FORGOTTEN);
    let is_new =
        |part: &Part| !(merged.contains(&name(part)) && is_known(part, states, &forgotten));
    Ok(submission.parts()?.into_iter().filter(is_new).collect())
}

fn listed(submission: &Submission, list: &str) -> HashSet<String> {
    let text = fs::read_to_string(submission.path().join(list)).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

fn write_list(
    submission: &Submission,
    list: &str,
    lines: HashSet<String>,
) -> Result<(), ClusterError> {
    let mut lines: Vec<String> = lines.into_iter().collect();
    lines.sort();
    let file = submission.path().join(list);
    write_whole(&file, lines.join("\n").as_bytes()).map_err(ClusterError::io("write", &file))
}

fn name(part: &Part) -> String {
    part.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Whether every job of the part has ended in the store or was forgotten.
fn is_known(part: &Part, states: &HashMap<JobKey, JobState>, forgotten: &HashSet<String>) -> bool {
    part.jobs().is_some_and(|jobs| {
        jobs.iter().all(|(key, _)| {
            matches!(states.get(key), Some(JobState::Completed | JobState::Failed))
                || forgotten.contains(&key.to_string())
        })
    })
}
