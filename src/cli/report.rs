//! `jitai report`: tables, figures and one page, from the store.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::analyse::declared::{carry_out, reproduce, setting, summarise_arms};
use crate::cli::counting::Counting;
use crate::cli::{Error, Exit, StoreArgument, check, folder, optima};
use crate::manifest::{Analysis, AnalysisKind, Condition, Manifest, Published, Sides};
use crate::plan::{self, JobKey, PlannedJob, Scalar};
use crate::record::{Failure, JobRecord, JobStatus, Setting};
use crate::report::{ReportFile, ReportedExperiment, report};
use crate::store::{DataPart, DataQuery, JobState, Parts, Reader};

/// Write tables, figures and a page about the results that there are
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files)
    #[arg(required = true, value_name = "MANIFEST")]
    manifests: Vec<PathBuf>,
    /// Folder to write to; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let manifests = check::load_all(&arguments.manifests)?;
    let published = manifests.iter().map(Published::of).collect::<Result<Vec<_>, _>>();
    let published = published.map_err(|faults| Error::Manifests(vec![faults]))?;
    let reader = Reader::open(&arguments.store.store)?;
    folder::make(&arguments.out)?;
    let mut experiments = Vec::new();
    for (manifest, published) in manifests.iter().zip(&published) {
        let jobs = records(&reader, manifest)?;
        let findings = carry_out(&manifest.analyses, &jobs, published.as_ref());
        let everything = everything(manifest, &jobs);
        let queries = manifest.analyses.iter().map(|analysis| query(&everything, analysis));
        experiments.push(ReportedExperiment {
            name: manifest.name.clone(),
            question: manifest.question.clone(),
            hypothesis: manifest.hypothesis.clone(),
            manifest: manifest.source.clone(),
            findings: findings.into_iter().zip(queries).collect(),
            reproduction: published.as_ref().map(|published| reproduce(published, &jobs)),
            arms: summarise_arms(&jobs),
            jobs,
        });
    }
    let store = arguments.store.store.file_name().unwrap_or_default().to_string_lossy();
    let files = report(&experiments, &store);
    files.iter().try_for_each(|file| write(&arguments.out, file))?;
    writeln!(io::stdout(), "{}", arguments.out.join("index.html").display())?;
    Ok(Exit::Done)
}

/// The jobs of a manifest with what the store knows of them.
fn records(reader: &Reader, manifest: &Manifest) -> Result<Vec<JobRecord>, Error> {
    let kind = |wanted: fn(&AnalysisKind) -> bool| {
        manifest.analyses.iter().any(|analysis| wanted(&analysis.kind))
    };
    let parts = Parts {
        curve: kind(|kind| matches!(kind, AnalysisKind::LearningCurve { .. })),
        actions: kind(|kind| {
            matches!(kind, AnalysisKind::ActionChoice { .. } | AnalysisKind::InferenceError)
        }),
        returns: true,
    };
    let failures: HashMap<JobKey, Failure> =
        reader.failed_jobs()?.into_iter().map(|failed| (failed.job_key, failed.failure)).collect();
    let planned: Vec<PlannedJob> = plan::expand(manifest);
    let keys: Vec<JobKey> = planned.iter().map(|planned| planned.form.key()).collect();
    let states = reader.job_states(&keys)?;
    let completed = planned.iter().zip(&states).filter(|(_, state)| **state == JobState::Completed);
    let optima = optima::of_jobs(completed.map(|(planned, _)| &planned.job));
    let mut shown = Counting::new(planned.len(), "jobs read");
    let jobs = planned.iter().zip(keys).zip(states).map(|((planned, key), state)| {
        shown.one_more();
        let status = match state {
            JobState::Pending => JobStatus::Pending,
            JobState::Interrupted => JobStatus::Interrupted,
            JobState::Running => JobStatus::Running,
            JobState::Failed => match failures.get(&key) {
                Some(failure) => JobStatus::Failed(failure.clone()),
                None => JobStatus::Interrupted,
            },
            JobState::Completed => match reader.completed_run(key, parts)? {
                Some(run) => JobStatus::Completed(Box::new(run)),
                None => JobStatus::Pending,
            },
        };
        Ok(JobRecord {
            job_key: key,
            agent: planned.agent.to_string(),
            scenario: planned.job.scenario.to_string(),
            seed: planned.job.seed,
            settings: settings(planned),
            optimum: optima.get(&optima::Cell::of(&planned.job)).copied(),
            status,
        })
    });
    jobs.collect()
}

/// Every parameter but scenario and seed, by name.
fn settings(planned: &PlannedJob) -> Vec<(String, Setting)> {
    let named = planned.job.parameters().into_iter();
    let others = named.filter(|(name, _)| name != "scenario" && name != "seed");
    let mut settings: Vec<(String, Setting)> = others
        .map(|(name, value)| match value {
            Scalar::Real(real) => (name, Setting::Number(real)),
            Scalar::Integer(whole) => (name, Setting::Number(whole as f64)),
            Scalar::Text(text) => (name, Setting::Text(text)),
        })
        .collect();
    settings.sort_by(|one, other| one.0.cmp(&other.0));
    settings
}

/// The rows of every job of a manifest.
fn everything(manifest: &Manifest, jobs: &[JobRecord]) -> DataQuery {
    let names: BTreeSet<&String> =
        jobs.iter().flat_map(|job| job.settings.iter().map(|(name, _)| name)).collect();
    // Parameters that differ among jobs, with their values.
    let valued = names.into_iter().map(|name| {
        let values = distinct(jobs.iter().filter_map(|job| job.setting(name).cloned()));
        (name.clone(), values)
    });
    DataQuery {
        experiment: manifest.name.clone(),
        agents: distinct(jobs.iter().map(|job| job.agent.clone())),
        scenarios: distinct(jobs.iter().map(|job| job.scenario.clone())),
        parameters: valued.filter(|(_, values)| values.len() > 1).collect(),
        part: DataPart::Returns,
    }
}

/// The query that reads the data of an analysis of everything.
fn query(everything: &DataQuery, analysis: &Analysis) -> String {
    let mut data_query = DataQuery { part: part(analysis), ..everything.clone() };
    analysis.conditions.iter().for_each(|condition| narrow(&mut data_query, condition));
    match &analysis.kind {
        AnalysisKind::Contrast(contrast) => narrow_to_sides(&mut data_query, &contrast.sides),
        AnalysisKind::HeatMap { sides: Some(sides), .. } => narrow_to_sides(&mut data_query, sides),
        _ => {}
    }
    data_query.sql()
}

/// Of the rows that are left, leaves only those of two sides.
fn narrow_to_sides(data_query: &mut DataQuery, Sides { first, second }: &Sides) {
    match (first, second) {
        (Condition::Scenario(first), Condition::Scenario(second)) => {
            let sides: Vec<String> = first.iter().chain(second).map(ToString::to_string).collect();
            data_query.scenarios.retain(|scenario| sides.contains(scenario));
        }
        (Condition::AgentName(first), Condition::AgentName(second)) => {
            data_query.agents.retain(|agent| first.contains(agent) || second.contains(agent));
        }
        (Condition::Key { parameter, values }, Condition::Key { values: others, .. }) => {
            let (name, sides) = (parameter.to_string(), values.iter().chain(others).map(setting));
            let sides: Vec<Setting> = sides.collect();
            match data_query.parameters.iter_mut().find(|(known, _)| *known == name) {
                Some((_, values)) => values.retain(|value| sides.contains(value)),
                None => data_query.parameters.push((name, sides)),
            }
        }
        _ => {}
    }
}

/// What comes up, each thing once, in the order in which it first does.
fn distinct<T: ToString>(found: impl Iterator<Item = T>) -> Vec<T> {
    let mut seen = HashSet::new();
    found.filter(|thing| seen.insert(thing.to_string())).collect()
}

/// Leaves only the rows that a condition is for. All seeds of an analysis are read.
fn narrow(data_query: &mut DataQuery, condition: &Condition) {
    match condition {
        Condition::Scenario(list) => {
            data_query.scenarios = list.iter().map(ToString::to_string).collect();
        }
        Condition::AgentName(list) => data_query.agents.clone_from(list),
        Condition::Seed(_) => {}
        Condition::Key { parameter, values } => {
            let name = parameter.to_string();
            let wanted = values.iter().map(setting).collect();
            match data_query.parameters.iter_mut().find(|(known, _)| *known == name) {
                Some((_, values)) => *values = wanted,
                None => data_query.parameters.push((name, wanted)),
            }
        }
    }
}

/// The part of the results that an analysis is about.
fn part(analysis: &Analysis) -> DataPart {
    match &analysis.kind {
        AnalysisKind::LearningCurve { .. } => DataPart::LearningCurve,
        AnalysisKind::ActionChoice { .. } | AnalysisKind::InferenceError => DataPart::ActionChoice,
        AnalysisKind::Contrast(_)
        | AnalysisKind::Curve { .. }
        | AnalysisKind::HeatMap { .. }
        | AnalysisKind::Selection { .. } => match analysis.metric {
            "lower_quartile_return" => DataPart::Returns,
            metric => DataPart::Metric(metric.to_owned()),
        },
    }
}

/// Writes a file of the report, under another name until it is whole.
fn write(folder: &Path, file: &ReportFile) -> Result<(), Error> {
    let path = folder.join(&file.name);
    let failure = |source| Error::Io { what: format!("write `{}`", path.display()), source };
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(failure)?;
    }
    let mut partial = path.clone().into_os_string();
    partial.push(".partial");
    fs::write(&partial, &file.bytes).map_err(failure)?;
    fs::rename(&partial, &path).map_err(failure)
}
