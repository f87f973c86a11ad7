//! Reads a view of an experiment.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::cluster::{self, ChunkState, Cluster, ClusterError, ClusterLook, HandedIn, Part};
use crate::job::metric::{MEAN_RETURN, metrics_with};
use crate::job::{JobKey, MetricName, MetricPlace, counted};
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::Swept;
use crate::schedule::{self, CheckpointFolder, Filtered, Left, RunningCurve, Speeds};
use crate::store::{Counts, FailedJob, JobState, Reader, StoreError, StoredArm};
use crate::watch::band::band;
use crate::watch::failures::{self, SameFailure};
use crate::watch::view::{ArmView, CurveChart, FailureView, RunningView, View, ViewChoice};

/// Shortest time between two looks.
const EVERY: Duration = Duration::from_secs(2);
/// Time from one look to the next, as a multiple of the time that a look takes.
const PAUSE: u32 = 4;
/// Time between two questions to the engine of a cluster.
const ASK: Duration = Duration::from_secs(15);
/// The number of parts of a line.
const PARTS: usize = 60;

/// Why there is nothing to watch.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A submission cannot be read.
    #[error(transparent)]
    Cluster(#[from] ClusterError),
    /// The store has no such experiment.
    #[error("the store has no experiment `{name}`")]
    Unknown {
        /// The name.
        name: String,
        /// The experiments of the store.
        known: Vec<String>,
    },
    /// The store has no experiment.
    #[error("the store {} has no experiment yet; start one with `jitai run`", path.display())]
    Nothing {
        /// The store.
        path: PathBuf,
    },
}

/// Reads views of the experiments of a store.
pub struct Watcher {
    path: PathBuf,
    reader: Reader,
    /// The jobs of the experiment that was read last.
    jobs: Option<Jobs>,
    /// Test returns of completed jobs.
    returns: HashMap<JobKey, f64>,
    /// Learning curves of completed jobs in a metric.
    curves: HashMap<JobKey, Vec<(u32, f64)>>,
    metric: Option<MetricName>,
    /// The submissions, and when they were looked at.
    look: Option<(Instant, ClusterLook)>,
    /// The number of jobs that were running at the last look.
    running: usize,
    /// The parts that were read.
    parts: Parts,
}

/// The jobs of an experiment.
struct Jobs {
    experiment: String,
    /// The number of jobs in the store when they were read.
    total: u64,
    /// Their membership in the experiment when they were read; see [`Reader::membership`].
    membership: i64,
    arms: Vec<StoredArm>,
    names: Vec<String>,
    swept: Swept,
    /// The manifest of a search.
    search: Option<Manifest>,
    /// The jobs that living commands with filters run.
    filtered: Option<Filtered>,
}

/// The results that tasks of a cluster have handed in.
#[derive(Default)]
struct Parts {
    seen: HashSet<PathBuf>,
    /// The part of each job, and how the job ended.
    jobs: HashMap<JobKey, (PathBuf, HandedIn)>,
    failures: Vec<FailedJob>,
}

impl Watcher {
    /// A watcher of the store at a path.
    ///
    /// **Errors**: the store cannot be opened.
    pub fn open(path: &Path) -> Result<Watcher, WatchError> {
        Ok(Watcher {
            path: path.to_owned(),
            reader: Reader::open(path)?,
            jobs: None,
            returns: HashMap::new(),
            curves: HashMap::new(),
            metric: None,
            look: None,
            running: 0,
            parts: Parts::default(),
        })
    }

    /// The experiment as it is now, and the time to wait before the next look.
    ///
    /// **Errors**: the experiment does not exist; the store or a submission cannot be read.
    pub fn look(&mut self, choice: &ViewChoice) -> Result<(View, Duration), WatchError> {
        let begun = Instant::now();
        let view = self.view(choice)?;
        Ok((view, EVERY.max(begun.elapsed() * PAUSE)))
    }

    fn view(&mut self, choice: &ViewChoice) -> Result<View, WatchError> {
        let experiments = self.reader.experiment_counts()?;
        let names: Vec<String> = experiments.iter().map(|one| one.experiment.clone()).collect();
        let chosen = match &choice.experiment {
            Some(name) => experiments.iter().find(|one| one.experiment == *name),
            None => {
                let running = experiments.iter().rfind(|one| one.counts.running > 0);
                running.or(experiments.last())
            }
        };
        let Some(chosen) = chosen else {
            return Err(match &choice.experiment {
                Some(name) => WatchError::Unknown { name: name.clone(), known: names },
                None => WatchError::Nothing { path: self.path.clone() },
            });
        };
        let mut jobs = self.jobs_of(&chosen.experiment, chosen.counts.total())?;
        // Tasks of a cluster run other jobs beside those of a filter.
        let filters = match self.submissions(&jobs.experiment) {
            (_, 0) => self.reader.filters(&jobs.experiment)?,
            _ => Vec::new(),
        };
        if jobs.filtered.as_ref().is_none_or(|known| known.filters != filters) {
            jobs.filtered = Filtered::of(filters, &jobs.arms);
        }
        self.look_at_cluster()?;
        let live = self.live();
        let states = self.states(&jobs, &live)?;
        let view = self.read(choice, &jobs, &states, live);
        self.jobs = Some(jobs);
        Ok(View { experiments: names, ..view? })
    }

    /// The jobs of an experiment, read again if others belong to it.
    fn jobs_of(&mut self, experiment: &str, total: u64) -> Result<Jobs, WatchError> {
        let membership = self.reader.membership(experiment)?;
        let known = |jobs: &Jobs| {
            (&*jobs.experiment, jobs.total, jobs.membership) == (experiment, total, membership)
        };
        if let Some(jobs) = self.jobs.take().filter(known) {
            return Ok(jobs);
        }
        let text = self.reader.manifest(experiment)?.unwrap_or_default();
        // A manifest that cannot be read leaves names without swept parameters.
        let manifest = schedule::stored_manifest(&self.reader, &text);
        let swept = Swept::of(manifest.as_slice());
        let arms = self.reader.arms(experiment)?;
        let names = arms.iter().map(|arm| swept.arm(&arm.agent, &arm.job)).collect();
        let search = manifest.filter(|manifest| manifest.search.is_some());
        Ok(Jobs {
            experiment: experiment.to_owned(),
            total,
            membership,
            arms,
            names,
            swept,
            search,
            filtered: None,
        })
    }

    /// Looks at the submissions from time to time, and at the parts that are new.
    fn look_at_cluster(&mut self) -> Result<(), WatchError> {
        if self.look.as_ref().is_some_and(|(at, _)| at.elapsed() < ASK) {
            return Ok(());
        }
        let look = Cluster::of(&self.path, cluster::connect)?.look()?;
        for (submission, _) in &look.surveys {
            for part in submission.parts()? {
                if !self.parts.seen.contains(&part.path) {
                    self.read_part(&part);
                }
            }
        }
        self.look = Some((Instant::now(), look));
        Ok(())
    }

    /// Reads the jobs of a part and how they ended. A part that cannot be read is read again at the next look;
    /// a merge reports it.
    fn read_part(&mut self, part: &Part) {
        let read = || {
            let jobs = part.jobs()?;
            let reader = Reader::open(&part.path).ok()?;
            let keys: Vec<JobKey> = jobs.iter().map(|(key, _)| *key).collect();
            Some((jobs, reader.failed_jobs().ok()?, reader.values(&keys, MEAN_RETURN).ok()?))
        };
        let Some((jobs, failures, returns)) = read() else { return };
        let jobs = jobs.into_iter().map(|(key, how)| (key, (part.path.clone(), how)));
        self.parts.jobs.extend(jobs);
        self.parts.failures.extend(failures);
        self.parts.seen.insert(part.path.clone());
        self.returns.extend(returns);
    }

    /// The learning curves of running jobs.
    fn live(&self) -> HashMap<JobKey, RunningCurve> {
        let looks = self.look.iter().flat_map(|(_, look)| &look.surveys);
        let folders = looks.filter(|(_, survey)| survey.counts().open() > 0);
        let folders = folders.map(|(submission, _)| submission.curves());
        let folders = std::iter::once(CheckpointFolder::beside(&self.path)).chain(folders);
        // A file that has just been begun or removed counts at the next look.
        let read = |(key, path): (JobKey, PathBuf)| Some((key, RunningCurve::read(&path).ok()?));
        folders.flat_map(|folder| folder.curves()).filter_map(read).collect()
    }

    /// The states of the jobs that have run, in the store and on the cluster.
    fn states(
        &self,
        jobs: &Jobs,
        live: &HashMap<JobKey, RunningCurve>,
    ) -> Result<HashMap<JobKey, JobState>, WatchError> {
        let keys: HashSet<JobKey> = jobs.arms.iter().flat_map(|arm| &arm.keys).copied().collect();
        let mut states = HashMap::with_capacity(keys.len());
        self.reader.tried(|key, state| {
            if keys.contains(&key) {
                states.insert(key, state);
            }
        })?;
        let is_open = |state: &JobState| matches!(state, JobState::Pending | JobState::Interrupted);
        let mut on_cluster = |key: &JobKey, there: JobState| {
            if keys.contains(key) && states.get(key).is_none_or(is_open) {
                states.insert(*key, there);
            }
        };
        for (key, (_, how)) in &self.parts.jobs {
            on_cluster(
                key,
                match how {
                    HandedIn::Completed => JobState::Completed,
                    HandedIn::Failed => JobState::Failed,
                },
            );
        }
        let chunks = self.look.iter().flat_map(|(_, look)| &look.surveys);
        for chunk in chunks.flat_map(|(_, survey)| &survey.chunks) {
            if chunk.state == ChunkState::Running {
                let runs = chunk.left.iter().filter(|key| live.contains_key(key));
                runs.for_each(|key| on_cluster(key, JobState::Running));
            }
        }
        Ok(states)
    }

    fn read(
        &mut self,
        choice: &ViewChoice,
        jobs: &Jobs,
        states: &HashMap<JobKey, JobState>,
        live: HashMap<JobKey, RunningCurve>,
    ) -> Result<View, WatchError> {
        let state = |key: &JobKey| states.get(key).copied().unwrap_or(JobState::Pending);
        let keys = jobs.arms.iter().flat_map(|arm| &arm.keys);
        let completed = keys.filter(|key| state(key) == JobState::Completed);
        self.read_returns(completed.copied())?;
        let mut speeds = Speeds::of(&self.reader)?;
        let mut running = Vec::new();
        let mut counted_jobs = HashSet::new();
        let mut view = View { experiment: jobs.experiment.clone(), ..View::default() };
        let will_run = |key: &JobKey| jobs.filtered.as_ref().is_none_or(|of| of.keys.contains(key));
        view.filter = jobs.filtered.as_ref().map(|of| of.described(jobs.total));
        let mut left = Left::default();
        for (arm, name) in jobs.arms.iter().zip(&jobs.names) {
            let mut counts = Counts::default();
            for key in &arm.keys {
                counts.add(state(key), 1);
                if !will_run(key) {
                    continue;
                }
                // Two agents may share a job.
                if !counted_jobs.insert(*key) {
                    continue;
                }
                view.counts.add(state(key), 1);
                if matches!(state(key), JobState::Pending | JobState::Interrupted) {
                    left.add(&arm.job, 1);
                }
                if state(key) == JobState::Running {
                    let curve = live.get(key);
                    if let Some(curve) = curve {
                        let worked = Duration::try_from_secs_f64(curve.seconds);
                        let part = arm.job.part_of_time(curve.part());
                        speeds.add(&arm.job, part, worked.unwrap_or_default());
                    }
                    let part = curve.map(RunningCurve::part);
                    let seed = &key.to_string()[..8];
                    view.running.push(RunningView { name: format!("{name} ({seed})"), part });
                    running.push((&arm.job, arm.job.part_of_time(part.unwrap_or(0.0))));
                }
            }
            let mean_return = self.mean_return(&arm.keys);
            view.arms.push(ArmView { name: name.clone(), counts, mean_return });
        }
        view.running
            .sort_by(|one, other| other.part.unwrap_or(0.0).total_cmp(&one.part.unwrap_or(0.0)));
        // Between two jobs, a worker runs none for a moment.
        let at_work = running.len().max(std::mem::replace(&mut self.running, running.len()));
        let workers = self.workers(at_work);
        if workers > 0 && view.counts.running + view.counts.pending + view.counts.interrupted > 0 {
            running.iter().for_each(|(job, part)| left.add_running(job, 1.0 - part));
            view.left = speeds.time(&left, workers);
        }
        view.failures = self.failures(jobs, states)?;
        if let Some(search) = &jobs.search {
            view.races = schedule::race_lines(search, Some(&self.reader))?;
        }
        (view.submissions, view.held) = self.submissions(&jobs.experiment);
        view.chart = self.chart(choice, jobs, states, &live)?;
        Ok(view)
    }

    /// Reads the mean returns of completed jobs that are not known yet.
    fn read_returns(&mut self, completed: impl Iterator<Item = JobKey>) -> Result<(), WatchError> {
        let new: Vec<JobKey> = completed.filter(|key| !self.returns.contains_key(key)).collect();
        self.returns.extend(self.reader.values(&new, MEAN_RETURN)?);
        Ok(())
    }

    /// The mean over jobs of their mean returns; `None` if none is known.
    fn mean_return(&self, keys: &[JobKey]) -> Option<f64> {
        let values = keys.iter().filter_map(|key| self.returns.get(key));
        let values: Vec<f64> = values.copied().collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// The number of workers: of this machine's running jobs and of the running tasks of a cluster.
    fn workers(&self, running: usize) -> usize {
        let looks = self.look.iter().flat_map(|(_, look)| &look.surveys);
        let on_cluster: usize = looks
            .map(|(submission, survey)| {
                survey.counts().running * submission.intent.cpus_per_task as usize
            })
            .sum();
        if on_cluster > 0 { on_cluster.max(running) } else { running }
    }

    /// The different failures of the experiment, in the store and in handed-in parts.
    fn failures(
        &self,
        jobs: &Jobs,
        states: &HashMap<JobKey, JobState>,
    ) -> Result<Vec<FailureView>, WatchError> {
        let mut failed = self.reader.failed_jobs()?;
        let known: HashSet<JobKey> = failed.iter().map(|failed| failed.job_key).collect();
        let new = self.parts.failures.iter().filter(|failed| !known.contains(&failed.job_key));
        failed.extend(new.cloned().collect::<Vec<_>>());
        failed.retain(|failed| {
            failed.experiment == jobs.experiment
                && states.get(&failed.job_key) == Some(&JobState::Failed)
        });
        let view = |SameFailure { first, jobs: count }: SameFailure<'_>| FailureView {
            name: match &first.job {
                Some(job) => jobs.swept.name(&first.agent, job),
                None => printable(&first.agent),
            },
            reason: format!("{} ({})", first.failure.kind, printable(&first.failure.message)),
            jobs: count,
        };
        Ok(failures::different(&failed).into_iter().map(view).collect())
    }

    /// The submissions of the experiment that are not finished, one line for each, and the number of their
    /// chunks that may still hand in results.
    fn submissions(&self, experiment: &str) -> (Vec<String>, usize) {
        let Some((_, look)) = &self.look else { return (Vec::new(), 0) };
        let ours: Vec<_> = look.open(experiment).collect();
        let held = ours.iter().map(|(_, survey)| survey.counts().open()).sum();
        let line = |(submission, survey): &(cluster::Submission, cluster::ChunkSurvey)| {
            let counts = survey.counts();
            let mut words = vec![format!("{} waiting", counted(counts.waiting, "chunk"))];
            let others = [
                (counts.running, "running"),
                (counts.finished, "finished"),
                (counts.lost, "lost"),
                (counts.unknown, "unknown"),
            ];
            let others = others.iter().filter(|(count, _)| *count > 0);
            words.extend(others.map(|(count, word)| format!("{count} {word}")));
            format!("{}: {}", submission.name(), words.join(", "))
        };
        (ours.into_iter().map(line).collect(), held)
    }

    /// The learning curves of the chosen arms.
    fn chart(
        &mut self,
        choice: &ViewChoice,
        jobs: &Jobs,
        states: &HashMap<JobKey, JobState>,
        live: &HashMap<JobKey, RunningCurve>,
    ) -> Result<CurveChart, WatchError> {
        let chosen = choice.arm.min(jobs.arms.len().saturating_sub(1));
        let Some(arm) = jobs.arms.get(chosen) else { return Ok(CurveChart::default()) };
        let termination = arm.job.environment.family().termination_metric;
        let metrics: Vec<MetricName> = metrics_with(MetricPlace::Curve, termination).collect();
        let metric = metrics[choice.metric % metrics.len()];
        if self.metric.replace(metric) != Some(metric) {
            self.curves.clear();
        }
        let (mut lines, mut episodes) = (Vec::new(), 0);
        let beside = choice.beside.iter().copied().filter(|other| *other != chosen);
        for shown in std::iter::once(chosen).chain(beside) {
            let Some(arm) = jobs.arms.get(shown) else { continue };
            let completed = |key: &&JobKey| states.get(key) == Some(&JobState::Completed);
            let new: Vec<JobKey> = arm
                .keys
                .iter()
                .filter(completed)
                .filter(|key| !self.curves.contains_key(key))
                .copied()
                .collect();
            if !new.is_empty() {
                self.curves.extend(self.reader.curves(&new, metric)?);
                let unmerged = new.iter().filter(|key| !self.curves.contains_key(key));
                let handed_in: HashSet<&PathBuf> =
                    unmerged.filter_map(|key| Some(&self.parts.jobs.get(key)?.0)).collect();
                for part in handed_in {
                    // A part that was merged and removed since is read from the store at the next look.
                    let part = Reader::open(part).and_then(|part| part.curves(&new, metric));
                    self.curves.extend(part.into_iter().flatten());
                }
            }
            let curve = |key: &JobKey| match states.get(key) {
                Some(JobState::Completed) => self.curves.get(key).map(Vec::as_slice),
                Some(JobState::Running) => {
                    live.get(key)?.points.get(&*metric.text()).map(Vec::as_slice)
                }
                _ => None,
            };
            let curves: Vec<&[(u32, f64)]> = arm.keys.iter().filter_map(curve).collect();
            // In a trial, an agent learns without training episodes.
            let trained = if arm.job.trial.is_some() { 0 } else { arm.job.agent.episodes() };
            lines.push((shown, band(&curves, trained, PARTS)));
            episodes = episodes.max(trained);
        }
        Ok(CurveChart { metric: Some(metric), metrics: metrics.len(), episodes, lines })
    }
}
