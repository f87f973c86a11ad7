//! Rolling an actor through episodes, for tests and for `simulate`.

use crate::agent::{Actor, StepObserver};
use crate::env::{Action, LaneSet, LaneStreams, Observations, VectorEnvironment};
use crate::rng::{Purpose, Stream};
use crate::state::resumable;

/// The random streams of rolled episodes.
#[derive(Clone, Debug)]
pub struct RollStreams {
    /// The streams of the environment: contexts and their features.
    pub environment: LaneStreams,
    /// The stream of the choice of actions.
    pub actions: Stream,
}

impl RollStreams {
    /// A seed's streams for the test, at their start; all lanes share one stream.
    pub fn of_test(seed: u64) -> Self {
        RollStreams {
            environment: LaneStreams::Shared(Stream::new(seed, Purpose::TestEnvironment)),
            actions: Stream::new(seed, Purpose::TestActions),
        }
    }
}

resumable!([] RollStreams { parts environment, actions });

/// Begins an episode in every lane.
pub fn begin<Env: VectorEnvironment + ?Sized>(
    environment: &mut Env,
    actor: &mut (impl Actor<Env> + ?Sized),
    streams: &mut RollStreams,
) {
    environment.reset(LaneSet::All, &mut streams.environment);
    actor.reset(LaneSet::All);
}

/// Rolls the running episodes to their ends, unless the observer requests a stop. The next call continues a
/// stopped roll.
pub fn roll<Env: VectorEnvironment + ?Sized>(
    environment: &mut Env,
    actor: &mut (impl Actor<Env> + ?Sized),
    streams: &mut RollStreams,
    observer: &mut impl StepObserver<Env>,
) {
    let mut actions = vec![Action::default(); environment.lanes()];
    let mut probabilities = vec![0.0; actions.len() * environment.action_spec().count];
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

/// Rolls like [`roll`], with choices by a function that may fail.
///
/// **Errors**: the function's error.
pub(super) fn roll_by<Env: VectorEnvironment + ?Sized, E>(
    environment: &mut Env,
    choose: &mut Choose<'_, Env, E>,
    streams: &mut RollStreams,
    observer: &mut impl StepObserver<Env>,
) -> Result<(), E> {
    let mut actions = vec![Action::default(); environment.lanes()];
    let mut probabilities = vec![0.0; actions.len() * environment.action_spec().count];
    let mut rewards = vec![0.0; environment.lanes()];
    while environment.any_running() && !observer.stop_requested() {
        choose(environment, &mut streams.actions, &mut actions, &mut probabilities)?;
        observer.chosen(environment, &actions, &probabilities);
        environment.step(&actions, &mut rewards, &mut streams.environment);
        observer.paid(environment, &rewards);
    }
    Ok(())
}

/// Chooses actions and returns their probabilities, like [`Actor::act`].
pub(super) type Choose<'a, Env, E> =
    dyn FnMut(&Env, &mut Stream, &mut [Action], &mut [f64]) -> Result<(), E> + 'a;

/// The record of rolled episodes. Row t · lanes + l of every array belongs to step t of lane l. The rewards
/// of ended lanes are 0.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// The observations before each step.
    pub observations: Observations,
    /// The actions, \[rows\].
    pub actions: Vec<Action>,
    /// The rewards, \[rows\].
    pub rewards: Vec<f64>,
    /// The sum of all returns.
    returns: f64,
    lanes: usize,
    present: Observations,
}

impl Rollout {
    /// The mean of the lanes' undiscounted returns.
    pub fn mean_return(&self) -> f64 {
        self.returns / self.lanes as f64
    }
}

impl<Env: VectorEnvironment + ?Sized> StepObserver<Env> for Rollout {
    fn chosen(&mut self, environment: &Env, actions: &[Action], _: &[f64]) {
        environment.observe(&mut self.present);
        self.observations.extend(&self.present, 0..self.lanes);
        self.actions.extend_from_slice(actions);
    }

    fn paid(&mut self, environment: &Env, rewards: &[f64]) {
        self.rewards.extend_from_slice(rewards);
        self.returns += environment.outcomes(rewards).iter().sum::<f64>();
    }
}

/// Plays an episode in every lane to its end and records it.
pub fn play<Env: VectorEnvironment + ?Sized>(
    environment: &mut Env,
    actor: &mut (impl Actor<Env> + ?Sized),
    streams: &mut RollStreams,
) -> Rollout {
    let none = environment.observation_spec().observations();
    let lanes = environment.lanes();
    let (actions, rewards) = (Vec::new(), Vec::new());
    let mut rollout = Rollout {
        observations: none.clone(),
        actions,
        rewards,
        returns: 0.0,
        lanes,
        present: none,
    };
    begin(environment, actor, streams);
    roll(environment, actor, streams, &mut rollout);
    rollout
}
