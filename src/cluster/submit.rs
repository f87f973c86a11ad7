//! Submitting: finds missing jobs, packs them into chunks, and passes them to an engine.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use super::clock;
use super::engine::{Alive, Engine, EngineError, Limits};
use super::engines::EngineKind;
use super::error::ClusterError;
use super::folder::{
    Intent, Stop, Submission, Submissions, array_name, chunk_file, plan_file, write_whole,
};
use super::pack::{Load, Packed, pack};
use super::profile::Profile;
use super::survey::{ChunkState, ChunkSurvey, Deaths, Loss};
use crate::job::{Failure, FailureKind, JobKey, Outcome};
use crate::manifest::{self, Manifest};
use crate::schedule::{self, Selection, Speeds, Surveyed};
use crate::store::{Claimed, Isolation, JobState, Reader, RetryFailed, RunEnd, Store, StoreError};

/// Time for which an engine that does not answer is queried about whether it accepted an array.
const PATIENCE: Duration = Duration::from_secs(120);
/// Time between two such queries.
const ASK_AGAIN: Duration = Duration::from_secs(2);

/// The submissions of a store, and the engines that run them.
pub struct Cluster<'a> {
    submissions: Submissions,
    connect: Box<dyn Fn(EngineKind) -> Box<dyn Engine + 'a> + 'a>,
}

/// The states of all submissions of a store.
pub struct ClusterLook {
    /// Each submission with its survey, the earliest first.
    pub surveys: Vec<(Submission, ChunkSurvey)>,
    /// Why the engine did not answer; `None` if it answered.
    pub silence: Option<EngineError>,
}

/// Jobs to be submitted.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// The jobs.
    pub selection: &'a Selection<'a>,
    /// Whether failed jobs are included.
    pub retry: RetryFailed,
    /// Where and how tasks run.
    pub profile: &'a Profile,
    /// Absolute path of this program, valid on the nodes.
    pub program: &'a Path,
}

/// The missing jobs, packed into chunks.
#[derive(Clone, Debug, Default)]
pub struct SubmissionDraft {
    /// The chunks.
    pub chunks: Vec<Filled>,
    /// Jobs that are completed.
    pub completed: usize,
    /// Jobs that failed and are not retried.
    pub failed: usize,
    /// Jobs that another process runs in this store.
    pub running: usize,
    /// Jobs that the engine holds.
    pub held: usize,
    /// Jobs deferred to the next submission, because their tasks died and no chunk is left for them.
    pub deferred: usize,
}

/// A chunk of a draft.
#[derive(Clone, Debug, PartialEq)]
pub struct Filled {
    /// Its jobs, the longest first.
    pub keys: Vec<JobKey>,
    /// Estimated time of its jobs on one core.
    pub seconds: f64,
}

impl SubmissionDraft {
    /// Number of jobs in all chunks.
    pub fn jobs(&self) -> usize {
        self.chunks.iter().map(|chunk| chunk.keys.len()).sum()
    }

    /// Estimated core-hours of all chunks.
    pub fn core_hours(&self) -> f64 {
        // The sum of nothing would be −0.
        self.chunks.iter().fold(0.0, |seconds, chunk| seconds + chunk.seconds) / 3600.0
    }
}

impl ClusterLook {
    /// The submissions that may still have results of an experiment.
    pub fn open<'l>(
        &'l self,
        experiment: &'l str,
    ) -> impl Iterator<Item = &'l (Submission, ChunkSurvey)> {
        self.surveys.iter().filter(move |(submission, survey)| {
            let counts = survey.counts();
            let is_open = survey.stopped.is_none() && counts.open() + counts.lost > 0;
            is_open && submission.intent.experiments.iter().any(|name| name == experiment)
        })
    }

    /// The jobs that tasks may still complete.
    fn held(&self) -> HashSet<JobKey> {
        self.surveys.iter().flat_map(|(_, survey)| survey.held()).copied().collect()
    }
}

impl<'a> Cluster<'a> {
    /// The submissions of the store at a path; `connect` makes engines.
    ///
    /// **Errors**: the path cannot be resolved.
    pub fn of(
        store: &Path,
        connect: impl Fn(EngineKind) -> Box<dyn Engine + 'a> + 'a,
    ) -> Result<Cluster<'a>, ClusterError> {
        Ok(Cluster { submissions: Submissions::beside(store)?, connect: Box::new(connect) })
    }

    /// The folder of the submissions.
    pub fn submissions(&self) -> &Submissions {
        &self.submissions
    }

    /// The limits of an engine.
    pub fn limits(&self, engine: EngineKind) -> Result<Limits, EngineError> {
        (self.connect)(engine).limits()
    }

    /// Reads all submissions, and asks their engines about open ones. Records the engine's id of an array
    /// if the submitting process was killed before it could.
    ///
    /// **Errors**: a submission cannot be read. A silent engine is not an error.
    pub fn look(&self) -> Result<ClusterLook, ClusterError> {
        let submissions = self.submissions.list()?;
        let mut surveys = Vec::new();
        for submission in submissions {
            let survey = ChunkSurvey::of(&submission, None)?;
            surveys.push((submission, survey));
        }
        let mut silence = None;
        for kind in EngineKind::ALL {
            let mut open: Vec<&mut (Submission, ChunkSurvey)> = surveys
                .iter_mut()
                .filter(|(of, survey)| of.intent.engine == kind && survey.counts().open() > 0)
                .collect();
            let names: Vec<String> = open.iter().map(|(of, _)| of.array_name()).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            if names.is_empty() {
                continue;
            }
            match (self.connect)(kind).alive(&names) {
                // The folder is read after the engine has answered.
                Ok(alive) => open.iter_mut().try_for_each(|(submission, survey)| {
                    record_found(submission, &alive)?;
                    *survey = ChunkSurvey::of(submission, Some(&alive))?;
                    Ok::<_, ClusterError>(())
                })?,
                Err(silent) => silence = Some(silent),
            }
        }
        Ok(ClusterLook { surveys, silence })
    }

    /// Marks submissions that never reached the engine because the submitting process was killed
    /// between writing the intent and calling the engine.
    ///
    /// **Errors**: the mark cannot be written.
    pub fn abandon_unknown(&self, look: &mut ClusterLook) -> Result<Vec<String>, ClusterError> {
        let mut abandoned = Vec::new();
        for (submission, survey) in &mut look.surveys {
            let begun = |state: &ChunkState| *state != ChunkState::Lost(Loss::NotBegun);
            let unknown = survey.stopped.is_none() && submission.array().is_none();
            if unknown && !survey.chunks.iter().any(|chunk| begun(&chunk.state)) {
                submission.stop(Stop::Abandoned)?;
                survey.stopped = Some(Stop::Abandoned);
                abandoned.push(submission.name().to_owned());
            }
        }
        Ok(abandoned)
    }

    /// Records jobs as failed if too many of their tasks died; returns these jobs. Also removes the learning
    /// curves that lost tasks have left.
    ///
    /// **Errors**: the store or a mark cannot be written.
    pub fn record_crashes(
        &self,
        look: &ClusterLook,
        store: &mut Store,
    ) -> Result<Vec<JobKey>, ClusterError> {
        for (submission, survey) in &look.surveys {
            let held: HashSet<&JobKey> = survey.held().collect();
            submission.curves().forget_curves(|key| !held.contains(key));
        }
        let guilty = self.deaths(look)?.guilty();
        if guilty.is_empty() {
            return Ok(Vec::new());
        }
        let session = store.begin_session(&schedule::of_this_process())?;
        let mut recorded = Vec::new();
        for key in guilty {
            let claimed = store.claim(session, &key, RetryFailed::Yes, Isolation::Alone)?;
            if let Claimed::Claimed(claim) = claimed {
                let outcome = Outcome::Failed(Failure {
                    kind: FailureKind::Crashed,
                    message: "three cluster tasks died while they ran this job, the last one \
                              without other jobs; their logs are in the folders of the submissions; \
                              `jitai submit --retry-failed` submits the job again"
                        .to_owned(),
                    episode: 0,
                });
                store.finish_all(&[RunEnd {
                    claim: &claim,
                    outcome: &outcome,
                    wall_seconds: 0.0,
                }])?;
                recorded.push(key);
            }
            self.mark_crash(&key)?;
        }
        store.end_session(session)?;
        Ok(recorded)
    }

    /// The deaths with each job since the job was last recorded as crashed.
    fn deaths(&self, look: &ClusterLook) -> Result<Deaths, ClusterError> {
        let mut deaths = Deaths::default();
        let crashed = self.crash_marks()?;
        for (submission, survey) in &look.surveys {
            let created_at = submission.intent.created_at;
            let counts = |key: &JobKey| crashed.get(key).is_none_or(|at| *at < created_at);
            deaths.add(survey, counts);
        }
        Ok(deaths)
    }

    fn mark_crash(&self, key: &JobKey) -> Result<(), ClusterError> {
        let folder = self.submissions.path().join("crashed");
        fs::create_dir_all(&folder).map_err(ClusterError::io("create", &folder))?;
        let file = folder.join(key.to_string());
        let text = format!("{}\n", clock::now());
        write_whole(&file, text.as_bytes()).map_err(ClusterError::io("write", &file))
    }

    /// The time at which each job was recorded as crashed.
    fn crash_marks(&self) -> Result<HashMap<JobKey, f64>, ClusterError> {
        let folder = self.submissions.path().join("crashed");
        let mut marks = HashMap::new();
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let text = fs::read_to_string(&path).map_err(ClusterError::io("read", &path))?;
            let key = entry.file_name().to_str().and_then(|k| u128::from_str_radix(k, 16).ok());
            if let (Some(key), Ok(at)) = (key, text.trim().parse()) {
                marks.insert(JobKey(key.to_be_bytes()), at);
            }
        }
        Ok(marks)
    }

    /// Packs the missing jobs: those neither completed, nor failed, nor held by the engine.
    ///
    /// **Errors**: the store or a submission cannot be read.
    pub fn draft(
        &self,
        request: Request<'_>,
        reader: Option<&Reader>,
        look: &ClusterLook,
        limits: Limits,
    ) -> Result<SubmissionDraft, ClusterError> {
        let speeds = reader.map_or(Ok(Speeds::default()), Speeds::of)?;
        let (held, deaths) = (look.held(), self.deaths(look)?);
        let mut draft = SubmissionDraft::default();
        let (mut keys, mut loads) = (Vec::new(), Vec::new());
        schedule::Survey::of(request.selection, reader).walk_all(|surveyed| {
            let Surveyed { key, planned, state, .. } = surveyed;
            match (state, request.retry) {
                (JobState::Completed, _) => draft.completed += 1,
                (JobState::Failed, RetryFailed::No) => draft.failed += 1,
                (JobState::Running, _) => draft.running += 1,
                (JobState::Failed, RetryFailed::Yes)
                | (JobState::Pending | JobState::Interrupted, _) => {
                    if held.contains(&key) {
                        draft.held += 1;
                        return Ok::<_, StoreError>(());
                    }
                    let dead = deaths.of(&key);
                    keys.push(key);
                    loads.push(Load {
                        seconds: speeds.seconds(&planned.job),
                        deaths: dead.map_or(0, |dead| dead.tasks),
                        died_in: dead.map_or(0, |dead| dead.last),
                    });
                }
            }
            Ok(())
        })?;
        let tasks = &request.profile.tasks;
        let seconds = tasks.chunk_minutes * 60.0 * f64::from(tasks.cpus_per_task);
        let Packed { chunks, deferred } = pack(&loads, seconds, limits.most_tasks as usize);
        draft.deferred = deferred;
        draft.chunks = chunks
            .into_iter()
            .map(|jobs| Filled {
                keys: jobs.iter().map(|&job| keys[job]).collect(),
                seconds: jobs.iter().map(|&job| loads[job].seconds).sum(),
            })
            .collect();
        Ok(draft)
    }

    /// The script for a draft; `None` if no job is missing.
    pub fn script(&self, draft: &SubmissionDraft, request: Request<'_>) -> Option<String> {
        let name = clock::new_name();
        let folder = self.submissions.folder(&name);
        (!draft.chunks.is_empty()).then(|| script(&name, &folder, draft, request))
    }

    /// Writes a submission and passes it to the engine.
    ///
    /// **Errors**: a file cannot be written; the engine rejects the array, which leaves no submission; or
    /// it is unknown whether the engine accepted the array.
    pub fn launch(
        &self,
        draft: &SubmissionDraft,
        request: Request<'_>,
    ) -> Result<Submission, ClusterError> {
        let submission = self.write(draft, request)?;
        let script = submission.path().join("script.sh");
        match self.hand_over(&submission, &script) {
            Ok(array) => {
                submission.record_array(&array)?;
                Ok(submission)
            }
            Err(error @ ClusterError::Uncertain { .. }) => Err(error),
            Err(error) => {
                // A rejected array leaves no submission.
                let _ = fs::remove_dir_all(submission.path());
                Err(error)
            }
        }
    }

    /// Writes all files of a submission, the intent last.
    fn write(
        &self,
        draft: &SubmissionDraft,
        request: Request<'_>,
    ) -> Result<Submission, ClusterError> {
        let name = clock::new_name();
        let path = self.submissions.folder(&name);
        Submission::make_folders(&path)?;
        let write = |file: &Path, text: &str| {
            fs::write(file, text).map_err(ClusterError::io("write", file))
        };
        let manifests = request.selection.manifests();
        for (index, manifest) in manifests.iter().enumerate() {
            // Tasks do not depend on files that can change meanwhile.
            let text = manifest::self_contained(manifest).map_err(ClusterError::Companion)?;
            write(&plan_file(&path, index + 1), &text)?;
        }
        for (number, chunk) in draft.chunks.iter().enumerate() {
            let text: String = chunk.keys.iter().map(|key| format!("{key}\n")).collect();
            write(&chunk_file(&path, number as u32), &text)?;
        }
        write(&path.join("script.sh"), &script(&name, &path, draft, request))?;
        Submission::intend(&path, intent(draft, request.profile, manifests))
    }

    /// Passes an array to the engine; if that fails, finds out whether it was accepted.
    fn hand_over(&self, submission: &Submission, script: &Path) -> Result<String, ClusterError> {
        let name = submission.array_name();
        let engine = (self.connect)(submission.intent.engine);
        let begun = Instant::now();
        let mut refused = false;
        loop {
            let error = match engine.submit(script) {
                Ok(array) => return Ok(array),
                Err(error @ EngineError::Missing { .. }) => return Err(error.into()),
                Err(error) => error,
            };
            let alive = loop {
                match engine.alive(&[&name]) {
                    Ok(alive) => break alive,
                    Err(reason) if begun.elapsed() >= PATIENCE => {
                        return Err(ClusterError::Uncertain { name, reason });
                    }
                    Err(_) => thread::sleep(ASK_AGAIN),
                }
            };
            match alive.into_iter().find(|task| task.name == name) {
                Some(task) => return Ok(task.array),
                // Only the second rejection counts, because the engine may have been down for a
                // moment at the first.
                None if refused || begun.elapsed() >= PATIENCE => return Err(error.into()),
                None => refused = true,
            }
        }
    }

    /// Cancels the tasks of a submission that the engine holds. They hand in their completed runs.
    ///
    /// **Errors**: the mark cannot be written; the engine fails or does not answer.
    pub fn cancel(&self, submission: &Submission) -> Result<(), ClusterError> {
        // The mark is written before the engine is called, so that tasks that start meanwhile see it.
        submission.stop(Stop::Cancelled)?;
        let name = submission.array_name();
        let engine = (self.connect)(submission.intent.engine);
        let alive = engine.alive(&[&name])?;
        let arrays: HashSet<&String> =
            alive.iter().filter(|task| task.name == name).map(|task| &task.array).collect();
        for array in arrays {
            engine.cancel(array)?;
        }
        Ok(())
    }
}

/// Records the engine's id of an array that it holds.
fn record_found(submission: &Submission, alive: &[Alive]) -> Result<(), ClusterError> {
    let name = submission.array_name();
    match alive.iter().find(|task| task.name == name) {
        Some(task) if submission.array().is_none() => submission.record_array(&task.array),
        _ => Ok(()),
    }
}

fn script(name: &str, folder: &Path, draft: &SubmissionDraft, request: Request<'_>) -> String {
    let chunks = draft.chunks.len() as u32;
    request.profile.script(&array_name(name), chunks, folder, request.program)
}

/// The absolute path of a manifest's folder. It is absolute because tasks start in another folder.
fn folder_of(manifest: &Manifest) -> String {
    let folder = manifest.folder();
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    folder.canonicalize().unwrap_or_else(|_| folder.to_owned()).display().to_string()
}

fn intent(draft: &SubmissionDraft, profile: &Profile, manifests: &[Manifest]) -> Intent {
    let made_by = schedule::of_this_process();
    Intent {
        format: Intent::format(),
        code_version: format!("{} ({})", made_by.code_version, made_by.git_revision),
        engine: profile.engine,
        created_at: clock::now(),
        chunks: draft.chunks.len() as u32,
        jobs: draft.jobs() as u64,
        cpus_per_task: profile.tasks.cpus_per_task,
        hand_in_seconds: profile.tasks.hand_in_minutes * 60.0,
        experiments: manifests.iter().map(|manifest| manifest.name.clone()).collect(),
        folders: manifests.iter().map(folder_of).collect(),
    }
}
