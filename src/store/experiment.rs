//! Experiments and the jobs they hold.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rusqlite::{CachedStatement, Connection, OptionalExtension, params};
use serde_json::{Value as Json, json};

use crate::job::{CanonicalForm, EstimateDeclaration, JobKey, Versions};

use super::earlier_manifest;
use super::error::{StoreError, StoreFault};
use super::transaction::NOW;
use super::writer::Store;

/// A manifest as the store keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Experiment<'a> {
    /// The experiment's name, which identifies it in the store.
    pub name: &'a str,
    /// The question of the experiment.
    pub question: Option<&'a str>,
    /// The expected result.
    pub hypothesis: Option<&'a str>,
    /// The manifest's text as it was read.
    pub manifest: &'a str,
}

/// The changes of a registration, in numbers of jobs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Registered {
    /// The number of jobs that the experiment holds now.
    pub jobs: usize,
    /// The number of these jobs that the experiment did not hold before.
    pub added: usize,
    /// Jobs that it no longer holds under any agent, because the manifest dropped them or their keys
    /// changed. Their runs stay in the store.
    pub dropped: usize,
}

/// The number of jobs per transaction. Other writers get their turn between transactions.
const BATCH: usize = 10_000;

impl Store {
    /// Makes the experiment hold exactly these jobs, each under its agent's name, in this order.
    ///
    /// Writes only differences from the store: registering the same jobs again writes nothing.
    ///
    /// **Errors**: another process is registering a different manifest under the same name.
    pub fn register<A: AsRef<str>, J: Into<CanonicalForm>>(
        &mut self,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
    ) -> Result<Registered, StoreError> {
        let never = AtomicBool::new(false);
        let registered = self.register_until(&never, experiment, jobs, None)?;
        Ok(registered.expect("nothing stops it"))
    }

    /// Like [`Store::register`], until all jobs are registered or `stop` is set; `None` if it was stopped.
    ///
    /// Each transaction registers ten thousand jobs. After a stop, the jobs registered so far remain, and so
    /// do jobs that the manifest dropped. Registering again completes the rest. With `part`, adds only the jobs
    /// in it, at their positions in the whole order, and keeps other jobs that the experiment already holds.
    pub fn register_until<A: AsRef<str>, J: Into<CanonicalForm>>(
        &mut self,
        stop: &AtomicBool,
        experiment: &Experiment<'_>,
        jobs: impl IntoIterator<Item = (A, J)>,
        part: Option<&HashSet<JobKey>>,
    ) -> Result<Option<Registered>, StoreError> {
        let is_held = |key: &JobKey| part.is_none_or(|part| part.contains(key));
        let action = "register an experiment";
        let id =
            self.write(action, |transaction| Ok(upsert_experiment(transaction, experiment)?))?;
        let mut held = Held::default();
        held.known = held
            .positions(&self.connection, id)
            .map_err(|source| StoreError::sqlite(&self.path, action, source))?;
        let mut jobs = jobs.into_iter().peekable();
        while jobs.peek().is_some() {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            // Jobs are hashed before the write lock is taken, because other processes wait for it.
            let batch: Vec<Member> = jobs
                .by_ref()
                .take(BATCH)
                .filter_map(|(agent, job)| {
                    let form: CanonicalForm = job.into();
                    let key = form.key();
                    let (agent, position) = held.meet(agent.as_ref(), key)?;
                    let is_new = is_held(&key) && !held.holds(key, agent, position);
                    is_new.then_some(Member { form, key, agent, position })
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

impl Store {
    /// Notes the estimates that the manifest of an experiment declares, each with the name of an agent whose jobs have
    /// it: the view `estimate` shows these alone.
    pub fn declare_estimates<'a>(
        &mut self,
        experiment: &str,
        declared: impl IntoIterator<Item = (&'a str, Arc<EstimateDeclaration>)>,
    ) -> Result<(), StoreError> {
        let pair = |(agent, one): (&str, Arc<EstimateDeclaration>)| json!([agent, one.canonical()]);
        let pairs = Json::Array(declared.into_iter().map(pair).collect()).to_string();
        self.write("register an experiment", |transaction| {
            let update = "UPDATE experiment SET estimates = ?2
                WHERE name = ?1 AND estimates IS NOT ?2";
            transaction.execute(update, [experiment, &pairs])?;
            Ok(())
        })
    }
}

/// Fails if the experiment's manifest has been replaced since its registration began.
fn require_manifest(
    connection: &Connection,
    id: i64,
    experiment: &Experiment<'_>,
) -> Result<(), StoreFault> {
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
    // The use of a text ends at the instant at which the use of the next text begins.
    let now: String = connection.query_row(&format!("SELECT {NOW}"), [], |row| row.get(0))?;
    let replaces = "SELECT 1 FROM experiment WHERE name = ?1 AND manifest <> ?2";
    if connection.prepare_cached(replaces)?.exists([experiment.name, experiment.manifest])? {
        earlier_manifest::keep(connection, experiment.name, &now)?;
    }
    connection.execute(
        "INSERT INTO experiment (name, question, hypothesis, manifest, created_at, updated_at)
         VALUES (?1, ?2, ?3, ?4, ?5, ?5)
         ON CONFLICT (name) DO UPDATE SET question = excluded.question,
            hypothesis = excluded.hypothesis, manifest = excluded.manifest,
            updated_at = excluded.updated_at
         WHERE (question, hypothesis, manifest)
            IS NOT (excluded.question, excluded.hypothesis, excluded.manifest)",
        params![
            experiment.name,
            experiment.question,
            experiment.hypothesis,
            experiment.manifest,
            now
        ],
    )?;
    connection
        .query_row("SELECT id FROM experiment WHERE name = ?1", [experiment.name], |row| row.get(0))
}

/// The jobs of an experiment that have been registered so far.
#[derive(Default)]
struct Held {
    /// The names of agents, by their number in `jobs`.
    agents: Vec<String>,
    /// The key and agent of every job seen so far.
    jobs: HashSet<(JobKey, usize)>,
    /// The position of every job that the experiment held before.
    known: HashMap<(JobKey, usize), usize>,
    /// The number of these jobs that the experiment holds through this registration.
    held: usize,
    /// The number of these jobs that the experiment did not hold before.
    added: usize,
}

/// A job that the experiment should hold.
struct Member {
    form: CanonicalForm,
    key: JobKey,
    /// The agent's number.
    agent: usize,
    /// The job's position in the manifest's order.
    position: usize,
}

impl Held {
    /// The number of the agent and the position of the job in the manifest; `None` for a repeated job.
    fn meet(&mut self, agent: &str, key: JobKey) -> Option<(usize, usize)> {
        let (agent, position) = (self.number(agent), self.jobs.len());
        self.jobs.insert((key, agent)).then_some((agent, position))
    }

    /// The positions of the jobs that the experiment holds.
    fn positions(
        &mut self,
        connection: &Connection,
        experiment: i64,
    ) -> rusqlite::Result<HashMap<(JobKey, usize), usize>> {
        let mut statement = connection.prepare(
            "SELECT unhex(key), agent, position FROM experiment_job JOIN job ON job.id = job
             WHERE experiment = ?1",
        )?;
        let mut rows = statement.query([experiment])?;
        let mut positions = HashMap::new();
        while let Some(row) = rows.next()? {
            let agent = self.number(row.get_ref(1)?.as_str()?);
            positions.insert((JobKey(row.get(0)?), agent), row.get(2)?);
        }
        Ok(positions)
    }

    /// Whether the experiment already holds the job at this position; if so, nothing needs to be written.
    fn holds(&mut self, key: JobKey, agent: usize, position: usize) -> bool {
        let holds = self.known.get(&(key, agent)) == Some(&position);
        self.held += usize::from(holds);
        holds
    }

    fn number(&mut self, agent: &str) -> usize {
        self.agents.iter().position(|name| name == agent).unwrap_or_else(|| {
            self.agents.push(agent.to_owned());
            self.agents.len() - 1
        })
    }

    /// Removes the jobs that the manifest no longer has. Returns the number of jobs that it also lacks under
    /// all other agents.
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

/// The part of a registration that belongs to one transaction.
struct Registration<'a> {
    experiment: i64,
    held: &'a mut Held,
    find_job: CachedStatement<'a>,
    insert_job: CachedStatement<'a>,
    insert_position: CachedStatement<'a>,
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
            insert_position: connection.prepare_cached(
                "INSERT INTO experiment_job (experiment, job, agent, position)
                 VALUES (?1, ?2, ?3, ?4)
                 ON CONFLICT (experiment, job, agent) DO UPDATE SET position = excluded.position",
            )?,
        })
    }

    fn hold(&mut self, member: &Member) -> rusqlite::Result<()> {
        let Member { key, agent, position, .. } = member;
        let id = self.row(member)?;
        let before = self.held.known.get(&(*key, *agent));
        let agent = &self.held.agents[*agent];
        self.held.held += 1;
        self.held.added += usize::from(before.is_none());
        self.insert_position.execute(params![self.experiment, id, agent, position])?;
        Ok(())
    }

    /// The row id of a job, which is inserted if it is missing.
    fn row(&mut self, Member { form, key, .. }: &Member) -> rusqlite::Result<i64> {
        let key = key.to_string();
        let found = self.find_job.query_row([&key], |row| row.get(0)).optional()?;
        if let Some(id) = found {
            return Ok(id);
        }
        let Versions { environment, algorithm } = form.versions();
        self.insert_job.insert(params![key, environment, algorithm, form.text()])
    }
}
