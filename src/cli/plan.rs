//! `jitai plan`: what would run, and why.

use std::collections::{BTreeMap, HashSet};
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::path::PathBuf;

use crate::cli::estimate::{Episodes, Speeds, spoken};
use crate::cli::filter::Filter;
use crate::cli::output::{Cell, Format, Rows};
use crate::cli::{Error, Exit, StoreArgument, check, counts, one_a_core, run};
use crate::manifest::Manifest;
use crate::schedule::Queued;
use crate::store::{Counts, JobState, Reader, StoreError};

/// Show what would run: jobs done, to do and failed, and the time it would take
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files)
    #[arg(required = true, value_name = "MANIFEST")]
    manifests: Vec<PathBuf>,
    /// List the jobs
    #[arg(long)]
    jobs: bool,
    /// Print the manifests in full instead: presets merged, every default written out
    #[arg(long, conflicts_with_all = ["jobs", "filter", "format"])]
    resolved: bool,
    /// Only jobs with these parameters, such as agent=dqn,sigma=0.4|0.6
    #[arg(long, value_name = "NAME=VALUE,...")]
    filter: Option<Filter>,
    /// Workers that the estimated time is for [default: one a core]
    #[arg(long, value_name = "N", value_parser = super::workers)]
    workers: Option<NonZeroUsize>,
    /// How rows are written
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let manifests = check::load_all(&arguments.manifests)?;
    if arguments.resolved {
        for manifest in &manifests {
            write!(io::stdout(), "{}", manifest.resolved())?;
        }
        return Ok(Exit::Done);
    }
    let planned = manifests
        .iter()
        .map(|manifest| Planned::new(manifest, arguments))
        .collect::<Result<Vec<_>, Error>>()?;
    if arguments.jobs {
        list_jobs(&planned, arguments)
    } else {
        list_experiments(&planned, arguments)
    }
}

/// The jobs of a manifest with what the store knows of them.
struct Planned<'a> {
    manifest: &'a Manifest,
    jobs: Vec<(Queued, JobState, Option<String>)>,
    speeds: Speeds,
}

impl<'a> Planned<'a> {
    fn new(manifest: &'a Manifest, arguments: &Arguments) -> Result<Self, Error> {
        let queued = run::select(std::slice::from_ref(manifest), arguments.filter.as_ref())?;
        let reader = match Reader::open(&arguments.store.store) {
            Ok(reader) => reader,
            // Nothing has run yet.
            Err(StoreError::Missing { .. }) => {
                let jobs = queued.into_iter().map(|q| (q, JobState::Pending, None)).collect();
                return Ok(Planned { manifest, jobs, speeds: Speeds::default() });
            }
            Err(error) => return Err(error.into()),
        };
        let states = reader.job_states(queued.iter().map(|queued| &queued.key))?;
        let mut jobs = Vec::with_capacity(queued.len());
        for (queued, state) in queued.into_iter().zip(states) {
            let reason = match state {
                JobState::Pending => outdated(&reader, &queued)?,
                JobState::Interrupted => Some("was interrupted".to_owned()),
                JobState::Failed => Some("failed; runs with --retry-failed".to_owned()),
                JobState::Running | JobState::Completed => None,
            };
            jobs.push((queued, state, reason));
        }
        Ok(Planned { manifest, jobs, speeds: run::speeds(&reader)? })
    }

    fn counts(&self) -> Counts {
        let mut counts = Counts::default();
        self.jobs.iter().for_each(|(_, state, _)| counts.add(*state, 1));
        counts
    }

    /// Seconds that one worker would take for what is to do; `None` without earlier runs.
    fn seconds(&self) -> Option<f64> {
        let mut left = Episodes::default();
        for (queued, state, _) in &self.jobs {
            match state {
                JobState::Pending | JobState::Interrupted => {
                    left.add(queued.job.algorithm(), u64::from(queued.job.agent.episodes()));
                }
                JobState::Running | JobState::Completed | JobState::Failed => {}
            }
        }
        self.speeds.seconds(&left)
    }
}

/// Why a job that the store has under an earlier version of the code is to run again.
fn outdated(reader: &Reader, queued: &Queued) -> Result<Option<String>, Error> {
    let now = queued.job.versions();
    let earlier = reader.superseded(&queued.job, now)?;
    Ok(earlier.last().map(|old| {
        let mut changes = Vec::new();
        if old.environment != now.environment {
            changes
                .push(format!("the simulation changed: {} → {}", old.environment, now.environment));
        }
        if old.algorithm != now.algorithm {
            let name = queued.job.algorithm();
            changes.push(format!("{name} changed: {} → {}", old.algorithm, now.algorithm));
        }
        changes.join(", ")
    }))
}

fn list_experiments(planned: &[Planned<'_>], arguments: &Arguments) -> Result<Exit, Error> {
    let workers = arguments.workers.unwrap_or_else(one_a_core);
    let columns = counts::COLUMNS.map(str::to_owned);
    let mut rows = Rows::new(arguments.format, &columns, io::stdout().lock())?;
    for one in planned {
        let left = one.seconds().map(|seconds| seconds / workers.get() as f64);
        rows.row(&counts::cells(&one.manifest.name, &one.counts(), left))?;
    }
    rows.finish()?;
    explain(planned, workers)?;
    Ok(Exit::Done)
}

/// Says on standard error what the numbers do not.
fn explain(planned: &[Planned<'_>], workers: NonZeroUsize) -> Result<(), Error> {
    let mut err = io::stderr();
    let distinct: HashSet<_> =
        planned.iter().flat_map(|one| &one.jobs).map(|(queued, ..)| queued.key).collect();
    let all: usize = planned.iter().map(|one| one.jobs.len()).sum();
    if distinct.len() < all {
        writeln!(
            err,
            "{} jobs are shared between the manifests and run once",
            all - distinct.len()
        )?;
    }
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for reason in planned.iter().flat_map(|one| &one.jobs).filter_map(|(.., why)| why.as_deref()) {
        *reasons.entry(reason).or_default() += 1;
    }
    for (reason, jobs) in reasons {
        writeln!(err, "{jobs} jobs: {reason}")?;
    }
    let seconds: Option<f64> = planned.iter().map(Planned::seconds).sum();
    match seconds {
        Some(0.0) => writeln!(err, "nothing to run")?,
        Some(seconds) => {
            let left = spoken(seconds / workers.get() as f64);
            writeln!(err, "about {left} with {workers} workers, as fast as earlier runs")?;
        }
        None => writeln!(err, "no time can be estimated before a job of each algorithm has run")?,
    }
    Ok(())
}

fn list_jobs(planned: &[Planned<'_>], arguments: &Arguments) -> Result<Exit, Error> {
    let columns =
        ["experiment", "job_key", "agent", "scenario", "sigma", "seed", "state", "reason"];
    let mut rows = Rows::new(arguments.format, &columns.map(str::to_owned), io::stdout().lock())?;
    for one in planned {
        for (queued, state, reason) in &one.jobs {
            rows.row(&[
                Cell::text(&one.manifest.name),
                Cell::text(queued.key.to_string()),
                Cell::text(&queued.agent),
                Cell::text(queued.job.scenario.to_string()),
                Cell::Real(queued.job.environment.sigma),
                Cell::Integer(queued.job.seed as i64),
                Cell::text(state.name()),
                reason.as_ref().map_or(Cell::Empty, Cell::text),
            ])?;
        }
    }
    rows.finish()?;
    Ok(Exit::Done)
}
