//! Estimates of the remaining time, from expected times and from measured times of other jobs.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::time::Duration;

use crate::job::Job;
use crate::store::{Reader, StoreError};

/// An algorithm, the outside programs that take part, and the expected time of a job. Jobs that differ only in seeds
/// and rates are of one kind.
type Kind = (String, String, Duration);

fn kind(job: &Job) -> Kind {
    (job.algorithm().to_owned(), job.programs().join(" "), job.expected_time())
}

/// Measured times of jobs, by kind.
#[derive(Clone, Debug, Default)]
pub struct Speeds(BTreeMap<Kind, Timed>);

/// Measured and expected times of the same jobs, in seconds.
#[derive(Clone, Copy, Debug, Default)]
struct Timed {
    measured: f64,
    expected: f64,
}

impl Timed {
    fn sum<'t>(all: impl Iterator<Item = &'t Timed>) -> Timed {
        all.fold(Timed::default(), |sum, timed| Timed {
            measured: sum.measured + timed.measured,
            expected: sum.expected + timed.expected,
        })
    }

    fn ratio(self) -> Option<f64> {
        (self.expected > 0.0).then_some(self.measured / self.expected)
    }
}

/// The part of a job whose measurement outweighs those of other kinds of jobs.
const OWN: f64 = 0.1;

impl Speeds {
    /// The speeds of the runs in a store.
    pub fn of(reader: &Reader) -> Result<Speeds, StoreError> {
        let mut speeds = Speeds::default();
        let mut runs = BTreeMap::<Kind, u64>::new();
        for pace in reader.paces()? {
            let kind = kind(&pace.job);
            *runs.entry(kind.clone()).or_default() += pace.runs;
            let timed = speeds.0.entry(kind).or_default();
            timed.expected += pace.job.expected_time().as_secs_f64() * pace.runs as f64;
            timed.measured += pace.seconds;
        }
        // Earlier runs of a kind together count as one mean job, so measurements of this sweep soon outweigh them.
        for (kind, timed) in &mut speeds.0 {
            let runs = runs.get(kind).map_or(1.0, |runs| *runs as f64);
            timed.measured /= runs;
            timed.expected /= runs;
        }
        Ok(speeds)
    }

    /// Adds the measured time of a part, from 0 to 1, of a job. A job without progress says nothing yet.
    pub fn add(&mut self, job: &Job, part: f64, wall: Duration) {
        if part <= 0.0 {
            return;
        }
        let timed = self.0.entry(kind(job)).or_default();
        timed.measured += wall.as_secs_f64();
        timed.expected += job.expected_time().as_secs_f64() * part;
    }

    /// Whether anything has been measured.
    pub fn are_measured(&self) -> bool {
        self.0.values().any(|timed| timed.ratio().is_some())
    }

    /// Whether the time of a kind is known: an outside program takes the time that it took before.
    fn know(&self, (algorithm, programs, _): &Kind) -> bool {
        let is_alike = |(kind, timed): (&Kind, &Timed)| {
            (&kind.0, &kind.1) == (algorithm, programs) && timed.ratio().is_some()
        };
        programs.is_empty() || self.0.iter().any(is_alike)
    }

    /// The time until the last job ends, when `workers` workers run one job at a time, in the order of the jobs;
    /// `None` if an outside program takes part that has not been timed.
    pub fn time(&self, left: &Left, workers: usize) -> Option<Duration> {
        let waiting = left.waiting.iter().filter(|(_, count)| *count > 0).map(|(kind, _)| kind);
        let mut kinds = left.running.iter().map(|(kind, _)| kind).chain(waiting);
        if !kinds.all(|kind| self.know(kind)) {
            return None;
        }
        let mut known: HashMap<&Kind, Duration> = HashMap::new();
        let kinds = left.running.iter().map(|(kind, _)| kind);
        for kind in kinds.chain(left.waiting.iter().map(|(kind, _)| kind)) {
            known.entry(kind).or_insert_with(|| times(kind.2, self.ratio(kind)));
        }
        let time = |kind: &Kind| known[kind];
        // The times at which the workers become idle.
        let mut idle: BinaryHeap<Reverse<Duration>> =
            left.running.iter().map(|(kind, part)| Reverse(times(time(kind), *part))).collect();
        while idle.len() < workers.max(1) {
            idle.push(Reverse(Duration::ZERO));
        }
        for (kind, count) in &left.waiting {
            let (time, workers) = (time(kind), idle.len() as u64);
            // Very many equal jobs occupy all workers equally.
            let (each, rest) = match count / workers {
                many @ AT_ONCE.. => (many, count % workers),
                _ => (0, *count),
            };
            if each > 0 {
                let each = time.saturating_mul(u32::try_from(each).unwrap_or(u32::MAX));
                idle = idle.into_iter().map(|at| Reverse(at.0.saturating_add(each))).collect();
            }
            for _ in 0..rest {
                let Reverse(at) = idle.pop().expect("there is a worker");
                idle.push(Reverse(at.saturating_add(time)));
            }
        }
        idle.into_iter().map(|Reverse(at)| at).max().or(Some(Duration::ZERO))
    }

    /// The time that one core needs for a job, in seconds.
    pub fn seconds(&self, job: &Job) -> f64 {
        job.expected_time().as_secs_f64() * self.ratio(&kind(job))
    }

    /// The ratio of the measured to the expected time of a kind: from its own measurements, completed by those of
    /// its algorithm, or of all algorithms if there is none.
    fn ratio(&self, kind: &Kind) -> f64 {
        let of_algorithm = self.0.iter().filter(|(one, _)| (&one.0, &one.1) == (&kind.0, &kind.1));
        let of_algorithm = Timed::sum(of_algorithm.map(|(_, timed)| timed)).ratio();
        let ours = self.0.iter().filter(|(one, _)| one.1.is_empty()).map(|(_, timed)| timed);
        let others = of_algorithm.or_else(|| Timed::sum(ours).ratio()).unwrap_or(1.0);
        let Timed { measured, expected } = self.0.get(kind).copied().unwrap_or_default();
        let weight = OWN * kind.2.as_secs_f64();
        (measured + weight * others) / (expected + weight)
    }
}

/// The number of equal jobs per worker from which they are not handed out one by one.
const AT_ONCE: u64 = 64;

/// The remaining work: the algorithms and expected times of jobs.
#[derive(Clone, Debug, Default)]
pub struct Left {
    /// The jobs that have not begun, in the order in which each kind first occurred.
    waiting: Vec<(Kind, u64)>,
    indices: HashMap<Kind, usize>,
    /// The running jobs, with the part that is left of each.
    running: Vec<(Kind, f64)>,
}

impl Left {
    /// Adds `count` jobs that differ only in their seeds.
    pub fn add(&mut self, job: &Job, count: u64) {
        let kind = kind(job);
        let index = *self.indices.entry(kind.clone()).or_insert(self.waiting.len());
        match self.waiting.get_mut(index) {
            Some((_, waiting)) => *waiting += count,
            None => self.waiting.push((kind, count)),
        }
    }

    /// Adds a running job, of which a part, from 0 to 1, is left.
    pub fn add_running(&mut self, job: &Job, part: f64) {
        self.running.push((kind(job), part));
    }

    /// Removes a job that was added before.
    pub fn remove(&mut self, job: &Job) {
        if let Some(index) = self.indices.get(&kind(job)) {
            let (_, waiting) = &mut self.waiting[*index];
            *waiting = waiting.saturating_sub(1);
        }
    }
}

/// The product of a time and a factor; the longest time if it is too long.
fn times(time: Duration, factor: f64) -> Duration {
    Duration::try_from_secs_f64(time.as_secs_f64() * factor).unwrap_or(Duration::MAX)
}

/// A duration in words: `45 s`, `12 min`, `3 h 20 min`.
pub fn spoken(time: Duration) -> String {
    let whole = time.as_secs_f64().round() as u64;
    let minutes = (whole + 30) / 60;
    match (minutes / 60, minutes % 60) {
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
        speeds.time(left, 1).unwrap().as_secs_f64()
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
        left.add_running(&job, 0.5);
        assert!((seconds(&speeds, &left) - 30.0).abs() < 1e-6);
        left.remove(&job);
        left.remove(&job);
        let left = Left { running: Vec::new(), ..left };
        assert_eq!(speeds.time(&left, 1), Some(Duration::ZERO));
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
        if cfg!(feature = "burn") {
            assert!(time("engine = \"burn\"") > 3.0 * usual);
        }
    }

    #[test]
    fn workers_take_the_jobs_in_turn() {
        let [short, long] =
            [1_000, 9_000].map(|n| job(&format!("algorithm = \"reinforce\"\nepisodes = {n}\n")));
        let mut speeds = Speeds::default();
        speeds.add(&long, 1.0, Duration::from_secs(90));
        let unit = speeds.seconds(&short);
        let long_seconds = speeds.seconds(&long);
        let time = |counts: [u64; 2], running: &[f64], workers| {
            let mut left = Left::default();
            left.add(&short, counts[0]);
            left.add(&long, counts[1]);
            running.iter().for_each(|part| left.add_running(&long, *part));
            speeds.time(&left, workers).unwrap().as_secs_f64()
        };
        let close = |found: f64, expected: f64| {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        };
        close(time([9, 0], &[], 4), 3.0 * unit);
        close(time([2, 0], &[], 4), unit);
        // The long job starts last, and the other workers wait for it.
        close(time([4, 1], &[], 4), unit + long_seconds);
        close(time([1, 0], &[0.5, 0.25], 2), (0.5 * long_seconds).max(0.25 * long_seconds + unit));
        close(time([4_000_001, 0], &[], 4), 1_000_001.0 * unit);
    }

    #[test]
    fn durations_are_spoken_in_the_unit_that_matters() {
        let cases = [
            (0.4, "0 s"),
            (59.6, "60 s"),
            (110.0, "2 min"),
            (125.0, "2 min"),
            (3580.0, "1 h 0 min"),
            (3600.0, "1 h 0 min"),
            (12_000.0, "3 h 20 min"),
            (500_000.0, "5 days"),
        ];
        for (seconds, expected) in cases {
            assert_eq!(spoken(Duration::from_secs_f64(seconds)), expected);
        }
    }
}
