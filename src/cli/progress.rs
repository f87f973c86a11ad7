//! The progress of a sweep: bars on a terminal, lines elsewhere, JSON events for programs, or nothing.

use std::collections::HashMap;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use unicode_width::UnicodeWidthStr;

use crate::cli::output::counted;
use crate::cli::reader::Writer;
use crate::job::{Failure, Outcome};
use crate::key::printable;
use crate::plan::Swept;
use crate::report::rounded;
use crate::schedule::{
    self, CheckpointNote, Event, EventLog, EventSink, Found, Left, Queued, Speeds,
};
use crate::train::TrainingProgress;
use crate::watch::failures::without_numbers;

/// Maximum width of a worker's line after an indent of two, for a terminal of 80 columns.
const WORKER_WIDTH: usize = 77;

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProgressForm {
    /// Bars on standard error.
    Bars,
    /// One line per finished job on standard error.
    Lines,
    /// One object per event on standard output.
    Json,
    /// Nothing.
    Quiet,
}

impl ProgressForm {
    /// Bars on a terminal, lines elsewhere.
    pub(super) fn for_stderr() -> ProgressForm {
        if io::stderr().is_terminal() { ProgressForm::Bars } else { ProgressForm::Lines }
    }
}

/// Shows a sweep.
pub(super) struct Progress {
    style: ProgressForm,
    jobs: usize,
    done: usize,
    failed: usize,
    /// The number of jobs with each failure, by kind and message.
    failures: HashMap<(&'static str, String), usize>,
    speeds: Speeds,
    unbegun: Left,
    running: Vec<Option<(Queued, Instant, Option<TrainingProgress>)>>,
    bars: Option<Bars>,
    writer: Writer,
    waiting_reported: bool,
    swept: Swept,
    log: EventLog,
}

struct Bars {
    all: MultiProgress,
    sweep: ProgressBar,
    workers: Vec<ProgressBar>,
}

impl Progress {
    /// Progress of the jobs in `queue` on this number of workers, which may have other work, too; `speeds` come from
    /// earlier sweeps.
    pub(super) fn new(
        style: ProgressForm,
        queue: &[Queued],
        workers: usize,
        speeds: Speeds,
        swept: Swept,
    ) -> Self {
        let bars = (style == ProgressForm::Bars && !queue.is_empty())
            .then(|| Bars::new(queue.len(), workers));
        let mut unbegun = Left::default();
        for Queued { job, .. } in queue {
            unbegun.add(job, 1);
        }
        Progress {
            style,
            jobs: queue.len(),
            done: 0,
            failed: 0,
            failures: HashMap::new(),
            speeds,
            unbegun,
            running: (0..workers).map(|_| None).collect(),
            bars,
            writer: if style == ProgressForm::Json {
                Writer::of_data()
            } else {
                Writer::of_progress()
            },
            waiting_reported: false,
            log: EventLog::new(workers, swept.clone()),
            swept,
        }
    }

    /// The estimated time until the last job ends, in words; `None` once no job is left, or if it is not known.
    fn left(&self) -> Option<String> {
        let mut left = self.unbegun.clone();
        let mut speeds = self.speeds.clone();
        for (queued, started, progress) in self.running.iter().flatten() {
            let trained =
                progress.map_or(0.0, |p| f64::from(p.episode) / f64::from(p.episodes.max(1)));
            let part = queued.job.part_of_time(trained);
            left.add_running(&queued.job, 1.0 - part);
            speeds.add(&queued.job, part, started.elapsed());
        }
        let time = speeds.time(&left, self.running.len())?;
        (self.done < self.jobs).then(|| format!("about {}", schedule::spoken(time)))
    }

    /// Writes a line for people; ignores a closed standard error.
    fn say(&self, line: &str) {
        match (&self.bars, self.style) {
            (Some(bars), _) => {
                let (all, line) = (bars.all.clone(), line.to_owned());
                self.writer.write(move || drop(all.println(line)));
            }
            (None, ProgressForm::Bars | ProgressForm::Lines) => self.complain(line),
            (None, ProgressForm::Json | ProgressForm::Quiet) => {}
        }
    }

    /// Writes a line to standard error.
    fn complain(&self, line: &str) {
        let line = format!("{line}\n");
        self.writer.write(move || drop(io::stderr().write_all(line.as_bytes())));
    }

    fn emit(&mut self, event: &Event<'_>) {
        if self.style == ProgressForm::Json {
            for line in self.log.of(event) {
                self.writer.write(move || drop(writeln!(io::stdout(), "{line}")));
            }
        }
    }

    fn begin(&mut self, worker: usize, queued: &Queued) {
        self.unbegun.remove(&queued.job);
        self.running[worker] = Some((queued.clone(), Instant::now(), None));
    }

    /// Shows a worker as idle, unless it has already started another job.
    fn rest(&mut self, worker: usize, queued: &Queued) {
        self.running[worker].take_if(|(running, ..)| running.key == queued.key);
    }

    fn end(&mut self, worker: usize, queued: &Queued, outcome: &Outcome, wall: Duration) {
        self.rest(worker, queued);
        let seconds = wall.as_secs_f64();
        let mut is_news = false;
        let what = match outcome {
            Outcome::Completed(results) => {
                self.done += 1;
                self.speeds.add(&queued.job, 1.0, wall);
                format!("mean return {}", rounded(results.metric("mean_return"), 1))
            }
            Outcome::Failed(failure) => {
                self.done += 1;
                self.failed += 1;
                let same = self
                    .failures
                    .entry((failure.kind.word(), without_numbers(&failure.message)))
                    .or_default();
                *same += 1;
                is_news = *same == 1;
                described(failure, *same)
            }
            Outcome::Interrupted => "interrupted".to_owned(),
        };
        // On a terminal, the bars show completed jobs and the number of failed jobs.
        if self.style == ProgressForm::Lines || is_news {
            let (done, jobs, name) = (self.done, self.jobs, self.name(queued));
            let left = self.left().map_or_else(String::new, |time| format!(", {time} left"));
            self.say(&format!("[{done}/{jobs}] {name}: {what}, {seconds:.1} s{left}"));
        }
    }

    fn note(&mut self, worker: usize, queued: &Queued, note: &CheckpointNote) {
        let name = self.name(queued);
        match note {
            CheckpointNote::Resumed(resumed) => {
                if let Some((_, started, _)) = &mut self.running[worker] {
                    *started = started.checked_sub(resumed.worked).unwrap_or(*started);
                }
                if self.style == ProgressForm::Lines {
                    let (episode, episodes) = (resumed.episode, queued.job.agent.episodes());
                    let from = match episode < episodes {
                        true => format!("from episode {episode} of {episodes}"),
                        false => "with its test".to_owned(),
                    };
                    self.say(&format!("{name}: resumed {from}"));
                }
            }
            CheckpointNote::Refused { path, reason } => {
                let path = printable(&path.display().to_string());
                self.warn(&format!("{name}: checkpoint {path} rejected: {reason}"));
            }
            CheckpointNote::NotKept { path, reason } => {
                let path = printable(&path.display().to_string());
                self.warn(&format!(
                    "{name}: failed to write the checkpoint {path}: {reason}; the job continues, but \
                     its progress is lost if it is killed"
                ));
            }
        }
    }

    fn taken_over(&mut self, worker: usize, queued: &Queued) {
        self.rest(worker, queued);
        // The job counts as left until its outcome in the other process is known.
        self.unbegun.add(&queued.job, 1);
        self.say(&format!("{}: taken over by another process", self.name(queued)));
    }

    fn skip(&mut self, queued: &Queued, found: Found) {
        self.unbegun.remove(&queued.job);
        self.done += 1;
        self.failed += usize::from(found == Found::Failed);
    }

    fn shrink(&mut self, started: usize, reason: &io::Error) {
        let asked = self.running.len();
        self.running.truncate(started);
        if let Some(bars) = &mut self.bars {
            let (all, idle) = (bars.all.clone(), bars.workers.split_off(started));
            self.writer.write(move || idle.iter().for_each(|bar| all.remove(bar)));
        }
        self.warn(&format!(
            "only {started} of {asked} workers started: the system refused more threads ({reason})"
        ));
    }

    /// Writes a warning to standard error, also in JSON and quiet runs.
    fn warn(&self, line: &str) {
        match self.style {
            ProgressForm::Json | ProgressForm::Quiet => self.complain(line),
            ProgressForm::Bars | ProgressForm::Lines => self.say(line),
        }
    }

    fn tick(&mut self, progress: &[Option<TrainingProgress>], waiting_for: usize) {
        for (running, progress) in self.running.iter_mut().zip(progress) {
            if let Some((_, _, latest)) = running {
                *latest = *progress;
            }
        }
        if waiting_for > 0 && !self.waiting_reported {
            self.waiting_reported = true;
            let jobs = counted(waiting_for, "job");
            self.say(&format!("waiting for {jobs} that another process is running"));
        }
    }

    fn draw(&self) {
        // The bars stand still while nobody reads them.
        let Some(bars) = self.bars.as_ref().filter(|_| self.writer.is_idle()) else { return };
        let left = self.left().map_or_else(String::new, |time| format!(", {time} left"));
        let (done, message) = (self.done as u64, format!("{} failed{left}", self.failed));
        let text = |running: &Option<(Queued, Instant, Option<TrainingProgress>)>| match running {
            Some((queued, _, progress)) => {
                worker_line(*progress, &self.swept.name(&queued.agent, &queued.job))
            }
            None => "idle".to_owned(),
        };
        let texts: Vec<String> = self.running.iter().map(text).collect();
        let (sweep, workers) = (bars.sweep.clone(), bars.workers.clone());
        self.writer.write(move || {
            sweep.set_position(done);
            sweep.set_message(message);
            workers.iter().zip(texts).for_each(|(bar, text)| bar.set_message(text));
        });
    }

    /// The short name of a job: `dqn P-H-D sigma=0.4 seed=1 (1a2b3c4d)`.
    fn name(&self, queued: &Queued) -> String {
        let key = &queued.key.to_string()[..8];
        format!("{} ({key})", self.swept.name(&queued.agent, &queued.job))
    }
}

/// The line of a worker: its progress, then as much of the job's name as fits. The line is cut between
/// words, because a number without its last digits would be a different number.
fn worker_line(progress: Option<TrainingProgress>, name: &str) -> String {
    let mut line = match progress {
        Some(TrainingProgress { episode, episodes, recent_return, .. }) => {
            format!("{episode}/{episodes}, return {}:", rounded(recent_return, 0))
        }
        None => "starting:".to_owned(),
    };
    let mut words = name.split(' ').peekable();
    while let Some(word) = words.next() {
        let room = if words.peek().is_some() { WORKER_WIDTH - 2 } else { WORKER_WIDTH };
        if line.width() + 1 + word.width() > room {
            return line + " …";
        }
        line = format!("{line} {word}");
    }
    line
}

impl EventSink for Progress {
    fn on_event(&mut self, event: Event<'_>) {
        // Programs read one event of all estimates.
        if self.style == ProgressForm::Json && !event.is_of_run() {
            return;
        }
        self.emit(&event);
        match event {
            Event::Started { worker, queued } => self.begin(worker, queued),
            Event::Ended { worker, queued, outcome, wall } => {
                self.end(worker, queued, outcome, wall);
            }
            Event::Checkpoint { worker, queued, note } => self.note(worker, queued, note),
            Event::Lost { worker, queued } => self.taken_over(worker, queued),
            Event::Skipped { queued, found } => self.skip(queued, found),
            Event::FewerWorkers { started, reason } => self.shrink(started, reason),
            Event::Tick { progress, waiting_for } => self.tick(progress, waiting_for),
        }
        self.draw();
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        // Bars that are dropped may be drawn once more.
        if let Some(bars) = self.bars.take() {
            self.writer.write(move || {
                let _ = bars.all.clear();
                drop(bars);
            });
        }
    }
}

impl Bars {
    fn new(jobs: usize, workers: usize) -> Self {
        let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(10));
        let style = |template: &str| {
            ProgressStyle::with_template(template)
                .expect("the templates are written here")
                .progress_chars("=> ")
        };
        let sweep = all.add(ProgressBar::new(jobs as u64));
        let noun = if jobs == 1 { "job" } else { "jobs" };
        sweep.set_style(style(&format!(
            "{{elapsed_precise}} {{bar:16}} {{pos}}/{{len}} {noun}, {{wide_msg}}"
        )));
        let workers = (0..workers)
            .map(|_| {
                let bar = all.add(ProgressBar::no_length());
                bar.set_style(style("  {wide_msg}"));
                bar
            })
            .collect();
        Bars { all, sweep, workers }
    }
}

/// The failure of a job in words; `same` is the number of jobs with this failure so far.
fn described(failure: &Failure, same: usize) -> String {
    match same {
        1 => format!("failed ({}): {}", failure.kind, printable(&failure.message)),
        _ => format!("failed ({}) like {} before", failure.kind, counted(same - 1, "job")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_a_worker_leaves_out_whole_words() {
        let progress =
            TrainingProgress { episode: 123_456, episodes: 750_000, recent_return: -1234.4 };
        let begin = "123456/750000, return -1234: reinforce P-H-D sigma=0.6";
        let line = |name: &str| worker_line(Some(progress), name);
        let short = "reinforce P-H-D sigma=0.6 seed=12";
        assert_eq!(line(short), format!("{begin} seed=12"));
        let long = format!("{short} learning_rate=0.00051 batch=128");
        assert_eq!(line(&long), format!("{begin} seed=12 …"));
        assert_eq!(worker_line(None, short), format!("starting: {short}"));
        for digits in 1..40 {
            let name = format!("dqn P-H-D sigma=0.{} seed=1", "6".repeat(digits));
            assert!(line(&name).width() <= WORKER_WIDTH, "{}", line(&name));
        }
    }
}
