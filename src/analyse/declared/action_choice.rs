//! Which actions a trained policy chooses, by the probability of context 0.

use super::arm::{ArmId, arms};
use crate::analyse::{Interval, share_interval};
use crate::env::PROBABILITY_BINS;
use crate::record::{CompletedRun, JobRecord};

/// Number of actions: none, untailored, tailored to context 0, tailored to context 1.
const ACTIONS: usize = 4;

/// The choices of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ActionPanel {
    /// The arm.
    pub name: ArmId,
    /// Numbers of completed seeds and of all seeds.
    pub seeds: (usize, usize),
    /// The bins, by probability.
    pub bins: Vec<BinShares>,
}

impl ActionPanel {
    /// The share of tailored actions in a bin, if a seed has a step in it.
    pub fn tailored(&self, bin: usize) -> Option<f64> {
        let shares = self.bins.get(bin)?.shares?;
        Some(shares[2].0 + shares[3].0)
    }
}

/// The choices in one bin.
#[derive(Clone, Debug, PartialEq)]
pub struct BinShares {
    /// Lower end of the probability of context 0.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Number of seeds that have a step in the bin.
    pub seeds: usize,
    /// Number of test steps of all seeds.
    pub steps: u64,
    /// Mean over seeds of each action's share, with its interval if defined; `None` if no seed has
    /// a step in the bin.
    pub shares: Option<[(f64, Option<Interval>); ACTIONS]>,
}

/// One panel per arm, in the manifest's order. Every seed has the same weight, whatever its number
/// of steps. A seed without a step in a bin is left out of that bin.
pub fn panels(bins: u8, jobs: &[&JobRecord]) -> Vec<ActionPanel> {
    let panel = |arm: super::Arm| {
        let runs: Vec<&CompletedRun> = arm.jobs.iter().filter_map(|job| job.completed()).collect();
        ActionPanel {
            seeds: (runs.len(), arm.jobs.len()),
            bins: (0..bins).map(|bin| shares(bin, bins, &runs)).collect(),
            name: arm.name,
        }
    };
    arms(jobs, &[]).into_iter().map(panel).collect()
}

fn shares(bin: u8, bins: u8, runs: &[&CompletedRun]) -> BinShares {
    let width = PROBABILITY_BINS as u8 / bins;
    let range = bin * width..(bin + 1) * width;
    let counts = runs.iter().map(|run| {
        let mut counts = [0_u64; ACTIONS];
        for count in run.actions.iter().filter(|count| {
            // A stratum is a bin with one of the two contexts.
            count.stratum.is_some_and(|stratum| range.contains(&(stratum / 2)))
        }) {
            counts[usize::from(count.action).min(ACTIONS - 1)] += count.count;
        }
        counts
    });
    let counts: Vec<[u64; ACTIONS]> =
        counts.filter(|counts| counts.iter().any(|n| *n > 0)).collect();
    let share = |action: usize| {
        let of =
            |counts: &[u64; ACTIONS]| counts[action] as f64 / counts.iter().sum::<u64>() as f64;
        let values: Vec<f64> = counts.iter().map(of).collect();
        (values.iter().sum::<f64>() / values.len() as f64, share_interval(&values).ok())
    };
    BinShares {
        low: f64::from(bin) / f64::from(bins),
        high: f64::from(bin + 1) / f64::from(bins),
        seeds: counts.len(),
        steps: counts.iter().flatten().sum(),
        shares: (!counts.is_empty()).then(|| std::array::from_fn(share)),
    }
}
