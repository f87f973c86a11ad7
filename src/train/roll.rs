//! The loop that drives lanes: through the episodes of a test or of `simulate`, and through a trial.

use crate::agent::{Actor, LearnerError, Rewards, StepObserver, StudyAgent};
use crate::env::{Action, LaneSet, LaneStreams, Observations, Simulated, VectorEnvironment};
use crate::rng::{Purpose, Stream};
use crate::state::resumable;
use crate::train::study::Study;

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
    let mut steps = OfSteps(observer);
    let never_fails = drive(environment, actor, streams, &mut steps, &mut Lockstep);
    never_fails.expect("a batch of episodes updates no agent");
}

/// Drives lanes until their conductor has no further step, or the observer requests a stop. The next call continues
/// what was stopped.
///
/// **Errors**: the agent cannot learn.
pub(super) fn drive<Env: VectorEnvironment + ?Sized, Agent: Actor<Env> + ?Sized>(
    environment: &mut Env,
    agent: &mut Agent,
    streams: &mut RollStreams,
    observer: &mut impl LaneObserver<Env>,
    conductor: &mut dyn Conductor<Env, Agent>,
) -> Result<(), LearnerError> {
    let mut actions = vec![Action::default(); environment.lanes()];
    let mut probabilities = vec![0.0; actions.len() * environment.action_spec().count];
    let mut values = vec![0.0; actions.len()];
    while !conductor.is_over(environment) && !observer.stop_requested() {
        conductor.begin_step(environment, agent, &mut streams.environment)?;
        agent.act(environment, &mut streams.actions, &mut actions, Some(&mut probabilities));
        conductor.replay(environment, agent, &mut actions, &probabilities);
        environment.expect(&probabilities);
        observer.chosen(&ChosenStep {
            environment,
            streams: &streams.environment,
            actions: &actions,
            probabilities: &probabilities,
            study: conductor.study(),
        });
        environment.step(&actions, &mut values, &mut streams.environment);
        conductor.end_step(environment);
        let rewards = Rewards { values: &values, reached: conductor.reached() };
        agent.observe(environment, rewards);
        observer.paid(environment, rewards);
    }
    Ok(())
}

/// Says when lanes begin and end, when their agent learns, and which rewards reach it.
pub(super) trait Conductor<Env: ?Sized, Agent: ?Sized> {
    /// Whether there is no further step.
    fn is_over(&self, environment: &Env) -> bool;

    /// Prepares a step. Does nothing by default.
    ///
    /// **Errors**: the agent cannot learn.
    fn begin_step(
        &mut self,
        environment: &mut Env,
        agent: &mut Agent,
        streams: &mut LaneStreams,
    ) -> Result<(), LearnerError> {
        let _ = (environment, agent, streams);
        Ok(())
    }

    /// Replaces the choices of an agent by those of a trial that happened, \[lanes\]. Does nothing by default.
    fn replay(
        &mut self,
        environment: &Env,
        agent: &mut Agent,
        actions: &mut [Action],
        probabilities: &[f64],
    ) {
        let _ = (environment, agent, actions, probabilities);
    }

    /// Ends a step. Does nothing by default.
    fn end_step(&mut self, environment: &Env) {
        let _ = environment;
    }

    /// The lanes whose rewards of the last step reach the agent; by default all.
    fn reached(&self) -> LaneSet<'_> {
        LaneSet::All
    }

    /// The trial that is conducted; `None` for episodes outside of a trial.
    fn study(&self) -> Option<&Study> {
        None
    }
}

/// The conductor of a batch of episodes that have begun together.
pub(super) struct Lockstep;

impl<Env: VectorEnvironment + ?Sized, Agent: ?Sized> Conductor<Env, Agent> for Lockstep {
    fn is_over(&self, environment: &Env) -> bool {
        !environment.any_running()
    }
}

impl Conductor<Simulated, dyn StudyAgent + '_> for Study {
    fn is_over(&self, _: &Simulated) -> bool {
        self.is_over()
    }

    fn begin_step(
        &mut self,
        environment: &mut Simulated,
        agent: &mut (dyn StudyAgent + '_),
        streams: &mut LaneStreams,
    ) -> Result<(), LearnerError> {
        self.begin_step(environment, agent, streams)
    }

    fn replay(
        &mut self,
        environment: &Simulated,
        agent: &mut (dyn StudyAgent + '_),
        actions: &mut [Action],
        probabilities: &[f64],
    ) {
        self.replay(environment, agent, actions, probabilities);
    }

    fn end_step(&mut self, environment: &Simulated) {
        self.end_step_among(environment.times(), (**environment).reached());
    }

    fn reached(&self) -> LaneSet<'_> {
        self.reached()
    }

    fn study(&self) -> Option<&Study> {
        Some(self)
    }
}

/// A step whose actions have been chosen.
pub(super) struct ChosenStep<'s, Env: ?Sized> {
    /// The lanes before the step.
    pub(super) environment: &'s Env,
    /// The streams from which the step will draw.
    pub(super) streams: &'s LaneStreams,
    /// \[lanes\].
    pub(super) actions: &'s [Action],
    /// \[lanes, actions\], row by row.
    pub(super) probabilities: &'s [f64],
    /// The trial; `None` for episodes outside of a trial.
    pub(super) study: Option<&'s Study>,
}

/// Sees every step of driven lanes, and changes nothing.
pub(super) trait LaneObserver<Env: ?Sized> {
    /// Sees a step before it is taken.
    fn chosen(&mut self, step: &ChosenStep<'_, Env>);

    /// Sees the lanes after the step and its rewards.
    fn paid(&mut self, environment: &Env, rewards: Rewards<'_>);

    /// Whether the drive should stop before the next step.
    fn stop_requested(&self) -> bool {
        false
    }
}

/// An observer of steps alone.
struct OfSteps<'o, O>(&'o mut O);

impl<Env: ?Sized, O: StepObserver<Env>> LaneObserver<Env> for OfSteps<'_, O> {
    fn chosen(&mut self, step: &ChosenStep<'_, Env>) {
        self.0.chosen(step.environment, step.actions, step.probabilities);
    }

    fn paid(&mut self, environment: &Env, rewards: Rewards<'_>) {
        self.0.paid(environment, rewards.values);
    }

    fn stop_requested(&self) -> bool {
        self.0.stop_requested()
    }
}

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
