//! Signals that ask the program to stop.

use std::io::{self, Write};
use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

/// Exit code after a signal.
const INTERRUPTED: i32 = 130;
/// How long an orderly stop may take. Two seconds are promised.
const GRACE: Duration = Duration::from_millis(1500);
/// How often the flag is looked at.
const LOOK: Duration = Duration::from_millis(50);

/// A flag that the first SIGINT, SIGTERM or SIGHUP sets; a second one ends the process at once,
/// with exit code 130.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        // In this order: the first signal finds the flag unset and sets it.
        flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(&stop))?;
        flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
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
        process::exit(INTERRUPTED)
    })?;
    Ok(())
}
