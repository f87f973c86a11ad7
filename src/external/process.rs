//! The process of a program, from its start to the end of its group.

use std::ffi::OsStr;
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use serde::Serialize;

use super::error::ProgramError;
use super::message::Message;
use super::pipes::{Input, Lines, Next, Tail};
use super::watchdog::Watchdog;

/// Interval of the checks for a stop and for the end of the program.
const LOOK: Duration = Duration::from_millis(20);
/// Time for a program to end after its input was closed, at the end of its job.
const GRACE: Duration = Duration::from_secs(2);
/// Time for a program to end after it broke the protocol.
const SHORT_GRACE: Duration = Duration::from_millis(500);
const KILLED: &str = "was ended by signal 9 (SIGKILL, as systems send it when memory is short)";

const TERMINAL: &str = "used the terminal, which only jitai may use (let it read what it needs from a file or the \
    environment),";

/// Time in which a stop may follow the end of a program. A batch system signals all processes of a job at
/// once, and a program may end before jitai has noticed the signal.
const STOP_FOLLOWS: Duration = Duration::from_millis(200);
/// Time for a program to end after a stop, because jitai must end within two seconds.
const STOP_GRACE: Duration = Duration::from_millis(300);

/// A running program.
pub struct Program {
    command: String,
    child: Child,
    group: Option<Pid>,
    /// `None` once its input is closed.
    to: Option<Input>,
    from: Lines,
    tail: Tail,
    /// `None` once the group has been killed.
    watchdog: Option<Watchdog>,
    status: Option<ExitStatus>,
}

/// The words of a command as a user would type them.
pub fn shown(words: &[String]) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    let shown = |word: &String| match !word.is_empty() && word.chars().all(is_plain) {
        true => word.clone(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    };
    words.iter().map(shown).collect::<Vec<_>>().join(" ")
}

impl Program {
    /// Starts a command in a folder, without a shell. Messages show the command as [`shown`]. The program
    /// inherits jitai's environment variables. Its lines have at most `longest_line` bytes.
    ///
    /// **Errors**: the program or the folder does not exist, or the system has no more processes.
    pub fn start(
        words: &[String],
        folder: &Path,
        longest_line: usize,
    ) -> Result<Program, ProgramError> {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let failed = |source: io::Error| {
            let help = match source.kind() {
                io::ErrorKind::NotFound => {
                    "; install it on this machine, or correct `command`; a path with a slash starts in \
                     the folder of the manifest"
                }
                io::ErrorKind::PermissionDenied => "; make the file executable",
                _ => "",
            };
            let folder = folder.display().to_string();
            ProgramError::NotStarted { command: shown(words), folder, source, help }
        };
        let first = words.first().map_or("", String::as_str);
        // A relative path starts from the folder, not from the working directory of jitai.
        let folder_path = folder.canonicalize().map_err(failed)?;
        let program = match first.contains('/') {
            true => folder_path.join(first).into_os_string(),
            false => OsStr::new(first).to_owned(),
        };
        let mut command = Command::new(program);
        command.args(words.iter().skip(1)).current_dir(&folder_path).process_group(0);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(failed)?;
        let group = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        let watchdog = Watchdog::over(child.id());
        let piped = "a pipe was asked for";
        let (input, output) = (child.stdin.take().expect(piped), child.stdout.take().expect(piped));
        let errors = child.stderr.take().expect(piped);
        let from = Lines::of(output, longest_line);
        let pipes = || Ok((Input::of(input)?, Tail::of(errors)?));
        match pipes() {
            Ok((to, tail)) => Ok(Program {
                command: shown(words),
                child,
                group,
                to: Some(to),
                from,
                tail,
                watchdog,
                status: None,
            }),
            Err(error) => {
                let _ = group.map(|group| kill_process_group(group, Signal::KILL));
                let _ = child.wait();
                Err(failed(error))
            }
        }
    }

    /// Sends a message. If the program does not read it, the next [`Program::receive`] reports the error.
    pub fn send(&mut self, message: &impl Serialize) {
        let mut line = serde_json::to_vec(message).expect("messages are finite numbers and texts");
        line.push(b'\n');
        if let Some(to) = &self.to {
            to.write(line);
        }
    }

    /// The next message of the program. Errors name the `expected` message and, in `when`, what the program
    /// was doing.
    ///
    /// **Errors**: the program ends or sends something else, or `stop` returns true.
    pub fn receive<M: Message>(
        &mut self,
        expected: &str,
        when: &str,
        stop: &dyn Fn() -> bool,
    ) -> Result<M, ProgramError> {
        loop {
            if stop() {
                return Err(ProgramError::Stopped);
            }
            if self.waits_for_terminal() {
                self.end(Duration::ZERO, stop);
                return Err(ProgramError::Ended {
                    command: self.command.clone(),
                    end: TERMINAL.to_owned(),
                    when: format!("{when}, where {expected} was expected"),
                    said: self.tail.said(),
                });
            }
            let line = match self.from.next(LOOK) {
                Next::Line(line) => line,
                // A process that the program left behind can keep its output open.
                Next::Nothing if self.has_ended() => match self.from.next(Duration::ZERO) {
                    Next::Line(line) => line,
                    Next::Nothing | Next::End => return Err(self.ended(expected, when, stop)),
                },
                Next::Nothing => continue,
                Next::End => return Err(self.ended(expected, when, stop)),
            };
            let line = line.whole(expected);
            if line.as_ref().is_ok_and(|line| line.trim_ascii().is_empty()) {
                continue;
            }
            let message = line.and_then(|line| M::read(&line, expected));
            return message.map_err(|fault| self.broke(fault));
        }
    }

    /// Ends a program that broke the protocol, and returns the error.
    pub fn broke(&mut self, fault: String) -> ProgramError {
        self.end(SHORT_GRACE, &|| false);
        ProgramError::Protocol { command: self.command.clone(), fault, said: self.tail.said() }
    }

    /// Ends a program whose job is done; it has two seconds to exit by itself.
    pub fn finish(mut self, stop: &dyn Fn() -> bool) {
        self.end(GRACE, stop);
    }

    /// Ends a program that has exited or closed its standard output, and returns the error. Its end is no
    /// failure if jitai is being stopped.
    fn ended(&mut self, expected: &str, when: &str, stop: &dyn Fn() -> bool) -> ProgramError {
        let by_itself = self.end(SHORT_GRACE, stop);
        let ended = Instant::now();
        while !stop() && ended.elapsed() < STOP_FOLLOWS {
            thread::sleep(LOOK);
        }
        if stop() {
            return ProgramError::Stopped;
        }
        let end = match self.status.filter(|_| by_itself) {
            Some(status) => match (status.code(), status.signal()) {
                (Some(code), _) => format!("exited with code {code}"),
                (None, Some(9)) => KILLED.to_owned(),
                (None, Some(signal)) => format!("was ended by signal {signal}"),
                (None, None) => "ended".to_owned(),
            },
            None => "closed its standard output".to_owned(),
        };
        let when = format!("{when}, where {expected} was expected");
        ProgramError::Ended { command: self.command.clone(), end, when, said: self.tail.said() }
    }

    /// Whether the program itself has exited. It remains a zombie until its group is killed, so that its
    /// group number is not reused.
    fn has_ended(&self) -> bool {
        let Some(group) = self.group else { return true };
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        !matches!(waitid(WaitId::Pid(group), options), Ok(None))
    }

    /// Whether the system has stopped the program because it used the terminal, which belongs to jitai.
    fn waits_for_terminal(&self) -> bool {
        let Some(group) = self.group else { return false };
        let options = WaitIdOptions::STOPPED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let status = waitid(WaitId::Pid(group), options).ok().flatten();
        let signal = status.and_then(|status| status.stopping_signal());
        signal.is_some_and(|signal| {
            [Signal::TTIN, Signal::TTOU].map(Signal::as_raw).contains(&signal)
        })
    }

    /// Closes the program's input, waits for its exit, and kills the rest of its group. Returns whether the
    /// program exited by itself.
    fn end(&mut self, grace: Duration, stop: &dyn Fn() -> bool) -> bool {
        self.to = None;
        let begun = Instant::now();
        let mut pause = Duration::from_millis(1);
        while begun.elapsed() < grace && !stop() && !self.has_ended() {
            thread::sleep(pause);
            pause = (pause * 2).min(LOOK);
        }
        let by_itself = self.has_ended();
        self.kill();
        by_itself
    }

    /// Kills the group with SIGKILL.
    fn kill(&mut self) {
        if self.status.is_some() {
            return;
        }
        if let Some(group) = self.group {
            let _ = kill_process_group(group, Signal::KILL);
        }
        self.status = self.child.wait().ok();
        self.watchdog = None;
    }

    /// Sends SIGTERM to the group, and kills it after a short grace period.
    pub fn stop(mut self) {
        if let Some(group) = self.group.filter(|_| self.status.is_none()) {
            let _ = kill_process_group(group, Signal::TERM);
        }
        self.end(STOP_GRACE, &|| false);
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.to = None;
        self.kill();
    }
}
