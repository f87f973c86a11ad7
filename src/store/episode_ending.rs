//! The endings of recorded training episodes as rows. The rows of test episodes have their endings themselves.

use rusqlite::Connection;
use rusqlite::types::Value;

use crate::job::{Decision, Phase};

use super::decision::row_id;
use super::insert::insert_rows;

const TABLE: &str = "recorded_ending";

/// The number of columns of the table.
const COLUMNS: usize = 3;

/// Inserts the endings of the training episodes of a run in progress, whose decisions must be sorted by phase, episode
/// and step.
///
/// **Errors**: an episode exceeds its bits in the row id.
pub(super) fn insert(
    connection: &Connection,
    run: i64,
    decisions: &[Decision],
) -> rusqlite::Result<()> {
    let of_training = decisions.partition_point(|decision| decision.phase == Phase::Train);
    let episodes = decisions[..of_training].chunk_by(|one, next| one.episode == next.episode);
    let rows = episodes.map(|steps| {
        let Decision { terminated, truncated, .. } = steps[steps.len() - 1];
        let ending = i64::from(terminated) + 2 * i64::from(truncated);
        let length = steps.len() as u64;
        Ok([row_id(run, &steps[0])?.into(), length.cast_signed().into(), ending.into()])
    });
    let rows: Vec<[Value; COLUMNS]> = rows.collect::<rusqlite::Result<_>>()?;
    insert_rows(connection, TABLE, rows.into_iter())
}
