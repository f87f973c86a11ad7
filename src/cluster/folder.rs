//! The folder of a submission: the path of each file, and atomic writes.
//!
//! ```text
//! jitai.sqlite.submissions/
//!   20260131-120000-1a2b3c/    one submission
//!     submission.json          the intent; written last, before the engine is called
//!     plan/1.toml ...          frozen copies of the manifests
//!     chunks/0 ...             keys of the jobs of each task, the longest first
//!     script.sh                the script given to the engine
//!     array                    the engine's id of the array, once it is known
//!     logs/0.log ...           output of all attempts of each task
//!     attempts/0.17.0-1a2b3c4d.json ... the record of each attempt
//!     parts/0.17.0-1a2b3c4d-1.sqlite    sealed stores; beside each, the list of its jobs (.jobs)
//!     checkpoints/             checkpoints of stopped jobs
//!     curves/                  learning curves of running jobs
//!     cancelled or abandoned   a mark: its tasks must not run
//! ```
//!
//! Files are written under a temporary name, synced and renamed. A sealed part never changes.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::attempt::TaskAttempt;
use super::clock::random;
use super::engines::EngineKind;
use super::error::ClusterError;
use crate::job::JobKey;
use crate::schedule::CheckpointFolder;
use crate::store::{StoreError, beside, resolve};

/// Version of the files of a submission; other versions are rejected.
const FORMAT: u32 = 1;

/// Prefix of the names of arrays.
const PREFIX: &str = "jitai-";

/// The intent of a submission: what it submits, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intent {
    /// Version of the files.
    pub format: u32,
    /// Release and revision of jitai that made the submission.
    pub code_version: String,
    /// The engine.
    pub engine: EngineKind,
    /// Time of the submission, in seconds since 1970.
    pub created_at: f64,
    /// Number of chunks.
    pub chunks: u32,
    /// Number of jobs.
    pub jobs: u64,
    /// Number of workers per task.
    pub cpus_per_task: u32,
    /// Maximum time between two hand-ins of a task, in seconds.
    pub hand_in_seconds: f64,
    /// Names of the experiments, one per manifest.
    pub experiments: Vec<String>,
    /// The folders of the manifests, in which outside programs start. Empty for submissions of earlier
    /// releases, which have no outside programs.
    #[serde(default)]
    pub folders: Vec<String>,
}

impl Intent {
    /// The version of the files that this program writes.
    pub fn format() -> u32 {
        FORMAT
    }
}

/// How a handed-in job ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandedIn {
    /// The job has results.
    Completed,
    /// The job failed.
    Failed,
}

/// Why the tasks of a submission must not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// It was cancelled.
    Cancelled,
    /// Its array was not found, and its jobs were submitted again.
    Abandoned,
}

impl Stop {
    fn file(self) -> &'static str {
        match self {
            Stop::Cancelled => "cancelled",
            Stop::Abandoned => "abandoned",
        }
    }
}

/// The folder of all submissions of a store.
#[derive(Clone, Debug)]
pub struct Submissions {
    path: PathBuf,
}

impl Submissions {
    /// The folder beside a store. The folder and the store may not exist yet.
    ///
    /// **Errors**: the path of the store cannot be resolved.
    pub fn beside(store: &Path) -> Result<Submissions, StoreError> {
        Ok(Submissions { path: beside(&resolve(store)?, ".submissions") })
    }

    /// Creates the folder: beside the store, or in `elsewhere` with a symbolic link beside the store.
    ///
    /// **Errors**: the link leads to a missing folder, or the folder cannot be created.
    pub fn make(&self, elsewhere: Option<&Path>) -> Result<(), ClusterError> {
        require_target(&self.path)?;
        if let Some(elsewhere) = elsewhere
            && fs::symlink_metadata(&self.path).is_err()
        {
            let name = self.path.file_name().expect("it ends in .submissions");
            let target = elsewhere.join(name);
            fs::create_dir_all(&target).map_err(ClusterError::io("create", &target))?;
            std::os::unix::fs::symlink(&target, &self.path)
                .map_err(ClusterError::io("link", &self.path))?;
        }
        fs::create_dir_all(&self.path).map_err(ClusterError::io("create", &self.path))
    }

    /// The path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Locks submitting for this store; waits while another process holds the lock. Closing the file
    /// releases the lock.
    pub fn lock(&self) -> Result<File, ClusterError> {
        let path = self.path.join("lock");
        let file = File::create(&path).map_err(ClusterError::io("create", &path))?;
        match file.lock() {
            // Some shared file systems do not support locks.
            Err(error) if error.kind() != ErrorKind::Unsupported => {
                Err(ClusterError::io("lock", &path)(error))
            }
            _ => Ok(file),
        }
    }

    /// All submissions that have an intent, the earliest first.
    ///
    /// **Errors**: a submission cannot be read, or a link leads to a missing folder. Jobs that it may hold
    /// would otherwise be submitted again.
    pub fn list(&self) -> Result<Vec<Submission>, ClusterError> {
        require_target(&self.path)?;
        let mut found = Vec::new();
        for name in names(&self.path)? {
            let path = self.path.join(&name);
            require_target(&path)?;
            if path.join("submission.json").is_file() {
                found.push(Submission::open(&path)?);
            }
        }
        found.sort_by(|one, other| {
            let order = one.intent.created_at.total_cmp(&other.intent.created_at);
            order.then_with(|| one.name().cmp(other.name()))
        });
        Ok(found)
    }

    /// The submission with this name.
    pub fn named(&self, name: &str) -> Result<Submission, ClusterError> {
        let name = name.strip_prefix(PREFIX).unwrap_or(name);
        self.list()?.into_iter().find(|submission| submission.name() == name).ok_or_else(|| {
            ClusterError::NoSuchSubmission { name: name.to_owned(), folder: self.path.clone() }
        })
    }

    /// The path for a new submission with this name.
    pub fn folder(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }
}

/// One submission, as read from its folder.
#[derive(Clone, Debug)]
pub struct Submission {
    path: PathBuf,
    /// The intent of the submission.
    pub intent: Intent,
}

/// The subfolders of a submission.
const SUBFOLDERS: [&str; 6] = ["plan", "chunks", "logs", "attempts", "parts", "checkpoints"];

impl Submission {
    /// The submission at a path.
    pub fn open(path: &Path) -> Result<Submission, ClusterError> {
        let file = path.join("submission.json");
        let text = fs::read(&file).map_err(ClusterError::io("read", &file))?;
        let damaged = |reason: String| ClusterError::Damaged { path: file.clone(), reason };
        let intent: Intent = serde_json::from_slice(&text).map_err(|e| damaged(e.to_string()))?;
        if intent.format != FORMAT {
            let found = intent.format;
            return Err(damaged(format!("its format is {found}, but this release reads {FORMAT}")));
        }
        Ok(Submission { path: path.to_owned(), intent })
    }

    /// Creates the empty folders of a submission that has no intent yet.
    pub fn make_folders(path: &Path) -> Result<(), ClusterError> {
        for folder in SUBFOLDERS {
            let folder = path.join(folder);
            fs::create_dir_all(&folder).map_err(ClusterError::io("create", &folder))?;
        }
        Ok(())
    }

    /// Writes the intent, which makes the folder a submission.
    pub fn intend(path: &Path, intent: Intent) -> Result<Submission, ClusterError> {
        let file = path.join("submission.json");
        let mut text = serde_json::to_string_pretty(&intent).expect("it has only plain fields");
        text.push('\n');
        write_whole(&file, text.as_bytes()).map_err(ClusterError::io("write", &file))?;
        Ok(Submission { path: path.to_owned(), intent })
    }

    /// The path of the submission's folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The name of the submission, which is the name of its folder.
    pub fn name(&self) -> &str {
        self.path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
    }

    /// The name of the job array.
    pub fn array_name(&self) -> String {
        array_name(self.name())
    }

    /// The engine's id of the job array, once known.
    pub fn array(&self) -> Option<String> {
        let text = fs::read_to_string(self.path.join("array")).ok()?;
        Some(text.trim().to_owned()).filter(|id| !id.is_empty())
    }

    /// Records the engine's id of the job array.
    pub fn record_array(&self, array: &str) -> Result<(), ClusterError> {
        let file = self.path.join("array");
        write_whole(&file, format!("{array}\n").as_bytes())
            .map_err(ClusterError::io("write", &file))
    }

    /// Why the submission was stopped, if it was.
    pub fn stopped(&self) -> Option<Stop> {
        let is_there = |stop: &Stop| self.path.join(stop.file()).exists();
        [Stop::Cancelled, Stop::Abandoned].into_iter().find(is_there)
    }

    /// Stops the submission: its tasks end as soon as they start.
    pub fn stop(&self, stop: Stop) -> Result<(), ClusterError> {
        let file = self.path.join(stop.file());
        write_whole(&file, b"").map_err(ClusterError::io("write", &file))
    }

    /// The frozen manifests.
    pub fn manifests(&self) -> Vec<PathBuf> {
        (1..=self.intent.experiments.len()).map(|n| plan_file(&self.path, n)).collect()
    }

    /// The keys of a chunk's jobs.
    pub fn chunk(&self, chunk: u32) -> Result<Vec<JobKey>, ClusterError> {
        let file = chunk_file(&self.path, chunk);
        let text = fs::read_to_string(&file).map_err(ClusterError::io("read", &file))?;
        let key = |line: &str| {
            parse_key(line).ok_or_else(|| ClusterError::Damaged {
                path: file.clone(),
                reason: format!("{line:?} is not the key of a job"),
            })
        };
        text.lines().map(key).collect()
    }

    /// The log of a chunk's task.
    pub fn log(&self, chunk: u32) -> PathBuf {
        self.path.join("logs").join(format!("{chunk}.log"))
    }

    /// The recorded attempts at all chunks, by chunk, the earliest first.
    pub fn attempts(&self) -> Result<HashMap<u32, Vec<TaskAttempt>>, ClusterError> {
        let folder = self.path.join("attempts");
        let mut attempts: HashMap<u32, Vec<TaskAttempt>> = HashMap::new();
        for name in names(&folder)?.iter().filter(|name| name.ends_with(".json")) {
            let file = folder.join(name);
            let text = fs::read(&file).map_err(ClusterError::io("read", &file))?;
            let attempt: TaskAttempt = serde_json::from_slice(&text).map_err(|error| {
                ClusterError::Damaged { path: file.clone(), reason: error.to_string() }
            })?;
            attempts.entry(attempt.chunk).or_default().push(attempt);
        }
        for of_chunk in attempts.values_mut() {
            of_chunk.sort_by(|one, other| one.started_at.total_cmp(&other.started_at));
        }
        Ok(attempts)
    }

    /// Writes the record of an attempt.
    pub fn record_attempt(&self, attempt: &TaskAttempt) -> io::Result<()> {
        let name = format!("{}.{}.json", attempt.chunk, attempt.attempt);
        let text = serde_json::to_vec(attempt).expect("it has only plain fields");
        write_whole(&self.path.join("attempts").join(name), &text)
    }

    /// The sealed parts.
    pub fn parts(&self) -> Result<Vec<Part>, ClusterError> {
        let folder = self.path.join("parts");
        let mut parts = Vec::new();
        for name in names(&folder)? {
            let Some(stem) = name.strip_suffix(".sqlite") else { continue };
            let chunk = stem.split('.').next().and_then(|chunk| chunk.parse().ok());
            parts.push(Part {
                chunk,
                path: folder.join(&name),
                jobs: folder.join(format!("{stem}.jobs")),
            });
        }
        parts.sort_by(|one, other| one.path.cmp(&other.path));
        Ok(parts)
    }

    /// Hands in a sealed store. The list of its jobs is written first, so that every part has one.
    pub fn hand_in(
        &self,
        stem: &str,
        store: &Path,
        jobs: &[(JobKey, HandedIn)],
    ) -> io::Result<PathBuf> {
        let folder = self.path.join("parts");
        let list: String = jobs
            .iter()
            .map(|(key, how)| match how {
                HandedIn::Completed => format!("{key} completed\n"),
                HandedIn::Failed => format!("{key} failed\n"),
            })
            .collect();
        write_whole(&folder.join(format!("{stem}.jobs")), list.as_bytes())?;
        let part = folder.join(format!("{stem}.sqlite"));
        let mut source = File::open(store)?;
        whole(&part, |file| {
            io::copy(&mut source, file)?;
            // A part never changes, and the store code reads a read-only file without a lock.
            let mut permissions = file.metadata()?.permissions();
            permissions.set_readonly(true);
            file.set_permissions(permissions)
        })?;
        Ok(part)
    }

    /// The path at which the checkpoint of a job is handed in.
    pub fn checkpoint(&self, key: &JobKey) -> PathBuf {
        self.path.join("checkpoints").join(format!("{key}.checkpoint"))
    }

    /// The folder of the learning curves of running jobs.
    pub fn curves(&self) -> CheckpointFolder {
        CheckpointFolder::at(self.path.join("curves"))
    }
}

/// A sealed part.
#[derive(Clone, Debug)]
pub struct Part {
    /// Number of its chunk, if the file name contains one.
    pub chunk: Option<u32>,
    /// The store.
    pub path: PathBuf,
    jobs: PathBuf,
}

impl Part {
    /// The jobs of the part and how they ended; `None` if there is no list.
    pub fn jobs(&self) -> Option<Vec<(JobKey, HandedIn)>> {
        let text = fs::read_to_string(&self.jobs).ok()?;
        let job = |line: &str| {
            let (key, how) = line.split_once(' ')?;
            let how = match how {
                "completed" => HandedIn::Completed,
                "failed" => HandedIn::Failed,
                _ => return None,
            };
            Some((parse_key(key)?, how))
        };
        text.lines().map(job).collect()
    }
}

/// The name of a submission's array.
pub fn array_name(submission: &str) -> String {
    format!("{PREFIX}{submission}")
}

/// The file with the keys of a chunk's jobs.
pub fn chunk_file(submission: &Path, chunk: u32) -> PathBuf {
    submission.join("chunks").join(chunk.to_string())
}

/// The file of a frozen manifest; `number` counts from 1.
pub fn plan_file(submission: &Path, number: usize) -> PathBuf {
    submission.join("plan").join(format!("{number}.toml"))
}

fn parse_key(text: &str) -> Option<JobKey> {
    let is_key = text.len() == 32 && text.bytes().all(|b| b.is_ascii_hexdigit());
    is_key.then(|| u128::from_str_radix(text, 16).ok()).flatten().map(|n| JobKey(n.to_be_bytes()))
}

/// Fails if the path is a link to a missing file or folder.
fn require_target(path: &Path) -> Result<(), ClusterError> {
    match path.is_symlink() {
        true => fs::metadata(path).map(drop).map_err(ClusterError::io("follow the link", path)),
        false => Ok(()),
    }
}

/// Names of the files in a folder, sorted, without unfinished files.
fn names(folder: &Path) -> Result<Vec<String>, ClusterError> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(ClusterError::io("list", folder))?,
    };
    let mut names = Vec::new();
    for entry in entries {
        let name = entry.map_err(ClusterError::io("list", folder))?.file_name();
        if let Some(name) = name.to_str().filter(|name| !name.starts_with('.')) {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}

/// Writes a file atomically: the file is complete or absent, and synced to the disk on return.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    whole(path, |file| file.write_all(bytes))
}

/// Copies a file atomically, as [`write_whole`] writes one.
pub fn copy_whole(from: &Path, to: &Path) -> io::Result<()> {
    let mut source = File::open(from)?;
    whole(to, |file| io::copy(&mut source, file).map(drop))
}

fn whole(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let folder = path.parent().expect("a file is in a folder");
    let name = path.file_name().and_then(|name| name.to_str()).expect("names are text here");
    // The temporary name is random because two machines may write the same file at the same time.
    let unfinished = folder.join(format!(".{name}.{:08x}", random() as u32));
    let written = File::create(&unfinished).and_then(|mut file| {
        write(&mut file)?;
        file.sync_all()?;
        fs::rename(&unfinished, path)?;
        File::open(folder)?.sync_all()
    });
    if written.is_err() {
        // If the removal fails as well, the file stays under a temporary name, which is never read.
        let _ = fs::remove_file(&unfinished);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_cannot_be_written_leaves_the_one_before_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_whole(&path, b"one").unwrap();
        whole(&path, |_| Err(ErrorKind::StorageFull.into())).unwrap_err();
        assert_eq!(fs::read(&path).unwrap(), b"one");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn submissions_lie_beside_the_file_of_the_store_and_not_beside_a_link() {
        let outer = tempfile::tempdir().unwrap();
        let root = outer.path().canonicalize().unwrap();
        std::os::unix::fs::symlink("later.sqlite", root.join("link.sqlite")).unwrap();
        let expected = root.join("later.sqlite.submissions");
        for store in ["link.sqlite", "later.sqlite"] {
            assert_eq!(Submissions::beside(&root.join(store)).unwrap().path(), expected);
        }
    }

    #[test]
    fn a_link_to_a_missing_folder_is_not_an_empty_folder() {
        let outer = tempfile::tempdir().unwrap();
        let store = outer.path().join("s.sqlite");
        std::os::unix::fs::symlink("/gone", outer.path().join("s.sqlite.submissions")).unwrap();
        let submissions = Submissions::beside(&store).unwrap();
        for error in [submissions.list().unwrap_err(), submissions.make(None).unwrap_err()] {
            let error = error.to_string();
            assert!(error.starts_with("failed to follow the link `"), "{error}");
        }
    }

    #[test]
    fn a_submission_without_an_intent_is_none() {
        let outer = tempfile::tempdir().unwrap();
        let submissions = Submissions::beside(&outer.path().join("s.sqlite")).unwrap();
        assert!(submissions.list().unwrap().is_empty());
        submissions.make(None).unwrap();
        Submission::make_folders(&submissions.folder("20260131-120000-000000")).unwrap();
        assert!(submissions.list().unwrap().is_empty());
    }
}
