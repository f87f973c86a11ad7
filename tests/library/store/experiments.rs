//! Experiments, and the information about their jobs.

use std::collections::HashSet;

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use jitai::agent::{Agent, DuelingDqn};
use jitai::job::Outcome;
use jitai::job::{Job, PlannedJob, Scalar, Versions};
use jitai::record::JobStatus;
use jitai::store::{Counts, Experiment, JobState, Parts, Reader, Registered, Store, StoreError};
use rusqlite::Connection;
use rusqlite::types::Value;

use super::sample::{Sample, completed, dqn, experiment, failed, number, reinforce};

fn counts(sample: &Sample, name: &str) -> Counts {
    let all = Reader::open(&sample.path).unwrap().experiment_counts().unwrap();
    all.into_iter().find(|one| one.experiment == name).unwrap().counts
}

#[test]
fn registering_again_writes_nothing() {
    let jobs: Vec<Job> = (1..=50).map(|seed| dqn(0.4, seed)).collect();
    let mut sample = Sample::new();
    let log = sample.path.with_extension("sqlite-wal");
    let mut register = || {
        let registered =
            sample.store.register(&experiment("sweep"), jobs.iter().map(|job| ("dqn", job)));
        (registered.unwrap(), fs::read(&log).unwrap())
    };
    let (first, before) = register();
    assert_eq!(first, Registered { jobs: 50, added: 50, dropped: 0 });
    let (second, after) = register();
    assert_eq!(second, Registered { jobs: 50, added: 0, dropped: 0 });
    assert!(before == after, "the log has grown");
}

/// Jobs that differ only in their seeds.
fn many(jobs: u64) -> impl Iterator<Item = (&'static str, Job)> {
    (1..=jobs).map(|seed| ("dqn", dqn(0.4, seed)))
}

#[test]
fn a_large_registration_lets_others_write_and_stops_between_its_parts() {
    let mut sample = Sample::new();
    let stranger = Connection::open(&sample.path).unwrap();
    stranger.busy_timeout(Duration::ZERO).unwrap();
    let stop = AtomicBool::new(false);
    let jobs = many(25_000).map(|(agent, job)| {
        if job.seed == 10_001 {
            // Other connections see the first ten thousand jobs, and the lock is free.
            let known = number(&stranger, "SELECT count(*) FROM experiment_job");
            assert_eq!(known, 10_000);
            stranger.execute_batch("BEGIN IMMEDIATE; ROLLBACK").unwrap();
        }
        stop.store(job.seed >= 20_000, Ordering::Relaxed);
        (agent, job)
    });
    let registered = sample.store.register_until(&stop, &experiment("sweep"), jobs, None).unwrap();
    assert_eq!(registered, None);
    assert_eq!(number(&stranger, "SELECT count(*) FROM experiment_job"), 20_000);

    let again = sample.store.register(&experiment("sweep"), many(25_000)).unwrap();
    assert_eq!(again, Registered { jobs: 25_000, added: 5_000, dropped: 0 });
    let in_order = "SELECT count(*) FROM experiment_job JOIN job ON job.id = job
         WHERE position + 1 = json_extract(canonical, '$.seed')";
    assert_eq!(number(&stranger, in_order), 25_000);
}

#[test]
fn two_manifests_of_one_name_cannot_be_registered_at_once() {
    let mut sample = Sample::new();
    let mut other = Store::open(&sample.path).unwrap();
    let theirs = Experiment { manifest: "format = 1\nseeds = 1", ..experiment("sweep") };
    let jobs = many(10_001).inspect(|(_, job)| {
        if job.seed == 10_001 {
            other.register(&theirs, many(1)).unwrap();
        }
    });
    let error = sample.store.register(&experiment("sweep"), jobs).unwrap_err();
    assert!(matches!(&error, StoreError::Contested { name } if name == "sweep"), "{error}");
    assert_eq!(counts(&sample, "sweep").total(), 1);
}

#[test]
fn an_edited_manifest_replaces_the_jobs_and_keeps_their_runs() {
    let mut sample = Sample::with(&[dqn(0.4, 1), dqn(0.4, 2)]);
    sample.run(&dqn(0.4, 1), &completed());
    let edited = Experiment { manifest: "format = 1\nseeds = [2, 3]", ..experiment("sweep") };
    let jobs = [("dueling", dqn(0.4, 2)), ("dueling", dqn(0.4, 3))];
    let registered = sample.store.register(&edited, jobs).unwrap();
    // One of the two jobs now has another agent name.
    assert_eq!(registered, Registered { jobs: 2, added: 2, dropped: 1 });
    assert_eq!(counts(&sample, "sweep"), Counts { pending: 2, ..Counts::default() });
    let raw = sample.raw();
    assert_eq!(number(&raw, "SELECT count(*) FROM experiment WHERE manifest LIKE '%[2, 3]'"), 1);
    assert_eq!(number(&raw, "SELECT count(*) FROM run_summary"), 0);
    assert_eq!(number(&raw, "SELECT count(*) FROM evaluation_episode"), 2);

    let all = [dqn(0.4, 1), dqn(0.4, 2), dqn(0.4, 3)];
    sample.store.register(&experiment("sweep"), all.iter().map(|job| ("dqn", job))).unwrap();
    assert_eq!(counts(&sample, "sweep"), Counts { pending: 2, completed: 1, ..Counts::default() });
}

#[test]
fn experiments_and_agents_that_declare_the_same_job_share_it() {
    let mut sample = Sample::with(&[dqn(0.4, 1)]);
    let twice = [("dqn", dqn(0.4, 1)), ("again", dqn(0.4, 1))];
    let registered = sample.store.register(&experiment("other"), twice).unwrap();
    assert_eq!(registered.jobs, 2);
    sample.run(&dqn(0.4, 1), &completed());
    for name in ["sweep", "other"] {
        assert_eq!(counts(&sample, name), Counts { completed: 1, ..Counts::default() });
    }
    let raw = sample.raw();
    assert_eq!(number(&raw, "SELECT count(*) FROM job"), 1);
    assert_eq!(number(&raw, "SELECT count(*) FROM run_summary WHERE experiment = 'sweep'"), 1);
    assert_eq!(number(&raw, "SELECT count(*) FROM run_summary WHERE experiment = 'other'"), 2);
    let agents = "SELECT group_concat(agent, ' ' ORDER BY position) FROM experiment_job
        WHERE experiment = 2";
    let agents: String = raw.query_row(agents, [], |row| row.get(0)).unwrap();
    assert_eq!(agents, "dqn again");
}

#[test]
fn jobs_are_counted_by_what_became_of_them() {
    let jobs: Vec<Job> = (1..=9).map(|seed| dqn(0.4, seed)).collect();
    let mut sample = Sample::with(&jobs);
    sample.run(&jobs[0], &completed());
    sample.run(&jobs[1], &failed());
    sample.run(&jobs[2], &Outcome::Interrupted);
    sample.run(&jobs[3], &Outcome::Interrupted);
    sample.run(&jobs[3], &completed());
    sample.claim(&jobs[4]);
    // A failed job runs again: one such run is running, another is interrupted; an interrupted job is
    // running.
    sample.run(&jobs[5], &failed());
    sample.run(&jobs[6], &failed());
    sample.run(&jobs[7], &Outcome::Interrupted);
    sample.session = sample.store.begin_session(&super::sample::provenance()).unwrap();
    sample.claim(&jobs[5]);
    sample.run(&jobs[6], &Outcome::Interrupted);
    sample.claim(&jobs[7]);
    let expected = Counts { pending: 1, interrupted: 1, failed: 2, running: 3, completed: 2 };
    assert_eq!(counts(&sample, "sweep"), expected);
    assert_eq!(expected.total(), 9);

    let keys: Vec<_> = jobs.iter().map(Job::key).chain([dqn(9.0, 1).key()]).collect();
    let states = Reader::open(&sample.path).unwrap().job_states(&keys).unwrap();
    use JobState::{Completed, Failed, Interrupted, Pending, Running};
    let of_each = [
        Completed,
        Failed,
        Interrupted,
        Completed,
        Running,
        Running,
        Failed,
        Running,
        Pending,
        Pending,
    ];
    assert_eq!(states, of_each);

    let mut tried = HashSet::new();
    Reader::open(&sample.path).unwrap().tried(|key, state| tried.extend([(key, state)])).unwrap();
    let expected = jobs.iter().zip(states).take(8).map(|(job, state)| (job.key(), state));
    assert_eq!(tried, expected.collect::<HashSet<_>>());
}

#[test]
fn an_experiment_without_jobs_is_counted_as_such() {
    let sample = Sample::with(&[]);
    assert_eq!(counts(&sample, "sweep"), Counts::default());
}

#[test]
fn failures_are_reported_with_their_reason_until_the_job_completes() {
    let jobs = [dqn(0.4, 1), dqn(0.4, 2)];
    let mut sample = Sample::with(&jobs);
    sample.run(&jobs[0], &failed());
    sample.run(&jobs[1], &failed());
    sample.session = sample.store.begin_session(&super::sample::provenance()).unwrap();
    sample.run(&jobs[0], &completed());
    sample.run(&jobs[1], &failed());
    let all = Reader::open(&sample.path).unwrap().failed_jobs().unwrap();
    let [one] = all.as_slice() else { panic!("{all:?}") };
    assert_eq!((one.experiment.as_str(), one.agent.as_str()), ("sweep", "dqn"));
    assert_eq!((one.job_key, one.attempt), (jobs[1].key(), 2));
    assert_eq!(Outcome::Failed(one.failure.clone()), failed());
}

#[test]
fn a_job_completed_under_another_version_is_found_by_its_content() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &completed());
    let reader = Reader::open(&sample.path).unwrap();
    let Versions { environment, algorithm } = job.versions();
    let next = Versions { environment, algorithm: algorithm + 1 };
    assert_eq!(reader.superseded(&job.form(), job.versions()).unwrap(), []);
    assert_eq!(reader.superseded(&job.form(), next).unwrap(), [job.versions()]);
    assert_eq!(reader.superseded(&dqn(0.4, 2).form(), next).unwrap(), []);
}

#[test]
fn paces_are_of_jobs_that_differ_in_seeds_alone() {
    let jobs = [dqn(0.4, 1), dqn(0.4, 2), dqn(0.6, 1), reinforce(0.4, 1)];
    let mut sample = Sample::with(&jobs);
    for (job, seconds) in jobs.iter().zip([10.0, 20.0, 5.0, 40.0]) {
        let claim = sample.claim(job);
        sample.store.finish(&claim, &completed(), seconds).unwrap();
    }
    let mut paces = Reader::open(&sample.path).unwrap().paces().unwrap();
    paces.sort_by(|one, other| one.seconds.total_cmp(&other.seconds));
    let found = paces.iter().map(|pace| (pace.job.algorithm(), pace.runs, pace.seconds));
    let expected = [("dueling_dqn", 1, 5.0), ("dueling_dqn", 2, 30.0), ("reinforce", 1, 40.0)];
    assert_eq!(found.collect::<Vec<_>>(), expected);
}

#[test]
fn what_is_left_is_counted_in_jobs_that_differ_in_seeds_alone() {
    let jobs = [dqn(0.4, 1), dqn(0.4, 2), dqn(0.4, 3), reinforce(0.4, 1), reinforce(0.4, 2)];
    let mut sample = Sample::with(&jobs);
    sample.run(&jobs[0], &completed());
    sample.run(&jobs[1], &Outcome::Interrupted);
    sample.claim(&jobs[2]);
    sample.run(&jobs[3], &failed());
    let all = Reader::open(&sample.path).unwrap().experiment_counts().unwrap();
    let left = all[0].left.iter().map(|(job, jobs)| (job.algorithm(), *jobs));
    assert_eq!(left.collect::<Vec<_>>(), [("dueling_dqn", 2), ("reinforce", 1)]);
}

#[test]
fn a_data_set_has_the_planned_jobs_with_what_became_of_them() {
    let with_rate = |learning_rate, seed| Job {
        agent: Agent::of(&DuelingDqn { learning_rate, ..DuelingDqn::default() }),
        ..dqn(0.6, seed)
    };
    let jobs = [with_rate(1e-3, 1), with_rate(5e-4, 2), with_rate(5e-4, 3), reinforce(0.4, 1)];
    let mut sample = Sample::with(&jobs);
    sample.run(&jobs[0], &completed());
    sample.run(&jobs[1], &failed());
    sample.run(&jobs[3], &completed());
    let planned =
        jobs.clone().map(|job| PlannedJob { agent: job.algorithm().into(), form: job.form(), job });
    let parts =
        Parts { curve: true, actions: true, returns: true, estimates: true, posteriors: true };
    let mut seen = 0;
    let reader = Reader::open(&sample.path).unwrap();
    let data = reader.data_set_of("sweep", planned, |_| parts, |_| seen += 1).unwrap();
    let [first, second, third, fourth] = data.jobs.as_slice() else { panic!("{data:?}") };
    assert_eq!((data.experiment.as_str(), seen), ("sweep", 4));
    assert_eq!((first.job_key, first.seed, first.scenario.as_str()), (jobs[0].key(), 1, "P-H-D"));
    assert_eq!(second.number("agent.learning_rate"), Some(5e-4));
    assert!(matches!(&second.status, JobStatus::Failed(failure) if failure.episode == 17));
    assert_eq!(third.status, JobStatus::Pending);
    assert_eq!((&*fourth.agent, fourth.number("environment.sigma")), ("reinforce", Some(0.4)));
    let run = first.completed().unwrap();
    assert_eq!((run.metric("mean_return"), run.metric("sd_return")), (Some(1.0), Some(2.0)));
    assert_eq!((&run.curve[..], &run.returns[..]), (&[(10, 7.5)][..], &[2500.0, 310.0][..]));
    assert_eq!((run.actions[0].count, run.wall_seconds), (17, 1.5));
}

#[test]
fn weights_are_found_by_the_beginning_of_a_key() {
    // At least two keys with the same first digit, and one key with another digit.
    let jobs: Vec<Job> = (1..=40).map(|seed| dqn(0.123_456_789_012_345_67, seed)).collect();
    let mut sample = Sample::with(&jobs);
    let digit = |job: &Job| job.key().to_string().remove(0);
    let first = &jobs[0];
    let same = jobs[1..].iter().find(|job| digit(job) == digit(first)).unwrap();
    let other = jobs.iter().find(|job| digit(job) != digit(first)).unwrap();
    let weights = |prefix: &str| {
        Reader::open(&sample.path).unwrap().weights(prefix).map_err(|e| e.to_string())
    };
    let prefix = digit(first).to_string();
    assert!(weights(&prefix).unwrap_err().contains("has no completed run"));
    sample.run(first, &completed());
    let weights = |prefix: &str| {
        Reader::open(&sample.path).unwrap().weights(prefix).map_err(|e| e.to_string())
    };
    let found = weights(&prefix.to_uppercase()).unwrap();
    assert_eq!((&found.job, found.job_key), (first, first.key()));
    assert_eq!(found.safetensors, Some(vec![8, 0, 0, 0]));
    assert_eq!(weights(&first.key().to_string()).unwrap(), found);
    assert!(weights(&other.key().to_string()).unwrap_err().contains("has no completed run"));
    assert!(weights(&"0".repeat(32)).unwrap_err().starts_with("no job key begins with"));
    for text in ["", "xyz", "a%", &"a".repeat(33)] {
        assert!(weights(text).unwrap_err().contains("is not a job key"), "{text}");
    }
    sample.run(same, &completed());
    let error = Reader::open(&sample.path).unwrap().weights(&prefix).unwrap_err();
    assert!(matches!(&error, StoreError::AmbiguousKey { keys, .. } if keys.len() == 2), "{error}");
}

#[test]
fn the_view_of_parameters_is_the_job() {
    let jobs = [dqn(0.0, 1), reinforce(0.6, u64::from(u32::MAX))];
    let sample = Sample::with(&jobs);
    drop(Store::open(&sample.path).unwrap());
    let raw = sample.raw();
    for job in &jobs {
        let mut statement = raw
            .prepare("SELECT name, value FROM parameter WHERE job_key = ?1 ORDER BY name")
            .unwrap();
        let stored: Vec<(String, Value)> = statement
            .query_map([job.key().to_string()], |row| Ok((row.get(0)?, row.get(1)?)))
            .unwrap()
            .collect::<Result<_, _>>()
            .unwrap();
        let mut expected: Vec<(String, Value)> = job
            .parameters()
            .into_iter()
            .map(|(name, value)| match value {
                Scalar::Real(real) => (name, Value::Real(real)),
                Scalar::Integer(whole) => (name, Value::Integer(whole)),
                Scalar::Text(text) => (name, Value::Text(text)),
            })
            .collect();
        expected.sort_by(|a, b| a.0.cmp(&b.0));
        assert_eq!(stored, expected);
    }
}
