//! Posteriors at the updates of trials as rows: insertion and reading.

use rusqlite::types::{Type, Value};
use rusqlite::{Connection, Error, Row};
use serde_json::Value as Json;

use crate::job::RecordedPosterior;

use super::insert::insert_rows;
use super::schema::has_table;

const TABLE: &str = "recorded_posterior";
/// The table of posteriors with partial pooling.
const PEOPLE: &str = "recorded_person";

/// The number of columns of each table.
const COLUMNS: usize = 6;
const COLUMNS_OF_PEOPLE: usize = 8;

/// Inserts the posteriors of a run in progress.
///
/// **Errors**: a number is not finite.
pub(super) fn insert(
    connection: &Connection,
    run: i64,
    posteriors: &[RecordedPosterior],
) -> rusqlite::Result<()> {
    let is_partial = |one: &&RecordedPosterior| one.person > 0 || !one.deviation.is_empty();
    let (people, everybody): (Vec<_>, Vec<_>) = posteriors.iter().partition(is_partial);
    let rows = everybody.into_iter().map(|one| {
        let [update, _, action, step] = numbers(one);
        Ok([run.into(), update, action, step, text(&one.mean)?, text(&one.covariance)?])
    });
    let rows: Vec<[Value; COLUMNS]> = rows.collect::<rusqlite::Result<_>>()?;
    insert_rows(connection, TABLE, rows.into_iter())?;
    let rows = people.into_iter().map(|one| {
        let [update, person, action, step] = numbers(one);
        let RecordedPosterior { mean, covariance, deviation, .. } = one;
        let [mean, covariance, deviation] = [text(mean)?, text(covariance)?, text(deviation)?];
        Ok([run.into(), update, person, action, step, mean, covariance, deviation])
    });
    let rows: Vec<[Value; COLUMNS_OF_PEOPLE]> = rows.collect::<rusqlite::Result<_>>()?;
    insert_rows(connection, PEOPLE, rows.into_iter())
}

/// The update, the person, the action and the step of a posterior.
fn numbers(one: &RecordedPosterior) -> [Value; 4] {
    let RecordedPosterior { update, person, action, step, .. } = one;
    [i64::from(*update), i64::from(*person), i64::from(*action), i64::from(*step)].map(Value::from)
}

/// Numbers as a JSON array. They have the shortest form that reads back as the same number.
fn text(numbers: &[f64]) -> rusqlite::Result<Value> {
    if numbers.iter().all(|number| number.is_finite()) {
        return Ok(Json::from(numbers.to_vec()).to_string().into());
    }
    Err(Error::ToSqlConversionFailure("a posterior has a number that is not finite".into()))
}

/// The posteriors of a run, by update, person and action.
pub(super) fn of_run(
    connection: &Connection,
    run: i64,
) -> rusqlite::Result<Vec<RecordedPosterior>> {
    let of_everybody =
        "SELECT number, 0, action, step, mean, covariance, '[]' FROM recorded_posterior
         WHERE run = ?1 ORDER BY number, action";
    let of_people =
        "SELECT number, person, action, step, mean, covariance, deviation FROM recorded_person
         WHERE run = ?1 ORDER BY number, person, action";
    let mut all = Vec::new();
    for (table, sql) in [(TABLE, of_everybody), (PEOPLE, of_people)] {
        if has_table(connection, table)? {
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map([run], read)?;
            all.extend(rows.collect::<rusqlite::Result<Vec<_>>>()?);
        }
    }
    Ok(all)
}

fn read(row: &Row<'_>) -> rusqlite::Result<RecordedPosterior> {
    let numbers = |column: usize| {
        let read = serde_json::from_str::<Vec<f64>>(&row.get::<_, String>(column)?);
        read.map_err(|error| Error::FromSqlConversionFailure(column, Type::Text, error.into()))
    };
    Ok(RecordedPosterior {
        update: row.get(0)?,
        person: row.get(1)?,
        action: row.get(2)?,
        step: row.get(3)?,
        mean: numbers(4)?,
        covariance: numbers(5)?,
        deviation: numbers(6)?,
    })
}
