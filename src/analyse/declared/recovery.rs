//! How much of an arm's distance to the optimum another arm recovers.

use super::arm::{Arm, ArmId, arms};
use crate::analyse::{self, Recovered, Sample, Undefined};
use crate::manifest::{Condition, Recovery, Setting};
use crate::record::JobRecord;

/// A recovered share of a loss, in one environment.
#[derive(Clone, Debug, PartialEq)]
pub struct RecoveryRow {
    /// The arm that recovers it.
    pub with: ArmId,
    /// The arm whose distance to the optimum is the loss.
    pub without: ArmId,
    /// The returns of both arms' seeds.
    pub returns: [Sample; 2],
    /// The best mean return that any policy can reach where the state is observed.
    pub optimum: Option<f64>,
    /// The share.
    pub recovered: Result<Recovered, Undefined>,
}

/// One row per pair of arms in the same environment, in the manifest's order. The optimum comes
/// from any job of the analysis in this environment whose scenario shows the state.
pub fn rows(recovery: &Recovery, metric: &str, jobs: &[&JobRecord]) -> Vec<RecoveryRow> {
    let arms = arms(jobs, &[]);
    let of = |conditions: &[Condition]| -> Vec<&Arm<'_>> {
        let meets = |arm: &&Arm<'_>| {
            let mut jobs = arm.jobs.iter();
            jobs.all(|job| conditions.iter().all(|condition| condition.is_met_by(job)))
        };
        arms.iter().filter(meets).collect()
    };
    let (with, without) = (of(&recovery.with), of(&recovery.without));
    let mut rows = Vec::new();
    for with in &with {
        let place = environment(&with.name);
        let here = |arm: &&&Arm<'_>| environment(&arm.name) == place;
        let optimum = arms.iter().filter(|arm| here(&arm)).find_map(Arm::optimum);
        for without in without.iter().filter(|arm| here(arm)) {
            let returns = [with.sample(metric), without.sample(metric)];
            let [of_with, of_without] = &returns;
            let recovered = optimum.ok_or(Undefined::NoOptimum).and_then(|optimum| {
                analyse::recovered(of_with.values(), of_without.values(), optimum)
            });
            rows.push(RecoveryRow {
                with: with.name.clone(),
                without: without.name.clone(),
                returns,
                optimum,
                recovered,
            });
        }
    }
    rows
}

/// The settings that distinguish an arm's environment.
fn environment(name: &ArmId) -> Vec<&(String, Setting)> {
    let is_environment = |setting: &&(String, Setting)| {
        setting.0.starts_with("environment.") || setting.0.starts_with("population.")
    };
    name.settings.iter().filter(is_environment).collect()
}
