//! The rows of a run's results during a copy between stores: read, hashed and inserted.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, LazyLock};

use rusqlite::types::Value;
use rusqlite::{CachedStatement, Connection};

use crate::job::MetricName;
use crate::store::digest::{Form, ResultsDigest};
use crate::store::results::metric_id;
use crate::store::schema::has_table;
use crate::store::{choice, decision, episode_ending, family, participant, posterior};

use super::sql::{Written, read_rows, read_values, written};

/// A table of results.
struct ResultTable {
    name: &'static str,
    /// The columns besides the run, starting with the rest of the key.
    columns: &'static [&'static str],
    /// The number of these columns that belong to the key.
    in_key: usize,
    /// Whether the first column is a metric, whose id differs between stores.
    by_metric: bool,
}

impl ResultTable {
    const fn new(name: &'static str, columns: &'static [&'static str], in_key: usize) -> Self {
        ResultTable { name, columns, in_key, by_metric: false }
    }

    const fn by_metric(self) -> Self {
        ResultTable { by_metric: true, ..self }
    }
}

/// All tables of results, in the order of the digest.
const TABLES: [ResultTable; 5] = [
    ResultTable::new("run_metric", &["metric", "value"], 1).by_metric(),
    ResultTable::new("curve_point", &["metric", "episode", "value"], 2).by_metric(),
    ResultTable::new("test_episode", &["episode", "total_reward", "length", "disengaged"], 1),
    ResultTable::new("action_count", &["bin", "context", "action", "count"], 3),
    ResultTable::new("trained_weights", &["safetensors"], 0),
];

/// The tables of [`family`].
const OF_FAMILIES: [ResultTable; 3] = {
    let [one, other, last] = family::TABLES;
    [
        ResultTable::new(one.0, one.1, one.2),
        ResultTable::new(other.0, other.1, other.2),
        ResultTable::new(last.0, last.1, last.2),
    ]
};

/// The place of the steps in [`OF_FAMILIES`].
const STEPS: usize = 1;

static NONE: Vec<Value> = Vec::new();

/// The number of rows that one statement inserts. More rows are hardly faster.
const ROWS: usize = 32;

/// The size of a row in the accounting of batches, in bytes.
const BYTES_PER_ROW: usize = 32;

/// The size of a number of a recorded decision in the accounting of batches, in bytes.
const BYTES_PER_NUMBER: usize = 8;

/// The statements of a table.
struct Statements {
    select: String,
    insert_one: String,
    insert_many: String,
}

/// The statements of [`TABLES`] and [`OF_FAMILIES`].
static STATEMENTS: LazyLock<Vec<Statements>> =
    LazyLock::new(|| TABLES.iter().chain(&OF_FAMILIES).map(Statements::of).collect());

impl Statements {
    fn of(table: &ResultTable) -> Statements {
        let ResultTable { name, columns, in_key, .. } = table;
        let names = columns.join(", ");
        let order = match in_key {
            0 => String::new(),
            _ => format!(" ORDER BY {}", columns[..*in_key].join(", ")),
        };
        let row = format!("({})", vec!["?"; 1 + columns.len()].join(", "));
        let insert = |rows: usize| {
            let rows = vec![row.as_str(); rows].join(", ");
            format!("INSERT INTO {name} (run, {names}) VALUES {rows}")
        };
        Statements {
            select: format!("SELECT {names} FROM {name} WHERE run = ?1{order}"),
            insert_one: insert(1),
            insert_many: insert(ROWS),
        }
    }
}

/// The results of a run: for each of [`TABLES`], the values of all rows in sequence.
pub(super) struct ResultRows {
    tables: Vec<Vec<Value>>,
    /// Recorded decisions, whose row ids include the run.
    decisions: Vec<Value>,
    /// Parameters of participants, whose row ids also include the run.
    participants: Vec<Value>,
    /// Recorded choices, likewise.
    choices: Vec<Value>,
    /// The endings of recorded training episodes, likewise.
    endings: Vec<Value>,
    /// The rows of each of [`OF_FAMILIES`].
    of_family: [Vec<Value>; OF_FAMILIES.len()],
    /// Posteriors at the updates of a trial.
    posteriors: Vec<Value>,
    metrics: Arc<MetricNames>,
}

impl ResultRows {
    /// Reads the results of run `run` of the source; `None` if a row cannot be read.
    pub(super) fn read(
        from: &Connection,
        metrics: &Arc<MetricNames>,
        run: i64,
    ) -> Option<ResultRows> {
        let table = |statements: &Statements| read_values(from, &statements.select, run);
        let (of_all, of_others) = STATEMENTS.split_at(TABLES.len());
        let tables = of_all.iter().map(table).collect::<Option<_>>()?;
        let decisions = match decision::are_known(from).ok()? {
            true => read_values(from, &decision::SELECT, run)?,
            false => Vec::new(),
        };
        let participants = match participant::are_known(from).ok()? {
            true => read_values(from, participant::SELECT, run)?,
            false => Vec::new(),
        };
        let choices = match choice::are_known(from).ok()? {
            true => read_values(from, choice::SELECT, run)?,
            false => Vec::new(),
        };
        let endings = match episode_ending::are_known(from).ok()? {
            true => read_values(from, episode_ending::SELECT, run)?,
            false => Vec::new(),
        };
        let mut of_family = [const { Vec::new() }; OF_FAMILIES.len()];
        for ((place, statements), of) in of_family.iter_mut().zip(of_others).zip(&OF_FAMILIES) {
            // Stores of earlier versions lack these tables.
            if has_table(from, of.name).ok()? {
                *place = table(statements)?;
            }
        }
        let posteriors = match posterior::are_known(from).ok()? {
            true => read_values(from, posterior::SELECT, run)?,
            false => Vec::new(),
        };
        let metrics = metrics.clone();
        Some(ResultRows {
            tables,
            decisions,
            participants,
            choices,
            endings,
            of_family,
            posteriors,
            metrics,
        })
    }

    /// The digest of these results for the job with this key, equal to [`crate::store::digest::of_run`] in the whole
    /// form; `None` if the name of a metric cannot be read.
    pub(super) fn digest_in(&self, job_key: &str, form: Form) -> Option<[u8; 32]> {
        let mut of_family = self.of_family.each_ref();
        if form == Form::WithoutSteps {
            of_family = [&NONE; OF_FAMILIES.len()];
        }
        let recorded = [&self.decisions, &self.participants, &self.choices, &self.endings];
        self.digest_of(job_key, recorded, of_family)
    }

    /// Whether the results equal those of another run of the job, apart from what only one of the two has recorded,
    /// because an earlier release made or copied it: choices, endings, or steps.
    pub(super) fn are_the_same_but_for_records(&self, other: &ResultRows) -> bool {
        let is_shared =
            |of: fn(&ResultRows) -> &Vec<Value>| of(self).is_empty() == of(other).is_empty();
        let same_choices = is_shared(|rows| &rows.choices);
        let same_endings = is_shared(|rows| &rows.endings);
        let same_steps = is_shared(|rows| &rows.of_family[STEPS]);
        let digest = |rows: &ResultRows| {
            let choices = if same_choices { &rows.choices } else { &NONE };
            let endings = if same_endings { &rows.endings } else { &NONE };
            let mut of_family = rows.of_family.each_ref();
            if !same_steps {
                of_family[STEPS] = &NONE;
            }
            let recorded = [&rows.decisions, &rows.participants, choices, endings];
            rows.digest_of("", recorded, of_family)
        };
        digest(self).is_some_and(|ours| digest(other) == Some(ours))
    }

    fn digest_of(
        &self,
        job_key: &str,
        recorded: [&Vec<Value>; 4],
        of_family: [&Vec<Value>; OF_FAMILIES.len()],
    ) -> Option<[u8; 32]> {
        let mut digest = ResultsDigest::new(job_key);
        for (table, values) in TABLES.iter().zip(&self.tables) {
            digest.begin_table();
            if !table.by_metric {
                values.iter().for_each(|value| digest.add(value.into()));
                continue;
            }
            for (name, rows) in self.by_name(values, table.columns.len())? {
                for row in values[rows].chunks(table.columns.len()) {
                    digest.add(name.into());
                    row[1..].iter().for_each(|value| digest.add(value.into()));
                }
            }
        }
        let recorded = recorded.into_iter().chain(of_family).chain([&self.posteriors]);
        recorded.flatten().for_each(|value| digest.add(value.into()));
        Some(digest.finish())
    }

    /// The names of the rows' metrics in alphabetical order, each with the range of its values.
    fn by_name(&self, values: &[Value], columns: usize) -> Option<Vec<(&str, Range<usize>)>> {
        let mut found: Vec<(&str, Range<usize>)> = Vec::new();
        let mut last = None;
        for (row, place) in values.chunks(columns).zip((0..).step_by(columns)) {
            let Value::Integer(metric) = row[0] else { return None };
            let end = place + columns;
            match found.last_mut().filter(|_| last == Some(metric)) {
                Some((_, rows)) => rows.end = end,
                None => found.push((self.metrics.0.get(&metric)?, place..end)),
            }
            last = Some(metric);
        }
        found.sort_by_key(|(name, _)| *name);
        Some(found)
    }

    /// The size of the results in the accounting of batches, in bytes.
    pub(super) fn bytes(&self) -> usize {
        let rows = TABLES.iter().zip(&self.tables);
        let rows: usize = rows.map(|(table, values)| values.len() / table.columns.len()).sum();
        let decisions = (self.decisions.len() + self.participants.len()) * BYTES_PER_NUMBER;
        let recorded = [&self.choices, &self.endings, &self.posteriors];
        let values = self.tables.iter().chain(&self.of_family).chain(recorded).flatten();
        let blobs = values.map(|value| match value {
            Value::Blob(bytes) => bytes.len(),
            Value::Text(text) => text.len(),
            Value::Null | Value::Integer(_) | Value::Real(_) => 0,
        });
        rows * BYTES_PER_ROW + decisions + blobs.sum::<usize>()
    }

    /// Inserts the results as results of run `own` of the target. `metrics` maps the source's
    /// metrics to the target's ids as far as they are known; missing ones are added.
    pub(super) fn insert(
        &self,
        target: &Connection,
        own: i64,
        metrics: &mut HashMap<i64, i64>,
    ) -> rusqlite::Result<Written> {
        let of_family = OF_FAMILIES.iter().zip(&self.of_family);
        let tables = TABLES.iter().zip(&self.tables).chain(of_family);
        for ((table, values), statements) in tables.zip(&*STATEMENTS) {
            if values.is_empty() {
                continue;
            }
            if table.by_metric
                && let Written::Refused = self.add_metrics(target, values, table, metrics)?
            {
                return Ok(Written::Refused);
            }
            let metrics = table.by_metric.then_some(&*metrics);
            let inserted = insert_rows(target, table, statements, own, values, metrics);
            if let Written::Refused = written(inserted)? {
                return Ok(Written::Refused);
            }
        }
        written(
            decision::insert_copied(target, own, &self.decisions)
                .and_then(|()| participant::insert_copied(target, own, &self.participants))
                .and_then(|()| choice::insert_copied(target, own, &self.choices))
                .and_then(|()| episode_ending::insert_copied(target, own, &self.endings))
                .and_then(|()| posterior::insert_copied(target, own, &self.posteriors)),
        )
    }

    /// Adds the metrics of all rows to `metrics`.
    fn add_metrics(
        &self,
        target: &Connection,
        values: &[Value],
        table: &ResultTable,
        metrics: &mut HashMap<i64, i64>,
    ) -> rusqlite::Result<Written> {
        for row in values.chunks(table.columns.len()) {
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
    let columns = table.columns.len();
    let bind = |statement: &mut CachedStatement<'_>, rows: &[Value]| -> rusqlite::Result<()> {
        let mut place = 1;
        for row in rows.chunks(columns) {
            statement.raw_bind_parameter(place, own)?;
            for (column, value) in row.iter().enumerate() {
                place += 1;
                match (column, value, metrics) {
                    (0, Value::Integer(metric), Some(metrics)) => {
                        statement.raw_bind_parameter(place, metrics.get(metric))?;
                    }
                    _ => statement.raw_bind_parameter(place, value)?,
                }
            }
            place += 1;
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
