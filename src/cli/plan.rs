//! `jitai plan`: shows which jobs would run, and why.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::time::Duration;

use crate::cli::check::ManifestArguments;
use crate::cli::output::{Field, Format, Rows, counted};
use crate::cli::workers::workers;
use crate::cli::{Error, Exit, StoreArgument, counts};
use crate::key::{Parameter, printable, shortened};
use crate::manifest::Manifest;
use crate::plan::{ChangedDefault, Filter, Shard, Swept};
use crate::schedule::{self, Change, Left, Reason, Selection, Sharing, Speeds, Survey, Surveyed};
use crate::store::{Counts, JobState, Reader, StoreError};

/// Show what would run: jobs completed, pending and failed, and the estimated time
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// List the jobs
    #[arg(long)]
    jobs: bool,
    /// Print the resolved manifests instead, with presets merged and every default written out
    #[arg(long, conflicts_with_all = ["jobs", "filter", "format"])]
    resolved: bool,
    /// Show only the jobs with these parameters, such as agent=dqn,gamma=0.9|0.99
    ///
    /// Commas separate conditions, and bars separate alternatives. A value that contains one of them stands in
    /// double quotes, which the shell must not remove: --filter 'agent="a,b"'. In quotes, \" and \\
    /// stand for a quote and a backslash.
    #[arg(long, value_name = "NAME=VALUE,...")]
    filter: Option<Filter>,
    /// Show only one shard of the jobs, such as 3/40, as for `run`
    #[arg(long, value_name = "I/N", conflicts_with = "resolved")]
    shard: Option<Shard>,
    /// Number of workers for the estimated time [default: one per core, as for `run`]
    #[arg(long, value_name = "N", value_parser = workers)]
    workers: Option<NonZeroUsize>,
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let manifests = arguments.manifests.load(&arguments.store)?;
    if arguments.resolved {
        for manifest in &manifests {
            write!(io::stdout(), "{}", manifest.resolved())?;
        }
        return Ok(Exit::Done);
    }
    let mut selection = Selection::new(&manifests, arguments.filter.as_ref())?;
    if let Some(shard) = arguments.shard {
        selection = selection.shard(shard);
    }
    let reader = match Reader::open(&arguments.store.store) {
        Ok(reader) => Some(reader),
        Err(StoreError::Missing { .. } | StoreError::Empty { .. }) => None,
        Err(error) => return Err(error.into()),
    };
    let survey = Survey::of(&selection, reader.as_ref());
    if arguments.jobs {
        list_jobs(survey, &manifests, arguments.format)?;
    } else {
        let speeds = reader.as_ref().map_or(Ok(Speeds::default()), Speeds::of)?;
        list_experiments(survey, &manifests, &speeds, arguments)?;
    }
    Ok(Exit::Done)
}

impl fmt::Display for Reason {
    /// Formats the reason for one job.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (simulation, algorithm, default) = match self {
            Reason::Interrupted => return write!(f, "was interrupted"),
            Reason::Failed => return write!(f, "failed; runs with --retry-failed"),
            Reason::Default(changed @ ChangedDefault { key, before, .. }) => {
                return write!(
                    f,
                    "{}; with {key} = {before} it is completed",
                    new_default(changed)
                );
            }
            Reason::Outdated { simulation, algorithm, default } => (simulation, algorithm, default),
        };
        let simulation = simulation.map(|change| ("the simulation", change));
        let changes = simulation.into_iter().chain(*algorithm);
        let changes =
            changes.map(|(what, Change { from, to })| format!("{what} changed: {from} → {to}"));
        let changes = changes.chain(default.as_ref().map(new_default));
        f.write_str(&changes.collect::<Vec<_>>().join(", "))
    }
}

fn new_default(ChangedDefault { algorithm, key, now, .. }: &ChangedDefault) -> String {
    format!("{key} = {now} is the new default of {algorithm}")
}

impl Reason {
    /// The message for this number of jobs.
    fn of(&self, jobs: u64) -> String {
        let (all, one) = (counted(jobs, "job"), jobs == 1);
        match self {
            Reason::Interrupted if one => {
                format!("{all} was interrupted; `jitai run` continues it")
            }
            Reason::Interrupted => format!("{all} were interrupted; `jitai run` continues them"),
            Reason::Failed if one => format!("{all} failed; `--retry-failed` runs it again"),
            Reason::Failed => format!("{all} failed; `--retry-failed` runs them again"),
            Reason::Outdated { .. } => format!("{all} to run again: {self}"),
            Reason::Default(ChangedDefault { algorithm, key, now, before }) => format!(
                "{all} to run, of {algorithm} with {key} = {now}, which is the default now; with the earlier \
                 default they are completed: to keep those results, write {key} = {before} in the agent"
            ),
        }
    }
}

/// Totals over jobs.
#[derive(Clone, Debug, Default)]
struct Sum {
    counts: Counts,
    /// The remaining work. Running jobs count in full, as in `status`.
    left: Left,
    reasons: BTreeMap<Reason, u64>,
    /// Completed jobs that lack declared estimates, and those of them that are trained again.
    lacking: [u64; 2],
}

impl Sum {
    fn add(&mut self, job: &Surveyed<'_>, reason: Option<&Reason>) {
        self.counts.add(job.state, 1);
        if let Some(reason) = reason {
            *self.reasons.entry(reason.clone()).or_default() += 1;
        }
        match job.state {
            JobState::Pending | JobState::Interrupted | JobState::Running => {
                self.left.add(&job.planned.job, 1);
            }
            JobState::Completed | JobState::Failed => {}
        }
    }

    fn to_run(&self) -> u64 {
        self.counts.pending + self.counts.interrupted
    }
}

fn list_experiments(
    mut survey: Survey<'_>,
    manifests: &[Manifest],
    speeds: &Speeds,
    arguments: &Arguments,
) -> Result<(), Error> {
    let workers = arguments.workers.unwrap_or_else(schedule::one_per_core);
    let time = |sum: &Sum| speeds.time(&sum.left, workers.get());
    let columns = counts::COLUMNS.map(str::to_owned);
    let mut rows = Rows::new(arguments.format, &columns, io::stdout().lock())?;
    let (mut all, mut dropped) = (Sum::default(), Vec::new());
    for (index, manifest) in manifests.iter().enumerate() {
        let mut experiment = Sum::default();
        survey.walk(index, |job| {
            let reason = job.reason()?;
            if job.lacks_estimates(manifest)? {
                let again = u64::from(schedule::trains_again(&job.planned.job));
                all.lacking = [all.lacking[0] + 1, all.lacking[1] + again];
            }
            experiment.add(&job, reason.as_ref());
            match job.sharing {
                Sharing::First => all.add(&job, reason.as_ref()),
                Sharing::Shared => {}
            }
            Ok::<_, StoreError>(())
        })?;
        let left = time(&experiment).as_secs_f64();
        dropped.push((&manifest.name, survey.dropped(index)?));
        rows.row(&counts::fields(&manifest.name, &experiment.counts, left))?;
    }
    rows.finish()?;
    match survey.shared() {
        0 => {}
        1 => writeln!(io::stderr(), "1 job is shared between the manifests and runs once")?,
        n => writeln!(io::stderr(), "{n} jobs are shared between the manifests and run once")?,
    }
    for (name, jobs) in dropped.into_iter().filter(|(_, jobs)| *jobs > 0) {
        let (name, jobs) = (printable(name), counted(jobs, "job"));
        writeln!(
            io::stderr(),
            "{name} has {jobs} in the store that this manifest no longer has; a run removes them \
             from the experiment and keeps their results"
        )?;
    }
    say_outside(manifests)?;
    say_environments(manifests)?;
    Ok(explain(&all, time(&all), workers, speeds.are_measured())?)
}

/// Lists the agents that are outside programs, for which jitai cannot guarantee determinism.
fn say_outside(manifests: &[Manifest]) -> io::Result<()> {
    let agents = manifests.iter().flat_map(|manifest| &manifest.agents);
    let outside = agents.filter(|agent| agent.algorithm.is_external());
    let names: Vec<String> = outside.map(|agent| printable(&agent.name)).collect();
    if names.is_empty() {
        return Ok(());
    }
    writeln!(
        io::stderr(),
        "outside programs: {}; their job keys cover command, version, parameters and budget, but \
         jitai cannot guarantee that equal jobs give equal results",
        names.join(", ")
    )
}

/// Lists the experiments whose environments are outside programs.
fn say_environments(manifests: &[Manifest]) -> io::Result<()> {
    let outside = manifests.iter().filter(|manifest| manifest.family().is_external());
    let names: Vec<String> = outside.map(|manifest| printable(&manifest.name)).collect();
    if names.is_empty() {
        return Ok(());
    }
    writeln!(
        io::stderr(),
        "environments that are outside programs: {}; their jobs start over instead of resuming in the middle; \
         job keys cover command, version and parameters, and `jitai check --try` checks that equal seeds \
         give equal episodes",
        names.join(", ")
    )
}

/// Writes reasons and the estimated time left to standard error.
fn explain(all: &Sum, time: Duration, workers: NonZeroUsize, is_measured: bool) -> io::Result<()> {
    let mut err = io::stderr();
    for (reason, jobs) in &all.reasons {
        writeln!(err, "{}", reason.of(*jobs))?;
    }
    let [lacking, again] = all.lacking;
    if lacking > 0 {
        let jobs = counted(lacking, "completed job");
        let again = match again {
            0 => "without training".to_owned(),
            again => format!("{} of them by training again, without recorded decisions", again),
        };
        writeln!(err, "estimates of {jobs} to compute, {again}")?;
    }
    if all.to_run() == 0 {
        return writeln!(err, "nothing to run");
    }
    let jobs = counted(all.to_run(), "job");
    let (time, workers) = (schedule::spoken(time), counted(workers.get(), "worker"));
    let basis = match is_measured {
        true => "estimated from earlier runs",
        false => "estimated from built-in speeds; no run has been timed yet",
    };
    writeln!(err, "{jobs} to run: about {time} with {workers}, {basis}")
}

fn list_jobs(mut survey: Survey<'_>, manifests: &[Manifest], format: Format) -> Result<(), Error> {
    let columns =
        ["experiment", "job_key", "agent", "scenario", "sigma", "seed", "swept", "state", "reason"];
    let mut rows = Rows::new(format, &columns.map(str::to_owned), io::stdout().lock())?;
    let swept = Swept::of(manifests);
    for (index, manifest) in manifests.iter().enumerate() {
        survey.walk(index, |surveyed| {
            let reason = surveyed.reason()?;
            let Surveyed { key, planned, state, .. } = surveyed;
            let row = rows.row(&[
                Field::text(&manifest.name),
                Field::text(key.to_string()),
                Field::text(&*planned.agent),
                Field::text(planned.job.scenario.to_string()),
                planned
                    .job
                    .number(Parameter::Environment("sigma"))
                    .map_or(Field::Empty, Field::Real),
                Field::Integer(planned.job.seed as i64),
                match format {
                    Format::Json => Field::Nested(swept.object(&planned.agent, &planned.job)),
                    Format::Csv => Field::text(swept.words(&planned.agent, &planned.job)),
                    Format::Table => {
                        Field::text(shortened(&swept.words(&planned.agent, &planned.job)))
                    }
                },
                Field::text(state.name()),
                reason.map_or(Field::Empty, |reason| Field::text(reason.to_string())),
            ]);
            row.map_err(Error::from)
        })?;
    }
    Ok(rows.finish()?)
}
