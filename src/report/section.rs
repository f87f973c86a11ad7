//! The contents of a report, per experiment, from which its files and its page are made.

use super::data_table::DataTable;
use super::legend::Legend;
use super::race::ReportedRace;
use super::scene::Scene;
use crate::analyse::declared::{ArmSummary, Finding, FindingContent, JobCounts, Reproduction};
use crate::job::counted;
use crate::key::printable;
use crate::manifest::{FigureKeys, nearest};
use crate::record::JobRecord;
use crate::report::environment_words::Words;
use crate::store::FailedEstimates;

/// An experiment with its findings.
#[derive(Clone, Debug)]
pub struct ReportedExperiment {
    /// Its name.
    pub name: String,
    /// The question of the experiment.
    pub question: Option<String>,
    /// The expected result.
    pub hypothesis: Option<String>,
    /// The manifest's text.
    pub manifest: String,
    /// Its jobs.
    pub jobs: Vec<JobRecord>,
    /// The findings of its analyses, each with the query for its data.
    pub findings: Vec<(Finding, String)>,
    /// The races of its search, if it is one.
    pub race: Option<ReportedRace>,
    /// The style of the figures of each analysis.
    pub styles: Vec<FigureKeys>,
    /// Names and labels of the agents that have a label.
    pub labels: Vec<(String, String)>,
    /// Digests of the files whose contents are values of keys, with the names of the files.
    pub files: Vec<(String, String)>,
    /// The comparison with published numbers, if the manifest names a file.
    pub reproduction: Option<Reproduction>,
    /// The summary of every arm.
    pub arms: Vec<ArmSummary>,
    /// The distinct reasons for missing optima of completed jobs.
    pub unknown_optima: Vec<String>,
    /// A sentence for each file of an outside program with several contents under one `version`.
    pub mixed_programs: Vec<String>,
    /// The words of its environment.
    pub words: Words,
}

impl ReportedExperiment {
    /// What a reader of the report should know: jobs without results, no figures, or another name in the store.
    /// `in_store` has the experiments of the store, which is displayed as `store`.
    pub fn notes(&self, store: &str, in_store: &[&str]) -> Vec<String> {
        let mut notes = Vec::new();
        let missing = self.jobs.iter().filter(|job| job.completed().is_none()).count();
        if missing > 0 {
            notes.push(format!(
                "{missing} of {} of {} {} no completed run",
                counted(self.jobs.len(), "job"),
                self.name,
                if missing == 1 { "has" } else { "have" }
            ));
        }
        notes.extend(self.failed_estimates().map(|said| format!("{}: {said}", self.name)));
        let is_of_effects =
            |finding: &Finding| matches!(finding.content, FindingContent::Effects(_));
        let has_effects = self.findings.iter().any(|(finding, _)| is_of_effects(finding));
        if !has_effects && self.reproduction.as_ref().is_some_and(|one| one.comparisons.is_empty())
        {
            notes.push(format!(
                "no published number belongs to an arm of {}; compare the columns of the file with the names and values of the \
                 manifest, such as environment.parameters.effect",
                self.name
            ));
        }
        notes.extend(self.mixed_programs.iter().map(|said| format!("{}: {said}", self.name)));
        let is_drawn = self.race.as_ref().is_some_and(|race| !race.figures.is_empty());
        if self.findings.is_empty() && !is_drawn {
            notes.push(format!(
                "no figures of {}, because it declares no [[analysis]]; the page has tables of its arms and agents",
                self.name
            ));
        }
        // Jobs of another experiment count, too, so a report without this one can be complete.
        if missing == self.jobs.len() && !in_store.contains(&self.name.as_str()) {
            notes.push(no_experiment(store, &self.name, in_store));
        }
        notes
    }

    /// The number of completed jobs with an estimate that failed, and the first reason; `None` if none failed.
    pub fn failed_estimates(&self) -> Option<String> {
        let failure = |job: &JobRecord| {
            let estimates = job.completed()?.estimates.iter();
            let mut terms = estimates
                .flat_map(|one| one.terms.iter().map(|term| (&one.declaration.name, term)));
            terms.find_map(|(name, term)| Some((name.clone(), term.effect.clone().err()?)))
        };
        let failed: Vec<(String, String)> = self.jobs.iter().filter_map(failure).collect();
        let (name, reason) = failed.first()?.clone();
        Some(FailedEstimates { jobs: failed.len() as u64, name, reason }.described())
    }
}

/// The message about an experiment that a store lacks, with the experiments that it has.
pub fn no_experiment(store: &str, name: &str, known: &[&str]) -> String {
    const SHOWN: usize = 10;
    let meant = nearest(name, known.iter().copied());
    let meant =
        meant.map_or(String::new(), |meant| format!(", did you mean `{}`?", printable(meant)));
    let more = if known.len() > SHOWN { ", …" } else { "" };
    let has = match known {
        [] => "no experiments".to_owned(),
        some => some.iter().take(SHOWN).copied().collect::<Vec<_>>().join(", "),
    };
    let (name, has) = (printable(name), printable(&has));
    format!("{store} has no experiment `{name}`{meant}; it has {has}{more}")
}

/// A finding in displayed form.
pub struct ShownFinding<'e> {
    pub finding: &'e Finding,
    pub stem: String,
    pub scenes: Vec<(String, Scene)>,
    /// Figures of several panels, with the stems of their files.
    pub wholes: Vec<(String, Scene)>,
    pub caption: String,
    pub table: DataTable,
    pub sql: &'e str,
    /// Whether the table is initially open.
    pub is_table: bool,
    /// Whether the figure is missing for lack of results.
    pub lacks_figure: bool,
}

/// The races of an experiment in displayed form.
pub struct ShownRace<'e> {
    pub race: &'e ReportedRace,
    /// The stem of the files of all races together.
    pub stem: String,
    /// The figure of each race, with the stem of its files.
    pub scenes: Vec<(String, &'e Scene)>,
}

/// The tables of an experiment's arms, by file name.
pub struct ArmTables {
    pub arms: (String, DataTable),
    pub agents: (String, DataTable),
}

/// An experiment in displayed form.
pub struct ReportSection<'e> {
    pub experiment: &'e ReportedExperiment,
    /// Its position on the page.
    pub anchor: String,
    pub shown: Vec<ShownFinding<'e>>,
    pub race: Option<ShownRace<'e>>,
    pub tables: ArmTables,
    pub legend: Legend,
}

/// The jobs of all experiments, each counted once.
pub fn all_jobs(experiments: &[&ReportedExperiment]) -> JobCounts {
    JobCounts::of(experiments.iter().flat_map(|experiment| &experiment.jobs))
}
