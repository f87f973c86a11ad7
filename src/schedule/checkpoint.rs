//! The folder of checkpoints, and the times when they are due.
//!
//! Checkpoints are kept in the folder `<store>.checkpoints` beside the store, one file per run:
//! `<job key>.<attempt>.checkpoint`. Their content belongs to training.
//!
//! - No two runs share a file. A process that has lost its claim without noticing cannot overwrite or remove
//!   the checkpoint of a later run.
//! - The curve of a running job (`curve.rs`) lies in the same folder, as `<job key>.<attempt>.curve`.
//! - A checkpoint is written under another name, synced and renamed, so it is complete or absent.
//! - The files of a job are removed only after its completed or failed run is stored.
//! - If a checkpoint cannot be read or written, the job loses time but the training continues.

use std::cell::Cell;
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::job::JobKey;
use crate::kill_point::{self, KillPoint};
use crate::store::{self, CHECKPOINTS, JobState, Reader, StoreError, beside, resolve};
use crate::train::{CheckpointError, Checkpoints, ReadCheckpoint, Resumed, WriteCheckpoint};

/// The minimum time between two checkpoints, as a multiple of the time that writing one takes. The resulting
/// time is at most [`MOST_BETWEEN`].
const COSTS_BETWEEN: u32 = 100;
/// Longest time between two checkpoints that are slow to write. Including the time of writing, a
/// killed process loses at most 30 seconds.
const MOST_BETWEEN: Duration = Duration::from_secs(25);

/// Time from the start of an attempt to its first checkpoint if the process of the attempt before was killed.
/// Each further death without a checkpoint halves it, and each checkpoint doubles the time to the next one, up
/// to the usual time. A job therefore gets further even if its process is killed every few seconds.
const FIRST_AFTER_DEATH: Duration = Duration::from_secs(1);
/// The number of times that [`FIRST_AFTER_DEATH`] is halved at most.
const MOST_HALVINGS: u32 = 4;

/// An attempt at a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RunAttempt {
    /// Its number, from 1.
    pub(super) number: u32,
    /// See [`Claim::deaths`](crate::store::Claim::deaths).
    pub(super) deaths: u32,
}

/// The folder of a store's checkpoints.
#[derive(Clone, Debug)]
pub struct CheckpointFolder {
    path: PathBuf,
}

/// What happened to a checkpoint.
#[derive(Debug)]
pub enum CheckpointNote {
    /// A job resumed from it.
    Resumed(Resumed),
    /// The checkpoint was rejected; the job resumes from another checkpoint or starts from the beginning.
    Refused {
        /// The checkpoint's file.
        path: PathBuf,
        /// The reason.
        reason: CheckpointError,
    },
    /// The checkpoint could not be written; the training continues. This is reported once per run.
    NotKept {
        /// The checkpoint's file.
        path: PathBuf,
        /// The error of the system.
        reason: io::Error,
    },
}

/// A file of the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FolderEntry {
    pub(super) key: JobKey,
    pub(super) attempt: u32,
    pub(super) form: FileForm,
}

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileForm {
    /// A checkpoint.
    Whole,
    /// The file is being written, or a process was killed while writing it.
    Unfinished,
    /// The learning curve of a running job.
    Curve,
}

impl FolderEntry {
    fn name(&self) -> String {
        let FolderEntry { key, attempt, form } = self;
        let form = match form {
            FileForm::Whole => "checkpoint",
            FileForm::Unfinished => "unfinished",
            FileForm::Curve => "curve",
        };
        store::checkpoint_name(&key.to_string(), *attempt, form)
    }

    /// The entry with this file name; `None` for other files.
    fn parse(name: &str) -> Option<FolderEntry> {
        let mut parts = name.split('.');
        let key = u128::from_str_radix(parts.next()?, 16).ok()?;
        let attempt = parts.next()?.parse().ok()?;
        let form = match parts.next()? {
            "checkpoint" => FileForm::Whole,
            "unfinished" => FileForm::Unfinished,
            "curve" => FileForm::Curve,
            _ => return None,
        };
        let entry = FolderEntry { key: JobKey(key.to_be_bytes()), attempt, form };
        (entry.name() == name).then_some(entry)
    }
}

impl CheckpointFolder {
    /// The folder beside a store, whose path is resolved. The folder need not exist.
    pub fn beside(store: &Path) -> Self {
        let path = beside(store, CHECKPOINTS);
        // A link may lead to a folder that does not exist yet. If it leads nowhere, writing reports it.
        CheckpointFolder { path: resolve(&path).unwrap_or(path) }
    }

    /// The folder at this path.
    pub fn at(path: PathBuf) -> Self {
        CheckpointFolder { path }
    }

    /// Removes files that no run needs: checkpoints of completed or failed jobs, and unfinished files and
    /// curves of killed processes.
    ///
    /// **Errors**: the store cannot be read.
    pub fn clear(&self, reader: &Reader) -> Result<(), StoreError> {
        let entries = self.entries();
        let states = reader.job_states(entries.iter().map(|entry| &entry.key))?;
        for (entry, state) in entries.iter().zip(states) {
            let over = match state {
                JobState::Completed | JobState::Failed => true,
                JobState::Pending | JobState::Interrupted => entry.form != FileForm::Whole,
                JobState::Running => false,
            };
            if over {
                self.remove(entry);
            }
        }
        self.remove_if_empty();
        Ok(())
    }

    /// The latest complete checkpoint of each job.
    pub fn latest(&self) -> Vec<(JobKey, PathBuf)> {
        self.latest_of(FileForm::Whole)
    }

    fn latest_of(&self, form: FileForm) -> Vec<(JobKey, PathBuf)> {
        let mut latest: HashMap<JobKey, FolderEntry> = HashMap::new();
        for entry in self.entries().into_iter().filter(|entry| entry.form == form) {
            match latest.get(&entry.key) {
                Some(other) if other.attempt > entry.attempt => {}
                _ => drop(latest.insert(entry.key, entry)),
            }
        }
        latest.into_iter().map(|(key, entry)| (key, self.file(&entry))).collect()
    }

    /// The curves of running jobs, of the latest attempt at each. Curves of killed processes may be among them.
    pub fn curves(&self) -> Vec<(JobKey, PathBuf)> {
        self.latest_of(FileForm::Curve)
    }

    /// Removes the curves of jobs whose processes are known to be dead.
    pub fn forget_curves(&self, is_dead: impl Fn(&JobKey) -> bool) {
        self.remove_where(|entry| entry.form == FileForm::Curve && is_dead(&entry.key));
    }

    /// Copies a job's checkpoint from another store, for the job's next run.
    ///
    /// **Errors**: the checkpoint cannot be copied.
    pub fn adopt(&self, key: &JobKey, checkpoint: &Path) -> io::Result<()> {
        // Attempts count from 1, so every checkpoint of this store is later.
        let entry = FolderEntry { key: *key, attempt: 0, form: FileForm::Whole };
        self.write(&entry, &mut |out| io::copy(&mut File::open(checkpoint)?, out).map(drop))
    }

    /// Removes the files of a job's runs up to an attempt.
    pub(super) fn forget(&self, key: &JobKey, attempt: u32) {
        self.remove_where(|entry| entry.key == *key && entry.attempt <= attempt);
        self.remove_if_empty();
    }

    /// Removes the files of one run.
    pub(super) fn forget_run(&self, key: &JobKey, attempt: u32) {
        self.remove_where(|entry| entry.key == *key && entry.attempt == attempt);
        self.remove_if_empty();
    }

    fn remove_where(&self, is_meant: impl Fn(&FolderEntry) -> bool) {
        self.entries().iter().filter(|entry| is_meant(entry)).for_each(|entry| self.remove(entry));
    }

    /// The files of the folder; empty if the folder cannot be read, which the next write reports.
    fn entries(&self) -> Vec<FolderEntry> {
        let Ok(files) = fs::read_dir(&self.path) else { return Vec::new() };
        let names = files.flatten().map(|file| file.file_name());
        names.filter_map(|name| FolderEntry::parse(name.to_str()?)).collect()
    }

    fn file(&self, entry: &FolderEntry) -> PathBuf {
        self.path.join(entry.name())
    }

    pub(super) fn remove(&self, entry: &FolderEntry) {
        // Another process may already have removed the file; the next clearing removes a file that remains.
        let _ = fs::remove_file(self.file(entry));
    }

    pub(super) fn remove_if_empty(&self) {
        let _ = fs::remove_dir(&self.path);
    }

    /// Writes a file completely, or leaves the previous file unchanged.
    fn write(&self, entry: &FolderEntry, write: &mut WriteCheckpoint<'_>) -> io::Result<()> {
        let unfinished = FolderEntry { form: FileForm::Unfinished, ..entry.clone() };
        let written = self.create(&unfinished).and_then(|mut file| {
            write(&mut file)?;
            file.sync_all()?;
            kill_point::pass(KillPoint::CheckpointWritten);
            fs::rename(self.file(&unfinished), self.file(entry))?;
            kill_point::pass(KillPoint::CheckpointRenamed);
            File::open(&self.path)?.sync_all()
        });
        if written.is_err() {
            self.remove(&unfinished);
        }
        written
    }

    /// Creates a file in the place of a file that another process may still be writing.
    pub(super) fn create_anew(&self, entry: &FolderEntry) -> io::Result<File> {
        self.remove(entry);
        self.create(entry)
    }

    fn create(&self, entry: &FolderEntry) -> io::Result<File> {
        fs::create_dir_all(&self.path)?;
        match File::create(self.file(entry)) {
            // Another process found the folder empty and removed it.
            Err(error) if error.kind() == ErrorKind::NotFound => {
                fs::create_dir_all(&self.path)?;
                File::create(self.file(entry))
            }
            created => created,
        }
    }
}

/// The longest time between two readings of the clock that counts as working time. If more time passes, the
/// process was suspended.
const MOST_UNSEEN: Duration = Duration::from_secs(1);

/// Returns the working time since `last`, and sets `last` to now.
fn worked_since(last: &mut Instant) -> Duration {
    let now = Instant::now();
    now.duration_since(mem::replace(last, now)).min(MOST_UNSEEN)
}

/// Measures the working time of a job; its clock must be read regularly.
#[derive(Debug)]
pub(super) struct Stopwatch(Mutex<(Duration, Instant)>);

impl Default for Stopwatch {
    fn default() -> Self {
        Stopwatch(Mutex::new((Duration::ZERO, Instant::now())))
    }
}

impl Stopwatch {
    /// Restarts at zero.
    pub(super) fn restart(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (Duration::ZERO, Instant::now());
    }

    /// Reads the clock and returns the working time so far.
    pub(super) fn look(&self) -> Duration {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (worked, last) = &mut *state;
        *worked += worked_since(last);
        *worked
    }
}

/// An alarm after a given working time, which goes off when the clock is read: for due checkpoints and for
/// jobs that exceed their time limit.
#[derive(Debug, Default)]
pub(super) struct Alarm {
    /// The time left, and the time of the last update.
    left: Mutex<Option<(Duration, Instant)>>,
    rings: AtomicBool,
}

impl Alarm {
    /// Sets the alarm to ring after this time.
    pub(super) fn set(&self, after: Duration) {
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        *left = Some((after, Instant::now()));
        self.rings.store(false, Ordering::Relaxed);
    }

    pub(super) fn rings(&self) -> bool {
        self.rings.load(Ordering::Relaxed)
    }

    /// Reads the clock, and sets off the alarm if its time is up.
    pub(super) fn look(&self) {
        let mut state = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((left, last)) = &mut *state else { return };
        *left = left.saturating_sub(worked_since(last));
        if left.is_zero() {
            *state = None;
            self.rings.store(true, Ordering::Relaxed);
        }
    }
}

/// The keeper of one run's checkpoints.
pub(super) struct Keeper<'a> {
    folder: &'a CheckpointFolder,
    entry: FolderEntry,
    alarm: &'a Alarm,
    every: Duration,
    /// The time from the start or the latest checkpoint to the next one; `None` for the usual time.
    soon: Cell<Option<Duration>>,
    report: &'a dyn Fn(CheckpointNote),
    before: Cell<Duration>,
    complained: Cell<bool>,
}

impl<'a> Keeper<'a> {
    /// The keeper of a run that starts now. `every` is the time between two checkpoints; `report` receives
    /// their events.
    pub(super) fn new(
        folder: &'a CheckpointFolder,
        (key, attempt): (JobKey, RunAttempt),
        (alarm, every): (&'a Alarm, Duration),
        report: &'a dyn Fn(CheckpointNote),
    ) -> Self {
        let halvings = attempt.deaths.checked_sub(1).map(|halvings| halvings.min(MOST_HALVINGS));
        let soon = halvings.map(|halvings| every.min(FIRST_AFTER_DEATH / 2_u32.pow(halvings)));
        alarm.set(soon.unwrap_or(every));
        let entry = FolderEntry { key, attempt: attempt.number, form: FileForm::Whole };
        let (before, complained) = (Cell::new(Duration::ZERO), Cell::new(false));
        Keeper { folder, entry, alarm, every, soon: Cell::new(soon), report, before, complained }
    }

    /// The working time of the earlier runs that this run resumed from.
    pub(super) fn before(&self) -> Duration {
        self.before.get()
    }

    /// The checkpoints of earlier runs, latest first.
    fn earlier(&self) -> Vec<FolderEntry> {
        let mut earlier = self.folder.entries();
        earlier.retain(|entry| entry.key == self.entry.key && entry.form == FileForm::Whole);
        earlier.sort_unstable_by_key(|entry| std::cmp::Reverse(entry.attempt));
        earlier
    }
}

impl Checkpoints for Keeper<'_> {
    fn are_due(&self) -> bool {
        self.alarm.rings()
    }

    fn resume(&self, read: &mut ReadCheckpoint<'_>) {
        for entry in self.earlier() {
            let path = self.folder.file(&entry);
            match open(&path).and_then(|mut file| read(&mut file)) {
                Ok(resumed) => {
                    self.before.set(resumed.worked);
                    (self.report)(CheckpointNote::Resumed(resumed));
                    return;
                }
                Err(reason) => (self.report)(CheckpointNote::Refused { path, reason }),
            }
        }
    }

    fn keep(&self, write: &mut WriteCheckpoint<'_>) {
        let begun = Instant::now();
        let FolderEntry { key, attempt, .. } = &self.entry;
        match self.folder.write(&self.entry, write) {
            Ok(()) => self.folder.remove_where(|e| e.key == *key && e.attempt < *attempt),
            Err(reason) => {
                if !self.complained.replace(true) {
                    let path = self.folder.file(&self.entry);
                    (self.report)(CheckpointNote::NotKept { path, reason });
                }
            }
        }
        let usual = self.every.max(MOST_BETWEEN.min(COSTS_BETWEEN * begun.elapsed()));
        self.soon.set(self.soon.get().map(|last| 2 * last).filter(|next| *next < usual));
        self.alarm.set(self.soon.get().unwrap_or(usual));
    }
}

/// Opens the file of a checkpoint. Opens only regular files, because a pipe would block.
fn open(path: &Path) -> Result<File, CheckpointError> {
    match fs::metadata(path)?.is_file() {
        true => Ok(File::open(path)?),
        false => Err(CheckpointError::Damaged),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> (tempfile::TempDir, CheckpointFolder) {
        let root = tempfile::tempdir().unwrap();
        let folder = CheckpointFolder::beside(&root.path().join("jitai.sqlite"));
        (root, folder)
    }

    fn entry(key: u8, attempt: u32) -> FolderEntry {
        FolderEntry { key: JobKey([key; 16]), attempt, form: FileForm::Whole }
    }

    fn attempt(number: u32, deaths: u32) -> RunAttempt {
        RunAttempt { number, deaths }
    }

    fn write(folder: &CheckpointFolder, entry: &FolderEntry) {
        folder.write(entry, &mut |out| out.write_all(b"state")).unwrap();
    }

    fn names(folder: &CheckpointFolder) -> Vec<String> {
        let mut names: Vec<String> = folder.entries().iter().map(FolderEntry::name).collect();
        names.sort_unstable();
        names
    }

    #[test]
    fn names_say_job_and_attempt_and_those_of_others_are_left_alone() {
        let unfinished = FolderEntry { form: FileForm::Unfinished, ..entry(0, 4_000_000_000) };
        for entry in [entry(0xab, 1), entry(1, 27), unfinished] {
            assert_eq!(FolderEntry::parse(&entry.name()), Some(entry));
        }
        let key = "ab".repeat(16);
        for name in ["", "notes.txt", &key, &format!("{key}.1"), &format!("{key}.01.checkpoint")] {
            assert_eq!(FolderEntry::parse(name), None, "{name}");
        }
        for name in [format!("{key}.1.checkpoint.bak"), format!("{key}.-1.checkpoint")] {
            assert_eq!(FolderEntry::parse(&name), None, "{name}");
        }
    }

    #[test]
    fn runs_remove_their_own_files_and_earlier_ones_and_the_last_removes_the_folder() {
        let (_root, folder) = folder();
        for entry in [entry(1, 1), entry(1, 2), entry(1, 3), entry(2, 1)] {
            write(&folder, &entry);
        }
        folder.forget_run(&JobKey([1; 16]), 2);
        assert_eq!(names(&folder), [entry(1, 1), entry(1, 3), entry(2, 1)].map(|e| e.name()));
        folder.forget(&JobKey([1; 16]), 2);
        assert_eq!(names(&folder), [entry(1, 3), entry(2, 1)].map(|e| e.name()));
        folder.forget(&JobKey([1; 16]), 3);
        assert!(folder.path.exists());
        folder.forget(&JobKey([2; 16]), 1);
        assert!(!folder.path.exists());
    }

    #[test]
    fn a_file_that_cannot_be_written_whole_leaves_the_one_before() {
        let (_root, folder) = folder();
        write(&folder, &entry(1, 1));
        let failed = folder.write(&entry(1, 1), &mut |out| {
            out.write_all(b"st")?;
            Err(ErrorKind::StorageFull.into())
        });
        assert_eq!(failed.unwrap_err().kind(), ErrorKind::StorageFull);
        assert_eq!(names(&folder), [entry(1, 1).name()]);
        assert_eq!(fs::read(folder.file(&entry(1, 1))).unwrap(), b"state");
    }

    #[test]
    fn time_in_which_nobody_could_look_counts_as_a_second() {
        let long_ago = Instant::now().checked_sub(Duration::from_secs(60)).unwrap();
        let stopwatch = Stopwatch(Mutex::new((Duration::from_secs(3), long_ago)));
        let worked = stopwatch.look();
        assert!((4..=5).contains(&worked.as_secs()), "{worked:?}");
        let alarm = Alarm::default();
        alarm.set(Duration::from_secs(40));
        *alarm.left.lock().unwrap() = Some((Duration::from_secs(40), long_ago));
        alarm.look();
        assert!(!alarm.rings());
        *alarm.left.lock().unwrap() = Some((Duration::from_secs(1), long_ago));
        alarm.look();
        assert!(alarm.rings());
    }

    #[test]
    fn a_pipe_in_the_place_of_a_checkpoint_is_refused_and_not_waited_for() {
        let (_root, folder) = folder();
        write(&folder, &entry(1, 1));
        let path = folder.file(&entry(1, 1));
        fs::remove_file(&path).unwrap();
        let made = std::process::Command::new("mkfifo").arg(&path).status().unwrap();
        assert!(made.success());
        let (alarm, notes) = (Alarm::default(), Cell::new(0));
        let tell = |note| {
            let refused =
                matches!(note, CheckpointNote::Refused { reason: CheckpointError::Damaged, .. });
            notes.set(notes.get() + usize::from(refused));
        };
        let key = (JobKey([1; 16]), attempt(2, 0));
        let keeper = Keeper::new(&folder, key, (&alarm, Duration::ZERO), &tell);
        keeper.resume(&mut |_| panic!("a pipe was read"));
        assert_eq!(notes.get(), 1);
    }

    #[test]
    fn a_checkpoint_is_due_when_the_alarm_has_rung_and_not_after_it_was_tried() {
        let (_root, folder) = folder();
        let (alarm, notes) = (Alarm::default(), Cell::new(0));
        let tell = |_| notes.set(notes.get() + 1);
        let key = (JobKey([1; 16]), attempt(1, 0));
        let keeper = Keeper::new(&folder, key, (&alarm, Duration::ZERO), &tell);
        assert!(!keeper.are_due());
        for reported in [1, 1] {
            // The second report is due after a hundred times the duration of the first.
            while !keeper.are_due() {
                alarm.look();
            }
            keeper.keep(&mut |_| Err(ErrorKind::StorageFull.into()));
            assert!(!keeper.are_due());
            assert_eq!(notes.get(), reported);
        }
        let hour = Duration::from_secs(3600);
        let keeper = Keeper::new(&folder, key, (&alarm, hour), &tell);
        alarm.look();
        assert!(!keeper.are_due());
    }

    #[test]
    fn after_a_death_checkpoints_are_due_sooner_and_then_at_twice_the_time_up_to_the_usual() {
        let (_root, folder) = folder();
        let (alarm, tell) = (Alarm::default(), |_| {});
        let left = || alarm.left.lock().unwrap().expect("the alarm is set").0.as_secs_f64();
        let every = Duration::from_secs(20);
        for (deaths, expected) in [
            (0, [20.0, 20.0, 20.0, 20.0, 20.0, 20.0, 20.0]),
            (1, [1.0, 2.0, 4.0, 8.0, 16.0, 20.0, 20.0]),
            (2, [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 20.0]),
            (9, [0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0]),
        ] {
            let key = (JobKey([1; 16]), attempt(deaths + 1, deaths));
            let keeper = Keeper::new(&folder, key, (&alarm, every), &tell);
            for expected in expected {
                assert_eq!(left(), expected, "{deaths} deaths");
                keeper.keep(&mut |_| Ok(()));
            }
        }
        let key = (JobKey([1; 16]), attempt(2, 1));
        let _keeper = Keeper::new(&folder, key, (&alarm, Duration::from_millis(50)), &tell);
        assert_eq!(left(), 0.05);
    }

    #[test]
    fn a_run_that_lost_its_claim_and_wakes_up_leaves_the_later_run_alone() {
        let (_root, folder) = folder();
        let (alarm, tell) = (Alarm::default(), |_| {});
        let keeper = |number| {
            let key = (JobKey([1; 16]), attempt(number, 0));
            Keeper::new(&folder, key, (&alarm, Duration::ZERO), &tell)
        };
        let (stopped, later) = (keeper(1), keeper(2));
        stopped.keep(&mut |out| out.write_all(b"early"));
        later.keep(&mut |out| out.write_all(b"late"));
        assert_eq!(names(&folder), [entry(1, 2).name()]);
        stopped.keep(&mut |out| out.write_all(b"early"));
        folder.forget_run(&JobKey([1; 16]), 1);
        assert_eq!(names(&folder), [entry(1, 2).name()]);
        assert_eq!(fs::read(folder.file(&entry(1, 2))).unwrap(), b"late");
    }
}
