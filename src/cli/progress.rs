//! A sweep as it is shown: bars on a terminal, lines elsewhere, JSON for programs, or nothing.

use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Value, json};

use crate::cli::estimate::{Episodes, Speeds, spoken};
use crate::cli::output::{counted, printable};
use crate::record::{Outcome, Results};
use crate::schedule::{Event, Found, Queued, Watcher};
use crate::train::Progress;

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
    running: Vec<Option<(Queued, Instant, Option<Progress>)>>,
    bars: Option<Bars>,
    told_waiting: bool,
}

struct Bars {
    all: MultiProgress,
    sweep: ProgressBar,
    workers: Vec<ProgressBar>,
}

impl Shown {
    /// A sweep of the jobs in `queue`; `speeds` are those of earlier sweeps.
    pub(super) fn new(style: Style, queue: &[Queued], workers: usize, speeds: Speeds) -> Self {
        let bars = (style == Style::Bars && !queue.is_empty())
            .then(|| Bars::new(queue.len(), workers.min(queue.len())));
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
            running: (0..workers.min(queue.len())).map(|_| None).collect(),
            bars,
            told_waiting: false,
        }
    }

    /// Seconds until the last job ends, if every algorithm left has been timed.
    fn seconds_left(&self) -> Option<f64> {
        let mut left = self.unbegun.clone();
        let mut speeds = self.speeds.clone();
        for (queued, started, progress) in self.running.iter().flatten() {
            let gone = progress.map_or(0, |p| p.episode);
            let ahead = queued.job.agent.episodes().saturating_sub(gone);
            left.add(queued.job.algorithm(), u64::from(ahead));
            speeds.add(queued.job.algorithm(), u64::from(gone), started.elapsed());
        }
        Some(speeds.seconds(&left)? / self.running.len().max(1) as f64)
    }

    fn left(&self) -> String {
        match self.seconds_left() {
            _ if self.done >= self.jobs => String::new(),
            Some(seconds) => format!(", about {} left", spoken(seconds)),
            None => String::new(),
        }
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
        self.tell(json!({ "event": "started", "worker": worker, "job": described(queued) }));
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
            let (done, jobs, left) = (self.done, self.jobs, self.left());
            self.say(&format!("[{done}/{jobs}] {}: {what}, {seconds:.1} s{left}", name(queued)));
        }
        let mut event = json!({
            "event": status, "worker": worker, "job": described(queued), "wall_seconds": seconds,
        });
        match outcome {
            Outcome::Completed(results) => event["mean_return"] = json!(mean_return(results)),
            Outcome::Failed(failure) => {
                event["kind"] = json!(failure.kind.name());
                event["message"] = json!(failure.message);
            }
            Outcome::Interrupted => {}
        }
        self.tell(event);
    }

    fn lose(&mut self, worker: usize, queued: &Queued) {
        self.rest(worker, queued);
        // Until it is known what became of it elsewhere.
        self.unbegun.add(queued.job.algorithm(), u64::from(queued.job.agent.episodes()));
        self.say(&format!("{}: another process has taken it over", name(queued)));
        self.tell(json!({ "event": "lost", "worker": worker, "job": described(queued) }));
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
        self.tell(json!({ "event": "skipped", "found": found, "job": described(queued) }));
    }

    fn shrink(&mut self, started: usize, reason: &io::Error) {
        let asked = self.running.len();
        self.running.truncate(started);
        if let Some(bars) = &mut self.bars {
            for bar in bars.workers.drain(started..) {
                bars.all.remove(&bar);
            }
        }
        let line =
            format!("going on with {started} of {asked} workers: no more threads ({reason})");
        match self.style {
            // Not even a program or a quiet run should wonder why it is slow.
            Style::Json | Style::Quiet => {
                let _ = writeln!(io::stderr(), "{line}");
            }
            Style::Bars | Style::Lines => self.say(&line),
        }
    }

    fn tick(&mut self, progress: &[Option<Progress>], waiting_for: usize) {
        for (running, progress) in self.running.iter_mut().zip(progress) {
            if let Some((_, _, latest)) = running {
                *latest = *progress;
            }
        }
        if waiting_for > 0 && !self.told_waiting {
            self.told_waiting = true;
            let jobs = counted(waiting_for, "job");
            self.say(&format!("waiting for {jobs} that another process is running"));
        }
    }

    fn draw(&self) {
        let Some(bars) = &self.bars else { return };
        bars.sweep.set_position(self.done as u64);
        bars.sweep.set_message(format!("{} failed{}", self.failed, self.left()));
        for (bar, running) in bars.workers.iter().zip(&self.running) {
            let text = match running {
                Some((queued, _, Some(progress))) => format!(
                    "{}: episode {} of {}, return {:.0}",
                    name(queued),
                    progress.episode,
                    progress.episodes,
                    progress.recent_return
                ),
                Some((queued, _, None)) => name(queued),
                None => "idle".to_owned(),
            };
            bar.set_message(text);
        }
    }
}

impl Watcher for Shown {
    fn hear(&mut self, event: Event<'_>) {
        match event {
            Event::Started { worker, queued } => self.begin(worker, queued),
            Event::Ended { worker, queued, outcome, wall } => {
                self.end(worker, queued, outcome, wall);
            }
            Event::Lost { worker, queued } => self.lose(worker, queued),
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
        sweep.set_style(style("[{elapsed_precise}] [{bar:40}] {pos}/{len} jobs, {wide_msg}"));
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

/// A job as people tell it from others: `dqn P-H-D sigma=0.4 seed=1 (1a2b3c4d)`.
pub(super) fn name(queued: &Queued) -> String {
    let Queued { key, agent, job } = queued;
    let key = &key.to_string()[..8];
    let (scenario, sigma, seed) = (&job.scenario, job.environment.sigma, job.seed);
    format!("{} {scenario} sigma={sigma} seed={seed} ({key})", printable(agent))
}

fn described(queued: &Queued) -> Value {
    json!({
        "job_key": queued.key.to_string(),
        "agent": queued.agent,
        "scenario": queued.job.scenario.to_string(),
        "sigma": queued.job.environment.sigma,
        "seed": queued.job.seed,
    })
}

fn mean_return(results: &Results) -> f64 {
    results.metrics.iter().find(|m| m.name == "mean_return").map_or(f64::NAN, |m| m.value)
}
