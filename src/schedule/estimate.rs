//! How long what is left will take, from how long the rest took.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::plan::Job;
use crate::store::{Reader, StoreError};

/// Measured speed of training, by algorithm.
#[derive(Clone, Debug, Default)]
pub struct Speeds(BTreeMap<String, Speed>);

#[derive(Clone, Copy, Debug, Default)]
struct Speed {
    seconds: f64,
    episodes: f64,
}

impl Speeds {
    /// The speeds of the runs in a store.
    pub fn of(reader: &Reader) -> Result<Speeds, StoreError> {
        let mut speeds = Speeds::default();
        for pace in reader.paces()? {
            // One episode's worth: what this sweep measures soon outweighs it.
            let wall = Duration::try_from_secs_f64(pace.seconds_per_episode).unwrap_or_default();
            speeds.add(&pace.algorithm, 1, wall);
        }
        Ok(speeds)
    }

    /// Adds the time that so many training episodes of an algorithm took.
    pub fn add(&mut self, algorithm: &str, episodes: u64, wall: Duration) {
        let speed = self.0.entry(algorithm.to_owned()).or_default();
        speed.seconds += wall.as_secs_f64();
        speed.episodes += episodes as f64;
    }

    /// Seconds of work in all that is left; `None` if some algorithm of it has not been timed.
    pub fn seconds(&self, left: &Episodes) -> Option<f64> {
        self.estimate(left).whole()
    }

    /// The work in what is left, as far as its algorithms have been timed.
    pub fn estimate(&self, left: &Episodes) -> Estimate {
        let mut estimate = Estimate { seconds: 0.0, untimed: Vec::new() };
        for (algorithm, episodes) in left.0.iter().filter(|(_, episodes)| **episodes > 0) {
            match self.0.get(algorithm).filter(|speed| speed.episodes > 0.0) {
                Some(speed) => {
                    estimate.seconds += speed.seconds / speed.episodes * *episodes as f64
                }
                None => estimate.untimed.push(algorithm.clone()),
            }
        }
        estimate
    }
}

/// How long something takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Seconds, of the algorithms that have been timed.
    pub seconds: f64,
    /// The algorithms that have not been.
    pub untimed: Vec<String>,
}

impl Estimate {
    /// Whether it is of all algorithms.
    pub fn is_whole(&self) -> bool {
        self.untimed.is_empty()
    }

    /// The seconds, if they are of all algorithms.
    pub fn whole(&self) -> Option<f64> {
        self.is_whole().then_some(self.seconds)
    }

    /// The time when so many workers share it.
    pub fn shared_by(self, workers: usize) -> Estimate {
        Estimate { seconds: self.seconds / workers.max(1) as f64, ..self }
    }

    /// `about 5 s` or, where there is more to it, `at least 5 s`; nothing if nothing is known, and
    /// never at least nothing.
    pub fn spoken(&self) -> Option<String> {
        let (about, least) = if self.is_whole() { ("about", 0.0) } else { ("at least", 0.5) };
        (self.seconds > least).then(|| format!("{about} {}", spoken(self.seconds)))
    }
}

/// Training episodes still to do, by algorithm.
#[derive(Clone, Debug, Default)]
pub struct Episodes(BTreeMap<String, u64>);

impl Episodes {
    /// Counts so many episodes of an algorithm in.
    pub fn add(&mut self, algorithm: &str, episodes: u64) {
        match self.0.get_mut(algorithm) {
            Some(left) => *left += episodes,
            None => drop(self.0.insert(algorithm.to_owned(), episodes)),
        }
    }

    /// Takes a job's episodes out again.
    pub fn remove(&mut self, job: &Job) {
        let left = self.0.entry(job.algorithm().to_owned()).or_default();
        *left = left.saturating_sub(u64::from(job.agent.episodes()));
    }
}

/// A duration as people say it: `45 s`, `12 min`, `3 h 20 min`.
fn spoken(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
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

    #[test]
    fn time_left_follows_the_measured_speed() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nseeds = 1\n\
                    environment.sigma = 0.6\n[[agent]]\nname = \"a\"\n\
                    algorithm = \"reinforce\"\nepisodes = 15000\n";
        let manifest = manifest::parse("t", text.as_bytes()).unwrap();
        let job = plan::jobs(&manifest).next().unwrap().job;
        let mut left = Episodes::default();
        left.add("reinforce", 15_000);
        left.add("reinforce", 15_000);
        let mut speeds = Speeds::default();
        assert_eq!(speeds.seconds(&left), None);
        speeds.add("reinforce", 1000, Duration::from_secs(2));
        assert_eq!(speeds.seconds(&left), Some(60.0));
        left.remove(&job);
        assert_eq!(speeds.seconds(&left), Some(30.0));
        left.remove(&job);
        // Not -0.0, which prints as "-0".
        assert_eq!(speeds.seconds(&left).map(f64::to_bits), Some(0));
        assert_eq!(speeds.estimate(&left).spoken(), None);
        left.add("reinforce", 30_000);
        assert_eq!(speeds.estimate(&left).shared_by(2).spoken().unwrap(), "about 30 s");
        left.add("dueling_dqn", 1);
        assert_eq!(speeds.seconds(&left), None);
        assert_eq!(speeds.estimate(&left).shared_by(2).spoken().unwrap(), "at least 30 s");
        assert_eq!(speeds.estimate(&left).shared_by(200).spoken(), None);
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
            assert_eq!(spoken(seconds), expected);
        }
    }
}
