//! A metric along a parameter.

use super::arm::{ArmId, arms, distinct};
use crate::analyse::Sample;
use crate::env::inference_error;
use crate::manifest::{CurveAxis, Published};
use crate::record::JobRecord;

/// Lines along one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct CurveFigure {
    /// What the horizontal axis shows: `context_inference_error` or a dotted name.
    pub axis: String,
    /// The lines.
    pub lines: Vec<CurveLine>,
}

/// An arm along the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct CurveLine {
    /// The arm; the axis' parameter is not among its settings.
    pub name: ArmId,
    /// Its points, by x.
    pub points: Vec<CurvePoint>,
    /// The best mean return that any policy can reach, x and value; empty if it is not known, or
    /// the line shows another metric.
    pub optimum: Vec<(f64, f64)>,
    /// The published line, x and value; empty if there is none.
    pub published: Vec<(f64, f64)>,
}

/// A point of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct CurvePoint {
    /// Where it stands on the axis.
    pub x: f64,
    /// The value of the axis' parameter.
    pub parameter: f64,
    /// The metric of its seeds.
    pub sample: Sample,
}

/// The lines of the jobs.
pub fn figure(
    axis: CurveAxis,
    metric: &str,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> CurveFigure {
    let (label, parameter) = match axis {
        CurveAxis::ContextInferenceError => {
            ("context_inference_error".to_owned(), "environment.sigma".to_owned())
        }
        CurveAxis::Swept(parameter) => (parameter.to_string(), parameter.to_string()),
    };
    let place = |value: f64| match axis {
        CurveAxis::ContextInferenceError => inference_error(value),
        CurveAxis::Swept(_) => value,
    };
    let lines = arms(jobs, &[&parameter]).into_iter().map(|group| {
        let numbers = group.jobs.iter().filter_map(|job| job.number(&parameter)).collect();
        let mut optimum = Vec::new();
        let points = distinct(numbers).into_iter().map(|value| {
            let here = |job: &&&JobRecord| job.number(&parameter) == Some(value);
            let jobs = group.jobs.iter().filter(here).copied().collect();
            let name = group.name.clone();
            let here = super::Arm { name, jobs };
            let best = here.optimum().filter(|_| metric == "mean_return");
            optimum.extend(best.map(|best| (place(value), best)));
            CurvePoint { x: place(value), parameter: value, sample: here.sample(metric) }
        });
        let points = points.collect();
        let comparable = parameter == "environment.sigma" && metric == "mean_return";
        let published = published.filter(|_| comparable && group.name.settings.is_empty());
        let line = published
            .into_iter()
            .flat_map(|published| &published.curves)
            .find(|curve| curve.agent == group.name.agent && curve.scenario == group.name.scenario);
        CurveLine {
            points,
            optimum,
            published: line.map_or_else(Vec::new, |line| {
                let points = line.sigma.iter().zip(&line.mean_return);
                points.map(|(sigma, value)| (place(*sigma), *value)).collect()
            }),
            name: group.name,
        }
    });
    CurveFigure { axis: label, lines: lines.collect() }
}
