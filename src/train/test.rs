//! The test episodes of a trained agent and their results.

use std::sync::Arc;

use crate::agent::{Actor, LearnerError, OutOfMemory, StepObserver, reserve_exact};
use crate::env::{
    Action, Environment, EpisodeStatus, LaneSet, Reported, Simulated, VectorEnvironment,
};
use crate::estimate::Estimation;
use crate::job::metric::{
    LOWER_QUARTILE_RETURN, MEAN_LENGTH, MEAN_RETURN, MESSAGE_RATE, NET_RETURN, SD_RETURN,
    quantile_of_sorted,
};
use crate::job::{
    ActionCount, Decision, EstimateDeclaration, Estimates, Metric, ParticipantValue, Phase,
    RecordedEpisodes, TestEpisode,
};
use crate::job::{Job, MetricName};
use crate::state::resumable;
use crate::train::decision_log::DecisionLog;
use crate::train::excursions::Excursions;
use crate::train::roll::{Choose, RollStreams, begin, roll, roll_by};
use crate::train::sightings::Sightings;
use crate::train::study::Study;

/// The number of episodes that advance in lockstep. Results depend on it, because lanes share streams.
const LANES: usize = 1000;

/// A test in progress.
pub(super) struct Test {
    /// The total number of episodes.
    episodes: usize,
    streams: RollStreams,
    counts: ActionCounts,
    /// `None` if the job does not ask for it.
    log: Option<DecisionLog>,
    played: Vec<TestEpisode>,
    batch: Batch,
    /// `None` if all participants have the same parameters.
    people: Option<People>,
    /// The participants' parameters, set at the end of the test; memory is reserved from the first batch.
    participants: Vec<ParticipantValue>,
    /// The cost of messages so far; maintained only if costs differ.
    costs: f64,
    environment: Environment,
    /// The metric that is the share of terminated episodes.
    terminated: MetricName,
    /// The trial whose people are the evaluation; `None` for people who come one after another.
    study: Option<Study>,
    recorded: RecordedEpisodes,
    /// What other actions lead to at the decisions of a trial; `None` in jobs.
    pub(super) excursions: Option<Excursions>,
    /// What the agent of a trial sees; `None` in jobs.
    pub(super) sightings: Option<Sightings>,
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

    /// Appends the parameters of all participants, by episode and place.
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
    pub(super) decisions: Vec<Decision>,
    pub(super) estimates: Vec<Estimates>,
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
    pub(super) recorded: RecordedEpisodes,
}

impl Test {
    /// The test of a job, before its first episode.
    pub(super) fn new(job: &Job) -> Self {
        let task = job.task();
        let environment = &job.environment;
        let study = job.trial.as_ref().map(|trial| Study::new(trial, job.seed));
        let mut streams = RollStreams::of_test(job.seed);
        if let Some(study) = &study {
            streams.environment = study.streams(job.seed);
        }
        let tested = task.tested(0);
        let reports = job.trial.as_ref().and_then(|trial| Study::reports(trial, job.seed));
        let tested = match reports {
            Some(reports) => Box::new(Reported::new(tested, reports)),
            None => tested,
        };
        let episodes = study.as_ref().map_or(job.evaluation.test_episodes as usize, Study::people);
        Test {
            episodes,
            streams,
            counts: ActionCounts::new(environment.strata(), task.interface().actions),
            log: (job.evaluation.record_decisions.of_test())
                .then(|| DecisionLog::new(job.agent.unavailable(), Phase::Test)),
            played: Vec::new(),
            people: (environment.differing() > 0 && study.is_none()).then(|| People {
                environment: environment.clone(),
                seed: job.seed,
                episodes: job.evaluation.test_episodes,
            }),
            participants: Vec::new(),
            costs: 0.0,
            environment: environment.clone(),
            terminated: job.termination_metric(),
            study,
            recorded: job.evaluation.record_episodes,
            excursions: None,
            sightings: None,
            batch: Batch { environment: tested, played: Vec::new() },
        }
    }

    /// The test of a job with estimates of its decisions, before its first episode.
    pub(super) fn estimating(self, job: &Job, declared: &[Arc<EstimateDeclaration>]) -> Self {
        let is_kept = job.evaluation.record_decisions.of_test();
        if declared.is_empty() && self.log.is_none() {
            return self;
        }
        let (actions, names) = (job.task().interface().actions, job.state_names());
        let estimation = |declared: &Arc<EstimateDeclaration>| {
            Estimation::new(declared.clone(), actions, &names)
        };
        let log = DecisionLog::new(job.agent.unavailable(), Phase::Test)
            .estimating(declared.iter().map(estimation).collect(), is_kept);
        Test { log: (is_kept || !declared.is_empty()).then_some(log), ..self }
    }

    /// The declarations of its estimates.
    pub(super) fn estimated(&self) -> Vec<Arc<EstimateDeclaration>> {
        self.log.iter().flat_map(DecisionLog::declarations).cloned().collect()
    }

    pub(super) fn is_over(&self) -> bool {
        self.played.len() == self.episodes
    }

    /// Whether an episode has begun. From then on, the actor may have state.
    pub(super) fn has_begun(&self) -> bool {
        !(self.played.is_empty() && self.batch.played.is_empty())
    }

    /// Plays a batch of episodes to its end, or until `pause` returns true; the next call continues.
    ///
    /// **Errors**: there is not enough memory for the episodes, or the agent of a trial cannot learn.
    pub(super) fn advance(
        &mut self,
        actor: &mut dyn Actor,
        pause: &dyn Fn() -> bool,
    ) -> Result<(), LearnerError> {
        if self.study.is_some() {
            return self.advance_study(actor, pause);
        }
        self.begin_batch(|environment, streams| begin(environment, actor, streams))?;
        let (batch, streams, mut player) = self.player(pause);
        roll(batch, actor, streams, &mut player);
        Ok(self.end_batch()?)
    }

    /// Plays a trial to its end, or until `pause` returns true; the next call continues.
    ///
    /// **Errors**: there is not enough memory for the episodes, or the agent cannot learn.
    fn advance_study(
        &mut self,
        actor: &mut dyn Actor,
        pause: &dyn Fn() -> bool,
    ) -> Result<(), LearnerError> {
        self.begin_batch(|_, _| {})?;
        let mut study = self.study.take().expect("the caller has a trial");
        let (mut excursions, mut sightings) = (self.excursions.take(), self.sightings.take());
        let (lanes, streams, mut player) = self.player(pause);
        study.assign(lanes);
        let mut actions = vec![Action::default(); lanes.lanes()];
        let mut probabilities = vec![0.0; actions.len() * lanes.action_spec().count];
        let mut rewards = vec![0.0; actions.len()];
        while !study.is_over() && !player.stop_requested() {
            let updated = study.begin_step(lanes, actor, &mut streams.environment)?;
            if let Some(sightings) = &mut sightings {
                sightings.updates.extend(updated.then(|| study.last_update()));
                sightings.see(lanes);
            }
            actor.act(lanes, &mut streams.actions, &mut actions, Some(&mut probabilities));
            if let Some(log) = &mut player.log {
                log.stand_beside(study.beside(|person| lanes.time(person)));
            }
            player.chosen(lanes, &actions, &probabilities);
            if let Some(excursions) = &mut excursions {
                excursions.see(lanes, &streams.environment);
            }
            lanes.step(&actions, &mut rewards, &mut streams.environment);
            player.paid(lanes, &rewards);
            study.end_step(&mut rewards, |person| lanes.time(person));
            if let Some(sightings) = &mut sightings {
                sightings.paid(&rewards);
            }
            actor.observe(lanes, &rewards);
        }
        let is_over = study.is_over();
        if is_over {
            study.end(lanes);
            if let Some(log) = &mut player.log {
                log.ended(lanes.statuses());
            }
        }
        self.study = Some(study);
        (self.excursions, self.sightings) = (excursions, sightings);
        if is_over { Ok(self.end_batch()?) } else { Ok(()) }
    }

    /// The day of the trial and its number of days; `None` without a trial.
    pub(super) fn days(&self) -> Option<(u32, u32)> {
        self.study.as_ref().map(Study::days)
    }

    /// Plays a batch of episodes to its end with choices that may fail. Calls `lanes` with their number
    /// before the first choice.
    ///
    /// **Errors**: the choices fail, or there is not enough memory for the episodes.
    pub(super) fn play_batch<E: From<OutOfMemory>>(
        &mut self,
        lanes: impl FnOnce(usize),
        choose: &mut Choose<'_, Simulated, E>,
    ) -> Result<(), E> {
        self.begin_batch(|environment, streams| {
            environment.reset(LaneSet::All, &mut streams.environment);
            lanes(environment.lanes());
        })?;
        let (batch, streams, mut player) = self.player(&|| false);
        roll_by(batch, choose, streams, &mut player)?;
        Ok(self.end_batch()?)
    }

    /// Begins the next batch with `begin`, unless a batch is in progress.
    ///
    /// **Errors**: there is not enough memory for the episodes.
    fn begin_batch(
        &mut self,
        begin: impl FnOnce(&mut Simulated, &mut RollStreams),
    ) -> Result<(), OutOfMemory> {
        let left = self.episodes - self.played.len();
        reserve_exact(&mut self.played, left, "the test episodes")?;
        let values = self.people.as_ref().map_or(0, People::count);
        reserve_exact(&mut self.participants, values, "the participants of the test")?;
        let Test { streams, batch, study, .. } = self;
        if batch.played.is_empty() {
            let lanes = if study.is_some() { left } else { LANES.min(left) };
            batch.environment = batch.environment.with_lanes(lanes);
            batch.played = vec![TestEpisode::default(); lanes];
            begin(&mut batch.environment, streams);
        }
        Ok(())
    }

    /// The batch, its streams, and the recorder of its episodes.
    fn player<'p>(
        &'p mut self,
        pause: &'p dyn Fn() -> bool,
    ) -> (&'p mut Simulated, &'p mut RollStreams, Player<'p>) {
        let Test { streams, counts, log, batch, costs, environment, .. } = self;
        let costs = costs_differ(environment).then_some(costs);
        let (log, played) = (log.as_mut(), &mut batch.played[..]);
        (&mut batch.environment, streams, Player { counts, log, played, costs, pause })
    }

    /// Stores the episodes of a batch, if it has been played to its end.
    ///
    /// **Errors**: there was not enough memory for the decisions.
    fn end_batch(&mut self) -> Result<(), OutOfMemory> {
        let Test { log, batch, study, participants, .. } = self;
        log.as_ref().map_or(Ok(()), DecisionLog::check)?;
        if batch.environment.any_running() {
            return Ok(());
        }
        let environment = &batch.environment;
        let mut values = Vec::new();
        for (lane, episode) in batch.played.iter_mut().enumerate() {
            episode.terminated = environment.has_terminated(lane);
            if study.is_some() {
                environment.participant(lane, &mut values);
                let (phase, episode) = (Phase::Test, lane as u32 + 1);
                participants.extend(values.drain(..).map(|(place, value)| ParticipantValue {
                    phase,
                    episode,
                    parameter: place as u8,
                    value,
                }));
            }
        }
        self.played.append(&mut batch.played);
        self.prepare_batch();
        Ok(())
    }

    /// The results, once all episodes are played.
    pub(super) fn finish(mut self) -> Tested {
        let (messages, actions) = (self.counts.messages(), self.counts.rows());
        let differ = costs_differ(&self.environment);
        let costs = self.environment.message_cost().map(|cost| match differ {
            // A product, as in the results of earlier jobs.
            false => cost * messages as f64,
            true => self.costs,
        });
        let messages = self.environment.has_nothing().then_some(messages);
        let mut state_names = self.environment.state_names();
        if let Some(study) = &self.study {
            state_names.extend(study.names());
        }
        if let Some(people) = &self.people {
            people.describe(&mut self.participants);
        }
        let participants = self.participants;
        // The participants of the test are recorded whether or not its decisions are.
        let estimates = self.log.as_ref().map(DecisionLog::estimates).unwrap_or_default();
        let (decisions, _) = self.log.map(DecisionLog::finish).unwrap_or_default();
        Tested {
            episodes: self.played,
            messages,
            costs,
            terminated: self.terminated,
            actions,
            decisions,
            estimates,
            participants,
            state_names,
            description: self.environment.description(),
            recorded: self.recorded,
        }
    }
}

/// Whether messages can have other costs to other people or at other moments, so that each is summed.
fn costs_differ(environment: &Environment) -> bool {
    environment.differing() > 0 || environment.costs_vary()
}

/// Test episodes in progress; empty between two batches.
struct Batch {
    environment: Simulated,
    played: Vec<TestEpisode>,
}

/// Records the episodes of a batch.
struct Player<'a> {
    counts: &'a mut ActionCounts,
    log: Option<&'a mut DecisionLog>,
    played: &'a mut [TestEpisode],
    /// `None` if messages have the same cost for every participant.
    costs: Option<&'a mut f64>,
    pause: &'a dyn Fn() -> bool,
}

impl StepObserver<Simulated> for Player<'_> {
    fn chosen(&mut self, lanes: &Simulated, actions: &[Action], probabilities: &[f64]) {
        if let Some(log) = &mut self.log {
            log.chosen(lanes, actions, probabilities);
        }
        for (lane, episode) in self.played.iter_mut().enumerate() {
            if lanes.statuses()[lane] == EpisodeStatus::Running && lanes.is_counted(lane) {
                episode.length += 1;
                let taken = lanes.taken(lane, actions[lane]);
                self.counts.add(lanes.stratum(lane), taken);
                if let Some(costs) = self.costs.as_deref_mut().filter(|_| taken.index() > 0) {
                    *costs += lanes.message_cost(lane);
                }
            }
        }
    }

    fn paid(&mut self, lanes: &Simulated, rewards: &[f64]) {
        if let Some(log) = &mut self.log {
            log.paid(lanes, rewards);
        }
        for (episode, outcome) in self.played.iter_mut().zip(lanes.outcomes(rewards)) {
            episode.total_reward += outcome;
        }
    }

    fn stop_requested(&self) -> bool {
        (self.pause)()
    }
}

resumable!([] Test {
    parts streams;
    fixed counts.counts;
    parts costs, played, batch.played;
    each log, study;
    check fits, "test episodes";
    then prepare_batch;
    parts batch.environment
});

resumable!([] TestEpisode { parts total_reward, length, terminated });

impl Test {
    /// Whether a batch is as large as it should be.
    fn fits(&self) -> bool {
        self.episodes.checked_sub(self.played.len()).is_some_and(|left| {
            let lanes = self.batch.played.len();
            lanes == 0 || self.study.is_some() || lanes == LANES.min(left)
        })
    }

    /// Gives the environment a lane for every episode of the batch.
    fn prepare_batch(&mut self) {
        self.batch.environment = self.batch.environment.with_lanes(self.batch.played.len());
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
        if self.recorded == RecordedEpisodes::None {
            let mut returns: Vec<f64> = self.episodes.iter().map(|e| e.total_reward).collect();
            returns.sort_unstable_by(f64::total_cmp);
            let value = quantile_of_sorted(&returns, 0.25);
            metrics.push(Metric { name: LOWER_QUARTILE_RETURN, value });
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

/// The number of choices by stratum and action.
struct ActionCounts {
    /// \[strata, actions\].
    counts: Vec<u64>,
    actions: usize,
}

impl ActionCounts {
    fn new(strata: usize, actions: usize) -> Self {
        ActionCounts { counts: vec![0; strata * actions], actions }
    }

    fn add(&mut self, stratum: usize, action: Action) {
        self.counts[stratum * self.actions + action.index()] += 1;
    }

    /// The number of choices of other actions than the first.
    fn messages(&self) -> u64 {
        self.counts.chunks(self.actions).map(|actions| actions[1..].iter().sum::<u64>()).sum()
    }

    fn rows(&self) -> Vec<ActionCount> {
        let has_strata = self.counts.len() > self.actions;
        let mut rows = Vec::new();
        for (stratum, actions) in (0..).zip(self.counts.chunks(self.actions)) {
            let stratum = has_strata.then_some(stratum);
            for (action, &count) in (0..=u8::MAX).zip(actions) {
                if count > 0 {
                    rows.push(ActionCount { stratum, action, count });
                }
            }
        }
        rows
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
            decisions: Vec::new(),
            estimates: Vec::new(),
            participants: Vec::new(),
            state_names: Vec::new(),
            description: None,
            terminated: DISENGAGEMENT_RATE,
            messages: Some(5),
            costs: Some(1.5 * 5.0),
            recorded: RecordedEpisodes::None,
        };
        let value = |name: &str| tested.metrics().iter().find(|m| m.name == name).unwrap().value;
        assert_eq!(value("mean_return"), 30.0);
        assert!((value("sd_return") - 700.0f64.sqrt()).abs() < 1e-12);
        assert!((value("mean_length") - 20.0 / 3.0).abs() < 1e-12);
        assert!((value("disengagement_rate") - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(value("message_rate"), 0.25);
        assert_eq!(value("mean_net_return"), 30.0 - 1.5 * 5.0 / 3.0);
        assert_eq!(value("lower_quartile_return"), 15.0);
        let first = tested.first_returns([1, 2].map(first_return).into_iter());
        let first: Vec<(MetricName, f64)> =
            first.map(|metric| (metric.name, metric.value)).collect();
        assert_eq!(first, [(first_return(1), 10.0), (first_return(2), 15.0)]);
        let mut found: Vec<MetricName> = tested.metrics().iter().map(|m| m.name).collect();
        found.sort_by_key(|name| METRICS.iter().position(|metric| metric == name));
        let of_tests = metrics_of(MetricPlace::Test);
        // The quartile is recorded where episodes are not.
        let of_tests = of_tests.chain([LOWER_QUARTILE_RETURN]);
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
            decisions: Vec::new(),
            estimates: Vec::new(),
            participants: Vec::new(),
            state_names: Vec::new(),
            description: None,
            terminated: DISENGAGEMENT_RATE,
            messages: Some(0),
            costs: None,
            recorded: RecordedEpisodes::All,
        };
        let names: Vec<MetricName> = tested.metrics().iter().map(|m| m.name).collect();
        let defined = [MEAN_RETURN, MEAN_LENGTH, DISENGAGEMENT_RATE, MESSAGE_RATE];
        assert_eq!(names, defined);
        assert!(tested.metrics().iter().all(|m| m.value.is_finite()));
    }
}
