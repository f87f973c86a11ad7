//! What the agent of a trial sees of its decisions, and when it learns from whom.

use crate::agent::Rewards;
use crate::env::{Observations, Simulated, VectorEnvironment};
use crate::job::Decision;
use crate::state::resumable;
use crate::train::decision_log::DecisionObserver;
use crate::train::roll::ChosenStep;
use crate::train::study::TracedUpdate;

/// What an agent saw of the decisions of a trial so far, and its updates.
#[derive(Debug, Default)]
pub(super) struct Sightings {
    pub(super) rows: Vec<Sighting>,
    pub(super) updates: Vec<TracedUpdate>,
    /// Buffer: the observations of all people.
    observations: Option<Observations>,
}

/// What an agent saw of a decision.
#[derive(Clone, Debug, Default)]
pub(super) struct Sighting {
    /// The number of the person, from 1, and the person's step.
    pub(super) episode: u32,
    pub(super) step: u32,
    /// The step of the trial, from 0.
    pub(super) time: u32,
    pub(super) observed: Vec<f64>,
    /// The reward; `None` if it did not reach the agent.
    pub(super) learned: Option<f64>,
}

impl Sightings {
    /// The sightings by episode and step.
    pub(super) fn finish(mut self) -> Sightings {
        self.rows.sort_unstable_by_key(|row| (row.episode, row.step));
        self
    }
}

impl DecisionObserver for Sightings {
    fn decided(&mut self, step: &ChosenStep<'_, Simulated>, decisions: &[Decision]) {
        let (lanes, study) = (step.environment, step.study.expect("trials alone have sightings"));
        self.updates.extend(study.last_update());
        let observations =
            self.observations.get_or_insert_with(|| lanes.observation_spec().observations());
        lanes.observe(observations);
        for &Decision { episode, step, .. } in decisions {
            let mut observed = Vec::new();
            lanes.exact_features(episode as usize - 1, observations, &mut observed);
            let (time, learned) = (study.time(), None);
            self.rows.push(Sighting { episode, step, time, observed, learned });
        }
    }

    fn paid(&mut self, decisions: &[Decision], rewards: Rewards<'_>) {
        let first = self.rows.len() - decisions.len();
        for row in &mut self.rows[first..] {
            row.learned = rewards.of_lane(row.episode as usize - 1);
        }
    }
}

resumable!([] Sighting { parts episode, step, time, observed, learned });
resumable!([] Sightings { parts rows, updates });
