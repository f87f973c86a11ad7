//! What a report is about: the experiments of manifests, from the store to their findings.

use super::optima;
use super::section::ReportedExperiment;
use crate::analyse::declared::{carry_out, reproduce, summarise_arms, varying};
use crate::manifest::{Analysis, Condition, DataPart, Manifest, Parameters, Published};
use crate::plan::{self, PlannedJob};
use crate::record::{DataSet, JobRecord};
use crate::store::{DataQuery, Parts, Reader, StoreError};

/// Work of an assembly that can take long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Jobs are read.
    Jobs,
    /// Optima are computed.
    Optima,
}

/// The experiments of manifests, each with its published numbers, if it names some. `watch` is told
/// how many of how many are done of some work.
///
/// **Errors**: the store cannot be read.
pub fn assemble(
    reader: &Reader,
    manifests: &[(Manifest, Option<Published>)],
    mut watch: impl FnMut(Work, usize, usize),
) -> Result<Vec<ReportedExperiment>, StoreError> {
    let experiment = |(manifest, published): &(Manifest, Option<Published>)| {
        let (data, unknown_optima) = data_set(reader, manifest, &mut watch)?;
        let queries: Vec<DataQuery> =
            manifest.analyses.iter().map(|analysis| query(manifest, &data, analysis)).collect();
        let concerned = queries.iter().map(|query| -> Vec<&JobRecord> {
            data.jobs.iter().filter(|job| query.asks_for(job)).collect()
        });
        let analyses = manifest.analyses.iter().zip(concerned).collect::<Vec<_>>();
        let findings = carry_out(&analyses, published.as_ref());
        Ok(ReportedExperiment {
            name: manifest.name.clone(),
            question: manifest.question.clone(),
            hypothesis: manifest.hypothesis.clone(),
            manifest: manifest.source.clone(),
            findings: findings.into_iter().zip(queries.iter().map(DataQuery::sql)).collect(),
            reproduction: published.as_ref().map(|published| reproduce(published, &data.jobs)),
            arms: summarise_arms(&data.jobs),
            unknown_optima,
            jobs: data.jobs,
        })
    };
    manifests.iter().map(experiment).collect()
}

/// The jobs of a manifest with what the store knows of them and the optimum of completed ones, and why some
/// optima are not known.
fn data_set(
    reader: &Reader,
    manifest: &Manifest,
    mut watch: impl FnMut(Work, usize, usize),
) -> Result<(DataSet, Vec<String>), StoreError> {
    let reads = |part| manifest.analyses.iter().any(|analysis| analysis.part() == part);
    let parts = Parts {
        curve: reads(DataPart::LearningCurve),
        actions: reads(DataPart::ActionChoice),
        returns: true,
    };
    let planned: Vec<PlannedJob> = plan::expand(manifest);
    let mut read = 0;
    let mut data = reader.data_set(&manifest.name, planned.iter().cloned(), parts, |_| {
        read += 1;
        watch(Work::Jobs, read, planned.len());
    })?;
    let completed = data.jobs.iter().zip(&planned).filter(|(job, _)| job.completed().is_some());
    let completed = completed.map(|(_, planned)| &planned.job);
    let unknown = optima::unknown(completed.clone());
    let optima = optima::of_jobs(completed, |done, of| {
        watch(Work::Optima, done, of);
    });
    for (job, planned) in data.jobs.iter_mut().zip(&planned) {
        job.optimum = optima.get(&optima::place_of(&planned.job)).copied();
    }
    Ok((data, unknown))
}

/// The query that reads the data of an analysis: what the analysis and its sides ask for, of what
/// the manifest declares.
fn query(manifest: &Manifest, data: &DataSet, analysis: &Analysis) -> DataQuery {
    let mut conditions: Vec<Condition> = analysis.of_jobs().collect();
    let asked: Vec<String> = conditions.iter().map(Condition::name).collect();
    let agents = manifest.agents.iter().map(|agent| agent.name.clone()).collect();
    let mut declared =
        vec![Condition::AgentName(agents), Condition::Scenario(manifest.scenarios.clone())];
    let swept = |parameters: &Parameters| parameters.conditions().collect::<Vec<_>>();
    declared.extend(swept(&manifest.environment));
    declared.extend(swept(&manifest.evaluation));
    conditions.extend(declared.into_iter().filter(|one| !asked.contains(&one.name())));
    // Agents and scenarios first, then keys by name.
    let place = |condition: &Condition| match condition {
        Condition::AgentName(_) => (0, String::new()),
        Condition::Scenario(_) => (1, String::new()),
        Condition::Seed(_) => (2, String::new()),
        Condition::Key { parameter, .. } => (3, parameter.to_string()),
    };
    conditions.sort_by_key(place);
    let mut columns = varying(&data.jobs.iter().collect::<Vec<_>>());
    let keys = conditions.iter().filter(|one| matches!(one, Condition::Key { .. }));
    for name in keys.map(Condition::name) {
        if !columns.contains(&name) {
            columns.push(name);
        }
    }
    DataQuery { experiment: data.experiment.clone(), conditions, columns, part: analysis.part() }
}
