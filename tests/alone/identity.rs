//! Stable identity: a key that is added later does not change the key of any stored job.

use std::path::Path;

use jitai::agent::{
    self, Actions, Actor, Agent, AlgorithmParameters, RulePolicy, Start, StartError, Task, Weights,
    WeightsError, register_algorithm,
};
use jitai::env::{Action, StepCount};
use jitai::job::Evaluation;
use jitai::job::{Job, JobError};
use jitai::key::{Constraint, Key, Keyed, Kind, Value, canonical_object, read_object};
use jitai::keys;
use jitai::manifest::{self};
use jitai::plan::{self};
use jitai::store::{Experiment, Reader, Store};
use rusqlite::Connection;

keys! {
    /// An algorithm as it was when its first jobs were stored.
    struct Early {
        /// action of every step
        action: u32 = 0, in Kind::Integer { min: 0, max: 3 };
    }
}

keys! {
    /// The same algorithm with an additional key, whose default differs from the value of all earlier jobs.
    struct Later {
        /// action of every step
        action: u32 = 0, in Kind::Integer { min: 0, max: 3 };
        /// share of steps without a message
        rest: f64 = 0.5, before 0.0, in Kind::PROBABILITY;
    }
}

macro_rules! algorithm {
    ($Parameters:ty) => {
        impl AlgorithmParameters for $Parameters {
            const NAME: &'static str = "always";
            const LEARNS: bool = false;
            const CONSTRAINTS: &'static [Constraint] = &[];

            fn version(&self) -> u32 {
                1
            }

            fn episodes(&self) -> u32 {
                0
            }

            fn start(&self, _: &Task) -> Result<Start, StartError> {
                let action = Action::from_index(self.action as usize).expect("an action");
                Ok(Start::Actor(Box::new(RulePolicy::fixed(action))))
            }

            fn trained(
                &self,
                _: &Task,
                _: &Weights,
                _: Actions,
            ) -> Result<Box<dyn Actor>, WeightsError> {
                Err(WeightsError::NoNetwork)
            }
        }
    };
}

algorithm!(Early);
algorithm!(Later);

fn job(agent: Agent) -> Job {
    Job {
        environment: StepCount::paper(0.6).into(),
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation::default(),
        trial: None,
        seed: 3,
    }
}

fn early() -> Job {
    job(Agent::of(&Early { action: 2 }))
}

fn later(rest: f64) -> Job {
    job(Agent::of(&Later { action: 2, rest }))
}

/// Registers the later algorithm, as a newer release of a program would.
fn newer_release() {
    // Another test may already have registered it.
    let _ = register_algorithm::<Later>();
}

#[test]
fn an_added_key_changes_the_identity_of_no_job_at_the_value_of_earlier_jobs() {
    assert_eq!(later(0.0).canonical(), early().canonical());
    assert_eq!(later(0.0).key(), early().key());
    for rest in [0.5, 1.0, f64::MIN_POSITIVE] {
        assert_ne!(later(rest).key(), early().key(), "{rest}");
    }
    assert_ne!(later(0.5).key(), later(1.0).key());
}

#[test]
fn stored_jobs_are_read_with_the_value_that_they_had() {
    newer_release();
    assert_eq!(Job::from_canonical(&early().canonical()).unwrap(), later(0.0));
    assert_eq!(Job::from_canonical(&later(0.5).canonical()).unwrap(), later(0.5));
}

#[test]
fn no_job_has_a_second_spelling() {
    newer_release();
    let spelled_out = early()
        .canonical()
        .replace("\"algorithm\":\"always\"", "\"algorithm\":\"always\",\"rest\":0.0");
    assert_ne!(spelled_out, early().canonical());
    let refused = Job::from_canonical(&spelled_out);
    assert!(matches!(refused, Err(JobError::Keys { part: "agent", .. })), "{refused:?}");
}

#[test]
fn a_key_of_the_environment_can_be_added_too() {
    let noise = Key {
        name: "noise",
        kind: Kind::PROBABILITY,
        written_doc: "",
        default: Some(|| Value::Real(0.1)),
        earlier: None,
        before: Some(|| Value::Real(0.0)),
    };
    let grown: Vec<Key> = StepCount::KEYS.iter().copied().chain([noise]).collect();
    let values = |noise| -> Vec<Value> {
        StepCount::paper(0.4).to_values().into_iter().chain([Value::Real(noise)]).collect()
    };
    let now = canonical_object(StepCount::KEYS, &StepCount::paper(0.4).to_values());
    assert_eq!(canonical_object(&grown, &values(0.0)), now);
    assert_ne!(canonical_object(&grown, &values(0.1)), now);
    assert_eq!(read_object(&grown, &now).unwrap(), values(0.0));
}

#[test]
fn manifests_views_and_commands_take_an_added_key_for_what_it_was() {
    newer_release();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jitai.sqlite");
    let mut store = Store::open(&path).unwrap();
    let experiment = Experiment { name: "t", question: None, hypothesis: None, manifest: "" };
    // An earlier release stored this job.
    store.register(&experiment, [("a", early())]).unwrap();
    assert_eq!(rows(&path), [(early().key().to_string(), 0.0)]);

    let text = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = [3]\n\
                environment.sigma = 0.6\n[[agent]]\nname = \"a\"\nalgorithm = \"always\"\n\
                action = 2\nrest = [0.0, 0.25]\n";
    let manifest = manifest::parse("t", text.as_bytes()).unwrap();
    let jobs = plan::expand(&manifest);
    assert_eq!(jobs[0].form.key(), early().key());
    let named = jobs.iter().map(|planned| (&*planned.agent, &planned.job));
    store.register(&experiment, named).unwrap();
    let mut expected =
        vec![(early().key().to_string(), 0.0), (later(0.25).key().to_string(), 0.25)];
    expected.sort_by(|one, other| one.0.cmp(&other.0));
    assert_eq!(rows(&path), expected);
    assert_eq!(Reader::open(&path).unwrap().experiment_counts().unwrap().len(), 1);
}

/// The rows of the view `parameter` for the added key.
fn rows(path: &Path) -> Vec<(String, f64)> {
    let connection = Connection::open(path).unwrap();
    let mut statement = connection
        .prepare("SELECT job_key, value FROM parameter WHERE name = 'agent.rest' ORDER BY job_key")
        .unwrap();
    let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    rows.collect::<rusqlite::Result<_>>().unwrap()
}

/// Declares an algorithm with one key of a given name, which always starts an actor.
macro_rules! odd_algorithm {
    ($Parameters:ident, $key:ident, $name:literal, $learns:literal) => {
        keys! {
            /// An algorithm that no program should register.
            struct $Parameters {
                /// episodes of training
                $key: u32 = 1, in Kind::EPISODES;
            }
        }

        impl AlgorithmParameters for $Parameters {
            const NAME: &'static str = $name;
            const LEARNS: bool = $learns;

            fn episodes(&self) -> u32 {
                self.$key
            }

            fn start(&self, _: &Task) -> Result<Start, StartError> {
                Ok(Start::Actor(Box::new(RulePolicy::fixed(Action::NONE))))
            }

            fn trained(
                &self,
                _: &Task,
                _: &Weights,
                _: Actions,
            ) -> Result<Box<dyn Actor>, WeightsError> {
                Err(WeightsError::NoNetwork)
            }
        }
    };
}

odd_algorithm!(Reserved, algorithm, "reserved", true);
odd_algorithm!(Reinforce, episodes, "reinforce", true);
odd_algorithm!(Untrained, episodes, "untrained", false);

#[test]
fn names_that_mean_something_else_cannot_be_registered() {
    let refused = register_algorithm::<Reserved>().unwrap_err();
    assert!(refused.to_string().starts_with("`algorithm` cannot be a key of an algorithm"));
    let refused = register_algorithm::<Reinforce>().unwrap_err();
    assert_eq!(refused.to_string(), "an algorithm called `reinforce` is already registered");
    let namesake = Agent::of(&Reinforce { episodes: 1 });
    assert_ne!(namesake.algorithm(), Agent::of(&agent::Reinforce::default()).algorithm());
    assert_eq!(namesake.parameters::<agent::Reinforce>(), None);
}

#[test]
fn an_algorithm_that_does_not_start_what_it_declares_is_an_error() {
    for (agent, declared) in [
        (Agent::of(&Reinforce { episodes: 1 }), "LEARNS = true"),
        (Agent::of(&Untrained { episodes: 1 }), "LEARNS = false"),
    ] {
        let job = job(agent);
        let refused = job.agent.start(&job.task()).err().unwrap().to_string();
        assert!(refused.contains(declared), "{refused}");
    }
}
