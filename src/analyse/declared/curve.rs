//! A metric along a parameter.

use super::arm::{ArmId, arms, by_value, decided_by};
use super::published;
use crate::analyse::{Sample, SeedPairing, Undefined, t_test};
use crate::env::inference_error;
use crate::job::MetricName;
use crate::manifest::{CurveAxis, ERROR_AXIS, Published, parameter as parameter_named};
use crate::record::JobRecord;

/// Lines along one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct CurveFigure {
    /// The horizontal axis: `context_inference_error` or a dotted name.
    pub axis: String,
    /// The lines.
    pub lines: Vec<CurveLine>,
}

/// An arm along the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct CurveLine {
    /// The arm, without the parameter of the axis among its settings.
    pub name: ArmId,
    /// Its points, by x; empty if the arm lacks the parameter of the axis.
    pub points: Vec<LinePoint>,
    /// The metric of the seeds of an arm that lacks the parameter of the axis, wherever on the axis.
    pub across: Option<Sample>,
    /// The best mean return that any policy can reach, x and value; empty if it is not known, or
    /// the line shows another metric.
    pub optimum: Vec<(f64, f64)>,
    /// The published line, x and value; empty if there is none.
    pub published: Vec<(f64, f64)>,
}

/// A point of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct LinePoint {
    /// Its position on the axis.
    pub x: f64,
    /// The value of the parameter of the axis.
    pub parameter: f64,
    /// The metric of its seeds.
    pub sample: Sample,
}

/// Level below which a corrected p value counts as a finding.
pub const ALPHA: f64 = 0.05;

/// The comparison of two means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Apart {
    /// The difference is significant.
    Surely,
    /// The difference is not significant.
    Perhaps,
    /// There are too few seeds for a test.
    Untested,
}

impl Apart {
    /// Whether two means differ, by the t test of the design with Bonferroni's correction for `pairs`
    /// comparisons. Differences without variance cannot be tested, unless they are 0.
    pub(super) fn of((one, other): (&Sample, &Sample), design: SeedPairing, pairs: usize) -> Apart {
        match t_test(one, other, design) {
            Ok(test) if test.p * (pairs as f64) < ALPHA => Apart::Surely,
            Ok(_) => Apart::Perhaps,
            Err(Undefined::NoVariance) if one.mean() == other.mean() => Apart::Perhaps,
            Err(_) => Apart::Untested,
        }
    }
}

/// Directions of lines from their first to their last point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Trends {
    /// Lines whose first and last point can be compared by a test.
    pub lines: usize,
    /// Lines that fall significantly.
    pub falls: usize,
    /// Lines that rise significantly.
    pub rises: usize,
}

/// The ends of a line.
#[derive(Clone, Copy, Debug)]
pub struct Ends<'l> {
    /// The first point that has a mean, and its mean.
    pub first: (&'l LinePoint, f64),
    /// The last point that has a mean, and its mean.
    pub last: (&'l LinePoint, f64),
    /// Whether the means differ.
    pub apart: Apart,
    /// How the seeds of both points are paired in the test.
    pub design: SeedPairing,
}

impl Ends<'_> {
    /// Whether the line has more than one point.
    pub fn are_apart(&self) -> bool {
        self.first.0.x != self.last.0.x
    }
}

impl CurveLine {
    /// The first and the last point that have a mean, compared with correction for `pairs`
    /// comparisons.
    pub fn ends(&self, pairs: usize) -> Option<Ends<'_>> {
        let mut seen =
            self.points.iter().filter_map(|point| Some((point, point.sample.mean().ok()?)));
        let first = seen.next()?;
        let last = seen.next_back().unwrap_or(first);
        let samples = (&first.0.sample, &last.0.sample);
        let design = SeedPairing::of(samples.0, samples.1);
        Some(Ends { first, last, apart: Apart::of(samples, design, pairs), design })
    }

    /// The metric of its seeds at a position on the axis, if it has any there.
    fn sample_at(&self, x: f64) -> Option<&Sample> {
        let point = self.points.iter().find(|point| point.x == x);
        point.map(|point| &point.sample).or(self.across.as_ref())
    }

    /// The numbers of seeds behind each of its means.
    pub fn seeds(&self) -> impl Iterator<Item = usize> {
        let samples = self.points.iter().map(|point| &point.sample).chain(&self.across);
        samples.map(Sample::n).filter(|n| *n > 0)
    }

    /// The best mean return that any policy can reach at a position on the axis, if it is known.
    pub fn optimum_at(&self, x: f64) -> Option<f64> {
        self.optimum.iter().find(|(at, _)| *at == x).map(|(_, best)| *best)
    }
}

impl CurveFigure {
    /// Whether the axis shows the context inference error.
    pub fn is_error(&self) -> bool {
        self.axis == ERROR_AXIS
    }

    /// The numbers of lines that fall and rise significantly, corrected for the number of lines;
    /// `None` if no line can be tested. Lines with too few seeds for a test do not count.
    pub fn trends(&self) -> Option<Trends> {
        let pairs = self.lines.iter().filter(|line| line.across.is_none()).count();
        let mut trends = Trends::default();
        for Ends { first: (_, start), last: (_, end), apart, .. } in
            self.lines.iter().filter_map(|line| line.ends(pairs)).filter(|ends| ends.are_apart())
        {
            trends.lines += usize::from(apart != Apart::Untested);
            trends.falls += usize::from(apart == Apart::Surely && end < start);
            trends.rises += usize::from(apart == Apart::Surely && end > start);
        }
        (trends.lines > 0).then_some(trends)
    }

    /// The gaps between two lines at the points that both have: the point, the difference of the means, and
    /// whether it is significant, corrected for the number of points. A line without points spans the points
    /// of the other line.
    fn gaps(&self) -> Vec<(&LinePoint, f64, Apart, SeedPairing)> {
        let [first, second] = self.lines.as_slice() else { return Vec::new() };
        let (one, other) = if first.points.is_empty() { (second, first) } else { (first, second) };
        let pairs = one.points.len();
        let gap = |point| {
            let LinePoint { sample, x, .. }: &LinePoint = point;
            let (sample, other) = (sample, other.sample_at(*x)?);
            let design = SeedPairing::of(sample, other);
            let (one, two) = design.compared(sample, other);
            let gap = one.mean().ok()? - two.mean().ok()?;
            Some((point, gap, Apart::of((sample, other), design, pairs), design))
        };
        one.points.iter().filter_map(gap).collect()
    }

    /// Whether every gap between two lines can be tested.
    pub fn are_gaps_tested(&self) -> bool {
        self.gaps().iter().all(|(_, _, apart, _)| *apart != Apart::Untested)
    }

    /// The widest gap between two lines. Significant gaps take precedence over wider gaps.
    pub fn widest_gap(&self) -> Option<(&LinePoint, f64, Apart, SeedPairing)> {
        let gaps = self.gaps().into_iter();
        let rank = |(_, gap, apart, _): &(&LinePoint, f64, Apart, SeedPairing)| {
            let certainty = match apart {
                Apart::Surely => 2,
                Apart::Perhaps => 1,
                Apart::Untested => 0,
            };
            (certainty, gap.abs())
        };
        gaps.max_by(|one, other| {
            let (one, other) = (rank(one), rank(other));
            one.0.cmp(&other.0).then(one.1.total_cmp(&other.1))
        })
    }
}

/// The lines of the jobs.
pub fn figure(
    axis: CurveAxis,
    metric: MetricName,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> CurveFigure {
    let (label, parameter) = match axis {
        CurveAxis::ContextInferenceError => (ERROR_AXIS.to_owned(), "environment.sigma".to_owned()),
        CurveAxis::Swept(parameter) => (parameter.to_string(), parameter.to_string()),
    };
    let x_of = |value: f64| match axis {
        CurveAxis::ContextInferenceError => inference_error(value),
        CurveAxis::Swept(_) => value,
    };
    // Parameters zipped with the axis vary along a line.
    let along = [vec![parameter.clone()], decided_by(&parameter, jobs)].concat();
    let along: Vec<&str> = along.iter().map(String::as_str).collect();
    let lines = arms(jobs, &along).into_iter().map(|arm| {
        let has_none = arm.jobs.iter().all(|job| job.number(&parameter).is_none());
        let across = has_none.then(|| arm.sample(metric));
        let mut optimum = Vec::new();
        let points = by_value(&parameter, &arm.jobs).into_iter().map(|(value, jobs)| {
            let name = arm.name.clone();
            let here = super::Arm { name, jobs };
            let best = here.optimum_of(metric);
            optimum.extend(best.map(|best| (x_of(value), best)));
            LinePoint { x: x_of(value), parameter: value, sample: here.sample(metric) }
        });
        let points = points.collect();
        let value = |name: &str| arm.jobs.first()?.setting(name);
        let of = (&*arm.name.agent, &*arm.name.scenario);
        let published = published::rows(published, metric, of, &arm.name, &[&parameter], &value);
        let swept = parameter_named(&parameter);
        CurveLine {
            points,
            across,
            optimum,
            published: published
                .into_iter()
                .filter_map(|row| Some((x_of(row.value_of(swept?)?), row.value)))
                .collect(),
            name: arm.name,
        }
    });
    CurveFigure { axis: label, lines: lines.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line with three seeds at each of x = 1, 2, …. `points` holds the mean and the distance of
    /// the two outer seeds from it.
    fn line(points: &[(f64, f64)]) -> CurveLine {
        let point = |(x, (mean, spread)): (f64, &(f64, f64))| {
            let values = [(1, *mean), (2, mean - spread), (3, mean + spread)];
            LinePoint { x, parameter: x, sample: Sample::new(values, 0, 0).unwrap() }
        };
        CurveLine {
            name: ArmId { agent: "dqn".into(), scenario: String::new(), settings: Vec::new() },
            points: (1..).map(f64::from).zip(points).map(point).collect(),
            across: None,
            optimum: Vec::new(),
            published: Vec::new(),
        }
    }

    fn figure(lines: Vec<CurveLine>) -> CurveFigure {
        CurveFigure { axis: "environment.sigma".into(), lines }
    }

    #[test]
    fn a_difference_counts_for_less_the_more_pairs_are_looked_at() {
        // The differences of three seeds are 40 and 40 ± 6.93: t is 10 with 2 degrees of freedom, and p 0.00985.
        let line = line(&[(20.0, 9.0), (60.0, 15.928)]);
        let test = line.ends(1).unwrap();
        assert_eq!(test.design, SeedPairing::Matched);
        assert_eq!(line.ends(5).unwrap().apart, Apart::Surely);
        assert_eq!(line.ends(6).unwrap().apart, Apart::Perhaps);
    }

    #[test]
    fn lines_rise_and_fall_beyond_chance_alone() {
        let mut one_seed = line(&[(20.0, 1.0), (90.0, 1.0)]);
        one_seed.points[1].sample = Sample::new([(1, 90.0)], 0, 2).unwrap();
        assert_eq!(one_seed.ends(1).unwrap().apart, Apart::Untested);
        let lines = vec![
            line(&[(90.0, 1.0), (50.0, 1.0), (20.0, 2.0)]),
            line(&[(20.0, 1.0), (90.0, 2.0)]),
            line(&[(20.0, 90.0), (30.0, 9.0)]),
            // Without variance, there is no test.
            line(&[(50.0, 0.0), (55.0, 0.0)]),
            line(&[(50.0, 0.0), (50.0, 0.0)]),
            one_seed.clone(),
            line(&[(60.0, 1.0)]),
            line(&[]),
        ];
        let trends = figure(lines).trends();
        assert_eq!(trends, Some(Trends { lines: 4, falls: 1, rises: 1 }));
        assert_eq!(figure(vec![one_seed]).trends(), None);
        assert_eq!(figure(Vec::new()).trends(), None);
    }

    #[test]
    fn two_lines_are_furthest_apart_where_they_differ_beyond_chance() {
        let gap = |second: &[(f64, f64)]| {
            let figure = figure(vec![line(&[(20.0, 2.0), (20.0, 2.0)]), line(second)]);
            figure.widest_gap().map(|(point, gap, apart, _)| (point.x, gap, apart)).unwrap()
        };
        assert_eq!(gap(&[(20.0, 1.0), (60.0, 1.0)]), (2.0, -40.0, Apart::Surely));
        assert_eq!(gap(&[(20.0, 1.0), (60.0, 90.0)]), (2.0, -40.0, Apart::Perhaps));
        assert_eq!(gap(&[(10.0, 1.0), (60.0, 90.0)]), (1.0, 10.0, Apart::Surely));
    }
}
