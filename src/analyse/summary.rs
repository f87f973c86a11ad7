//! Means over seeds, arm by arm.

use super::moments::mean_and_sd;
use crate::record::RunSummary;

/// Jobs that differ in their seed alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Agent's name in the manifest.
    pub agent: String,
    /// Scenario, like `P-H-D`.
    pub scenario: String,
    /// Feature noise.
    pub sigma: f64,
    /// Further parameters that the experiment sweeps: dotted name and value, by name.
    pub swept: Vec<(String, String)>,
}

/// What has become of a job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fate<'a> {
    /// It has a completed run.
    Completed(&'a RunSummary),
    /// Its last run failed.
    Failed,
    /// It has not ended.
    Open,
}

/// What the seeds of an arm came to.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmSummary {
    /// The arm.
    pub arm: Arm,
    /// Seeds that the experiment declares, at least 1.
    pub declared: usize,
    /// Seeds completed.
    pub seeds: usize,
    /// Means over the seeds completed; `None` if there are none.
    pub means: Option<Means>,
}

/// Means over the seeds of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Means {
    /// Mean over seeds of the mean return of the test episodes, in steps walked.
    pub mean_return: f64,
    /// Standard deviation over seeds (n - 1); `None` for one seed.
    pub sd_return: Option<f64>,
    /// Mean over seeds of the share of test episodes that ended in disengagement.
    pub disengagement_rate: f64,
}

/// Summarises the jobs of an experiment by arm, in the order in which the arms first appear. Arms
/// of which no job has ended are left out.
pub fn summarise<'a>(jobs: impl IntoIterator<Item = (Arm, Fate<'a>)>) -> Vec<ArmSummary> {
    let mut arms: Vec<(Arm, Vec<Fate<'a>>)> = Vec::new();
    for (arm, fate) in jobs {
        // The seeds of an arm mostly follow each other.
        match arms.iter_mut().rev().find(|(known, _)| *known == arm) {
            Some((_, fates)) => fates.push(fate),
            None => arms.push((arm, vec![fate])),
        }
    }
    arms.retain(|(_, fates)| fates.iter().any(|fate| *fate != Fate::Open));
    let summary = |(arm, fates): (Arm, Vec<Fate<'a>>)| {
        let completed = fates.iter().filter_map(|fate| match fate {
            Fate::Completed(run) => Some(*run),
            Fate::Failed | Fate::Open => None,
        });
        let runs: Vec<&RunSummary> = completed.collect();
        ArmSummary { arm, declared: fates.len(), seeds: runs.len(), means: means(&runs) }
    };
    arms.into_iter().map(summary).collect()
}

fn means(runs: &[&RunSummary]) -> Option<Means> {
    if runs.is_empty() {
        return None;
    }
    let of =
        |value: fn(&RunSummary) -> f64| -> Vec<f64> { runs.iter().map(|run| value(run)).collect() };
    let (mean_return, sd_return) = mean_and_sd(&of(|run| run.mean_return));
    let (disengagement_rate, _) = mean_and_sd(&of(|run| run.disengagement_rate));
    Some(Means { mean_return, sd_return, disengagement_rate })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::JobKey;

    fn run(agent: &str, sigma: f64, seed: u64, mean_return: f64) -> RunSummary {
        RunSummary {
            job_key: JobKey([0; 16]),
            agent: agent.to_owned(),
            scenario: "P-H-D".to_owned(),
            sigma,
            seed,
            mean_return,
            sd_return: 1.0,
            mean_length: 50.0,
            disengagement_rate: mean_return / 1000.0,
            wall_seconds: 1.0,
        }
    }

    fn arm(run: &RunSummary) -> Arm {
        let RunSummary { agent, scenario, sigma, .. } = run.clone();
        Arm { agent, scenario, sigma, swept: Vec::new() }
    }

    fn completed(runs: &[RunSummary]) -> Vec<ArmSummary> {
        summarise(runs.iter().map(|run| (arm(run), Fate::Completed(run))))
    }

    #[test]
    fn arms_are_summarised_over_their_seeds_by_hand() {
        let runs = [
            run("dqn", 0.4, 1, 100.0),
            run("dqn", 0.6, 1, 50.0),
            run("dqn", 0.4, 2, 104.0),
            run("other", 0.4, 1, 7.0),
            run("dqn", 0.4, 3, 96.0),
        ];
        let arms = completed(&runs);
        let means = |a: &ArmSummary| a.means.unwrap();
        let line =
            |a: &ArmSummary| (a.arm.agent.clone(), a.arm.sigma, a.seeds, means(a).mean_return);
        assert_eq!(line(&arms[0]), ("dqn".to_owned(), 0.4, 3, 100.0));
        assert_eq!(means(&arms[0]).sd_return, Some(4.0));
        assert!((means(&arms[0]).disengagement_rate - 0.1).abs() < 1e-12);
        assert_eq!(line(&arms[1]), ("dqn".to_owned(), 0.6, 1, 50.0));
        assert_eq!(means(&arms[1]).sd_return, None);
        assert_eq!(line(&arms[2]), ("other".to_owned(), 0.4, 1, 7.0));
    }

    #[test]
    fn further_swept_parameters_make_arms_of_their_own() {
        let runs = [run("dqn", 0.4, 1, 20.0), run("dqn", 0.4, 2, 10.0)];
        let swept = vec![("agent.batch".to_owned(), "32".to_owned())];
        let other = Arm { swept, ..arm(&runs[1]) };
        let jobs = [(arm(&runs[0]), Fate::Completed(&runs[0])), (other, Fate::Completed(&runs[1]))];
        assert_eq!(summarise(jobs).len(), 2);
    }

    #[test]
    fn seeds_without_a_result_are_counted_and_arms_without_an_end_left_out() {
        let [one, failed, open] = [0.4, 0.6, 0.8].map(|sigma| run("dqn", sigma, 1, 20.0));
        let jobs = [
            (arm(&one), Fate::Failed),
            (arm(&one), Fate::Completed(&one)),
            (arm(&one), Fate::Open),
            (arm(&failed), Fate::Failed),
            (arm(&failed), Fate::Open),
            (arm(&open), Fate::Open),
        ];
        let arms = summarise(jobs);
        let line = |a: &ArmSummary| (a.arm.sigma, a.seeds, a.declared, a.means.is_some());
        let lines: Vec<_> = arms.iter().map(line).collect();
        assert_eq!(lines, [(0.4, 1, 3, true), (0.6, 0, 2, false)]);
    }
}
