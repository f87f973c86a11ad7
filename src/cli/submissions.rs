//! Shows and collects submissions, for `status`, `submit` and `cancel`.

use std::collections::HashSet;
use std::io;

use crate::cli::counting::Counting;
use crate::cli::output::{Format, OutputField, OutputRows, counted};
use crate::cli::reader::say;
use crate::cli::{Error, StoreArgument};
use crate::cluster::{
    self, Chunk, ChunkState, ChunkSurvey, Cluster, ClusterLook, Loss, Stop, Submission,
};
use crate::job::JobKey;
use crate::key::printable;
use crate::store::{Conflict, Damage, JobState, Merged, Reader, Store};

/// Maximum number of different losses listed per submission.
const LOST_SHOWN: usize = 10;

/// Whether tasks of a submission may still hand in results.
pub(super) fn is_open(survey: &ChunkSurvey) -> bool {
    survey.stopped.is_none() && survey.counts().open() > 0
}

/// Requires that no submission brings back jobs of an experiment, from which jobs are to be removed. Returns all
/// submissions of the store.
///
/// **Errors**: tasks run jobs of the experiment, or the store lacks what they handed in. Then nothing may be removed.
pub(super) fn require_closed(
    store: &StoreArgument,
    reader: &Reader,
    experiment: &str,
) -> Result<Vec<Submission>, Error> {
    let look = Cluster::of(&store.store, cluster::connect)?.look()?;
    let refused = |submission: &Submission, why: &str| {
        Error::Usage(format!(
            "nothing was removed from {}: submission {} {why}",
            printable(&store.store.display().to_string()),
            submission.name()
        ))
    };
    let option = store.as_option();
    for (submission, survey) in &look.surveys {
        if !submission.intent.experiments.iter().any(|name| name == experiment) {
            continue;
        }
        let counts = survey.counts();
        // Tasks of a cancelled submission that begin later end at once.
        let is_open = is_open(survey) || counts.running > 0;
        if is_open && counts.waiting + counts.running == 0 {
            let folder = printable(&submission.path().display().to_string());
            let silence = look.silence.as_ref().map(|why| format!(" ({why})")).unwrap_or_default();
            return Err(refused(
                submission,
                &format!(
                    "may hold jobs of it, and its cluster does not answer{silence}; try again where \
                     it answers, or remove the folder {folder} if no task is left"
                ),
            ));
        }
        if is_open {
            return Err(refused(
                submission,
                &format!(
                    "has tasks with jobs of it; cancel them with `jitai cancel {}{option}`, or wait \
                     until they end",
                    submission.name()
                ),
            ));
        }
        if cluster::has_new_parts(submission, reader)? {
            return Err(refused(
                submission,
                &format!(
                    "has results of it that are not merged; merge them with `jitai status --merge{option}` first"
                ),
            ));
        }
    }
    Ok(look.surveys.into_iter().map(|(submission, _)| submission).collect())
}

/// The state of a submission in one word.
fn state(survey: &ChunkSurvey, left: usize) -> &'static str {
    let counts = survey.counts();
    match survey.stopped {
        Some(Stop::Cancelled) => "cancelled",
        Some(Stop::Abandoned) => "abandoned",
        None if counts.unknown > 0 => "unknown",
        None if counts.open() > 0 => "open",
        None if left > 0 => "lost",
        None => "finished",
    }
}

/// The unfinished jobs of a chunk: jobs that have ended neither in a part nor in the store.
fn left_of<'c>(chunk: &'c Chunk, ended: &HashSet<JobKey>) -> impl Iterator<Item = &'c JobKey> {
    chunk.left.iter().filter(|key| !ended.contains(key))
}

/// The jobs that have ended in the store.
pub(super) fn ended(reader: &Reader) -> Result<HashSet<JobKey>, Error> {
    let mut ended = HashSet::new();
    reader.tried(|key, state| match state {
        JobState::Completed | JobState::Failed => {
            ended.insert(key);
        }
        JobState::Pending | JobState::Interrupted | JobState::Running => {}
    })?;
    Ok(ended)
}

const COLUMNS: [&str; 12] = [
    "submission",
    "state",
    "chunks",
    "waiting",
    "running",
    "finished",
    "lost",
    "unknown",
    "jobs",
    "done",
    "left",
    "core_hours",
];

/// Prints the submissions of a store.
pub(super) fn show(
    look: &ClusterLook,
    ended: &HashSet<JobKey>,
    format: Format,
) -> Result<(), Error> {
    let integer = |count: usize| OutputField::Integer(count as i64);
    let mut rows = OutputRows::new(format, &COLUMNS.map(str::to_owned), io::stdout().lock())?;
    for (submission, survey) in &look.surveys {
        let counts = survey.counts();
        let jobs: usize = survey.chunks.iter().map(|chunk| chunk.jobs).sum();
        let left = survey.chunks.iter().flat_map(|chunk| left_of(chunk, ended)).count();
        rows.row(&[
            OutputField::text(submission.name()),
            OutputField::text(state(survey, left)),
            integer(survey.chunks.len()),
            integer(counts.waiting),
            integer(counts.running),
            integer(counts.finished),
            integer(counts.lost),
            integer(counts.unknown),
            integer(jobs),
            integer(jobs - left),
            integer(left),
            OutputField::Rounded(survey.core_hours, 2),
        ])?;
    }
    rows.finish()?;
    if let Some(silence) = &look.silence {
        say(&format!("the state on the cluster is unknown: {silence}"));
    }
    for (submission, survey) in &look.surveys {
        if survey.stopped.is_none() {
            list_lost(submission, survey, ended)?;
        }
    }
    Ok(())
}

/// Lists the lost chunks of a submission that have jobs left, with reasons and logs. Chunks that were lost
/// for the same reason share a line, with the log of the first.
pub(super) fn list_lost(
    submission: &Submission,
    survey: &ChunkSurvey,
    ended: &HashSet<JobKey>,
) -> Result<(), Error> {
    let mut lost: Vec<(&Loss, Vec<&Chunk>)> = Vec::new();
    for chunk in survey.chunks.iter().filter(|chunk| left_of(chunk, ended).next().is_some()) {
        match &chunk.state {
            ChunkState::Lost(loss) => match lost.iter_mut().find(|(other, _)| *other == loss) {
                Some((_, chunks)) => chunks.push(chunk),
                None => lost.push((loss, vec![chunk])),
            },
            ChunkState::Waiting
            | ChunkState::Running
            | ChunkState::Finished
            | ChunkState::Unknown => {}
        }
    }
    for (loss, chunks) in lost.iter().take(LOST_SHOWN) {
        let reason = match loss {
            Loss::NotBegun => "its task never started".to_owned(),
            Loss::Stopped => "its task was stopped and not requeued".to_owned(),
            Loss::Failed(reason) => format!("its task failed: {reason}"),
            Loss::Died => "its task died".to_owned(),
        };
        let (name, number) = (submission.name(), chunks[0].number);
        let others = match chunks.len() {
            1 => String::new(),
            all => format!(" and {}", counted(all - 1, "more chunk")),
        };
        let left: usize = chunks.iter().map(|chunk| left_of(chunk, ended).count()).sum();
        say(&format!(
            "lost: chunk {number}{others} of {name}, {} left: {}; log: {}",
            counted(left, "job"),
            printable(&reason),
            printable(&submission.log(number).display().to_string())
        ));
    }
    let more: usize = lost.iter().skip(LOST_SHOWN).map(|(_, chunks)| chunks.len()).sum();
    if more > 0 {
        say(&format!("and {} lost", counted(more, "more chunk")));
    }
    Ok(())
}

/// Merges the new parts of the submissions, and reports conflicts and damage.
pub(super) fn collect(look: &ClusterLook, store: &mut Store) -> Result<Merged, Error> {
    let mut counting = Counting::new(0, "runs");
    let submissions = look.surveys.iter().map(|(submission, _)| submission);
    let merged = cluster::collect(submissions, store, |progress| {
        counting.advance(progress.done, progress.of);
    });
    drop(counting);
    let merged = merged?;
    for Conflict { source, job_key, .. } in &merged.conflicts {
        let part = printable(&source.display().to_string());
        say(&format!(
            "conflict: job {job_key} has different results in {part}; the store keeps its own \
             (`jitai merge {part}` shows both)"
        ));
    }
    for Damage { source, what, .. } in &merged.damaged {
        let part = printable(&source.display().to_string());
        say(&format!("{part} is damaged; not merged: {}", printable(what)));
    }
    Ok(merged)
}
