//! `jitai status`: the state of every experiment in a store.

use std::collections::{HashMap, HashSet};
use std::io::{self, Write};

use serde_json::{Value, json};

use crate::cli::changes::Changes;
use crate::cli::output::{Format, OutputField, OutputRows, counted};
use crate::cli::races::SearchRaces;
use crate::cli::{Error, Exit, StoreArgument, counts, submissions, summary, watch};
use crate::cluster::{self, Cluster, ClusterLook};
use crate::job::JobKey;
use crate::key::{Parameter, printable};
use crate::plan::Swept;
use crate::schedule::{self, Filtered, Left, Speeds};
use crate::store::{Counts, ExperimentCounts, FailedEstimates, FailedJob, JobState, Reader};
use crate::watch::failures::{self, SameFailure};

/// Show the experiments of a store: jobs by state, races of searches, and failures with their reasons
///
/// The remaining seconds are estimated from earlier runs: for the workers that run jobs now, or, if
/// none does, for one worker per core, the default of `jitai run`. Equal failures are listed once, with
/// their number; the format json lists every failed job.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The former name of `jitai watch --plain`
    #[arg(long, hide = true)]
    watch: bool,
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    /// First merge the results that cluster tasks have handed in
    #[arg(long)]
    merge: bool,
    /// Show only the submissions to a cluster: chunks by state, jobs done and left, core-hours
    #[arg(long)]
    submissions: bool,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    if arguments.merge {
        let look = look(arguments)?;
        submissions::collect(&look, &mut arguments.store.open()?)?;
    }
    if arguments.submissions {
        let look = look(arguments)?;
        let reader = Reader::open(&arguments.store.store)?;
        submissions::show(&look, &submissions::ended(&reader)?, arguments.format)?;
        return Ok(Exit::Done);
    }
    if arguments.watch {
        return watch::run(&watch::Arguments::plain(arguments.store.clone()));
    }
    let reader = Reader::open(&arguments.store.store)?;
    show(&reader, arguments)?;
    if arguments.format == Format::Table {
        show_submissions(arguments, &reader)?;
    }
    Ok(Exit::Done)
}

/// The submissions of the store, with their states on the cluster.
fn look(arguments: &Arguments) -> Result<ClusterLook, Error> {
    Ok(Cluster::of(&arguments.store.store, cluster::connect)?.look()?)
}

/// Prints the submissions of the store, if any, below its experiments.
fn show_submissions(arguments: &Arguments, reader: &Reader) -> Result<(), Error> {
    let look = look(arguments)?;
    if look.surveys.is_empty() {
        return Ok(());
    }
    writeln!(io::stdout(), "\nsubmissions:")?;
    submissions::show(&look, &submissions::ended(reader)?, Format::Table)
}

/// Prints the state of the store.
fn show(reader: &Reader, arguments: &Arguments) -> Result<(), Error> {
    let format = arguments.format;
    let speeds = Speeds::of(reader)?;
    let experiments = reader.experiment_counts()?;
    let details = Details::read(reader, &experiments, format)?;
    // A running job of several experiments takes one worker.
    let workers = usize::try_from(reader.running()?).ok().filter(|running| *running > 0);
    let workers = workers.unwrap_or_else(|| schedule::one_per_core().get());
    let mut columns = counts::COLUMNS.map(str::to_owned).to_vec();
    if format == Format::Json {
        columns.extend(Details::COLUMNS.map(str::to_owned));
    }
    let mut rows = OutputRows::new(format, &columns, io::stdout().lock())?;
    let (mut filters, mut programs) = (Vec::new(), Vec::new());
    for ExperimentCounts { experiment, counts, left: jobs_left } in experiments {
        // Tasks of a cluster run other jobs beside those of a filter.
        let is_filtered = !reader.filters(&experiment)?.is_empty();
        let filtered = match is_filtered && look(arguments)?.open(&experiment).next().is_none() {
            true => filtered(reader, &experiment)?,
            false => None,
        };
        let left = filtered.as_ref().map_or_else(
            || {
                let mut left = Left::default();
                jobs_left.iter().for_each(|(job, count)| left.add(job, *count));
                left
            },
            |(_, _, left)| left.clone(),
        );
        let seconds = speeds.time(&left, workers);
        let name = printable(&experiment);
        if let Some((of, chosen, _)) = &filtered {
            let of = of.described(counts.total());
            let (ended, running) = (chosen.completed + chosen.failed, chosen.running);
            filters.push(format!(
                "{name}: {of}, of which {ended} have ended, with {running} running; the seconds left are theirs"
            ));
        }
        let mixed = reader.mixed_programs(&experiment)?;
        programs.extend(mixed.iter().map(|said| format!("{name}: {said}")));
        let mut fields = counts::fields(&experiment, &counts, seconds);
        if format == Format::Json {
            let described = filtered.map(|(of, counts, _)| {
                json!({
                    "filters": of.filters, "jobs": counts.total(), "completed": counts.completed,
                    "running": counts.running, "failed": counts.failed,
                    "interrupted": counts.interrupted, "pending": counts.pending,
                })
            });
            let nested =
                details.described(&experiment, described.unwrap_or_default(), json!(mixed));
            fields.extend(nested.map(OutputField::Nested));
        }
        rows.row(&fields)?;
    }
    rows.finish()?;
    if format == Format::Table {
        let mut lines = filters.iter().chain(&programs);
        lines.try_for_each(|line| writeln!(io::stdout(), "\n{line}"))?;
    }
    details.list(format)
}

/// What the output says of experiments beside the numbers of their jobs.
struct Details {
    failed: Failed,
    /// `None` for CSV output, which has no column for them.
    changes: Option<Changes>,
    /// `None` for CSV output, which has no column for them.
    races: Option<SearchRaces>,
    /// By experiment.
    estimates: Vec<(String, FailedEstimates)>,
}

impl Details {
    /// The further columns of JSON output.
    const COLUMNS: [&str; 6] =
        ["failures", "manifest_changes", "races", "failed_estimates", "filtered", "mixed_programs"];

    fn read(
        reader: &Reader,
        experiments: &[ExperimentCounts],
        format: Format,
    ) -> Result<Details, Error> {
        let is_csv = format == Format::Csv;
        let mut estimates = Vec::new();
        for ExperimentCounts { experiment, .. } in experiments {
            let failed = reader.failed_estimates(experiment)?;
            estimates.extend(failed.map(|failed| (experiment.clone(), failed)));
        }
        Ok(Details {
            failed: Failed::read(reader)?,
            changes: (!is_csv).then(|| Changes::read(reader)).transpose()?,
            races: (!is_csv).then(|| SearchRaces::read(reader)).transpose()?,
            estimates,
        })
    }

    /// The values of the further columns for an experiment, in their order.
    fn described(&self, experiment: &str, filtered: Value, mixed_programs: Value) -> [Value; 6] {
        let changes = self.changes.as_ref().map(|changes| changes.described(experiment));
        let races = self.races.as_ref().map(|races| races.described(experiment));
        let estimates = self.estimates.iter().find(|(name, _)| name == experiment);
        let estimates = estimates.map(|(_, failed)| {
            json!({ "jobs": failed.jobs, "name": failed.name, "reason": failed.reason })
        });
        let [changes, races, estimates] =
            [changes, races, estimates].map(Option::unwrap_or_default);
        [self.failed.described(experiment), changes, races, estimates, filtered, mixed_programs]
    }

    /// Prints the details that the format does not have in its rows.
    fn list(&self, format: Format) -> Result<(), Error> {
        match format {
            Format::Table => {
                self.races.iter().try_for_each(SearchRaces::list)?;
                self.failed.list()?;
                for (experiment, failed) in &self.estimates {
                    let name = printable(experiment);
                    writeln!(io::stdout(), "\n{name}: {}", printable(&failed.described()))?;
                }
                self.changes.iter().try_for_each(Changes::list)?;
            }
            Format::Json => {}
            _ if self.failed.jobs.is_empty() => {}
            _ => {
                let jobs = counted(self.failed.jobs.len(), "failed job");
                writeln!(
                    io::stderr(),
                    "{jobs}; for the reasons use --format table or json, or query `failure_message` \
                     in the view run_summary"
                )?;
            }
        }
        Ok(())
    }
}

/// The jobs of an experiment that living commands with filters run, by state, and their remaining work; `None` if
/// a command runs all jobs.
fn filtered(reader: &Reader, experiment: &str) -> Result<Option<(Filtered, Counts, Left)>, Error> {
    let filters = reader.filters(experiment)?;
    if filters.is_empty() {
        return Ok(None);
    }
    let arms = reader.arms(experiment)?;
    let Some(filtered) = Filtered::of(filters, &arms) else { return Ok(None) };
    let (mut counts, mut left, mut seen) = (Counts::default(), Left::default(), HashSet::new());
    for arm in &arms {
        // Two agents may share a job.
        let is_new = |key: &&JobKey| filtered.keys.contains(*key) && seen.insert(**key);
        let keys: Vec<&JobKey> = arm.keys.iter().filter(is_new).collect();
        for state in reader.job_states(keys)? {
            counts.add(state, 1);
            match state {
                JobState::Completed | JobState::Failed => {}
                JobState::Pending | JobState::Interrupted | JobState::Running => {
                    left.add(&arm.job, 1);
                }
            }
        }
    }
    Ok(Some((filtered, counts, left)))
}

/// The failed jobs of a store, with the swept parameters of their experiments.
struct Failed {
    jobs: Vec<FailedJob>,
    /// Swept parameters by experiment, for experiments with failed jobs.
    swept: HashMap<String, Swept>,
}

impl Failed {
    fn read(reader: &Reader) -> Result<Failed, Error> {
        let jobs = reader.failed_jobs()?;
        let mut swept = HashMap::new();
        for FailedJob { experiment, .. } in &jobs {
            if !swept.contains_key(experiment) {
                let text = reader.manifest(experiment)?.unwrap_or_default();
                let manifest = schedule::stored_manifest(reader, &text);
                swept.insert(experiment.clone(), Swept::of(manifest.as_slice()));
            }
        }
        Ok(Failed { jobs, swept })
    }

    /// The failed jobs of an experiment as JSON.
    fn described(&self, experiment: &str) -> Value {
        let ours = self.jobs.iter().filter(|job| job.experiment == experiment);
        ours.map(|failed| {
            json!({
                "job_key": failed.job_key.to_string(),
                "agent": failed.agent,
                "scenario": failed.job.as_ref().map(|job| job.scenario.to_string()),
                "sigma": failed.job.as_ref().and_then(|job| job.number(Parameter::Environment("sigma"))),
                "seed": failed.job.as_ref().map(|job| job.seed),
                "swept": failed.job.as_ref().map(|job| {
                    self.swept[experiment].object(&failed.agent, job)
                }),
                "attempt": failed.attempt,
                "failure_kind": failed.failure.kind.word(),
                "failure_message": failed.failure.message,
                "failure_episode": failed.failure.episode,
            })
        })
        .collect()
    }

    /// Lists the different failures, each with its first job and the number of its jobs.
    fn list(&self) -> Result<(), Error> {
        if self.jobs.is_empty() {
            return Ok(());
        }
        let mut out = io::stdout().lock();
        writeln!(out, "\nfailed:")?;
        let columns =
            ["experiment", "job_key", "job", "jobs", "attempt", "kind", "episode", "message"];
        let mut rows = OutputRows::new(Format::Table, &columns.map(str::to_owned), &mut out)?;
        for SameFailure { first: failed, jobs } in failures::different(&self.jobs) {
            rows.row(&[
                OutputField::text(&failed.experiment),
                OutputField::text(failed.job_key.to_string()),
                OutputField::text(summary::name_of_failed(&self.swept[&failed.experiment], failed)),
                OutputField::Integer(jobs as i64),
                OutputField::Integer(i64::from(failed.attempt)),
                OutputField::text(failed.failure.kind.word()),
                OutputField::Integer(i64::from(failed.failure.episode)),
                OutputField::text(&failed.failure.message),
            ])?;
        }
        Ok(rows.finish()?)
    }
}
