//! Signals that stop the program.

use std::fs::File;
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::{self, pipe};

/// How to resume after a stop, for messages.
pub(super) const RESUME: &str = "run the same command to resume";
/// Exit code after a signal.
const INTERRUPTED: i32 = 130;
/// Maximum time of an orderly stop. The documentation promises two seconds.
const GRACE: Duration = Duration::from_millis(1500);
/// Time between two checks of the flag.
const LOOK: Duration = Duration::from_millis(50);

/// A flag that the first SIGINT, SIGTERM or SIGHUP sets. A second signal ends the process at once with
/// exit code 130. Signals of one kind that are pending together count once, as in the system.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    // One thread receives all signals. Handlers in several threads could each treat their signal as the
    // first.
    thread::Builder::new().name("signals".to_owned()).spawn({
        let stop = Arc::clone(&stop);
        move || {
            for _ in signals.forever() {
                if stop.swap(true, Ordering::Relaxed) {
                    end_now();
                }
            }
        }
    })?;
    Ok(stop)
}

/// A flag that every SIGTERM, SIGINT and SIGHUP sets; further signals do nothing else. A cluster kills
/// a process that takes too long to stop.
pub(super) fn lasting_stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
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
/// without a final checkpoint resumes from its previous checkpoint.
pub(super) fn end_in_time(stop: Arc<AtomicBool>) -> io::Result<()> {
    thread::Builder::new().name("deadline".to_owned()).spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            thread::sleep(LOOK);
        }
        thread::sleep(GRACE);
        // The process ends even if standard error is closed.
        let _ = writeln!(io::stderr(), "stopped in the middle of a step; {RESUME}");
        end_now()
    })?;
    Ok(())
}

/// Writes a byte to the mark when the process aborts: after a failed allocation, a stack overflow,
/// or a panic that cannot be caught.
pub(super) fn mark_crash(mark: File) -> io::Result<()> {
    pipe::register(SIGABRT, mark)?;
    // Registered second, so that the process still aborts after the mark is written.
    flag::register_conditional_default(SIGABRT, Arc::new(AtomicBool::new(true)))?;
    Ok(())
}
