//! A job in progress: its learner, curve and test, and the part of them that a checkpoint holds.

use std::sync::Arc;
use std::time::Duration;

use crate::agent::{
    EffectPosterior, Learner, LearnerError, OutOfMemory, Sharing, Start, StartError, StepObserver,
    StudyAgent, StudyPlan, TrainedEpisode,
};
use crate::job::{
    CurvePoint, EstimateDeclaration, Failure, FailureKind, Metric, Phase, Pooling,
    RecordedEpisodes, RecordedPosterior, Results, RunnableJob, Trial,
};
use crate::state::resumable;
use crate::train::afterwards::{self, Afterwards};
use crate::train::curve::CurveRecorder;
use crate::train::decision_log::DecisionLog;
use crate::train::observers::{ObservedTrial, Observers};
use crate::train::progress::TrainingProgress;
use crate::train::test::{Test, Tested};

/// Why there is a learner where training episodes are played or a policy has been trained.
const LEARNS: &str = "an agent with training episodes learns";

/// A job in progress.
pub(super) struct Training<'j> {
    job: RunnableJob<'j>,
    /// `None` for an agent that acts without training.
    learner: Option<Box<dyn Learner>>,
    curve: CurveRecorder,
    /// `None` if the job does not ask for it.
    log: Option<DecisionLog>,
    test: Test,
    /// The tested agent: the trained policy once training is over, or an agent without training.
    actor: Option<Box<dyn StudyAgent>>,
    /// A buffer for the episodes of a span.
    finished: Vec<TrainedEpisode>,
    /// Working time spent on the job before this process started.
    before: Duration,
}

/// The stage of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// Training episodes remain.
    Training,
    /// Test episodes remain.
    Testing,
    /// The job is finished.
    Over,
}

impl<'j> Training<'j> {
    /// A job at its start.
    ///
    /// **Errors**: there is not enough memory for the learner, or the agent does not suit the environment.
    pub(super) fn new(job: RunnableJob<'j>) -> Result<Self, StartError> {
        let plan = job.trial.as_ref().map(|trial| StudyPlan {
            people: trial.people as usize,
            decisions: (trial.days * trial.decisions_per_day) as usize,
            sharing: sharing(trial),
            keeps_updates: job.evaluation.record_posteriors,
        });
        let (learner, actor): (_, Option<Box<dyn StudyAgent>>) = match plan {
            Some(plan) => (None, Some(job.agent.in_trial(&job.task(), plan)?)),
            None => match job.agent.start(&job.task())? {
                Start::Learner(learner) => (Some(learner), None),
                Start::Actor(actor) => (None, Some(Box::new(actor))),
            },
        };
        Ok(Training {
            job,
            learner,
            curve: CurveRecorder::new(
                job.evaluation.curve_stride,
                job.termination_metric(),
                job.evaluation.first_returns(),
            ),
            log: job
                .evaluation
                .record_decisions
                .of_training()
                .then(|| DecisionLog::new(job.agent.unavailable(), Phase::Train)),
            test: Test::new(job),
            actor,
            finished: Vec::new(),
            before: Duration::ZERO,
        })
    }

    /// The same training with these estimates of the decisions of its test; false, and unchanged, if the test has begun
    /// with others.
    pub(super) fn estimate(&mut self, declared: &[Arc<EstimateDeclaration>]) -> bool {
        if self.test.has_begun() || self.test.estimated() == declared {
            return self.test.estimated() == declared;
        }
        self.test = Test::new(self.job).estimating(&self.job, declared);
        afterwards::attach(&mut self.test.observers, &self.job, declared);
        true
    }

    /// The declarations of its estimates.
    pub(super) fn estimated(&self) -> Vec<Arc<EstimateDeclaration>> {
        self.test.estimated()
    }

    /// The observers of its test, before the test has begun.
    pub(super) fn observers(&mut self) -> &mut Observers {
        &mut self.test.observers
    }

    /// What was observed of a finished trial.
    pub(super) fn into_observed(self) -> ObservedTrial {
        self.test.finish().observed
    }

    /// The same training, with this working time spent before.
    pub(super) fn after(self, before: Duration) -> Self {
        Training { before, ..self }
    }

    pub(super) fn job(&self) -> RunnableJob<'j> {
        self.job
    }

    /// The number of training episodes finished.
    pub(super) fn episodes(&self) -> u32 {
        self.curve.episodes()
    }

    /// Working time spent on the job before this process started.
    pub(super) fn before(&self) -> Duration {
        self.before
    }

    pub(super) fn stage(&self) -> Stage {
        if self.job.trial.is_none() && self.episodes() < self.job.agent.episodes() {
            Stage::Training
        } else if self.test.is_over() {
            Stage::Over
        } else {
            Stage::Testing
        }
    }

    /// The points of the learning curve so far.
    pub(super) fn curve(&self) -> &[CurvePoint] {
        self.curve.points()
    }

    pub(super) fn progress(&self) -> TrainingProgress {
        if let Some((day, days)) = self.test.days() {
            return TrainingProgress { episode: day, episodes: days, recent_return: f64::NAN };
        }
        TrainingProgress {
            episode: self.episodes(),
            episodes: self.job.agent.episodes(),
            recent_return: self.curve.recent_return(),
        }
    }

    /// Continues training or test for a span, which is suspended as soon as `pause` returns true.
    ///
    /// **Errors**: a loss or weight is not finite, a regression has no posterior, or there is not enough memory.
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
                played.map_err(|error| failure(&error, self.episodes()))?;
                self.actor = Some(actor);
            }
            Stage::Over => {}
        }
        Ok(())
    }

    /// The policy to test.
    ///
    /// **Errors**: a weight is not finite.
    fn trained(&self) -> Result<Box<dyn StudyAgent>, Failure> {
        let learner = self.learner.as_ref().expect(LEARNS);
        if !learner.weights().are_finite() {
            return Err(Failure {
                kind: FailureKind::Diverged,
                message: "a weight is infinite or not a number after training".to_owned(),
                episode: self.episodes(),
            });
        }
        Ok(Box::new(learner.policy(self.job.evaluation.test_actions.into())))
    }

    /// The results of the finished training.
    ///
    /// **Errors**: a regression has no posterior.
    pub(super) fn results(mut self) -> Result<Results, Failure> {
        let episodes = self.episodes();
        let wanted = self.job.evaluation.first_returns();
        let learns = self.learner.is_some();
        let weights = match (&self.learner, &mut self.actor) {
            (Some(learner), _) => Some(learner.weights()),
            (None, Some(actor)) => actor.weights().map_err(|error| failure(&error, episodes))?,
            (None, None) => None,
        };
        let weights = weights.map(|weights| weights.to_bytes());
        let posteriors = self.actor.as_mut().map_or_else(Vec::new, |actor| actor.updates());
        let first = |tested: &Tested, curve: &CurveRecorder| match learns {
            true => curve.first_returns().collect(),
            false => tested.first_returns(wanted).collect(),
        };
        let mut tested = self.test.finish();
        let declared: Vec<_> = tested.estimates.iter().map(|one| one.declaration.clone()).collect();
        Afterwards::of(&self.job, &declared, Ok(&tested.observed)).add_to(&mut tested.estimates);
        let results = assemble(tested, self.curve, self.log, first, weights);
        Ok(Results { posteriors: posteriors.into_iter().map(recorded).collect(), ..results })
    }
}

/// How the agent of a trial learns from several people.
pub(super) fn sharing(trial: &Trial) -> Sharing {
    let groups = || trial.calendar().map(|calendar| calendar.agents()).unwrap_or_default();
    match trial.pooling {
        Pooling::Full => Sharing::Everybody,
        Pooling::Partial => Sharing::Partial,
        Pooling::None | Pooling::Groups(_) => Sharing::Apart(groups()),
    }
}

/// A posterior as results have it.
fn recorded(posterior: EffectPosterior) -> RecordedPosterior {
    let EffectPosterior { update, step, person, action, mean, covariance, deviation } = posterior;
    RecordedPosterior { update, step, person, action, mean, covariance, deviation }
}

/// The results of a finished training and its test; `first` returns the metrics of the first episodes.
pub(super) fn assemble(
    mut tested: Tested,
    curve: CurveRecorder,
    log: Option<DecisionLog>,
    first: impl FnOnce(&Tested, &CurveRecorder) -> Vec<Metric>,
    weights: Option<Vec<u8>>,
) -> Results {
    let (mut decisions, mut participants) = log.map(DecisionLog::finish).unwrap_or_default();
    if tested.records_decisions {
        decisions.append(&mut tested.observed.decisions);
    }
    let mut metrics = tested.metrics();
    metrics.extend(first(&tested, &curve));
    participants.extend(tested.participants.iter());
    let mut results = Results {
        metrics,
        description: tested.description,
        state_names: tested.state_names,
        decisions,
        participants,
        curve: curve.finish(),
        episodes: tested.episodes,
        actions: tested.actions,
        weights,
        posteriors: Vec::new(),
        estimates: tested.estimates,
    };
    if tested.recorded.0 == RecordedEpisodes::None {
        (results.episodes, results.participants, results.weights) = (Vec::new(), Vec::new(), None);
    }
    results
}

/// The failure of a training whose agent failed after `episode` episodes.
fn failure(error: &LearnerError, episode: u32) -> Failure {
    match error {
        LearnerError::Diverged(diverged) => {
            Failure { kind: FailureKind::Diverged, message: diverged.to_string(), episode }
        }
        LearnerError::Singular { .. } => {
            Failure { kind: FailureKind::Diverged, message: error.to_string(), episode }
        }
        LearnerError::OutOfMemory(error) => out_of_memory(error, episode),
    }
}

/// The failure of a training that ran out of memory after `episode` episodes.
pub(super) fn out_of_memory(error: &OutOfMemory, episode: u32) -> Failure {
    let message = format!(
        "{error}; run fewer workers, or use a machine with more memory, and run the job again with \
         `--retry-failed`"
    );
    Failure { kind: FailureKind::OutOfMemory, message, episode }
}

resumable!([] Training<'_> {
    each learner;
    parts curve;
    each log;
    parts test;
    check prepares_actor, "weights";
    each actor
});

impl Training<'_> {
    /// Makes the actor of a test that has begun; returns false if a weight is not finite.
    fn prepares_actor(&mut self) -> bool {
        if self.actor.is_none() && self.test.has_begun() {
            self.actor = self.trained().ok();
            return self.actor.is_some();
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::agent::{Actor, Agent, DecisionRule, LinearThompson, Rewards, RuleParameters};
    use crate::env::{Action, LaneSet, Simulated, StepCount, VectorEnvironment};
    use crate::job::{
        Estimates, Estimator, EvaluatedOn, Evaluation, Job, Messages, REWARD, RecordedDecisions,
        StandardErrors, TargetPolicy, Treatment,
    };
    use crate::key::{Keyed, Value};
    use crate::rng::Stream;
    use crate::state::{Resumable, StateReader, StateWriter};

    /// An actor whose choices depend on every kind of state that an actor can have.
    #[derive(Default)]
    struct Remembering {
        /// The number of steps in the episode, by lane; cleared at its end.
        steps: Vec<u32>,
        /// The sum of the last rewards, by lane; cleared at the end of the episode.
        recent: Vec<f64>,
        /// The number of good steps in all episodes; never cleared.
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
            environment: &Simulated,
            stream: &mut Stream,
            actions: &mut [Action],
            probabilities: Option<&mut [f64]>,
        ) {
            self.steps.resize(environment.lanes(), 0);
            self.recent.resize(environment.lanes(), 0.0);
            let memory = self.steps.iter_mut().zip(&self.recent);
            for (action, (steps, recent)) in actions.iter_mut().zip(memory) {
                let number = u64::from(*steps) + *recent as u64 + u64::from(self.good / 7);
                *action = Action::uniform(number + stream.bits() % 3, 4);
                *steps += 1;
            }
            probabilities.expect("a roll asks for them").fill(1.0 / 3.0);
        }

        fn observe(&mut self, _: &Simulated, rewards: Rewards<'_>) {
            for (recent, reward) in self.recent.iter_mut().zip(rewards.values) {
                *recent = 0.5 * *recent + reward;
                self.good += u32::from(*reward > 100.0);
            }
        }
    }

    resumable!([] Remembering { parts good; grown steps, recent });

    fn begun(job: &Job) -> Training<'_> {
        Training::new(job.runnable().unwrap()).unwrap()
    }

    fn started(job: &Job) -> Training<'_> {
        let mut training = begun(job);
        let actor: Box<dyn Actor> = Box::new(Remembering::default());
        training.actor = Some(Box::new(actor));
        training
    }

    /// The results of a test that is saved and restored after every `span` steps, and the number of
    /// interruptions.
    fn tested<'j>(
        job: &'j Job,
        span: Option<u32>,
        started: fn(&'j Job) -> Training<'j>,
    ) -> Result<(Results, u32), Failure> {
        let mut training = started(job);
        let mut interruptions = 0;
        while training.stage() != Stage::Over {
            let left = Cell::new(span);
            let pause = || left.replace(left.get().map(|left| left.saturating_sub(1))) == Some(0);
            training.advance(&pause)?;
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
        Ok((training.results()?, interruptions))
    }

    #[test]
    fn an_actor_keeps_its_memory_when_a_test_is_interrupted() {
        let job = Job {
            environment: StepCount { horizon: 20, ..StepCount::paper(0.6) }.into(),
            scenario: "P-H-D".parse().unwrap(),
            agent: Agent::of(&RuleParameters::new(DecisionRule::Random)),
            // Two batches, so that the first batch's learning affects the second.
            evaluation: Evaluation { test_episodes: 1100, ..Evaluation::default() },
            trial: None,
            seed: 4,
        };
        let (undisturbed, _) = tested(&job, None, started).unwrap();
        for span in [1, 3, 19] {
            let (results, interruptions) = tested(&job, Some(span), started).unwrap();
            assert!(interruptions > 2);
            assert!(results == undisturbed, "interrupted every {span} steps");
        }
    }

    /// Four people with two decisions on each of five days.
    fn plan() -> Trial {
        let required = [Value::Integer(4), Value::Integer(5)];
        Trial { decisions_per_day: 2, ..Trial::with_required(&required) }
    }

    fn trial(agent: Agent, trial: Trial) -> Job {
        Job {
            environment: StepCount { horizon: 10, ..StepCount::paper(0.6) }.into(),
            scenario: "P-H-D".parse().unwrap(),
            agent,
            evaluation: Evaluation {
                test_episodes: 0,
                on: EvaluatedOn::Trial,
                record_decisions: RecordedDecisions::Test,
                ..Evaluation::default()
            },
            trial: Some(trial),
            seed: 4,
        }
    }

    #[test]
    fn a_trial_fails_at_an_update_without_a_posterior_interrupted_or_not() {
        let bandit = LinearThompson {
            action_centring: true,
            noise_sd: 1e-6,
            prior_sd: 1e6,
            ..LinearThompson::default()
        };
        for pooling in [Pooling::Full, Pooling::None] {
            let job = trial(Agent::of(&bandit), Trial { pooling, ..plan() });
            let failure = tested(&job, None, begun).err().unwrap();
            assert_eq!(failure.kind, FailureKind::Diverged);
            assert!(
                failure.message.contains("the precision of a regression is not positive definite")
            );
            for span in [1, 3] {
                assert_eq!(tested(&job, Some(span), begun).err().unwrap(), failure);
            }
        }
    }

    #[test]
    fn what_phones_last_reported_survives_an_interruption() {
        let reports = Trial { entry_every_days: 2, entry_people: 2, unreported: 0.6, ..plan() };
        let bandit = LinearThompson { noise_sd: 40.0, ..LinearThompson::default() };
        let tailored = RuleParameters::new(DecisionRule::Tailored);
        for agent in [Agent::of(&bandit), Agent::of(&tailored)] {
            let job = trial(agent, reports.clone());
            let (undisturbed, _) = tested(&job, None, begun).unwrap();
            assert_eq!(undisturbed.state_names[5..], ["reported", "calendar_day", "policy"]);
            let silent = |decision: &&crate::job::Decision| decision.state[5] == 0.0;
            assert!(undisturbed.decisions.iter().filter(silent).count() > 10);
            for pair in undisturbed.decisions.windows(2).filter(|pair| silent(&&pair[1])) {
                assert_eq!(pair[0].episode, pair[1].episode, "the first decision is reported");
                assert_eq!(pair[0].state[..5], pair[1].state[..5]);
                // The same observation and policy give the same probabilities.
                if pair[0].state[7] == pair[1].state[7] {
                    assert_eq!(pair[0].probabilities, pair[1].probabilities);
                }
            }
            for span in [1, 3] {
                let (results, interruptions) = tested(&job, Some(span), begun).unwrap();
                assert!(interruptions > 2 && results == undisturbed, "every {span} steps");
            }
        }
    }

    fn estimate(name: &str, outcome: &str, errors: StandardErrors) -> Arc<EstimateDeclaration> {
        Arc::new(EstimateDeclaration {
            against: None,
            control: Vec::new(),
            less_costs: false,
            estimator: Estimator::Wcls,
            moderators: Vec::new(),
            name: name.to_owned(),
            numerator: 0.5,
            outcome: outcome.to_owned(),
            policy: None,
            standard_errors: errors,
            steps: 1,
            treatment: Treatment::Messages(Messages::Any),
            truth: true,
        })
    }

    fn estimates() -> [Arc<EstimateDeclaration>; 3] {
        [
            estimate("after", REWARD, StandardErrors::AfterStudy),
            estimate("nominal", REWARD, StandardErrors::Nominal),
            estimate("state", "habituation", StandardErrors::Nominal),
        ]
    }

    fn estimated(job: &Job) -> Training<'_> {
        let mut training = begun(job);
        assert!(training.estimate(&estimates()));
        training
    }

    /// The value of a policy over three decisions, from states as they are after each decision.
    fn value() -> Arc<EstimateDeclaration> {
        Arc::new(EstimateDeclaration {
            estimator: Estimator::Value,
            policy: Some(TargetPolicy::Message(0.6)),
            steps: 3,
            ..(*estimate("value", "habituation", StandardErrors::Nominal)).clone()
        })
    }

    fn valued(job: &Job) -> Training<'_> {
        let mut training = begun(job);
        assert!(training.estimate(&[value()]));
        training
    }

    #[test]
    fn a_value_and_its_truth_survive_interruptions() {
        let calendar = Trial { people: 30, dropout: 0.1, ..plan() };
        let job = trial(Agent::of(&RuleParameters::new(DecisionRule::Random)), calendar);
        let (undisturbed, _) = tested(&job, None, valued).unwrap();
        for term in &undisturbed.estimates[0].terms {
            let effect = term.effect.clone().unwrap();
            let (truth, size) = (effect.truth.unwrap(), effect.effective_sample_size.unwrap());
            assert!((effect.value - truth).abs() < 4.0 * effect.standard_error, "{effect:?}");
            assert!(size > 10.0 && size < effect.decisions as f64);
        }
        let (results, interruptions) = tested(&job, Some(2), valued).unwrap();
        assert!(interruptions > 2 && results == undisturbed);
    }

    #[test]
    fn truths_and_errors_of_a_trial_survive_interruptions() {
        let bandit = LinearThompson { noise_sd: 40.0, pi_min: 0.1, ..LinearThompson::default() };
        let calendar = Trial { people: 12, unreported: 0.2, missing_outcomes: 0.2, ..plan() };
        for record_decisions in [RecordedDecisions::None, RecordedDecisions::Test] {
            let mut job = trial(Agent::of(&bandit), calendar.clone());
            job.evaluation.record_decisions = record_decisions;
            let (undisturbed, _) = tested(&job, None, estimated).unwrap();
            let is_recorded = record_decisions == RecordedDecisions::Test;
            assert_eq!(undisturbed.decisions.is_empty(), !is_recorded);
            let [after, nominal, state] = undisturbed.estimates.clone().try_into().unwrap();
            let effect = |of: &Estimates| of.terms[0].effect.clone().unwrap();
            assert!(effect(&state).truth.is_some());
            assert_eq!(effect(&after).truth, effect(&nominal).truth);
            assert_eq!(effect(&after).value, effect(&nominal).value);
            assert_ne!(effect(&after).standard_error, effect(&nominal).standard_error);
            for span in [1, 3] {
                let (results, interruptions) = tested(&job, Some(span), estimated).unwrap();
                assert!(interruptions > 2 && results == undisturbed, "every {span} steps");
            }
            // Estimates that are declared later play the trial once more.
            let (results, _) = tested(&job, None, begun).unwrap();
            assert_eq!(Results { estimates: Vec::new(), ..undisturbed.clone() }, results);
            let mut later = undisturbed.estimates.clone();
            for term in later.iter_mut().flat_map(|one| &mut one.terms) {
                let Ok(effect) = &mut term.effect else { continue };
                (effect.truth, effect.standard_error) = (None, 1.0);
            }
            let [after, nominal, _] = estimates();
            let afterwards = Afterwards::simulate(&job, &[after, nominal], &|| false).unwrap();
            afterwards.add_to(&mut later);
            assert_eq!(later[0], undisturbed.estimates[0]);
            assert_eq!(
                later[1].terms[0].effect.clone().unwrap().truth,
                effect(&undisturbed.estimates[1]).truth
            );
            assert!(Afterwards::simulate(&job, &estimates(), &|| true).is_none());
        }
    }
}
