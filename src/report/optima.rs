//! The optima of jobs, one per environment and scenario.

use std::collections::HashMap;
use std::mem;

use crate::env::{Environment, Scenario, StepCountModel};
use crate::job::{Job, environment_text, people_text};
use crate::optimum::{self, NoOptimum};

/// The problems that jobs solve, each once.
#[derive(Default)]
pub(super) struct Problems {
    problems: Vec<Problem>,
    /// The index of each problem by its text.
    known: HashMap<String, usize>,
    /// The index of the problem of each job.
    of_jobs: Vec<usize>,
}

/// An environment and a scenario, and what keeps everybody in a trial from the optimum.
struct Problem {
    environment: Environment,
    scenario: Scenario,
    reality: Option<(&'static str, f64)>,
}

/// The optima of jobs.
pub(super) struct Optima {
    /// The highest mean return of any policy for each job; `None` if it cannot be computed.
    pub(super) of_jobs: Vec<Option<f64>>,
    /// The distinct reasons for unknown optima of jobs whose scenarios show the state.
    pub(super) unknown: Vec<String>,
}

/// What keeps everybody in the trial of a job from the optimum of the environment.
fn reality(job: &Job) -> Option<(&'static str, f64)> {
    job.trial.as_ref()?.without_optimum()
}

impl Problem {
    fn is_of(&self, job: &Job) -> bool {
        self.environment == job.environment
            && self.scenario == job.scenario
            && self.reality == reality(job)
    }

    /// `None` in a family without an optimum.
    fn model(&self) -> Option<&StepCountModel> {
        self.environment.model()
    }

    /// Whether the optimum can be computed. If there are several reasons against it, a scenario that hides
    /// the state takes precedence.
    fn check(&self) -> Result<(), NoOptimum> {
        let family = self.environment.family().name;
        let model = self.model().ok_or(NoOptimum::Family { family })?;
        let reality = self.reality.map_or(Ok(()), |(key, value)| {
            Err(NoOptimum::NotKnown { key, value: value.to_string() })
        });
        let alike = optimum::check_people(&model.population);
        match optimum::check(&model.parameters, &self.scenario) {
            hidden @ Err(NoOptimum::StateHidden { .. }) => hidden,
            other => alike.and(reality).and(other),
        }
    }
}

impl Problems {
    /// Adds the next job.
    pub(super) fn add(&mut self, job: &Job) {
        // Most jobs differ from the one before them in their seeds alone.
        let last = self.of_jobs.last().copied();
        if let Some(last) = last.filter(|last| self.problems[*last].is_of(job)) {
            self.of_jobs.push(last);
            return;
        }
        let (environment, people) =
            (environment_text(&job.environment), people_text(&job.environment));
        let text = format!("{environment} {people} {} {:?}", job.scenario, reality(job));
        let new = self.problems.len();
        let index = *self.known.entry(text).or_insert(new);
        if index == new {
            let (environment, scenario) = (job.environment.clone(), job.scenario.clone());
            self.problems.push(Problem { environment, scenario, reality: reality(job) });
        }
        self.of_jobs.push(index);
    }

    /// The optima of the jobs, in the order in which they were added, if `is_completed`. `on_progress`
    /// receives the number of optima found so far and the total.
    pub(super) fn optima(
        &self,
        is_completed: impl Iterator<Item = bool>,
        mut on_progress: impl FnMut(usize, usize),
    ) -> Optima {
        let mut is_new = vec![true; self.problems.len()];
        let completed = self.of_jobs.iter().zip(is_completed).filter(|(_, is)| *is);
        let wanted = completed.filter(|(at, _)| mem::replace(&mut is_new[**at], false));
        let mut unknown: Vec<String> = Vec::new();
        let mut solved = Vec::new();
        for at in wanted.map(|(at, _)| *at) {
            let reason = match self.problems[at].check() {
                Ok(()) => {
                    solved.push(at);
                    continue;
                }
                Err(NoOptimum::StateHidden { .. } | NoOptimum::Family { .. }) => continue,
                Err(
                    error @ (NoOptimum::NotKnown { .. }
                    | NoOptimum::PeopleDiffer { .. }
                    | NoOptimum::TooLong { .. }),
                ) => error.to_string(),
            };
            if !unknown.contains(&reason) {
                unknown.push(reason);
            }
        }
        let pair = |at: &usize| {
            let problem = &self.problems[*at];
            Some((&problem.model()?.parameters, &problem.scenario))
        };
        let pairs: Vec<_> = solved.iter().filter_map(pair).collect();
        let found = optimum::several(&pairs, |done| on_progress(done, pairs.len()));
        let mut best = vec![None; self.problems.len()];
        for (at, found) in solved.into_iter().zip(found) {
            best[at] = found.ok().map(|found| found.mean_return);
        }
        Optima { of_jobs: self.of_jobs.iter().map(|at| best[*at]).collect(), unknown }
    }
}
