//! Whole jobs in the published settings, P-H-D at sigma 0.6: training and 1000 test episodes; and
//! checkpoints of them.

use std::cell::{Cell, RefCell};
use std::fs::File;
use std::io::Write;
use std::time::Duration;

use divan::Bencher;
use jitai::agent::{Agent, DuelingDqn, Engine, Reinforce};
use jitai::env::Environment;
use jitai::manifest::Evaluation;
use jitai::plan::Job;
use jitai::record::Outcome;
use jitai::train::{
    self, Checkpoints, ReadCheckpoint, TrainingControl, TrainingProgress, Uncontrolled,
    WriteCheckpoint,
};

fn main() {
    divan::main();
}

fn job(agent: Agent, time_one_hot: bool) -> Job {
    Job {
        environment: Environment { time_one_hot, ..Environment::paper(0.6) },
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation { curve_stride: 500, ..Evaluation::default() },
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

/// A tenth of the budget, by Burn and by the kernels, to compare.
#[divan::bench(sample_count = 5, sample_size = 1, args = [Engine::Fused, Engine::Burn])]
fn a_tenth_of_dueling_dqn(engine: Engine) {
    run(Agent::of(&DuelingDqn { episodes: 100, engine, ..DuelingDqn::default() }), false);
}

/// A tenth of the budget, by Burn and by the kernels, to compare.
#[divan::bench(sample_count = 5, sample_size = 1, args = [Engine::Fused, Engine::Burn])]
fn a_tenth_of_reinforce(engine: Engine) {
    run(Agent::of(&Reinforce { episodes: 1500, engine, ..Reinforce::default() }), false);
}

/// Times the checkpoint that a training leaves after so many steps, when it is stopped.
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
    fn report(&self, _: TrainingProgress) {}

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

/// Of a dueling DQN with so many transitions in its replay buffer; synced to the disk.
#[divan::bench(sample_count = 10, sample_size = 1, args = [1_000, 50_000, 1_000_000])]
fn checkpoint(bencher: Bencher<'_, '_>, transitions: u32) {
    // An agent that only fills its buffer.
    let dqn = DuelingDqn { episodes: transitions, batch: 1_000_000, ..DuelingDqn::default() };
    let timer = Timer {
        bencher: RefCell::new(Some(bencher)),
        steps_left: Cell::new(transitions),
        file: RefCell::new(tempfile::tempfile_in(".").unwrap()),
    };
    let outcome = train::run(&job(Agent::of(&dqn), false), &timer);
    assert_eq!(outcome, Outcome::Interrupted);
}
