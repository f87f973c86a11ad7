//! How much of an arm's distance to the optimum another arm recovers.

use crate::job::metric::NET_RETURN;
use std::collections::HashMap;

use super::arm::{Arm, ArmId, Token, arms};
use crate::analyse::{self, Recovered, Sample, SeedPairing, Undefined};
use crate::job::{Condition, Scalar};
use crate::manifest::kind::Recovery;
use crate::record::JobRecord;

/// A recovered share of a loss, in one environment.
#[derive(Clone, Debug, PartialEq)]
pub struct RecoveryRow {
    /// The arm that recovers it.
    pub with: ArmId,
    /// The arm whose distance to the optimum is the loss.
    pub without: ArmId,
    /// How the seeds of both arms are paired.
    pub design: SeedPairing,
    /// The net returns of the seeds that are compared.
    pub returns: [Sample; 2],
    /// The largest optimum of the analysis' scenarios that show the state.
    pub optimum: Option<ScenarioOptimum>,
    /// The share.
    pub recovered: Result<Recovered, Undefined>,
}

/// The best mean return that any policy can reach in a scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenarioOptimum {
    /// The scenario.
    pub scenario: String,
    /// The mean return.
    pub mean_return: f64,
}

/// One row per pair of arms in the same environment, in the manifest's order. The optimum is the
/// largest of this environment among the analysis' jobs, of which only those have one whose scenario
/// shows the state.
pub fn rows(recovery: &Recovery, jobs: &[&JobRecord]) -> Vec<RecoveryRow> {
    let arms = arms(jobs, &[]);
    let select = |conditions: &[Condition]| -> Vec<&Arm<'_>> {
        let meets = |arm: &&Arm<'_>| {
            let mut jobs = arm.jobs.iter();
            jobs.all(|job| conditions.iter().all(|condition| condition.is_met_by(job)))
        };
        arms.iter().filter(meets).collect()
    };
    let mut optima: HashMap<_, ScenarioOptimum> = HashMap::new();
    for arm in &arms {
        let Some(mean_return) = arm.optimum() else { continue };
        let next = || ScenarioOptimum { scenario: arm.name.scenario.clone(), mean_return };
        let best = optima.entry(environment(&arm.name)).or_insert_with(next);
        if mean_return > best.mean_return {
            *best = next();
        }
    }
    let mut partners: HashMap<_, Vec<&Arm<'_>>> = HashMap::new();
    for arm in select(&recovery.without) {
        partners.entry(environment(&arm.name)).or_default().push(arm);
    }
    let mut rows = Vec::new();
    for with in select(&recovery.with) {
        let shared = environment(&with.name);
        let optimum = optima.get(&shared);
        let partners = partners.get(&shared).into_iter().flatten();
        let partners: Vec<&&Arm<'_>> =
            partners.filter(|without| are_partners(recovery, with, without)).collect();
        for without in partners.iter().filter(|one| is_nearest(with, one, &partners)) {
            // The optimum is that of the net return.
            let (of_with, of_without) = (with.sample(NET_RETURN), without.sample(NET_RETURN));
            let design = SeedPairing::of(&of_with, &of_without);
            let recovered = optimum.ok_or(Undefined::NoOptimum).and_then(|optimum| {
                analyse::recovered(&of_with, &of_without, optimum.mean_return, design)
            });
            let (of_with, of_without) = design.compared(&of_with, &of_without);
            rows.push(RecoveryRow {
                with: with.name.clone(),
                without: without.name.clone(),
                design,
                returns: [of_with, of_without],
                optimum: optimum.cloned(),
                recovered,
            });
        }
    }
    rows
}

/// Whether no arm of the same agent and scenario has more settings in common with the arm: keys that two agents
/// sweep in the same way are compared at equal values.
fn is_nearest(with: &Arm<'_>, without: &Arm<'_>, partners: &[&&Arm<'_>]) -> bool {
    let common = |other: &ArmId| {
        let is_common = |setting: &&(String, Scalar)| other.settings.contains(setting);
        with.name.settings.iter().filter(is_common).count()
    };
    let of_agent = partners.iter().map(|other| &other.name).filter(|other| {
        other.agent == without.name.agent && other.scenario == without.name.scenario
    });
    let most = of_agent.map(common).max().unwrap_or(0);
    common(&without.name) == most
}

/// Whether two arms in the same environment form a pair: what neither `with` nor `without` mentions is the same
/// in both. Keys of two different agents need not agree.
fn are_partners(recovery: &Recovery, with: &Arm<'_>, without: &Arm<'_>) -> bool {
    let mentions =
        |name: &str| recovery.with.iter().chain(&recovery.without).any(|one| one.name() == name);
    let (one, other) = (&with.name, &without.name);
    let is_same_agent = one.agent == other.agent;
    let settings = |of: &ArmId| -> Vec<(String, Scalar)> {
        let counts = |name: &str| is_same_agent || !name.starts_with("agent.");
        let counted = of.settings.iter().filter(|(name, _)| counts(name) && !mentions(name));
        counted.cloned().collect()
    };
    one != other
        && (is_same_agent || mentions("agent.name"))
        && (one.scenario == other.scenario || mentions("scenario"))
        && settings(one) == settings(other)
}

/// The settings that distinguish an arm's environment, as a key of a table.
fn environment(name: &ArmId) -> Vec<(&str, Token<'_>)> {
    let is_environment = |setting: &&(String, Scalar)| {
        setting.0.starts_with("environment.") || setting.0.starts_with("population.")
    };
    let settings = name.settings.iter().filter(is_environment);
    settings.map(|(name, value)| (name.as_str(), Token::of(value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::{AnalysisKind, Manifest, parse};
    use crate::plan;
    use crate::record::JobStatus;

    const MANIFEST: &str = "format = 1\nname = \"t\"\nseeds = 2\nenvironment.sigma = [0.4, 0.6]\n\
        scenarios = [\"P-T\", \"L-H-D\", \"P-H-D\"]\n[[agent]]\nname = \"a\"\nalgorithm = \"reinforce\"\n\
        [[agent]]\nname = \"b\"\nalgorithm = \"ppo\"\n[[analysis]]\nname = \"r\"\nkind = \"recovery\"\n\
        with = { agent.name = \"b\", scenario = \"P-T\" }\nwithout = { agent.name = \"a\", scenario = \"P-T\" }";

    /// The rows from jobs whose optimum is a function of sigma and scenario.
    fn rows_with(
        manifest: &Manifest,
        optimum: impl Fn(f64, &str) -> Option<f64>,
    ) -> Vec<RecoveryRow> {
        let AnalysisKind::Recovery(recovery) = &manifest.analyses[0].kind else { unreachable!() };
        let jobs = plan::jobs(manifest).map(|planned| {
            let mut job = JobRecord::new(&planned, planned.form.key(), JobStatus::Pending);
            job.optimum = optimum(job.number("environment.sigma").unwrap(), &job.scenario);
            job
        });
        let jobs: Vec<JobRecord> = jobs.collect();
        rows(recovery, &jobs.iter().collect::<Vec<_>>())
    }

    #[test]
    fn arms_are_paired_by_environment_and_the_largest_optimum_counts() {
        let manifest = parse("t", MANIFEST.as_bytes()).unwrap();
        let found = rows_with(&manifest, |sigma, scenario| match scenario {
            "P-H-D" => Some(3600.0 - 1000.0 * sigma),
            "L-H-D" => Some(3000.0 - 1000.0 * sigma),
            _ => None,
        });
        assert_eq!(found.len(), 2);
        for (row, best) in found.iter().zip([3200.0, 3000.0]) {
            assert_eq!((row.with.agent.as_str(), row.without.agent.as_str()), ("b", "a"));
            assert_eq!(row.with.settings, row.without.settings);
            let optimum = row.optimum.as_ref().unwrap();
            assert_eq!((optimum.scenario.as_str(), optimum.mean_return), ("P-H-D", best));
            assert_eq!(row.recovered, Err(Undefined::NoSeeds));
        }
        // What neither side mentions is the same in both: an agent is compared with itself.
        let sides = "with = { scenario = \"L-H-D\" }\nwithout = { scenario = \"P-T\" }";
        let (before, _) = MANIFEST.split_once("with =").unwrap();
        let scenarios = parse("t", format!("{before}{sides}").as_bytes()).unwrap();
        let found = rows_with(&scenarios, |_, _| None);
        let pairs = found.iter().map(|row| (row.with.agent.as_str(), row.without.agent.as_str()));
        assert_eq!(pairs.collect::<Vec<_>>(), [("a", "a"), ("a", "a"), ("b", "b"), ("b", "b")]);
        let unknown = rows_with(&manifest, |_, _| None);
        assert!(unknown.iter().all(|row| row.recovered == Err(Undefined::NoOptimum)));
    }
}
