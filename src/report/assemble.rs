//! The contents of a report: experiments of manifests, from the store to their findings.

use std::collections::HashSet;
use std::sync::Arc;

use super::diagnosands;
use super::optima;
use super::race::race;
use super::section::ReportedExperiment;
use crate::analyse::declared::{SAME, carry_out, condense, reproduce, summarise_arms, varying};
use crate::job::{Condition, DataPart, Estimates, RecordedEpisodes, distinct};
use crate::key::{DIRECTION, Parameter, SectionName, Value, hidden};
use crate::manifest::{Analysis, AnalysisKind, Faults, Manifest, Published, kept_text};
use crate::plan::{self, Staged};
use crate::record::{DataSet, JobRecord, JobStatus};
use crate::report::environment_words::Words;
use crate::store::{DataQuery, Parts, Reader, StoreError};

/// Long-running work of an assembly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AssemblyWork {
    /// Reading jobs.
    Jobs,
    /// Computing optima.
    Optima,
}

/// Why a report cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub enum AssembleError {
    /// The file of published numbers that a manifest names cannot be read, or a diagnosand is faulty.
    #[error(transparent)]
    Published(#[from] Faults),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The experiments of manifests with their findings and published numbers. `on_progress` receives the
/// kind of work, the number done, and the total.
///
/// **Errors**: the store, or a file of published numbers, cannot be read.
pub fn assemble(
    reader: &Reader,
    manifests: &[Manifest],
    mut on_progress: impl FnMut(AssemblyWork, usize, usize),
) -> Result<Vec<ReportedExperiment>, AssembleError> {
    // Faults in these files are reported before the long-running work.
    let published = manifests.iter().map(Published::of).collect::<Result<Vec<_>, _>>()?;
    manifests.iter().try_for_each(diagnosands::check_diagnosands)?;
    let staged = plan::at_stage(manifests, |keys, metric| reader.scores(keys, metric))?;
    let experiment = |(staged, published): (&Staged<'_>, Option<Published>)| {
        let manifest = staged.manifest();
        let (mut data, unknown_optima) = data_set(reader, staged, &mut on_progress)?;
        add_days(reader, manifest, &mut data)?;
        add_recorded(reader, manifest, &mut data)?;
        // Whether a trial was randomised comes before what follows from it.
        let mut all: Vec<&Analysis> = manifest.analyses.iter().collect();
        all.sort_by_key(|one| !matches!(one.kind, AnalysisKind::Randomisation(_)));
        let queries: Vec<DataQuery> =
            all.iter().map(|analysis| query(manifest, &data, analysis)).collect();
        let is_registered = is_registered(reader, &data)?;
        let sql = |query: &DataQuery| match is_registered {
            true => query.sql(),
            false => format!("{OTHER_JOBS}{}", query.sql()),
        };
        let concerned = queries.iter().zip(&all).map(|(query, analysis)| {
            let mut jobs = query.among(&data.jobs);
            if let AnalysisKind::Effects(_) = analysis.kind {
                // An agent can have no estimate.
                jobs.retain(|job| !manifest.estimates_of(&job.agent).is_empty());
            }
            jobs
        });
        let analyses = all.iter().copied().zip(concerned).collect::<Vec<_>>();
        let words = Words::of(manifest, data.description.as_deref());
        let mut findings = carry_out(&analyses, published.as_ref(), words.return_unit);
        let of_findings = findings.iter_mut().zip(&all);
        of_findings.for_each(|(finding, analysis)| diagnosands::add(analysis, finding));
        let mut arms = summarise_arms(&data.jobs);
        arms.retain(|arm| !manifest.replays(&arm.name.agent));
        // As TOML writes them; they would turn the text around them.
        let escaped = |c: char| match hidden(c) {
            Some(DIRECTION) => format!("\\u{:04X}", u32::from(c)),
            _ => c.to_string(),
        };
        Ok(ReportedExperiment {
            name: manifest.name.clone(),
            question: manifest.question.clone(),
            hypothesis: manifest.hypothesis.clone(),
            manifest: kept_text(manifest).chars().map(escaped).collect(),
            race: race(reader, manifest, words.return_unit)?,
            findings: findings.into_iter().zip(queries.iter().map(sql)).collect(),
            styles: all.iter().map(|analysis| analysis.figure).collect(),
            labels: manifest
                .agents
                .iter()
                .filter_map(|agent| Some((agent.name.clone(), agent.label.clone()?)))
                .collect(),
            files: manifest.file_labels(),
            reproduction: published
                .as_ref()
                .map(|published| reproduce(published, &data.jobs, words.return_unit)),
            arms,
            unknown_optima,
            mixed_programs: reader.mixed_programs(&manifest.name)?,
            words,
            jobs: data.jobs,
        })
    };
    staged.iter().zip(published).map(experiment).collect()
}

/// The comment above the SQL if its jobs differ from the figure's jobs.
const OTHER_JOBS: &str = "/* The jobs of the manifest have changed since `jitai run` last read it. The \
     figure\n   shows the jobs of the current manifest; this query finds the jobs of the last run. */\n";

/// Whether the experiment has the same jobs in the store as in the data set.
fn is_registered(reader: &Reader, data: &DataSet) -> Result<bool, StoreError> {
    let mut registered = HashSet::new();
    reader.jobs_of(&data.experiment, |key| {
        registered.insert(key);
    })?;
    Ok(registered == data.jobs.iter().map(|job| job.job_key).collect())
}

/// The jobs of a manifest with their results from the store and the optima of completed jobs, and
/// the reasons for unknown optima.
fn data_set(
    reader: &Reader,
    manifest: &Staged<'_>,
    mut on_progress: impl FnMut(AssemblyWork, usize, usize),
) -> Result<(DataSet, Vec<String>), StoreError> {
    let total = usize::try_from(manifest.count()).unwrap_or(usize::MAX);
    let mut problems = optima::Problems::default();
    let planned = manifest.jobs().inspect(|planned| problems.add(&planned.job));
    let mut read = 0;
    let parts = |job: &JobRecord| parts(manifest, job);
    // A metric needs no more of the returns than their quartiles; a kind of analysis may need them all.
    let needs_returns =
        |one: &Analysis| one.part() == DataPart::Returns && one.metric.quantile().is_none();
    let is_condensed = !manifest.analyses.iter().any(needs_returns);
    let mut data = reader.data_set_of(&manifest.name, planned, parts, |job| {
        if let (JobStatus::Completed(run), true) = (&mut job.status, is_condensed) {
            condense(Arc::make_mut(run));
        }
        if let JobStatus::Completed(run) = &mut job.status
            && !run.estimates.is_empty()
        {
            // A run can have estimates that other manifests declare, and has them in another order.
            let declared = manifest.estimates_of(&job.agent);
            let place = |one: &Estimates| declared.iter().position(|of| *of == one.declaration);
            let estimates = &mut Arc::make_mut(run).estimates;
            estimates.retain(|one| place(one).is_some());
            estimates.sort_by_key(place);
        }
        read += 1;
        on_progress(AssemblyWork::Jobs, read, total);
    })?;
    let is_completed = data.jobs.iter().map(|job| job.completed().is_some());
    let found =
        problems.optima(is_completed, |done, of| on_progress(AssemblyWork::Optima, done, of));
    let ranges = distinct(manifest.analyses.iter().filter_map(|analysis| analysis.participants));
    reader.read_participants(&mut data.jobs, &ranges)?;
    for (job, optimum) in data.jobs.iter_mut().zip(found.of_jobs) {
        job.optimum = optimum;
    }
    Ok((data, found.unknown))
}

/// Reads the decisions of the people whose days are drawn, of the first completed job of each arm.
fn add_days(reader: &Reader, manifest: &Manifest, data: &mut DataSet) -> Result<(), StoreError> {
    for analysis in &manifest.analyses {
        let AnalysisKind::Days(kind) = &analysis.kind else { continue };
        let conditions: Vec<Condition> = analysis.of_jobs().collect();
        let mut earlier: Option<JobRecord> = None;
        for job in &mut data.jobs {
            let is_concerned = conditions.iter().all(|condition| condition.is_met_by(job));
            let is_first = earlier.as_ref().is_none_or(|earlier| !earlier.shares_arm(job));
            let JobStatus::Completed(run) = &mut job.status else { continue };
            if is_concerned && is_first {
                let mut days = reader.days(&job.job_key, &kind.people)?;
                let run = Arc::make_mut(run);
                // Another analysis may show the same people.
                days.retain(|one| run.days.iter().all(|known| known.person != one.person));
                run.days.extend(days);
                earlier = Some(job.clone());
            }
        }
    }
    Ok(())
}

/// Reads what analyses of recorded trials take of the completed jobs that they concern.
fn add_recorded(
    reader: &Reader,
    manifest: &Manifest,
    data: &mut DataSet,
) -> Result<(), StoreError> {
    for analysis in &manifest.analyses {
        let [mut drawn, mut replayed, mut valued] = [false; 3];
        match analysis.kind {
            AnalysisKind::Randomisation(_) => drawn = true,
            AnalysisKind::Replay(_) => replayed = true,
            AnalysisKind::Effects(_) if manifest.is_recorded() => valued = true,
            _ => continue,
        }
        let conditions: Vec<Condition> = analysis.of_jobs().collect();
        for job in &mut data.jobs {
            let is_concerned = conditions.iter().all(|condition| condition.is_met_by(job));
            let per_day = job.number(&Parameter::Trial("decisions_per_day").to_string());
            let JobStatus::Completed(run) = &mut job.status else { continue };
            if !is_concerned {
                continue;
            }
            let run = Arc::make_mut(run);
            if drawn && run.description.is_none() {
                run.description = reader.description(&job.job_key)?;
            }
            let is_value = |one: &Estimates| one.declaration.policy.is_some();
            if valued && run.mean_outcome.is_none() && run.estimates.iter().any(is_value) {
                run.mean_outcome = reader.mean_outcome(&job.job_key)?;
            }
            if replayed && run.replayed.is_none() {
                let per_day = per_day.unwrap_or(1.0) as u32;
                run.replayed = Some(reader.replayed(&job.job_key, per_day, SAME)?);
            }
        }
    }
    Ok(())
}

/// The results of a job that the manifest's analyses and its tables take.
fn parts(manifest: &Manifest, job: &JobRecord) -> Parts {
    let reads = |part| {
        let mut analyses = manifest.analyses.iter().filter(|analysis| analysis.part() == part);
        analyses.any(|analysis| analysis.of_jobs().all(|condition| condition.is_met_by(job)))
    };
    Parts {
        curve: reads(DataPart::LearningCurve),
        actions: reads(DataPart::ActionChoice),
        returns: true,
        estimates: !manifest.estimates.is_empty(),
        posteriors: reads(DataPart::Posteriors) || reads(DataPart::PersonPosteriors),
    }
}

/// The query that reads the data of an analysis: the conditions of the analysis and of its sides,
/// among the jobs that the manifest declares.
fn query(manifest: &Manifest, data: &DataSet, analysis: &Analysis) -> DataQuery {
    let mut conditions: Vec<Condition> = analysis.of_jobs().collect();
    let asked: Vec<String> = conditions.iter().map(Condition::name).collect();
    let agents = manifest.agents.iter().map(|agent| &agent.name);
    let mut declared = vec![
        Condition::texts(Parameter::AGENT_NAME, agents),
        Condition::texts(Parameter::SCENARIO, manifest.scenarios()),
    ];
    declared.extend(manifest.sections.iter().flat_map(|(_, shared)| shared.conditions()));
    conditions.extend(declared.into_iter().filter(|one| !asked.contains(&one.name())));
    // Agents and scenarios first, then keys by name.
    let rank = |condition: &Condition| match condition.parameter {
        Parameter::AGENT_NAME => (0, String::new()),
        Parameter::SCENARIO => (1, String::new()),
        Parameter::SEED => (2, String::new()),
        parameter => (3, parameter.to_string()),
    };
    conditions.sort_by_key(rank);
    let varying = varying(&data.jobs.iter().collect::<Vec<_>>());
    let keys = conditions.iter().filter(|one| rank(one).0 == 3).map(Condition::name);
    let columns = distinct(varying.into_iter().chain(keys));
    let none = Value::Choice(RecordedEpisodes::None.word());
    let kept =
        manifest.sections[SectionName::Evaluation].get("record_episodes").unwrap_or_default();
    let part = match analysis.part() {
        // Where episodes are not recorded, what is computed from them is.
        DataPart::Returns if kept == [none] => DataPart::Metric(analysis.metric),
        part => part,
    };
    DataQuery { experiment: data.experiment.clone(), conditions, columns, part }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;

    #[test]
    fn a_query_has_a_condition_for_every_swept_section() {
        let text = r#"
format = 1
name = "t"
scenarios = ["C"]
seeds = 2
environment.sigma = [0.4, 0.6]
environment.horizon = 6
population.delta_d = [{ uniform = [0.1, 0.2] }, { uniform = [0.2, 0.3] }]
trial = { people = [4, 8], days = 6, outage = [[], [2, 3]] }
evaluation.on = "trial"
[[agent]]
name = "never"
algorithm = "rule"
rule = "never"
[[analysis]]
name = "a"
kind = "curve"
x = "trial.people"
"#;
        let manifest = parse("t", text.as_bytes()).unwrap();
        let data = DataSet { experiment: "t".into(), jobs: Vec::new(), description: None };
        let sql = query(&manifest, &data, &manifest.analyses[0]).sql();
        for condition in [
            "'environment.sigma') IN (0.4, 0.6)",
            "'population.delta_d') IN (",
            "'trial.outage') IN ('[]', '[2,3]')",
            "'trial.people') IN (4, 8)",
            "run.agent IN ('never')",
        ] {
            assert!(sql.contains(condition), "{condition}: {sql}");
        }
    }
}
