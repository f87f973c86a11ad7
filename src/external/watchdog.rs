//! A process that kills a program's process group if jitai ends without killing it.
//!
//! The watchdog waits for a line on a pipe whose other end only jitai holds. The pipe closes when jitai
//! ends, even by SIGKILL; the watchdog then kills the group. A line means that the group has already been
//! killed. The watchdog ignores the signals by which a batch system stops all processes of a job, so that
//! it outlives jitai.

use std::io::Write;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};

const SCRIPT: &str = "trap '' HUP INT TERM USR1 USR2 XCPU; read -r done || kill -s KILL -- \"-$1\"";

/// The watchdog of a process group.
pub(super) struct Watchdog(Child);

impl Watchdog {
    /// Starts the watchdog of a group; `None` if there is no shell to run it.
    pub(super) fn over(group: u32) -> Option<Watchdog> {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", SCRIPT, "jitai-watchdog", &group.to_string()]);
        // In a group of its own, so that the terminal's Ctrl-C does not reach it.
        command.process_group(0).stdin(Stdio::piped());
        command.stdout(Stdio::null()).stderr(Stdio::null()).current_dir("/");
        command.spawn().ok().map(Watchdog)
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        if let Some(mut pipe) = self.0.stdin.take() {
            let _ = pipe.write_all(b"done\n");
        }
        let _ = self.0.wait();
    }
}
