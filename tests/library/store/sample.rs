//! Jobs, results and stores for tests.

use std::path::{Path, PathBuf};

use jitai::agent::{Agent, DecisionRule, DuelingDqn, Reinforce, RuleParameters};
use jitai::env::StepCount;
use jitai::job::metric::{MEAN_RETURN, TERMINATION_RATE, metrics_of};
use jitai::job::{
    ActionCount, CurvePoint, Evaluation, Failure, FailureKind, Job, Metric, MetricPlace, Outcome,
    Provenance, Results, TestEpisode,
};
use jitai::store::{Claim, Claimed, Experiment, Isolation, RetryFailed, SessionId, Store};
use rusqlite::Connection;

/// A store in its own folder, with a session of this process.
pub struct Sample {
    _folder: tempfile::TempDir,
    pub path: PathBuf,
    pub store: Store,
    pub session: SessionId,
}

impl Sample {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("jitai.sqlite");
        let mut store = Store::open(&path).unwrap();
        let session = store.begin_session(&provenance()).unwrap();
        Sample { _folder: folder, path, store, session }
    }

    /// A store whose experiment `sweep` holds these jobs, with the agent name `dqn`.
    pub fn with(jobs: &[Job]) -> Self {
        let mut sample = Sample::new();
        sample.store.register(&experiment("sweep"), jobs.iter().map(|job| ("dqn", job))).unwrap();
        sample
    }

    /// Claims a job, which must be free.
    pub fn claim(&mut self, job: &Job) -> Claim {
        match self
            .store
            .claim(self.session, &job.key(), RetryFailed::Yes, Isolation::Shared)
            .unwrap()
        {
            Claimed::Claimed(claim) => claim,
            other => panic!("the job is not free: {other:?}"),
        }
    }

    /// Claims a job and ends its run.
    pub fn run(&mut self, job: &Job, outcome: &Outcome) {
        let claim = self.claim(job);
        self.store.finish(&claim, outcome, 1.5).unwrap();
    }

    /// A connection to the file that bypasses the library.
    pub fn raw(&self) -> Connection {
        raw(&self.path)
    }

    /// Makes a session look like that of a process that has ended.
    pub fn kill(&self, session: SessionId) {
        let mut child = std::process::Command::new("true").spawn().unwrap();
        child.wait().unwrap();
        let raw = self.raw();
        // The id is private, but its debug output shows it.
        let id: i64 =
            format!("{session:?}").trim_matches(|c: char| !c.is_ascii_digit()).parse().unwrap();
        let rule: String = raw
            .query_row(
                "SELECT sql FROM sqlite_schema WHERE name = 'session_stays_the_same_process'",
                [],
                |row| row.get(0),
            )
            .unwrap();
        // No client could make this change.
        raw.execute_batch("DROP TRIGGER session_stays_the_same_process").unwrap();
        raw.execute("UPDATE session SET process_id = ?1 WHERE id = ?2", (child.id(), id)).unwrap();
        raw.execute_batch(&rule).unwrap();
    }
}

pub fn raw(path: &Path) -> Connection {
    let raw = Connection::open(path).unwrap();
    raw.execute_batch("PRAGMA foreign_keys = ON").unwrap();
    raw
}

/// A number from the file.
pub fn number(raw: &Connection, sql: &str) -> i64 {
    raw.query_row(sql, [], |row| row.get(0)).unwrap_or_else(|error| panic!("{sql}: {error}"))
}

pub fn experiment(name: &str) -> Experiment<'_> {
    Experiment { name, question: Some("Does it learn?"), hypothesis: None, manifest: "format = 1" }
}

pub fn provenance() -> Provenance {
    Provenance {
        code_version: "0.1.0".into(),
        git_revision: "abc1234".into(),
        backend: "ndarray 0.22.1".into(),
        host: std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap().trim().into(),
        processor: "a processor".into(),
    }
}

pub fn dqn(sigma: f64, seed: u64) -> Job {
    Job {
        environment: StepCount::paper(sigma).into(),
        scenario: "P-H-D".parse().unwrap(),
        agent: Agent::of(&DuelingDqn::default()),
        evaluation: Evaluation::default(),
        trial: None,
        seed,
    }
}

pub fn reinforce(sigma: f64, seed: u64) -> Job {
    Job { agent: Agent::of(&Reinforce::default()), ..dqn(sigma, seed) }
}

pub fn rule(sigma: f64, seed: u64) -> Job {
    Job { agent: Agent::of(&RuleParameters::new(DecisionRule::Tailored)), ..dqn(sigma, seed) }
}

/// The smallest valid results.
pub fn results() -> Results {
    Results {
        metrics: (1..)
            .zip(metrics_of(MetricPlace::Test).filter(|name| *name != TERMINATION_RATE))
            .map(|(i, name)| Metric { name, value: f64::from(i) })
            .collect(),
        curve: vec![CurvePoint { episode: 10, metric: MEAN_RETURN, value: 7.5 }],
        episodes: vec![
            TestEpisode { total_reward: 2500.0, length: 50, terminated: false },
            TestEpisode { total_reward: 310.0, length: 7, terminated: true },
        ],
        actions: vec![ActionCount { stratum: Some(18), action: 2, count: 17 }],
        description: None,
        state_names: Vec::new(),
        decisions: Vec::new(),
        participants: Vec::new(),
        weights: Some(vec![8, 0, 0, 0]),
        estimates: Vec::new(),
        posteriors: Vec::new(),
    }
}

pub fn completed() -> Outcome {
    Outcome::Completed(results())
}

pub fn failed() -> Outcome {
    Outcome::Failed(Failure {
        kind: FailureKind::Diverged,
        message: "the loss is not a number".into(),
        episode: 17,
    })
}

/// Results of the size of a real job with the default settings.
pub fn realistic(job: &Job) -> Results {
    let (metrics, weights) = match job.algorithm() {
        // The DQN has one test network: 3 inputs, layers of 128 and 128, and heads of 1 and 4.
        // REINFORCE has a layer of 128 and 4 outputs.
        "dueling_dqn" => (5, 4 * (3 * 128 + 128 + 128 * 128 + 128 + 128 * 5 + 5) + 600),
        "reinforce" => (4, 4 * (3 * 128 + 128 + 128 * 4 + 4) + 400),
        other => panic!("{other} has neither curve nor weights"),
    };
    // Incompressible numbers from a linear congruential generator.
    let mut state = job.seed;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let stride = job.evaluation.curve_stride;
    Results {
        metrics: metrics_of(MetricPlace::Test)
            .filter(|name| *name != TERMINATION_RATE)
            .map(|name| Metric { name, value: uniform() })
            .collect(),
        curve: (1..=job.agent.episodes() / stride)
            .flat_map(|point| {
                metrics_of(MetricPlace::Curve).take(metrics).map(move |m| (point * stride, m))
            })
            .map(|(episode, metric)| CurvePoint { episode, metric, value: uniform() })
            .collect(),
        episodes: (0..job.evaluation.test_episodes)
            .map(|i| TestEpisode {
                total_reward: 3000.0 * uniform(),
                length: 50,
                terminated: i % 9 == 0,
            })
            .collect(),
        actions: (0..80)
            .map(|i: u8| ActionCount { stratum: Some(i / 4), action: i % 4, count: 600 })
            .collect(),
        description: None,
        state_names: Vec::new(),
        decisions: Vec::new(),
        participants: Vec::new(),
        weights: Some((0..weights).map(|_| (256.0 * uniform()) as u8).collect()),
        estimates: Vec::new(),
        posteriors: Vec::new(),
    }
}
