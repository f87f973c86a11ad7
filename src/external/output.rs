//! Programs that are run for their output.

use std::io;
use std::process::{Command, Output, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

/// Runs a command without input. Returns `None` if it does not end within `patience`; it is then killed.
///
/// **Errors**: the program cannot be started, or its output cannot be read.
pub fn output_within(mut command: Command, patience: Duration) -> io::Result<Option<Output>> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = command.spawn()?;
    let process = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let (sender, end) = mpsc::channel();
    thread::Builder::new().name("program's output".to_owned()).spawn(move || {
        // The receiver is gone if the program ended too late.
        let _ = sender.send(child.wait_with_output());
    })?;
    if let Ok(output) = end.recv_timeout(patience) {
        return output.map(Some);
    }
    // The program may already have ended.
    let _ = process.map(|process| kill_process(process, Signal::KILL));
    Ok(None)
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_program_is_killed_when_patience_ends() {
        let shell = |script: &str| {
            let mut command = Command::new("/bin/sh");
            command.args(["-c", script]);
            command
        };
        let begun = Instant::now();
        let late = output_within(shell("exec sleep 60"), Duration::from_millis(50));
        assert!(late.unwrap().is_none());
        assert!(begun.elapsed() < Duration::from_secs(30));
        let output =
            output_within(shell("echo out; echo err >&2; exit 3"), Duration::from_secs(60));
        let Output { status, stdout, stderr } = output.unwrap().unwrap();
        assert_eq!(
            (status.code(), stdout, stderr),
            (Some(3), b"out\n".to_vec(), b"err\n".to_vec())
        );
    }
}
