//! The outcomes of runs as plain data.
//!
//! Training creates them, the store keeps them, and analysis reads them. Nothing here computes.

use std::fmt;

use super::{EstimateDeclaration, Estimates, MetricName, ParticipantRange};
use crate::agent::{PersonSd, features_of_state};
use crate::key::choices;

/// A named number about a completed run.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Its name.
    pub name: MetricName,
    /// Finite value.
    pub value: f64,
}

/// The result of a job in a comparison of jobs by one metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Score {
    /// The job has not ended.
    Open,
    /// The job failed, or ended without a finite value.
    Lost,
    /// The value of the metric.
    Value(f64),
}

/// One value of a learning curve.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurvePoint {
    /// Training episodes finished, counted from 1.
    pub episode: u32,
    /// The metric, one of the metrics of learning curves.
    pub metric: MetricName,
    /// Finite value.
    pub value: f64,
}

/// One episode of the test, by its position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TestEpisode {
    /// Undiscounted return.
    pub total_reward: f64,
    /// Number of steps.
    pub length: u32,
    /// Whether it was terminated, and not cut off at the horizon.
    pub terminated: bool,
}

/// A phase of a job in which decisions are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// The training.
    #[default]
    Train,
    /// The test of the trained agent.
    Test,
}

/// One step of an episode: observation, action with its probability, and reward.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decision {
    /// Whether the episode belongs to the training or to the test.
    pub phase: Phase,
    /// Episode of the phase, from 1.
    pub episode: u32,
    /// Steps taken in the episode before this one.
    pub step: u32,
    /// The state before the step: one number for each of [`Results::state_names`].
    pub state: Box<[f64]>,
    /// Whether a message could be sent, apart from the budget of messages.
    pub available: bool,
    /// Whether a message could be sent; where it could not, the action taken is 0.
    pub can_send: bool,
    /// Number of the action that the agent chose.
    pub chosen: u8,
    /// Number of the action taken.
    pub action: u8,
    /// Probabilities of all actions when the agent chose. All but the chosen action's are NaN where only
    /// this one is known.
    pub probabilities: Box<[f64]>,
    /// Reward, without the cost of the message.
    pub reward: f64,
    /// Cost of the message, 0 for none. Where it differs between people or moments, a store does not have it.
    pub cost: f64,
    /// Whether the episode ended with this step in a terminal state.
    pub terminated: bool,
    /// Whether the episode was cut off after this step, and not by the end of the training.
    pub truncated: bool,
}

impl Decision {
    /// The reward that is the outcome of an estimate.
    pub fn reward_for(&self, estimate: &EstimateDeclaration) -> f64 {
        if estimate.less_costs { self.reward - self.cost } else { self.reward }
    }

    /// The first number that no store accepts; see [`Results::unusable_number`].
    fn unusable_number(&self, state_names: &[String], can_miss: bool) -> Option<String> {
        let described = |name: &str, value: f64| {
            let phase = match self.phase {
                Phase::Train => "training",
                Phase::Test => "test",
            };
            let Decision { episode, step, .. } = self;
            format!("{name} at step {step} of {phase} episode {episode} is {value}")
        };
        let is_usable = |value: f64| value.is_finite() || can_miss && value.is_nan();
        let state = (0..).zip(&self.state).find(|(_, value)| !is_usable(**value));
        if let Some((index, value)) = state {
            let name = state_names.get::<usize>(index).map_or("a state", String::as_str);
            return Some(described(name, *value));
        }
        if !self.reward.is_finite() {
            return Some(described("the reward", self.reward));
        }
        let taken = self.action_probability();
        (!(0.0..=1.0).contains(&taken)).then(|| described("the action probability", taken))
    }

    /// The probability with which the action was taken, in (0, 1]: 1 where no message could be sent.
    pub fn action_probability(&self) -> f64 {
        if self.can_send { self.probabilities[usize::from(self.action)] } else { 1.0 }
    }
}

/// The value of a parameter of a participant. A participant takes part in one episode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ParticipantValue {
    /// Whether the episode belongs to the training or to the test.
    pub phase: Phase,
    /// Episode of the phase, from 1.
    pub episode: u32,
    /// The parameter, by its index; see [`crate::env::ParticipantSampler`].
    pub parameter: u8,
    /// Finite value.
    pub value: f64,
}

/// The posterior of the effect of a message after an update of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedPosterior {
    /// The number of the update, from 1.
    pub update: u32,
    /// The number of steps of the trial before the update.
    pub step: u32,
    /// The person, from 1, with partial pooling; 0 for everybody, or for what people have in common.
    pub person: u32,
    /// The message: the number of an action above 0.
    pub action: u8,
    /// The means of the coefficients of the effect, \[features\]; the first is the intercept.
    pub mean: Vec<f64>,
    /// Their covariances, \[features, features\].
    pub covariance: Vec<f64>,
    /// The standard deviations of people's coefficients around common ones, \[features\]; empty for a person, and without
    /// partial pooling.
    pub deviation: Vec<f64>,
}

impl RecordedPosterior {
    /// The posterior mean of the effect in a state, divided by its standard deviation; `None` if the agent does not see
    /// states of this length.
    pub fn standardised_effect(&self, state: &[f64]) -> Option<f64> {
        let (mean, sd) = self.effect(state)?;
        Some(mean / sd)
    }

    /// The posterior mean and standard deviation of the effect in a state; `None` if the agent does not see states of this
    /// length.
    pub fn effect(&self, state: &[f64]) -> Option<(f64, f64)> {
        let features = features_of_state(state, self.mean.len())?;
        let product =
            |row: &[f64]| row.iter().zip(&features).map(|(one, other)| one * other).sum::<f64>();
        let rows = self.covariance.chunks_exact(features.len()).map(product);
        let variance = product(&rows.collect::<Vec<_>>());
        Some((product(&self.mean), variance.sqrt()))
    }

    /// The standard deviation of people's effects in a state around the common effect; `None` without partial pooling.
    pub fn deviation(&self, state: &[f64]) -> Option<f64> {
        let features = features_of_state(state, self.deviation.len())?;
        let squares = features.iter().zip(&self.deviation).map(|(one, sd)| (one * sd).powi(2));
        Some(squares.sum::<f64>().sqrt())
    }
}

impl RecordedPosterior {
    /// Where the deviations that matter in a state are held, if they were estimated with these scales, \[features\].
    pub fn held(&self, state: &[f64], scales: &[f64]) -> Vec<HeldDeviation> {
        let features = features_of_state(state, self.deviation.len()).unwrap_or_default();
        let all = features.iter().zip(&self.deviation).zip(scales);
        let matters = all.filter(|((feature, _), _)| **feature != 0.0);
        matters.filter_map(|((_, sd), scale)| HeldDeviation::of(*sd, *scale)).collect()
    }
}

/// Where an estimated deviation is not free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeldDeviation {
    /// At its first value: fewer than two people have data about the coefficient, or the likelihood is flat.
    First,
    /// At its smallest value: people do not differ as far as the agent can see.
    Least,
    /// At its largest value.
    Most,
}

impl HeldDeviation {
    /// All, each with its name.
    pub const NAMED: [(HeldDeviation, &'static str); 3] = [
        (HeldDeviation::First, "at its first value"),
        (HeldDeviation::Least, "at its smallest value"),
        (HeldDeviation::Most, "at its largest value"),
    ];

    /// Where an estimated deviation with this scale is held; `None` if it is free.
    pub fn of(sd: f64, scale: f64) -> Option<HeldDeviation> {
        let mut values = PersonSd::HELD.into_iter().zip(HeldDeviation::NAMED);
        let is_there = |value: f64| (sd / (value * scale) - 1.0).abs() < 1e-9;
        values.find(|(value, _)| is_there(*value)).map(|(_, (held, _))| held)
    }
}

/// How often an action was taken in the test episodes, by the stratum of the decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActionCount {
    /// The stratum, from 0; `None` in a family without strata.
    pub stratum: Option<u8>,
    /// Number of the action.
    pub action: u8,
    /// The number of times the action was taken; at least 1.
    pub count: u64,
}

/// All results of a completed run. The same job always gives bit-identical results.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// Summary metrics, each at most once.
    pub metrics: Vec<Metric>,
    /// Learning curve, by episode; empty for an algorithm that does not train.
    pub curve: Vec<CurvePoint>,
    /// Test episodes, by position.
    pub episodes: Vec<TestEpisode>,
    /// Choices of action in the test; only counts above 0.
    pub actions: Vec<ActionCount>,
    /// How the environment described itself; see [`crate::env::Model::description`].
    pub description: Option<String>,
    /// The names of the numbers in the state of a decision.
    pub state_names: Vec<String>,
    /// Recorded decisions, by phase, episode and step; empty unless the job asks for them.
    pub decisions: Vec<Decision>,
    /// Parameters in which participants differ, by phase, episode and index. Parameters of the
    /// training are included if its decisions are recorded.
    pub participants: Vec<ParticipantValue>,
    /// What was learned at the updates of a trial, by update and action; empty unless the job asks for it.
    pub posteriors: Vec<RecordedPosterior>,
    /// Trained weights in the safetensors format; `None` for an algorithm without weights.
    pub weights: Option<Vec<u8>>,
    /// The estimates that were asked for. They are no part of the digest of results.
    pub estimates: Vec<Estimates>,
}

impl Results {
    /// The first number that no store accepts, with its name: one that is not finite, or a probability outside 0
    /// to 1. `None` if there is none. Weights and estimates are not looked at. Where numbers of the state can be missing, NaN
    /// stands for them.
    pub fn unusable_number(&self, can_miss: bool) -> Option<String> {
        let unusable = |name: &dyn Fn() -> String, value: f64| {
            (!value.is_finite()).then(|| format!("{} is {value}", name()))
        };
        let metric = |one: &Metric| unusable(&|| one.name.text().into_owned(), one.value);
        let episode = |(number, one): (usize, &TestEpisode)| {
            unusable(&|| format!("the total reward of test episode {number}"), one.total_reward)
        };
        let point = |one: &CurvePoint| {
            let name = || {
                format!("{} of the learning curve at episode {}", one.metric.text(), one.episode)
            };
            unusable(&name, one.value)
        };
        let participant = |one: &ParticipantValue| {
            let name = || format!("parameter {} of participant {}", one.parameter, one.episode);
            unusable(&name, one.value)
        };
        let posterior = |one: &RecordedPosterior| {
            let name = |what| {
                format!("the posterior {what} of action {} at update {}", one.action, one.update)
            };
            let first = |what: &'static str, numbers: &[f64]| {
                numbers.iter().find_map(|number| unusable(&|| name(what), *number))
            };
            first("mean", &one.mean).or_else(|| first("covariance", &one.covariance))
        };
        (self.metrics.iter().find_map(metric))
            .or_else(|| self.curve.iter().find_map(point))
            .or_else(|| (1..).zip(&self.episodes).find_map(episode))
            .or_else(|| {
                let number = |one: &Decision| one.unusable_number(&self.state_names, can_miss);
                self.decisions.iter().find_map(number)
            })
            .or_else(|| self.participants.iter().find_map(participant))
            .or_else(|| self.posteriors.iter().find_map(posterior))
    }

    /// The value of a summary metric; NaN without it.
    pub fn metric(&self, name: &str) -> f64 {
        self.metrics.iter().find(|metric| metric.name == name).map_or(f64::NAN, |m| m.value)
    }
}

/// A part of the results of runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DataPart {
    /// A metric.
    Metric(MetricName),
    /// The learning curve of the mean return.
    LearningCurve,
    /// Choices of action.
    ActionChoice,
    /// Recorded decisions of people up to this number.
    Days(u32),
    /// Returns of the test episodes.
    Returns,
    /// Estimates of causal effects.
    Estimates,
    /// What was learned at the updates of trials.
    Posteriors,
    /// Posteriors of people at the updates of trials with partial pooling.
    PersonPosteriors,
    /// Test episodes of some participants.
    Participants(ParticipantRange),
}

choices! {
    /// Why a run failed.
    pub enum FailureKind {
        /// The process that trained the job crashed repeatedly.
        Crashed = "crashed",
        /// A loss, a weight, or a number of a model became infinite or NaN.
        Diverged = "diverged",
        /// The outside program did not start, ended early or broke the protocol.
        External = "external",
        /// There was not enough memory.
        OutOfMemory = "out_of_memory",
        /// The run exceeded its declared time limit.
        OverTime = "over_time",
        /// The training code panicked.
        Panicked = "panicked",
    }
}

impl fmt::Display for FailureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// A failed run: its kind, its message, and the progress of training.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The kind of failure.
    pub kind: FailureKind,
    /// The message for the user.
    pub message: String,
    /// Training episodes finished before the failure.
    pub episode: u32,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a process holds few outcomes at a time")]
pub enum Outcome {
    /// Training and test were completed.
    Completed(Results),
    /// A fault of the job ended the run; the same fault would recur.
    Failed(Failure),
    /// The run was stopped from outside; the job itself is sound.
    Interrupted,
}

impl Outcome {
    /// The same outcome, or a failure if a store would not accept a number of its results; see
    /// [`Results::unusable_number`]. `episode` is the number of finished training episodes.
    pub fn judged(self, episode: u32, can_miss: bool) -> Outcome {
        let number = match &self {
            Outcome::Completed(results) => results.unusable_number(can_miss),
            Outcome::Failed(_) | Outcome::Interrupted => None,
        };
        match number {
            None => self,
            Some(number) => Outcome::Failed(Failure {
                kind: FailureKind::Diverged,
                message: format!("{number}: no result is stored"),
                episode,
            }),
        }
    }
}

/// The code and the machine that produced a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Version of jitai, as in `Cargo.toml`.
    pub code_version: String,
    /// Git revision of the build, with the suffix `-dirty` if files had changed; `unknown` outside a
    /// repository.
    pub git_revision: String,
    /// Name and version of the tensor backend.
    pub backend: String,
    /// Host name.
    pub host: String,
    /// Processor model.
    pub processor: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::metric::{EPSILON, MEAN_RETURN};

    fn results() -> Results {
        Results {
            metrics: vec![Metric { name: MEAN_RETURN, value: 1.0 }],
            curve: vec![CurvePoint { episode: 10, metric: EPSILON, value: 0.5 }],
            episodes: vec![TestEpisode { total_reward: 50.0, length: 2, terminated: true }],
            actions: Vec::new(),
            description: None,
            state_names: vec!["x".to_owned()],
            decisions: vec![Decision {
                phase: Phase::Test,
                episode: 3,
                step: 4,
                state: [1.0].into(),
                can_send: true,
                probabilities: [0.5, f64::NAN].into(),
                ..Decision::default()
            }],
            participants: vec![ParticipantValue::default()],
            posteriors: vec![RecordedPosterior {
                update: 1,
                step: 3,
                person: 0,
                action: 1,
                mean: vec![0.5],
                covariance: vec![1.0],
                deviation: Vec::new(),
            }],
            weights: None,
            estimates: Vec::new(),
        }
    }

    #[test]
    fn a_number_that_is_not_finite_fails_the_job_and_is_named() {
        assert_eq!(results().unusable_number(false), None);
        // A recorded trial may lack numbers of the state, and has no other ones without a value.
        let mut lacking = results();
        lacking.decisions[0].state = [f64::NAN].into();
        assert_eq!(lacking.unusable_number(true), None);
        lacking.decisions[0].state = [f64::INFINITY].into();
        assert!(lacking.unusable_number(true).is_some());
        type Change = fn(&mut Results);
        let cases: [(Change, &str); 9] = [
            (|all| all.metrics[0].value = f64::INFINITY, "mean_return is inf"),
            (
                |all| all.curve[0].value = f64::NAN,
                "epsilon of the learning curve at episode 10 is NaN",
            ),
            (
                |all| all.episodes[0].total_reward = f64::NEG_INFINITY,
                "the total reward of test episode 1 is -inf",
            ),
            (
                |all| all.decisions[0].state = [f64::NAN].into(),
                "x at step 4 of test episode 3 is NaN",
            ),
            (
                |all| all.decisions[0].reward = f64::INFINITY,
                "the reward at step 4 of test episode 3 is inf",
            ),
            (
                |all| all.decisions[0].probabilities = [f64::NAN, 1.0].into(),
                "the action probability at step 4 of test episode 3 is NaN",
            ),
            (|all| all.participants[0].value = f64::NAN, "parameter 0 of participant 0 is NaN"),
            (
                |all| all.posteriors[0].mean = vec![f64::INFINITY],
                "the posterior mean of action 1 at update 1 is inf",
            ),
            (
                |all| all.posteriors[0].covariance = vec![f64::NAN],
                "the posterior covariance of action 1 at update 1 is NaN",
            ),
        ];
        for (spoil, expected) in cases {
            let mut spoilt = results();
            spoil(&mut spoilt);
            let Outcome::Failed(failure) = Outcome::Completed(spoilt).judged(7, false) else {
                panic!("{expected}")
            };
            let message = format!("{expected}: no result is stored");
            let failed = Failure { kind: FailureKind::Diverged, message, episode: 7 };
            assert_eq!(failure, failed);
        }
    }
}
