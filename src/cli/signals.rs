//! Signals that ask the program to stop.

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

/// Exit code after a signal.
const INTERRUPTED: i32 = 130;
/// How long an orderly stop may take. Two seconds are promised.
const GRACE: Duration = Duration::from_millis(1500);
/// How often the flag is looked at.
const LOOK: Duration = Duration::from_millis(50);

/// A flag that the first SIGINT, SIGTERM or SIGHUP sets; a second one ends the process at once,
/// with exit code 130. The same one twice at a time counts once, as it does to the system.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP])?;
    // One thread hears of all of them. Handlers may run in several threads at a time, and two
    // signals would then both be the first.
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

/// A flag that SIGTERM, SIGINT and SIGHUP set, however often they come: whoever sends them ends the
/// process otherwise if it takes too long.
pub(super) fn lasting_stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT, SIGHUP] {
        flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}

/// Ends the process with exit code 130, whatever its threads are at.
pub(super) fn end_now() -> ! {
    low_level::exit(INTERRUPTED)
}

/// Lets a write beyond the limit on the size of files fail, as on a full disk, instead of ending the
/// process without a word.
pub(super) fn survive_file_limits() -> io::Result<()> {
    flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false))).map(drop)
}

/// Ends the process 1.5 seconds after the flag is set, if it has not ended by itself: a single
/// update of a very large network, the registration of a very large manifest, or a store that
/// another program has locked would keep it for longer. Transactions and checkpoints are whole or
/// not there, and the next run takes the jobs over: those that had no time for a last checkpoint,
/// from the one before.
pub(super) fn end_in_time(stop: Arc<AtomicBool>) -> io::Result<()> {
    thread::Builder::new().name("deadline".to_owned()).spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            thread::sleep(LOOK);
        }
        thread::sleep(GRACE);
        // A closed standard error is no reason to stay.
        let _ = writeln!(io::stderr(), "stopped in the middle of a step; the same command goes on");
        end_now()
    })?;
    Ok(())
}

/// Writes a byte to the mark when the process aborts: when an allocation fails, a stack overflows,
/// or a panic cannot be caught.
pub(super) fn mark_crash(mark: File) -> io::Result<()> {
    pipe::register(SIGABRT, mark)?;
    // In this order: then the process ends as it would without the mark.
    flag::register_conditional_default(SIGABRT, Arc::new(AtomicBool::new(true)))?;
    Ok(())
}
