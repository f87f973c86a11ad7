//! Recorded decisions of a completed run, read back one at a time.

use serde_json::{Map, Value as Json};

use crate::job::{Decision, Job, JobKey, Phase};
use crate::record::{PersonDecision, ReplayedDecision, ReplayedDecisions};

use super::error::StoreFault;
use super::read::completed_run;
use super::tables::packed_decisions;
use super::{Reader, StoreError, decision, family};

/// The columns that every family has.
const COLUMNS: &str = "episode, step, available, coalesce(can_send, available), coalesce(chosen_action, action), action,
    action_probability, action_probabilities, reward, terminated, truncated";

impl Reader {
    /// The job with the description of its environment in its completed run; the job itself if there is none.
    pub fn described(&self, job: Job) -> Result<Job, StoreError> {
        let key = job.key().to_string();
        self.read("read the description of an environment", |connection| {
            Ok(match completed_run(connection, &key)? {
                Some(run) => family::described(connection, run, job)?,
                None => job,
            })
        })
    }

    /// Calls `see` with each recorded decision of the test or trial of a job, by episode and step. Returns their number.
    /// The job must be [`Reader::described`].
    pub fn decisions(&self, job: &Job, see: impl FnMut(&Decision)) -> Result<u64, StoreError> {
        self.decisions_with(job, &job.state_names(), see)
    }

    /// [`Reader::decisions`] with these names of the state.
    pub fn decisions_with(
        &self,
        job: &Job,
        names: &[String],
        mut see: impl FnMut(&Decision),
    ) -> Result<u64, StoreError> {
        let key = job.key().to_string();
        let actions = job.task().interface().actions;
        let cost = job.environment.message_cost().unwrap_or(0.0);
        self.read("read decisions", |connection| {
            let run = completed_run(connection, &key)?;
            let is_packed = match run {
                Some(run) => packed_decisions().has_rows(connection, run)?,
                None => false,
            };
            // The state of packed rows has columns of its own, with all digits.
            let state = if is_packed { decision::STATE.join(", ") } else { "state".to_owned() };
            let sql = format!(
                "SELECT {COLUMNS}, {state} FROM decision WHERE job_key = ?1 AND phase = 'test' ORDER BY episode, step"
            );
            let mut statement = connection.prepare_cached(&sql)?;
            let mut rows = statement.query([&key])?;
            let mut count = 0;
            while let Some(row) = rows.next()? {
                let action: u8 = row.get(5)?;
                let state = match is_packed {
                    true => (11..11 + names.len())
                        .map(|index| row.get(index))
                        .collect::<Result<_, _>>()?,
                    false => numbers(&row.get::<_, String>(11)?, names)?,
                };
                let probabilities = match row.get::<_, Option<String>>(7)? {
                    Some(text) => serde_json::from_str(&text).map_err(unreadable)?,
                    None => {
                        let mut known = vec![f64::NAN; actions.max(1 + usize::from(action))];
                        known[usize::from(action)] = row.get(6)?;
                        known
                    }
                };
                see(&Decision {
                    phase: Phase::Test,
                    episode: row.get(0)?,
                    step: row.get(1)?,
                    state,
                    available: row.get(2)?,
                    can_send: row.get(3)?,
                    chosen: row.get(4)?,
                    action,
                    probabilities: probabilities.into(),
                    reward: row.get(8)?,
                    cost: if action > 0 { cost } else { 0.0 },
                    terminated: row.get::<_, Option<bool>>(9)?.unwrap_or_default(),
                    truncated: row.get::<_, Option<bool>>(10)?.unwrap_or_default(),
                });
                count += 1;
            }
            Ok(count)
        })
    }
}

impl Reader {
    /// The recorded decisions of some people of the test or trial of a job, by person and step.
    pub fn days(&self, key: &JobKey, people: &[u32]) -> Result<Vec<PersonDecision>, StoreError> {
        self.read("read decisions", |connection| {
            let sql =
                "SELECT step, action, coalesce(can_send, available), reward, state FROM decision
                WHERE job_key = ?1 AND phase = 'test' AND episode = ?2 ORDER BY step";
            let mut statement = connection.prepare_cached(sql)?;
            let mut days = Vec::new();
            for person in people {
                let mut rows = statement.query((key.to_string(), person))?;
                while let Some(row) = rows.next()? {
                    let text: String = row.get(4)?;
                    let state: Map<String, Json> =
                        serde_json::from_str(&text).map_err(unreadable)?;
                    let number = |(name, value): (String, Json)| {
                        let flag = value.as_bool().map(|flag| f64::from(u8::from(flag)));
                        Some((name, value.as_f64().or(flag)?))
                    };
                    days.push(PersonDecision {
                        person: *person,
                        step: row.get(0)?,
                        action: if row.get(2)? { row.get(1)? } else { f64::NAN },
                        reward: row.get(3)?,
                        state: state.into_iter().filter_map(number).collect(),
                    });
                }
            }
            Ok(days)
        })
    }
}

impl Reader {
    /// How the environment described itself in the completed run of a job.
    pub fn description(&self, key: &JobKey) -> Result<Option<String>, StoreError> {
        self.read("read the description of an environment", |connection| {
            Ok(family::description_of(connection, &key.to_string())?)
        })
    }

    /// The mean outcome of the recorded decisions of a job's test; `None` without any.
    pub fn mean_outcome(&self, key: &JobKey) -> Result<Option<f64>, StoreError> {
        let sql = "SELECT avg(reward) FROM decision WHERE job_key = ?1 AND phase = 'test'";
        self.read("read decisions", |connection| {
            Ok(connection.query_row(sql, [key.to_string()], |row| row.get(0))?)
        })
    }

    /// How the decisions of a job, which replays a recorded trial with this number of decisions per day, differ from the
    /// record by more than a threshold.
    pub fn replayed(
        &self,
        key: &JobKey,
        per_day: u32,
        threshold: f64,
    ) -> Result<ReplayedDecisions, StoreError> {
        self.read("read decisions", |connection| {
            let sql = "WITH replay AS (
                    SELECT episode, step, action_probability AS replayed,
                        json_extract(state, '$.recorded_probability') AS recorded,
                        coalesce(json_extract(state, '$.calendar_day'), step) AS day
                    FROM decision WHERE job_key = ?1 AND phase = 'test' AND coalesce(can_send, available)
                )
                SELECT episode, step, CAST(day AS INTEGER), recorded, replayed FROM replay
                WHERE recorded IS NOT NULL
                ORDER BY day, step % ?2, episode";
            let mut statement = connection.prepare_cached(sql)?;
            let mut rows = statement.query((key.to_string(), per_day.max(1)))?;
            let mut all = ReplayedDecisions::default();
            while let Some(row) = rows.next()? {
                all.add(
                    ReplayedDecision {
                        person: row.get(0)?,
                        step: row.get(1)?,
                        day: row.get(2)?,
                        recorded: row.get(3)?,
                        replayed: row.get(4)?,
                    },
                    threshold,
                );
            }
            Ok(all)
        })
    }
}

/// The numbers of a state in the order of their names.
fn numbers(text: &str, names: &[String]) -> Result<Box<[f64]>, StoreFault> {
    let state: Map<String, Json> = serde_json::from_str(text).map_err(unreadable)?;
    let number = |name: &String| state.get(name).and_then(Json::as_f64);
    Ok(names.iter().map(|name| number(name).unwrap_or(f64::NAN)).collect())
}

fn unreadable(error: serde_json::Error) -> StoreFault {
    rusqlite::Error::FromSqlConversionFailure(0, rusqlite::types::Type::Text, error.into()).into()
}
