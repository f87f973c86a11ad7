//! Reading sources on several threads, and writing them on one thread in order.

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread;

use crate::store::copy::{Copied, Copier, CopyBatch, CopySource, Ended, Extent, Origins, RunCopy};
use crate::store::error::StoreError;
use crate::store::file;
use crate::store::writer::Store;

use super::merged::{Conflict, Damage, MergeProgress, Merged, OtherManifest};
use super::snapshot;

/// The maximum number of reading threads: two or three suffice for one writer.
const MOST_READERS: usize = 4;

/// The number of batches of a source that may wait to be written.
const WAITING: usize = 1;

/// A part of a source, as sent by a reading thread.
enum Message {
    Batch(CopyBatch),
    /// The last message: whether part of the list of runs is unreadable, or why the source could not be read.
    End(Result<bool, StoreError>),
}

/// A source to be read.
struct Unread<'a> {
    path: &'a Path,
    to: SyncSender<Message>,
}

/// Stores that can be merged: each could be opened, and is of this or an earlier release.
#[derive(Clone, Debug)]
pub struct Sources {
    paths: Vec<PathBuf>,
    runs: usize,
}

impl Sources {
    /// The stores at `paths`. Call this before opening the target, so that a rejected merge creates no empty
    /// target.
    ///
    /// **Errors**: a path holds no store, or a store of a newer release. A damaged store is not an error
    /// here: [`merge`] reports it.
    pub fn open(paths: Vec<PathBuf>) -> Result<Sources, StoreError> {
        let mut runs = 0;
        for path in &paths {
            runs += match snapshot::count(path) {
                Err(StoreError::Damaged { .. }) => 0,
                counted => counted?,
            };
        }
        Ok(Sources { paths, runs })
    }
}

/// Copies the verified completed runs and the failed runs of `sources`, with their jobs and experiments, into
/// `into`, unless it has them. Merging again inserts nothing. Calls `hear` after every transaction.
///
/// If another process is writing to a source, the merge reads a snapshot of it.
///
/// **Errors**: a source can no longer be read, `into` cannot be written, or no thread can be started. Runs that
/// were copied before remain.
pub fn merge(
    sources: &Sources,
    into: &mut Store,
    mut hear: impl FnMut(MergeProgress),
) -> Result<Merged, StoreError> {
    let Sources { paths: sources, runs } = sources;
    let mut progress = MergeProgress { done: 0, of: *runs };
    into.release_all_dead_sessions()?;
    let target = into.path().to_owned();
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let readers = cores.min(MOST_READERS).min(sources.len());
    let (unread, waiting) = sync_channel::<Unread<'_>>(sources.len());
    let waiting = Mutex::new(waiting);
    thread::scope(|scope| {
        for started in 0..readers {
            let reader = || read_all(&waiting, &target);
            match thread::Builder::new().spawn_scoped(scope, reader) {
                Err(reason) if started == 0 => return Err(StoreError::NoThread(reason)),
                // Fewer readers suffice.
                Err(_) => break,
                Ok(_) => {}
            }
        }
        let unread = unread;
        let mut merged = Merged { sources: sources.len(), ..Merged::default() };
        let mut ahead = sources.iter();
        let mut begun: VecDeque<(&Path, Receiver<Message>)> = VecDeque::new();
        loop {
            // Sources are read only shortly before they are written, so that few batches wait.
            while begun.len() <= readers
                && let Some(path) = ahead.next()
            {
                let (to, from) = sync_channel(WAITING);
                unread.send(Unread { path, to }).expect("its other end is outside of the scope");
                begun.push_back((path, from));
            }
            let Some((path, from)) = begun.pop_front() else { return Ok(merged) };
            take(&mut merged, path, &from, into, |runs| {
                progress.done += runs;
                hear(progress);
            })?;
        }
    })
}

/// Reads one source after the other until no source is left or the receiver is gone.
fn read_all(unread: &Mutex<Receiver<Unread<'_>>>, target: &Path) {
    loop {
        let next = unread.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(Unread { path, to }) = next else { return };
        let read = || -> Result<Result<bool, _>, StoreError> {
            let source = snapshot::open(path)?;
            let known = file::connect_reader(target)
                .map_err(|source| StoreError::sqlite(target, "read the store", source))?;
            let source = CopySource::new(&source, Extent::Results(&known));
            Ok(source.read(|batch| to.send(Message::Batch(batch))))
        };
        let end = match read() {
            Ok(Ok(unreadable)) => Ok(unreadable),
            Ok(Err(_)) => return,
            Err(error) => Err(error),
        };
        if to.send(Message::End(end)).is_err() {
            return;
        }
    }
}

/// Writes one source; calls `handled` with the number of runs after each transaction.
fn take(
    merged: &mut Merged,
    path: &Path,
    from: &Receiver<Message>,
    into: &mut Store,
    mut handled: impl FnMut(usize),
) -> Result<(), StoreError> {
    let damage = |what: String| Damage { source: path.to_owned(), job_key: None, what };
    let mut copier = Copier::new(path);
    // A thread that panicked sends no last message; the scope propagates its panic.
    for message in from {
        match message {
            Message::Batch(batch) => {
                let runs = if let CopyBatch::Runs(runs) = &batch { runs.len() } else { 0 };
                copier.write(into, &batch, |run, became| {
                    merged.count(path, run.job_key.as_deref(), run.ended, became);
                })?;
                handled(runs);
            }
            Message::End(Ok(false)) => {}
            Message::End(Ok(true)) => {
                merged.damaged.push(damage("part of its list of runs cannot be read".to_owned()));
            }
            Message::End(Err(StoreError::Damaged { reason, .. })) => {
                merged.damaged.push(damage(reason));
            }
            Message::End(Err(error)) => return Err(error),
        }
    }
    let Copied { experiments, differing, jobs, estimates, .. } = copier.copied;
    merged.experiments += experiments;
    merged.estimates += estimates;
    merged.jobs += jobs;
    merged.differing.extend(
        differing
            .into_iter()
            .map(|experiment| OtherManifest { source: path.to_owned(), experiment }),
    );
    Ok(())
}

impl Merged {
    /// Counts a run.
    fn count(&mut self, source: &Path, job_key: Option<&str>, ended: Ended, became: RunCopy) {
        let source = source.to_owned();
        match became {
            RunCopy::Copied => match ended {
                Ended::Completed => self.completed += 1,
                Ended::Failed | Ended::Interrupted => self.failed += 1,
            },
            RunCopy::AlreadyThere => self.already_there += 1,
            RunCopy::InProgress => self.in_progress += 1,
            RunCopy::Conflict(origins) => {
                let Origins { theirs, ours } = *origins;
                let job_key = job_key.unwrap_or_default().to_owned();
                self.conflicts.push(Conflict { source, job_key, theirs, ours });
            }
            RunCopy::Damaged(what) => {
                let job_key = job_key.map(str::to_owned);
                self.damaged.push(Damage { source, job_key, what });
            }
        }
    }
}
