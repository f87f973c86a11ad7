//! Hyper-parameters ranked by a stated rule.

use std::collections::HashMap;
use std::fmt;

use super::arm::{ArmId, Token, arms};
use crate::analyse::{Interval, Sample, Undefined};
use crate::job::{MetricName, Scalar};
use crate::key::Kind;
use crate::manifest::Section;
use crate::manifest::kind::SelectionRule;
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

    /// The numbers of the winner at the end of their searched ranges, each as a sentence fragment. Ends
    /// that the key itself sets do not count.
    pub fn at_ends(&self) -> impl Iterator<Item = RangeEnd> {
        let settings = self.winner().map_or(&[][..], |winner| &winner.settings);
        settings.iter().filter_map(|(name, value)| self.end(name, value))
    }

    /// The end of the range of a parameter at which the value is, among the settings tried.
    fn end(&self, name: &str, value: &Scalar) -> Option<RangeEnd> {
        let best = &value.number()?;
        let tried = self.candidates.iter().filter(|candidate| candidate.sample.n() > 0);
        let settings = tried.flat_map(|candidate| &candidate.settings);
        let of_name = settings.filter(|(other, _)| other == name);
        let numbers = || of_name.clone().filter_map(|(_, other)| other.number());
        let (least, most) = (numbers().fold(*best, f64::min), numbers().fold(*best, f64::max));
        let side = match *best {
            _ if least == most => return None,
            best if best == least => Side::Smallest,
            best if best == most => Side::Largest,
            _ => return None,
        };
        (!is_limit(name, *best)).then(|| RangeEnd { name: name.to_owned(), value: *best, side })
    }

    /// The number of settings with a completed run.
    pub fn tried(&self) -> usize {
        self.candidates.iter().filter(|candidate| candidate.sample.n() > 0).count()
    }
}

/// A parameter whose best value is the smallest or the largest of those tried.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeEnd {
    /// The dotted name.
    pub name: String,
    value: f64,
    side: Side,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Smallest,
    Largest,
}

impl fmt::Display for RangeEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (further, extreme) = match self.side {
            Side::Smallest => ("smaller", "smallest"),
            Side::Largest => ("larger", "largest"),
        };
        let value = Scalar::Real(self.value);
        let name = &self.name;
        write!(
            f,
            "{name} = {value} is the {extreme} value tried, and a {further} one may be better"
        )
    }
}

/// Whether a parameter can have no value beyond this one: the limit of its key, or a flag.
fn is_limit(name: &str, value: f64) -> bool {
    let key = |section: Section| {
        let (_, key) = section.find(name.strip_prefix(section.name())?.strip_prefix('.')?)?;
        Some(key.kind)
    };
    match Section::all().into_iter().find_map(key) {
        Some(Kind::Real { min, max }) => value == min || value == max,
        Some(Kind::PositiveReal { max }) => value == max,
        Some(Kind::Integer { min, max }) => value == min as f64 || value == max as f64,
        // The number of an outside program's parameter may be a flag.
        Some(Kind::Scalar) | None => value == 0.0 || value == 1.0,
        Some(_) => true,
    }
}

/// One combination of settings, with its results.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// The settings, dotted names and values.
    pub settings: Vec<(String, Scalar)>,
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
            SelectionRule::HighestLowerBound => match self.interval {
                Ok(interval) => Some(interval.low),
                // Equal seeds are the limit of seeds that hardly vary.
                Err(Undefined::NoVariance) => self.mean.ok(),
                Err(_) => None,
            },
            SelectionRule::LowestMean => self.mean.ok().map(|mean| -mean),
        }
    }
}

/// The rankings of every agent's candidates, one per scenario and environment.
pub fn rankings(rule: SelectionRule, metric: MetricName, jobs: &[&JobRecord]) -> Vec<Ranking> {
    let mut rankings: Vec<Ranking> = Vec::new();
    let mut places = HashMap::new();
    let arms = arms(jobs, &[]);
    for arm in &arms {
        let sample = arm.sample(metric);
        let (environment, settings) =
            arm.name.settings.iter().cloned().partition(|(name, _)| is_surrounding(name));
        let place = ArmId { settings: environment, ..arm.name.clone() };
        let candidate =
            Candidate { mean: sample.mean(), interval: sample.interval(), settings, sample };
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A ranking of candidates with one setting each, best first.
    fn ranking(name: &str, values: &[f64]) -> Ranking {
        let candidate = |value: &f64| {
            let sample = Sample::new([(1, 1.0), (2, 2.0)], 0, 0).unwrap();
            let settings = vec![(name.to_owned(), Scalar::Real(*value))];
            let interval = sample.interval();
            Candidate { settings, sample, mean: Ok(1.5), interval }
        };
        let (agent, scenario) = ("dqn".to_owned(), "P-T".to_owned());
        Ranking {
            place: ArmId { agent, scenario, settings: Vec::new() },
            rule: SelectionRule::HighestMean.word(),
            candidates: values.iter().map(candidate).collect(),
        }
    }

    #[test]
    fn a_winner_at_the_end_of_its_range_is_known() {
        let ends = |name: &str, values: &[f64]| {
            ranking(name, values).at_ends().map(|end| end.to_string()).collect::<Vec<_>>()
        };
        let rate = "agent.learning_rate";
        assert_eq!(
            ends(rate, &[0.01, 0.001, 0.0001]),
            [
                "agent.learning_rate = 0.01 is the largest value tried, and a larger one may be better"
            ]
        );
        assert_eq!(
            ends(rate, &[0.0001, 0.01]),
            [
                "agent.learning_rate = 0.0001 is the smallest value tried, and a smaller one may be better"
            ]
        );
        assert!(ends(rate, &[0.001, 0.0001, 0.01]).is_empty());
        assert!(ends(rate, &[0.001]).is_empty(), "nothing was searched");
        assert!(ends("agent.gamma", &[1.0, 0.9]).is_empty(), "gamma cannot be larger");
        assert!(ends("agent.action_centring", &[1.0, 0.0]).is_empty(), "a flag has no range");
    }
}
