//! The pipes of a program: threads read its output and write its input, so that jitai can limit every wait.

use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use super::message::shown;

/// Capacity of the queue of unhandled lines; a full queue blocks the program.
const LINES_AHEAD: usize = 16;
/// Number of lines of standard error that are kept, and maximum bytes of each.
const TAIL_LINES: usize = 8;
const TAIL_BYTES: usize = 300;
/// Maximum wait for the end of standard error after the program has ended.
const LAST_WORDS: Duration = Duration::from_millis(300);

/// A line of standard output.
#[derive(Debug)]
pub(super) enum Line {
    /// A line without its line break.
    Whole(Vec<u8>),
    /// The beginning of a line that exceeds the maximum length.
    TooLong(Vec<u8>),
}

/// Sends every line of `output` until its end; `longest` is the maximum length of a line, in bytes.
pub(super) fn read_lines(
    output: impl Read + Send + 'static,
    longest: usize,
) -> io::Result<Receiver<Line>> {
    let (sender, lines) = mpsc::sync_channel(LINES_AHEAD);
    spawn("program's output", move || send_lines(output, longest, &sender))?;
    Ok(lines)
}

fn send_lines(output: impl Read, longest: usize, sender: &SyncSender<Line>) {
    let mut output = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        let most = longest as u64 + 1;
        match output.by_ref().take(most).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let is_whole = line.pop_if(|last| *last == b'\n').is_some();
        line.pop_if(|last| *last == b'\r');
        let is_too_long = !is_whole && line.len() > longest;
        let line = if is_too_long { Line::TooLong(line) } else { Line::Whole(line) };
        // Stops at a closed receiver, and after a line that is too long.
        if sender.send(line).is_err() || is_too_long {
            return;
        }
    }
}

/// Writes everything that is sent to `input`, and closes `input` once all senders are dropped. A program
/// that does not read blocks only this thread.
pub(super) fn write_all(mut input: impl Write + Send + 'static) -> io::Result<Sender<Vec<u8>>> {
    let (sender, bytes) = mpsc::channel::<Vec<u8>>();
    spawn("program's input", move || {
        for bytes in bytes {
            // The program has closed its input; the reading side detects its end.
            if input.write_all(&bytes).and_then(|()| input.flush()).is_err() {
                return;
            }
        }
    })?;
    Ok(sender)
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

impl Line {
    /// The line; or, for a line that is too long, an error with the `expected` message.
    pub(super) fn whole(self, expected: &str) -> Result<Vec<u8>, String> {
        match self {
            Line::Whole(line) => Ok(line),
            Line::TooLong(line) => Err(format!(
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

    #[test]
    fn lines_are_cut_at_their_breaks_and_long_ones_end_the_reading() {
        let text = [&b"one\r\n\ntwo"[..], b"\n", &vec![b'y'; LONGEST_LINE + 5]].concat();
        let lines = read_lines(io::Cursor::new(text), LONGEST_LINE).unwrap();
        let lines: Vec<Result<Vec<u8>, String>> =
            lines.iter().map(|line| line.whole("a message")).collect();
        assert_eq!(lines[..3], [Ok(b"one".to_vec()), Ok(Vec::new()), Ok(b"two".to_vec())]);
        let fault = lines[3].as_ref().unwrap_err();
        assert!(
            fault.contains("a line of more than 1048576 bytes that begins with `yyy"),
            "{fault}"
        );
        assert_eq!(lines.len(), 4);
    }
}
