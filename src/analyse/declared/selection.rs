//! Hyper-parameters ranked by a stated rule.

use super::arm::{ArmId, arms};
use crate::analyse::{Interval, Moments, Sample, Undefined, mean_interval};
use crate::manifest::{SelectionRule, Setting};
use crate::record::JobRecord;

/// The settings of one agent where it is, the best first: in one scenario and environment, for a
/// setting that met an easier one is no better by that.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// The agent, its scenario, and what distinguishes the environment.
    pub place: ArmId,
    /// The rule's word.
    pub rule: &'static str,
    /// Its settings in the order of the rule; those that cannot be ranked come last.
    pub candidates: Vec<Candidate>,
}

impl Ranking {
    /// How many settings have a completed run.
    pub fn tried(&self) -> usize {
        self.candidates.iter().filter(|candidate| candidate.sample.n() > 0).count()
    }
}

/// Settings that were tried.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The settings, dotted names and values.
    pub settings: Vec<(String, Setting)>,
    /// The metric of their seeds.
    pub sample: Sample,
    /// Its mean.
    pub mean: Result<f64, Undefined>,
    /// The mean's interval.
    pub interval: Result<Interval, Undefined>,
}

/// The candidates of every agent, ranked among those of their scenario and environment.
pub fn rankings(rule: SelectionRule, metric: &str, jobs: &[&JobRecord]) -> Vec<Ranking> {
    let mut places: Vec<Ranking> = Vec::new();
    for arm in arms(jobs, &[]) {
        let sample = arm.sample(metric);
        let (environment, settings) =
            arm.name.settings.into_iter().partition(|(name, _)| name.starts_with("environment."));
        let place = ArmId { settings: environment, ..arm.name };
        let candidate = Candidate {
            mean: Moments::of(sample.values()).map(|moments| moments.mean),
            interval: mean_interval(sample.values()),
            settings,
            sample,
        };
        match places.iter_mut().find(|ranking| ranking.place == place) {
            Some(ranking) => ranking.candidates.push(candidate),
            None => {
                places.push(Ranking { place, rule: rule.word(), candidates: vec![candidate] });
            }
        }
    }
    let rank = |candidate: &Candidate| match rule {
        SelectionRule::HighestMean => candidate.mean.ok(),
        SelectionRule::HighestLowerBound => candidate.interval.ok().map(|interval| interval.low),
    };
    for ranking in &mut places {
        ranking.candidates.sort_by(|a, b| {
            let of = |one| rank(one).unwrap_or(f64::NEG_INFINITY);
            f64::total_cmp(&of(b), &of(a))
        });
    }
    places
}
