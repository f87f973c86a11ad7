//! A sweep as it is shown: bars on a terminal, lines elsewhere, JSON for programs, or nothing.

use std::collections::VecDeque;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Value, json};

use crate::cli::output::counted;
use crate::manifest::printable;
use crate::plan::Swept;
use crate::record::{Outcome, Results};
use crate::schedule::{
    CheckpointNote, Episodes, Estimate, Event, EventSink, Found, Queued, Speeds,
};
use crate::train::TrainingProgress;

/// Columns that the line of a worker takes at most, behind an indent of two, on a terminal of 80.
const WORKER_WIDTH: usize = 77;

/// How a sweep is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    /// Bars on standard error.
    Bars,
    /// A line an ended job on standard error.
    Lines,
    /// An object an event on standard output.
    Json,
    /// Nothing.
    Quiet,
}

impl Style {
    /// Bars on a terminal, lines elsewhere.
    pub(super) fn for_stderr() -> Style {
        if io::stderr().is_terminal() { Style::Bars } else { Style::Lines }
    }
}

/// Shows a sweep.
pub(super) struct Shown {
    style: Style,
    jobs: usize,
    done: usize,
    failed: usize,
    speeds: Speeds,
    unbegun: Episodes,
    running: Vec<Option<(Queued, Instant, Option<TrainingProgress>)>>,
    bars: Option<Bars>,
    told_waiting: bool,
    swept: Swept,
    telling: Vec<Telling>,
}

/// What programs are told of one worker. Its jobs are stored a moment after they end, so it may be
/// at its next ones by then: these are told of later.
#[derive(Debug, Default)]
struct Telling {
    /// Whether a job that was told to have started has not been told to have ended.
    open: bool,
    later: VecDeque<Value>,
}

impl Telling {
    /// What to tell now that something happened to the job that started last.
    fn note(&mut self, event: Value) -> Option<Value> {
        if self.later.is_empty() {
            return Some(event);
        }
        self.later.push_back(event);
        None
    }

    /// What to tell now that a job has started.
    fn start(&mut self, event: Value) -> Option<Value> {
        if self.open {
            self.later.push_back(event);
            return None;
        }
        self.open = true;
        Some(event)
    }

    /// What to tell after the end of the job that was told of last: the start of the next, and what
    /// happened to it since.
    fn end(&mut self) -> Vec<Value> {
        let starts = |event: &Value| event["event"] == "started";
        let next = self.later.iter().skip(1).position(starts);
        let count = next.map_or(self.later.len(), |after_first| after_first + 1);
        let told: Vec<Value> = self.later.drain(..count).collect();
        self.open = !told.is_empty();
        told
    }
}

struct Bars {
    all: MultiProgress,
    sweep: ProgressBar,
    workers: Vec<ProgressBar>,
}

impl Shown {
    /// A sweep of the jobs in `queue`; `speeds` are those of earlier sweeps.
    pub(super) fn new(
        style: Style,
        queue: &[Queued],
        workers: usize,
        speeds: Speeds,
        swept: Swept,
    ) -> Self {
        let workers = workers.min(queue.len());
        let bars =
            (style == Style::Bars && !queue.is_empty()).then(|| Bars::new(queue.len(), workers));
        let mut unbegun = Episodes::default();
        for Queued { job, .. } in queue {
            unbegun.add(job.algorithm(), u64::from(job.agent.episodes()));
        }
        Shown {
            style,
            jobs: queue.len(),
            done: 0,
            failed: 0,
            speeds,
            unbegun,
            running: (0..workers).map(|_| None).collect(),
            bars,
            told_waiting: false,
            swept,
            telling: (0..workers).map(|_| Telling::default()).collect(),
        }
    }

    /// The time until the last job ends.
    fn time_left(&self) -> Estimate {
        let mut left = self.unbegun.clone();
        let mut speeds = self.speeds.clone();
        for (queued, started, progress) in self.running.iter().flatten() {
            let gone = progress.map_or(0, |p| p.episode);
            let ahead = queued.job.agent.episodes().saturating_sub(gone);
            left.add(queued.job.algorithm(), u64::from(ahead));
            speeds.add(queued.job.algorithm(), u64::from(gone), started.elapsed());
        }
        speeds.estimate(&left).shared_by(self.running.len())
    }

    /// The time left, if something is known of it, as people say it.
    fn left(&self) -> Option<String> {
        self.time_left().spoken().filter(|_| self.done < self.jobs)
    }

    /// Writes a line for a person; a closed standard error ends nothing.
    fn say(&self, line: &str) {
        match (&self.bars, self.style) {
            (Some(bars), _) => {
                let _ = bars.all.println(line);
            }
            (None, Style::Bars | Style::Lines) => {
                let _ = writeln!(io::stderr(), "{line}");
            }
            (None, Style::Json | Style::Quiet) => {}
        }
    }

    fn tell(&self, event: Value) {
        if self.style == Style::Json {
            let _ = writeln!(io::stdout(), "{event}");
        }
    }

    fn begin(&mut self, worker: usize, queued: &Queued) {
        self.unbegun.remove(&queued.job);
        self.running[worker] = Some((queued.clone(), Instant::now(), None));
        let event = json!({
            "event": "started", "worker": worker, "job": self.described(queued),
        });
        if let Some(event) = self.telling[worker].start(event) {
            self.tell(event);
        }
    }

    /// Shows a worker as idle, unless it has begun another job already.
    fn rest(&mut self, worker: usize, queued: &Queued) {
        self.running[worker].take_if(|(running, ..)| running.key == queued.key);
    }

    fn end(&mut self, worker: usize, queued: &Queued, outcome: &Outcome, wall: Duration) {
        self.rest(worker, queued);
        let seconds = wall.as_secs_f64();
        let (status, what) = match outcome {
            Outcome::Completed(results) => {
                self.done += 1;
                let episodes = u64::from(queued.job.agent.episodes());
                self.speeds.add(queued.job.algorithm(), episodes, wall);
                ("completed", format!("mean return {:.1}", mean_return(results)))
            }
            Outcome::Failed(failure) => {
                self.done += 1;
                self.failed += 1;
                ("failed", format!("failed ({}): {}", failure.kind, printable(&failure.message)))
            }
            Outcome::Interrupted => ("interrupted", "interrupted".to_owned()),
        };
        // On a terminal the bars say how completed jobs did.
        if self.style == Style::Lines || matches!(outcome, Outcome::Failed(_)) {
            let (done, jobs, name) = (self.done, self.jobs, self.name(queued));
            let left = self.left().map_or_else(String::new, |time| format!(", {time} left"));
            self.say(&format!("[{done}/{jobs}] {name}: {what}, {seconds:.1} s{left}"));
        }
        let mut event = json!({
            "event": status, "worker": worker, "job": self.described(queued),
            "wall_seconds": seconds,
        });
        match outcome {
            Outcome::Completed(results) => event["mean_return"] = json!(mean_return(results)),
            Outcome::Failed(failure) => {
                event["kind"] = json!(failure.kind.name());
                event["message"] = json!(failure.message);
            }
            Outcome::Interrupted => {}
        }
        self.tell_end(worker, event);
    }

    /// Tells that the job of a worker has ended.
    fn tell_end(&mut self, worker: usize, event: Value) {
        self.tell(event);
        for next in self.telling[worker].end() {
            self.tell(next);
        }
    }

    fn note(&mut self, worker: usize, queued: &Queued, note: &CheckpointNote) {
        let name = self.name(queued);
        let mut event = json!({ "worker": worker, "job": self.described(queued) });
        match note {
            CheckpointNote::Resumed(resumed) => {
                if let Some((_, started, _)) = &mut self.running[worker] {
                    *started = started.checked_sub(resumed.worked).unwrap_or(*started);
                }
                if self.style == Style::Lines {
                    let (episode, episodes) = (resumed.episode, queued.job.agent.episodes());
                    let from = match episode < episodes {
                        true => format!("from episode {episode} of {episodes}"),
                        false => "with its test".to_owned(),
                    };
                    self.say(&format!("{name}: goes on {from}"));
                }
                event["event"] = json!("resumed");
                event["episode"] = json!(resumed.episode);
            }
            CheckpointNote::Refused { path, reason } => {
                let path = printable(&path.display().to_string());
                self.warn(&format!("{name}: the checkpoint {path} is not used: {reason}"));
                event["event"] = json!("checkpoint_refused");
                event["file"] = json!(path);
                event["reason"] = json!(reason.to_string());
            }
            CheckpointNote::NotKept { path, reason } => {
                let path = printable(&path.display().to_string());
                self.warn(&format!(
                    "{name}: failed to write the checkpoint {path}: {reason}; the job goes on, and \
                     loses what it has done if it is killed"
                ));
                event["event"] = json!("checkpoint_not_kept");
                event["file"] = json!(path);
                event["reason"] = json!(reason.to_string());
            }
        }
        if let Some(event) = self.telling[worker].note(event) {
            self.tell(event);
        }
    }

    fn taken_over(&mut self, worker: usize, queued: &Queued) {
        self.rest(worker, queued);
        // Until it is known what became of it elsewhere.
        self.unbegun.add(queued.job.algorithm(), u64::from(queued.job.agent.episodes()));
        self.say(&format!("{}: another process has taken it over", self.name(queued)));
        let event = json!({ "event": "lost", "worker": worker, "job": self.described(queued) });
        self.tell_end(worker, event);
    }

    fn skip(&mut self, queued: &Queued, found: Found) {
        self.unbegun.remove(&queued.job);
        self.done += 1;
        let found = match found {
            Found::Completed => "completed",
            Found::Failed => {
                self.failed += 1;
                "failed"
            }
        };
        self.tell(json!({ "event": "skipped", "found": found, "job": self.described(queued) }));
    }

    fn shrink(&mut self, started: usize, reason: &io::Error) {
        let asked = self.running.len();
        self.running.truncate(started);
        if let Some(bars) = &mut self.bars {
            for bar in bars.workers.drain(started..) {
                bars.all.remove(&bar);
            }
        }
        self.warn(&format!(
            "going on with {started} of {asked} workers: no more threads ({reason})"
        ));
    }

    /// Writes what not even a program or a quiet run should have to wonder about.
    fn warn(&self, line: &str) {
        match self.style {
            Style::Json | Style::Quiet => {
                let _ = writeln!(io::stderr(), "{line}");
            }
            Style::Bars | Style::Lines => self.say(line),
        }
    }

    fn tick(&mut self, progress: &[Option<TrainingProgress>], waiting_for: usize) {
        for (running, progress) in self.running.iter_mut().zip(progress) {
            if let Some((_, _, latest)) = running {
                *latest = *progress;
            }
        }
        if waiting_for > 0 && !self.told_waiting {
            self.told_waiting = true;
            let jobs = counted(waiting_for, "job");
            self.say(&format!("waiting for {jobs} that another process has taken"));
        }
    }

    fn draw(&self) {
        let Some(bars) = &self.bars else { return };
        bars.sweep.set_position(self.done as u64);
        let left = self.left().map_or_else(String::new, |time| format!(", {time} left"));
        bars.sweep.set_message(format!("{} failed{left}", self.failed));
        for (bar, running) in bars.workers.iter().zip(&self.running) {
            let text = match running {
                Some((queued, _, progress)) => {
                    worker_line(*progress, &self.swept.name(&queued.agent, &queued.job))
                }
                None => "idle".to_owned(),
            };
            bar.set_message(text);
        }
    }

    /// A job as people tell it from others: `dqn P-H-D sigma=0.4 seed=1 (1a2b3c4d)`.
    fn name(&self, queued: &Queued) -> String {
        let key = &queued.key.to_string()[..8];
        format!("{} ({key})", self.swept.name(&queued.agent, &queued.job))
    }

    fn described(&self, queued: &Queued) -> Value {
        json!({
            "job_key": queued.key.to_string(),
            "agent": queued.agent,
            "scenario": queued.job.scenario.to_string(),
            "sigma": queued.job.environment.sigma,
            "seed": queued.job.seed,
            "swept": self.swept.object(&queued.agent, &queued.job),
        })
    }
}

/// What a worker is at: how far it has come, then the job as far as there is room. Whole words are
/// left out at the end, because a number without its last digits is another number.
fn worker_line(progress: Option<TrainingProgress>, name: &str) -> String {
    let mut line = match progress {
        Some(TrainingProgress { episode, episodes, recent_return, .. }) => {
            format!("{episode}/{episodes}, return {recent_return:.0}:")
        }
        None => "begins:".to_owned(),
    };
    let mut words = name.split(' ').peekable();
    while let Some(word) = words.next() {
        let room = if words.peek().is_some() { WORKER_WIDTH - 2 } else { WORKER_WIDTH };
        if line.chars().count() + 1 + word.chars().count() > room {
            return line + " …";
        }
        line = format!("{line} {word}");
    }
    line
}

impl EventSink for Shown {
    fn on_event(&mut self, event: Event<'_>) {
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

impl Drop for Shown {
    fn drop(&mut self) {
        if let Some(bars) = &self.bars {
            let _ = bars.all.clear();
        }
    }
}

impl Bars {
    fn new(jobs: usize, workers: usize) -> Self {
        let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(10));
        let style = |template| {
            ProgressStyle::with_template(template)
                .expect("the templates are written here")
                .progress_chars("=> ")
        };
        let sweep = all.add(ProgressBar::new(jobs as u64));
        sweep.set_style(style("{elapsed_precise} {bar:16} {pos}/{len} jobs, {wide_msg}"));
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

fn mean_return(results: &Results) -> f64 {
    results.metrics.iter().find(|m| m.name == "mean_return").map_or(f64::NAN, |m| m.value)
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
        assert_eq!(worker_line(None, short), format!("begins: {short}"));
        for digits in 1..40 {
            let name = format!("dqn P-H-D sigma=0.{} seed=1", "6".repeat(digits));
            assert!(line(&name).chars().count() <= WORKER_WIDTH, "{}", line(&name));
        }
    }

    #[test]
    fn programs_hear_of_an_end_before_the_worker_s_next_start() {
        let mut telling = Telling::default();
        let start = |job| json!({ "event": "started", "job": job });
        let [one, two, three] = [1, 2, 3].map(start);
        let note = json!({ "event": "resumed", "job": 2 });
        assert_eq!(telling.start(one.clone()), Some(one));
        assert_eq!(telling.start(two.clone()), None);
        assert_eq!(telling.note(note.clone()), None);
        assert_eq!(telling.start(three.clone()), None);
        assert_eq!(telling.end(), [two, note]);
        assert_eq!(telling.end(), vec![three.clone()]);
        assert_eq!(telling.note(json!("now")), Some(json!("now")));
        assert!(telling.end().is_empty());
        assert_eq!(telling.start(three.clone()), Some(three));
    }
}
