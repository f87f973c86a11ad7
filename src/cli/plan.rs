//! `jitai plan`: shows which jobs would run, and why.
//!
//! Jobs are examined one at a time and not kept, so a sweep of a million jobs takes seconds and
//! little memory.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::time::Duration;

use crate::cli::check::ManifestArguments;
use crate::cli::output::{Field, Format, Rows, counted};
use crate::cli::workers::workers;
use crate::cli::{Error, Exit, StoreArgument, counts};
use crate::job::{JobKey, PlannedJob, Versions};
use crate::manifest::{Manifest, printable};
use crate::plan::{self, ChangedDefault, Filter, Shard, Swept};
use crate::schedule::{self, Left, Selection, Speeds};
use crate::store::{Counts, JobState, JobStates, Reader, StoreError};

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
    /// Show only the jobs with these parameters, such as agent=dqn,sigma=0.4|0.6
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
    let manifests = arguments.manifests.load()?;
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
    let survey = Survey::new(selection, reader.as_ref());
    if arguments.jobs {
        list_jobs(survey, arguments.format)?;
    } else {
        list_experiments(survey, arguments)?;
    }
    Ok(Exit::Done)
}

/// A pass through the jobs of a plan, with their states in the store.
struct Survey<'a> {
    selection: Selection<'a>,
    /// `None` if there is no store yet.
    reader: Option<&'a Reader>,
    states: Option<JobStates<'a>>,
    /// The manifests in which each job occurs.
    met: HashMap<JobKey, Met>,
    /// Number of jobs that several manifests share.
    shared: u64,
}

/// The manifests in which a job occurs.
struct Met {
    /// Index of the last manifest with the job.
    place: usize,
    sharing: Sharing,
}

/// A job of a manifest, with its state in the store.
struct Surveyed {
    key: JobKey,
    planned: PlannedJob,
    state: JobState,
    reason: Option<Reason>,
    /// Whether an earlier manifest has the same job.
    sharing: Sharing,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sharing {
    /// No earlier manifest has the job.
    First,
    /// An earlier manifest has the job, which runs once.
    Shared,
}

/// Why a job runs again, or does not run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Reason {
    /// Its runs were interrupted.
    Interrupted,
    /// A run failed.
    Failed,
    /// It was completed by another version of the simulation or of the algorithm, perhaps with the earlier
    /// default of a key.
    Outdated {
        simulation: Option<Change>,
        algorithm: Option<(&'static str, Change)>,
        default: Option<ChangedDefault>,
    },
    /// It was completed with the earlier default of a key.
    Default(ChangedDefault),
}

/// A change of a version of the code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Change {
    from: u32,
    to: u32,
}

impl Change {
    fn between(from: u32, to: u32) -> Option<Change> {
        (from != to).then_some(Change { from, to })
    }
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
    /// The reason for a job whose content was completed by earlier versions of the code.
    fn outdated(
        planned: &PlannedJob,
        earlier: Versions,
        default: Option<ChangedDefault>,
    ) -> Reason {
        let now = planned.job.versions();
        let algorithm = Change::between(earlier.algorithm, now.algorithm);
        Reason::Outdated {
            simulation: Change::between(earlier.environment, now.environment),
            algorithm: algorithm.map(|change| (planned.job.algorithm(), change)),
            default,
        }
    }

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

impl<'a> Survey<'a> {
    fn new(selection: Selection<'a>, reader: Option<&'a Reader>) -> Self {
        let states = reader.map(JobStates::of);
        Survey { selection, reader, states, met: HashMap::new(), shared: 0 }
    }

    /// Calls `see` once for every distinct job of the manifest with this index.
    fn walk(
        &mut self,
        place: usize,
        mut see: impl FnMut(&Surveyed) -> io::Result<()>,
    ) -> Result<(), Error> {
        let mut jobs = self.selection.jobs(&self.selection.manifests()[place]);
        loop {
            let some: Vec<PlannedJob> = jobs.by_ref().take(JobStates::TOGETHER).collect();
            if some.is_empty() {
                return Ok(());
            }
            let distinct: Vec<(JobKey, Sharing, PlannedJob)> = some
                .into_iter()
                .filter_map(|planned| {
                    let key = planned.form.key();
                    self.meet(key, place).map(|sharing| (key, sharing, planned))
                })
                .collect();
            let keys: Vec<JobKey> = distinct.iter().map(|(key, ..)| *key).collect();
            let states = self.states(&keys)?;
            for ((key, sharing, planned), state) in distinct.into_iter().zip(states) {
                let reason = self.reason(&planned, state)?;
                see(&Surveyed { key, planned, state, reason, sharing })?;
            }
        }
    }

    /// Whether an earlier manifest shares the job; `None` if this manifest has already listed the job.
    fn meet(&mut self, key: JobKey, place: usize) -> Option<Sharing> {
        let first = Met { place, sharing: Sharing::First };
        let met = match self.met.entry(key) {
            Entry::Vacant(unmet) => return Some(unmet.insert(first).sharing),
            Entry::Occupied(met) => met.into_mut(),
        };
        if met.place == place {
            return None;
        }
        self.shared += u64::from(met.sharing == Sharing::First);
        *met = Met { place, sharing: Sharing::Shared };
        Some(Sharing::Shared)
    }

    /// The number of jobs that the experiment has in the store but no longer in its manifest. The
    /// manifest with this index must be the last one walked. A filter does not change the number.
    fn dropped(&self, place: usize) -> Result<u64, Error> {
        let Some(reader) = self.reader else { return Ok(0) };
        let manifest = &self.selection.manifests()[place];
        let mut others = HashSet::new();
        reader.jobs_of(&manifest.name, |key| {
            if self.met.get(&key).is_none_or(|met| met.place != place) {
                others.insert(key);
            }
        })?;
        if !others.is_empty() && self.selection.is_filtered() {
            for planned in plan::jobs(manifest) {
                others.remove(&planned.form.key());
            }
        }
        Ok(others.len() as u64)
    }

    /// The state of each job, in the order of `keys`.
    fn states(&mut self, keys: &[JobKey]) -> Result<Vec<JobState>, Error> {
        match &mut self.states {
            Some(states) => Ok(states.ask(keys)?),
            None => Ok(vec![JobState::Pending; keys.len()]),
        }
    }

    fn reason(&mut self, planned: &PlannedJob, state: JobState) -> Result<Option<Reason>, Error> {
        match state {
            JobState::Interrupted => return Ok(Some(Reason::Interrupted)),
            JobState::Failed => return Ok(Some(Reason::Failed)),
            JobState::Running | JobState::Completed => return Ok(None),
            JobState::Pending => {}
        }
        let Some(states) = &mut self.states else { return Ok(None) };
        if let Some(earlier) = states.superseded(&planned.form)? {
            return Ok(Some(Reason::outdated(planned, earlier, None)));
        }
        let Some((changed, form)) = plan::under_earlier_default(&planned.job) else {
            return Ok(None);
        };
        if states.ask(&[form.key()])?[0] == JobState::Completed {
            return Ok(Some(Reason::Default(changed)));
        }
        let earlier = states.superseded(&form)?;
        Ok(earlier.map(|earlier| Reason::outdated(planned, earlier, Some(changed))))
    }

    fn speeds(&self) -> Result<Speeds, StoreError> {
        self.reader.map_or(Ok(Speeds::default()), Speeds::of)
    }
}

/// Totals over jobs.
#[derive(Clone, Debug, Default)]
struct Sum {
    counts: Counts,
    /// The remaining work. Running jobs count in full, as in `status`.
    left: Left,
    reasons: BTreeMap<Reason, u64>,
}

impl Sum {
    fn add(&mut self, job: &Surveyed) {
        self.counts.add(job.state, 1);
        if let Some(reason) = job.reason.clone() {
            *self.reasons.entry(reason).or_default() += 1;
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

fn list_experiments(mut survey: Survey<'_>, arguments: &Arguments) -> Result<(), Error> {
    let workers = arguments.workers.unwrap_or_else(schedule::one_per_core);
    let speeds = survey.speeds()?;
    let time = |sum: &Sum| {
        let jobs = sum.to_run() + sum.counts.running;
        schedule::shared(speeds.time(&sum.left), workers.get(), jobs)
    };
    let columns = counts::COLUMNS.map(str::to_owned);
    let mut rows = Rows::new(arguments.format, &columns, io::stdout().lock())?;
    let (mut all, mut dropped) = (Sum::default(), Vec::new());
    for (place, manifest) in survey.selection.manifests().iter().enumerate() {
        let mut experiment = Sum::default();
        survey.walk(place, |job| {
            experiment.add(job);
            match job.sharing {
                Sharing::First => all.add(job),
                Sharing::Shared => {}
            }
            Ok(())
        })?;
        let left = time(&experiment).as_secs_f64();
        dropped.push((&manifest.name, survey.dropped(place)?));
        rows.row(&counts::fields(&manifest.name, &experiment.counts, left))?;
    }
    rows.finish()?;
    match survey.shared {
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
    say_outside(survey.selection.manifests())?;
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

/// Writes reasons and the estimated time left to standard error.
fn explain(all: &Sum, time: Duration, workers: NonZeroUsize, is_measured: bool) -> io::Result<()> {
    let mut err = io::stderr();
    for (reason, jobs) in &all.reasons {
        writeln!(err, "{}", reason.of(*jobs))?;
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

fn list_jobs(mut survey: Survey<'_>, format: Format) -> Result<(), Error> {
    let columns =
        ["experiment", "job_key", "agent", "scenario", "sigma", "seed", "swept", "state", "reason"];
    let mut rows = Rows::new(format, &columns.map(str::to_owned), io::stdout().lock())?;
    let swept = Swept::of(survey.selection.manifests());
    for (place, manifest) in survey.selection.manifests().iter().enumerate() {
        survey.walk(place, |surveyed| {
            let Surveyed { key, planned, state, reason, .. } = surveyed;
            rows.row(&[
                Field::text(&manifest.name),
                Field::text(key.to_string()),
                Field::text(&*planned.agent),
                Field::text(planned.job.scenario.to_string()),
                Field::Real(planned.job.environment.sigma),
                Field::Integer(planned.job.seed as i64),
                match format {
                    Format::Json => Field::Nested(swept.object(&planned.agent, &planned.job)),
                    Format::Table | Format::Csv => {
                        Field::text(swept.words(&planned.agent, &planned.job))
                    }
                },
                Field::text(state.name()),
                reason.as_ref().map_or(Field::Empty, |reason| Field::text(reason.to_string())),
            ])
        })?;
    }
    Ok(rows.finish()?)
}
