//! What a policy leads to from each decision of a trial: the truth of an estimated value.
//!
//! In: a trial, and a policy that makes a number of decisions one after the other. Out: the mean outcome of these decisions,
//! from each decision of the trial on. Courses change nothing in the trial, and draw from a stream of their own.

use crate::agent::Rewards;
use crate::env::{Action, EpisodeStatus, Simulated, Simulation, VectorEnvironment};
use crate::estimate::Feature;
use crate::job::{Decision, Job, TargetPolicy};
use crate::rng::{Purpose, Stream};
use crate::state::resumable;
use crate::train::decision_log::DecisionObserver;
use crate::train::excursions::ProximalOutcome;
use crate::train::roll::ChosenStep;
use crate::train::study::Study;

/// The courses of one policy.
#[derive(Debug)]
pub(super) struct PolicyCourses {
    outcome: ProximalOutcome,
    policy: TargetPolicy,
    /// The number before a decision that a named policy is.
    feature: Option<Feature>,
    actions: usize,
    /// The number of decisions of a course.
    steps: u32,
    seed: u64,
    per_day: u32,
    /// The decisions of each person's stay, \[people\].
    stays: Vec<u32>,
    courses: Vec<CourseMean>,
}

/// The mean outcome of a course.
#[derive(Clone, Debug, Default)]
pub(super) struct CourseMean {
    /// The number of the person, from 1, and the person's step.
    episode: u32,
    step: u32,
    /// Not a number where an outcome is not known.
    mean: f64,
}

impl PolicyCourses {
    /// No course yet; `None` if the job has no trial, the estimate no policy for its actions, or a policy that copies of
    /// people do not have: the agent's own, or a number of the trial beside the state of people.
    pub(super) fn new(
        job: &Job,
        steps: u32,
        outcome: ProximalOutcome,
        (policy, feature): (&TargetPolicy, Option<Feature>),
    ) -> Option<PolicyCourses> {
        let actions = job.task().interface().actions;
        policy.probabilities(actions, 0.5).ok()?;
        let of_person = job.environment.state_names().len();
        let is_known = match (policy, feature) {
            (TargetPolicy::Named(_), None) => false,
            (_, Some(Feature::State(index))) => index < of_person,
            (_, Some(Feature::Step) | None) => true,
        };
        is_known.then_some(())?;
        let trial = job.trial.as_ref()?;
        Some(PolicyCourses {
            outcome,
            policy: policy.clone(),
            feature,
            actions,
            steps,
            seed: job.seed,
            per_day: trial.decisions_per_day,
            stays: Study::new(trial, job.seed).stay_lengths(),
            courses: Vec::new(),
        })
    }

    /// The courses by episode and step.
    pub(super) fn finish(mut self) -> PolicyCourses {
        self.courses.sort_unstable_by_key(|one| (one.episode, one.step));
        self
    }

    /// Whether the courses of both are the same.
    pub(super) fn equals(&self, other: &PolicyCourses) -> bool {
        let content = |one: &PolicyCourses| (one.outcome, one.policy.clone(), one.steps);
        content(self) == content(other)
    }

    /// The mean of the courses that begin at decisions which an estimate of the value counts; `None` if it counts none.
    /// `decisions` are those of the trial, by episode and step.
    pub(super) fn value(&self, decisions: &[Decision]) -> Option<f64> {
        let steps = self.steps as usize;
        let (mut sum, mut count) = (0.0, 0.0);
        for (start, (first, course)) in decisions.iter().zip(&self.courses).enumerate() {
            assert_eq!((first.episode, first.step), (course.episode, course.step));
            let of_person = decisions[start..].iter().take(steps);
            let made = of_person.take_while(|one| one.episode == first.episode);
            let (number, last) = made.fold((0, first), |(number, _), one| (number + 1, one));
            let is_whole = number == steps || last.terminated;
            let stay = self.stays[first.episode as usize - 1];
            if is_whole && first.step + self.steps <= stay && course.mean.is_finite() {
                sum += course.mean;
                count += 1.0;
            }
        }
        (count > 0.0).then(|| sum / count)
    }

    /// The probabilities of the policy at the next decision of a lane, \[actions\]. `state` is a buffer.
    fn probabilities(&self, lanes: &dyn Simulation, lane: usize, state: &mut Vec<f64>) -> Vec<f64> {
        let message = match self.feature {
            Some(Feature::State(index)) => {
                state.clear();
                lanes.record_state(lane, state);
                state[index]
            }
            Some(Feature::Step) => f64::from(lanes.times()[lane]),
            None => 0.0,
        };
        // What is no probability leads to no estimate.
        let message = if message.is_nan() { 0.0 } else { message.clamp(0.0, 1.0) };
        self.policy.probabilities(self.actions, message).unwrap_or_default()
    }

    /// The action at a decision of a course that began at a step of a person.
    fn action(&self, person: usize, (first, later): (u32, u32), probabilities: &[f64]) -> Action {
        let mut stream = Stream::of_person(self.seed, Purpose::PolicyCourse, person as u32);
        stream.go_to(u64::from(first) * u64::from(self.steps) + u64::from(later));
        let mut rest = stream.unit();
        let mut chosen = 0;
        for (action, probability) in probabilities.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            chosen = action;
            if rest < *probability {
                break;
            }
            rest -= probability;
        }
        Action::from_index(chosen).expect("a policy has a probability for each action")
    }
}

impl DecisionObserver for PolicyCourses {
    /// Follows the policy in a copy of the lanes, with copies of the streams.
    fn decided(&mut self, step: &ChosenStep<'_, Simulated>, decisions: &[Decision]) {
        if decisions.is_empty() {
            return;
        }
        let mut copy = step.environment.copied().expect("a state is saved in memory");
        let mut streams = step.streams.clone();
        let lanes = copy.lanes();
        let (mut actions, mut rewards) = (vec![Action::default(); lanes], vec![0.0; lanes]);
        let mut sums = vec![0.0; decisions.len()];
        let mut state = Vec::new();
        let time = step.study.map_or(0, |study| study.time());
        let mut probabilities = vec![0.0; lanes * self.actions];
        for later in 0..self.steps {
            if later > 0 && (time + later).is_multiple_of(self.per_day) {
                copy.begin_day((time + later) / self.per_day);
            }
            for Decision { episode, step, .. } in decisions {
                let person = *episode as usize - 1;
                let own = self.probabilities(&*copy, person, &mut state);
                actions[person] = self.action(person, (*step, later), &own);
                probabilities[person * self.actions..][..self.actions].copy_from_slice(&own);
            }
            let is_running = |lane: usize| copy.statuses()[lane] == EpisodeStatus::Running;
            let running: Vec<bool> =
                decisions.iter().map(|one| is_running(one.episode as usize - 1)).collect();
            copy.expect(&probabilities);
            copy.step(&actions, &mut rewards, &mut streams);
            for ((sum, decision), _) in
                sums.iter_mut().zip(decisions).zip(&running).filter(|(_, running)| **running)
            {
                let lane = decision.episode as usize - 1;
                *sum += self.outcome.of(&*copy, lane, &rewards, &mut state);
            }
        }
        let ended = decisions.iter().zip(sums);
        self.courses.extend(ended.map(|(Decision { episode, step, .. }, sum)| CourseMean {
            episode: *episode,
            step: *step,
            mean: sum / f64::from(self.steps),
        }));
    }

    fn paid(&mut self, _: &[Decision], _: Rewards<'_>) {}
}

resumable!([] CourseMean { parts episode, step, mean });
resumable!([] PolicyCourses { parts courses });
