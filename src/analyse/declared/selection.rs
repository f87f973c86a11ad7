//! Hyper-parameters ranked by a stated rule.

use std::collections::HashMap;

use super::arm::{ArmId, Token, arms};
use crate::analyse::{Interval, Moments, Sample, Undefined, mean_interval};
use crate::manifest::{SelectionRule, Setting};
use crate::record::JobRecord;

/// The settings of one agent in one scenario and environment, best first. Rankings do not mix
/// environments, because the same setting has a better metric in an easier environment.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// The agent, its scenario, and the settings that distinguish the environment and its
    /// participants.
    pub place: ArmId,
    /// The name of the rule.
    pub rule: &'static str,
    /// Its settings in the order of the rule; those that cannot be ranked come last.
    pub candidates: Vec<Candidate>,
}

impl Ranking {
    /// The best setting; `None` if there is only one setting, or if the rule cannot rank the first.
    pub fn winner(&self) -> Option<&Candidate> {
        let rule = SelectionRule::named(self.rule)?;
        let best = self.candidates.first()?;
        (self.candidates.len() > 1 && best.rank(rule).is_some()).then_some(best)
    }

    /// The number of settings with a completed run.
    pub fn tried(&self) -> usize {
        self.candidates.iter().filter(|candidate| candidate.sample.n() > 0).count()
    }
}

/// One combination of settings, with its results.
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

impl Candidate {
    /// The number by which the rule ranks the candidate, if it is defined.
    fn rank(&self, rule: SelectionRule) -> Option<f64> {
        match rule {
            SelectionRule::HighestMean => self.mean.ok(),
            SelectionRule::HighestLowerBound => self.interval.ok().map(|interval| interval.low),
        }
    }
}

/// The rankings of every agent's candidates, one per scenario and environment.
pub fn rankings(rule: SelectionRule, metric: &str, jobs: &[&JobRecord]) -> Vec<Ranking> {
    let mut rankings: Vec<Ranking> = Vec::new();
    let mut places = HashMap::new();
    let arms = arms(jobs, &[]);
    for arm in &arms {
        let sample = arm.sample(metric);
        let (environment, settings) =
            arm.name.settings.iter().cloned().partition(|(name, _)| is_surrounding(name));
        let place = ArmId { settings: environment, ..arm.name.clone() };
        let candidate = Candidate {
            mean: Moments::of(sample.values()).map(|moments| moments.mean),
            interval: mean_interval(sample.values()),
            settings,
            sample,
        };
        let settings = arm.name.settings.iter().filter(|(name, _)| is_surrounding(name));
        let settings: Vec<_> = settings.map(|(name, value)| (name, Token::of(value))).collect();
        let found = (&arm.name.agent, &arm.name.scenario, settings);
        let at = *places.entry(found).or_insert(rankings.len());
        if at == rankings.len() {
            rankings.push(Ranking { place, rule: rule.word(), candidates: Vec::new() });
        }
        rankings[at].candidates.push(candidate);
    }
    for ranking in &mut rankings {
        ranking.candidates.sort_by(|a, b| {
            let of = |one: &Candidate| one.rank(rule).unwrap_or(f64::NEG_INFINITY);
            f64::total_cmp(&of(b), &of(a))
        });
    }
    rankings
}

/// Whether a parameter belongs to the environment or its participants rather than to the agent.
fn is_surrounding(name: &str) -> bool {
    ["environment.", "population."].iter().any(|section| name.starts_with(section))
}
