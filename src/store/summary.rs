//! The summary of an experiment: a line for every completed run.

use crate::plan::JobKey;
use crate::record::RunSummary;

use super::error::StoreError;
use super::read::Reader;

impl Reader {
    /// The completed runs of an experiment's jobs, in the manifest's order; empty for an unknown
    /// experiment.
    pub fn run_summaries(&self, experiment: &str) -> Result<Vec<RunSummary>, StoreError> {
        self.read("summarise an experiment", |connection| {
            let mut statement = connection.prepare_cached(
                "SELECT unhex(s.job_key), s.agent, s.scenario, s.sigma, s.seed,
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
                Ok(RunSummary {
                    job_key: JobKey(row.get(0)?),
                    agent: row.get(1)?,
                    scenario: row.get(2)?,
                    sigma: row.get(3)?,
                    seed: row.get(4)?,
                    mean_return: row.get(5)?,
                    sd_return: row.get(6)?,
                    mean_length: row.get(7)?,
                    disengagement_rate: row.get(8)?,
                    wall_seconds: row.get(9)?,
                })
            })?;
            Ok(rows.collect::<rusqlite::Result<_>>()?)
        })
    }
}
