//! Jobs and results for the tests of this module.

use crate::job::Job;
use crate::job::metric::{TERMINATION_RATE, metrics_of};
use crate::job::{Metric, MetricPlace, Provenance, Results, TestEpisode};

use super::{Claim, Claimed, Experiment, Isolation, RetryFailed, SessionId, Store};

/// A job of minimal size.
pub(super) fn job() -> Job {
    let canonical = r#"{"agent":{"activation":"relu","algorithm":"dueling_dqn","batch":64,
        "buffer":1000,"engine":"fused","episodes":10,"epsilon_decrement":0.001,
        "epsilon_floor":0.01,"epsilon_start":1.0,"gamma":0.99,"layers":[8],
        "learning_rate":0.0005,"target_period":1000,"terminal_target":"zero",
        "trunk":"shared"},"environment":{"delta_d":0.1,"delta_h":0.1,
        "disengagement_threshold":1.0,"epsilon_d":0.4,"epsilon_h":0.05,
        "first_context":"fixed","horizon":50,"initial_disengagement":0.1,
        "initial_habituation":0.1,"mu":[0.1,0.1],"observed_probability":0,"rho_1":50.0,
        "rho_2":200.0,"sigma":0.4,"time_indicator":"lagged","time_indicator_period":2,
        "time_one_hot":false},"evaluation":{"curve_stride":10,"test_actions":"as_trained",
        "test_episodes":1},"scenario":"P-H-D","seed":1}"#;
    Job::from_canonical(&canonical.split_whitespace().collect::<String>()).unwrap()
}

/// A job with a trial.
pub(super) fn trial() -> Job {
    let canonical = r#"{"agent":{"algorithm":"rule","rule":"random","threshold":0.8},
        "environment":{"delta_d":0.1,"delta_h":0.1,"disengagement_threshold":1.0,"epsilon_d":0.4,
        "epsilon_h":0.05,"first_context":"fixed","horizon":10,"initial_disengagement":0.1,
        "initial_habituation":0.1,"mu":[0.1,0.1],"observed_probability":0,"rho_1":50.0,
        "rho_2":200.0,"sigma":0.4,"time_indicator":"lagged","time_indicator_period":2,
        "time_one_hot":false},"evaluation":{"curve_stride":10,"on":"trial",
        "record_decisions":"test","test_actions":"as_trained","test_episodes":0},
        "scenario":"P-H-D","seed":2,"trial":{"days":10,"decisions_per_day":1,"dropout":0.0,
        "entry":"none","entry_every_days":0,"entry_first_day":0,"entry_people":1,
        "missing_outcomes":0.0,"outage":[],"people":8,"people_file":"none","pooling":"full",
        "unreported":0.0,"update_data":"all","update_every_days":1,"update_first_day":0,
        "update_first_with_people":1,"update_lag_days":0}}"#;
    Job::from_canonical(&canonical.split_whitespace().collect::<String>()).unwrap()
}

/// Minimal results of that job.
pub(super) fn results() -> Results {
    Results {
        metrics: metrics_of(MetricPlace::Test)
            .filter(|name| *name != TERMINATION_RATE)
            .map(|name| Metric { name, value: 1.0 })
            .collect(),
        curve: Vec::new(),
        episodes: vec![TestEpisode { total_reward: 50.0, length: 2, terminated: true }],
        actions: Vec::new(),
        description: None,
        state_names: ["context", "probability", "likely_context", "habituation", "disengagement"]
            .map(str::to_owned)
            .into(),
        decisions: Vec::new(),
        participants: Vec::new(),
        weights: Some(vec![8]),
        posteriors: Vec::new(),
        estimates: Vec::new(),
    }
}

/// Begins a session of this process with made-up provenance.
pub(super) fn begin_session(store: &mut Store) -> SessionId {
    let [code_version, git_revision, backend, host, processor] =
        ["1", "2", "3", "4", "5"].map(str::to_owned);
    let provenance = Provenance { code_version, git_revision, backend, host, processor };
    store.begin_session(&provenance).unwrap()
}

/// Claims a job in a separate experiment.
pub(super) fn claim(store: &mut Store, session: SessionId, job: &Job) -> Claim {
    let name = format!("sweep {}", job.seed);
    let experiment = Experiment { name: &name, question: None, hypothesis: None, manifest: "" };
    store.register(&experiment, [("dqn", job)]).unwrap();
    let claimed = store.claim(session, &job.key(), RetryFailed::No, Isolation::Shared);
    let Ok(Claimed::Claimed(claim)) = claimed else { panic!("{claimed:?}") };
    claim
}
