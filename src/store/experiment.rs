//! Experiments and the jobs they hold.

use std::borrow::Borrow;
use std::collections::HashSet;

use rusqlite::{Connection, OptionalExtension, params};

use crate::plan::Job;

use super::{NOW, Store, StoreError};

/// A manifest as the store keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Experiment<'a> {
    /// Its name, which identifies it in the store.
    pub name: &'a str,
    /// What the author wants to know.
    pub question: Option<&'a str>,
    /// What the author expects.
    pub hypothesis: Option<&'a str>,
    /// The manifest's text as it was read.
    pub manifest: &'a str,
}

/// What registering an experiment changed, in jobs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Registered {
    /// Held by the experiment now.
    pub jobs: usize,
    /// Of these, new to the experiment.
    pub added: usize,
    /// No longer held, because the manifest dropped them. Their runs stay in the store.
    pub dropped: usize,
}

impl Store {
    /// Makes the experiment hold exactly these jobs, each under its agent's name, in this order.
    ///
    /// Writes only what differs from the store: registering the same again writes nothing.
    pub fn register<A: AsRef<str>, J: Borrow<Job>>(
        &mut self,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
    ) -> Result<Registered, StoreError> {
        self.write("register an experiment", |transaction| {
            let experiment = upsert_experiment(transaction, experiment)?;
            let mut registration = Registration::new(transaction, experiment);
            for (agent, job) in jobs {
                registration.hold(agent.as_ref(), job.borrow())?;
            }
            let dropped = registration.drop_others()?;
            Ok(Registered { jobs: registration.held.len(), added: registration.added, dropped })
        })
    }
}

fn upsert_experiment(
    connection: &Connection,
    experiment: &Experiment<'_>,
) -> rusqlite::Result<i64> {
    connection.execute(
        &format!(
            "INSERT INTO experiment (name, question, hypothesis, manifest, created_at, updated_at)
             VALUES (?1, ?2, ?3, ?4, {NOW}, {NOW})
             ON CONFLICT (name) DO UPDATE SET question = excluded.question,
                hypothesis = excluded.hypothesis, manifest = excluded.manifest,
                updated_at = excluded.updated_at
             WHERE (question, hypothesis, manifest)
                IS NOT (excluded.question, excluded.hypothesis, excluded.manifest)"
        ),
        params![experiment.name, experiment.question, experiment.hypothesis, experiment.manifest],
    )?;
    connection
        .query_row("SELECT id FROM experiment WHERE name = ?1", [experiment.name], |row| row.get(0))
}

/// A registration under way.
struct Registration<'a> {
    connection: &'a Connection,
    experiment: i64,
    /// Names of agents, by the number that `held` knows them by.
    agents: Vec<String>,
    /// Job and agent of every job met so far.
    held: HashSet<(i64, usize)>,
    added: usize,
}

impl<'a> Registration<'a> {
    fn new(connection: &'a Connection, experiment: i64) -> Self {
        Registration { connection, experiment, agents: Vec::new(), held: HashSet::new(), added: 0 }
    }

    fn hold(&mut self, agent: &str, job: &Job) -> rusqlite::Result<()> {
        let number = self.number(agent);
        let id = self.job_id(job)?;
        // Its place in the manifest's order.
        let position = self.held.len();
        if !self.held.insert((id, number)) {
            return Ok(());
        }
        let before: Option<usize> = self
            .connection
            .prepare_cached(
                "SELECT position FROM experiment_job
                 WHERE experiment = ?1 AND job = ?2 AND agent = ?3",
            )?
            .query_row(params![self.experiment, id, agent], |row| row.get(0))
            .optional()?;
        if before == Some(position) {
            return Ok(());
        }
        self.added += usize::from(before.is_none());
        self.connection
            .prepare_cached(
                "INSERT INTO experiment_job (experiment, job, agent, position)
                 VALUES (?1, ?2, ?3, ?4)
                 ON CONFLICT (experiment, job, agent) DO UPDATE SET position = excluded.position",
            )?
            .execute(params![self.experiment, id, agent, position])?;
        Ok(())
    }

    fn number(&mut self, agent: &str) -> usize {
        self.agents.iter().position(|name| name == agent).unwrap_or_else(|| {
            self.agents.push(agent.to_owned());
            self.agents.len() - 1
        })
    }

    /// The job's row id; the row is made if there is none.
    fn job_id(&self, job: &Job) -> rusqlite::Result<i64> {
        let key = job.key().to_string();
        let found = self
            .connection
            .prepare_cached("SELECT id FROM job WHERE key = ?1")?
            .query_row([&key], |row| row.get(0))
            .optional()?;
        if let Some(id) = found {
            return Ok(id);
        }
        let versions = job.versions();
        self.connection
            .prepare_cached(
                "INSERT INTO job
                    (key, content_key, environment_version, algorithm_version, canonical)
                 VALUES (?1, ?2, ?3, ?4, ?5)",
            )?
            .insert(params![
                key,
                job.content_key().to_string(),
                versions.environment,
                versions.algorithm,
                job.canonical()
            ])
    }

    /// Lets go of the jobs that were not met; returns how many.
    fn drop_others(&self) -> rusqlite::Result<usize> {
        let stored: usize = self.connection.query_row(
            "SELECT count(*) FROM experiment_job WHERE experiment = ?1",
            [self.experiment],
            |row| row.get(0),
        )?;
        if stored == self.held.len() {
            return Ok(0);
        }
        let mut others = Vec::new();
        let mut statement = self
            .connection
            .prepare("SELECT job, agent FROM experiment_job WHERE experiment = ?1")?;
        let mut rows = statement.query([self.experiment])?;
        while let Some(row) = rows.next()? {
            let (job, agent): (i64, String) = (row.get(0)?, row.get(1)?);
            let number = self.agents.iter().position(|name| *name == agent);
            if number.is_none_or(|number| !self.held.contains(&(job, number))) {
                others.push((job, agent));
            }
        }
        let mut delete = self.connection.prepare(
            "DELETE FROM experiment_job WHERE experiment = ?1 AND job = ?2 AND agent = ?3",
        )?;
        for (job, agent) in &others {
            delete.execute(params![self.experiment, job, agent])?;
        }
        Ok(others.len())
    }
}
