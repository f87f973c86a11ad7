//! The progress of a long command on standard error: a bar on a terminal, a line every ten seconds
//! elsewhere, and nothing for a command that ends within two seconds.

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::reader::say;

/// Time before the first line or bar.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time between two lines if standard error is not a terminal.
const BETWEEN_LINES: Duration = Duration::from_secs(10);

/// A counter of items that are processed one after the other.
pub(super) struct Counting {
    bar: ProgressBar,
    terminal: bool,
    what: &'static str,
    of: usize,
    done: usize,
    said: bool,
    /// When the next line is due.
    due: Instant,
}

impl Counting {
    /// A count from 0 to `of`; `what` is the noun after the number.
    pub(super) fn new(of: usize, what: &'static str) -> Self {
        let style = ProgressStyle::with_template("{elapsed_precise} {bar:16} {pos}/{len} {msg}")
            .expect("the template is written here")
            .progress_chars("=> ");
        let bar = ProgressBar::hidden().with_style(style).with_message(what);
        bar.set_length(of as u64);
        let terminal = io::stderr().is_terminal();
        Counting { bar, terminal, what, of, done: 0, said: false, due: Instant::now() + PATIENCE }
    }

    /// Counts one more as done.
    pub(super) fn one_more(&mut self) {
        self.advance(self.done + 1, self.of);
    }

    /// Sets the number of processed items, and the total.
    pub(super) fn advance(&mut self, done: usize, of: usize) {
        (self.done, self.of) = (done, of);
        self.bar.set_length(of as u64);
        self.bar.set_position(done as u64);
        // Once shown, a count is also shown at its end.
        let ends = self.said && self.done == self.of;
        if Instant::now() < self.due && !ends {
            return;
        }
        self.said = true;
        self.due = Instant::now() + BETWEEN_LINES;
        if !self.terminal {
            say(&format!("{} of {} {}", self.done, self.of, self.what));
        } else if self.bar.is_hidden() {
            self.bar.set_draw_target(indicatif::ProgressDrawTarget::stderr_with_hz(10));
        }
    }
}

impl Drop for Counting {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
