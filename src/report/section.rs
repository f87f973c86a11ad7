//! The contents of a report, per experiment, from which its files and its page are made.

use super::data_table::DataTable;
use super::scene::Scene;
use crate::analyse::declared::{ArmSummary, Finding, JobCounts, Reproduction};
use crate::record::JobRecord;

/// An experiment with what was found.
#[derive(Clone, Debug)]
pub struct ReportedExperiment {
    /// Its name.
    pub name: String,
    /// What its author wants to know.
    pub question: Option<String>,
    /// What its author expects.
    pub hypothesis: Option<String>,
    /// The manifest's text.
    pub manifest: String,
    /// Its jobs.
    pub jobs: Vec<JobRecord>,
    /// What its analyses found, with the query that reads their data.
    pub findings: Vec<(Finding, String)>,
    /// Published numbers beside ours, where the manifest names some.
    pub reproduction: Option<Reproduction>,
    /// What every arm came to, whatever is analysed.
    pub arms: Vec<ArmSummary>,
    /// Why the optimum of some completed jobs is not known, each reason once.
    pub unknown_optima: Vec<String>,
}

/// A finding as the page shows it.
pub struct Shown<'e> {
    pub finding: &'e Finding,
    pub stem: String,
    pub scenes: Vec<(String, Scene)>,
    pub caption: String,
    pub table: DataTable,
    pub sql: &'e str,
    /// Labels of the series that a reader can hide.
    pub series: Vec<String>,
    /// Whether readers see the table at once.
    pub is_table: bool,
    /// Whether it has no figure for want of results.
    pub lacks_figure: bool,
}

/// The tables of an experiment's arms, by file name.
pub struct ArmTables {
    pub arms: (String, DataTable),
    pub agents: (String, DataTable),
}

/// An experiment as the page shows it.
pub struct Section<'e> {
    pub experiment: &'e ReportedExperiment,
    pub shown: Vec<Shown<'e>>,
    pub tables: ArmTables,
}

/// The jobs of all experiments, each counted once.
pub fn all_jobs(experiments: &[&ReportedExperiment]) -> JobCounts {
    let mut seen = std::collections::HashSet::new();
    let jobs = experiments.iter().flat_map(|experiment| &experiment.jobs);
    JobCounts::of(jobs.filter(|job| seen.insert(job.job_key)))
}
