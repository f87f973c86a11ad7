//! The ends of runs, each with all its results, in one transaction.

use std::collections::HashMap;

use rusqlite::{Connection, OptionalExtension, params};

use crate::record::{Failure, Outcome, Results};

use super::{Claim, NOW, Store, StoreError, digest};

/// The end of a claimed run.
#[derive(Clone, Copy, Debug)]
pub struct RunEnd<'a> {
    /// The run.
    pub claim: &'a Claim,
    /// What it leaves behind.
    pub outcome: &'a Outcome,
    /// How long it took, in seconds of real time.
    pub wall_seconds: f64,
}

/// What became of the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finished {
    /// It is stored.
    Stored,
    /// The run is no longer the claimer's; nothing of it is stored.
    ClaimLost,
}

impl Store {
    /// Ends a claimed run, with everything that it leaves behind, or not at all.
    ///
    /// `wall_seconds` is how long it took, in seconds of real time.
    ///
    /// **Errors**: [`StoreError::ClaimLost`] if the run is no longer the claimer's; the results
    /// break a rule of the schema (a number that is not finite, none at all).
    pub fn finish(
        &mut self,
        claim: &Claim,
        outcome: &Outcome,
        wall_seconds: f64,
    ) -> Result<(), StoreError> {
        match self.finish_all(&[RunEnd { claim, outcome, wall_seconds }])?.as_slice() {
            [Finished::Stored] => Ok(()),
            _ => Err(StoreError::ClaimLost { key: claim.job_key }),
        }
    }

    /// Ends claimed runs together, which waits for the disk once; says of each what became of it.
    /// What was stored survives a power cut.
    ///
    /// **Errors**: as [`Store::finish`], but for lost claims; none of the ends is stored then.
    pub fn finish_all(&mut self, ends: &[RunEnd<'_>]) -> Result<Vec<Finished>, StoreError> {
        self.write_durably("store the end of a run", |transaction| {
            ends.iter().map(|end| Ok(finish_one(transaction, end)?)).collect()
        })
    }
}

fn finish_one(connection: &Connection, end: &RunEnd<'_>) -> rusqlite::Result<Finished> {
    let Claim { run, session, .. } = end.claim;
    let held: bool = connection
        .prepare_cached(
            "SELECT EXISTS (SELECT 1 FROM run
                WHERE id = ?1 AND session = ?2 AND status = 'running')",
        )?
        .query_row([run, &session.0], |row| row.get(0))?;
    if !held {
        return Ok(Finished::ClaimLost);
    }
    match end.outcome {
        Outcome::Completed(results) => {
            insert_results(connection, *run, results)?;
            complete_run(connection, *run, end.wall_seconds)?;
        }
        Outcome::Failed(failure) => {
            end_run(connection, *run, "failed", Some(failure), end.wall_seconds)?;
        }
        Outcome::Interrupted => {
            end_run(connection, *run, "interrupted", None, end.wall_seconds)?;
        }
    }
    Ok(Finished::Stored)
}

/// Completes a run whose results are in the file, with their digest.
fn complete_run(connection: &Connection, run: i64, wall_seconds: f64) -> rusqlite::Result<()> {
    let results = digest::of_run(connection, run)?;
    connection
        .prepare_cached(&format!(
            "UPDATE run SET status = 'completed', ended_at = {NOW}, wall_seconds = ?2,
                results_sha256 = ?3
             WHERE id = ?1"
        ))?
        .execute(params![run, wall_seconds, results])?;
    Ok(())
}

/// Ends a run that leaves no results.
pub(super) fn end_run(
    connection: &Connection,
    run: i64,
    status: &str,
    failure: Option<&Failure>,
    wall_seconds: f64,
) -> rusqlite::Result<()> {
    connection
        .prepare_cached(&format!(
            "UPDATE run SET status = ?2, ended_at = {NOW}, wall_seconds = ?3,
                failure_kind = ?4, failure_message = ?5, failure_episode = ?6
             WHERE id = ?1"
        ))?
        .execute(params![
            run,
            status,
            wall_seconds,
            failure.map(|failure| failure.kind.name()),
            failure.map(|failure| &failure.message),
            failure.map(|failure| failure.episode),
        ])?;
    Ok(())
}

fn insert_results(connection: &Connection, run: i64, results: &Results) -> rusqlite::Result<()> {
    let mut names = MetricNames { connection, ids: HashMap::new() };
    let mut insert = connection.prepare_cached("INSERT INTO run_metric VALUES (?1, ?2, ?3)")?;
    for metric in &results.metrics {
        insert.execute(params![run, names.id(metric.name)?, metric.value])?;
    }
    let mut insert =
        connection.prepare_cached("INSERT INTO curve_point VALUES (?1, ?2, ?3, ?4)")?;
    for point in &results.curve {
        insert.execute(params![run, names.id(point.metric)?, point.episode, point.value])?;
    }
    let mut insert =
        connection.prepare_cached("INSERT INTO test_episode VALUES (?1, ?2, ?3, ?4, ?5)")?;
    for (number, episode) in (1_i64..).zip(&results.episodes) {
        insert.execute(params![
            run,
            number,
            episode.total_reward,
            episode.length,
            episode.disengaged
        ])?;
    }
    let mut insert =
        connection.prepare_cached("INSERT INTO action_count VALUES (?1, ?2, ?3, ?4, ?5)")?;
    for choice in &results.actions {
        insert.execute(params![run, choice.bin, choice.context, choice.action, choice.count])?;
    }
    if let Some(weights) = &results.weights {
        connection
            .prepare_cached("INSERT INTO trained_weights VALUES (?1, ?2)")?
            .execute(params![run, weights])?;
    }
    Ok(())
}

/// Row ids of metric names; a name is added when first met.
struct MetricNames<'a> {
    connection: &'a Connection,
    ids: HashMap<&'static str, i64>,
}

impl MetricNames<'_> {
    fn id(&mut self, name: &'static str) -> rusqlite::Result<i64> {
        if let Some(&id) = self.ids.get(name) {
            return Ok(id);
        }
        let found = self
            .connection
            .prepare_cached("SELECT id FROM metric_name WHERE name = ?1")?
            .query_row([name], |row| row.get(0))
            .optional()?;
        let id = match found {
            Some(id) => id,
            None => self
                .connection
                .prepare_cached("INSERT INTO metric_name (name) VALUES (?1)")?
                .insert([name])?,
        };
        self.ids.insert(name, id);
        Ok(id)
    }
}
