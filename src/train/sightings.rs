//! What the agent of a trial sees of its decisions, and when it learns from whom.

use crate::env::{EpisodeStatus, Observations, Simulated, VectorEnvironment};

/// An update of the agent of everybody.
#[derive(Clone, Debug, PartialEq)]
pub struct TracedUpdate {
    /// The step of the trial before which it comes.
    pub time: u32,
    /// The data of steps before this one count.
    pub before: u32,
    /// The people whose data count, \[people\].
    pub people: Vec<bool>,
}

/// What an agent saw of the decisions of a trial so far, and its updates.
#[derive(Debug, Default)]
pub(super) struct Sightings {
    pub(super) rows: Vec<Sighting>,
    pub(super) updates: Vec<TracedUpdate>,
    /// The step of the trial, and the first row of the step.
    time: u32,
    first: usize,
    /// Buffer: the observations of all people.
    observations: Option<Observations>,
}

/// What an agent saw of a decision.
#[derive(Debug)]
pub(super) struct Sighting {
    /// The number of the person, from 1, and the person's step.
    pub(super) episode: u32,
    pub(super) step: u32,
    /// The step of the trial, from 0.
    pub(super) time: u32,
    pub(super) observed: Vec<f64>,
    /// The reward that reached the agent.
    pub(super) learned: Option<f64>,
}

impl Sightings {
    /// Sees the state before a step.
    pub(super) fn see(&mut self, lanes: &Simulated) {
        let observations =
            self.observations.get_or_insert_with(|| lanes.observation_spec().observations());
        lanes.observe(observations);
        self.first = self.rows.len();
        for lane in 0..lanes.lanes() {
            if lanes.statuses()[lane] == EpisodeStatus::Running && lanes.is_counted(lane) {
                let mut observed = Vec::new();
                lanes.exact_features(lane, observations, &mut observed);
                let (episode, step) = (lane as u32 + 1, lanes.time(lane));
                let learned = None;
                self.rows.push(Sighting { episode, step, time: self.time, observed, learned });
            }
        }
        self.time += 1;
    }

    /// Sees the rewards of the step as the agent sees them: NaN where it sees none.
    pub(super) fn paid(&mut self, rewards: &[f64]) {
        for row in &mut self.rows[self.first..] {
            row.learned = Some(rewards[row.episode as usize - 1]).filter(|reward| !reward.is_nan());
        }
    }
}
