//! Summaries of every arm and every agent, independent of declared analyses.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use super::arm::{ArmId, arms};
use crate::analyse::{Aggregate, Sample, Undefined, grouped, interquartile_mean};
use crate::env::Family;
use crate::job::MetricName;
use crate::job::metric::{
    DISENGAGEMENT_RATE, LOWER_QUARTILE_RETURN, MEAN_RETURN, MESSAGES, NET_RETURN, TERMINATION_RATE,
};
use crate::key::Parameter;
use crate::record::JobRecord;

/// Maximum number of statistics that are computed at a time.
const MOST_AT_ONCE: usize = 64;

/// The results of an arm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArmSummary {
    /// The identity of the arm.
    pub name: ArmId,
    /// Mean returns of its seeds.
    pub returns: Sample,
    /// Mean returns of its seeds minus the cost of messages.
    pub net_returns: Sample,
    /// Lower quartiles of the test returns of its seeds.
    pub lower_quartiles: Sample,
    /// Shares of the test episodes that were terminated.
    pub terminated: Sample,
    /// Messages per test episode.
    pub messages: Sample,
    /// The best mean net return that any policy can reach; `None` if it was not computed.
    pub optimum: Option<f64>,
    /// The headline key of its environment with its value, if there is one.
    pub headline: Option<(&'static str, f64)>,
    /// Context inference error; `None` if it differs between participants.
    pub context_error: Option<f64>,
    /// Inter-quartile mean of the mean returns, once it is known.
    pub interquartile: OnceLock<Result<Aggregate, Undefined>>,
}

impl ArmSummary {
    /// Inter-quartile mean of the mean returns, with its interval.
    pub fn interquartile(&self) -> Result<Aggregate, Undefined> {
        *self.interquartile.get_or_init(|| interquartile_mean(&[&self.returns]))
    }

    /// Number of declared seeds.
    pub fn declared(&self) -> usize {
        self.returns.declared()
    }

    /// Whether a seed has completed or failed.
    pub fn has_ended(&self) -> bool {
        self.returns.n() > 0 || self.returns.lost().ended() > 0
    }
}

/// The results of an agent in a scenario, over all settings of the other parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentSummary {
    /// The agent.
    pub agent: String,
    /// The scenario.
    pub scenario: String,
    /// Number of its arms that have a result.
    pub arms: usize,
    /// Number of results: seeds of all arms.
    pub runs: usize,
    /// Number of results in the arms with a known optimum.
    pub shared: usize,
    /// Inter-quartile mean of the mean returns; its bootstrap draws seeds with their values in all arms.
    pub returns: Result<Aggregate, Undefined>,
    /// The same for shares of the optimum, over the arms with a known optimum; `None` if there are
    /// results but no known optimum.
    pub shares: Option<Result<Aggregate, Undefined>>,
}

/// Summarises the jobs of an experiment by arm, in the manifest's order.
pub fn summarise_arms(jobs: &[JobRecord]) -> Vec<ArmSummary> {
    let jobs: Vec<&JobRecord> = jobs.iter().collect();
    let summary = |arm: super::Arm<'_>| ArmSummary {
        returns: arm.sample(MEAN_RETURN),
        net_returns: arm.sample(NET_RETURN),
        lower_quartiles: arm.sample(LOWER_QUARTILE_RETURN),
        terminated: arm.sample(termination_metric(&arm)),
        messages: arm.sample(MESSAGES),
        optimum: arm.optimum(),
        headline: headline(arm.jobs[0]),
        context_error: arm.jobs[0].context_error,
        interquartile: OnceLock::new(),
        name: arm.name,
    };
    arms(&jobs, &[]).into_iter().map(summary).collect()
}

/// The headline key of a job's environment, with its value.
fn headline(job: &JobRecord) -> Option<(&'static str, f64)> {
    let mut keys = Family::all().iter().filter_map(|family| family.headline);
    keys.find_map(|key| Some((key, job.number(&Parameter::Environment(key).to_string())?)))
}

/// The metric of an arm's jobs that is the share of terminated episodes.
fn termination_metric(arm: &super::Arm<'_>) -> MetricName {
    let of_other_families = TERMINATION_RATE.text();
    let mut completed = arm.jobs.iter().filter_map(|job| job.completed());
    match completed.any(|run| run.metric(&of_other_families).is_some()) {
        true => TERMINATION_RATE,
        false => DISENGAGEMENT_RATE,
    }
}

/// Summarises arms by agent and scenario, in their order. Inter-quartile means take most of a report's time,
/// so those of agents and of arms are computed together, on all cores.
pub fn summarise_agents(arms: &[ArmSummary]) -> Vec<AgentSummary> {
    let groups = grouped(arms.iter().map(|arm| ((&arm.name.agent, &arm.name.scenario), arm)));
    let groups: Vec<Group<'_>> = groups.into_iter().map(|(_, arms)| Group::of(arms)).collect();
    // An agent's samples are larger than an arm's, and are begun first.
    let of_agents = groups.iter().flat_map(|group| [group.returns(), group.shares()]);
    let of_arms = arms.iter().map(|arm| vec![&arm.returns]);
    let samples: Vec<Vec<&Sample>> = of_agents.chain(of_arms).collect();
    let mut found = on_all_cores(&samples, |samples| interquartile_mean(samples)).into_iter();
    let of_agents: Vec<_> = found.by_ref().take(2 * groups.len()).collect();
    for (arm, found) in arms.iter().zip(found) {
        let _ = arm.interquartile.set(found);
    }
    let summaries = groups.iter().zip(of_agents.chunks(2));
    summaries.map(|(group, found)| group.summary(found[0], found[1])).collect()
}

/// The arms of an agent in a scenario.
struct Group<'a> {
    agent: &'a str,
    scenario: &'a str,
    /// Arms that have a result.
    ours: Vec<&'a ArmSummary>,
    /// Shares of the optimum of the arms that have one.
    shares: Vec<Sample>,
}

impl<'a> Group<'a> {
    fn of(arms: Vec<&'a ArmSummary>) -> Group<'a> {
        let ArmId { agent, scenario, .. } = &arms[0].name;
        let ours: Vec<&ArmSummary> =
            arms.iter().filter(|arm| arm.returns.n() > 0).copied().collect();
        let shares = ours.iter().filter_map(|arm| shares(arm)).collect();
        Group { agent, scenario, ours, shares }
    }

    /// The samples of the agent's returns; none if there is a single arm, which has the same summary.
    fn returns(&self) -> Vec<&Sample> {
        let returns = self.ours.iter().map(|arm| &arm.returns);
        if self.ours.len() == 1 { Vec::new() } else { returns.collect() }
    }

    fn shares(&self) -> Vec<&Sample> {
        self.shares.iter().collect()
    }

    fn summary(
        &self,
        returns: Result<Aggregate, Undefined>,
        shares: Result<Aggregate, Undefined>,
    ) -> AgentSummary {
        let runs = self.ours.iter().map(|arm| arm.returns.n());
        AgentSummary {
            agent: self.agent.to_owned(),
            scenario: self.scenario.to_owned(),
            arms: self.ours.len(),
            runs: runs.sum(),
            shared: self.shares.iter().map(Sample::n).sum(),
            returns: match self.ours[..] {
                [arm] => arm.interquartile(),
                _ => returns,
            },
            shares: (!self.shares.is_empty() || self.ours.is_empty()).then_some(shares),
        }
    }
}

/// The results of `of` for each item, in their order.
fn on_all_cores<T: Sync, R: Send>(items: &[T], compute: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let cores = thread::available_parallelism().map_or(1, usize::from).min(MOST_AT_ONCE);
    let next = AtomicUsize::new(0);
    let work = || {
        let indices = std::iter::repeat_with(|| next.fetch_add(1, Ordering::Relaxed));
        let items = indices.map_while(|index| Some((index, items.get(index)?)));
        items.map(|(index, item)| (index, compute(item))).collect::<Vec<_>>()
    };
    let mut found: Vec<(usize, R)> = thread::scope(|scope| {
        // Where the system refuses a thread, the others do its work.
        let start = |_| thread::Builder::new().spawn_scoped(scope, work).ok();
        let threads: Vec<_> = (1..cores.min(items.len())).map_while(start).collect();
        let mut found = work();
        for thread in threads {
            found.extend(thread.join().expect("statistics do not panic"));
        }
        found
    });
    found.sort_by_key(|(index, _)| *index);
    found.into_iter().map(|(_, result)| result).collect()
}

/// The net returns of an arm's seeds as shares of the optimum; `None` if the optimum is unknown or
/// not above 0.
fn shares(arm: &ArmSummary) -> Option<Sample> {
    let values = arm.net_returns.seeds().iter().zip(arm.net_returns.values());
    let shares = values.map(|(seed, value)| Some((*seed, share_of_optimum(*value, arm.optimum)?)));
    let shares = shares.collect::<Option<Vec<_>>>()?;
    let lost = arm.net_returns.lost();
    Some(Sample::new(shares, lost.failed, lost.open).expect("a sample has every seed once"))
}

/// A return as a share of the optimum; `None` if the optimum is unknown or not above 0.
pub fn share_of_optimum(value: f64, optimum: Option<f64>) -> Option<f64> {
    optimum.filter(|optimum| *optimum > 0.0).map(|optimum| value / optimum)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm(scenario: &str, returns: &[f64], optimum: Option<f64>) -> ArmSummary {
        let values = returns.iter().enumerate().map(|(seed, value)| (seed as u64, *value));
        let returns = Sample::new(values, 0, 0).unwrap();
        ArmSummary {
            name: ArmId {
                agent: "dqn".to_owned(),
                scenario: scenario.to_owned(),
                ..ArmId::default()
            },
            net_returns: returns.clone(),
            returns,
            optimum,
            ..ArmSummary::default()
        }
    }

    #[test]
    fn an_agent_s_share_of_the_optimum_is_over_the_arms_that_have_one() {
        let rows = summarise_agents(&[
            arm("P-H-D", &[1000.0, 2000.0], Some(2000.0)),
            arm("P-H-D", &[900.0, 600.0], Some(1000.0)),
            arm("P-T", &[5.0], None),
        ]);
        assert_eq!((rows[0].arms, rows[0].runs), (2, 4));
        // Without the lowest and the highest: of 600, 900, 1000, 2000 and of 0.5, 0.6, 0.9, 1.
        assert_eq!(rows[0].returns.unwrap().value, 950.0);
        assert!((rows[0].shares.unwrap().unwrap().value - 0.75).abs() < 1e-12);
        assert!(rows[0].shares.unwrap().unwrap().interval.is_ok());
        assert_eq!(rows[1].shares, None);
        assert!(rows[1].returns.unwrap().interval.is_err());
    }
}
