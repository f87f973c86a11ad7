//! What observes a test or a trial while it is played: a list, to which observers are attached where they are asked for.
//!
//! Observers change nothing, and draw from none of the streams.

use std::sync::Arc;

use crate::agent::{OutOfMemory, Rewards};
use crate::env::{Action, Environment, EpisodeStatus, Simulated, VectorEnvironment};
use crate::estimate::Estimation;
use crate::job::{ActionCount, Decision, EstimateDeclaration, Estimates, Job, Phase, TestEpisode};
use crate::state::resumable;
use crate::train::decision_log::{DecisionLog, DecisionObserver};
use crate::train::excursions::Excursions;
use crate::train::policy_courses::PolicyCourses;
use crate::train::roll::{ChosenStep, LaneObserver};
use crate::train::sightings::Sightings;
use crate::train::study::Study;

impl DecisionObserver for Estimation {
    fn paid(&mut self, decisions: &[Decision], _: Rewards<'_>) {
        // Others read the decisions once the last is made.
        if !self.declaration().estimator.reads_all() {
            decisions.iter().for_each(|decision| self.add(decision));
        }
    }
}

/// The observers of a test or a trial.
pub(super) struct Observers {
    pub(super) counts: EpisodeCounts,
    /// Whether the job records its decisions.
    is_recorded: bool,
    /// `None` if the decisions are neither recorded nor observed.
    log: Option<DecisionLog>,
    estimations: Vec<Estimation>,
    /// `None` if no truth of an effect is asked for.
    excursions: Option<Excursions>,
    /// Courses under the policies whose true value is asked for.
    courses: Vec<PolicyCourses>,
    /// `None` if no standard error is to account for the learning.
    sightings: Option<Sightings>,
}

/// What was observed of a trial that is over.
#[derive(Default)]
pub(super) struct ObservedTrial {
    /// The decisions, by episode and step; empty if they are neither recorded nor read again.
    pub(super) decisions: Vec<Decision>,
    /// What other actions lead to, by episode and step.
    pub(super) excursions: Option<Excursions>,
    /// What policies lead to from every decision.
    pub(super) courses: Vec<PolicyCourses>,
    /// What the agent saw, by episode and step.
    pub(super) sightings: Option<Sightings>,
}

impl Observers {
    /// The observers that a job needs for its results.
    pub(super) fn new(job: &Job) -> Self {
        let is_recorded = job.evaluation.record_decisions.of_test();
        Observers {
            counts: EpisodeCounts::new(&job.environment, job.task().interface().actions),
            is_recorded,
            log: is_recorded.then(|| DecisionLog::new(job.agent.unavailable(), Phase::Test)),
            estimations: Vec::new(),
            excursions: None,
            courses: Vec::new(),
            sightings: None,
        }
    }

    /// Attaches these estimates of a job.
    pub(super) fn estimate(&mut self, job: &Job, declared: &[Arc<EstimateDeclaration>]) {
        let (actions, names) = (job.task().interface().actions, job.state_names());
        let stays = job.trial.as_ref().map(|trial| Study::new(trial, job.seed).stay_lengths());
        let estimation = |declared: &Arc<EstimateDeclaration>| {
            let estimation = Estimation::new(declared.clone(), actions, &names);
            estimation.of_stays(stays.clone().unwrap_or_default())
        };
        self.estimations.extend(declared.iter().map(estimation));
        self.log_decisions(job);
    }

    /// Attaches excursions from the trial of a job.
    pub(super) fn explore(&mut self, job: &Job, excursions: Excursions) {
        self.excursions = Some(excursions);
        self.log_decisions(job);
    }

    /// Attaches courses under a policy, from every decision of the trial of a job.
    pub(super) fn follow(&mut self, job: &Job, courses: Vec<PolicyCourses>) {
        self.courses = courses;
        self.log_decisions(job);
    }

    /// Attaches a record of what the agent sees in the trial of a job.
    pub(super) fn see(&mut self, job: &Job) {
        self.sightings = Some(Sightings::default());
        self.log_decisions(job);
    }

    /// Logs the decisions, and keeps those that are read again after the trial.
    fn log_decisions(&mut self, job: &Job) {
        let new = || DecisionLog::new(job.agent.unavailable(), Phase::Test);
        let reads_all = |one: &Estimation| one.declaration().estimator.reads_all();
        let is_kept = self.is_recorded
            || self.excursions.is_some()
            || !self.courses.is_empty()
            || self.sightings.is_some()
            || self.estimations.iter().any(reads_all);
        let is_observed = is_kept || !self.estimations.is_empty();
        self.log = is_observed.then(|| new().keeping(is_kept));
    }

    /// The declarations of the attached estimates.
    pub(super) fn declared(&self) -> Vec<Arc<EstimateDeclaration>> {
        self.estimations.iter().map(|one| one.declaration().clone()).collect()
    }

    /// Observes which episodes of a trial have ended once it is over.
    pub(super) fn ended(&mut self, statuses: &[EpisodeStatus]) {
        self.log.iter_mut().for_each(|log| log.ended(statuses));
    }

    /// Reports a failed allocation. **Errors**: there was not enough memory for a decision.
    pub(super) fn check(&self) -> Result<(), OutOfMemory> {
        self.log.as_ref().map_or(Ok(()), DecisionLog::check)
    }

    /// Whether the decisions belong to the results.
    pub(super) fn is_recorded(&self) -> bool {
        self.is_recorded
    }

    /// The estimates, and what was observed beside them.
    pub(super) fn finish(mut self) -> (Vec<Estimates>, ObservedTrial) {
        let (decisions, _) = self.log.map(DecisionLog::finish).unwrap_or_default();
        let reads_all = |one: &&mut Estimation| one.declaration().estimator.reads_all();
        for estimation in self.estimations.iter_mut().filter(reads_all) {
            decisions.iter().for_each(|decision| estimation.add(decision));
        }
        let excursions = self.excursions.map(Excursions::finish);
        let sightings = self.sightings.map(Sightings::finish);
        let estimates = self.estimations.iter().map(Estimation::finish).collect();
        let courses = self.courses.into_iter().map(PolicyCourses::finish).collect();
        (estimates, ObservedTrial { decisions, excursions, courses, sightings })
    }

    /// The log with the observers of its decisions.
    fn of_decisions(
        &mut self,
    ) -> Option<(&mut DecisionLog, impl Iterator<Item = &mut dyn DecisionObserver>)> {
        let estimations = self.estimations.iter_mut().map(|one| one as &mut dyn DecisionObserver);
        let excursions = self.excursions.iter_mut().map(|one| one as &mut dyn DecisionObserver);
        let courses = self.courses.iter_mut().map(|one| one as &mut dyn DecisionObserver);
        let sightings = self.sightings.iter_mut().map(|one| one as &mut dyn DecisionObserver);
        let others = excursions.chain(courses).chain(sightings);
        Some((self.log.as_mut()?, estimations.chain(others)))
    }
}

impl LaneObserver<Simulated> for Observers {
    fn chosen(&mut self, step: &ChosenStep<'_, Simulated>) {
        self.counts.chosen(step);
        if let Some((log, observers)) = self.of_decisions() {
            log.chosen(step);
            observers.for_each(|observer| observer.decided(step, log.latest()));
        }
    }

    fn paid(&mut self, lanes: &Simulated, rewards: Rewards<'_>) {
        self.counts.paid(lanes, rewards);
        if let Some((log, observers)) = self.of_decisions() {
            log.paid(lanes, rewards);
            observers.for_each(|observer| observer.paid(log.latest(), rewards));
            log.end_step(lanes.statuses());
        }
    }
}

resumable!([] Observers { parts counts; each log, estimations, excursions, courses, sightings });

/// The episodes in progress, and the choices and costs of all episodes.
pub(super) struct EpisodeCounts {
    /// The episodes of the lanes; empty between two batches.
    pub(super) running: Vec<TestEpisode>,
    /// The number of choices by stratum and action, \[strata, actions\].
    choices: Vec<u64>,
    actions: usize,
    /// The cost of messages; `None` if messages have the same cost for everybody and at any moment.
    pub(super) costs: Option<f64>,
}

impl EpisodeCounts {
    fn new(environment: &Environment, actions: usize) -> Self {
        let differ = environment.differing() > 0 || environment.costs_vary();
        EpisodeCounts {
            running: Vec::new(),
            choices: vec![0; environment.strata() * actions],
            actions,
            costs: differ.then_some(0.0),
        }
    }

    /// The number of choices of other actions than the first.
    pub(super) fn messages(&self) -> u64 {
        self.choices.chunks(self.actions).map(|actions| actions[1..].iter().sum::<u64>()).sum()
    }

    /// The choices that were made at all.
    pub(super) fn rows(&self) -> Vec<ActionCount> {
        let has_strata = self.choices.len() > self.actions;
        let mut rows = Vec::new();
        for (stratum, actions) in (0..).zip(self.choices.chunks(self.actions)) {
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

impl LaneObserver<Simulated> for EpisodeCounts {
    fn chosen(&mut self, step: &ChosenStep<'_, Simulated>) {
        let ChosenStep { environment: lanes, actions, .. } = step;
        for (lane, episode) in self.running.iter_mut().enumerate() {
            if lanes.statuses()[lane] == EpisodeStatus::Running && lanes.is_counted(lane) {
                episode.length += 1;
                let taken = lanes.taken(lane, actions[lane]);
                self.choices[lanes.stratum(lane) * self.actions + taken.index()] += 1;
                if let Some(costs) = self.costs.as_mut().filter(|_| taken != Action::default()) {
                    *costs += lanes.message_cost(lane);
                }
            }
        }
    }

    fn paid(&mut self, lanes: &Simulated, rewards: Rewards<'_>) {
        let outcomes = lanes.outcomes(rewards.values);
        for (episode, outcome) in self.running.iter_mut().zip(outcomes) {
            episode.total_reward += outcome;
        }
        if let Some(costs) = self.costs.as_mut().filter(|_| lanes.costs_follow()) {
            // Ended lanes have neither outcomes nor rewards.
            *costs +=
                outcomes.iter().zip(rewards.values).map(|(one, paid)| one - paid).sum::<f64>();
        }
    }
}

resumable!([] EpisodeCounts { fixed choices; parts costs, running });

resumable!([] TestEpisode { parts total_reward, length, terminated });
