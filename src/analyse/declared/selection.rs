//! Hyper-parameters chosen by a stated rule.

use super::arm::{Name, groups};
use crate::analyse::{Interval, Moments, Sample, Undefined, mean_interval};
use crate::manifest::SelectionRule;
use crate::record::JobRecord;

/// The settings of one agent, the best first.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// The agent.
    pub agent: String,
    /// The rule's word.
    pub rule: &'static str,
    /// Its settings in the order of the rule; those that cannot be ranked come last.
    pub candidates: Vec<Candidate>,
}

/// Settings that were tried.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The settings.
    pub name: Name,
    /// The metric of their seeds.
    pub sample: Sample,
    /// Its mean.
    pub mean: Result<f64, Undefined>,
    /// The mean's interval.
    pub interval: Result<Interval, Undefined>,
}

/// The candidates of every agent, ranked.
pub fn chosen(rule: SelectionRule, metric: &str, jobs: &[&JobRecord]) -> Vec<Chosen> {
    let mut agents: Vec<Chosen> = Vec::new();
    for group in groups(jobs, &[]) {
        let sample = group.sample(metric);
        let candidate = Candidate {
            mean: Moments::of(sample.values()).map(|moments| moments.mean),
            interval: mean_interval(sample.values()),
            name: group.name,
            sample,
        };
        let agent = candidate.name.agent.clone();
        match agents.iter_mut().find(|chosen| chosen.agent == agent) {
            Some(chosen) => chosen.candidates.push(candidate),
            None => {
                agents.push(Chosen { agent, rule: rule.name(), candidates: vec![candidate] });
            }
        }
    }
    let rank = |candidate: &Candidate| match rule {
        SelectionRule::HighestMean => candidate.mean.ok(),
        SelectionRule::HighestLowerBound => candidate.interval.ok().map(|interval| interval.low),
    };
    for chosen in &mut agents {
        chosen.candidates.sort_by(|a, b| {
            let of = |one| rank(one).unwrap_or(f64::NEG_INFINITY);
            f64::total_cmp(&of(b), &of(a))
        });
    }
    agents
}
