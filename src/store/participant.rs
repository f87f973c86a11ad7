//! The parameters of participants as rows: their ids, insertion and copying.

use rusqlite::types::Value;
use rusqlite::{Connection, Error};

use crate::job::{ParticipantValue, Phase};

use super::insert::{RUN, insert_renumbered, insert_rows};
use super::schema::has_table;

// The lowest bits of the parts of a row id; the bits below the episode are the place of the parameter.
const PHASE: u32 = 38;
const EPISODE: u32 = 14;

/// The rows of run `?1` in order. The first column is the row id without the run.
pub(super) const SELECT: &str = "SELECT id & 549755813887, value FROM recorded_participant
    WHERE id BETWEEN ?1 << 39 AND (?1 << 39) + 549755813887 ORDER BY id";

/// The values of the parameter at place `?2` in the test of run `?1`, by episode.
pub(super) const OF_TEST: &str = "SELECT id >> 14 & 16777215, value FROM recorded_participant
    WHERE id BETWEEN (?1 << 39) + (1 << 38) AND (?1 << 39) + 549755813887 AND id & 16383 = ?2
    ORDER BY id";

/// Whether the file has the table, which stores of earlier versions lack.
pub(super) fn are_known(connection: &Connection) -> rusqlite::Result<bool> {
    has_table(connection, "recorded_participant")
}

/// Inserts the parameters of the participants of a run in progress, which must be sorted by phase, episode
/// and place.
///
/// **Errors**: a number is not finite, or an episode exceeds its bits in the row id.
pub(super) fn insert(
    connection: &Connection,
    run: i64,
    values: &[ParticipantValue],
) -> rusqlite::Result<()> {
    let rows = values.iter().map(|value| Ok([row_id(run, value)?.into(), value.value.into()]));
    let rows: Vec<[Value; 2]> = rows.collect::<rusqlite::Result<_>>()?;
    insert_rows(connection, "recorded_participant", rows.into_iter())
}

fn row_id(run: i64, value: &ParticipantValue) -> rusqlite::Result<i64> {
    let ParticipantValue { phase, episode, parameter, .. } = *value;
    if run >> (63 - RUN) != 0 || episode >> (PHASE - EPISODE) != 0 {
        return Err(Error::IntegralValueOutOfRange(0, episode.into()));
    }
    let phase = match phase {
        Phase::Train => 0,
        Phase::Test => 1,
    };
    Ok(run << RUN | phase << PHASE | i64::from(episode) << EPISODE | i64::from(parameter))
}

/// Inserts the rows of another store's run, as read by [`SELECT`], as the rows of run `own`.
///
/// **Errors**: the target rejects the rows.
pub(super) fn insert_copied(
    target: &Connection,
    own: i64,
    values: &[Value],
) -> rusqlite::Result<()> {
    insert_renumbered::<2>(target, "recorded_participant", own, values)
}
