//! The results of a job depend on its content and the code alone.

use std::thread;

#[cfg(feature = "burn")]
use burn::tensor::Device;
use jitai::agent::{
    Activation, Agent, BanditFeatures, DuelingDqn, Engine, LinearThompson, Ppo, Recurrent,
    Reinforce, TerminalTarget, Trunk,
};
use jitai::env::{FirstContext, StepCount, TimeIndicator};
use jitai::job::Evaluation;
use jitai::job::Job;
use jitai::job::{CurvePoint, Outcome, Results};
use jitai::train::{self, Uncontrolled};
use sha2::{Digest, Sha256};

fn job(agent: Agent, seed: u64) -> Job {
    Job {
        environment: StepCount::paper(0.6).into(),
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation { test_episodes: 30, ..Evaluation::default() },
        trial: None,
        seed,
    }
}

fn dueling_dqn() -> Agent {
    Agent::of(&DuelingDqn { episodes: 15, ..DuelingDqn::default() })
}

fn reinforce() -> Agent {
    Agent::of(&Reinforce { episodes: 60, trajectories_per_update: 3, ..Reinforce::default() })
}

fn ppo() -> Agent {
    Agent::of(&Ppo { episodes: 60, lanes: 7, ..Ppo::default() })
}

fn recurrent_ppo() -> Agent {
    let ppo: Ppo = ppo().parameters().unwrap();
    Agent::of(&Ppo { recurrent: Recurrent::Gru, ..ppo })
}

fn recurrent_dqn(engine: Engine) -> Agent {
    Agent::of(&DuelingDqn {
        episodes: 20,
        layers: vec![16],
        recurrent: Recurrent::Gru,
        units: 16,
        batch: 8,
        sequence: 20,
        burn_in: 10,
        update_interval: 5,
        target_period: 40,
        reward_scale: 200.0,
        engine,
        ..DuelingDqn::default()
    })
}

fn linear_thompson() -> Agent {
    Agent::of(&LinearThompson { episodes: 20, warm_up: 3, ..LinearThompson::default() })
}

fn centred() -> Agent {
    let action_centring = true;
    Agent::of(&LinearThompson {
        episodes: 10,
        pi_min: 0.05,
        action_centring,
        smoothing: 0.02,
        features: BanditFeatures::Interactions,
        ..LinearThompson::default()
    })
}

/// Agents that Burn trains; none in a build without it.
fn burn_agents() -> Vec<Agent> {
    if !cfg!(feature = "burn") {
        return Vec::new();
    }
    let dqn: DuelingDqn = dueling_dqn().parameters().unwrap();
    let policy: Reinforce = reinforce().parameters().unwrap();
    let ppo: Ppo = ppo().parameters().unwrap();
    vec![
        Agent::of(&DuelingDqn { engine: Engine::Burn, ..dqn }),
        Agent::of(&Reinforce { engine: Engine::Burn, ..policy }),
        Agent::of(&Ppo { engine: Engine::Burn, recurrent: Recurrent::Gru, ..ppo.clone() }),
        Agent::of(&Ppo { engine: Engine::Burn, ..ppo }),
        recurrent_dqn(Engine::Burn),
    ]
}

/// The device of these agents.
#[cfg(feature = "burn")]
fn device() -> Device {
    #[cfg(feature = "burn-flex")]
    return Device::flex();
    #[cfg(not(feature = "burn-flex"))]
    #[allow(deprecated)]
    return Device::ndarray();
}

fn results(job: &Job) -> Results {
    match train::run(job, &Uncontrolled) {
        Outcome::Completed(results) => results,
        other => panic!("the job did not complete: {other:?}"),
    }
}

#[cfg(feature = "burn")]
#[test]
fn results_do_not_depend_on_burns_global_generator() {
    for agent in burn_agents() {
        let job = job(agent, 1);
        let device = device();
        device.seed(1);
        let first = results(&job);
        device.seed(2);
        assert_eq!(results(&job), first);
    }
}

/// If this test fails, the results of jobs have changed: raise the version of the simulation or of the
/// algorithm in `plan::Job::versions`.
#[test]
fn results_are_what_they_were_to_the_bit() {
    let ended = |job: Job| {
        let results = results(&job);
        let total: f64 = results.episodes.iter().map(|episode| episode.total_reward).sum();
        let weights = Sha256::digest(results.weights.unwrap());
        (total.to_bits(), u32::from_be_bytes(weights[..4].try_into().unwrap()))
    };
    let mut far = job(
        Agent::of(&DuelingDqn {
            episodes: 30,
            activation: Activation::Tanh,
            trunk: Trunk::Separate,
            terminal_target: TerminalTarget::Standard,
            target_period: 50,
            buffer: 200,
            ..DuelingDqn::default()
        }),
        1,
    );
    far.environment.change(|e| e.time_one_hot = true);
    far.environment.change(|e| e.first_context = FirstContext::Sampled);
    far.environment.change(|e| e.time_indicator = TimeIndicator::Exact);
    assert_eq!(
        [
            job(dueling_dqn(), 1),
            job(reinforce(), 1),
            far,
            job(ppo(), 1),
            job(recurrent_ppo(), 1),
            job(recurrent_dqn(Engine::Fused), 1),
            job(linear_thompson(), 1),
            job(centred(), 1)
        ]
        .map(ended),
        [
            (4670428529652141323, 1062691346),
            (4670331052534184363, 1922289694),
            (4668886930363693733, 1792301739),
            (4671132607656521346, 3860758467),
            (4670685639835049108, 2263627423),
            (4669693567461683298, 252659508),
            (4674824841433238729, 1996970840),
            (4669645376591863430, 4266763039)
        ]
    );
}

#[test]
fn results_do_not_depend_on_jobs_that_train_at_the_same_time() {
    let agents = [dueling_dqn(), reinforce(), ppo(), recurrent_ppo(), recurrent_dqn(Engine::Fused)]
        .into_iter()
        .chain(burn_agents());
    let jobs: Vec<Job> = agents.map(|agent| job(agent, 1)).collect();
    let alone: Vec<Results> = jobs.iter().map(results).collect();
    let together: Vec<Results> = thread::scope(|scope| {
        let handles: Vec<_> = jobs.iter().map(|job| scope.spawn(|| results(job))).collect();
        handles.into_iter().map(|handle| handle.join().unwrap()).collect()
    });
    assert!(together == alone);
}

#[test]
fn seeds_and_parameters_change_the_results() {
    let first = results(&job(reinforce(), 1));
    assert_ne!(results(&job(reinforce(), 2)), first);
    let mut other = job(reinforce(), 1);
    other.environment.change(|e| e.sigma = 0.8);
    assert_ne!(results(&other), first);
}

#[test]
fn a_stop_request_ends_a_training_without_a_result() {
    struct StopAfter(std::cell::Cell<u32>);
    impl train::TrainingControl for StopAfter {
        fn report(&self, progress: train::TrainingProgress, _: &[CurvePoint]) {
            assert!(progress.episode <= 1, "it went on to episode {}", progress.episode);
        }
        fn worked(&self) -> std::time::Duration {
            std::time::Duration::ZERO
        }

        fn stop_requested(&self) -> bool {
            self.0.set(self.0.get() + 1);
            // This is called at every step, and an episode has at least three steps.
            self.0.get() > 5
        }
    }
    let outcome = train::run(&job(dueling_dqn(), 1), &StopAfter(std::cell::Cell::new(0)));
    assert_eq!(outcome, Outcome::Interrupted);
}

#[test]
fn the_tested_policy_is_the_one_whose_weights_are_kept() {
    use jitai::agent::{Actions, Weights};
    use jitai::env::{Action, Simulated};
    use jitai::train::{RollStreams, StepObserver, begin, roll};

    struct Total(f64);
    impl StepObserver<Simulated> for Total {
        fn chosen(&mut self, _: &Simulated, _: &[Action], _: &[f64]) {}
        fn paid(&mut self, _: &Simulated, rewards: &[f64]) {
            self.0 += rewards.iter().sum::<f64>();
        }
    }
    for agent in [dueling_dqn(), reinforce(), ppo(), recurrent_ppo(), recurrent_dqn(Engine::Fused)]
        .into_iter()
        .chain(burn_agents())
    {
        let job = job(agent, 1);
        let results = results(&job);
        let weights = Weights::from_bytes(&results.weights.unwrap()).unwrap();
        let mut policy = job.agent.trained(&job.task(), &weights, Actions::AsTrained).unwrap();
        let mut streams = RollStreams::of_test(job.seed);
        let mut lanes = job.task().tested(30);
        let mut total = Total(0.0);
        begin(&mut lanes, &mut *policy, &mut streams);
        roll(&mut lanes, &mut *policy, &mut streams, &mut total);
        let tested: f64 = results.episodes.iter().map(|episode| episode.total_reward).sum();
        assert!((total.0 - tested).abs() < 1e-9 * tested, "{} {tested}", total.0);
    }
}
