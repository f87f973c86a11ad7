//! Diagnosands: what a user computes of the estimates of some trials, as an expression of SQL.
//!
//! An expression is evaluated over a table in memory, whose rows are those of the view `estimate` of one term over the trials
//! of an arm. No file is opened, and the connection permits nothing but reading that table.

use rusqlite::types::Value;
use rusqlite::{Connection, Error};

use crate::job::Effect;

use super::sandbox::{add_functions, allow_reading_only};

/// The estimates of a term over the trials of an arm.
pub struct Diagnosed(Connection);

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
        let fill = || -> rusqlite::Result<Connection> {
            let mut connection = Connection::open_in_memory()?;
            add_functions(&connection)?;
            connection.execute(TABLE, [])?;
            let mut insert = connection
                .prepare("INSERT INTO estimate VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")?;
            for (number, trial) in (1_i64..).zip(trials) {
                insert.execute(rusqlite::params_from_iter(row(number, trial)))?;
            }
            drop(insert);
            allow_reading_only(&mut connection)?;
            Ok(connection)
        };
        fill().map(Diagnosed).map_err(|error| error.to_string())
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
        // The line break ends a comment in the expression.
        let sql = format!(
            "WITH estimate AS (SELECT * FROM main.estimate WHERE trial % {groups} <> {of})
            SELECT (\n{expression}\n) FROM estimate"
        );
        let mut statement = self.0.prepare(&sql).map_err(|error| in_words(&error))?;
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

    /// The values of an expression without each of some groups of trials, for its Monte Carlo error; empty if one of them is
    /// none, or with fewer than two trials.
    ///
    /// **Errors**: what is wrong with the expression.
    pub fn without_each(&self, expression: &str) -> Result<Vec<f64>, String> {
        let count = "SELECT count(*) FROM estimate";
        let trials: i64 =
            self.0.query_row(count, [], |row| row.get(0)).map_err(|one| in_words(&one))?;
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
        Error::SqlInputError { msg, .. } if msg.starts_with("not authorized") => {
            "it may only read the table `estimate`".to_owned()
        }
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
}
