//! Rolling an actor through episodes, for tests and for `simulate`.

use std::io;

use crate::agent::Actor;
use crate::env::{Action, LaneSet, LaneStreams, VectorEnvironment};
use crate::rng::{Purpose, Stream};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// The random streams of a test.
#[derive(Clone, Debug)]
pub struct TestStreams {
    /// The environment's chance: contexts and their features.
    pub environment: LaneStreams,
    /// The choice among actions.
    pub actions: Stream,
}

impl TestStreams {
    /// The streams of a seed at their start, one of them shared by all lanes of the environment.
    pub fn new(seed: u64) -> Self {
        TestStreams {
            environment: LaneStreams::Shared(Stream::new(seed, Purpose::TestEnvironment)),
            actions: Stream::new(seed, Purpose::TestActions),
        }
    }
}

impl Resumable for TestStreams {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.environment.save(out)?;
        self.actions.save(out)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.environment.restore(from)?;
        self.actions.restore(from)
    }
}

/// Sees every step of a roll. Lanes that have ended are still shown; their statuses say so.
pub trait StepObserver<Env: ?Sized> {
    /// Sees the state before a step, and the actions with the probabilities with which they were
    /// chosen.
    ///
    /// **Shapes**: `actions` and `probabilities` are \[lanes\].
    fn chosen(&mut self, environment: &Env, actions: &[Action], probabilities: &[f64]);

    /// Sees the state after the step, and the rewards, \[lanes\]: 0 in lanes that had ended.
    fn paid(&mut self, environment: &Env, rewards: &[f64]);

    /// Whether the roll should stop before the next step.
    fn stop_requested(&self) -> bool {
        false
    }
}

/// Begins an episode in every lane.
pub fn begin<Env: VectorEnvironment + ?Sized>(
    environment: &mut Env,
    actor: &mut (impl Actor<Env> + ?Sized),
    streams: &mut TestStreams,
) {
    environment.reset(LaneSet::All, &mut streams.environment);
    actor.reset(LaneSet::All);
}

/// Rolls the running episodes to their ends, unless the observer requests a stop. The next call
/// continues a roll that was stopped.
pub fn roll<Env: VectorEnvironment + ?Sized>(
    environment: &mut Env,
    actor: &mut (impl Actor<Env> + ?Sized),
    streams: &mut TestStreams,
    observer: &mut impl StepObserver<Env>,
) {
    let mut actions = vec![Action::NONE; environment.lanes()];
    let mut probabilities = vec![0.0; environment.lanes()];
    let mut rewards = vec![0.0; environment.lanes()];
    while environment.any_running() && !observer.stop_requested() {
        let chosen_with = Some(&mut probabilities[..]);
        actor.act(environment, &mut streams.actions, &mut actions, chosen_with);
        observer.chosen(environment, &actions, &probabilities);
        environment.step(&actions, &mut rewards, &mut streams.environment);
        actor.observe(environment, &rewards);
        observer.paid(environment, &rewards);
    }
}
