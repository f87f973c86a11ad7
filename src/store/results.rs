//! Storing the ends of runs, each with all its results, in one transaction.

use std::path::Path;

use crate::job::metric::SD_RETURN;
use rusqlite::{Connection, OptionalExtension, params};

use crate::job::{ActionCount, Job, MetricName, Outcome, Results, TestEpisode, Versions};

use super::claim::Claim;
use super::ending::{complete_run, end_run};
use super::error::StoreError;
use super::insert::insert_rows;
use super::migrate::MIGRATIONS;
use super::transaction::NOW;
use super::writer::Store;
use super::{choice, decision, digest, episode_ending, estimate, family, participant, posterior};

/// The end of a claimed run.
#[derive(Clone, Copy, Debug)]
pub struct RunEnd<'a> {
    /// The run.
    pub claim: &'a Claim,
    /// How it ended, with its results or its failure.
    pub outcome: &'a Outcome,
    /// Wall-clock time, in seconds.
    pub wall_seconds: f64,
}

/// The result of storing the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finished {
    /// The end was stored.
    Stored,
    /// Another session has taken over the run; nothing was stored.
    ClaimLost,
}

impl Store {
    /// Ends a claimed run and stores all its results, or fails and stores nothing.
    ///
    /// `wall_seconds` is the wall-clock time in seconds.
    ///
    /// **Errors**: [`StoreError::ClaimLost`] if another session has taken over the run; the results violate
    /// the schema (a number is not finite, or results are missing).
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

    /// Ends claimed runs in one transaction, which waits for the disk once. Returns for each run whether it
    /// was stored. Stored runs survive a power failure.
    ///
    /// **Errors**: as for [`Store::finish`], except for lost claims; in that case, no run is stored.
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
            let key = end.claim.job_key.to_string();
            estimate::insert(connection, (*run, &key), &results.estimates)?;
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

/// The digest that the results of a completed run of a job have in every store.
///
/// **Errors**: the results violate the schema.
pub fn results_digest(job: &Job, results: &Results) -> Result<[u8; 32], StoreError> {
    let of_results = || -> rusqlite::Result<[u8; 32]> {
        let connection = Connection::open_in_memory()?;
        MIGRATIONS.iter().try_for_each(|migration| connection.execute_batch(migration.sql))?;
        let (form, Versions { environment, algorithm }) = (job.form(), job.versions());
        connection.execute(
            "INSERT INTO job VALUES (1, ?1, ?2, ?3, ?4)",
            params![form.key().to_string(), environment, algorithm, form.text()],
        )?;
        connection.execute_batch(&format!(
            "INSERT INTO session (id, host, process_id, code_version, git_revision, backend, processor,
                started_at, heartbeat_at) VALUES (1, '', 1, '', '', '', '', {NOW}, {NOW});
             INSERT INTO run (id, job, attempt, session, status, started_at)
             VALUES (1, 1, 1, 1, 'running', {NOW});"
        ))?;
        insert_results(&connection, 1, results)?;
        digest::of_run(&connection, 1)
    };
    of_results().map_err(|source| {
        StoreError::sqlite(Path::new(":memory:"), "compute the digest of results", source)
    })
}

fn insert_results(connection: &Connection, run: i64, results: &Results) -> rusqlite::Result<()> {
    let mut names = MetricNames { connection, ids: Vec::new() };
    let metrics = results.metrics.iter();
    let metrics = metrics.map(|metric| Ok((names.id(metric.name)?, metric.value)));
    let mut metrics = metrics.collect::<rusqlite::Result<Vec<_>>>()?;
    // The standard deviation of one episode is undefined, and readers and views show none. The file has the
    // 0 that earlier releases stored, so that equal results have equal digests.
    if results.episodes.len() == 1 && results.metrics.iter().all(|one| one.name != SD_RETURN) {
        metrics.push((names.id(SD_RETURN)?, 0.0));
    }
    let metrics = metrics.into_iter();
    let metrics = metrics.map(|(metric, value)| [run.into(), metric.into(), value.into()]);
    insert_rows(connection, "run_metric", metrics)?;
    // Sorted by the table's key, so that every row is appended.
    let points = results.curve.iter().map(|point| Ok((names.id(point.metric)?, point)));
    let mut points: Vec<_> = points.collect::<rusqlite::Result<_>>()?;
    points.sort_unstable_by_key(|(metric, point)| (*metric, point.episode));
    let points = points.into_iter();
    let points = points.map(|(metric, point)| {
        [run.into(), metric.into(), point.episode.into(), point.value.into()]
    });
    insert_rows(connection, "curve_point", points)?;
    let episodes = (1_i64..).zip(&results.episodes).map(|(number, episode)| {
        let TestEpisode { total_reward, length, terminated } = *episode;
        [run.into(), number.into(), total_reward.into(), length.into(), terminated.into()]
    });
    insert_rows(connection, "test_episode", episodes)?;
    let actions = results.actions.iter().filter_map(|choice| {
        let ActionCount { stratum, action, count } = *choice;
        let [bin, context] = [stratum? / 2, stratum? % 2];
        Some([run.into(), bin.into(), context.into(), action.into(), count.cast_signed().into()])
    });
    insert_rows(connection, "action_count", actions)?;
    if decision::packs(results) {
        decision::insert(connection, run, &results.decisions)?;
        choice::insert(connection, run, &results.decisions)?;
    } else {
        family::insert_steps(connection, run, results)?;
    }
    family::insert(connection, run, results)?;
    episode_ending::insert(connection, run, &results.decisions)?;
    participant::insert(connection, run, &results.participants)?;
    posterior::insert(connection, run, &results.posteriors)?;
    if let Some(weights) = &results.weights {
        connection
            .prepare_cached("INSERT INTO trained_weights VALUES (?1, ?2)")?
            .execute(params![run, weights])?;
    }
    Ok(())
}

/// The row ids of metric names, which are added as needed.
struct MetricNames<'a> {
    connection: &'a Connection,
    ids: Vec<(MetricName, i64)>,
}

impl MetricNames<'_> {
    fn id(&mut self, name: MetricName) -> rusqlite::Result<i64> {
        if let Some((_, id)) = self.ids.iter().find(|(known, _)| *known == name) {
            return Ok(*id);
        }
        let id = metric_id(self.connection, &name.text())?;
        self.ids.push((name, id));
        Ok(id)
    }
}

/// The row id of a metric's name; a new name is added.
pub(super) fn metric_id(connection: &Connection, name: &str) -> rusqlite::Result<i64> {
    let found = connection
        .prepare_cached("SELECT id FROM metric_name WHERE name = ?1")?
        .query_row([name], |row| row.get(0))
        .optional()?;
    match found {
        Some(id) => Ok(id),
        None => {
            connection.prepare_cached("INSERT INTO metric_name (name) VALUES (?1)")?.insert([name])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Job;
    use crate::job::metric::{EPSILON, MEAN_LOSS, MEAN_RETURN, metrics_of};
    use crate::job::{CurvePoint, Failure, FailureKind, MetricPlace};
    use crate::store::sample::{begin_session, claim, job, results};
    use crate::store::tables::ROWS;

    /// Records the synchronous mode whenever a run begins or ends.
    const RECORD: &str = "CREATE TEMP TABLE recorded (status TEXT, synchronous INTEGER);
        CREATE TEMP TRIGGER begins AFTER INSERT ON main.run
        BEGIN INSERT INTO recorded SELECT NEW.status, synchronous FROM pragma_synchronous; END;
        CREATE TEMP TRIGGER ends AFTER UPDATE OF status ON main.run
        BEGIN INSERT INTO recorded SELECT NEW.status, synchronous FROM pragma_synchronous; END";
    /// SQLite's numbers for the two modes; FULL waits for the disk.
    const NORMAL: i64 = 1;
    const FULL: i64 = 2;

    #[test]
    fn the_digest_of_results_stays_what_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let session = begin_session(&mut store);
        // Names occur in an order other than alphabetical.
        let point = |episode, metric, value| CurvePoint { episode, metric, value };
        let metrics = results().metrics.into_iter();
        let results = Results {
            // The metrics that every job has.
            metrics: metrics.filter(|metric| metric.name != "mean_net_return").collect(),
            curve: vec![
                point(10, MEAN_RETURN, 1.5),
                point(10, MEAN_LOSS, 2.5),
                point(10, EPSILON, 0.5),
                point(20, MEAN_RETURN, -1.5),
                point(20, EPSILON, 0.25),
            ],
            actions: vec![ActionCount { stratum: Some(19), action: 3, count: 7 }],
            ..results()
        };
        let claim = claim(&mut store, session, &job());
        store.finish(&claim, &Outcome::Completed(results), 1.0).unwrap();
        let digest: String = store
            .connection
            .query_row("SELECT lower(hex(results_sha256)) FROM run", [], |row| row.get(0))
            .unwrap();
        assert_eq!(
            digest, "92fa6b4698c5779d193a01e9a60bd36d94219c139e47f70c342d7c836a72ec34",
            "stored results would no longer count as intact"
        );
    }

    #[test]
    fn a_row_that_is_there_already_undoes_all_of_its_run() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let session = begin_session(&mut store);
        let claim = claim(&mut store, session, &job());
        let point = |i: u32| CurvePoint { episode: 1 + i % 63, metric: EPSILON, value: 1.0 };
        let results = Results { curve: (0..64).map(point).collect(), ..results() };
        let error = store.finish(&claim, &Outcome::Completed(results), 1.0).unwrap_err();
        assert!(format!("{error:?}").contains("UNIQUE constraint failed"), "{error:?}");
        let count = "SELECT (SELECT count(*) FROM curve_point) + (SELECT count(*) FROM run_metric)
            + (SELECT count(*) FROM test_episode)";
        let left: i64 = store.connection.query_row(count, [], |row| row.get(0)).unwrap();
        assert_eq!(left, 0);
    }

    /// The rows that a query reads of a run.
    fn rows<T>(
        store: &Store,
        sql: &str,
        claim: &Claim,
        read: impl Fn(&rusqlite::Row<'_>) -> rusqlite::Result<T>,
    ) -> Vec<T> {
        let mut statement = store.connection.prepare(sql).unwrap();
        let rows = statement.query_map([claim.run], |row| read(row)).unwrap();
        rows.collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn all_results_are_stored_whatever_their_number() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let session = begin_session(&mut store);
        for (seed, count) in (1..).zip([1, ROWS - 1, ROWS, 3 * ROWS + 5]) {
            let job = Job { seed, ..job() };
            let names = metrics_of(MetricPlace::Curve);
            let curve: Vec<CurvePoint> = (1..=count as u32)
                .flat_map(|episode| names.clone().map(move |metric| (episode, metric)))
                .zip(0..)
                .map(|((episode, metric), value)| CurvePoint {
                    episode,
                    metric,
                    value: value.into(),
                })
                .collect();
            let episodes: Vec<TestEpisode> = (1..=count as u32)
                .map(|length| TestEpisode {
                    total_reward: f64::from(length) / 7.0,
                    length,
                    terminated: length % 3 == 0,
                })
                .collect();
            let actions: Vec<ActionCount> = (0..count.min(80) as u8)
                .map(|i| ActionCount {
                    stratum: Some(i / 4),
                    action: i % 4,
                    count: 1 + u64::from(i),
                })
                .collect();
            let whole = Results { curve, episodes, actions, ..results() };
            let claim = claim(&mut store, session, &job);
            store.finish(&claim, &Outcome::Completed(whole.clone()), 1.0).unwrap();

            let points = "SELECT episode, name, value FROM curve_point
                JOIN metric_name ON metric_name.id = metric WHERE run = ?1 ORDER BY value";
            let stored: Vec<(u32, String, f64)> =
                rows(&store, points, &claim, |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)));
            let expected = whole.curve.iter().map(|p| (p.episode, p.metric.to_string(), p.value));
            assert_eq!(stored, expected.collect::<Vec<_>>(), "{count} points of each metric");
            let episodes = "SELECT total_reward, length, disengaged FROM test_episode
                WHERE run = ?1 ORDER BY episode";
            let stored = rows(&store, episodes, &claim, |row| {
                let (total_reward, length) = (row.get(0)?, row.get(1)?);
                Ok(TestEpisode { total_reward, length, terminated: row.get(2)? })
            });
            assert_eq!(stored, whole.episodes, "{count} episodes");
            let choices = "SELECT bin, context, action, count FROM action_count
                WHERE run = ?1 ORDER BY count";
            let stored = rows(&store, choices, &claim, |row| {
                let [bin, context]: [u8; 2] = [row.get(0)?, row.get(1)?];
                let stratum = Some(2 * bin + context);
                let count: i64 = row.get(3)?;
                Ok(ActionCount { stratum, action: row.get(2)?, count: count as u64 })
            });
            assert_eq!(stored, whole.actions, "{count} choices");
        }
    }

    #[test]
    fn the_end_of_a_run_waits_for_the_disk_and_its_beginning_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(&folder.path().join("jitai.sqlite")).unwrap();
        let jobs = [job(), Job { seed: 2, ..job() }];
        let session = begin_session(&mut store);
        store.connection.execute_batch(RECORD).unwrap();
        let failure =
            Failure { kind: FailureKind::Diverged, message: "it diverged".to_owned(), episode: 3 };
        let outcomes = [
            (&jobs[0], Outcome::Interrupted),
            (&jobs[0], Outcome::Completed(results())),
            (&jobs[1], Outcome::Failed(failure)),
        ];
        for (job, outcome) in &outcomes {
            let claim = claim(&mut store, session, job);
            store.finish(&claim, outcome, 1.0).unwrap();
        }
        let mut statement =
            store.connection.prepare("SELECT status, synchronous FROM recorded").unwrap();
        let recorded = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
        let recorded: Vec<(String, i64)> = recorded.collect::<Result<_, _>>().unwrap();
        let ends = ["interrupted", "completed", "failed"];
        let expected = ends.map(|end| [("running".to_owned(), NORMAL), (end.to_owned(), FULL)]);
        assert_eq!(recorded, expected.concat());
    }
}
