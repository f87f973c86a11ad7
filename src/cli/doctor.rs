//! `jitai doctor`: looks for damage in a store and salvages intact runs.

use std::io::{self, Write};
use std::path::PathBuf;

use serde_json::json;

use crate::agent::{Actions, Weights, WeightsError};
use crate::cli::output::{TextOrJson, counted, shell_word};
use crate::cli::store_argument::this_command;
use crate::cli::{Error, Exit, StoreArgument};
use crate::job::Job;
use crate::key::printable;
use crate::store::{self, Diagnosis, Discovery, Salvaged, Store};

/// Check a store for damage: its file, its references, and every result against its digest
///
/// Exits with 0 if the store is healthy and with 3 if it is damaged.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Copy every intact completed run to a new store; the damaged store is only read
    ///
    /// Exits with 0 if the new store was written.
    #[arg(long, value_name = "NEW")]
    salvage: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    match &arguments.salvage {
        Some(new) => {
            let salvaged = store::salvage(&arguments.store.store, new, &check_weights)?;
            Store::open(new)?.changed_by(this_command()).record_command()?;
            show_salvaged(arguments, &new.display().to_string(), salvaged)?;
            Ok(Exit::Done)
        }
        None => {
            let diagnosis = store::examine(&arguments.store.store, &check_weights)?;
            show_diagnosis(arguments, &diagnosis)?;
            Ok(if diagnosis.findings.is_empty() { Exit::Done } else { Exit::System })
        }
    }
}

/// Checks the weights of a completed run; the error says what is wrong with them.
fn check_weights(job: &Job, safetensors: Option<&[u8]>) -> Result<(), String> {
    let Some(safetensors) = safetensors else {
        let missing = "no weights are stored, although its algorithm learns";
        return if job.no_weights().is_none() { Err(missing.to_owned()) } else { Ok(()) };
    };
    let weights = Weights::from_bytes(safetensors).map_err(|error| error.to_string())?;
    if !weights.are_finite() {
        return Err("a weight is infinite or not a number".to_owned());
    }
    match job.agent.trained(&job.task(), &weights, Actions::AsTrained) {
        // Another build has the engine that could load them.
        Ok(_) | Err(WeightsError::NoEngine(_)) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

fn show_diagnosis(arguments: &Arguments, diagnosis: &Diagnosis) -> Result<(), Error> {
    let Diagnosis { findings, completed, intact, uncovered } = diagnosis;
    let mut out = io::stdout().lock();
    if arguments.format == TextOrJson::Json {
        let findings: Vec<_> = findings
            .iter()
            .map(|Discovery { part, job_key, what }| {
                json!({ "part": part, "job_key": job_key, "what": what })
            })
            .collect();
        let healthy = findings.is_empty();
        let answer = json!({
            "healthy": healthy, "completed": completed, "intact": intact, "uncovered": uncovered,
            "findings": findings,
        });
        return Ok(writeln!(out, "{answer}")?);
    }
    let store = printable(&arguments.store.store.display().to_string());
    let runs = counted(*completed, "completed run");
    if *uncovered > 0 {
        let cause =
            "an earlier release made them, whose digests do not cover the decisions of trials";
        writeln!(
            io::stderr(),
            "note: changes of the recorded decisions of {} would not be found; {cause}",
            counted(*uncovered, "run")
        )?;
    }
    if findings.is_empty() {
        return Ok(writeln!(out, "{store} is healthy: {runs}, all intact")?);
    }
    writeln!(out, "{store} is damaged:")?;
    for Discovery { part, job_key, what } in findings {
        let of_job = job_key.as_ref().map(|key| format!(" of job {key}")).unwrap_or_default();
        let part = if *part == "job" { "" } else { part };
        let subject = format!("{part}{of_job}");
        let subject = if subject.is_empty() { "job" } else { subject.trim_start() };
        writeln!(out, "  {}: {}", printable(subject), printable(what))?;
    }
    let option = arguments.store.as_option();
    writeln!(
        out,
        "{intact} of {runs} are intact; `jitai doctor --salvage NEW{option}` copies the intact runs \
         to a new store"
    )?;
    Ok(())
}

fn show_salvaged(arguments: &Arguments, new: &str, salvaged: Salvaged) -> Result<(), Error> {
    let Salvaged { experiments, jobs, completed, lost, lost_more, others } = salvaged;
    let mut out = io::stdout().lock();
    if arguments.format == TextOrJson::Json {
        let answer = json!({
            "store": new, "experiments": experiments, "jobs": jobs, "completed": completed,
            "lost": lost, "lost_more": lost_more, "failed_or_interrupted": others,
        });
        return Ok(writeln!(out, "{answer}")?);
    }
    writeln!(
        out,
        "{}: {}, {}, {}, {} that failed or were interrupted; {} lost{}",
        printable(new),
        counted(experiments as u64, "experiment"),
        counted(jobs as u64, "job"),
        counted(completed as u64, "completed run"),
        counted(others as u64, "run"),
        counted(lost as u64, "completed run"),
        if lost_more { ", and an unknown number that can no longer be read" } else { "" },
    )?;
    writeln!(
        out,
        "`jitai run` with the same manifests and --store {} runs what is missing",
        shell_word(new)
    )?;
    Ok(())
}
