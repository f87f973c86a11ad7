//! The summary of an experiment: a line for every completed run.

use std::collections::HashMap;

use rusqlite::Connection;

use crate::plan::JobKey;
use crate::record::RunSummary;

use super::{Reader, StoreError};

/// Parameters by job key and agent.
type Swept = HashMap<(String, String), Vec<(String, String)>>;

impl Reader {
    /// The completed runs of an experiment's jobs, in the manifest's order; empty for an unknown
    /// experiment.
    pub fn run_summaries(&self, experiment: &str) -> Result<Vec<RunSummary>, StoreError> {
        self.read("summarise an experiment", |connection| {
            let mut swept = swept(connection, experiment)?;
            let mut statement = connection.prepare_cached(
                "SELECT s.job_key, unhex(s.job_key), s.agent, s.scenario, s.sigma, s.seed,
                    s.mean_return, s.sd_return, s.mean_length, s.disengagement_rate, s.wall_seconds
                 FROM experiment
                 JOIN experiment_job ON experiment_job.experiment = experiment.id
                 JOIN job ON job.id = experiment_job.job
                 JOIN run_summary AS s ON s.experiment = experiment.name
                    AND s.job_key = job.key AND s.agent = experiment_job.agent
                 WHERE experiment.name = ?1 AND s.status = 'completed'
                 ORDER BY experiment_job.position",
            )?;
            let rows = statement.query_map([experiment], |row| {
                let agent: String = row.get(2)?;
                Ok(RunSummary {
                    job_key: JobKey(row.get(1)?),
                    swept: swept.remove(&(row.get(0)?, agent.clone())).unwrap_or_default(),
                    agent,
                    scenario: row.get(3)?,
                    sigma: row.get(4)?,
                    seed: row.get(5)?,
                    mean_return: row.get(6)?,
                    sd_return: row.get(7)?,
                    mean_length: row.get(8)?,
                    disengagement_rate: row.get(9)?,
                    wall_seconds: row.get(10)?,
                })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}

/// The parameters that differ between jobs of one agent, for each job of an experiment.
fn swept(connection: &Connection, experiment: &str) -> rusqlite::Result<Swept> {
    let mut statement = connection.prepare_cached(
        "WITH declared AS (
            SELECT experiment_job.agent AS agent, parameter.job_key AS job_key,
                parameter.name AS name, parameter.value AS value
            FROM experiment
            JOIN experiment_job ON experiment_job.experiment = experiment.id
            JOIN job ON job.id = experiment_job.job
            JOIN parameter ON parameter.job_key = job.key
            WHERE experiment.name = ?1
                AND parameter.name NOT IN ('scenario', 'environment.sigma', 'seed'))
         SELECT job_key, agent, name, CAST(value AS TEXT) FROM declared
         WHERE (agent, name) IN
            (SELECT agent, name FROM declared GROUP BY agent, name HAVING min(value) <> max(value))
         ORDER BY job_key, agent, name",
    )?;
    let mut rows = statement.query([experiment])?;
    let mut swept = Swept::new();
    while let Some(row) = rows.next()? {
        let values = swept.entry((row.get(0)?, row.get(1)?)).or_default();
        values.push((row.get(2)?, row.get(3)?));
    }
    Ok(swept)
}
