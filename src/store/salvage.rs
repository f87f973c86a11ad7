//! A new store from what a damaged one still holds.
//!
//! In: the path of a store, that of a store to be, and a way to see whether weights load. Out: a
//! store that passes [`super::examine`], with every completed run whose results are still those
//! that were stored, and everything else that can be read of experiments, jobs, sessions and failed
//! or interrupted runs; and [`Salvaged`], which says how much that was. The damaged file is only
//! read. Runs that were in progress are left behind: their jobs run again.

use std::fs;
use std::path::{Path, PathBuf};

use rusqlite::types::Value;
use rusqlite::{Connection, ErrorCode, params_from_iter};

use crate::record::{CURVE_METRICS, METRICS};

use super::doctor::{self, Loads, row_ids};
use super::{NOW, Store, StoreError, file};

/// How much of a store was carried over to a new one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Salvaged {
    /// Experiments.
    pub experiments: usize,
    /// Jobs.
    pub jobs: usize,
    /// Completed runs, each with all its results.
    pub completed: usize,
    /// Completed runs that are known to be lost: their jobs run again.
    pub lost: usize,
    /// Whether the list of runs cannot be read to its end, so that more of them may be lost.
    pub lost_more: bool,
    /// Failed and interrupted runs.
    pub others: usize,
}

/// The tables of results, each keyed by its run.
const RESULTS: [&str; 5] =
    ["run_metric", "curve_point", "test_episode", "action_count", "trained_weights"];

/// Writes what can be read of the store at `damaged` to a new store at `new`.
///
/// **Errors**: `new` is there already or cannot be made; `damaged` is no store, or of another
/// release. Nothing is left at `new` then.
pub fn salvage(damaged: &Path, new: &Path, loads: Loads<'_>) -> Result<Salvaged, StoreError> {
    if new.symlink_metadata().is_ok() {
        return Err(StoreError::InTheWay { path: new.to_owned() });
    }
    let salvaged = write_new(damaged, new, loads);
    if salvaged.is_err() {
        remove(new);
    }
    salvaged
}

fn write_new(damaged: &Path, new: &Path, loads: Loads<'_>) -> Result<Salvaged, StoreError> {
    // Closed once, so that all of it is in its one file.
    drop(Store::open(new)?);
    let mut store = Store::open(new)?;
    let source = Source::open(damaged, &store)?;
    store.write_durably("write the salvaged store", |transaction| {
        let copy = Copy { from: &source.connection, to: transaction, loads };
        let salvaged = copy.everything()?;
        // With a schema that was not its own, any file looks like a store.
        if source.repaired.is_some() && salvaged.jobs == 0 {
            return Err(StoreError::NothingToSave { path: damaged.to_owned() }.into());
        }
        Ok(salvaged)
    })
}

/// Removes a store with what lies beside it. What cannot be removed does no harm.
fn remove(path: &Path) {
    for ending in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(file::beside(path, ending));
    }
}

/// The damaged store, as far as it can be opened.
struct Source {
    connection: Connection,
    /// A copy that is read in its place.
    repaired: Option<PathBuf>,
}

impl Drop for Source {
    fn drop(&mut self) {
        if let Some(path) = &self.repaired {
            remove(path);
        }
    }
}

impl Source {
    /// Opens the file itself, or, if its header or schema is damaged, a copy that has those of a
    /// new store.
    fn open(damaged: &Path, new: &Store) -> Result<Source, StoreError> {
        match file::open_damaged(damaged) {
            Ok(connection) => return Ok(Source { connection, repaired: None }),
            // Nothing but a damaged header makes a store look like one of these.
            Err(StoreError::Damaged { .. }) => {}
            Err(error) => return Err(error),
        }
        let path = file::beside(&new.path, ".salvaging");
        let cannot = |error: std::io::Error| StoreError::CannotOpen {
            path: damaged.to_owned(),
            reason: error.to_string(),
        };
        let mut bytes = fs::read(damaged).map_err(cannot)?;
        let template = fs::read(&new.path).map_err(cannot)?;
        let pages = schema_pages(&new.connection)
            .map_err(|source| StoreError::sqlite(&new.path, "read the schema", source))?;
        put_schema(&mut bytes, &template, &pages);
        let log = file::beside(damaged, "-wal");
        if log.exists() {
            fs::copy(log, file::beside(&path, "-wal")).map_err(cannot)?;
        }
        fs::write(&path, bytes).map_err(cannot)?;
        let opened = file::open_damaged(&path);
        let repaired = Some(path);
        match opened {
            Ok(connection) => Ok(Source { connection, repaired }),
            Err(_) => {
                remove(&file::beside(&new.path, ".salvaging"));
                Err(StoreError::NothingToSave { path: damaged.to_owned() })
            }
        }
    }
}

/// The pages that hold the schema, from 1.
fn schema_pages(connection: &Connection) -> rusqlite::Result<Vec<usize>> {
    let mut statement =
        connection.prepare("SELECT pageno FROM dbstat WHERE name = 'sqlite_schema'")?;
    let pages = statement.query_map([], |row| row.get::<_, u32>(0).map(|page| page as usize))?;
    pages.collect()
}

/// Gives the bytes of a store the header and schema of a new one. Both were made by the same
/// migrations, which put every table at the same page; were it not so, nothing would be read that
/// belongs together, and no run would be taken for intact.
fn put_schema(damaged: &mut [u8], template: &[u8], pages: &[usize]) {
    let size = match u16::from_be_bytes([template[16], template[17]]) {
        1 => 65_536,
        size => usize::from(size),
    };
    for page in pages {
        let place = (page - 1) * size..page * size;
        if let (Some(to), Some(from)) = (damaged.get_mut(place.clone()), template.get(place)) {
            to.copy_from_slice(from);
        }
    }
    // The header counts the pages, and no longer knows which of them are free.
    let count = u32::try_from(damaged.len() / size).unwrap_or(u32::MAX);
    if let Some(header) = damaged.get_mut(28..40) {
        header[..4].copy_from_slice(&count.to_be_bytes());
        header[4..].fill(0);
    }
}

/// The columns of a run, but for its id.
const RUN: &str = "job, attempt, session, status, started_at, ended_at, wall_seconds,
    failure_kind, failure_message, failure_episode, suspects, results_sha256";

/// A copy from one store to another. What cannot be read, or breaks a rule of the schema, is left
/// out.
struct Copy<'a> {
    from: &'a Connection,
    to: &'a Connection,
    loads: Loads<'a>,
}

impl Copy<'_> {
    fn everything(&self) -> rusqlite::Result<Salvaged> {
        let mut salvaged = Salvaged::default();
        for id in row_ids(self.from, "experiment").0 {
            salvaged.experiments += usize::from(self.row("experiment", id)?);
        }
        for id in row_ids(self.from, "job").0 {
            if let Ok((_, None)) = doctor::job_fault(self.from, id) {
                salvaged.jobs += usize::from(self.row("job", id)?);
            }
        }
        self.held_jobs()?;
        self.metric_names()?;
        let sessions = row_ids(self.from, "session").0;
        for &id in &sessions {
            self.session(id)?;
        }
        let (runs, all) = row_ids(self.from, "run");
        salvaged.lost_more = !all;
        for id in runs {
            let Some(run) =
                self.read(&format!("SELECT {RUN} FROM run NOT INDEXED WHERE id = ?1"), id)
            else {
                continue;
            };
            let status = match &run[3] {
                Value::Text(status) => status.clone(),
                _ => continue,
            };
            let carried = status != "running" && self.run(id, &run)?;
            match (status.as_str(), carried) {
                ("completed", true) => salvaged.completed += 1,
                ("completed", false) => salvaged.lost += 1,
                (_, true) => salvaged.others += 1,
                (_, false) => {}
            }
        }
        for id in sessions {
            self.end_session(id)?;
        }
        Ok(salvaged)
    }

    /// A row of the damaged store; `None` if it is not there or cannot be read.
    fn read(&self, sql: &str, id: i64) -> Option<Vec<Value>> {
        let mut statement = self.from.prepare_cached(sql).ok()?;
        let columns = statement.column_count();
        statement.query_row([id], |row| (0..columns).map(|column| row.get(column)).collect()).ok()
    }

    /// Writes to the new store; `false` if its rules refuse it.
    fn write(&self, sql: &str, values: &[Value]) -> rusqlite::Result<bool> {
        let written = self.to.prepare_cached(sql)?.execute(params_from_iter(values));
        match written {
            Ok(rows) => Ok(rows > 0),
            Err(error) => match error.sqlite_error_code() {
                Some(ErrorCode::ConstraintViolation | ErrorCode::TypeMismatch) => Ok(false),
                _ => Err(error),
            },
        }
    }

    fn insert(&self, table: &str, values: &[Value]) -> rusqlite::Result<bool> {
        let places = vec!["?"; values.len()].join(", ");
        self.write(&format!("INSERT INTO {table} VALUES ({places})"), values)
    }

    /// Copies a row by its id.
    fn row(&self, table: &str, id: i64) -> rusqlite::Result<bool> {
        match self.read(&format!("SELECT * FROM {table} NOT INDEXED WHERE id = ?1"), id) {
            Some(values) => self.insert(table, &values),
            None => Ok(false),
        }
    }

    /// Copies what experiments hold, of the experiments and jobs that were copied.
    fn held_jobs(&self) -> rusqlite::Result<()> {
        for job in row_ids(self.to, "job").0 {
            for experiment in row_ids(self.to, "experiment").0 {
                let sql = "SELECT * FROM experiment_job WHERE experiment = ?1 AND job = ?2";
                for row in self.rows(sql, &[experiment, job]).unwrap_or_default() {
                    self.insert("experiment_job", &row)?;
                }
            }
        }
        Ok(())
    }

    /// The rows of an answer of the damaged store; `None` if one of them cannot be read.
    fn rows(&self, sql: &str, ids: &[i64]) -> Option<Vec<Vec<Value>>> {
        let mut statement = self.from.prepare_cached(sql).ok()?;
        let columns = statement.column_count();
        let rows = statement.query_map(params_from_iter(ids), |row| {
            (0..columns).map(|column| row.get(column)).collect()
        });
        rows.ok()?.collect::<rusqlite::Result<_>>().ok()
    }

    /// Copies the names of metrics. They stand in the table and in its index; where these differ,
    /// a name that this program gives is the right one.
    fn metric_names(&self) -> rusqlite::Result<()> {
        let known = |row: &Vec<Value>| match row.as_slice() {
            [_, Value::Text(name)] => {
                METRICS.iter().chain(CURVE_METRICS).any(|(known, _)| known == name)
            }
            _ => false,
        };
        let mut named = Vec::new();
        for sql in [
            "SELECT id, name FROM metric_name NOT INDEXED",
            "SELECT id, name FROM metric_name ORDER BY name",
        ] {
            named.extend(self.rows(sql, &[]).unwrap_or_default());
        }
        named.sort_by_key(|row| !known(row));
        for row in named {
            self.insert("metric_name", &row)?;
        }
        Ok(())
    }

    /// Copies a session as one that lives, for only such a one can have runs; a session that
    /// cannot be read is replaced by one of which nothing is known, so that its runs have one.
    fn session(&self, id: i64) -> rusqlite::Result<bool> {
        let copied = match self.read("SELECT * FROM session WHERE id = ?1", id) {
            Some(mut values) => {
                if let Some(ended_at) = values.last_mut() {
                    *ended_at = Value::Null;
                }
                self.insert("session", &values)?
            }
            None => false,
        };
        if copied {
            return Ok(true);
        }
        let unknown = format!(
            "INSERT OR IGNORE INTO session (id, host, process_id, code_version, git_revision,
                backend, processor, started_at, heartbeat_at)
             VALUES (?1, 'unknown', 1, 'unknown', 'unknown', 'unknown', 'unknown', {NOW}, {NOW})"
        );
        self.write(&unknown, &[Value::Integer(id)])
    }

    fn end_session(&self, id: i64) -> rusqlite::Result<bool> {
        match self.read("SELECT ended_at FROM session WHERE id = ?1", id).as_deref() {
            Some([ended_at @ Value::Text(_)]) => self.write(
                "UPDATE session SET ended_at = ?2 WHERE id = ?1",
                &[Value::Integer(id), ended_at.clone()],
            ),
            _ => Ok(false),
        }
    }

    /// Copies an ended run with its results, or nothing of it; whether it was copied.
    fn run(&self, id: i64, run: &[Value]) -> rusqlite::Result<bool> {
        self.to.execute_batch("SAVEPOINT run")?;
        let copied = self.run_and_results(id, run)?;
        if !copied {
            self.to.execute_batch("ROLLBACK TO run")?;
        }
        self.to.execute_batch("RELEASE run")?;
        Ok(copied)
    }

    fn run_and_results(&self, id: i64, run: &[Value]) -> rusqlite::Result<bool> {
        let [job, attempt, session, status, started_at, end @ ..] = run else { return Ok(false) };
        if let Value::Integer(session) = session
            && self.read("SELECT id FROM session WHERE id = ?1", *session).is_none()
        {
            self.session(*session)?;
        }
        let begin = "INSERT INTO run (id, job, attempt, session, status, started_at)
             VALUES (?1, ?2, ?3, ?4, 'running', ?5)";
        let id_value = Value::Integer(id);
        let begun = [&id_value, job, attempt, session, started_at].map(Clone::clone);
        if !self.write(begin, &begun)? || !self.results(id)? {
            return Ok(false);
        }
        let finish = "UPDATE run SET status = ?2, ended_at = ?3, wall_seconds = ?4,
                failure_kind = ?5, failure_message = ?6, failure_episode = ?7, suspects = ?8,
                results_sha256 = ?9
             WHERE id = ?1";
        let ended: Vec<Value> = [&id_value, status].into_iter().chain(end).cloned().collect();
        Ok(self.write(finish, &ended)?
            && match status {
                Value::Text(status) if status == "completed" => {
                    doctor::run_fault(self.to, id, self.loads).is_none()
                }
                Value::Text(status) if status == "failed" => {
                    doctor::failure_fault(self.to, id).is_none()
                }
                _ => true,
            })
    }

    fn results(&self, run: i64) -> rusqlite::Result<bool> {
        for table in RESULTS {
            let rows = self.rows(&format!("SELECT * FROM {table} WHERE run = ?1"), &[run]);
            let Some(rows) = rows else { return Ok(false) };
            for row in rows {
                if !self.insert(table, &row)? {
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }
}
