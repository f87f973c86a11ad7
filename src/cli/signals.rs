//! Signals that stop the program.

use std::fs::{self, File};
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGUSR1, SIGUSR2, SIGXCPU, SIGXFSZ};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::{self, pipe};

use crate::cli::reader;
use crate::store::STOPPED;

/// How to resume after a stop, for messages.
pub(super) const RESUME: &str = "run the same command to resume";
/// Exit code after a signal.
const INTERRUPTED: i32 = 130;
/// Maximum time of an orderly stop. The documentation promises two seconds.
const GRACE: Duration = Duration::from_millis(1500);
/// Time between two checks of the flag.
const LOOK: Duration = Duration::from_millis(50);

/// Signals by which a person or a system stops a program.
const REQUESTS: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];
/// Signals by which batch systems (SGE, LSF, PBS) announce the end of a job. They may come repeatedly:
/// SIGXCPU comes after every further second of processor time.
const WARNINGS: [i32; 3] = [SIGUSR1, SIGUSR2, SIGXCPU];

/// The file that [`mark_crash`] marks, which also records that the process was stopped.
static MARK: OnceLock<File> = OnceLock::new();

/// A flag that the first signal of [`REQUESTS`] or [`WARNINGS`] sets. A second request ends the process at
/// once with exit code 130; further warnings do nothing. Signals of one kind that are pending together count
/// once, as in the system. Signals that were ignored when the program started, for example by `nohup`, stay
/// ignored.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut signals = Signals::new(heeded())?;
    // One thread receives all signals. Handlers in several threads could each treat their signal as the
    // first.
    thread::Builder::new().name("signals".to_owned()).spawn({
        let stop = Arc::clone(&stop);
        move || {
            let mut requested = false;
            for signal in signals.forever() {
                if !stop.swap(true, Ordering::Relaxed) {
                    mark_stop();
                }
                if REQUESTS.contains(&signal) && std::mem::replace(&mut requested, true) {
                    end_now();
                }
            }
        }
    })?;
    Ok(stop)
}

/// A flag that every signal of [`stop_flag`] sets; further signals do nothing else. A cluster kills a
/// process that takes too long to stop.
pub(super) fn lasting_stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in heeded() {
        flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}

/// The signals that stop the program: those that were not ignored when it started.
fn heeded() -> impl Iterator<Item = i32> {
    let ignored = ignored(&fs::read_to_string("/proc/self/status").unwrap_or_default());
    let is_ignored = move |signal: &i32| ignored >> (signal - 1) & 1 == 1;
    REQUESTS.into_iter().chain(WARNINGS).filter(move |signal| !is_ignored(signal))
}

/// The ignored signals in a status file of proc(5): bit n - 1 stands for signal n. None where the system has
/// no such file.
fn ignored(status: &str) -> u64 {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}

/// Records in the mark that the process was stopped, so that its end, however it comes, counts against no job.
fn mark_stop() {
    if let Some(mut mark) = MARK.get() {
        // Without the record, the end counts as that of a process that was killed.
        let _ = mark.write_all(STOPPED);
    }
}

/// Ends the process immediately with exit code 130.
pub(super) fn end_now() -> ! {
    low_level::exit(INTERRUPTED)
}

/// Makes a write beyond the file-size limit fail, as on a full disk, instead of killing the process.
pub(super) fn survive_file_limits() -> io::Result<()> {
    flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false))).map(drop)
}

/// Ends the process 1.5 seconds after the flag is set, if the process still runs then. An update of a
/// very large network, the registration of a very large manifest, or a store locked by another program
/// may take longer. Transactions and checkpoints are atomic, so the next run takes over the jobs: a job
/// without a final checkpoint resumes from its previous checkpoint. `last` is called before the end and must not wait
/// for a reader: the thread that should end may wait for one.
pub(super) fn end_in_time(
    stop: Arc<AtomicBool>,
    last: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    thread::Builder::new().name("deadline".to_owned()).spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            thread::sleep(LOOK);
        }
        thread::sleep(GRACE);
        last();
        end_now()
    })?;
    Ok(())
}

/// Says that the process ends before its threads do, unless nobody reads it.
pub(super) fn say_stopped() {
    reader::say_within(LOOK, &format!("stopped in the middle of a step; {RESUME}"));
}

/// Writes a byte to the mark when the process aborts: after a failed allocation, a stack overflow,
/// or a panic that cannot be caught. Writes another byte when the process is stopped by a signal.
pub(super) fn mark_crash(mark: File) -> io::Result<()> {
    if let Ok(copy) = mark.try_clone() {
        // A process marks only one session.
        let _ = MARK.set(copy);
    }
    pipe::register(SIGABRT, mark)?;
    // Registered second, so that the process still aborts after the mark is written.
    flag::register_conditional_default(SIGABRT, Arc::new(AtomicBool::new(true)))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ignored_signals_are_read_from_the_mask_of_the_status_file() {
        let status =
            |mask: &str| format!("Name:\tjitai\nSigBlk:\tffffffffffffffff\nSigIgn:\t{mask}\n");
        // nohup ignores SIGHUP, a shell without job control SIGINT and SIGQUIT of background commands.
        for (mask, expected) in [("0000000000001001", 0x1001), ("0000000000000006", 6)] {
            assert_eq!(ignored(&status(mask)), expected);
        }
        assert_eq!((ignored(""), ignored(&status("?"))), (0, 0));
    }
}
