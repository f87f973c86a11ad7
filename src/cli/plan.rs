//! `jitai plan`: what would run, and why.
//!
//! Jobs are looked at one at a time and forgotten, so that a sweep of a million is told about in
//! seconds and little memory.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use crate::cli::output::{Field, Format, Rows, counted};
use crate::cli::workers::workers;
use crate::cli::{Error, Exit, StoreArgument, check, counts};
use crate::manifest::printable;
use crate::plan::{self, Filter, JobKey, PlannedJob, Shard, Swept, Versions};
use crate::schedule::{self, Episodes, Estimate, Selection, Speeds};
use crate::store::{Counts, JobState, Reader, StoreError};

/// Jobs that the store is asked about at a time.
const ASKED_TOGETHER: usize = 1000;

/// Jobs that the store is asked about one by one; for more, reading about all it has is faster.
const ASKED_SINGLY: usize = 10_000;

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
    /// Only one of several parts of the jobs, such as 3/40, as for `run`
    #[arg(long, value_name = "I/N", conflicts_with = "resolved")]
    shard: Option<Shard>,
    /// Workers that the time left is estimated for [default: one a core, as for `run`]
    #[arg(long, value_name = "N", value_parser = workers)]
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
    let mut selection = Selection::new(&manifests, arguments.filter.as_ref())?;
    if let Some(shard) = arguments.shard {
        selection = selection.shard(shard);
    }
    let survey = Survey::new(selection, &arguments.store.store)?;
    if arguments.jobs {
        list_jobs(survey, arguments.format)?;
    } else {
        list_experiments(survey, arguments)?;
    }
    Ok(Exit::Done)
}

/// A walk through the jobs that a plan is about, with what the store knows of them.
struct Survey<'a> {
    selection: Selection<'a>,
    /// Nothing before the first run.
    reader: Option<Reader>,
    /// All that the store has tried; read when it has been asked about many jobs.
    tried: Option<HashMap<JobKey, JobState>>,
    /// By job, where it was met.
    met: HashMap<JobKey, Met>,
    /// Jobs that several manifests have.
    shared: u64,
}

/// Where a job was met.
struct Met {
    /// The last manifest.
    place: usize,
    sharing: Sharing,
}

/// A job of a manifest, with what the store knows of it.
struct Surveyed {
    key: JobKey,
    planned: PlannedJob,
    state: JobState,
    reason: Option<Reason>,
    /// Whether an earlier manifest has it, too.
    sharing: Sharing,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sharing {
    /// No manifest before this one has the job.
    First,
    /// A manifest before this one has it; it runs once.
    Shared,
}

/// Why a job is to run again, or why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Reason {
    /// Its runs were interrupted.
    Interrupted,
    /// A run failed.
    Failed,
    /// It was completed by code of other versions: of the simulation, or of an algorithm.
    Outdated { simulation: Option<Change>, algorithm: Option<(&'static str, Change)> },
}

/// Of a version of the code.
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
    /// Of one job.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (simulation, algorithm) = match self {
            Reason::Interrupted => return write!(f, "was interrupted"),
            Reason::Failed => return write!(f, "failed; runs with --retry-failed"),
            Reason::Outdated { simulation, algorithm } => (simulation, algorithm),
        };
        let simulation = simulation.map(|change| ("the simulation", change));
        let changes = simulation.into_iter().chain(*algorithm);
        let changes =
            changes.map(|(what, Change { from, to })| format!("{what} changed: {from} → {to}"));
        f.write_str(&changes.collect::<Vec<_>>().join(", "))
    }
}

impl Reason {
    /// Why content that the store has under earlier versions of the code is to run again.
    fn outdated(planned: &PlannedJob, earlier: Versions) -> Reason {
        let now = planned.job.versions();
        let algorithm = Change::between(earlier.algorithm, now.algorithm);
        Reason::Outdated {
            simulation: Change::between(earlier.environment, now.environment),
            algorithm: algorithm.map(|change| (planned.job.algorithm(), change)),
        }
    }

    /// The sentence about so many jobs.
    fn of(self, jobs: u64) -> String {
        let (all, one) = (counted(jobs, "job"), jobs == 1);
        match self {
            Reason::Interrupted if one => format!("{all} was interrupted; a run goes on with it"),
            Reason::Interrupted => format!("{all} were interrupted; a run goes on with them"),
            Reason::Failed if one => format!("{all} failed; it runs with --retry-failed"),
            Reason::Failed => format!("{all} failed; they run with --retry-failed"),
            Reason::Outdated { .. } => format!("{all} to run again: {self}"),
        }
    }
}

impl<'a> Survey<'a> {
    fn new(selection: Selection<'a>, store: &Path) -> Result<Self, Error> {
        let reader = match Reader::open(store) {
            Ok(reader) => Some(reader),
            Err(StoreError::Missing { .. } | StoreError::Empty { .. }) => None,
            Err(error) => return Err(error.into()),
        };
        Ok(Survey { selection, reader, tried: None, met: HashMap::new(), shared: 0 })
    }

    /// Shows `see` every job of the manifest in this place, none twice.
    fn walk(
        &mut self,
        place: usize,
        mut see: impl FnMut(&Surveyed) -> io::Result<()>,
    ) -> Result<(), Error> {
        let mut jobs = self.selection.jobs(&self.selection.manifests()[place]);
        loop {
            let some: Vec<PlannedJob> = jobs.by_ref().take(ASKED_TOGETHER).collect();
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

    /// Whether the job of a manifest is shared with one before; `None` if this one had it already.
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

    /// How many jobs the experiment of the manifest in this place, which was walked last, has in the
    /// store that are not the manifest's. A filter runs fewer jobs and drops as many.
    fn dropped(&self, place: usize) -> Result<u64, Error> {
        let Some(reader) = &self.reader else { return Ok(0) };
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
        let Some(reader) = &self.reader else { return Ok(vec![JobState::Pending; keys.len()]) };
        if self.met.len() > ASKED_SINGLY && self.tried.is_none() {
            let mut tried = HashMap::new();
            reader.tried(|key, state| {
                tried.insert(key, state);
            })?;
            self.tried = Some(tried);
        }
        let Some(tried) = &self.tried else { return Ok(reader.job_states(keys)?) };
        let state = |key| tried.get(key).copied().unwrap_or(JobState::Pending);
        Ok(keys.iter().map(state).collect())
    }

    fn reason(&self, planned: &PlannedJob, state: JobState) -> Result<Option<Reason>, Error> {
        match state {
            JobState::Interrupted => return Ok(Some(Reason::Interrupted)),
            JobState::Failed => return Ok(Some(Reason::Failed)),
            JobState::Running | JobState::Completed => return Ok(None),
            JobState::Pending => {}
        }
        let Some(reader) = &self.reader else { return Ok(None) };
        let under = |versions| planned.form.key_under(versions);
        let earlier = match &self.tried {
            Some(tried) => {
                let completed = |v: &Versions| tried.get(&under(*v)) == Some(&JobState::Completed);
                planned.form.versions().earlier().filter(completed).last()
            }
            None => reader.superseded(&planned.form, planned.form.versions())?.pop(),
        };
        Ok(earlier.map(|earlier| Reason::outdated(planned, earlier)))
    }

    fn speeds(&self) -> Result<Speeds, StoreError> {
        self.reader.as_ref().map_or(Ok(Speeds::default()), Speeds::of)
    }
}

/// Jobs added up.
#[derive(Clone, Debug, Default)]
struct Sum {
    counts: Counts,
    /// What is to do, as `status` counts it: of running jobs all.
    left: Episodes,
    reasons: BTreeMap<Reason, u64>,
}

impl Sum {
    fn add(&mut self, job: &Surveyed) {
        self.counts.add(job.state, 1);
        if let Some(reason) = job.reason {
            *self.reasons.entry(reason).or_default() += 1;
        }
        match job.state {
            JobState::Pending | JobState::Interrupted | JobState::Running => {
                let job = &job.planned.job;
                self.left.add(job.algorithm(), u64::from(job.agent.episodes()));
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
    let time = |sum: &Sum| speeds.estimate(&sum.left).shared_by(workers.get());
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
        let left = time(&experiment).whole();
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
            "{name} has {jobs} in the store that this manifest and this version do not make; a run \
             takes them out of it and keeps their results"
        )?;
    }
    Ok(explain(&all, time(&all), workers)?)
}

/// Says on standard error what the numbers do not; `time` is what is left.
fn explain(all: &Sum, time: Estimate, workers: NonZeroUsize) -> io::Result<()> {
    let mut err = io::stderr();
    for (reason, jobs) in &all.reasons {
        writeln!(err, "{}", reason.of(*jobs))?;
    }
    let workers = counted(workers.get(), "worker");
    let jobs = counted(all.to_run(), "job");
    match time.spoken() {
        _ if all.to_run() == 0 => return writeln!(err, "nothing to run"),
        Some(time) => {
            writeln!(err, "{jobs} to run: {time} with {workers}, as fast as earlier runs")?;
        }
        None if time.is_whole() => {
            writeln!(err, "{jobs} to run, which do not train; no time is estimated")?;
        }
        None => writeln!(err, "{jobs} to run; no time can be estimated")?,
    }
    match time.untimed.join(" and ").as_str() {
        "" => Ok(()),
        untimed => writeln!(err, "no run of {untimed} has been timed"),
    }
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
                reason.map_or(Field::Empty, |reason| Field::text(reason.to_string())),
            ])
        })?;
    }
    Ok(rows.finish()?)
}
