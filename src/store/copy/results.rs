//! The rows of a run's results during a copy between stores: read, hashed and inserted.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use rusqlite::types::Value;
use rusqlite::{CachedStatement, Connection};

use crate::job::MetricName;
use crate::store::digest::{DigestForm, ResultsDigest};
use crate::store::results::metric_id;
use crate::store::tables::{ROWS, ResultTable, Statements, digested};

use super::sql::{Written, read_rows, read_values, written};

/// The size of a row in the accounting of batches, in bytes.
const BYTES_PER_ROW: usize = 32;

static NONE: Vec<Value> = Vec::new();

/// The results of a run: the values of all rows of each table in sequence, in the order of [`digested`].
pub(super) struct ResultRows {
    tables: Vec<Vec<Value>>,
    metrics: Arc<MetricNames>,
}

impl ResultRows {
    /// Reads the results of run `run` of the source; `None` if a row cannot be read.
    pub(super) fn read(
        from: &Connection,
        metrics: &Arc<MetricNames>,
        run: i64,
    ) -> Option<ResultRows> {
        let read =
            |(table, statements): (&ResultTable, &Statements)| match table.is_in(from).ok()? {
                true => read_values(from, &statements.select, run),
                false => Some(Vec::new()),
            };
        let tables = digested().map(read).collect::<Option<_>>()?;
        Some(ResultRows { tables, metrics: metrics.clone() })
    }

    /// The digest of these results for the job with this key, equal to [`crate::store::digest::of_run_in`]; `None` if the
    /// name of a metric cannot be read.
    pub(super) fn digest_in(&self, job_key: &str, form: DigestForm) -> Option<[u8; 32]> {
        self.digest_of(job_key, form, |_| true)
    }

    /// Whether the results equal those of another run of the job, apart from the rows of optional tables that only one of
    /// the two has.
    pub(super) fn are_the_same_but_for_records(&self, other: &ResultRows) -> bool {
        let shared: Vec<bool> = digested()
            .zip(self.tables.iter().zip(&other.tables))
            .map(|((table, _), (ours, theirs))| {
                !table.is_optional || ours.is_empty() == theirs.is_empty()
            })
            .collect();
        let digest =
            |rows: &ResultRows| rows.digest_of("", DigestForm::Whole, |table| shared[table]);
        digest(self).is_some_and(|ours| digest(other) == Some(ours))
    }

    /// The digest of the rows of the tables that `holds` permits, given their indices.
    fn digest_of(
        &self,
        job_key: &str,
        form: DigestForm,
        holds: impl Fn(usize) -> bool,
    ) -> Option<[u8; 32]> {
        let mut digest = ResultsDigest::new(job_key);
        for (index, ((table, _), values)) in digested().zip(&self.tables).enumerate() {
            if !digest.begin(table, form) {
                continue;
            }
            let values = if holds(index) { values } else { &NONE };
            if !table.is_by_metric {
                values.iter().for_each(|value| digest.add(value.into()));
                continue;
            }
            for (name, rows) in self.by_name(values, table.width())? {
                for row in values[rows].chunks(table.width()) {
                    digest.add(name.into());
                    row[1..].iter().for_each(|value| digest.add(value.into()));
                }
            }
        }
        Some(digest.finish())
    }

    /// The names of the rows' metrics in alphabetical order, each with the range of its values.
    fn by_name(&self, values: &[Value], columns: usize) -> Option<Vec<(&str, Range<usize>)>> {
        let mut found: Vec<(&str, Range<usize>)> = Vec::new();
        let mut last = None;
        for (row, start) in values.chunks(columns).zip((0..).step_by(columns)) {
            let Value::Integer(metric) = row[0] else { return None };
            let end = start + columns;
            match found.last_mut().filter(|_| last == Some(metric)) {
                Some((_, rows)) => rows.end = end,
                None => found.push((self.metrics.0.get(&metric)?, start..end)),
            }
            last = Some(metric);
        }
        found.sort_by_key(|(name, _)| *name);
        Some(found)
    }

    /// The size of the results in the accounting of batches, in bytes.
    pub(super) fn bytes(&self) -> usize {
        let rows = digested().zip(&self.tables);
        let rows: usize = rows.map(|((table, _), values)| values.len() / table.width()).sum();
        let bytes = self.tables.iter().flatten().map(|value| match value {
            Value::Blob(bytes) => bytes.len(),
            Value::Text(text) => text.len(),
            Value::Real(_) => size_of::<f64>(),
            Value::Null | Value::Integer(_) => 0,
        });
        rows * BYTES_PER_ROW + bytes.sum::<usize>()
    }

    /// Inserts the results as results of run `own` of the target. `metrics` maps the source's
    /// metrics to the target's ids as far as they are known; missing ones are added.
    pub(super) fn insert(
        &self,
        target: &Connection,
        own: i64,
        metrics: &mut HashMap<i64, i64>,
    ) -> rusqlite::Result<Written> {
        for ((table, statements), values) in digested().zip(&self.tables) {
            if values.is_empty() {
                continue;
            }
            if table.is_by_metric
                && let Written::Refused = self.add_metrics(target, values, table, metrics)?
            {
                return Ok(Written::Refused);
            }
            let metrics = table.is_by_metric.then_some(&*metrics);
            let inserted = insert_rows(target, table, statements, own, values, metrics);
            if let Written::Refused = written(inserted)? {
                return Ok(Written::Refused);
            }
        }
        Ok(Written::Yes)
    }

    /// Adds the metrics of all rows to `metrics`.
    fn add_metrics(
        &self,
        target: &Connection,
        values: &[Value],
        table: &ResultTable,
        metrics: &mut HashMap<i64, i64>,
    ) -> rusqlite::Result<Written> {
        for row in values.chunks(table.width()) {
            let Value::Integer(metric) = row[0] else { return Ok(Written::Refused) };
            if metrics.contains_key(&metric) {
                continue;
            }
            let Some(name) = self.metrics.0.get(&metric) else { return Ok(Written::Refused) };
            let mut own = None;
            let found = metric_id(target, name).map(|id| own = Some(id));
            match (written(found)?, own) {
                (Written::Yes, Some(own)) => metrics.insert(metric, own),
                (Written::Refused, _) | (_, None) => return Ok(Written::Refused),
            };
        }
        Ok(Written::Yes)
    }
}

/// Inserts the rows of a table: [`ROWS`] per statement, and the remaining rows one by one.
fn insert_rows(
    target: &Connection,
    table: &ResultTable,
    statements: &Statements,
    own: i64,
    values: &[Value],
    metrics: Option<&HashMap<i64, i64>>,
) -> rusqlite::Result<()> {
    let columns = table.width();
    let bind = |statement: &mut CachedStatement<'_>, rows: &[Value]| -> rusqlite::Result<()> {
        let mut index = 1;
        for row in rows.chunks(columns) {
            let (first, named) = table.first_of(own, &row[0]);
            statement.raw_bind_parameter(index, first)?;
            for (column, value) in row.iter().enumerate().skip(named) {
                index += 1;
                match (column, value, metrics) {
                    (0, Value::Integer(metric), Some(metrics)) => {
                        statement.raw_bind_parameter(index, metrics.get(metric))?;
                    }
                    _ => statement.raw_bind_parameter(index, value)?,
                }
            }
            index += 1;
        }
        statement.raw_execute().map(drop)
    };
    let (many, rest) = values.split_at(values.len() - values.len() % (ROWS * columns));
    if !many.is_empty() {
        let mut statement = target.prepare_cached(&statements.insert_many)?;
        many.chunks(ROWS * columns).try_for_each(|rows| bind(&mut statement, rows))?;
    }
    if !rest.is_empty() {
        let mut statement = target.prepare_cached(&statements.insert_one)?;
        rest.chunks(columns).try_for_each(|row| bind(&mut statement, row))?;
    }
    Ok(())
}

/// The names of the source's metrics by row id.
pub(super) struct MetricNames(HashMap<i64, String>);

impl MetricNames {
    /// Reads the names. They are stored in both the table and its index. If a damaged store has two names for
    /// one id, a name that this program uses takes precedence.
    pub(super) fn read(from: &Connection) -> MetricNames {
        let mut names: HashMap<i64, String> = HashMap::new();
        for sql in [
            "SELECT id, name FROM metric_name NOT INDEXED",
            "SELECT id, name FROM metric_name ORDER BY name",
        ] {
            for row in read_rows(from, sql, &[]).unwrap_or_default() {
                let [Value::Integer(id), Value::Text(name)] = row else { continue };
                if names.get(&id).is_none_or(|earlier| MetricName::named(earlier).is_none()) {
                    names.insert(id, name);
                }
            }
        }
        MetricNames(names)
    }
}
