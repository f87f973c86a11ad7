//! Recorded choices as rows: the chosen actions and the probabilities of all actions, beside the rows of
//! [`decision`](super::decision) with the same ids.

use rusqlite::types::Value;
use rusqlite::{Connection, Error};
use serde_json::Value as Json;

use crate::job::Decision;

use super::decision::{blocks, row_id};
use super::insert::insert_rows;

const TABLE: &str = "recorded_choice";

/// The number of bits per step.
const BITS: usize = 3;

/// The number of columns of the table.
const COLUMNS: usize = 3;

/// Inserts the choices of a run in progress, which must be sorted by phase, episode and step.
///
/// **Errors**: an episode or step exceeds its bits in the row id.
pub(super) fn insert(
    connection: &Connection,
    run: i64,
    decisions: &[Decision],
) -> rusqlite::Result<()> {
    let rows = blocks(decisions).map(|steps| {
        let mut bits = 0_i64;
        for (index, decision) in steps.iter().enumerate() {
            let step = decision.chosen | u8::from(decision.can_send) << 2;
            bits |= i64::from(step) << (BITS * index);
        }
        Ok([row_id(run, &steps[0])?.into(), bits.into(), probabilities(steps)?.into()])
    });
    let rows: Vec<[Value; COLUMNS]> = rows.collect::<rusqlite::Result<_>>()?;
    insert_rows(connection, TABLE, rows.into_iter())
}

/// The probabilities of all actions as JSON: a list per step, or null if they are not known.
fn probabilities(steps: &[Decision]) -> rusqlite::Result<String> {
    let each = steps.iter().map(|decision| {
        let all = &decision.probabilities;
        // Numbers have the shortest form that reads back as the same number.
        if all.iter().all(|p| p.is_finite()) { Json::from(all.to_vec()) } else { Json::Null }
    });
    let failed = |error: serde_json::Error| Error::ToSqlConversionFailure(error.into());
    serde_json::to_string(&each.collect::<Vec<_>>()).map_err(failed)
}
