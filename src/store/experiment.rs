//! Experiments and the jobs they hold.

use std::borrow::Borrow;
use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, Ordering};

use rusqlite::{CachedStatement, Connection, OptionalExtension, params};

use crate::plan::{CanonicalForm, Job, JobKey, Versions};

use super::error::{Fault, StoreError};
use super::transaction::NOW;
use super::writer::Store;

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
    /// Jobs that the experiment holds now.
    pub jobs: usize,
    /// Jobs among them that it did not hold before.
    pub added: usize,
    /// Jobs that it no longer holds under any agent, because the manifest dropped them or their keys
    /// changed. Their runs stay in the store.
    pub dropped: usize,
}

/// Jobs that one transaction registers. Other writers get their turn between two transactions.
const BATCH: usize = 10_000;

impl Store {
    /// Makes the experiment hold exactly these jobs, each under its agent's name, in this order.
    ///
    /// Writes only what differs from the store: registering the same again writes nothing.
    ///
    /// **Errors**: another process registers another manifest under the same name meanwhile.
    pub fn register<A: AsRef<str>, J: Borrow<Job>>(
        &mut self,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
    ) -> Result<Registered, StoreError> {
        let never = AtomicBool::new(false);
        let registered = self.register_until(&never, experiment, jobs)?;
        Ok(registered.expect("nothing stops it"))
    }

    /// As [`Store::register`], until it is done or `stop` is set; `None` if it was stopped.
    ///
    /// Each transaction registers ten thousand jobs. Jobs registered before a stop stay, and so do
    /// jobs that the manifest dropped; registering again completes the rest.
    pub fn register_until<A: AsRef<str>, J: Borrow<Job>>(
        &mut self,
        stop: &AtomicBool,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
    ) -> Result<Option<Registered>, StoreError> {
        self.register_where(stop, experiment, jobs, |_| true)
    }

    /// As [`Store::register_until`], with those of the jobs that are in `part`, each in its place in
    /// the whole order. Of the others the experiment keeps those that it holds already, and gets none.
    pub fn register_part_until<A: AsRef<str>, J: Borrow<Job>>(
        &mut self,
        stop: &AtomicBool,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
        part: &HashSet<JobKey>,
    ) -> Result<Option<Registered>, StoreError> {
        self.register_where(stop, experiment, jobs, |key| part.contains(key))
    }

    fn register_where<A: AsRef<str>, J: Borrow<Job>>(
        &mut self,
        stop: &AtomicBool,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
        is_held: impl Fn(&JobKey) -> bool,
    ) -> Result<Option<Registered>, StoreError> {
        let action = "register an experiment";
        let id =
            self.write(action, |transaction| Ok(upsert_experiment(transaction, experiment)?))?;
        let mut held = Held::default();
        let mut jobs = jobs.into_iter().peekable();
        while jobs.peek().is_some() {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            // Hashed before the lock is taken, which others wait for.
            let batch: Vec<Member> = jobs
                .by_ref()
                .take(BATCH)
                .filter_map(|(agent, job)| {
                    let form = job.borrow().form();
                    let key = form.key();
                    let (agent, position) = held.meet(agent.as_ref(), key)?;
                    is_held(&key).then_some(Member { form, agent, position })
                })
                .collect();
            if batch.is_empty() {
                continue;
            }
            self.write(action, |transaction| {
                require_manifest(transaction, id, experiment)?;
                let mut registration = Registration::new(transaction, id, &mut held)?;
                batch.iter().try_for_each(|member| registration.hold(member))?;
                Ok(())
            })?;
        }
        let dropped = self.write(action, |transaction| {
            require_manifest(transaction, id, experiment)?;
            Ok(held.drop_others(transaction, id)?)
        })?;
        Ok(Some(Registered { jobs: held.held, added: held.added, dropped }))
    }
}

/// Fails if the experiment has been given another manifest since its registration began.
fn require_manifest(
    connection: &Connection,
    id: i64,
    experiment: &Experiment<'_>,
) -> Result<(), Fault> {
    let ours = connection
        .prepare_cached("SELECT manifest = ?2 FROM experiment WHERE id = ?1")?
        .query_row(params![id, experiment.manifest], |row| row.get(0))?;
    match ours {
        true => Ok(()),
        false => Err(StoreError::Contested { name: experiment.name.to_owned() }.into()),
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

/// The jobs of an experiment that were registered so far.
#[derive(Default)]
struct Held {
    /// Names of agents, by the number that `jobs` knows them by.
    agents: Vec<String>,
    /// Key and agent of every job met so far.
    jobs: HashSet<(JobKey, usize)>,
    /// Of these, how many the experiment holds as part of the registration.
    held: usize,
    /// Of these, how many the experiment did not hold before.
    added: usize,
}

/// A job that an experiment is to hold.
struct Member {
    form: CanonicalForm,
    /// The agent's number.
    agent: usize,
    /// The job's place in the manifest's order.
    position: usize,
}

impl Held {
    /// The agent's number and the job's place in the manifest's order; `None` if the job was met
    /// before.
    fn meet(&mut self, agent: &str, key: JobKey) -> Option<(usize, usize)> {
        let (agent, position) = (self.number(agent), self.jobs.len());
        self.jobs.insert((key, agent)).then_some((agent, position))
    }

    fn number(&mut self, agent: &str) -> usize {
        self.agents.iter().position(|name| name == agent).unwrap_or_else(|| {
            self.agents.push(agent.to_owned());
            self.agents.len() - 1
        })
    }

    /// Removes the jobs that the manifest no longer has; returns how many it has under no other
    /// agent either.
    fn drop_others(&self, connection: &Connection, experiment: i64) -> rusqlite::Result<usize> {
        let stored: usize = connection.query_row(
            "SELECT count(*) FROM experiment_job WHERE experiment = ?1",
            [experiment],
            |row| row.get(0),
        )?;
        if stored == self.held {
            return Ok(0);
        }
        let mut others = Vec::new();
        let mut kept = HashSet::new();
        let mut statement = connection.prepare(
            "SELECT unhex(key), job, agent FROM experiment_job JOIN job ON job.id = job
             WHERE experiment = ?1",
        )?;
        let mut rows = statement.query([experiment])?;
        while let Some(row) = rows.next()? {
            let (key, job, agent): (_, i64, String) =
                (JobKey(row.get(0)?), row.get(1)?, row.get(2)?);
            let number = self.agents.iter().position(|name| *name == agent);
            if number.is_some_and(|number| self.jobs.contains(&(key, number))) {
                kept.insert(job);
            } else {
                others.push((job, agent));
            }
        }
        let mut delete = connection.prepare(
            "DELETE FROM experiment_job WHERE experiment = ?1 AND job = ?2 AND agent = ?3",
        )?;
        for (job, agent) in &others {
            delete.execute(params![experiment, job, agent])?;
        }
        let dropped: HashSet<i64> = others.into_iter().map(|(job, _)| job).collect();
        Ok(dropped.difference(&kept).count())
    }
}

/// The part of a registration that is in one transaction.
struct Registration<'a> {
    experiment: i64,
    held: &'a mut Held,
    find_job: CachedStatement<'a>,
    insert_job: CachedStatement<'a>,
    find_position: CachedStatement<'a>,
    insert_position: CachedStatement<'a>,
}

/// A job's row.
enum JobRow {
    /// It was there.
    Known(i64),
    /// It has just been made.
    New(i64),
}

impl<'a> Registration<'a> {
    fn new(
        connection: &'a Connection,
        experiment: i64,
        held: &'a mut Held,
    ) -> rusqlite::Result<Self> {
        Ok(Registration {
            experiment,
            held,
            find_job: connection.prepare_cached("SELECT id FROM job WHERE key = ?1")?,
            insert_job: connection.prepare_cached(
                "INSERT INTO job
                    (key, environment_version, algorithm_version, canonical)
                 VALUES (?1, ?2, ?3, ?4)",
            )?,
            find_position: connection.prepare_cached(
                "SELECT position FROM experiment_job
                 WHERE experiment = ?1 AND job = ?2 AND agent = ?3",
            )?,
            insert_position: connection.prepare_cached(
                "INSERT INTO experiment_job (experiment, job, agent, position)
                 VALUES (?1, ?2, ?3, ?4)
                 ON CONFLICT (experiment, job, agent) DO UPDATE SET position = excluded.position",
            )?,
        })
    }

    fn hold(&mut self, member: &Member) -> rusqlite::Result<()> {
        let Member { form, agent, position } = member;
        let row = self.row(form)?;
        let agent = &self.held.agents[*agent];
        let (JobRow::Known(id) | JobRow::New(id)) = row;
        self.held.held += 1;
        let before: Option<usize> = match row {
            JobRow::Known(_) => self
                .find_position
                .query_row(params![self.experiment, id, agent], |row| row.get(0))
                .optional()?,
            JobRow::New(_) => None,
        };
        if before == Some(*position) {
            return Ok(());
        }
        self.held.added += usize::from(before.is_none());
        self.insert_position.execute(params![self.experiment, id, agent, position])?;
        Ok(())
    }

    /// The job's row, made if there is none.
    fn row(&mut self, form: &CanonicalForm) -> rusqlite::Result<JobRow> {
        let key = form.key().to_string();
        let found = self.find_job.query_row([&key], |row| row.get(0)).optional()?;
        if let Some(id) = found {
            return Ok(JobRow::Known(id));
        }
        let Versions { environment, algorithm } = form.versions();
        self.insert_job.insert(params![key, environment, algorithm, form.text()]).map(JobRow::New)
    }
}
