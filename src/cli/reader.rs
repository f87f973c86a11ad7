//! Writes that do not wait for their reader.
//!
//! A full pipe, a terminal held by Ctrl-S or a connection that hangs makes a write wait without end. Here, a thread
//! of its own writes, so that neither the work nor the end of the program waits with it.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

/// Longest time that the program waits for a reader of progress and messages.
const PATIENCE: Duration = Duration::from_secs(1);

/// A write.
type Task = Box<dyn FnOnce() + Send>;

/// Does writes in their order, in a thread of its own.
pub(super) struct Writer {
    /// `None` once it is dropped.
    writes: Option<mpsc::Sender<Task>>,
    /// The number of writes that are not done.
    waiting: Arc<AtomicUsize>,
    done: mpsc::Receiver<()>,
    /// Whether the end waits for a reader without limit.
    is_data: bool,
}

impl Writer {
    /// A writer of progress and messages, which are dropped at its end if nobody reads.
    pub(super) fn of_progress() -> Writer {
        Writer::new(false)
    }

    /// A writer of data, which are never dropped.
    pub(super) fn of_data() -> Writer {
        Writer::new(true)
    }

    fn new(is_data: bool) -> Writer {
        let (writes, inbox) = mpsc::channel::<Task>();
        let (end, done) = mpsc::channel();
        let waiting = Arc::new(AtomicUsize::new(0));
        let left = Arc::clone(&waiting);
        let work = move || {
            for write in inbox {
                write();
                left.fetch_sub(1, Ordering::Relaxed);
                let _ = end.send(());
            }
        };
        // Without a thread, what is written is lost, and the work goes on.
        let started = thread::Builder::new().name("writer".to_owned()).spawn(work);
        Writer { writes: started.is_ok().then_some(writes), waiting, done, is_data }
    }

    /// Writes after all earlier writes.
    pub(super) fn write(&self, write: impl FnOnce() + Send + 'static) {
        if let Some(writes) = &self.writes {
            self.waiting.fetch_add(1, Ordering::Relaxed);
            let _ = writes.send(Box::new(write));
        }
        // Ends of earlier writes are of use only while the writer is dropped.
        while self.done.try_recv().is_ok() {}
    }

    /// Whether all writes are done.
    pub(super) fn is_idle(&self) -> bool {
        self.waiting.load(Ordering::Relaxed) == 0
    }
}

impl Drop for Writer {
    /// Waits for the writes; unless they are data, only as long as a reader reads.
    fn drop(&mut self) {
        self.writes = None;
        loop {
            match self.done.recv_timeout(PATIENCE) {
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) if !self.is_data => return,
                Ok(()) | Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }
}

/// Writes a message to standard error, and waits at most a second for its reader.
pub(super) fn say(line: &str) {
    say_within(PATIENCE, line);
}

/// Like [`say`], with another time. Does not wait for a reader for whom an earlier message waits.
pub(super) fn say_within(patience: Duration, line: &str) {
    static HANGS: AtomicBool = AtomicBool::new(false);
    let line = format!("{line}\n");
    let write = move || {
        drop(io::stderr().write_all(line.as_bytes()));
        HANGS.store(false, Ordering::Relaxed);
    };
    let patience = if HANGS.load(Ordering::Relaxed) { Duration::ZERO } else { patience };
    if !within(patience, write) {
        HANGS.store(true, Ordering::Relaxed);
    }
}

/// Does a write in a thread of its own, and waits for it for this time; whether it is done.
pub(super) fn within(patience: Duration, write: impl FnOnce() + Send + 'static) -> bool {
    let (end, done) = mpsc::channel();
    let work = move || {
        write();
        let _ = end.send(());
    };
    let started = thread::Builder::new().name("writer".to_owned()).spawn(work);
    started.is_ok() && done.recv_timeout(patience).is_ok()
}
