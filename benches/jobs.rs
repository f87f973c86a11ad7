//! Whole jobs in the published settings, P-H-D at sigma 0.6 (training and 1000 test episodes), and
//! their checkpoints.

use std::cell::{Cell, RefCell};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use divan::Bencher;
use jitai::agent::{
    Actions, Actor, Agent, BanditAllocation, DuelingDqn, Engine, LinearThompson,
    LinearThompsonStudy, PersonSd, Ppo, Recurrent, Reinforce, Rewards, Sharing, StudyAgent,
    StudyPlan, StudyUpdate, linear_thompson_learner,
};
use jitai::env::{
    Action, Environment, Family, LaneSet, LaneStreams, PhysicalActivity, Scenario, StepCount,
    VectorEnvironment,
};
use jitai::estimate::Estimation;
use jitai::experiment::{self, Filter};
use jitai::job::Evaluation;
use jitai::job::Job;
use jitai::job::{CurvePoint, Outcome};
use jitai::job::{
    Decision, EstimateDeclaration, Estimator, Messages, Phase, StandardErrors, Treatment,
};
use jitai::key::{Content, Kind, Value};
use jitai::rng::{Purpose, Stream};
use jitai::train::{
    self, Checkpoints, ReadCheckpoint, TrainingControl, TrainingProgress, Uncontrolled,
    WriteCheckpoint,
};

fn main() {
    divan::main();
}

fn job(agent: Agent, time_one_hot: bool) -> Job {
    Job {
        environment: StepCount { time_one_hot, ..StepCount::paper(0.6) }.into(),
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation { curve_stride: 500, ..Evaluation::default() },
        trial: None,
        seed: 1,
    }
}

fn run(agent: Agent, time_one_hot: bool) {
    let job = job(agent, time_one_hot);
    assert!(matches!(train::run(&job, &Uncontrolled), Outcome::Completed(_)));
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [false, true])]
fn dueling_dqn(time_one_hot: bool) {
    run(Agent::of(&DuelingDqn::default()), time_one_hot);
}

#[divan::bench(sample_count = 5, sample_size = 1, args = [false, true])]
fn reinforce(time_one_hot: bool) {
    run(Agent::of(&Reinforce::default()), time_one_hot);
}

/// 15,000 updates of 50 trajectories.
#[divan::bench(sample_count = 5, sample_size = 1, args = [false, true])]
fn reinforce_of_50(time_one_hot: bool) {
    let reinforce =
        Reinforce { episodes: 750_000, trajectories_per_update: 50, ..Reinforce::default() };
    run(Agent::of(&reinforce), time_one_hot);
}

/// A tenth of the budget, to compare Burn with the kernels.
#[divan::bench(sample_count = 5, sample_size = 1, args = Engine::BUILT)]
fn a_tenth_of_dueling_dqn(engine: Engine) {
    run(Agent::of(&DuelingDqn { episodes: 100, engine, ..DuelingDqn::default() }), false);
}

/// A tenth of the budget, to compare Burn with the kernels.
#[divan::bench(sample_count = 5, sample_size = 1, args = Engine::BUILT)]
fn a_tenth_of_reinforce(engine: Engine) {
    run(Agent::of(&Reinforce { episodes: 1500, engine, ..Reinforce::default() }), false);
}

/// Bandits; `probabilities` is how they compute the probabilities of actions.
fn bandit(probabilities: &str) -> LinearThompson {
    let usual = LinearThompson::default();
    match probabilities {
        "draws" => LinearThompson { action_centring: true, pi_min: 0.05, ..usual },
        _ => usual,
    }
}

/// 1500 episodes of 50 steps in C-H-D, and one test episode.
#[divan::bench(sample_count = 5, sample_size = 1, args = ["integral", "draws"])]
fn linear_thompson(probabilities: &str) {
    let mut job = job(Agent::of(&bandit(probabilities)), false);
    job.scenario = "C-H-D".parse().unwrap();
    job.evaluation.test_episodes = 1;
    assert!(matches!(train::run(&job, &Uncontrolled), Outcome::Completed(_)));
}

/// A trial of a model of Oralytics with invented people: 9800 decisions and 33 weekly updates with the data of everybody in V2,
/// 10,080 and 27 in V1.
#[divan::bench(sample_count = 40, sample_size = 1, args = ["updates", "rewards_v1"])]
fn a_trial(bencher: Bencher<'_, '_>, name: &str) {
    let path = format!("experiments/oralytics/{name}.toml");
    let manifest = experiment::load(Path::new(&path)).unwrap();
    let filter: Filter = match name {
        "updates" => "agent=thompson,update_every_days=7,pooling=full,seed=1".parse().unwrap(),
        _ => "agent=thompson,seed=1".parse().unwrap(),
    };
    let planned = experiment::jobs(&manifest).find(|planned| filter.meets(planned)).unwrap();
    bencher.bench_local(|| {
        assert!(matches!(train::run(&planned.job, &Uncontrolled), Outcome::Completed(_)));
    });
}

/// A model of 140 decisions with seven features, which with the intercept are eight.
fn seven_features() -> Environment {
    let names: Vec<String> = (1..8).map(|number| format!("x{number}")).collect();
    let drawn = names.iter().map(|name| format!("{name} = {{ uniform = [-1, 1] }}\n"));
    let features = names.iter().map(|name| format!("{{ name = \"{name}\", low = -1, high = 1 }}"));
    let text = format!(
        "format = 1\ntitle = \"seven\"\nunit = \"reward\"\ndays = 140\n[person]\nown = {{ gaussian = [0, 1] }}\n\
         [variables]\n{}reward = {{ gaussian = [\"x1 + action * (own + {})\", 1] }}\n\
         [roles]\noutcome = \"reward\"\nfeatures = [{}]\n",
        drawn.collect::<String>(),
        names.join(" + "),
        features.collect::<Vec<_>>().join(", "),
    );
    let family = Family::named("declared").unwrap();
    let values = family.keys.iter().map(|key| match key.kind {
        Kind::Content(form) if key.name == "model" => {
            Value::Content(Content::read(form, &text).unwrap())
        }
        Kind::Content(_) => Value::Content(Content::default()),
        _ => Value::Integer(0),
    });
    (family.read)(family, &values.collect::<Vec<_>>(), &[]).unwrap()
}

/// An update of partial pooling after 140 decisions of each of 100 people with eight features, whose decisions have not
/// counted before.
#[divan::bench(
    sample_count = 10,
    sample_size = 1,
    args = ["given", "estimated", "centred, given", "centred, estimated"]
)]
fn an_update_of_partial_pooling(bencher: Bencher<'_, '_>, name: &str) {
    let bandit = LinearThompson {
        noise_sd: 1.0,
        allocation: BanditAllocation::Clipped,
        pi_min: 0.1,
        action_centring: name.contains("centred"),
        person_sd: if name.contains("given") { PersonSd::Same(0.5) } else { PersonSd::Estimated },
        ..LinearThompson::default()
    };
    let (environment, everybody) = (seven_features(), [true; 100]);
    let played = || {
        let mut lanes = environment.testing(&"all".parse().unwrap(), 1, 100);
        let plan = StudyPlan {
            people: 100,
            decisions: 140,
            sharing: Sharing::Partial,
            keeps_updates: false,
        };
        let mut agent = LinearThompsonStudy::new(&bandit, &lanes, plan, 1);
        let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
        let mut choices = Stream::new(1, Purpose::TestActions);
        let (mut actions, mut rewards) = (vec![Action::default(); 100], vec![0.0; 100]);
        lanes.reset(LaneSet::All, &mut streams);
        for _ in 0..140 {
            agent.act(&lanes, &mut choices, &mut actions, None);
            lanes.step(&actions, &mut rewards, &mut streams);
            agent.observe(&lanes, Rewards::all(&rewards));
        }
        agent
    };
    bencher.with_inputs(played).bench_local_refs(|agent| {
        agent.update(&StudyUpdate { people: &everybody, before: 140, agent: None }).unwrap();
    });
}

/// A decision for each of 1000 people, in the state of their tenth step, with the posterior after 100
/// episodes.
#[divan::bench(sample_count = 20, sample_size = 1, args = ["integral", "draws"])]
fn a_thousand_decisions(bencher: Bencher<'_, '_>, probabilities: &str) {
    let scenario: Scenario = "C-H-D".parse().unwrap();
    let simulation = PhysicalActivity::new(&StepCount::paper(0.6), &scenario, 1);
    let mut lanes = simulation.with_lanes(1000);
    let mut learner = linear_thompson_learner(&bandit(probabilities), simulation, 1).unwrap();
    learner.train(100).unwrap();
    let mut policy = learner.policy(Actions::AsTrained);
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
    let mut choices = Stream::new(1, Purpose::TestActions);
    let (mut actions, mut chances) = (vec![Action::default(); 1000], vec![[0.0; 4]; 1000]);
    lanes.reset(LaneSet::All, &mut streams);
    for _ in 0..10 {
        policy.act(&lanes, &mut choices, &mut actions, None);
        lanes.step(&actions, &mut vec![0.0; 1000], &mut streams);
    }
    bencher.bench_local(|| {
        policy.act(&lanes, &mut choices, &mut actions, Some(chances.as_flattened_mut()))
    });
}

/// Sizes of PPO: lanes, steps per rollout, minibatches and epochs. The network has two layers of 64.
const LARGE: [u32; 4] = [64, 50, 4, 4];
const SMALL: [u32; 4] = [8, 256, 32, 10];

fn ppo(engine: Engine, [lanes, steps, minibatches, epochs]: [u32; 4]) -> Ppo {
    Ppo { episodes: 2000, lanes, steps, minibatches, epochs, engine, ..Ppo::default() }
}

/// Trains where nobody disengages, so that every episode has 50 steps, and plays one test episode.
fn train_ppo(parameters: &Ppo) {
    let mut job = job(Agent::of(parameters), false);
    job.environment.change(|environment| environment.epsilon_d = 0.0);
    job.evaluation.test_episodes = 1;
    assert!(matches!(train::run(&job, &Uncontrolled), Outcome::Completed(_)));
}

/// 100,000 steps, 64 lanes of 50 steps in minibatches of 800, 4 epochs.
#[divan::bench(sample_count = 5, sample_size = 1, args = Engine::BUILT)]
fn ppo_of_64_lanes(engine: Engine) {
    train_ppo(&ppo(engine, LARGE));
}

/// 100,000 steps, 8 lanes of 256 steps in minibatches of 64, 10 epochs.
#[divan::bench(sample_count = 5, sample_size = 1, args = Engine::BUILT)]
fn ppo_of_8_lanes(engine: Engine) {
    train_ppo(&ppo(engine, SMALL));
}

/// 32,000 steps with a GRU of 64 units behind a layer of 64, 64 lanes of 50 steps in minibatches of
/// 800, 4 epochs.
#[divan::bench(sample_count = 5, sample_size = 1, args = Engine::BUILT)]
fn ppo_with_a_gru(engine: Engine) {
    let layers = vec![64];
    let recurrent = Recurrent::Gru;
    train_ppo(&Ppo { episodes: 640, layers, recurrent, ..ppo(engine, LARGE) });
}

/// Times the checkpoint that a training writes when it is stopped after this number of steps.
struct Timer<'a, 'b> {
    bencher: RefCell<Option<Bencher<'a, 'b>>>,
    steps_left: Cell<u32>,
    file: RefCell<File>,
}

impl Checkpoints for Timer<'_, '_> {
    fn are_due(&self) -> bool {
        false
    }

    fn resume(&self, _: &mut ReadCheckpoint<'_>) {}

    fn keep(&self, write: &mut WriteCheckpoint<'_>) {
        let bencher = self.bencher.take().expect("a stopped training leaves one checkpoint");
        bencher.bench_local(|| {
            let mut file: &File = &self.file.borrow();
            file.set_len(0).and_then(|()| write(&mut file)).and_then(|()| file.flush()).unwrap();
            file.sync_all().unwrap();
        });
    }
}

impl TrainingControl for Timer<'_, '_> {
    fn report(&self, _: TrainingProgress, _: &[CurvePoint]) {}

    fn stop_requested(&self) -> bool {
        self.steps_left.set(self.steps_left.get().saturating_sub(1));
        self.steps_left.get() == 0
    }

    fn worked(&self) -> Duration {
        Duration::ZERO
    }

    fn checkpoints(&self) -> &dyn Checkpoints {
        self
    }
}

/// A checkpoint of a dueling DQN with this number of transitions in its replay buffer, synced to the
/// disk.
#[divan::bench(sample_count = 10, sample_size = 1, args = [1_000, 50_000, 1_000_000])]
fn checkpoint(bencher: Bencher<'_, '_>, transitions: u32) {
    // This agent only fills its buffer.
    let dqn = DuelingDqn { episodes: transitions, batch: 1_000_000, ..DuelingDqn::default() };
    let timer = Timer {
        bencher: RefCell::new(Some(bencher)),
        steps_left: Cell::new(transitions),
        file: RefCell::new(tempfile::tempfile_in(".").unwrap()),
    };
    let outcome = train::run(&job(Agent::of(&dqn), false), &timer);
    assert_eq!(outcome, Outcome::Interrupted);
}

/// The effect of a message in a trial of 70 people with 140 decisions each, 8 control features and 2 moderators.
#[divan::bench(sample_count = 100, sample_size = 1)]
fn wcls(bencher: Bencher<'_, '_>) {
    let names: Vec<String> = (0..8).map(|number| format!("x{number}")).collect();
    let mut stream = Stream::new(1, Purpose::TestEnvironment);
    let mut decision = |place: u32| {
        let action = (stream.unit() < 0.3) as u8;
        Decision {
            phase: Phase::Test,
            episode: 1 + place / 140,
            step: place % 140,
            state: names.iter().map(|_| stream.unit()).collect(),
            available: true,
            can_send: true,
            chosen: action,
            action,
            probabilities: [0.7, 0.3].into(),
            reward: stream.unit(),
            cost: 0.0,
            terminated: false,
            truncated: false,
        }
    };
    let decisions: Vec<Decision> = (0..70 * 140).map(&mut decision).collect();
    let declaration = Arc::new(EstimateDeclaration {
        against: None,
        control: names.clone(),
        estimator: Estimator::Wcls,
        less_costs: false,
        moderators: names[..2].to_vec(),
        name: "effect".to_owned(),
        numerator: 0.3,
        outcome: "reward".to_owned(),
        policy: None,
        standard_errors: StandardErrors::Nominal,
        steps: 1,
        treatment: Treatment::Messages(Messages::Any),
        truth: false,
    });
    bencher.bench_local(|| {
        let mut estimation = Estimation::new(declaration.clone(), 2, &names.clone().into());
        decisions.iter().for_each(|decision| estimation.add(decision));
        let estimates = estimation.finish();
        assert!(estimates.terms.iter().all(|term| term.effect.is_ok()));
        estimates
    });
}
