//! The parameters of participants as rows, their ids, insertion and copying; and the test episodes of a range
//! of participants.

use std::sync::Arc;

use rusqlite::types::Value;
use rusqlite::{Connection, Error};

use crate::job::{ParticipantRange, ParticipantValue, Phase, TestEpisode};
use crate::record::{AmongParticipants, JobRecord, JobStatus};

use super::insert::insert_rows;
use super::read::completed_run;
use super::schema::has_table;
use super::tables::RUN;
use super::{Reader, StoreError};

// The lowest bits of the parts of a row id; the bits below the episode are the index of the parameter.
const PHASE: u32 = 38;
const EPISODE: u32 = 14;

/// The values of the parameter with the index `?2` in the test of run `?1`, by episode.
const OF_TEST: &str = "SELECT id >> 14 & 16777215, value FROM recorded_participant
    WHERE id BETWEEN (?1 << 39) + (1 << 38) AND (?1 << 39) + 549755813887 AND id & 16383 = ?2
    ORDER BY id";

/// Inserts the parameters of the participants of a run in progress, which must be sorted by phase, episode
/// and index.
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

impl Reader {
    /// Adds the test episodes of these participants to completed jobs. Skips jobs whose participants do not
    /// differ in the parameter.
    pub fn read_participants(
        &self,
        jobs: &mut [JobRecord],
        ranges: &[ParticipantRange],
    ) -> Result<(), StoreError> {
        if ranges.is_empty() {
            return Ok(());
        }
        self.read("read participants", |connection| {
            if !has_table(connection, "recorded_participant")? {
                return Ok(());
            }
            for job in jobs {
                let JobStatus::Completed(run) = &mut job.status else { continue };
                let key = job.job_key.to_string();
                let run = Arc::make_mut(run);
                for range in ranges {
                    run.among.extend(among(connection, &key, *range)?);
                }
            }
            Ok(())
        })
    }
}

/// The test episodes of a completed job in a range; `None` if the job's participants do not differ in the
/// parameter.
fn among(
    connection: &Connection,
    key: &str,
    range: ParticipantRange,
) -> rusqlite::Result<Option<AmongParticipants>> {
    // Another process may have deleted the run.
    let Some(run) = completed_run(connection, key)? else { return Ok(None) };
    let mut values: Vec<(u32, f64)> = connection
        .prepare_cached(OF_TEST)?
        .query_map([run, range.index.into()], |row| Ok((row.get(0)?, row.get(1)?)))?
        .collect::<rusqlite::Result<_>>()?;
    if values.is_empty() {
        return Ok(None);
    }
    // A stable sort: equal values stay in the order of their episodes.
    values.sort_by(|(_, one), (_, other)| one.total_cmp(other));
    let count = values.len();
    let ranked = values.into_iter().enumerate();
    let meant = ranked.filter(|(rank, _)| range.contains(*rank, count));
    let mut episodes: Vec<u32> = meant.map(|(_, (episode, _))| episode).collect();
    episodes.sort_unstable();
    let played = test_episodes(connection, run)?;
    let found = episodes.iter().filter_map(|episode| played.get(*episode as usize - 1).copied());
    Ok(Some(AmongParticipants { range, episodes: found.collect() }))
}

fn test_episodes(connection: &Connection, run: i64) -> rusqlite::Result<Vec<TestEpisode>> {
    let mut statement = connection.prepare_cached(
        "SELECT total_reward, length, disengaged FROM test_episode WHERE run = ?1 ORDER BY episode",
    )?;
    let rows = statement.query_map([run], |row| {
        Ok(TestEpisode { total_reward: row.get(0)?, length: row.get(1)?, terminated: row.get(2)? })
    })?;
    rows.collect()
}
