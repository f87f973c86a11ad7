//! The test episodes of a trained agent and what is kept of them.

use crate::env::{Action, Ending, Episodes, Signal};
use crate::plan::Job;
use crate::record::{ActionCount, Metric, PROBABILITY_BINS, TestEpisode};
use crate::train::{Chooser, Monitor, TestStreams, Watch, roll};

/// Episodes that advance in lockstep; part of what fixes the results, because lanes share streams.
const LANES: u32 = 1000;

/// What the test episodes were.
pub(super) struct Tested {
    pub(super) episodes: Vec<TestEpisode>,
    pub(super) actions: Vec<ActionCount>,
    messages: u64,
}

/// Tests who chooses; `None` if the test was stopped.
pub(super) fn run(job: &Job, mut chooser: Chooser, monitor: &dyn Monitor) -> Option<Tested> {
    let mut streams = TestStreams::new(job.seed);
    let mut counts = ActionCounts::default();
    let mut tested = Vec::new();
    let mut left = job.evaluation.test_episodes;
    while left > 0 {
        let lanes = left.min(LANES);
        left -= lanes;
        let mut episodes =
            Episodes::start(&job.environment, lanes as usize, &mut streams.environment);
        let unplayed = TestEpisode { total_reward: 0.0, length: 0, disengaged: false };
        let played = vec![unplayed; lanes as usize];
        let mut batch = Batch { counts: &mut counts, played, monitor };
        roll(&mut episodes, &mut chooser, &mut streams, &mut batch);
        if monitor.stop_requested() {
            return None;
        }
        for (episode, ending) in batch.played.iter_mut().zip(episodes.endings()) {
            episode.disengaged = *ending == Ending::Terminated;
        }
        tested.append(&mut batch.played);
    }
    Some(Tested { episodes: tested, messages: counts.messages(), actions: counts.rows() })
}

/// Test episodes while they are played.
struct Batch<'a> {
    counts: &'a mut ActionCounts,
    played: Vec<TestEpisode>,
    monitor: &'a dyn Monitor,
}

impl Watch for Batch<'_> {
    fn chosen(&mut self, episodes: &Episodes, actions: &[Action], _: &mut Chooser) {
        for (lane, episode) in self.played.iter_mut().enumerate() {
            if episodes.endings()[lane] == Ending::Running {
                episode.length += 1;
                self.counts.add(&episodes.signal(lane), actions[lane]);
            }
        }
    }

    fn paid(&mut self, _: &Episodes, rewards: &[f64]) {
        for (episode, reward) in self.played.iter_mut().zip(rewards) {
            episode.total_reward += reward;
        }
    }

    fn stop_requested(&self) -> bool {
        self.monitor.stop_requested()
    }
}

impl Tested {
    /// The metrics of the run, each once; see [`crate::record::METRICS`].
    pub(super) fn metrics(&self) -> Vec<Metric> {
        let n = self.episodes.len() as f64;
        let mean = self.episodes.iter().map(|e| e.total_reward).sum::<f64>() / n;
        let squares: f64 =
            self.episodes.iter().map(|e| (e.total_reward - mean) * (e.total_reward - mean)).sum();
        let steps: u64 = self.episodes.iter().map(|e| u64::from(e.length)).sum();
        let disengaged = self.episodes.iter().filter(|e| e.disengaged).count();
        vec![
            Metric { name: "mean_return", value: mean },
            Metric { name: "sd_return", value: (squares / (n - 1.0).max(1.0)).sqrt() },
            Metric { name: "mean_length", value: steps as f64 / n },
            Metric { name: "disengagement_rate", value: disengaged as f64 / n },
            Metric { name: "message_rate", value: self.messages as f64 / steps as f64 },
        ]
    }
}

/// Counts of choices by \[bin, context, action\].
#[derive(Default)]
struct ActionCounts([[[u64; Action::COUNT]; 2]; PROBABILITY_BINS]);

impl ActionCounts {
    fn add(&mut self, signal: &Signal, action: Action) {
        let bin = (signal.probability_of_zero * PROBABILITY_BINS as f64) as usize;
        let bin = bin.min(PROBABILITY_BINS - 1);
        self.0[bin][usize::from(signal.context)][action.index()] += 1;
    }

    fn messages(&self) -> u64 {
        self.0.iter().flatten().map(|actions| actions[1..].iter().sum::<u64>()).sum()
    }

    fn rows(&self) -> Vec<ActionCount> {
        let mut rows = Vec::new();
        for (bin, contexts) in (0..).zip(&self.0) {
            for (context, actions) in (0..).zip(contexts) {
                for (action, &count) in (0..).zip(actions) {
                    if count > 0 {
                        rows.push(ActionCount { bin, context, action, count });
                    }
                }
            }
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_by_hand() {
        let episode =
            |total_reward, length, disengaged| TestEpisode { total_reward, length, disengaged };
        let tested = Tested {
            episodes: vec![
                episode(10.0, 4, true),
                episode(20.0, 10, false),
                episode(60.0, 6, false),
            ],
            actions: Vec::new(),
            messages: 5,
        };
        let value = |name: &str| tested.metrics().iter().find(|m| m.name == name).unwrap().value;
        assert_eq!(value("mean_return"), 30.0);
        assert!((value("sd_return") - 700.0f64.sqrt()).abs() < 1e-12);
        assert!((value("mean_length") - 20.0 / 3.0).abs() < 1e-12);
        assert!((value("disengagement_rate") - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(value("message_rate"), 0.25);
        let names: Vec<&str> = tested.metrics().iter().map(|m| m.name).collect();
        let declared: Vec<&str> = crate::record::METRICS.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, declared);
    }

    #[test]
    fn one_test_episode_has_no_spread() {
        let tested = Tested {
            episodes: vec![TestEpisode { total_reward: 7.0, length: 2, disengaged: false }],
            actions: Vec::new(),
            messages: 0,
        };
        assert!(tested.metrics().iter().all(|m| m.value.is_finite()));
    }
}
