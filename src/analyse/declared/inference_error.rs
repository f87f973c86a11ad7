//! The rate at which the more probable context is wrong.

use super::arm::by_value;
use crate::env::{FirstContext, inference_error};
use crate::job::Scalar;
use crate::key::Parameter;
use crate::manifest::Published;
use crate::record::JobRecord;

/// The error along sigma: by the formula, in test steps, and as published.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorFigure {
    /// One point per sigma.
    pub points: Vec<ErrorPoint>,
    /// Published rates: sigma and rate.
    pub published: Vec<(f64, f64)>,
}

/// The error at one sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorPoint {
    /// Feature noise.
    pub sigma: f64,
    /// The error by the formula.
    pub exact: f64,
    /// Share of the test steps of all completed runs at which the more probable context was wrong, without
    /// steps whose context is fixed; `None` without such test steps.
    pub seen: Option<f64>,
    /// These test steps.
    pub steps: u64,
    /// Completed runs.
    pub runs: usize,
}

impl ErrorFigure {
    /// The sigma at which the published rate is furthest from the exact rate, and the published
    /// minus the exact rate there.
    pub fn furthest_published(&self) -> Option<(f64, f64)> {
        let gaps = self.published.iter().filter_map(|(sigma, rate)| {
            let point = self.points.iter().find(|point| point.sigma == *sigma)?;
            Some((*sigma, rate - point.exact))
        });
        gaps.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))
    }
}

/// The number of test steps of a job whose context is known beforehand: a fixed first context is never wrong.
fn certain_steps(job: &JobRecord) -> u64 {
    let is_fixed = job.setting("environment.first_context").is_none_or(
        |first| matches!(first, Scalar::Text(word) if word == FirstContext::Fixed.word()),
    );
    if is_fixed { job.number("evaluation.test_episodes").unwrap_or(0.0) as u64 } else { 0 }
}

/// The error at every sigma of the jobs.
pub fn figure(jobs: &[&JobRecord], published: Option<&Published>) -> ErrorFigure {
    let point = |(at, jobs): (f64, Vec<&JobRecord>)| {
        let runs = jobs.iter().filter_map(|job| Some((job, job.completed()?)));
        let runs: Vec<_> = runs.collect();
        let (mut steps, mut wrong) = (0, 0);
        for (job, run) in &runs {
            for count in &run.actions {
                steps += count.count;
                // A stratum is a bin with one of the two contexts. Context 0 is more probable in bins from 5 on.
                let Some((bin, context)) = count.stratum.map(|of| (of / 2, of % 2)) else {
                    continue;
                };
                let likely = u8::from(bin < 5);
                wrong += if likely == context { 0 } else { count.count };
            }
            steps = steps.saturating_sub(certain_steps(job));
        }
        let seen = (steps > 0).then(|| wrong as f64 / steps as f64);
        ErrorPoint { sigma: at, exact: inference_error(at), seen, steps, runs: runs.len() }
    };
    let sigma = Parameter::Environment("sigma");
    let rates = published.into_iter().flat_map(|published| &published.rows);
    let rates = rates.filter(|row| row.metric.is_none());
    ErrorFigure {
        points: by_value("environment.sigma", jobs).into_iter().map(point).collect(),
        published: rates.filter_map(|row| Some((row.value_of(sigma)?, row.value))).collect(),
    }
}
