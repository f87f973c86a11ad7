//! How much training is still to do.

use super::read::alive;
use super::state::state_sql;
use super::{Reader, StoreError};

/// Training episodes that an experiment has still to do with one algorithm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EpisodesLeft {
    /// The experiment's name.
    pub experiment: String,
    /// The algorithm, as the manifest writes it.
    pub algorithm: String,
    /// Episodes of the jobs that are pending, interrupted or running; how far those running have
    /// come is not known here.
    pub episodes: u64,
}

impl Reader {
    /// What is still to do, by experiment and algorithm; nothing for what is done.
    pub fn episodes_left(&self) -> Result<Vec<EpisodesLeft>, StoreError> {
        self.read("count what is to do", |connection| {
            // Failed (2) and completed (4) jobs are not run again.
            let state = state_sql("held.job", "?1");
            let mut statement = connection.prepare_cached(&format!(
                "SELECT experiment.name, json_extract(job.canonical, '$.agent.algorithm'),
                    sum(json_extract(job.canonical, '$.agent.episodes'))
                 FROM (SELECT DISTINCT experiment, job FROM experiment_job) AS held
                 JOIN job ON job.id = held.job
                 JOIN experiment ON experiment.id = held.experiment
                 WHERE coalesce({state}, 0) NOT IN (2, 4)
                 GROUP BY 1, 2 ORDER BY 1, 2"
            ))?;
            let rows = statement.query_map([alive(connection)?], |row| {
                Ok(EpisodesLeft {
                    experiment: row.get(0)?,
                    algorithm: row.get(1)?,
                    episodes: row.get(2)?,
                })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}
