//! Diagnosands: what a user computes of the estimates of some trials, as an expression of SQL.
//!
//! An expression is evaluated over a table in memory, whose rows are those of the view `estimate` of one term over the trials
//! of an arm. No file is opened, and the connection permits nothing but reading that table.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use rusqlite::types::Value;
use rusqlite::{Connection, Error, ErrorCode};

use crate::job::Effect;

use super::sandbox::{MOST_STEPS, add_functions, allow_diagnosands_only, limit_steps};

/// The estimates of a term over the trials of an arm.
pub struct Diagnosed {
    connection: Connection,
    /// What its statement has used of its steps.
    used: Arc<AtomicU32>,
}

/// The most groups of trials of which each is left out once for the Monte Carlo error.
const GROUPS: i64 = 20;

/// The columns are those of the view `estimate` that differ between trials.
const TABLE: &str = "CREATE TABLE estimate (trial INTEGER PRIMARY KEY, estimate REAL, standard_error REAL,
    degrees_of_freedom REAL, low REAL, high REAL, p_value REAL, decisions INTEGER, residual_sd REAL, truth REAL,
    failure TEXT, treatment_variance REAL, effective_sample_size REAL) STRICT";

/// Why an expression is no diagnosand; `None` if it is one.
pub fn diagnosand_fault(expression: &str) -> Option<String> {
    Diagnosed::new(&[]).and_then(|none| none.value(expression, None)).err()
}

impl Diagnosed {
    /// The estimates of trials, in order; of a failed one, the reason.
    ///
    /// **Errors**: why SQLite cannot hold them.
    pub fn new(trials: &[Result<Effect, String>]) -> Result<Diagnosed, String> {
        let fill = || -> rusqlite::Result<Diagnosed> {
            let mut connection = Connection::open_in_memory()?;
            add_functions(&connection)?;
            connection.execute(TABLE, [])?;
            let mut insert = connection
                .prepare("INSERT INTO estimate VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")?;
            for (number, trial) in (1_i64..).zip(trials) {
                insert.execute(rusqlite::params_from_iter(row(number, trial)))?;
            }
            drop(insert);
            allow_diagnosands_only(&mut connection)?;
            let used = limit_steps(&mut connection)?;
            Ok(Diagnosed { connection, used })
        };
        fill().map_err(|error| error.to_string())
    }

    /// The value of an expression; NULL and texts are none. With a group, the trials of that group are left out.
    ///
    /// **Errors**: what is wrong with the expression.
    pub fn value(
        &self,
        expression: &str,
        group: Option<(i64, i64)>,
    ) -> Result<Option<f64>, String> {
        let (of, groups) = group.unwrap_or((-1, 1));
        let sql = statement(expression, (of, groups));
        self.used.store(0, Ordering::Relaxed);
        let mut statement = self.connection.prepare(&sql).map_err(|error| in_words(&error))?;
        if statement.column_count() != 1 || !statement.readonly() {
            return Err(NOT_ONE.to_owned());
        }
        let mut rows = statement.raw_query();
        let mut value = None;
        let mut count = 0;
        while let Some(row) = rows.next().map_err(|error| in_words(&error))? {
            count += 1;
            value = match row.get(0).map_err(|error| in_words(&error))? {
                Value::Integer(whole) => Some(whole as f64),
                Value::Real(real) => Some(real).filter(|real| real.is_finite()),
                Value::Null | Value::Text(_) | Value::Blob(_) => None,
            };
            if count > 1 {
                break;
            }
        }
        if count == 1 { Ok(value) } else { Err(NO_AGGREGATE.to_owned()) }
    }

    /// Whether an expression has an aggregate that is the largest or the smallest of some rows, by the program of its
    /// statement. `max(a, b)` of two numbers is no aggregate.
    ///
    /// **Errors**: what is wrong with the expression.
    pub fn has_extreme(&self, expression: &str) -> Result<bool, String> {
        let explained = format!("EXPLAIN {}", statement(expression, (-1, 1)));
        let read = || -> rusqlite::Result<bool> {
            let mut program = self.connection.prepare(&explained)?;
            let mut steps = program.raw_query();
            while let Some(step) = steps.next()? {
                let operation = step.get_ref("opcode")?.as_str().unwrap_or_default();
                let of = step.get_ref("p4")?.as_str().unwrap_or_default();
                if operation.starts_with("AggStep") && ["max(1)", "min(1)"].contains(&of) {
                    return Ok(true);
                }
            }
            Ok(false)
        };
        read().map_err(|error| in_words(&error))
    }

    /// The values of an expression without each of some groups of trials, for its Monte Carlo error; empty if one of them is
    /// none, or with fewer than two trials.
    ///
    /// **Errors**: what is wrong with the expression.
    pub fn without_each(&self, expression: &str) -> Result<Vec<f64>, String> {
        let count = "SELECT count(*) FROM estimate";
        let trials: i64 =
            self.connection.query_row(count, [], |row| row.get(0)).map_err(|one| in_words(&one))?;
        let groups = trials.min(GROUPS);
        let values = (0..groups).map(|of| self.value(expression, Some((of, groups))));
        let values = values.collect::<Result<Vec<_>, _>>()?;
        Ok(values
            .into_iter()
            .collect::<Option<Vec<f64>>>()
            .filter(|_| groups > 1)
            .unwrap_or_default())
    }
}

/// The statement of an expression, without the trials of a group.
fn statement(expression: &str, (of, groups): (i64, i64)) -> String {
    // The line break ends a comment in the expression.
    format!(
        "WITH estimate AS (SELECT * FROM main.estimate WHERE trial % {groups} <> {of})
        SELECT (\n{expression}\n) FROM estimate"
    )
}

const NOT_ONE: &str = "expected a single expression";
const NO_AGGREGATE: &str = "it has a value for each trial; expected one for all of them, as by avg(...), max(...) or count(*)";

fn row(number: i64, trial: &Result<Effect, String>) -> Vec<Value> {
    let real = |number: Option<f64>| number.map_or(Value::Null, Value::Real);
    let of = trial.as_ref().ok();
    let number_of = |value: fn(&Effect) -> f64| real(of.map(value));
    vec![
        Value::Integer(number),
        number_of(|of| of.value),
        number_of(|of| of.standard_error),
        number_of(|of| of.degrees_of_freedom),
        number_of(|of| of.low),
        number_of(|of| of.high),
        number_of(|of| of.p_value),
        of.map_or(Value::Null, |of| Value::Integer(of.decisions as i64)),
        number_of(|of| of.residual_sd),
        real(of.and_then(|of| of.truth)),
        trial.as_ref().err().map_or(Value::Null, |why| Value::Text(why.clone())),
        real(of.and_then(|of| of.treatment_variance)),
        real(of.and_then(|of| of.effective_sample_size)),
    ]
}

fn in_words(error: &Error) -> String {
    match error {
        Error::MultipleStatement => NOT_ONE.to_owned(),
        Error::SqlInputError { msg, .. } | Error::SqliteFailure(_, Some(msg))
            if msg.starts_with("not authorized") =>
        {
            match msg.strip_prefix("not authorized to use function: ") {
                Some(function) => format!(
                    "it may not use `{function}`: a diagnosand has the same value at any time"
                ),
                None => "it may only read the table `estimate`, and has no recursion".to_owned(),
            }
        }
        other if other.sqlite_error_code() == Some(ErrorCode::OperationInterrupted) => format!(
            "it takes more than {} million steps of SQLite; expected an aggregate that reads each trial a few times",
            MOST_STEPS / 1_000_000
        ),
        Error::SqlInputError { msg, .. } => msg.clone(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trials() -> Vec<Result<Effect, String>> {
        let effect = |value: f64| Effect {
            value,
            standard_error: 1.0,
            degrees_of_freedom: 10.0,
            low: value - 2.0,
            high: value + 2.0,
            p_value: 0.5,
            decisions: 100,
            residual_sd: 3.0,
            truth: Some(2.0),
            treatment_variance: Some(0.25),
            effective_sample_size: None,
        };
        let failed = Err("there are too few people".to_owned());
        [1.0, 2.0, 6.0].map(effect).map(Ok).into_iter().chain([failed]).collect()
    }

    #[test]
    fn expressions_have_the_values_of_their_rows() {
        let diagnosed = Diagnosed::new(&trials()).unwrap();
        let value = |expression: &str| diagnosed.value(expression, None).unwrap();
        for (expression, expected) in [
            ("avg(estimate)", Some(3.0)),
            ("avg(failure IS NOT NULL)", Some(0.25)),
            ("sqrt(avg((estimate - truth) * (estimate - truth)))", Some((17.0_f64 / 3.0).sqrt())),
            ("max(estimate) -- the largest", Some(6.0)),
            ("(SELECT count(*) FROM estimate WHERE low > 0) * 1.0 / count(*)", Some(0.25)),
            ("max(failure)", None),
            ("avg(effective_sample_size)", None),
        ] {
            assert_eq!(value(expression), expected, "{expression}");
        }
        assert_eq!(diagnosed.without_each("max(estimate)").unwrap(), [6.0, 6.0, 6.0, 2.0]);
        assert!(diagnosed.without_each("avg(effective_sample_size)").unwrap().is_empty());
    }

    #[test]
    fn an_extreme_is_known_by_its_aggregate() {
        let diagnosed = Diagnosed::new(&trials()).unwrap();
        for (expression, expected) in [
            ("max(abs(estimate - truth))", true),
            ("avg(estimate) - MIN ( estimate )", true),
            ("(SELECT max(low) FROM estimate)", true),
            ("avg(max(low, 0)) /* max(low) */", false),
            ("count(*) FILTER (WHERE failure LIKE 'max(low)')", false),
            ("stddev(estimate)", false),
        ] {
            assert_eq!(diagnosed.has_extreme(expression), Ok(expected), "{expression}");
        }
    }

    #[test]
    fn what_is_no_single_expression_has_a_reason() {
        for (expression, expected) in [
            ("avg(estimate", "syntax error"),
            ("avg(estimat)", "no such column: estimat"),
            ("", "syntax error"),
            ("estimate", "it has a value for each trial"),
            ("1", "it has a value for each trial"),
            ("avg(low), avg(high)", "row value misused"),
            ("avg(low)) FROM estimate; SELECT (1", "expected a single expression"),
            ("avg(low)), (avg(high)", "expected a single expression"),
            ("avg(low)) FROM estimate; DELETE FROM estimate WHERE (1", "syntax error"),
            ("(SELECT sum(estimate) FROM other)", "no such table: other"),
        ] {
            let why = diagnosand_fault(expression).unwrap_or_default();
            assert!(why.contains(expected), "{expression}: {why}");
        }
        assert_eq!(diagnosand_fault("avg(estimate)"), None);
    }

    #[test]
    fn a_diagnosand_ends_and_is_the_same_at_any_time() {
        let endless = "(WITH RECURSIVE t(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM t) SELECT sum(x) FROM t)";
        for (expression, expected) in [
            (endless, "has no recursion"),
            ("avg(random())", "it may not use `random`"),
            ("max(length(RandomBlob(9)))", "it may not use `RandomBlob`"),
            ("max(julianday('now'))", "it may not use `julianday`"),
            ("max(current_timestamp)", "it may not use `current_timestamp`"),
        ] {
            let why = diagnosand_fault(expression).unwrap_or_default();
            assert!(why.to_lowercase().contains(&expected.to_lowercase()), "{expression}: {why}");
        }
        let many = Diagnosed::new(&(0..100).flat_map(|_| trials()).collect::<Vec<_>>()).unwrap();
        let pairs = "(SELECT count(*) FROM estimate a, estimate b, estimate c, estimate d WHERE a.low < d.low)";
        let why = many.value(&format!("max({pairs})"), None).unwrap_err();
        assert!(why.contains("more than 100 million steps"), "{why}");
        // The next one has its own steps.
        assert_eq!(many.value("avg(estimate)", None), Ok(Some(3.0)));
    }
}
