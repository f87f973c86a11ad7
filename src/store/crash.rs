//! Crashes: processes that died, perhaps because of a job that they were running.
//!
//! Such a job would end every later process, too. Therefore the jobs of a process that died become suspects.
//! A suspect runs after all other jobs and in isolation, so that the next death has only one suspect. After
//! three deaths in a row, the last of them in isolation, the job has failed. A checkpoint ends the row: a job
//! that gets further is no suspect. Deaths differ:
//!
//! - A process that aborts (a failed allocation, a stack overflow, a panic within a panic) marks its file. All
//!   of its jobs are suspects.
//! - A process that was killed while the kernel killed processes for lack of memory counts like an abort.
//! - Another process that was killed may have been killed by a person or a batch system. A job is a suspect
//!   only if it ran for a second without reaching a checkpoint, and was the only job of its process or was
//!   killed in its previous attempt, too.
//! - A process that was asked to stop, or ended with its machine, counts against no job.

use std::fs;
use std::path::{Path, PathBuf};

use rusqlite::Connection;

use crate::job::{Failure, FailureKind};

use super::liveness::ProcessTable;
use super::place::beside;

/// The number of crashes after which a job has failed, if the last crash happened in isolation.
const MOST_CRASHES: u32 = 3;

/// Separates the store's name from the session's number in the name of a mark.
const MARK: &str = "-session-";

/// What a process that is asked to stop writes into its file.
pub const STOPPED: &[u8] = b"S";

/// The ending of the folder of checkpoints beside a store.
pub const CHECKPOINTS: &str = ".checkpoints";

/// How a process died.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Death {
    /// It aborted, or was killed when memory was short.
    Crashed,
    /// It was killed for an unknown reason.
    Killed,
    /// No job is to blame, or nothing is known.
    Blameless,
}

impl Death {
    /// The death of a process with this file. `kills` is the number of processes that the kernel has killed
    /// for lack of memory since it was started; the file begins with this number at the start of the process.
    fn of(mark: &[u8], kills: Option<u64>) -> Death {
        let digits = mark.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let (before, then) = mark.split_at(digits);
        let before = std::str::from_utf8(before).ok().and_then(|text| text.parse::<u64>().ok());
        match (then.trim_ascii(), before.zip(kills)) {
            ([], Some((before, now))) if now > before => Death::Crashed,
            ([], _) => Death::Killed,
            (STOPPED, _) => Death::Blameless,
            _ => Death::Crashed,
        }
    }
}

/// The content of a new file of a session.
pub(super) fn new_mark() -> String {
    memory_kills().map_or_else(String::new, |kills| format!("{kills}\n"))
}

/// The number of processes that the kernel has killed for lack of memory; `None` if it does not count them.
fn memory_kills() -> Option<u64> {
    let counters = fs::read_to_string("/proc/vmstat").ok()?;
    counters.lines().find_map(|line| line.strip_prefix("oom_kill "))?.trim().parse().ok()
}

/// The name of a checkpoint in the folder of checkpoints.
pub fn checkpoint_name(key: &str, attempt: u32, form: &str) -> String {
    format!("{key}.{attempt}.{form}")
}

/// Whether an attempt at a job has written a checkpoint that is still there.
pub(super) fn has_checkpoint(store: &Path, key: &str, attempt: u32) -> bool {
    beside(store, CHECKPOINTS).join(checkpoint_name(key, attempt, "checkpoint")).exists()
}

/// The file that a session marks when it crashes.
pub(super) fn mark(store: &Path, session: i64) -> PathBuf {
    beside(store, &format!("{MARK}{session}"))
}

/// The sessions that have a mark file.
pub(super) fn marked(store: &Path) -> Vec<i64> {
    let (Some(folder), Some(name)) = (store.parent(), mark_name(store)) else { return Vec::new() };
    // If the folder cannot be listed, its marks stay as they are.
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let number =
        |entry: fs::DirEntry| entry.file_name().to_str()?.strip_prefix(&name)?.parse().ok();
    entries.filter_map(number).collect()
}

/// The prefix of the names of a store's marks; `None` if the store's name is not valid text.
fn mark_name(store: &Path) -> Option<String> {
    Some(format!("{}{MARK}", store.file_name()?.to_str()?))
}

/// Removes the mark of a session, if there is one.
pub(super) fn unmark(store: &Path, session: i64) {
    // If the removal fails, the next process that looks for marks tries again.
    let _ = fs::remove_file(mark(store, session));
}

/// Removes the mark of a session of the store that a connection has open.
pub(super) fn unmark_of(connection: &Connection, session: i64) {
    if let Some(store) = connection.path() {
        unmark(Path::new(store), session);
    }
}

/// How a dead session died, from its file, which is removed. If the caller's transaction is not committed,
/// this death is not counted.
pub(super) fn take(connection: &Connection, session: i64) -> rusqlite::Result<Death> {
    let Some(store) = connection.path() else { return Ok(Death::Blameless) };
    let store = Path::new(store);
    let mark = fs::read(mark(store, session));
    unmark(store, session);
    let Ok(mark) = mark else { return Ok(Death::Blameless) };
    match (Death::of(&mark, None), Death::of(&mark, memory_kills())) {
        // The kernel counts from the boot, and a machine that goes down kills everything.
        (Death::Killed, _) if !is_of_this_boot(connection, session)? => Ok(Death::Blameless),
        (_, death) => Ok(death),
    }
}

/// Whether a session was begun since this machine booted.
fn is_of_this_boot(connection: &Connection, session: i64) -> rusqlite::Result<bool> {
    let boot: Option<String> = connection
        .prepare_cached("SELECT boot_id FROM session WHERE id = ?1")?
        .query_row([session], |row| row.get(0))?;
    Ok(boot == ProcessTable::of_this_system().this_process().boot_id)
}

/// The running runs of a session that was killed whose jobs are suspects; `running` is the number of all.
pub(super) fn suspects(
    connection: &Connection,
    session: i64,
    running: i64,
) -> rusqlite::Result<Vec<i64>> {
    let Some(store) = connection.path() else { return Ok(Vec::new()) };
    let store = Path::new(store);
    // The heartbeat a second after the start of a job shows that the job got so far.
    let mut statement = connection.prepare_cached(&format!(
        "SELECT run.id, job.key, run.attempt FROM run
            JOIN job ON job.id = run.job JOIN session ON session.id = run.session
         WHERE run.session = ?1 AND run.status = 'running'
            AND 86400 * (julianday(heartbeat_at) - julianday(run.started_at)) >= 0.99
            AND (?2 = 1 OR EXISTS (SELECT 1 FROM run AS before
                WHERE before.job = run.job AND before.attempt = run.attempt - 1 AND {WAS_KILLED}))"
    ))?;
    let runs = statement.query_map([session, running], |row| {
        Ok((row.get(0)?, row.get::<_, String>(1)?, row.get(2)?))
    })?;
    let stuck = runs.filter(|run| match run {
        Ok((_, key, attempt)) => !has_checkpoint(store, key, *attempt),
        Err(_) => true,
    });
    stuck.map(|run| run.map(|(id, ..)| id)).collect()
}

/// SQL: whether the process of the run `before` was killed, so that its wall time is NULL.
const WAS_KILLED: &str = "before.status = 'interrupted' AND before.wall_seconds IS NULL";

/// The jobs whose last attempts died, if there were two or one was a suspect, each with the number of these
/// deaths: they run after all others, by this number. Attempts before the last checkpoint, or before the last
/// two, do not count.
pub(super) fn died(connection: &Connection) -> rusqlite::Result<Vec<([u8; 16], u32)>> {
    let Some(store) = connection.path() else { return Ok(Vec::new()) };
    let mut statement = connection.prepare_cached(&format!(
        "SELECT job.key, unhex(job.key), attempt, suspects IS NOT NULL
         FROM run AS before JOIN job ON job.id = before.job
         WHERE {WAS_KILLED} AND before.attempt >= (SELECT max(attempt) FROM run
            WHERE run.job = before.job) - 1
         ORDER BY job.id, attempt DESC"
    ))?;
    let attempts = statement.query_map([], |row| {
        Ok((row.get::<_, String>(0)?, row.get(1)?, row.get::<_, u32>(2)?, row.get::<_, bool>(3)?))
    })?;
    let attempts: Vec<_> = attempts.collect::<rusqlite::Result<_>>()?;
    let jobs = attempts.chunk_by(|(one, ..), (next, ..)| one == next);
    let deaths = jobs.filter_map(|attempts| {
        let kept = |(key, _, attempt, _): &&(String, _, u32, bool)| {
            has_checkpoint(Path::new(store), key, *attempt)
        };
        let died: Vec<_> = attempts.iter().take_while(|attempt| !kept(attempt)).collect();
        let is_suspect = died.iter().any(|(.., is_suspect)| *is_suspect);
        (is_suspect || died.len() == 2).then(|| (attempts[0].1, died.len() as u32))
    });
    Ok(deaths.collect())
}

/// The number of a job's last attempts in a row whose processes were killed, back to the latest that wrote a
/// checkpoint.
pub(super) fn deaths(connection: &Connection, job: i64) -> rusqlite::Result<u32> {
    let mut statement = connection.prepare_cached(&format!(
        "SELECT key, attempt, {WAS_KILLED} FROM run AS before JOIN job ON job.id = before.job
         WHERE before.job = ?1 ORDER BY attempt DESC"
    ))?;
    let mut attempts = statement.query([job])?;
    let mut deaths = 0;
    while let Some(row) = attempts.next()? {
        let (key, attempt, was_killed): (String, u32, bool) =
            (row.get(0)?, row.get(1)?, row.get(2)?);
        if !was_killed {
            break;
        }
        deaths += 1;
        if connection.path().is_some_and(|store| has_checkpoint(Path::new(store), &key, attempt)) {
            break;
        }
    }
    Ok(deaths)
}

/// The crash record of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Record {
    /// No process died because of the job.
    Clean,
    /// A process died, possibly because of this job.
    Suspect,
    /// Processes died too often, the last one while it ran the job in isolation.
    Guilty(Failure),
}

/// The crash record of a job since its last failure and its last checkpoint.
pub(super) fn record(connection: &Connection, job: i64) -> rusqlite::Result<Record> {
    let mut statement = connection.prepare_cached(
        "SELECT key, attempt, suspects FROM run JOIN job ON job.id = run.job
         WHERE run.job = ?1 AND attempt > (SELECT coalesce(max(attempt), 0) FROM run
            WHERE job = ?1 AND status = 'failed')
         ORDER BY attempt DESC",
    )?;
    let mut attempts = statement.query([job])?;
    // From the last attempt back.
    let (mut crashes, mut last) = (0, None);
    while let Some(row) = attempts.next()? {
        let (key, attempt): (String, u32) = (row.get(0)?, row.get(1)?);
        if connection.path().is_some_and(|store| has_checkpoint(Path::new(store), &key, attempt)) {
            break;
        }
        if let Some(suspects) = row.get::<_, Option<u32>>(2)? {
            last = last.or(Some(suspects));
            crashes += 1;
        }
    }
    Ok(match (crashes, last) {
        (0, _) => Record::Clean,
        (MOST_CRASHES.., Some(1)) => Record::Guilty(Failure {
            kind: FailureKind::Crashed,
            message: format!(
                "the process crashed or was killed in {crashes} attempts at this job, in the last one \
                 without other jobs; the cause may be too little memory: see the output of that `jitai \
                 run` and the kernel's log; `--retry-failed` runs the job again"
            ),
            episode: 0,
        }),
        _ => Record::Suspect,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_of_an_abort_a_kill_for_memory_another_kill_or_a_stop() {
        let read_death = |mark: &str, kills| Death::of(mark.as_bytes(), kills);
        // Files of earlier releases are empty or hold one byte.
        for (mark, kills, expected) in [
            ("", Some(7), Death::Killed),
            ("X", Some(7), Death::Crashed),
            ("7\n", Some(7), Death::Killed),
            ("7\n", Some(8), Death::Crashed),
            ("7\n", Some(0), Death::Killed),
            ("7\n", None, Death::Killed),
            ("7\nX", None, Death::Crashed),
            ("7\nS", Some(8), Death::Blameless),
            ("S", None, Death::Blameless),
            ("7\nSX", None, Death::Crashed),
        ] {
            assert_eq!(read_death(mark, kills), expected, "{mark:?} {kills:?}");
        }
    }
}
