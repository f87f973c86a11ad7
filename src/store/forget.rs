//! Removal of an experiment: the only deletion of rows that others may rely on.

use rusqlite::{Connection, OptionalExtension};

use super::error::StoreError;
use super::read::{Reader, holders};
use super::state::{Counts, JobState, RunStates};
use super::tables::RESULT_TABLES;
use super::writer::Store;

/// The data that the store has of an experiment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Belongings {
    /// The experiment's jobs by state, each counted once.
    pub jobs: Counts,
    /// The experiment's jobs that no other experiment holds, by state.
    pub alone: Counts,
    /// Completed jobs in the store that no experiment holds.
    pub unheld: u64,
}

/// The result of an attempt to remove an experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Forgotten {
    /// The store has no experiment of this name.
    Unknown,
    /// A living process is running jobs of the experiment; nothing was removed.
    Running,
    /// The experiment was removed.
    Removed(Belongings),
}

/// The number of completed jobs that no experiment holds.
const UNHELD: &str = "SELECT count(DISTINCT job) FROM run WHERE status = 'completed'
    AND NOT EXISTS (SELECT 1 FROM experiment_job AS held WHERE held.job = run.job)";

impl Reader {
    /// The data that the store has of an experiment; `None` for an unknown experiment.
    pub fn belongings(&self, experiment: &str) -> Result<Option<Belongings>, StoreError> {
        self.read("read an experiment", |connection| {
            let Some(id) = id_of(connection, experiment)? else { return Ok(None) };
            Ok(Some(Held::read(connection, id)?.belongings(connection)?))
        })
    }
}

impl Store {
    /// Removes an experiment. With `results`, also removes the jobs that no other experiment holds, with all
    /// their runs and results. One transaction removes everything or nothing.
    ///
    /// **Errors**: the store fails.
    pub fn forget(&mut self, experiment: &str, results: bool) -> Result<Forgotten, StoreError> {
        let forgotten = self.forgotten(experiment, results);
        // Another process may read the log; then it is emptied when the last process closes the store.
        let _ = self.connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
        forgotten
    }

    fn forgotten(&mut self, experiment: &str, results: bool) -> Result<Forgotten, StoreError> {
        self.write_durably("forget an experiment", |transaction| {
            // What is deleted can have names of people: its bytes go, too.
            transaction.query_row("PRAGMA secure_delete = ON", [], |_| Ok(()))?;
            let Some(id) = id_of(transaction, experiment)? else { return Ok(Forgotten::Unknown) };
            let held = Held::read(transaction, id)?;
            let belongings = held.belongings(transaction)?;
            if belongings.jobs.running > 0 {
                return Ok(Forgotten::Running);
            }
            without_guards(transaction, || {
                for table in ["experiment_job", "earlier_manifest"] {
                    let delete = format!("DELETE FROM {table} WHERE experiment = ?1");
                    transaction.execute(&delete, [id])?;
                }
                transaction.execute("DELETE FROM experiment WHERE id = ?1", [id])?;
                if results { delete_jobs(transaction, &held) } else { Ok(()) }
            })?;
            Ok(Forgotten::Removed(belongings))
        })
    }
}

fn id_of(connection: &Connection, experiment: &str) -> rusqlite::Result<Option<i64>> {
    connection
        .query_row("SELECT id FROM experiment WHERE name = ?1", [experiment], |row| row.get(0))
        .optional()
}

/// The jobs of an experiment: row id, state, and whether no other experiment holds the job.
struct Held(Vec<(i64, JobState, bool)>);

impl Held {
    fn read(connection: &Connection, experiment: i64) -> rusqlite::Result<Held> {
        let states = RunStates::read(connection, &holders(connection)?.alive)?;
        let mut statement = connection.prepare(
            "SELECT DISTINCT job, NOT EXISTS (SELECT 1 FROM experiment_job AS other
                WHERE other.job = held.job AND other.experiment <> ?1)
             FROM experiment_job AS held WHERE experiment = ?1",
        )?;
        let rows = statement.query_map([experiment], |row| {
            let job = row.get(0)?;
            Ok((job, states.of(job), row.get(1)?))
        })?;
        Ok(Held(rows.collect::<rusqlite::Result<_>>()?))
    }

    fn belongings(&self, connection: &Connection) -> rusqlite::Result<Belongings> {
        let mut belongings = Belongings {
            unheld: connection.query_row(UNHELD, [], |row| row.get(0))?,
            ..Belongings::default()
        };
        for (_, state, alone) in &self.0 {
            belongings.jobs.add(*state, 1);
            if *alone {
                belongings.alone.add(*state, 1);
            }
        }
        Ok(belongings)
    }
}

/// Runs `delete` without the triggers that forbid deletions. The triggers are restored before the transaction
/// ends; if `delete` fails, rolling back the transaction restores them.
fn without_guards(
    connection: &Connection,
    delete: impl FnOnce() -> rusqlite::Result<()>,
) -> rusqlite::Result<()> {
    let guards: Vec<(String, String)> = connection
        .prepare(
            "SELECT name, sql FROM sqlite_schema
             WHERE type = 'trigger' AND sql LIKE '%BEFORE DELETE ON%'",
        )?
        .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
        .collect::<rusqlite::Result<_>>()?;
    for (name, _) in &guards {
        connection.execute_batch(&format!("DROP TRIGGER \"{}\"", name.replace('"', "\"\"")))?;
    }
    delete()?;
    guards.iter().try_for_each(|(_, sql)| connection.execute_batch(sql))
}

/// Deletes the jobs that only this experiment holds, with their runs and results.
fn delete_jobs(connection: &Connection, held: &Held) -> rusqlite::Result<()> {
    let mut runs = connection.prepare("SELECT id FROM run WHERE job = ?1")?;
    let results = RESULT_TABLES.iter().map(|table| (table.name, table.rows()));
    let mut of_run = results
        .chain([("run", "id = ?1".to_owned())])
        .map(|(table, rows)| connection.prepare(&format!("DELETE FROM {table} WHERE {rows}")))
        .collect::<rusqlite::Result<Vec<_>>>()?;
    let mut conflicts = connection.prepare("DELETE FROM recorded_conflict WHERE job = ?1")?;
    let mut job_row = connection.prepare("DELETE FROM job WHERE id = ?1")?;
    for (job, ..) in held.0.iter().filter(|(.., alone)| *alone) {
        let ids = runs.query_map([job], |row| row.get(0))?;
        for run in ids.collect::<rusqlite::Result<Vec<i64>>>()? {
            of_run.iter_mut().try_for_each(|delete| delete.execute([run]).map(drop))?;
        }
        conflicts.execute([job])?;
        job_row.execute([job])?;
    }
    Ok(())
}
