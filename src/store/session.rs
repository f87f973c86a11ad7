//! Sessions: one per process that runs jobs, with a heartbeat. The runs of a dead session are interrupted.

use std::collections::HashMap;
use std::fs::File;
use std::io::Write;
use std::time::Duration;

use rusqlite::{Connection, OptionalExtension, Row, named_params};

use crate::job::JobKey;
use crate::job::Provenance;

use super::crash::{self, Death};
use super::error::StoreError;
use super::liveness::{Liveness, Process, ProcessTable};
use super::transaction::NOW;
use super::writer::Store;

/// A session of the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SessionId(pub(super) i64);

const RELEASE: &str = "release the runs of dead sessions";

impl Store {
    /// Begins a session of this process.
    ///
    /// The session lasts until [`Store::end_session`] or the end of the process. The caller must call
    /// [`Store::heartbeat`] every few seconds. Processes that cannot look up this one consider the session
    /// dead after 30 s without a heartbeat, or after 5 min if they are on another machine.
    pub fn begin_session(&mut self, provenance: &Provenance) -> Result<SessionId, StoreError> {
        self.begin_filtered_session(provenance, None)
    }

    /// Like [`Store::begin_session`], for a process that runs only the jobs of a filter.
    pub fn begin_filtered_session(
        &mut self,
        provenance: &Provenance,
        filter: Option<&str>,
    ) -> Result<SessionId, StoreError> {
        let process = ProcessTable::of_this_system().this_process();
        self.write("begin a session", |transaction| {
            transaction
                .prepare(&format!(
                    "INSERT INTO session (host, boot_id, pid_namespace, process_id, process_started,
                        code_version, git_revision, backend, processor, filter, started_at, heartbeat_at)
                     VALUES (:host, :boot_id, :pid_namespace, :process_id, :process_started,
                        :code_version, :git_revision, :backend, :processor, :filter, {NOW}, {NOW})"
                ))?
                .insert(named_params! {
                    ":host": provenance.host,
                    ":boot_id": process.boot_id,
                    ":pid_namespace": process.pid_namespace,
                    ":process_id": process.id,
                    ":process_started": process.started,
                    ":code_version": provenance.code_version,
                    ":git_revision": provenance.git_revision,
                    ":backend": provenance.backend,
                    ":processor": provenance.processor,
                    ":filter": filter,
                })
                .map(SessionId)
                .map_err(Into::into)
        })
    }

    /// Records that the session is alive.
    pub fn heartbeat(&mut self, session: SessionId) -> Result<(), StoreError> {
        self.write("record a heartbeat", |transaction| {
            transaction
                .prepare_cached(&format!("UPDATE session SET heartbeat_at = {NOW} WHERE id = ?1"))?
                .execute([session.0])?;
            Ok(())
        })
    }

    /// Ends the session and interrupts the runs that it still holds.
    pub fn end_session(&mut self, session: SessionId) -> Result<(), StoreError> {
        self.write("end the session", |transaction| {
            release(transaction, session.0)?;
            transaction.execute(
                &format!("UPDATE session SET heartbeat_at = {NOW}, ended_at = {NOW} WHERE id = ?1"),
                [session.0],
            )?;
            // The mark applies only to sessions that crash before their end.
            crash::unmark_of(transaction, session.0);
            Ok(())
        })
    }

    /// Creates the file into which a signal handler writes one byte if the process crashes, and
    /// [`STOPPED`](crash::STOPPED) if it is asked to stop. A dead session whose file has neither was killed.
    ///
    /// **Errors**: the file cannot be created.
    pub fn crash_mark(&self, session: SessionId) -> Result<File, StoreError> {
        let path = crash::mark(&self.path, session.0);
        let created = File::create(&path).and_then(|mut mark| {
            mark.write_all(crash::new_mark().as_bytes())?;
            Ok(mark)
        });
        created.map_err(|error| StoreError::CannotOpen { path, reason: error.to_string() })
    }

    /// The jobs whose processes died several times in a row, or that may have caused a death, with the number
    /// of deaths in the last two attempts. They should run after all others, by this number.
    pub fn died(&self) -> Result<HashMap<JobKey, u32>, StoreError> {
        let jobs = crash::died(&self.connection)
            .map_err(|source| StoreError::sqlite(&self.path, "look for jobs that died", source))?;
        Ok(jobs.into_iter().map(|(key, deaths)| (JobKey(key), deaths)).collect())
    }

    /// Removes the crash marks of dead sessions that hold no runs: processes that were killed while idle, or
    /// that used another store at this path. Other marks are needed to take over the runs of their sessions.
    pub fn clear_crash_marks(&self) -> Result<(), StoreError> {
        for session in crash::marked(&self.path) {
            let needed = is_mark_needed(&self.connection, session)
                .map_err(|source| StoreError::sqlite(&self.path, "look for sessions", source))?;
            if !needed {
                crash::unmark(&self.path, session);
            }
        }
        Ok(())
    }

    /// Interrupts the runs of dead sessions, so that their jobs can be claimed; returns the number of runs.
    ///
    /// `session` is the caller's session; other sessions are judged from its process. Writes nothing if no
    /// session died.
    pub fn release_dead_sessions(&mut self, session: SessionId) -> Result<usize, StoreError> {
        let this = process_of(&self.connection, session)
            .map_err(|source| StoreError::sqlite(&self.path, RELEASE, source))?;
        self.release_dead_of(&this)
    }

    /// Like [`Store::release_dead_sessions`], for a process without a session.
    pub(super) fn release_all_dead_sessions(&mut self) -> Result<usize, StoreError> {
        self.release_dead_of(&ProcessTable::of_this_system().this_process())
    }

    /// Interrupts the runs of sessions that are dead as seen from `this`.
    fn release_dead_of(&mut self, this: &Process) -> Result<usize, StoreError> {
        let action = RELEASE;
        let dead = holders(&self.connection, this)
            .map_err(|source| StoreError::sqlite(&self.path, action, source))?
            .dead;
        if dead.is_empty() {
            return Ok(0);
        }
        self.write(action, |transaction| {
            // A dead process stays dead, and only running runs are interrupted.
            dead.iter().try_fold(0, |runs, &id| Ok(runs + release_dead(transaction, id)?))
        })
    }
}

/// Interrupts the running runs of a session whose process is dead; returns their number. Each run whose job
/// may have caused the death records the number of running jobs.
pub(super) fn release_dead(connection: &Connection, session: i64) -> rusqlite::Result<usize> {
    let running = running(connection, session)?;
    let suspects = match crash::take(connection, session)? {
        Death::Crashed => running_runs(connection, session)?,
        Death::Killed => crash::suspects(connection, session, running)?,
        Death::Blameless => Vec::new(),
    };
    for run in &suspects {
        connection
            .prepare_cached(&format!(
                "UPDATE run SET status = 'interrupted', ended_at = {NOW}, suspects = ?2 WHERE id = ?1"
            ))?
            .execute([*run, running])?;
    }
    Ok(suspects.len() + release(connection, session)?)
}

fn running_runs(connection: &Connection, session: i64) -> rusqlite::Result<Vec<i64>> {
    let mut statement = connection
        .prepare_cached("SELECT id FROM run WHERE session = ?1 AND status = 'running'")?;
    statement.query_map([session], |row| row.get(0))?.collect()
}

fn running(connection: &Connection, session: i64) -> rusqlite::Result<i64> {
    connection
        .prepare_cached("SELECT count(*) FROM run WHERE session = ?1 AND status = 'running'")?
        .query_row([session], |row| row.get(0))
}

/// Interrupts the running runs of a session; returns their number.
pub(super) fn release(connection: &Connection, session: i64) -> rusqlite::Result<usize> {
    connection
        .prepare_cached(&format!(
            "UPDATE run SET status = 'interrupted', ended_at = {NOW}
             WHERE session = ?1 AND status = 'running'"
        ))?
        .execute([session])
}

/// Whether the session is alive, or holds runs whose end its mark explains.
fn is_mark_needed(connection: &Connection, session: i64) -> rusqlite::Result<bool> {
    let table = ProcessTable::of_this_system();
    let this = table.this_process();
    let needed = connection
        .prepare_cached(&format!("SELECT {SESSION} FROM session WHERE id = ?1"))?
        .query_row([session], |row| liveness(row, &table, &this))
        .optional()?
        .is_some_and(|liveness| liveness == Liveness::Alive);
    Ok(needed || running(connection, session)? > 0)
}

/// The columns that [`liveness`] reads.
const SESSION: &str = "id, host, boot_id, pid_namespace, process_id, process_started,
    86400 * (julianday('now') - julianday(heartbeat_at)), ended_at IS NOT NULL";

/// Whether the process of a session is alive, judged from the process `this`.
fn liveness(row: &Row<'_>, table: &ProcessTable, this: &Process) -> rusqlite::Result<Liveness> {
    // If the clock was set back, the heartbeat lies in the future.
    let silence = Duration::try_from_secs_f64(row.get(6)?).unwrap_or(Duration::ZERO);
    Ok(match row.get(7)? {
        true => Liveness::Dead,
        false => table.judge(this, &process(row)?, silence),
    })
}

/// The living sessions as seen from this process, each with its filter.
pub(super) fn living_filters(
    connection: &Connection,
) -> rusqlite::Result<Vec<(i64, Option<String>)>> {
    let select = format!("SELECT {SESSION}, filter FROM session WHERE ended_at IS NULL");
    let mut statement = connection.prepare_cached(&select)?;
    let mut rows = statement.query([])?;
    let table = ProcessTable::of_this_system();
    let (this, mut living) = (table.this_process(), Vec::new());
    while let Some(row) = rows.next()? {
        if liveness(row, &table, &this)? == Liveness::Alive {
            living.push((row.get(0)?, row.get("filter")?));
        }
    }
    Ok(living)
}

/// The sessions that hold running runs.
#[derive(Debug, Default)]
pub(super) struct Holders {
    pub(super) alive: Vec<i64>,
    pub(super) dead: Vec<i64>,
}

impl Holders {
    /// The living sessions as a JSON list, which SQL takes as one parameter.
    pub(super) fn alive_json(&self) -> String {
        serde_json::Value::from(self.alive.clone()).to_string()
    }
}

/// The sessions that hold running runs, judged from the process `this`.
pub(super) fn holders(connection: &Connection, this: &Process) -> rusqlite::Result<Holders> {
    let mut statement = connection.prepare_cached(&format!(
        "SELECT {SESSION} FROM session
         WHERE id IN (SELECT session FROM run WHERE status = 'running')"
    ))?;
    let mut rows = statement.query([])?;
    let table = ProcessTable::of_this_system();
    let mut holders = Holders::default();
    while let Some(row) = rows.next()? {
        let id = row.get(0)?;
        match liveness(row, &table, this)? {
            Liveness::Alive => holders.alive.push(id),
            Liveness::Dead => holders.dead.push(id),
        }
    }
    Ok(holders)
}

/// The process that began a session.
pub(super) fn process_of(connection: &Connection, session: SessionId) -> rusqlite::Result<Process> {
    connection
        .prepare_cached(
            "SELECT id, host, boot_id, pid_namespace, process_id, process_started
             FROM session WHERE id = ?1",
        )?
        .query_row([session.0], process)
}

fn process(row: &Row<'_>) -> rusqlite::Result<Process> {
    Ok(Process {
        host: row.get(1)?,
        boot_id: row.get(2)?,
        pid_namespace: row.get(3)?,
        id: row.get(4)?,
        started: row.get(5)?,
    })
}
