//! The jobs of experiments, counted by state.

use std::collections::{BTreeMap, HashMap};

use rusqlite::{CachedStatement, Connection};

use super::error::StoreError;
use super::read::{Reader, holders};
use super::state::{Counts, JobState, States};

/// How many jobs of an experiment are in each state, and how much training is still to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExperimentCounts {
    /// The experiment's name.
    pub experiment: String,
    /// Its jobs, each counted once.
    pub counts: Counts,
    /// Training episodes by algorithm, as the manifest writes it, of the jobs that are pending,
    /// interrupted or running; how far those running have come is not known here.
    pub episodes_left: BTreeMap<String, u64>,
}

impl Reader {
    /// The jobs of every experiment by state, in the order the experiments were first run.
    pub fn experiment_counts(&self) -> Result<Vec<ExperimentCounts>, StoreError> {
        self.read("count jobs", |connection| {
            let mut counted = count(connection)?;
            let mut statement =
                connection.prepare_cached("SELECT id, name FROM experiment ORDER BY id")?;
            let rows = statement.query_map([], |row| {
                let Counted { counts, episodes_left } =
                    counted.remove(&row.get(0)?).unwrap_or_default();
                Ok(ExperimentCounts { experiment: row.get(1)?, counts, episodes_left })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

#[derive(Default)]
struct Counted {
    counts: Counts,
    episodes_left: BTreeMap<String, u64>,
}

/// The counts of every experiment that holds jobs, by row id.
fn count(connection: &Connection) -> rusqlite::Result<HashMap<i64, Counted>> {
    let states = States::read(connection, &holders(connection)?.alive)?;
    let mut budget = connection.prepare_cached(
        "SELECT json_extract(canonical, '$.agent.algorithm'),
            -- NULL for an algorithm that does not train.
            ifnull(json_extract(canonical, '$.agent.episodes'), 0)
         FROM job WHERE id = ?1",
    )?;
    let mut counted: HashMap<i64, Counted> = HashMap::new();
    for_each_held(connection, |experiment, job| {
        let counted = counted.entry(experiment).or_default();
        let state = states.of(job);
        counted.counts.add(state, 1);
        match state {
            // These are not run again.
            JobState::Completed | JobState::Failed => Ok(()),
            JobState::Pending | JobState::Interrupted | JobState::Running => {
                add_budget(&mut budget, job, &mut counted.episodes_left)
            }
        }
    })?;
    Ok(counted)
}

fn add_budget(
    budget: &mut CachedStatement<'_>,
    job: i64,
    episodes_left: &mut BTreeMap<String, u64>,
) -> rusqlite::Result<()> {
    let mut rows = budget.query([job])?;
    if let Some(row) = rows.next()? {
        let (algorithm, episodes) = (row.get_ref(0)?.as_str()?, row.get::<_, u64>(1)?);
        match episodes_left.get_mut(algorithm) {
            Some(left) => *left += episodes,
            None => {
                episodes_left.insert(algorithm.to_owned(), episodes);
            }
        }
    }
    Ok(())
}

/// Calls `see` with the row ids of every experiment and job that it holds, once for each pair,
/// ordered by experiment.
fn for_each_held(
    connection: &Connection,
    mut see: impl FnMut(i64, i64) -> rusqlite::Result<()>,
) -> rusqlite::Result<()> {
    let mut statement = connection
        .prepare_cached("SELECT experiment, job FROM experiment_job ORDER BY experiment, job")?;
    let mut rows = statement.query([])?;
    let mut last = None;
    while let Some(row) = rows.next()? {
        let held = (row.get(0)?, row.get(1)?);
        // Two agents of an experiment may share a job.
        if last.replace(held) != Some(held) {
            see(held.0, held.1)?;
        }
    }
    Ok(())
}
