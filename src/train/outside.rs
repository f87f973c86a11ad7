//! A job whose agent is an outside program. jitai counts every episode of its training and plays
//! its test, or plays its trial.
//!
//! In: a job, the declaration of its program, and a [`TrainingControl`]. Out: an [`Outcome`], as for any job.
//! There are no checkpoints, because the state of a program cannot be saved: a stopped job starts over.

mod broken;
mod choice;
mod lanes;
mod play;
mod question;
mod record;

use serde_json::{Map, Value as Json, json};

use crate::agent::External;
use crate::env::Environment;
use crate::external::{FromProgram, LONGEST_LINE, PROTOCOL, Program, ProgramError, ToProgram};
use crate::job::{Job, Outcome, RunnableJob, counted};
use crate::key::{Keyed, Value};
use crate::key::{Parameter, json_object};
use crate::train::control::TrainingControl;
use crate::train::decision_log::DecisionLog;
use crate::train::test::Test;
use crate::train::training::out_of_memory;

use broken::{Broken, unexpected};
use lanes::Lanes;
use record::TrainingRecord;

/// The most lanes in which a program can train.
const MOST_LANES: usize = 4096;

/// Trains and tests an outside program.
pub(super) fn run(
    job: RunnableJob<'_>,
    external: &External,
    control: &dyn TrainingControl,
) -> Outcome {
    let mut record = TrainingRecord::new(job.job(), control);
    let stop = || control.stop_requested();
    let started = Program::start(&external.command, control.folder(), LONGEST_LINE);
    let mut program = match started {
        Ok(program) => program,
        Err(error) => return record.failed(&error),
    };
    let mut session = Session { job, stop: &stop, program: &mut program };
    match session.converse(external, &mut record) {
        Ok(test) => {
            program.finish(&stop);
            Outcome::Completed(record.results(test))
        }
        Err(Broken::Program(ProgramError::Stopped)) => {
            program.stop();
            Outcome::Interrupted
        }
        Err(Broken::Program(error)) => record.failed(&error),
        Err(Broken::OutOfMemory(error)) => {
            Outcome::Failed(out_of_memory(&error, record.episodes()))
        }
    }
}

/// The conversation with the program of a job.
struct Session<'s> {
    job: RunnableJob<'s>,
    stop: &'s dyn Fn() -> bool,
    program: &'s mut Program,
}

impl Session<'_> {
    /// Conducts the whole conversation; returns the test, which ends it.
    fn converse(
        &mut self,
        external: &External,
        record: &mut TrainingRecord<'_>,
    ) -> Result<Test, Broken> {
        self.program.send(&assignment(&self.job, external));
        let lanes = self.ready()?;
        let mut test = Test::new(self.job).estimating(&self.job, record.control.estimates());
        if self.job.trial.is_none() {
            self.train(lanes, record)?;
        }
        play::play(&self.job, &mut test, self.program, record.control)?;
        self.program.send(&ToProgram::End {});
        Ok(test)
    }

    /// The number of lanes that the program requests in its answer.
    fn ready(&mut self) -> Result<usize, ProgramError> {
        const READY: &str = "\"ready\"";
        let message = self.program.receive(READY, "before training", self.stop)?;
        let FromProgram::Ready { protocol, lanes, trials } = message else {
            return Err(unexpected(self.program, &message, READY));
        };
        if protocol != PROTOCOL {
            let fault = format!(
                "expected protocol {PROTOCOL}, found {protocol}; use versions of the program and \
                 of jitai with the same protocol"
            );
            return Err(self.program.broke(fault));
        }
        if !(1..=MOST_LANES).contains(&lanes) {
            let fault = format!("`lanes`: expected a number from 1 to {MOST_LANES}, found {lanes}");
            return Err(self.program.broke(fault));
        }
        if self.job.trial.is_some() && !trials {
            let fault = "expected `trials` = true in \"ready\", because the job is a trial, found a program \
                         that does not act in trials; docs/external.md describes the messages of a trial";
            return Err(self.program.broke(fault.to_owned()));
        }
        Ok(lanes)
    }

    /// Serves the training until the program reports its end.
    fn train(&mut self, lanes: usize, record: &mut TrainingRecord<'_>) -> Result<(), Broken> {
        const EXPECTED: &str =
            "\"reset\", \"step\", \"episodes\", \"update\" or \"trained\" in training";
        let mut lanes = Lanes::new(&self.job, lanes);
        loop {
            let episodes = record.episodes();
            let when = format!("in training, after {}", counted(episodes, "episode"));
            let answered = match self.program.receive(EXPECTED, &when, self.stop)? {
                FromProgram::Reset(reset) => lanes.reset(&reset, record, self.program),
                FromProgram::Step(step) => lanes.step(&step, record, self.program)?,
                FromProgram::Episodes(episodes) => record.add(&episodes)?,
                FromProgram::Update(update) => {
                    record.update(update);
                    Ok(())
                }
                FromProgram::Trained {} => return Ok(()),
                other @ (FromProgram::Ready { .. } | FromProgram::Choices(_)) => {
                    return Err(unexpected(self.program, &other, EXPECTED).into());
                }
            };
            answered.map_err(|fault| self.program.broke(fault))?;
            record.log.as_ref().map_or(Ok(()), DecisionLog::check)?;
        }
    }
}

/// The first message: everything that a program needs for its job.
fn assignment(job: &Job, external: &External) -> Json {
    let spec = job.task().observations();
    let bound = |bound: f32| bound.is_finite().then_some(bound);
    let feature = |(name, low, high): (&str, f32, f32)| json!({ "name": name, "low": bound(low), "high": bound(high) });
    let features = spec.features.iter();
    let features = features.map(|one| feature((&one.name, one.low, one.high)));
    let moments = (0..spec.one_hot).map(|step| feature((&format!("T={step}"), 0.0, 1.0)));
    let parameters = job.agent.free_parameters();
    let parameters: Map<String, Json> =
        parameters.map(|(name, value)| (name.to_owned(), json!(value))).collect();
    let horizon = job.value(Parameter::Environment("horizon")).map(|horizon| json!(horizon));
    let mut assignment = json!({
        "type": "job",
        "protocol": PROTOCOL,
        "jitai": env!("CARGO_PKG_VERSION"),
        "job_key": job.key().to_string(),
        "version": external.version,
        "seed": job.seed,
        "episodes": if job.trial.is_some() { 0 } else { external.episodes },
        "parameters": parameters,
        "scenario": job.scenario.to_string(),
        "history": job.agent.history(),
        "observation": features.chain(moments).collect::<Vec<_>>(),
        "actions": job.task().interface().actions,
        "horizon": horizon.unwrap_or_else(|| job.environment.longest_episode().into()),
        "longest_episode": job.environment.longest_episode(),
        "family": job.environment.family().name,
        "environment": json_object(job.environment.family().keys, &job.environment.values()),
        "files": files(&job.environment),
        "population": population(&job.environment),
        "evaluation": job.evaluation.to_json(),
    });
    if let Some(trial) = &job.trial {
        assignment["trial"] = trial.to_json().into();
    }
    assignment
}

/// The texts of the files that keys name, by key; `json_object` has their digests.
fn files(of: &Environment) -> Map<String, Json> {
    let values = of.family().keys.iter().zip(of.values());
    let texts = values.filter_map(|(key, value)| match value {
        Value::Content(content) => Some((key.name.to_owned(), content.text()?.into())),
        _ => None,
    });
    texts.collect()
}

/// The keys of a population that differ from their defaults, as the tables of a manifest.
fn population(of: &Environment) -> Map<String, Json> {
    let keys = of.family().people.iter().zip(of.people_values());
    let given = keys.filter(|(key, value)| key.default().as_ref() != Some(value));
    let written = given.map(|(key, value)| {
        let table = match &value {
            Value::Distribution(of) => {
                toml::from_str::<Map<String, Json>>(&format!("x = {}", of.text()))
            }
            _ => Ok(Map::new()),
        };
        let read = table.ok().and_then(|mut table| table.remove("x"));
        (key.name.to_owned(), read.unwrap_or_else(|| json!(value)))
    });
    written.collect()
}
