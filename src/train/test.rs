//! The test episodes of a trained agent and what is kept of them.

use std::io;

use crate::agent::{Actor, OutOfMemory, StepObserver, reserve_exact};
use crate::env::{Action, ContextDraw, EpisodeStatus, PhysicalActivity, VectorEnvironment};
use crate::plan::Job;
use crate::record::{ActionCount, Decision, Metric, PROBABILITY_BINS, Phase, TestEpisode};
use crate::state::{Resumable, StateError, StateReader, StateWriter};
use crate::train::decision_log::DecisionLog;
use crate::train::roll::{RollStreams, begin, roll};

/// Episodes that advance in lockstep; part of what fixes the results, because lanes share streams.
const LANES: usize = 1000;

const UNPLAYED: TestEpisode = TestEpisode { total_reward: 0.0, length: 0, disengaged: false };

/// A test under way.
pub(super) struct Test {
    /// Episodes that it has in all.
    episodes: usize,
    streams: RollStreams,
    counts: ActionCounts,
    /// `None` where the job does not ask for it.
    log: Option<DecisionLog>,
    played: Vec<TestEpisode>,
    batch: Batch,
}

/// What the test episodes were.
pub(super) struct Tested {
    pub(super) episodes: Vec<TestEpisode>,
    pub(super) actions: Vec<ActionCount>,
    pub(super) decisions: Vec<Decision>,
    messages: u64,
    message_cost: f64,
}

impl Test {
    /// The test of a job, before its first episode.
    pub(super) fn new(job: &Job) -> Self {
        Test {
            episodes: job.evaluation.test_episodes as usize,
            streams: RollStreams::of_test(job.seed),
            counts: ActionCounts::default(),
            log: job.evaluation.record_decisions.of_test().then(|| DecisionLog::new(Phase::Test)),
            played: Vec::new(),
            batch: Batch {
                environment: PhysicalActivity::new(&job.environment, &job.scenario, 0),
                played: Vec::new(),
            },
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.played.len() == self.episodes
    }

    /// Whether an episode has begun: the actor may remember something from then on.
    pub(super) fn has_begun(&self) -> bool {
        !(self.played.is_empty() && self.batch.played.is_empty())
    }

    /// Plays a batch of episodes to its end, or until `pause` says yes; the next call continues.
    ///
    /// **Errors**: there is no memory for its episodes.
    pub(super) fn advance(
        &mut self,
        actor: &mut dyn Actor,
        pause: &dyn Fn() -> bool,
    ) -> Result<(), OutOfMemory> {
        let left = self.episodes - self.played.len();
        reserve_exact(&mut self.played, left, "the test episodes")?;
        let Test { streams, counts, log, batch, .. } = self;
        if batch.played.is_empty() {
            let lanes = LANES.min(self.episodes - self.played.len());
            batch.environment = batch.environment.with_lanes(lanes);
            batch.played = vec![UNPLAYED; lanes];
            begin(&mut batch.environment, actor, streams);
        }
        let mut player = Player { counts, log: log.as_mut(), played: &mut batch.played, pause };
        roll(&mut batch.environment, actor, streams, &mut player);
        log.as_ref().map_or(Ok(()), DecisionLog::check)?;
        if batch.environment.any_running() {
            return Ok(());
        }
        for (episode, status) in batch.played.iter_mut().zip(batch.environment.statuses()) {
            episode.disengaged = *status == EpisodeStatus::Terminated;
        }
        self.played.append(&mut batch.played);
        Ok(())
    }

    /// What the episodes were, once all are played.
    pub(super) fn finish(self) -> Tested {
        let (messages, actions) = (self.counts.messages(), self.counts.rows());
        let message_cost = self.batch.environment.parameters().message_cost;
        let decisions = self.log.map(DecisionLog::finish).unwrap_or_default();
        Tested { episodes: self.played, messages, message_cost, actions, decisions }
    }
}

/// Test episodes that are being played; none between two batches.
struct Batch {
    environment: PhysicalActivity,
    played: Vec<TestEpisode>,
}

/// Notes what happens in the episodes of a batch.
struct Player<'a> {
    counts: &'a mut ActionCounts,
    log: Option<&'a mut DecisionLog>,
    played: &'a mut [TestEpisode],
    pause: &'a dyn Fn() -> bool,
}

impl StepObserver<PhysicalActivity> for Player<'_> {
    fn chosen(&mut self, lanes: &PhysicalActivity, actions: &[Action], probabilities: &[f64]) {
        if let Some(log) = &mut self.log {
            log.chosen(lanes, actions, probabilities);
        }
        for (lane, episode) in self.played.iter_mut().enumerate() {
            if lanes.statuses()[lane] == EpisodeStatus::Running {
                episode.length += 1;
                self.counts.add(&lanes.context(lane), lanes.taken(lane, actions[lane]));
            }
        }
    }

    fn paid(&mut self, lanes: &PhysicalActivity, rewards: &[f64]) {
        if let Some(log) = &mut self.log {
            log.paid(lanes, rewards);
        }
        for (episode, outcome) in self.played.iter_mut().zip(lanes.outcomes(rewards)) {
            episode.total_reward += outcome;
        }
    }

    fn stop_requested(&self) -> bool {
        (self.pause)()
    }
}

impl Resumable for Test {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.streams.save(out)?;
        out.many(self.counts.0.as_flattened().as_flattened())?;
        self.log.iter().try_for_each(|log| log.save(out))?;
        out.each(self.played.iter(), save_episode)?;
        out.each(self.batch.played.iter(), save_episode)?;
        if self.batch.played.is_empty() { Ok(()) } else { self.batch.environment.save(out) }
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "test episodes";
        self.streams.restore(from)?;
        from.fill(self.counts.0.as_flattened_mut().as_flattened_mut(), "counts of actions")?;
        self.log.iter_mut().try_for_each(|log| log.restore(from))?;
        self.played = from.each(self.episodes, WHAT, restore_episode)?;
        let most = LANES.min(self.episodes - self.played.len());
        self.batch.played = from.each(most, WHAT, restore_episode)?;
        match self.batch.played.len() {
            0 => Ok(()),
            lanes if lanes == most => {
                self.batch.environment = self.batch.environment.with_lanes(lanes);
                self.batch.environment.restore(from)
            }
            _ => Err(StateError::Misfit(WHAT)),
        }
    }
}

fn save_episode(out: &mut StateWriter<'_>, episode: &TestEpisode) -> io::Result<()> {
    out.one(episode.total_reward)?;
    out.one(episode.length)?;
    out.one(u8::from(episode.disengaged))
}

fn restore_episode(from: &mut StateReader<'_>) -> Result<TestEpisode, StateError> {
    let (total_reward, length) = (from.one()?, from.one()?);
    Ok(TestEpisode { total_reward, length, disengaged: from.one::<u8>()? != 0 })
}

impl Tested {
    /// The metrics of the run, each at most once; see [`crate::record::METRICS`].
    pub(super) fn metrics(&self) -> Vec<Metric> {
        let n = self.episodes.len() as f64;
        let mean = self.episodes.iter().map(|e| e.total_reward).sum::<f64>() / n;
        let squares: f64 =
            self.episodes.iter().map(|e| (e.total_reward - mean) * (e.total_reward - mean)).sum();
        let steps: u64 = self.episodes.iter().map(|e| u64::from(e.length)).sum();
        let disengaged = self.episodes.iter().filter(|e| e.disengaged).count();
        let mut metrics = vec![
            Metric { name: "mean_return", value: mean },
            Metric { name: "sd_return", value: (squares / (n - 1.0).max(1.0)).sqrt() },
            Metric { name: "mean_length", value: steps as f64 / n },
            Metric { name: "disengagement_rate", value: disengaged as f64 / n },
            Metric { name: "message_rate", value: self.messages as f64 / steps as f64 },
        ];
        if self.message_cost > 0.0 {
            let value = mean - self.message_cost * self.messages as f64 / n;
            metrics.push(Metric { name: "mean_net_return", value });
        }
        metrics
    }
}

/// Counts of choices by \[bin, context, action\].
#[derive(Default)]
struct ActionCounts([[[u64; Action::COUNT]; 2]; PROBABILITY_BINS]);

impl ActionCounts {
    fn add(&mut self, draw: &ContextDraw, action: Action) {
        let bin = (draw.probability_of_zero * PROBABILITY_BINS as f64) as usize;
        let bin = bin.min(PROBABILITY_BINS - 1);
        self.0[bin][usize::from(draw.context)][action.index()] += 1;
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
            decisions: Vec::new(),
            messages: 5,
            message_cost: 1.5,
        };
        let value = |name: &str| tested.metrics().iter().find(|m| m.name == name).unwrap().value;
        assert_eq!(value("mean_return"), 30.0);
        assert!((value("sd_return") - 700.0f64.sqrt()).abs() < 1e-12);
        assert!((value("mean_length") - 20.0 / 3.0).abs() < 1e-12);
        assert!((value("disengagement_rate") - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(value("message_rate"), 0.25);
        assert_eq!(value("mean_net_return"), 30.0 - 1.5 * 5.0 / 3.0);
        let names: Vec<&str> = tested.metrics().iter().map(|m| m.name).collect();
        let declared: Vec<&str> = crate::record::METRICS.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, declared);
    }

    #[test]
    fn one_test_episode_has_no_spread() {
        let tested = Tested {
            episodes: vec![TestEpisode { total_reward: 7.0, length: 2, disengaged: false }],
            actions: Vec::new(),
            decisions: Vec::new(),
            messages: 0,
            message_cost: 0.0,
        };
        assert!(tested.metrics().iter().all(|m| m.name != "mean_net_return"));
        assert!(tested.metrics().iter().all(|m| m.value.is_finite()));
    }
}
