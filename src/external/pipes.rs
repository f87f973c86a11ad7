//! The pipes of a program. Every wait for the program has a limit.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::process::{ChildStdin, ChildStdout};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::message::shown;

/// Number of bytes that are read at once.
const BLOCK: usize = 1 << 14;
/// Maximum size of a message that is written at once if the pipe has room: the size that POSIX guarantees a
/// pipe with any room to take without a wait.
const SMALL: usize = 512;
/// Time in which an answer is looked for again and again.
const AWAKE: Duration = Duration::from_micros(100);
/// Number of lines of standard error that are kept, and maximum bytes of each.
const TAIL_LINES: usize = 8;
const TAIL_BYTES: usize = 300;
/// Maximum wait for the end of standard error after the program has ended.
const LAST_WORDS: Duration = Duration::from_millis(300);

/// A line of standard output.
#[derive(Debug)]
pub(super) enum OutputLine {
    /// A line without its line break.
    Whole(Vec<u8>),
    /// The beginning of a line that exceeds the maximum length.
    TooLong(Vec<u8>),
}

/// The lines of standard output.
pub(super) struct Lines<Output = ChildStdout> {
    output: Output,
    /// Bytes that were read and belong to no line yet.
    bytes: Vec<u8>,
    /// The number of these bytes in which no line break was found.
    searched: usize,
    /// Maximum length of a line, in bytes.
    longest: usize,
    has_ended: bool,
}

/// The result of a wait for a line.
#[derive(Debug)]
pub(super) enum Next {
    /// A line.
    Line(OutputLine),
    /// No line has come yet.
    Nothing,
    /// Standard output has been read to its end, or to a line that is too long.
    End,
}

impl<Output: Read + AsFd> Lines<Output> {
    /// The lines of `output` with at most `longest` bytes each.
    pub(super) fn of(output: Output, longest: usize) -> Self {
        Lines { output, bytes: Vec::new(), searched: 0, longest, has_ended: false }
    }

    /// The next line, if it comes within `wait`.
    pub(super) fn next(&mut self, wait: Duration) -> Next {
        let deadline = Instant::now() + wait;
        loop {
            if let Some(line) = self.read_before() {
                return Next::Line(line);
            }
            if self.has_ended {
                return Next::End;
            }
            if !self.comes_before(deadline) {
                return Next::Nothing;
            }
            let before = self.bytes.len();
            self.bytes.resize(before + BLOCK, 0);
            let read = self.output.read(&mut self.bytes[before..]);
            self.bytes.truncate(before + read.as_ref().copied().unwrap_or(0));
            self.has_ended = match read {
                Ok(length) => length == 0,
                Err(error) => error.kind() != io::ErrorKind::Interrupted,
            };
        }
    }

    /// Waits until there is something to read, or until a deadline. A program that answers at once is not waited
    /// for asleep, because waking up can take longer than its answer.
    fn comes_before(&self, deadline: Instant) -> bool {
        let begun = Instant::now();
        loop {
            if is_ready(&self.output, PollFlags::IN, Duration::ZERO) {
                return true;
            }
            let now = Instant::now();
            if now >= deadline {
                return false;
            }
            if now - begun > AWAKE {
                return is_ready(&self.output, PollFlags::IN, deadline - now);
            }
            thread::yield_now();
        }
    }

    /// A line that has been read already.
    fn read_before(&mut self) -> Option<OutputLine> {
        let found = self.bytes[self.searched..].iter().position(|byte| *byte == b'\n');
        let end = found.map(|found| self.searched + found);
        if end.unwrap_or(self.bytes.len()) > self.longest {
            self.has_ended = true;
            let mut line = std::mem::take(&mut self.bytes);
            line.truncate(self.longest + 1);
            self.searched = 0;
            return Some(OutputLine::TooLong(line));
        }
        let is_last = self.has_ended && !self.bytes.is_empty();
        let Some(end) = end.or(is_last.then_some(self.bytes.len())) else {
            self.searched = self.bytes.len();
            return None;
        };
        let rest = self.bytes.split_off((end + 1).min(self.bytes.len()));
        let mut line = std::mem::replace(&mut self.bytes, rest);
        self.searched = 0;
        line.truncate(end);
        line.pop_if(|last| *last == b'\r');
        Some(OutputLine::Whole(line))
    }
}

/// Whether a pipe can be read or written, or has been closed at its other end, within `wait`.
fn is_ready(pipe: &impl AsFd, how: PollFlags, wait: Duration) -> bool {
    let wait = Timespec::try_from(wait).ok();
    poll(&mut [PollFd::new(pipe, how)], wait.as_ref()).is_ok_and(|ready| ready > 0)
}

/// Standard input.
pub(super) struct Input {
    pipe: Arc<ChildStdin>,
    /// Messages that a thread writes.
    later: Sender<Vec<u8>>,
    /// The number of these messages that are not written yet.
    waiting: Arc<AtomicUsize>,
}

impl Input {
    /// The standard input of a program. It is closed once this value is dropped and everything is written.
    pub(super) fn of(pipe: ChildStdin) -> io::Result<Input> {
        let (later, messages) = mpsc::channel::<Vec<u8>>();
        let (pipe, waiting) = (Arc::new(pipe), Arc::new(AtomicUsize::new(0)));
        let (to, left) = (Arc::clone(&pipe), Arc::clone(&waiting));
        spawn("program's input", move || {
            for bytes in messages {
                // The program has closed its input; the reading side detects its end.
                if (&*to).write_all(&bytes).is_err() {
                    return;
                }
                left.fetch_sub(1, Ordering::Release);
            }
        })?;
        Ok(Input { pipe, later, waiting })
    }

    /// Writes a message, now or in a thread, which alone waits if the program does not read.
    pub(super) fn write(&self, bytes: Vec<u8>) {
        let is_free = bytes.len() <= SMALL && self.waiting.load(Ordering::Acquire) == 0;
        if is_free && is_ready(&*self.pipe, PollFlags::OUT, Duration::ZERO) {
            let _ = (&*self.pipe).write_all(&bytes);
            return;
        }
        self.waiting.fetch_add(1, Ordering::Relaxed);
        let _ = self.later.send(bytes);
    }
}

/// The last lines of standard error.
pub(super) struct Tail {
    lines: Arc<Mutex<VecDeque<Vec<u8>>>>,
    /// Disconnected once standard error has been read to its end.
    end: Receiver<()>,
}

impl Tail {
    /// The last lines of `errors`, which a thread reads to the end, whatever its length.
    pub(super) fn of(errors: impl Read + Send + 'static) -> io::Result<Tail> {
        let lines = Arc::new(Mutex::new(VecDeque::new()));
        let (sender, end) = mpsc::channel::<()>();
        spawn("program's errors", {
            let lines = Arc::clone(&lines);
            move || {
                keep_last(errors, &lines);
                drop(sender);
            }
        })?;
        Ok(Tail { lines, end })
    }

    /// The last lines, joined into one line; empty if there are none. Waits briefly for the output of a
    /// program that has just ended.
    pub(super) fn said(&self) -> String {
        let _ = self.end.recv_timeout(LAST_WORDS);
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let plain = |line: &Vec<u8>| {
            let text = String::from_utf8_lossy(line);
            text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>()
        };
        let lines = lines.iter().map(plain).filter(|line| !line.trim().is_empty());
        let lines: Vec<String> = lines.collect();
        match lines.is_empty() {
            true => String::new(),
            false => format!("; standard error ends with: {}", lines.join(" | ")),
        }
    }
}

/// Reads in blocks, so that a line without end needs no more memory than others.
fn keep_last(mut errors: impl Read, kept: &Mutex<VecDeque<Vec<u8>>>) {
    let mut block = [0; 1 << 13];
    let mut is_new_line = true;
    loop {
        let length = match errors.read(&mut block) {
            Ok(0) => return,
            Ok(length) => length,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        for part in block[..length].split_inclusive(|byte| *byte == b'\n') {
            if is_new_line {
                if kept.len() == TAIL_LINES {
                    kept.pop_front();
                }
                kept.push_back(Vec::new());
            }
            is_new_line = part.ends_with(b"\n");
            let part = part.strip_suffix(b"\n").unwrap_or(part);
            if let Some(line) = kept.back_mut() {
                let room = TAIL_BYTES.saturating_sub(line.len());
                line.extend(&part[..part.len().min(room)]);
            }
        }
    }
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
    thread::Builder::new().name(name.to_owned()).spawn(work).map(drop)
}

impl OutputLine {
    /// The line; or, for a line that is too long, an error with the `expected` message.
    pub(super) fn whole(self, expected: &str) -> Result<Vec<u8>, String> {
        match self {
            OutputLine::Whole(line) => Ok(line),
            OutputLine::TooLong(line) => Err(format!(
                "expected {expected}, found a line of more than {} bytes that begins with {}",
                line.len() - 1,
                shown(&line)
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::external::LONGEST_LINE;

    #[test]
    fn the_last_lines_are_kept_of_any_amount() {
        let mut flood = Vec::new();
        for number in 0..200_000 {
            flood.extend(format!("line {number}\n").into_bytes());
        }
        flood.extend(vec![b'x'; 1 << 20]);
        let tail = Tail::of(io::Cursor::new(flood)).unwrap();
        // Gives the thread time to read everything.
        std::thread::sleep(Duration::from_millis(200));
        let said = tail.said();
        assert!(
            said.starts_with("; standard error ends with: line 199993 | line 199994"),
            "{said}"
        );
        assert!(said.ends_with(&format!("| {}", "x".repeat(TAIL_BYTES))), "{said}");
        assert_eq!(Tail::of(io::empty()).unwrap().said(), "");
    }

    fn lines_of(text: Vec<u8>) -> Vec<Result<Vec<u8>, String>> {
        let (output, mut input) = io::pipe().unwrap();
        let writer = thread::spawn(move || input.write_all(&text));
        let mut lines = Lines::of(output, LONGEST_LINE);
        let mut found = Vec::new();
        loop {
            match lines.next(Duration::from_secs(1)) {
                Next::Line(line) => found.push(line.whole("a message")),
                Next::Nothing => {}
                Next::End => break,
            }
        }
        drop(lines);
        let _ = writer.join().unwrap();
        found
    }

    #[test]
    fn lines_are_cut_at_their_breaks_and_long_ones_end_the_reading() {
        let text =
            [&b"one\r\n\ntwo"[..], b"\n", &vec![b'y'; LONGEST_LINE + 5], b"\nthree"].concat();
        let lines = lines_of(text);
        assert_eq!(lines[..3], [Ok(b"one".to_vec()), Ok(Vec::new()), Ok(b"two".to_vec())]);
        let fault = lines[3].as_ref().unwrap_err();
        assert!(
            fault.contains("a line of more than 1048576 bytes that begins with `yyy"),
            "{fault}"
        );
        assert_eq!(lines.len(), 4);
        let long = [&vec![b'z'; LONGEST_LINE][..], b"\nlast"].concat();
        assert_eq!(
            lines_of(long.clone()),
            [Ok(long[..LONGEST_LINE].to_vec()), Ok(b"last".to_vec())]
        );
        assert_eq!(lines_of(b"a\n".to_vec()), [Ok(b"a".to_vec())]);
        assert!(lines_of(Vec::new()).is_empty());
    }

    #[test]
    fn a_wait_for_a_line_ends_and_keeps_what_was_read() {
        let (output, mut input) = io::pipe().unwrap();
        let mut lines = Lines::of(output, LONGEST_LINE);
        input.write_all(b"half").unwrap();
        assert!(matches!(lines.next(Duration::from_millis(5)), Next::Nothing));
        input.write_all(b" a line\nnext\n").unwrap();
        for expected in ["half a line", "next"] {
            let Next::Line(OutputLine::Whole(line)) = lines.next(Duration::ZERO) else { panic!() };
            assert_eq!(line, expected.as_bytes());
        }
    }
}
