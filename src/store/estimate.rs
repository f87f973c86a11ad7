//! Estimates as rows: what a completed run has of the estimates that manifests declare.
//!
//! A declaration is a row of its own, which equal declarations share. Estimates are no part of a run's digest;
//! each row has a digest of itself, its job and its declaration instead.

use std::collections::HashMap;
use std::sync::Arc;

use rusqlite::types::Value;
use rusqlite::{Connection, OptionalExtension};

use crate::job::{Effect, Estimate, EstimateDeclaration, Estimates, JobKey, counted};

use super::digest::ResultsDigest;
use super::read::completed_run;
use super::schema::{has_column, has_table};
use super::writer::Store;
use super::{Reader, StoreError};

/// The columns of a row besides run, declaration and digest.
const COLUMNS: usize = 12;

/// A row of another store: the canonical text of the declaration, its columns, its digest, and the variance of its
/// treatment and its effective sample size, which rows of earlier versions lack.
pub(super) type Row = [Value; COLUMNS + 4];

/// The rows of run `?1` in order.
fn select(connection: &Connection) -> rusqlite::Result<String> {
    let known = |column: &'static str| -> rusqlite::Result<&str> {
        Ok(if has_column(connection, "recorded_estimate", column)? { column } else { "NULL" })
    };
    let (variance, size) = (known("treatment_variance")?, known("effective_sample_size")?);
    Ok(format!(
        "SELECT canonical, number, term, estimate, standard_error, degrees_of_freedom, low, high, p_value, decisions,
            residual_sd, truth, failure, sha256, {variance}, {size}
         FROM recorded_estimate AS recorded
         JOIN estimate_declaration AS declared ON declared.id = recorded.declaration
         WHERE run = ?1 ORDER BY canonical, number"
    ))
}

/// Whether the file has the tables, which stores of earlier versions lack.
pub(super) fn are_known(connection: &Connection) -> rusqlite::Result<bool> {
    has_table(connection, "recorded_estimate")
}

/// Inserts the estimates of a completed run of the job with this key, except those that the run has.
pub(super) fn insert(
    connection: &Connection,
    (run, job_key): (i64, &str),
    estimates: &[Estimates],
) -> rusqlite::Result<()> {
    let rows = estimates.iter().flat_map(|estimates| rows_of(job_key, estimates));
    insert_copied(connection, run, &rows.collect::<Vec<_>>()).map(drop)
}

fn rows_of<'e>(job_key: &'e str, estimates: &'e Estimates) -> impl Iterator<Item = Row> + 'e {
    let canonical = estimates.declaration.canonical();
    (1_i64..).zip(&estimates.terms).map(move |(number, Estimate { term, effect })| {
        let effect = effect.as_ref().map_err(Clone::clone);
        let effect = effect.and_then(|of| of.unusable_number().map_or(Ok(of), Err));
        let numbers = match &effect {
            Ok(of) => {
                let [value, error, freedom, low, high, p_value, sd] = [
                    of.value,
                    of.standard_error,
                    of.degrees_of_freedom,
                    of.low,
                    of.high,
                    of.p_value,
                    of.residual_sd,
                ]
                .map(Value::Real);
                let decisions = Value::Integer(of.decisions as i64);
                let real = |number: Option<f64>| number.map_or(Value::Null, Value::Real);
                let (truth, variance) = (real(of.truth), real(of.treatment_variance));
                let size = real(of.effective_sample_size);
                [value, error, freedom, low, high, p_value, decisions, sd, truth, variance, size]
            }
            Err(_) => [const { Value::Null }; 11],
        };
        let [value, error, freedom, low, high, p_value, decisions, sd, truth, variance, size] =
            numbers;
        let failure = effect.err().map_or(Value::Null, Value::Text);
        let (canonical, term) = (Value::Text(canonical.clone()), Value::Text(term.clone()));
        let mut row = [
            canonical,
            number.into(),
            term,
            value,
            error,
            freedom,
            low,
            high,
            p_value,
            decisions,
            sd,
            truth,
            failure,
            Value::Null,
            variance,
            size,
        ];
        row[COLUMNS + 1] = Value::Blob(digest(job_key, &row).into());
        row
    })
}

/// The digest of a row of a job.
fn digest(job_key: &str, row: &Row) -> [u8; 32] {
    let mut digest = ResultsDigest::new(job_key);
    row[..=COLUMNS].iter().for_each(|value| digest.add(value.into()));
    // Rows of earlier versions keep their digest.
    let later = &row[COLUMNS + 2..];
    let last = later.iter().rposition(|value| *value != Value::Null);
    later.iter().take(last.map_or(0, |last| last + 1)).for_each(|value| digest.add(value.into()));
    digest.finish()
}

/// Inserts rows as estimates of the completed run `own`, unless the run has an estimate of the declaration; returns
/// their number.
///
/// **Errors**: the file rejects a row.
pub(super) fn insert_copied(
    connection: &Connection,
    own: i64,
    rows: &[Row],
) -> rusqlite::Result<usize> {
    let mut inserted = 0;
    for rows in rows.chunk_by(|one, next| one[0] == next[0]) {
        let declaration = declaration_id(connection, &rows[0][0])?;
        let known = "SELECT 1 FROM recorded_estimate WHERE run = ?1 AND declaration = ?2";
        if connection.prepare_cached(known)?.exists([own, declaration])? {
            continue;
        }
        let marks = ["?"; COLUMNS + 5].join(", ");
        let mut insert = connection
            .prepare_cached(&format!("INSERT INTO recorded_estimate VALUES ({marks})"))?;
        for row in rows {
            let head = [own.into(), declaration.into()];
            insert.execute(rusqlite::params_from_iter(head.iter().chain(&row[1..])))?;
            inserted += 1;
        }
    }
    Ok(inserted)
}

/// The row id of a declaration; a new one is added.
fn declaration_id(connection: &Connection, canonical: &Value) -> rusqlite::Result<i64> {
    let found = connection
        .prepare_cached("SELECT id FROM estimate_declaration WHERE canonical = ?1")?
        .query_row([canonical], |row| row.get(0))
        .optional()?;
    let insert = "INSERT INTO estimate_declaration (canonical) VALUES (?1)";
    found.map_or_else(|| connection.prepare_cached(insert)?.insert([canonical]), Ok)
}

/// The rows of a run of the job with this key. An estimate of which a row is damaged or missing is left out.
pub(super) fn intact(
    connection: &Connection,
    run: i64,
    job_key: &str,
) -> rusqlite::Result<Vec<Row>> {
    if !are_known(connection)? {
        return Ok(Vec::new());
    }
    let mut statement = connection.prepare_cached(&select(connection)?)?;
    let rows = statement.query_map([run], |row| {
        let mut values = [const { Value::Null }; COLUMNS + 4];
        for (column, value) in values.iter_mut().enumerate() {
            *value = row.get(column)?;
        }
        Ok(values)
    })?;
    let rows = rows.collect::<rusqlite::Result<Vec<Row>>>()?;
    let estimates = rows.chunk_by(|one, next| one[0] == next[0]);
    let is_intact = |rows: &&[Row]| {
        (1_i64..).zip(*rows).all(|(number, row)| {
            row[1] == Value::Integer(number)
                && row[COLUMNS + 1] == Value::Blob(digest(job_key, row).into())
        })
    };
    Ok(estimates.filter(is_intact).flatten().cloned().collect())
}

/// Whether a row of a run of the job with this key does not match its digest.
pub(super) fn is_damaged(
    connection: &Connection,
    run: i64,
    job_key: &str,
) -> rusqlite::Result<bool> {
    if !are_known(connection)? {
        return Ok(false);
    }
    let count = "SELECT count(*) FROM recorded_estimate WHERE run = ?1";
    let count: usize = connection.prepare_cached(count)?.query_row([run], |row| row.get(0))?;
    Ok(intact(connection, run, job_key)?.len() != count)
}

/// The estimates of a run. `known` keeps the declarations that were read before.
pub(super) fn of_run(
    connection: &Connection,
    run: i64,
    known: &mut HashMap<String, Arc<EstimateDeclaration>>,
) -> rusqlite::Result<Vec<Estimates>> {
    if !are_known(connection)? {
        return Ok(Vec::new());
    }
    let mut statement = connection.prepare_cached(&select(connection)?)?;
    let mut rows = statement.query([run])?;
    let mut all: Vec<(String, Estimates)> = Vec::new();
    while let Some(row) = rows.next()? {
        let canonical: String = row.get(0)?;
        let effect = match row.get(12)? {
            Some(failure) => Err(failure),
            None => Ok(Effect {
                value: row.get(3)?,
                standard_error: row.get(4)?,
                degrees_of_freedom: row.get(5)?,
                low: row.get(6)?,
                high: row.get(7)?,
                p_value: row.get(8)?,
                decisions: row.get(9)?,
                residual_sd: row.get(10)?,
                truth: row.get(11)?,
                treatment_variance: row.get(14)?,
                effective_sample_size: row.get(15)?,
            }),
        };
        let estimate = Estimate { term: row.get(2)?, effect };
        if let Some((_, last)) = all.last_mut().filter(|(last, _)| *last == canonical) {
            last.terms.push(estimate);
            continue;
        }
        let declaration = match known.get(&canonical) {
            Some(declaration) => declaration.clone(),
            // No manifest of this version can ask for a declaration of a later one, which `doctor` reports.
            None => match EstimateDeclaration::from_canonical(&canonical) {
                Ok(declaration) => {
                    let declaration = Arc::new(declaration);
                    known.insert(canonical.clone(), declaration.clone());
                    declaration
                }
                Err(_) => continue,
            },
        };
        all.push((canonical, Estimates { declaration, terms: vec![estimate] }));
    }
    Ok(all.into_iter().map(|(_, estimates)| estimates).collect())
}

/// The declarations that cannot be read, each with the reason.
pub(super) fn unread_declarations(connection: &Connection) -> rusqlite::Result<Vec<String>> {
    if !are_known(connection)? {
        return Ok(Vec::new());
    }
    let mut statement = connection.prepare("SELECT canonical FROM estimate_declaration")?;
    let texts = statement.query_map([], |row| row.get::<_, String>(0))?;
    let unread = |text: String| {
        let why = EstimateDeclaration::from_canonical(&text).err()?;
        Some(format!("{text} is damaged, or of a newer release of jitai: {why}"))
    };
    texts.filter_map(|text| text.map(unread).transpose()).collect()
}

/// Estimates of an experiment that could not be computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FailedEstimates {
    /// The number of jobs with such an estimate.
    pub jobs: u64,
    /// The name of the first one.
    pub name: String,
    /// Why it could not be computed.
    pub reason: String,
}

impl FailedEstimates {
    /// The number of jobs and the first reason, in words.
    pub fn described(&self) -> String {
        let FailedEstimates { jobs, name, reason } = self;
        format!(
            "estimates of {} failed, the first, `{name}`, because {reason}",
            counted(*jobs, "completed job")
        )
    }
}

impl Reader {
    /// The failed estimates of an experiment that its manifest declares; `None` if none failed.
    pub fn failed_estimates(
        &self,
        experiment: &str,
    ) -> Result<Option<FailedEstimates>, StoreError> {
        // The views of earlier versions do not know which estimates a manifest declares.
        if !self.has_column("estimate", "experiment")? {
            return Ok(None);
        }
        self.read("read estimates", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT count(DISTINCT job_key), name, failure FROM estimate
                 WHERE experiment = ?1 AND failure IS NOT NULL",
            )?;
            let row = statement.query_row([experiment], |row| {
                let jobs = row.get(0)?;
                if jobs == 0 {
                    return Ok(None);
                }
                Ok(Some(FailedEstimates { jobs, name: row.get(1)?, reason: row.get(2)? }))
            })?;
            Ok(row)
        })
    }

    /// The declarations of which the completed run of a job has no estimate. A job without a completed run lacks all.
    pub fn lacking_estimates(
        &self,
        key: &JobKey,
        wanted: &[Arc<EstimateDeclaration>],
    ) -> Result<Vec<Arc<EstimateDeclaration>>, StoreError> {
        self.read("read estimates", |connection| {
            if wanted.is_empty() || !are_known(connection)? {
                return Ok(wanted.to_vec());
            }
            let run = completed_run(connection, &key.to_string())?;
            let mut has = connection.prepare_cached(
                "SELECT 1 FROM recorded_estimate WHERE run = ?1
                    AND declaration = (SELECT id FROM estimate_declaration WHERE canonical = ?2)",
            )?;
            let mut lacking = Vec::new();
            for declaration in wanted {
                if !has.exists((run, declaration.canonical()))? {
                    lacking.push(declaration.clone());
                }
            }
            Ok(lacking)
        })
    }
}

/// The result of adding estimates to a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Added {
    /// The job has them.
    Stored,
    /// The results of the job's run have another digest; nothing was added.
    Differing,
    /// The job has no completed run; nothing was added.
    NotCompleted,
}

impl Store {
    /// Adds estimates to the completed runs of jobs, except those that they have. A digest must be that of the run's
    /// results.
    pub fn add_estimates<'e>(
        &mut self,
        jobs: impl Iterator<Item = (&'e JobKey, &'e [Estimates], Option<[u8; 32]>)>,
    ) -> Result<Vec<Added>, StoreError> {
        self.write_durably("store estimates", |transaction| {
            let mut added = Vec::new();
            for (key, estimates, digest) in jobs {
                let key = key.to_string();
                let found: Option<(i64, [u8; 32])> = transaction
                    .prepare_cached(
                        "SELECT run.id, results_sha256 FROM job
                         JOIN run ON run.job = job.id AND run.status = 'completed' WHERE job.key = ?1",
                    )?
                    .query_row([&key], |row| Ok((row.get(0)?, row.get(1)?)))
                    .optional()?;
                added.push(match found {
                    None => Added::NotCompleted,
                    Some((_, stored)) if digest.is_some_and(|digest| digest != stored) => {
                        Added::Differing
                    }
                    Some((run, _)) => {
                        insert(transaction, (run, &key), estimates)?;
                        Added::Stored
                    }
                });
            }
            Ok(added)
        })
    }
}
