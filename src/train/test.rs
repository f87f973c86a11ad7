//! The test of a trained agent, or its trial, and the results.

use std::io;
use std::sync::Arc;

use crate::agent::{LearnerError, OutOfMemory, Rewards, StudyAgent, reserve_exact};
use crate::env::{Environment, Reported, Simulated, VectorEnvironment};
use crate::job::metric::{
    LOWER_QUARTILE_RETURN, MEAN_LENGTH, MEAN_RETURN, MESSAGE_RATE, NET_RETURN, SD_RETURN,
    UPPER_QUARTILE_RETURN, quantile_of_sorted,
};
use crate::job::{
    ActionCount, EstimateDeclaration, Estimates, Job, Metric, MetricName, ParticipantValue, Phase,
    RecordedEpisodes, RecordedQuartiles, RunnableJob, TestEpisode,
};
use crate::state::{Resumable, StateError, StateReader, StateWriter, resumable};
use crate::train::observers::{ObservedTrial, Observers};
use crate::train::roll::{ChosenStep, LaneObserver, Lockstep, RollStreams, begin, drive};
use crate::train::study::Study;

/// The number of episodes that advance in lockstep. Results depend on it, because lanes share streams.
const LANES: usize = 1000;

/// A test in progress.
pub(super) struct Test {
    /// The total number of episodes.
    episodes: usize,
    course: Course,
    streams: RollStreams,
    /// A lane for each episode in progress.
    lanes: Simulated,
    pub(super) observers: Observers,
    played: Vec<TestEpisode>,
    /// The participants' parameters, set at the end of the test; memory is reserved from the first batch.
    participants: Vec<ParticipantValue>,
    environment: Environment,
    /// The metric that is the share of terminated episodes.
    terminated: MetricName,
    recorded: (RecordedEpisodes, RecordedQuartiles),
}

/// How a test proceeds.
enum Course {
    /// In batches of episodes, with these participants; `None` if all have the same parameters.
    Batches(Option<People>),
    /// By the calendar of a trial.
    Trial(Box<Study>),
}

/// The participants of a test. Their parameters do not depend on what happens in it.
struct People {
    environment: Environment,
    seed: u64,
    episodes: u32,
}

impl People {
    /// The number of the participants' parameters in total.
    fn count(&self) -> usize {
        self.environment.differing() * self.episodes as usize
    }

    /// Appends the parameters of all participants, by episode and index.
    fn describe(&self, all: &mut Vec<ParticipantValue>) {
        let mut streams = RollStreams::of_test(self.seed).environment;
        let phase = Phase::Test;
        let mut describe = |episode, parameter, value| {
            all.push(ParticipantValue { phase, episode, parameter, value });
        };
        self.environment.describe_participants(streams.of(0), self.episodes, &mut describe);
    }
}

/// The results of the test episodes.
pub(super) struct Tested {
    pub(super) episodes: Vec<TestEpisode>,
    pub(super) actions: Vec<ActionCount>,
    pub(super) estimates: Vec<Estimates>,
    pub(super) observed: ObservedTrial,
    /// Whether the decisions belong to the results.
    pub(super) records_decisions: bool,
    pub(super) participants: Vec<ParticipantValue>,
    /// The names of the numbers in the state of a decision.
    pub(super) state_names: Vec<String>,
    /// How the environment described itself.
    pub(super) description: Option<String>,
    /// The metric that is the share of terminated episodes.
    terminated: MetricName,
    /// The number of messages; `None` if every action sends one.
    messages: Option<u64>,
    /// The total cost of messages; `None` if messages have no cost.
    costs: Option<f64>,
    /// Whether the results of single people are stored.
    pub(super) recorded: (RecordedEpisodes, RecordedQuartiles),
}

impl Test {
    /// The test of a job, before its first episode.
    pub(super) fn new(job: RunnableJob<'_>) -> Self {
        let environment = &job.environment;
        let mut streams = RollStreams::of_test(job.seed);
        let mut lanes = job.task().tested(0);
        let mut episodes = job.evaluation.test_episodes;
        let course = match &job.trial {
            None => Course::Batches((environment.differing() > 0).then(|| People {
                environment: environment.clone(),
                seed: job.seed,
                episodes,
            })),
            Some(trial) => {
                let study = Study::new(trial, job.seed);
                streams.environment = study.streams(job.seed);
                if let Some(reports) = Study::reports(trial, job.seed) {
                    lanes = Box::new(Reported::new(lanes, reports));
                }
                episodes = trial.people;
                Course::Trial(Box::new(study))
            }
        };
        Test {
            episodes: episodes as usize,
            course,
            streams,
            lanes,
            observers: Observers::new(&job),
            played: Vec::new(),
            participants: Vec::new(),
            environment: environment.clone(),
            terminated: job.termination_metric(),
            recorded: (job.evaluation.record_episodes, job.evaluation.record_quartiles),
        }
    }

    /// The test of a job with estimates of its decisions, before its first episode.
    pub(super) fn estimating(mut self, job: &Job, declared: &[Arc<EstimateDeclaration>]) -> Self {
        self.observers.estimate(job, declared);
        self
    }

    /// The declarations of its estimates.
    pub(super) fn estimated(&self) -> Vec<Arc<EstimateDeclaration>> {
        self.observers.declared()
    }

    pub(super) fn is_over(&self) -> bool {
        self.played.len() == self.episodes
    }

    /// Whether an episode has begun. From then on, the actor may have state.
    pub(super) fn has_begun(&self) -> bool {
        !(self.played.is_empty() && self.observers.counts.running.is_empty())
    }

    /// Plays a batch of episodes or a trial to its end, or until `pause` returns true; the next call continues.
    ///
    /// **Errors**: there is not enough memory for the episodes, or the agent of a trial cannot learn.
    pub(super) fn advance(
        &mut self,
        agent: &mut dyn StudyAgent,
        pause: &dyn Fn() -> bool,
    ) -> Result<(), LearnerError> {
        self.begin_batch(agent)?;
        let Test { course, streams, lanes, observers, .. } = self;
        let mut pausing = Pausing { observers: &mut *observers, pause };
        match course {
            Course::Batches(_) => drive(lanes, agent, streams, &mut pausing, &mut Lockstep)?,
            Course::Trial(study) => {
                study.assign(lanes);
                drive(lanes, agent, streams, &mut pausing, &mut **study)?;
                if study.is_over() {
                    study.end(lanes);
                    observers.ended(lanes.statuses());
                }
            }
        }
        Ok(self.end_batch()?)
    }

    /// The day of the trial and its number of days; `None` without a trial.
    pub(super) fn days(&self) -> Option<(u32, u32)> {
        match &self.course {
            Course::Batches(_) => None,
            Course::Trial(study) => Some(study.days()),
        }
    }

    /// Begins the next batch, unless a batch is in progress.
    ///
    /// **Errors**: there is not enough memory for the episodes.
    fn begin_batch(&mut self, agent: &mut dyn StudyAgent) -> Result<(), OutOfMemory> {
        let left = self.episodes - self.played.len();
        reserve_exact(&mut self.played, left, "the test episodes")?;
        let people = match &self.course {
            Course::Batches(people) => people.as_ref(),
            Course::Trial(_) => None,
        };
        let values = people.map_or(0, People::count);
        reserve_exact(&mut self.participants, values, "the participants of the test")?;
        if self.observers.counts.running.is_empty() {
            let (lanes, begins) = match self.course {
                Course::Batches(_) => (LANES.min(left), true),
                Course::Trial(_) => (left, false),
            };
            self.lanes = self.lanes.with_lanes(lanes);
            self.observers.counts.running = vec![TestEpisode::default(); lanes];
            if begins {
                begin(&mut self.lanes, agent, &mut self.streams);
            }
        }
        Ok(())
    }

    /// Stores the episodes of a batch, if it has been played to its end.
    ///
    /// **Errors**: there was not enough memory for the decisions.
    fn end_batch(&mut self) -> Result<(), OutOfMemory> {
        self.observers.check()?;
        let is_over = match &self.course {
            Course::Batches(_) => !self.lanes.any_running(),
            Course::Trial(study) => study.is_over(),
        };
        if !is_over {
            return Ok(());
        }
        let Test { course, lanes, observers, participants, .. } = self;
        let mut values = Vec::new();
        for (lane, episode) in observers.counts.running.iter_mut().enumerate() {
            episode.terminated = lanes.has_terminated(lane);
            if let Course::Trial(_) = course {
                lanes.participant(lane, &mut values);
                let (phase, episode) = (Phase::Test, lane as u32 + 1);
                participants.extend(values.drain(..).map(|(index, value)| ParticipantValue {
                    phase,
                    episode,
                    parameter: index as u8,
                    value,
                }));
            }
        }
        self.played.append(&mut self.observers.counts.running);
        self.prepare_batch();
        Ok(())
    }

    /// The results, once all episodes are played.
    pub(super) fn finish(mut self) -> Tested {
        let counts = &self.observers.counts;
        let (messages, actions) = (counts.messages(), counts.rows());
        let costs = self.environment.message_cost().map(|cost| match counts.costs {
            // A product, as in the results of earlier jobs.
            None => cost * messages as f64,
            Some(costs) => costs,
        });
        let messages = self.environment.has_nothing().then_some(messages);
        let mut state_names = self.environment.state_names();
        match &self.course {
            // The participants of the test are recorded whether or not its decisions are.
            Course::Batches(Some(people)) => people.describe(&mut self.participants),
            Course::Batches(None) => {}
            Course::Trial(study) => state_names.extend(study.names()),
        }
        let records_decisions = self.observers.is_recorded();
        let (estimates, observed) = self.observers.finish();
        Tested {
            episodes: self.played,
            messages,
            costs,
            terminated: self.terminated,
            actions,
            estimates,
            observed,
            records_decisions,
            participants: self.participants,
            state_names,
            description: self.environment.description(),
            recorded: self.recorded,
        }
    }
}

/// Observers with a pause between two steps.
struct Pausing<'p> {
    observers: &'p mut Observers,
    pause: &'p dyn Fn() -> bool,
}

impl LaneObserver<Simulated> for Pausing<'_> {
    fn chosen(&mut self, step: &ChosenStep<'_, Simulated>) {
        self.observers.chosen(step);
    }

    fn paid(&mut self, lanes: &Simulated, rewards: Rewards<'_>) {
        self.observers.paid(lanes, rewards);
    }

    fn stop_requested(&self) -> bool {
        (self.pause)()
    }
}

resumable!([] Test {
    parts streams, observers, played, course;
    check fits, "test episodes";
    then prepare_batch;
    parts lanes
});

impl Resumable for Course {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        match self {
            Course::Batches(_) => Ok(()),
            Course::Trial(study) => study.save(out),
        }
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        match self {
            Course::Batches(_) => Ok(()),
            Course::Trial(study) => study.restore(from),
        }
    }
}

impl Test {
    /// Whether a batch is as large as it should be.
    fn fits(&self) -> bool {
        self.episodes.checked_sub(self.played.len()).is_some_and(|left| {
            let lanes = self.observers.counts.running.len();
            lanes == 0
                || match self.course {
                    Course::Batches(_) => lanes == LANES.min(left),
                    Course::Trial(_) => lanes == left,
                }
        })
    }

    /// Gives the environment a lane for every episode of the batch.
    fn prepare_batch(&mut self) {
        self.lanes = self.lanes.with_lanes(self.observers.counts.running.len());
    }
}

impl Tested {
    /// The metrics of the run, each at most once; see [`crate::job::MetricPlace::Test`].
    pub(super) fn metrics(&self) -> Vec<Metric> {
        let n = self.episodes.len() as f64;
        let mean = self.episodes.iter().map(|e| e.total_reward).sum::<f64>() / n;
        let squares: f64 =
            self.episodes.iter().map(|e| (e.total_reward - mean) * (e.total_reward - mean)).sum();
        let steps: u64 = self.episodes.iter().map(|e| u64::from(e.length)).sum();
        let terminated = self.episodes.iter().filter(|e| e.terminated).count();
        let mut metrics = vec![Metric { name: MEAN_RETURN, value: mean }];
        if self.episodes.len() > 1 {
            metrics.push(Metric { name: SD_RETURN, value: (squares / (n - 1.0)).sqrt() });
        }
        metrics.extend([
            Metric { name: MEAN_LENGTH, value: steps as f64 / n },
            Metric { name: self.terminated, value: terminated as f64 / n },
        ]);
        if let Some(messages) = self.messages {
            let value = messages as f64 / steps as f64;
            metrics.push(Metric { name: MESSAGE_RATE, value });
        }
        if let Some(costs) = self.costs {
            let value = mean - costs / n;
            metrics.push(Metric { name: NET_RETURN, value });
        }
        // Readers compute it from the episodes.
        let recorded: &[_] = match self.recorded {
            (RecordedEpisodes::All, _) => &[],
            (_, RecordedQuartiles::Lower) => &[LOWER_QUARTILE_RETURN],
            (_, RecordedQuartiles::Both) => &[LOWER_QUARTILE_RETURN, UPPER_QUARTILE_RETURN],
        };
        if !recorded.is_empty() {
            let mut returns: Vec<f64> = self.episodes.iter().map(|e| e.total_reward).collect();
            returns.sort_unstable_by(f64::total_cmp);
            metrics.extend(recorded.iter().filter_map(|name| {
                Some(Metric { name: *name, value: quantile_of_sorted(&returns, name.quantile()?) })
            }));
        }
        metrics
    }

    /// The mean returns of the first test episodes, for each requested number of episodes.
    pub(super) fn first_returns(
        &self,
        wanted: impl Iterator<Item = MetricName>,
    ) -> impl Iterator<Item = Metric> {
        wanted.map(|name| {
            let number = name.first_episodes().unwrap_or(u32::MAX);
            let first = &self.episodes[..self.episodes.len().min(number as usize)];
            let sum: f64 = first.iter().map(|episode| episode.total_reward).sum();
            Metric { name, value: sum / first.len().max(1) as f64 }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::MetricPlace;
    use crate::job::metric::{
        DISENGAGEMENT_RATE, METRICS, TERMINATION_RATE, first_return, metrics_of,
    };

    #[test]
    fn metrics_by_hand() {
        let episode =
            |total_reward, length, terminated| TestEpisode { total_reward, length, terminated };
        let tested = Tested {
            episodes: vec![
                episode(10.0, 4, true),
                episode(20.0, 10, false),
                episode(60.0, 6, false),
            ],
            actions: Vec::new(),
            estimates: Vec::new(),
            observed: ObservedTrial::default(),
            records_decisions: false,
            participants: Vec::new(),
            state_names: Vec::new(),
            description: None,
            terminated: DISENGAGEMENT_RATE,
            messages: Some(5),
            costs: Some(1.5 * 5.0),
            recorded: (RecordedEpisodes::None, RecordedQuartiles::Both),
        };
        let value = |name: &str| tested.metrics().iter().find(|m| m.name == name).unwrap().value;
        assert_eq!(value("mean_return"), 30.0);
        assert!((value("sd_return") - 700.0f64.sqrt()).abs() < 1e-12);
        assert!((value("mean_length") - 20.0 / 3.0).abs() < 1e-12);
        assert!((value("disengagement_rate") - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(value("message_rate"), 0.25);
        assert_eq!(value("mean_net_return"), 30.0 - 1.5 * 5.0 / 3.0);
        assert_eq!(value("lower_quartile_return"), 15.0);
        assert_eq!(value("upper_quartile_return"), 40.0);
        let first = tested.first_returns([1, 2].map(first_return).into_iter());
        let first: Vec<(MetricName, f64)> =
            first.map(|metric| (metric.name, metric.value)).collect();
        assert_eq!(first, [(first_return(1), 10.0), (first_return(2), 15.0)]);
        let mut found: Vec<MetricName> = tested.metrics().iter().map(|m| m.name).collect();
        found.sort_by_key(|name| METRICS.iter().position(|metric| metric == name));
        let of_tests = metrics_of(MetricPlace::Test);
        // Quartiles are recorded where episodes are not.
        let of_tests = of_tests.chain([LOWER_QUARTILE_RETURN, UPPER_QUARTILE_RETURN]);
        let mut of_tests: Vec<MetricName> =
            of_tests.filter(|name| *name != TERMINATION_RATE).collect();
        of_tests.sort_by_key(|name| METRICS.iter().position(|metric| metric == name));
        assert_eq!(found, of_tests);
    }

    #[test]
    fn one_test_episode_has_no_spread() {
        let tested = Tested {
            episodes: vec![TestEpisode { total_reward: 7.0, length: 2, terminated: false }],
            actions: Vec::new(),
            estimates: Vec::new(),
            observed: ObservedTrial::default(),
            records_decisions: false,
            participants: Vec::new(),
            state_names: Vec::new(),
            description: None,
            terminated: DISENGAGEMENT_RATE,
            messages: Some(0),
            costs: None,
            recorded: (RecordedEpisodes::All, RecordedQuartiles::Lower),
        };
        let names: Vec<MetricName> = tested.metrics().iter().map(|m| m.name).collect();
        let defined = [MEAN_RETURN, MEAN_LENGTH, DISENGAGEMENT_RATE, MESSAGE_RATE];
        assert_eq!(names, defined);
        assert!(tested.metrics().iter().all(|m| m.value.is_finite()));
    }
}
