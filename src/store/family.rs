//! Results that any environment can have: choices of action without strata, steps with states of any names, as in
//! every trial, and the descriptions of outside programs.

use rusqlite::types::Value;
use rusqlite::{Connection, Error, OptionalExtension, params};
use serde_json::{Map, Value as Json};

use crate::job::{ActionCount, Decision, Job, Phase, Results};

use super::insert::insert_rows;
use super::read::completed_run;
use super::schema::has_table;
use super::tables::ROWS;

/// The number of columns of `recorded_step`.
const STEP_COLUMNS: usize = 12;

/// Inserts the choices of action without strata, and the description, of a run in progress.
pub(super) fn insert(connection: &Connection, run: i64, results: &Results) -> rusqlite::Result<()> {
    let actions = results.actions.iter().filter(|choice| choice.stratum.is_none());
    let actions = actions.map(|choice| {
        let ActionCount { action, count, .. } = *choice;
        [run.into(), action.into(), count.cast_signed().into()]
    });
    insert_rows(connection, "action_total", actions)?;
    let Some(text) = &results.description else { return Ok(()) };
    let sql = "INSERT INTO recorded_description VALUES (?1, ?2)";
    connection.prepare_cached(sql)?.execute(params![run, text]).map(drop)
}

/// Inserts the decisions of a run in progress, which must be sorted by phase, episode and step.
///
/// **Errors**: a number is not finite.
pub(super) fn insert_steps(
    connection: &Connection,
    run: i64,
    results: &Results,
) -> rusqlite::Result<()> {
    // A recorded trial can have a million decisions, whose rows are larger.
    for some in results.decisions.chunks(100 * ROWS) {
        let rows = some.iter().map(|decision| row(run, decision, &results.state_names));
        let rows: Vec<[Value; STEP_COLUMNS]> = rows.collect::<rusqlite::Result<_>>()?;
        insert_rows(connection, "recorded_step", rows.into_iter())?;
    }
    Ok(())
}

fn row(run: i64, decision: &Decision, names: &[String]) -> rusqlite::Result<[Value; STEP_COLUMNS]> {
    let all = &decision.probabilities;
    // A number that a recorded trial lacks is NaN, and NULL in the store.
    let are_known = decision.state.iter().all(|number| !number.is_infinite());
    if !are_known || !decision.reward.is_finite() {
        let error = format!("a decision has a number that is not finite: {decision:?}");
        return Err(Error::ToSqlConversionFailure(error.into()));
    }
    let probabilities = match all.iter().all(|p| p.is_finite()) {
        true => Json::from(all.to_vec()).to_string().into(),
        false => Value::Null,
    };
    let state = names.iter().cloned().zip(decision.state.iter().map(|number| Json::from(*number)));
    let state: Map<String, Json> = state.collect();
    Ok([
        run.into(),
        i64::from(decision.phase == Phase::Test).into(),
        i64::from(decision.episode).into(),
        i64::from(decision.step).into(),
        i64::from(decision.available).into(),
        i64::from(decision.can_send).into(),
        i64::from(decision.chosen).into(),
        i64::from(decision.action).into(),
        decision.action_probability().into(),
        probabilities,
        decision.reward.into(),
        Json::Object(state).to_string().into(),
    ])
}

/// The choices of action of a run without strata.
pub(super) fn actions(connection: &Connection, run: i64) -> rusqlite::Result<Vec<ActionCount>> {
    if !has_table(connection, "action_total")? {
        return Ok(Vec::new());
    }
    let sql = "SELECT action, count FROM action_total WHERE run = ?1 ORDER BY action";
    let mut statement = connection.prepare_cached(sql)?;
    let rows = statement.query_map([run], |row| {
        Ok(ActionCount { stratum: None, action: row.get(0)?, count: row.get(1)? })
    })?;
    rows.collect()
}

/// The description of a run's environment; `None` if it was known before.
fn description(connection: &Connection, run: i64) -> rusqlite::Result<Option<String>> {
    if !has_table(connection, "recorded_description")? {
        return Ok(None);
    }
    let sql = "SELECT description FROM recorded_description WHERE run = ?1";
    connection.prepare_cached(sql)?.query_row([run], |row| row.get(0)).optional()
}

/// The description in the completed run of the job with this key.
pub(super) fn description_of(
    connection: &Connection,
    key: &str,
) -> rusqlite::Result<Option<String>> {
    completed_run(connection, key)?.map_or(Ok(None), |run| description(connection, run))
}

/// A job with the description of its environment in a run.
pub(super) fn described(connection: &Connection, run: i64, job: Job) -> rusqlite::Result<Job> {
    let text = description(connection, run)?;
    let environment = text.and_then(|text| job.environment.described(&text));
    Ok(match environment {
        Some(environment) => Job { environment, ..job },
        None => job,
    })
}
