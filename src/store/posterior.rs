//! Posteriors at the updates of trials as rows: insertion and reading.

use rusqlite::types::{Type, Value};
use rusqlite::{Connection, Error};
use serde_json::Value as Json;

use crate::job::RecordedPosterior;

use super::insert::insert_rows;
use super::schema::has_table;

const TABLE: &str = "recorded_posterior";

/// The number of columns of the table.
const COLUMNS: usize = 6;

/// Inserts the posteriors of a run in progress.
///
/// **Errors**: a number is not finite.
pub(super) fn insert(
    connection: &Connection,
    run: i64,
    posteriors: &[RecordedPosterior],
) -> rusqlite::Result<()> {
    let rows = posteriors.iter().map(|one| {
        let RecordedPosterior { update, step, action, mean, covariance } = one;
        let numbers = [i64::from(*update), i64::from(*action), i64::from(*step)].map(Value::from);
        let [update, action, step] = numbers;
        Ok([run.into(), update, action, step, text(mean)?, text(covariance)?])
    });
    let rows: Vec<[Value; COLUMNS]> = rows.collect::<rusqlite::Result<_>>()?;
    insert_rows(connection, TABLE, rows.into_iter())
}

/// Numbers as a JSON array. They have the shortest form that reads back as the same number.
fn text(numbers: &[f64]) -> rusqlite::Result<Value> {
    if numbers.iter().all(|number| number.is_finite()) {
        return Ok(Json::from(numbers.to_vec()).to_string().into());
    }
    Err(Error::ToSqlConversionFailure("a posterior has a number that is not finite".into()))
}

/// The posteriors of a run, by update and action.
pub(super) fn of_run(
    connection: &Connection,
    run: i64,
) -> rusqlite::Result<Vec<RecordedPosterior>> {
    if !has_table(connection, TABLE)? {
        return Ok(Vec::new());
    }
    let numbers = |column: usize, text: String| {
        let read = serde_json::from_str::<Vec<f64>>(&text);
        read.map_err(|error| Error::FromSqlConversionFailure(column, Type::Text, error.into()))
    };
    let mut statement = connection.prepare_cached(
        "SELECT number, action, step, mean, covariance FROM recorded_posterior
         WHERE run = ?1 ORDER BY number, action",
    )?;
    let rows = statement.query_map([run], |row| {
        Ok(RecordedPosterior {
            update: row.get(0)?,
            action: row.get(1)?,
            step: row.get(2)?,
            mean: numbers(3, row.get(3)?)?,
            covariance: numbers(4, row.get(4)?)?,
        })
    })?;
    rows.collect()
}
