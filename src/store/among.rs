//! The test episodes of a range of participants.

use std::sync::Arc;

use rusqlite::Connection;

use crate::job::ParticipantRange;
use crate::job::TestEpisode;
use crate::record::{AmongParticipants, JobRecord, JobStatus};

use super::participant;
use super::{Reader, StoreError};

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
            if !participant::are_known(connection)? {
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
    let run: i64 = connection
        .prepare_cached(
            "SELECT run.id FROM job JOIN run ON run.job = job.id AND status = 'completed'
             WHERE job.key = ?1",
        )?
        .query_row([key], |row| row.get(0))?;
    let mut values: Vec<(u32, f64)> = connection
        .prepare_cached(participant::OF_TEST)?
        .query_map([run, range.place.into()], |row| Ok((row.get(0)?, row.get(1)?)))?
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
        Ok(TestEpisode { total_reward: row.get(0)?, length: row.get(1)?, disengaged: row.get(2)? })
    })?;
    rows.collect()
}
