//! A job under way: its learner, its curve and its test, and what of them a checkpoint holds.

use std::io;
use std::time::Duration;

use crate::agent::{
    Actor, Learner, LearnerError, OutOfMemory, Start, StartError, StepObserver, TrainedEpisode,
};
use crate::plan::Job;
use crate::record::{Failure, FailureKind, Phase, Results};
use crate::state::{Resumable, StateError, StateReader, StateWriter};
use crate::train::curve::CurveRecorder;
use crate::train::decision_log::DecisionLog;
use crate::train::progress::TrainingProgress;
use crate::train::test::Test;

/// Why there is a learner where training episodes are played or a policy was trained.
const LEARNS: &str = "an agent with training episodes learns";

/// A job under way.
pub(super) struct Training<'j> {
    job: &'j Job,
    /// `None` for an agent that acts without training.
    learner: Option<Box<dyn Learner>>,
    curve: CurveRecorder,
    /// `None` where the job does not ask for it.
    log: Option<DecisionLog>,
    test: Test,
    /// What is tested: the trained policy, once training is over, or the agent that needs none.
    actor: Option<Box<dyn Actor>>,
    /// Room for the episodes of a span.
    finished: Vec<TrainedEpisode>,
    /// Time at work on it before this process began.
    before: Duration,
}

/// Whether there is more to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// Training episodes are left.
    Training,
    /// Test episodes are left.
    Testing,
    /// Nothing is left.
    Over,
}

impl<'j> Training<'j> {
    /// A job at its beginning.
    ///
    /// **Errors**: there is no memory for what learns.
    ///
    /// # Panics
    /// If the agent cannot start for another reason.
    pub(super) fn new(job: &'j Job) -> Result<Self, OutOfMemory> {
        let start = match job.agent.start(&job.task()) {
            Ok(start) => start,
            Err(StartError::OutOfMemory(error)) => return Err(error),
            // A manifest with this agent is refused, so that the fault is the algorithm's.
            Err(error) => panic!("the agent cannot start: {error}"),
        };
        let (learner, actor) = match start {
            Start::Learner(learner) => (Some(learner), None),
            Start::Actor(actor) => (None, Some(actor)),
        };
        Ok(Training {
            job,
            learner,
            curve: CurveRecorder::new(job.evaluation.curve_stride),
            log: job
                .evaluation
                .record_decisions
                .of_training()
                .then(|| DecisionLog::new(Phase::Train)),
            test: Test::new(job),
            actor,
            finished: Vec::new(),
            before: Duration::ZERO,
        })
    }

    /// The same with this much work done before.
    pub(super) fn after(self, before: Duration) -> Self {
        Training { before, ..self }
    }

    pub(super) fn job(&self) -> &'j Job {
        self.job
    }

    /// Training episodes finished.
    pub(super) fn episodes(&self) -> u32 {
        self.curve.episodes()
    }

    /// Time at work on it before this process began.
    pub(super) fn before(&self) -> Duration {
        self.before
    }

    pub(super) fn stage(&self) -> Stage {
        if self.episodes() < self.job.agent.episodes() {
            Stage::Training
        } else if self.test.is_over() {
            Stage::Over
        } else {
            Stage::Testing
        }
    }

    pub(super) fn progress(&self) -> TrainingProgress {
        TrainingProgress {
            episode: self.episodes(),
            episodes: self.job.agent.episodes(),
            recent_return: self.curve.recent_return(),
        }
    }

    /// Goes on with training or test for a span, which is broken off as soon as `pause` says yes.
    ///
    /// **Errors**: a loss or weight is not finite, or memory is short.
    pub(super) fn advance(&mut self, pause: &dyn Fn() -> bool) -> Result<(), Failure> {
        match self.stage() {
            Stage::Training => {
                let learner = self.learner.as_mut().expect(LEARNS);
                let observer = self.log.as_mut().map(|log| log as &mut dyn StepObserver<_>);
                let learned = learner.advance(&mut self.finished, observer, pause);
                learned.map_err(|error| failure(&error, self.episodes()))?;
                let recorded = self.log.as_ref().map_or(Ok(()), DecisionLog::check);
                recorded.map_err(|error| out_of_memory(&error, self.episodes()))?;
                let Training { finished, curve, .. } = self;
                let added = finished.drain(..).try_for_each(|episode| curve.add(&episode));
                added.map_err(|error| out_of_memory(&error, curve.episodes()))?;
            }
            Stage::Testing => {
                let mut actor = match self.actor.take() {
                    Some(actor) => actor,
                    None => self.trained()?,
                };
                let played = self.test.advance(&mut *actor, pause);
                played.map_err(|error| out_of_memory(&error, self.episodes()))?;
                self.actor = Some(actor);
            }
            Stage::Over => {}
        }
        Ok(())
    }

    /// The policy to be tested.
    ///
    /// **Errors**: a weight is not finite.
    fn trained(&self) -> Result<Box<dyn Actor>, Failure> {
        let learner = self.learner.as_ref().expect(LEARNS);
        if !learner.weights().are_finite() {
            return Err(Failure {
                kind: FailureKind::Diverged,
                message: "a weight is infinite or not a number after training".to_owned(),
                episode: self.episodes(),
            });
        }
        Ok(learner.policy(self.job.evaluation.test_actions.into()))
    }

    /// What it leaves behind once it is over.
    pub(super) fn results(self) -> Results {
        let tested = self.test.finish();
        let mut decisions = self.log.map(DecisionLog::finish).unwrap_or_default();
        decisions.extend(tested.decisions.iter());
        Results {
            metrics: tested.metrics(),
            decisions,
            curve: self.curve.finish(),
            episodes: tested.episodes,
            actions: tested.actions,
            weights: self.learner.map(|learner| learner.weights().to_bytes()),
        }
    }
}

/// The failure of a training whose learner cannot go on, after so many episodes.
fn failure(error: &LearnerError, episode: u32) -> Failure {
    match error {
        LearnerError::Diverged(diverged) => {
            Failure { kind: FailureKind::Diverged, message: diverged.to_string(), episode }
        }
        LearnerError::OutOfMemory(error) => out_of_memory(error, episode),
    }
}

/// The failure of a training for which memory was short, after so many episodes.
pub(super) fn out_of_memory(error: &OutOfMemory, episode: u32) -> Failure {
    let message = format!(
        "{error}; give it more, or run fewer workers, and run it again with `--retry-failed`"
    );
    Failure { kind: FailureKind::OutOfMemory, message, episode }
}

impl Resumable for Training<'_> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.learner.iter().try_for_each(|learner| learner.save(out))?;
        self.curve.save(out)?;
        self.log.iter().try_for_each(|log| log.save(out))?;
        self.test.save(out)?;
        match &self.actor {
            Some(actor) if self.test.has_begun() => actor.save(out),
            Some(_) | None => Ok(()),
        }
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.learner.iter_mut().try_for_each(|learner| learner.restore(from))?;
        self.curve.restore(from)?;
        self.log.iter_mut().try_for_each(|log| log.restore(from))?;
        self.test.restore(from)?;
        if !self.test.has_begun() {
            return Ok(());
        }
        let mut actor = match self.actor.take() {
            Some(actor) => actor,
            None => self.trained().map_err(|_| StateError::Misfit("weights"))?,
        };
        actor.restore(from)?;
        self.actor = Some(actor);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::agent::{Agent, DecisionRule, RuleParameters};
    use crate::env::{Action, Environment, LaneSet, PhysicalActivity, VectorEnvironment};
    use crate::manifest::Evaluation;
    use crate::rng::Stream;

    /// An actor whose choices depend on everything that an actor can remember.
    #[derive(Default)]
    struct Remembering {
        /// Steps of the episode, by lane: forgotten at its end.
        steps: Vec<u32>,
        /// Sum of the last rewards, by lane: forgotten at its end.
        recent: Vec<f64>,
        /// Good steps in all episodes: learned for good.
        good: u32,
    }

    impl Actor for Remembering {
        fn reset(&mut self, lanes: LaneSet<'_>) {
            assert_eq!(lanes, LaneSet::All);
            self.steps.clear();
            self.recent.clear();
        }

        fn act(
            &mut self,
            environment: &PhysicalActivity,
            stream: &mut Stream,
            actions: &mut [Action],
            probabilities: Option<&mut [f64]>,
        ) {
            self.steps.resize(environment.lanes(), 0);
            self.recent.resize(environment.lanes(), 0.0);
            let memory = self.steps.iter_mut().zip(&self.recent);
            for (action, (steps, recent)) in actions.iter_mut().zip(memory) {
                let number = u64::from(*steps) + *recent as u64 + u64::from(self.good / 7);
                *action = Action::from_low_bits(number + stream.bits() % 3);
                *steps += 1;
            }
            probabilities.expect("a roll asks for them").fill(1.0 / 3.0);
        }

        fn observe(&mut self, _: &PhysicalActivity, rewards: &[f64]) {
            for (recent, reward) in self.recent.iter_mut().zip(rewards) {
                *recent = 0.5 * *recent + reward;
                self.good += u32::from(*reward > 100.0);
            }
        }
    }

    impl Resumable for Remembering {
        fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
            out.many(&self.steps)?;
            out.many(&self.recent)?;
            out.one(self.good)
        }

        fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
            self.steps = from.many(usize::MAX, "steps")?;
            self.recent = from.many(usize::MAX, "rewards")?;
            self.good = from.one()?;
            Ok(())
        }
    }

    fn started(job: &Job) -> Training<'_> {
        let mut training = Training::new(job).unwrap();
        training.actor = Some(Box::new(Remembering::default()));
        training
    }

    /// The results of the test, saved and restored after every `span` steps; and how often it was.
    fn tested(job: &Job, span: Option<u32>) -> (Results, u32) {
        let mut training = started(job);
        let mut interruptions = 0;
        while training.stage() != Stage::Over {
            let left = Cell::new(span);
            let pause = || left.replace(left.get().map(|left| left.saturating_sub(1))) == Some(0);
            training.advance(&pause).unwrap();
            if span.is_none() {
                continue;
            }
            let mut bytes = Vec::new();
            training.save(&mut StateWriter::new(&mut bytes)).unwrap();
            training = started(job);
            let mut from = &bytes[..];
            training.restore(&mut StateReader::new(&mut from)).unwrap();
            assert!(from.is_empty());
            interruptions += 1;
        }
        (training.results(), interruptions)
    }

    #[test]
    fn an_actor_keeps_its_memory_when_a_test_is_interrupted() {
        let job = Job {
            environment: Environment { horizon: 20, ..Environment::paper(0.6) },
            scenario: "P-H-D".parse().unwrap(),
            agent: Agent::of(&RuleParameters::new(DecisionRule::Random)),
            // Two batches, so that what is learned in the first matters in the second.
            evaluation: Evaluation { test_episodes: 1100, ..Evaluation::default() },
            seed: 4,
        };
        let (undisturbed, _) = tested(&job, None);
        for span in [1, 3, 19] {
            let (results, interruptions) = tested(&job, Some(span));
            assert!(interruptions > 2);
            assert!(results == undisturbed, "interrupted every {span} steps");
        }
    }
}
