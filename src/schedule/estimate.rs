//! Estimates of the remaining time, from expected times and from measured times of other jobs.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::job::Job;
use crate::store::{Reader, StoreError};

/// The ratio of measured to expected training times, by algorithm.
#[derive(Clone, Debug, Default)]
pub struct Speeds(BTreeMap<String, Timed>);

/// Measured and expected times of the same jobs, in seconds.
#[derive(Clone, Copy, Debug, Default)]
struct Timed {
    measured: f64,
    expected: f64,
}

impl Timed {
    fn ratio(self) -> Option<f64> {
        (self.expected > 0.0).then_some(self.measured / self.expected)
    }
}

impl Speeds {
    /// The speeds of the runs in a store.
    pub fn of(reader: &Reader) -> Result<Speeds, StoreError> {
        let mut speeds = Speeds::default();
        let mut runs = BTreeMap::<String, u64>::new();
        for pace in reader.paces()? {
            let algorithm = pace.job.algorithm();
            let expected = pace.job.expected_time().as_secs_f64() * pace.runs as f64;
            speeds.add_seconds(algorithm, expected, pace.seconds);
            *runs.entry(algorithm.to_owned()).or_default() += pace.runs;
        }
        // Earlier runs together count as one mean job, so measurements of this sweep soon outweigh them.
        for (algorithm, timed) in &mut speeds.0 {
            let runs = runs.get(algorithm).map_or(1.0, |runs| *runs as f64);
            timed.measured /= runs;
            timed.expected /= runs;
        }
        Ok(speeds)
    }

    /// Adds the measured time of a part, from 0 to 1, of a job's training.
    pub fn add(&mut self, job: &Job, part: f64, wall: Duration) {
        let expected = job.expected_time().as_secs_f64() * part;
        self.add_seconds(job.algorithm(), expected, wall.as_secs_f64());
    }

    fn add_seconds(&mut self, algorithm: &str, expected: f64, measured: f64) {
        let timed = self.0.entry(algorithm.to_owned()).or_default();
        timed.measured += measured;
        timed.expected += expected;
    }

    /// Whether anything has been measured.
    pub fn are_measured(&self) -> bool {
        self.0.values().any(|timed| timed.ratio().is_some())
    }

    /// The time that one core needs for the remaining work. An algorithm without measurements gets the ratio
    /// of all other algorithms together.
    pub fn time(&self, left: &Left) -> Duration {
        let all = self.0.values().fold(Timed::default(), |sum, timed| Timed {
            measured: sum.measured + timed.measured,
            expected: sum.expected + timed.expected,
        });
        let usual = all.ratio().unwrap_or(1.0);
        let seconds = left.0.iter().map(|(algorithm, expected)| {
            let ratio = self.0.get(algorithm).and_then(|timed| timed.ratio());
            ratio.unwrap_or(usual) * expected.as_secs_f64()
        });
        Duration::try_from_secs_f64(seconds.sum()).unwrap_or(Duration::MAX)
    }

    /// The time that one core needs for a job, in seconds.
    pub fn seconds(&self, job: &Job) -> f64 {
        let mut left = Left::default();
        left.add(job, 1);
        self.time(&left).as_secs_f64()
    }
}

/// The expected time of the remaining work, by algorithm.
#[derive(Clone, Debug, Default)]
pub struct Left(BTreeMap<String, Duration>);

impl Left {
    /// Adds `count` jobs that differ only in their seeds.
    pub fn add(&mut self, job: &Job, count: u64) {
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        self.add_time(job, job.expected_time().saturating_mul(count));
    }

    /// Adds the unfinished part, from 0 to 1, of a running job.
    pub fn add_part(&mut self, job: &Job, part: f64) {
        let ahead = Duration::try_from_secs_f64(job.expected_time().as_secs_f64() * part);
        self.add_time(job, ahead.unwrap_or(Duration::MAX));
    }

    fn add_time(&mut self, job: &Job, time: Duration) {
        match self.0.get_mut(job.algorithm()) {
            Some(left) => *left = left.saturating_add(time),
            None => drop(self.0.insert(job.algorithm().to_owned(), time)),
        }
    }

    /// Removes a job that was added before.
    pub fn remove(&mut self, job: &Job) {
        if let Some(left) = self.0.get_mut(job.algorithm()) {
            *left = left.saturating_sub(job.expected_time());
        }
    }
}

/// The time that the work of `jobs` jobs takes when `workers` workers share it, of which each runs one job at
/// a time.
pub fn shared(time: Duration, workers: usize, jobs: u64) -> Duration {
    let busy = usize::try_from(jobs).map_or(workers, |jobs| workers.min(jobs));
    let seconds = time.as_secs_f64() / busy.max(1) as f64;
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}

/// A duration in words: `45 s`, `12 min`, `3 h 20 min`.
pub fn spoken(time: Duration) -> String {
    let whole = time.as_secs_f64().round() as u64;
    match (whole / 3600, whole / 60 % 60) {
        (0, _) if whole < 100 => format!("{whole} s"),
        (0, minutes) => format!("{minutes} min"),
        (hours, minutes) if hours < 48 => format!("{hours} h {minutes} min"),
        (hours, _) => format!("{} days", hours / 24),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{manifest, plan};

    fn job(agent: &str) -> Job {
        let text = format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 1\n\
             environment.sigma = 0.6\n[[agent]]\nname = \"a\"\n{agent}"
        );
        let manifest = manifest::parse("t", text.as_bytes()).unwrap();
        plan::jobs(&manifest).next().unwrap().job
    }

    fn seconds(speeds: &Speeds, left: &Left) -> f64 {
        speeds.time(left).as_secs_f64()
    }

    #[test]
    fn time_left_is_expected_until_it_is_measured() {
        let job = job("algorithm = \"reinforce\"\nepisodes = 15000\n");
        let expected = job.expected_time().as_secs_f64();
        let (mut left, mut speeds) = (Left::default(), Speeds::default());
        left.add(&job, 2);
        assert!((seconds(&speeds, &left) - 2.0 * expected).abs() < 1e-8);
        assert!(!speeds.are_measured());
        speeds.add(&job, 0.25, Duration::from_secs(5));
        assert!(speeds.are_measured());
        assert!((seconds(&speeds, &left) - 40.0).abs() < 1e-6);
        left.remove(&job);
        left.add_part(&job, 0.5);
        assert!((seconds(&speeds, &left) - 30.0).abs() < 1e-6);
        left.remove(&job);
        left.remove(&job);
        assert_eq!(speeds.time(&left), Duration::ZERO);
    }

    #[test]
    fn an_algorithm_that_was_not_timed_is_as_slow_as_the_others() {
        let reinforce = job("algorithm = \"reinforce\"\n");
        let dqn = job("algorithm = \"dueling_dqn\"\n");
        let mut speeds = Speeds::default();
        speeds.add(&reinforce, 1.0, reinforce.expected_time() * 3);
        let expected = dqn.expected_time().as_secs_f64();
        assert!((speeds.seconds(&dqn) / expected - 3.0).abs() < 1e-6);
    }

    #[test]
    fn expected_times_grow_with_the_multiply_adds() {
        let with = |keys: &str| job(&format!("algorithm = \"dueling_dqn\"\n{keys}"));
        let time = |keys: &str| with(keys).expected_time().as_secs_f64();
        let usual = time("");
        assert!((1.8..2.2).contains(&(time("episodes = 2000") / usual)));
        assert!((3.0..4.5).contains(&(time("layers = [256, 256]") / usual)));
        assert!(time("batch = 128") > 1.5 * usual);
        assert!(time("engine = \"burn\"") > 3.0 * usual);
    }

    #[test]
    fn no_more_workers_share_the_work_than_there_are_jobs() {
        let minute = Duration::from_secs(60);
        for (workers, jobs, expected) in [(1, 9, 60), (4, 9, 15), (4, 2, 30), (4, 0, 60)] {
            assert_eq!(shared(minute, workers, jobs), Duration::from_secs(expected));
        }
    }

    #[test]
    fn durations_are_spoken_in_the_unit_that_matters() {
        let cases = [
            (0.4, "0 s"),
            (59.6, "60 s"),
            (125.0, "2 min"),
            (3600.0, "1 h 0 min"),
            (12_000.0, "3 h 20 min"),
            (500_000.0, "5 days"),
        ];
        for (seconds, expected) in cases {
            assert_eq!(spoken(Duration::from_secs_f64(seconds)), expected);
        }
    }
}
