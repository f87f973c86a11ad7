//! Summaries of every arm and every agent, independent of declared analyses.

use super::arm::{ArmId, MESSAGES, arms};
use crate::analyse::{Aggregate, Sample, Undefined, interquartile_mean};
use crate::record::JobRecord;

/// The results of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmSummary {
    /// The identity of the arm.
    pub name: ArmId,
    /// Mean returns of its seeds.
    pub returns: Sample,
    /// Lower quartiles of the test returns of its seeds.
    pub lower_quartiles: Sample,
    /// Shares of the test episodes that ended in disengagement.
    pub disengagement: Sample,
    /// Messages per test episode.
    pub messages: Sample,
    /// The best mean return that any policy can reach; `None` if it was not computed.
    pub optimum: Option<f64>,
    /// Feature noise of its jobs, if they have one.
    pub sigma: Option<f64>,
    /// Context inference error; `None` if it differs between participants.
    pub context_error: Option<f64>,
}

impl ArmSummary {
    /// Inter-quartile mean of the mean returns, with its bootstrap interval.
    pub fn interquartile(&self) -> Result<Aggregate, Undefined> {
        interquartile_mean(&[&self.returns])
    }

    /// Number of declared seeds.
    pub fn declared(&self) -> usize {
        let lost = self.returns.lost();
        self.returns.n() + (lost.ended() + lost.open) as usize
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
    /// Smallest number of seeds with a result in an arm; 0 without an arm.
    pub fewest: usize,
    /// Inter-quartile mean of the mean returns; its bootstrap resamples seeds within arms.
    pub returns: Result<Aggregate, Undefined>,
    /// The same for shares of the optimum, over the arms with a known optimum; `None` if there are
    /// results but no known optimum.
    pub shares: Option<Result<Aggregate, Undefined>>,
}

/// Summarises the jobs of an experiment by arm, in the manifest's order.
pub fn summarise_arms(jobs: &[JobRecord]) -> Vec<ArmSummary> {
    let jobs: Vec<&JobRecord> = jobs.iter().collect();
    let summary = |arm: super::Arm<'_>| ArmSummary {
        returns: arm.sample("mean_return"),
        lower_quartiles: arm.sample("lower_quartile_return"),
        disengagement: arm.sample("disengagement_rate"),
        messages: arm.sample(MESSAGES),
        optimum: arm.optimum(),
        sigma: arm.jobs[0].number("environment.sigma"),
        context_error: arm.jobs[0].context_error,
        name: arm.name,
    };
    arms(&jobs, &[]).into_iter().map(summary).collect()
}

/// Summarises arms by agent and scenario, in their order.
pub fn summarise_agents(arms: &[ArmSummary]) -> Vec<AgentSummary> {
    let mut names: Vec<(&str, &str)> = Vec::new();
    for arm in arms {
        let name = (arm.name.agent.as_str(), arm.name.scenario.as_str());
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let row = |(agent, scenario): (&str, &str)| {
        let is_of = |arm: &&ArmSummary| arm.name.agent == agent && arm.name.scenario == scenario;
        let ours = arms.iter().filter(is_of).filter(|arm| arm.returns.n() > 0);
        let ours: Vec<&ArmSummary> = ours.collect();
        let returns: Vec<&Sample> = ours.iter().map(|arm| &arm.returns).collect();
        let shares: Vec<Sample> = ours.iter().filter_map(|arm| shares(arm)).collect();
        AgentSummary {
            agent: agent.to_owned(),
            scenario: scenario.to_owned(),
            arms: ours.len(),
            runs: returns.iter().map(|sample| sample.n()).sum(),
            fewest: returns.iter().map(|sample| sample.n()).min().unwrap_or(0),
            returns: interquartile_mean(&returns),
            shares: (!shares.is_empty() || ours.is_empty())
                .then(|| interquartile_mean(&shares.iter().collect::<Vec<_>>())),
        }
    };
    names.into_iter().map(row).collect()
}

/// The mean returns of an arm's seeds as shares of the optimum; `None` if the optimum is unknown or
/// not above 0.
fn shares(arm: &ArmSummary) -> Option<Sample> {
    let values = arm.returns.seeds().iter().zip(arm.returns.values());
    let shares = values.map(|(seed, value)| Some((*seed, share_of_optimum(*value, arm.optimum)?)));
    let shares = shares.collect::<Option<Vec<_>>>()?;
    let lost = arm.returns.lost();
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
                settings: Vec::new(),
            },
            returns,
            lower_quartiles: Sample::default(),
            disengagement: Sample::default(),
            messages: Sample::default(),
            optimum,
            sigma: None,
            context_error: None,
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
