//! A training resumes from any of its checkpoints with bit-identical results, and rejects everything
//! else.

use std::cell::{Cell, RefCell};
use std::io::{Cursor, Write};
use std::time::Duration;

use jitai::agent::{
    Activation, Agent, AtHorizon, BanditDraw, BanditPosterior, BanditUpdate, DecisionRule,
    DuelingDqn, Engine, LinearThompson, Ppo, Recurrent, Reinforce, RuleParameters, TerminalTarget,
    Trunk,
};
use jitai::env::{FirstContext, Population, StateNoise, StepCount, StepNoise, TimeIndicator};
use jitai::job::{CurvePoint, Outcome, Pooling, Results, Trial, UpdateData};
use jitai::job::{EvaluatedOn, Evaluation, Job, RecordedDecisions};
use jitai::key::{Distribution, Keyed, Value};
use jitai::train::{
    self, CheckpointError, Checkpoints, ReadCheckpoint, Resumed, TrainingControl, TrainingProgress,
    Uncontrolled, WriteCheckpoint,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use sha2::{Digest, Sha256};

/// Length of the hash at the end of a checkpoint, in bytes.
const SEAL: usize = 32;

/// A keeper of checkpoints in memory.
#[derive(Default)]
struct Shelf {
    /// The checkpoint that is offered to a training at its start.
    shown: Option<Vec<u8>>,
    /// The answer of the training to the offered checkpoint.
    answer: RefCell<Option<Result<Resumed, CheckpointError>>>,
    /// The checkpoints that the training wrote.
    kept: RefCell<Vec<Vec<u8>>>,
    /// Steps between two checkpoints, or until the training is stopped; 0 for neither.
    every: u32,
    stops: bool,
    asked: Cell<u32>,
}

impl Shelf {
    /// Requests a checkpoint every `steps` steps.
    fn every(steps: u32) -> Self {
        Shelf { every: steps, ..Shelf::default() }
    }

    /// Offers a checkpoint to a training that is stopped before its first step.
    fn that_only_shows(checkpoint: Vec<u8>) -> Self {
        Shelf { every: 1, stops: true, asked: Cell::new(1), ..Shelf::showing(checkpoint) }
    }

    fn showing(checkpoint: Vec<u8>) -> Self {
        Shelf { shown: Some(checkpoint), ..Shelf::default() }
    }

    fn is_time(&self) -> bool {
        if self.every == 0 || self.asked.get() >= self.every {
            return self.every > 0;
        }
        self.asked.set(self.asked.get() + 1);
        false
    }

    /// The answer of the training to the offered checkpoint.
    #[track_caller]
    fn answer(self) -> Result<Resumed, CheckpointError> {
        self.answer.into_inner().expect("the training asked for a checkpoint")
    }
}

impl Checkpoints for Shelf {
    fn are_due(&self) -> bool {
        !self.stops && self.is_time()
    }

    fn resume(&self, read: &mut ReadCheckpoint<'_>) {
        if let Some(checkpoint) = &self.shown {
            *self.answer.borrow_mut() = Some(read(&mut Cursor::new(checkpoint)));
        }
    }

    fn keep(&self, write: &mut WriteCheckpoint<'_>) {
        let mut kept = Vec::new();
        write(&mut kept).unwrap();
        self.kept.borrow_mut().push(kept);
        self.asked.set(0);
    }
}

/// Time spent on a job, as reported in each of its checkpoints.
const WORKED: Duration = Duration::from_secs(5);

impl TrainingControl for Shelf {
    fn report(&self, _: TrainingProgress, _: &[CurvePoint]) {}

    fn stop_requested(&self) -> bool {
        self.stops && self.is_time()
    }

    fn worked(&self) -> Duration {
        WORKED
    }

    fn checkpoints(&self) -> &dyn Checkpoints {
        self
    }
}

fn job(agent: Agent, change: impl FnOnce(&mut StepCount)) -> Job {
    let mut environment = StepCount { horizon: 5, ..StepCount::paper(0.6) };
    change(&mut environment);
    Job {
        environment: environment.into(),
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation {
            test_episodes: 3,
            curve_stride: 2,
            record_decisions: RecordedDecisions::All,
            first_episodes: vec![1, 4],
            ..Evaluation::default()
        },
        trial: None,
        seed: 4,
    }
}

/// Batch, target period and buffer are so small that all three take effect within 20 steps.
fn dueling_dqn(engine: Engine) -> DuelingDqn {
    DuelingDqn {
        episodes: 5,
        layers: vec![6, 3],
        batch: 4,
        buffer: 9,
        target_period: 3,
        epsilon_decrement: 0.02,
        learning_rate: 0.01,
        engine,
        ..DuelingDqn::default()
    }
}

fn reinforce(engine: Engine, trajectories_per_update: u32) -> Reinforce {
    Reinforce {
        episodes: 6,
        trajectories_per_update,
        layers: vec![5],
        learning_rate: 0.01,
        engine,
        ..Reinforce::default()
    }
}

/// Bandits with every kind of state: learned parameters, state from the start of an episode, and draws
/// for an episode.
fn bandits() -> [(&'static str, LinearThompson); 3] {
    let usual = LinearThompson { episodes: 5, prior_sd: 100.0, ..LinearThompson::default() };
    let centred = LinearThompson {
        action_centring: true,
        pi_min: 0.05,
        warm_up: 2,
        probability_draws: 100,
        posterior: BanditPosterior::Reset,
        ..usual.clone()
    };
    let drawn = LinearThompson {
        draw: BanditDraw::Episode,
        update: BanditUpdate::Episode,
        update_interval: 2,
        pi_min: 0.1,
        ..usual.clone()
    };
    [("bandit", usual), ("centred bandit", centred), ("bandit by episode", drawn)]
}

/// Rollouts end within episodes, and some lanes are idle at the end.
fn ppo(engine: Engine) -> Ppo {
    Ppo {
        episodes: 7,
        lanes: 3,
        steps: 4,
        minibatches: 2,
        epochs: 2,
        layers: vec![5, 3],
        learning_rate: 0.01,
        engine,
        ..Ppo::default()
    }
}

/// Jobs with noise, and with everything that lanes remember.
fn beyond_the_paper(agent: &Agent) -> [(&'static str, Job); 3] {
    let of_state = job(agent.clone(), |environment| {
        environment.state_noise = StateNoise::Uniform;
        environment.state_spread = 0.5;
    });
    let uniform = job(agent.clone(), |environment| {
        environment.state_noise = StateNoise::Uniform;
        environment.state_spread = 0.5;
        environment.parameter_spread = 0.5;
        environment.context_persistence = 0.5;
        environment.unpaid_last_step = true;
    });
    let mut beta = job(agent.clone(), |environment| {
        environment.state_noise = StateNoise::Beta;
        (environment.kappa_h, environment.kappa_d) = (10.0, 10.0);
        environment.step_noise = StepNoise::Gamma;
        environment.sigma_s = 10.0;
        environment.context_probability = 0.3;
        environment.availability = 0.7;
        environment.message_cost = 5.0;
        environment.message_budget = 3;
    });
    beta.scenario = "P-M-S-A-B-D-H".parse().unwrap();
    [("uniform noise of the state", of_state), ("uniform", uniform), ("beta", beta)]
}

/// The job with participants who differ in every kind of parameter: dynamics, noise, contexts and
/// costs.
fn of_people(job: Job) -> Job {
    let population = Population {
        sigma: Distribution::Uniform([0.2, 1.0]),
        epsilon_d: Distribution::Uniform([0.1, 0.7]),
        context_probability: Distribution::Uniform([0.3, 0.7]),
        state_spread: Distribution::Uniform([0.1, 0.5]),
        message_cost: Distribution::Values { values: vec![0.0, 4.0], weights: vec![1.0, 2.0] },
        ..Population::default()
    };
    let parameters = job.task().model().parameters.clone();
    Job { environment: (parameters, population).into(), ..job }
}

/// The job in a trial with overlapping stays, in which not everything happens as planned.
fn in_trial(job: Job, pooling: Pooling) -> Job {
    let trial = Trial {
        entry_every_days: 4,
        entry_people: 2,
        pooling,
        update_every_days: 2,
        update_data: UpdateData::InStudy,
        update_lag_days: 1,
        outage: vec![6, 7],
        dropout: 0.1,
        missing_outcomes: 0.2,
        unreported: 0.4,
        ..Trial::with_required(&[Value::Integer(6), Value::Integer(5)])
    };
    let evaluation =
        Evaluation { test_episodes: 0, on: EvaluatedOn::Trial, ..job.evaluation.clone() };
    Job { trial: Some(trial), evaluation, ..job }
}

/// Short jobs that cover every kind of state.
fn small_jobs() -> Vec<(String, Job)> {
    let mut jobs = Vec::new();
    for &engine in Engine::BUILT {
        let shared = Agent::of(&dueling_dqn(engine));
        let separate = Agent::of(&DuelingDqn {
            trunk: Trunk::Separate,
            activation: Activation::Tanh,
            terminal_target: TerminalTarget::Standard,
            ..dueling_dqn(engine)
        });
        let one = Agent::of(&reinforce(engine, 1));
        let three = Agent::of(&reinforce(engine, 3));
        let clipped = Agent::of(&ppo(engine));
        let cut = Agent::of(&Ppo {
            at_horizon: AtHorizon::Truncation,
            clip_value_loss: true,
            target_kl: 1e-6,
            epochs: 3,
            layers: vec![4],
            activation: Activation::Relu,
            ..ppo(engine)
        });
        let remembering =
            Agent::of(&Ppo { recurrent: Recurrent::Gru, units: 3, minibatches: 2, ..ppo(engine) });
        let whole = DuelingDqn {
            recurrent: Recurrent::Gru,
            units: 3,
            batch: 2,
            buffer: 16,
            reward_scale: 200.0,
            update_interval: 2,
            ..dueling_dqn(engine)
        };
        let burning_in = DuelingDqn {
            sequence: 2,
            burn_in: 1,
            layers: vec![4],
            terminal_target: TerminalTarget::Standard,
            ..whole.clone()
        };
        for (name, agent) in [
            ("recurrent", Agent::of(&whole)),
            ("burning in", Agent::of(&burning_in)),
            ("shared", shared),
            ("separate", separate),
            ("one", one),
            ("three", three),
            ("clipped", clipped),
            ("cut", cut),
            ("remembering", remembering),
        ] {
            jobs.push((format!("{name} {engine:?}"), job(agent.clone(), |_| {})));
            let with_clock = job(agent.clone(), |environment| {
                environment.time_one_hot = true;
                environment.time_indicator = TimeIndicator::Exact;
                environment.first_context = FirstContext::Sampled;
            });
            jobs.push((format!("{name} {engine:?} with one-hot"), with_clock));
            let [of_state, uniform, beta] = beyond_the_paper(&agent);
            jobs.push((format!("{name} {engine:?} of people"), of_people(uniform.1.clone())));
            for (version, beyond) in [of_state, uniform, beta] {
                jobs.push((format!("{name} {engine:?} {version}"), beyond));
            }
            let remembering = job(agent.with_history(3), |_| {});
            jobs.push((format!("{name} {engine:?} with history"), remembering));
        }
    }
    let policy = Agent::of(&reinforce(Engine::Fused, 1));
    let [of_state, ..] = beyond_the_paper(&policy);
    let few = job(policy.clone(), |environment| environment.belief_particles = 8);
    for (name, mut job) in [
        ("exact contexts", job(policy.clone(), |_| {})),
        ("few particles", few),
        ("particles", of_state.1),
    ] {
        job.scenario = "F-E-R".parse().unwrap();
        jobs.push((format!("Fused with beliefs by {name}"), job));
    }
    for (name, bandit) in bandits() {
        let agent = Agent::of(&bandit);
        jobs.push((name.to_owned(), job(agent.clone(), |_| {})));
        jobs.push((format!("{name} of people"), of_people(job(agent.clone(), |_| {}))));
        jobs.push((format!("{name} with history"), job(agent.clone().with_history(2), |_| {})));
        for pooling in [Pooling::Full, Pooling::None, Pooling::Partial, Pooling::Groups(2)] {
            let trial = in_trial(of_people(job(agent.clone(), |_| {})), pooling);
            jobs.push((format!("{name} in a trial, {pooling:?}"), trial));
        }
    }
    let random = Agent::of(&RuleParameters::new(DecisionRule::Random));
    jobs.push(("rule in a trial".to_owned(), in_trial(job(random, |_| {}), Pooling::Full)));
    jobs
}

#[track_caller]
fn completed(outcome: Outcome) -> Results {
    match outcome {
        Outcome::Completed(results) => results,
        other => panic!("the job did not complete: {other:?}"),
    }
}

#[track_caller]
fn assert_same_bits(ours: &Results, theirs: &Results, what: &str) {
    let bits = |results: &Results| {
        let metrics: Vec<u64> = results.metrics.iter().map(|m| m.value.to_bits()).collect();
        let curve: Vec<u64> = results.curve.iter().map(|point| point.value.to_bits()).collect();
        let returns: Vec<u64> = results.episodes.iter().map(|e| e.total_reward.to_bits()).collect();
        (metrics, curve, returns, results.weights.clone())
    };
    assert!(ours == theirs && bits(ours) == bits(theirs), "{what}: other results");
}

/// All checkpoints of a job (one before each step except the first), and its results.
fn every_checkpoint(job: &Job) -> (Vec<Vec<u8>>, Results) {
    let shelf = Shelf::every(1);
    let results = completed(train::run(job, &shelf));
    (shelf.kept.into_inner(), results)
}

#[test]
fn small_jobs_resume_from_every_checkpoint_to_the_same_bits() {
    for (name, job) in small_jobs() {
        let undisturbed = completed(train::run(&job, &Uncontrolled));
        let (kept, interrupted) = every_checkpoint(&job);
        assert_same_bits(&interrupted, &undisturbed, &name);
        // About twenty steps of training, and the steps of the test.
        assert!(kept.len() > 10, "{name}: {} checkpoints", kept.len());
        for (step, checkpoint) in kept.into_iter().enumerate() {
            let shelf = Shelf::showing(checkpoint);
            let results = completed(train::run(&job, &shelf));
            assert_same_bits(&results, &undisturbed, &format!("{name}, checkpoint {step}"));
            shelf.answer().unwrap();
        }
    }
}

#[test]
fn a_job_that_is_stopped_at_every_step_ends_in_the_same_bits() {
    for (name, job) in small_jobs() {
        let undisturbed = completed(train::run(&job, &Uncontrolled));
        let mut shelf = Shelf { stops: true, ..Shelf::every(1) };
        let mut stops = 0;
        let results = loop {
            match train::run(&job, &shelf) {
                Outcome::Interrupted => stops += 1,
                other => break completed(other),
            }
            let kept = shelf.kept.borrow_mut().pop().expect("a stopped training leaves one");
            shelf = Shelf { stops: true, every: 1, ..Shelf::showing(kept) };
        };
        assert!(stops > 10, "{name}: {stops} stops");
        assert_same_bits(&results, &undisturbed, &name);
    }
}

#[test]
fn larger_jobs_resume_from_checkpoints_anywhere_to_the_same_bits() {
    let mut chance = ChaCha8Rng::seed_from_u64(1);
    let dqn = DuelingDqn { episodes: 40, buffer: 700, ..DuelingDqn::default() };
    let policy = Reinforce { episodes: 600, trajectories_per_update: 20, ..Reinforce::default() };
    let ppo = Ppo { episodes: 600, lanes: 20, steps: 33, ..Ppo::default() };
    for agent in [Agent::of(&dqn), Agent::of(&policy), Agent::of(&ppo)] {
        let mut job = job(agent, |environment| environment.horizon = 50);
        // The test needs more than one batch of lanes.
        job.evaluation.test_episodes = 1500;
        let undisturbed = completed(train::run(&job, &Uncontrolled));
        let shelf = Shelf::every(17);
        assert_same_bits(&completed(train::run(&job, &shelf)), &undisturbed, "kept");
        let kept = shelf.kept.into_inner();
        assert!(kept.len() > 20, "{} checkpoints", kept.len());
        for _ in 0..20 {
            let chosen = chance.next_u32() as usize % kept.len();
            let results = completed(train::run(&job, &Shelf::showing(kept[chosen].clone())));
            assert_same_bits(&results, &undisturbed, &format!("checkpoint {chosen}"));
        }
    }
}

/// A checkpoint of a small job in the middle of its training.
fn a_checkpoint() -> (Job, Vec<u8>) {
    let agent = Reinforce { layers: vec![2], ..reinforce(Engine::Fused, 2) };
    let mut job = job(Agent::of(&agent), |_| {});
    // No decisions of the training are recorded, to keep the checkpoint small: every byte is tested.
    job.evaluation.record_decisions = RecordedDecisions::Test;
    let (kept, _) = every_checkpoint(&job);
    let checkpoint = kept[7].clone();
    assert!(checkpoint.len() < 4000, "{} bytes", checkpoint.len());
    (job, checkpoint)
}

fn shown(job: &Job, checkpoint: Vec<u8>) -> Result<Resumed, CheckpointError> {
    let shelf = Shelf::that_only_shows(checkpoint);
    assert_eq!(train::run(job, &shelf), Outcome::Interrupted);
    shelf.answer()
}

#[test]
fn a_checkpoint_with_any_byte_changed_is_refused_and_the_job_starts_over() {
    let (job, checkpoint) = a_checkpoint();
    assert!(shown(&job, checkpoint.clone()).is_ok());
    for place in 0..checkpoint.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut damaged = checkpoint.clone();
            damaged[place] ^= flip;
            let refused = shown(&job, damaged);
            assert!(refused.is_err(), "byte {place} with {flip:#x}: {refused:?}");
        }
    }
    let undisturbed = completed(train::run(&job, &Uncontrolled));
    let mut damaged = checkpoint;
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    let shelf = Shelf::showing(damaged);
    assert_same_bits(&completed(train::run(&job, &shelf)), &undisturbed, "started over");
    assert!(matches!(shelf.answer(), Err(CheckpointError::Damaged)));
}

#[test]
fn a_checkpoint_of_any_other_length_is_refused() {
    let (job, checkpoint) = a_checkpoint();
    for length in 0..checkpoint.len() {
        let refused = shown(&job, checkpoint[..length].to_vec());
        assert!(matches!(refused, Err(CheckpointError::Damaged)), "{length} bytes: {refused:?}");
    }
    for more in [1, SEAL, 4096] {
        let mut longer = checkpoint.clone();
        longer.extend(vec![0; more]);
        assert!(matches!(shown(&job, longer), Err(CheckpointError::Damaged)));
    }
}

/// The checkpoint with changed text and a recomputed hash.
fn rewritten(checkpoint: &[u8], from: &str, to: &str) -> Vec<u8> {
    let body = &checkpoint[..checkpoint.len() - SEAL];
    let at = body.windows(from.len()).position(|text| text == from.as_bytes()).unwrap();
    let mut changed = [&body[..at], to.as_bytes(), &body[at + from.len()..]].concat();
    let seal = Sha256::digest(&changed);
    changed.extend(&seal[..]);
    changed
}

#[test]
fn a_checkpoint_of_other_code_or_another_job_is_refused_and_says_so() {
    let (job, checkpoint) = a_checkpoint();
    let says = |from: &str, to: &str| {
        shown(&job, rewritten(&checkpoint, from, to)).unwrap_err().to_string()
    };
    let format = String::from_utf8_lossy(&checkpoint).lines().next().unwrap().to_owned();
    assert_eq!(says(&format, "jitai checkpoint 2"), "written by another release of jitai");
    let release = format!("\"release\":\"{}\"", env!("CARGO_PKG_VERSION"));
    let other = says(&release, "\"release\":\"9.8.7\"");
    assert!(other.starts_with("written by different code: jitai 9.8.7, simulation 1"), "{other}");
    let algorithm = format!("\"algorithm\":{}", job.versions().algorithm);
    let other = says(&algorithm, "\"algorithm\":700");
    assert!(other.contains("algorithm 700"), "{other}");
    let other = says("\"environment\":1", "\"environment\":7");
    assert!(other.contains("simulation 7"), "{other}");

    let mut sibling = job.clone();
    sibling.seed += 1;
    let refused = shown(&sibling, checkpoint).unwrap_err().to_string();
    assert_eq!(refused, format!("belongs to another job, {}", job.key()));
}

/// The bytes of each state that are changed, about: many bytes are parts of equal numbers. `make test-damage` changes
/// every byte.
const CHANGED: usize = 500;

#[test]
fn states_that_make_no_sense_are_no_reason_to_panic() {
    no_changed_state_panics(|name| name.contains("Fused"));
}

#[test]
fn other_states_that_make_no_sense_are_no_reason_to_panic() {
    no_changed_state_panics(|name| !name.contains("Fused"));
}

fn no_changed_state_panics(chosen: impl Fn(&str) -> bool) {
    let changes_all = std::env::var_os("JITAI_EVERY_BYTE").is_some();
    for (name, job) in small_jobs().into_iter().filter(|(name, _)| chosen(name)) {
        let (kept, _) = every_checkpoint(&job);
        let checkpoint = &kept[kept.len() / 2];
        let state =
            1 + checkpoint.iter().enumerate().filter(|(_, b)| **b == b'\n').nth(1).unwrap().0;
        // An odd number of bytes apart, all parts of all numbers are met. Burn takes long to start.
        let bytes = checkpoint.len() - SEAL - state;
        let stride = match (name.contains("Burn"), changes_all) {
            (true, true) => 31,
            (true, false) => 93,
            (false, true) => 1,
            (false, false) => bytes.div_ceil(CHANGED) | 1,
        };
        for index in (state..checkpoint.len() - SEAL).step_by(stride) {
            let mut changed = checkpoint[..checkpoint.len() - SEAL].to_vec();
            changed[index] ^= 0xff;
            let seal = Sha256::digest(&changed);
            changed.extend(&seal[..]);
            // Whether the text is accepted or not, nothing panics, and memory is allocated only for
            // existing data.
            let shelf = Shelf::that_only_shows(changed);
            let outcome = train::run(&job, &shelf);
            // Where the changed state says that everybody has left, the trial is over.
            assert!(matches!(outcome, Outcome::Interrupted | Outcome::Completed(_)), "{outcome:?}");
            let _ = shelf.answer();
        }
    }
}

#[test]
fn a_checkpoint_says_how_far_it_is_and_what_it_took() {
    let job = job(Agent::of(&dueling_dqn(Engine::Fused)), |_| {});
    let (kept, _) = every_checkpoint(&job);
    let resumed: Vec<Resumed> =
        kept.into_iter().map(|checkpoint| shown(&job, checkpoint).unwrap()).collect();
    assert!(resumed.is_sorted_by_key(|resumed| resumed.episode));
    assert_eq!((resumed[0].episode, resumed.last().unwrap().episode), (0, 5));
    assert!(resumed.iter().all(|resumed| resumed.worked == WORKED));
}

#[test]
fn a_training_whose_checkpoints_cannot_be_kept_continues() {
    struct Full;
    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    struct FullDisk(Cell<u32>);
    impl Checkpoints for FullDisk {
        fn are_due(&self) -> bool {
            self.0.set(self.0.get() + 1);
            self.0.get().is_multiple_of(5)
        }

        fn resume(&self, _: &mut ReadCheckpoint<'_>) {}

        fn keep(&self, write: &mut WriteCheckpoint<'_>) {
            write(&mut Full).unwrap_err();
        }
    }
    impl TrainingControl for FullDisk {
        fn report(&self, _: TrainingProgress, _: &[CurvePoint]) {}

        fn stop_requested(&self) -> bool {
            false
        }

        fn worked(&self) -> Duration {
            WORKED
        }

        fn checkpoints(&self) -> &dyn Checkpoints {
            self
        }
    }
    let (job, _) = a_checkpoint();
    let results = completed(train::run(&job, &FullDisk(Cell::new(0))));
    assert_same_bits(&results, &completed(train::run(&job, &Uncontrolled)), "full disk");
}
