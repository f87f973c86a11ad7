//! What a watcher sees, as plain data.

use std::time::Duration;

use crate::job::MetricName;
use crate::schedule::spoken;
use crate::store::Counts;
use crate::watch::band::Band;

/// What to show.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ViewChoice {
    /// The experiment; `None` for the one that runs, or else the latest one.
    pub experiment: Option<String>,
    /// The number of the arm whose curve has a spread.
    pub arm: usize,
    /// The numbers of the arms that are shown with it.
    pub beside: Vec<usize>,
    /// The number of the metric among those of the arm.
    pub metric: usize,
}

/// An experiment at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// The name of the experiment.
    pub experiment: String,
    /// All experiments of the store.
    pub experiments: Vec<String>,
    /// Its jobs by state; of those that the filter selects, if there is one.
    pub counts: Counts,
    /// The filter of the commands that run its jobs, and how many it selects; `None` if a command runs all.
    pub filter: Option<String>,
    /// The estimated time until the last job ends; `None` if no job is left, no process runs one, or it
    /// is not known.
    pub left: Option<Duration>,
    /// Its arms, in the order of the manifest.
    pub arms: Vec<ArmView>,
    /// The jobs that run, the most advanced first.
    pub running: Vec<RunningView>,
    /// Its different failures.
    pub failures: Vec<FailureView>,
    /// Where the races of its search stand, one line for each.
    pub races: Vec<String>,
    /// The state of its submissions to a cluster, one line for each.
    pub submissions: Vec<String>,
    /// The number of chunks of its submissions that may still hand in results.
    pub held: usize,
    /// The learning curves that were chosen.
    pub chart: CurveChart,
}

impl View {
    /// The lines about its races and submissions.
    pub fn notes(&self) -> impl Iterator<Item = &String> {
        self.races.iter().chain(&self.submissions)
    }

    /// The jobs by state, and the time left.
    pub fn summary(&self) -> String {
        let counts = &self.counts;
        let mut words = vec![format!("{} of {} completed", counts.completed, counts.total())];
        let others = [
            (counts.running, "running"),
            (counts.pending, "pending"),
            (counts.interrupted, "interrupted"),
            (counts.failed, "failed"),
        ];
        let others = others.iter().filter(|(count, _)| *count > 0);
        words.extend(others.map(|(count, state)| format!("{count} {state}")));
        words.extend(self.left.map(|left| format!("about {} left", spoken(left))));
        let filter = self.filter.as_ref().map(|filter| format!(" ({filter})"));
        words.join(", ") + &filter.unwrap_or_default()
    }
}

/// An arm: the jobs that differ in their seeds alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ArmView {
    /// Its name.
    pub name: String,
    /// Its jobs by state.
    pub counts: Counts,
    /// The mean return of the tests of its completed jobs.
    pub mean_return: Option<f64>,
}

/// A running job.
#[derive(Clone, Debug, PartialEq)]
pub struct RunningView {
    /// Its short name.
    pub name: String,
    /// The finished part of its training, from 0 to 1; `None` in its first seconds.
    pub part: Option<f64>,
}

/// The jobs that failed in one way.
#[derive(Clone, Debug, PartialEq)]
pub struct FailureView {
    /// The short name of the first of them.
    pub name: String,
    /// The kind of failure, and its message.
    pub reason: String,
    /// The number of these jobs.
    pub jobs: usize,
}

/// Learning curves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurveChart {
    /// The metric; `None` if there is no arm.
    pub metric: Option<MetricName>,
    /// The number of metrics to choose from.
    pub metrics: usize,
    /// The number of training episodes.
    pub episodes: u32,
    /// The number of the arm and its line. The chosen arm is first.
    pub lines: Vec<(usize, Vec<Band>)>,
}
