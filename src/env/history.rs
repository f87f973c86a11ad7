//! Stacked observations: the last observations of an episode in one row.

use crate::env::observation::{FeatureSpec, ObservationSpec, Observations};
use crate::env::vector::{EpisodeStatus, LaneSet};
use crate::state::resumable;

/// The observations of earlier steps in every lane.
///
/// A row of stacked observations starts with the oldest and ends with the current one. Entries from before
/// the first step of an episode are 0. A one-hot of time covers the current step only.
#[derive(Clone, Debug)]
pub struct History {
    /// The number of earlier observations in a row.
    earlier: usize,
    /// \[lanes, earlier, width\].
    past: Vec<f32>,
    /// A buffer for the current observations, \[lanes, width\].
    present: Observations,
}

impl ObservationSpec {
    /// The specification of the last `length` observations. The name of a feature from k steps ago has the
    /// suffix `-k`.
    pub fn stacked(&self, length: usize) -> ObservationSpec {
        let before = |back: usize| {
            self.features.iter().map(move |feature| match back {
                0 => feature.clone(),
                // Entries from before the first step are 0.
                _ => FeatureSpec {
                    name: format!("{}-{back}", feature.name),
                    low: feature.low.min(0.0),
                    high: feature.high.max(0.0),
                },
            })
        };
        let features = (0..length.max(1)).rev().flat_map(before).collect();
        ObservationSpec { features, one_hot: self.one_hot }
    }
}

impl History {
    /// An empty history of `lanes` lanes; `None` for a length of 1, which needs no history.
    pub fn new(length: usize, lanes: usize, spec: &ObservationSpec) -> Option<History> {
        let earlier = length.checked_sub(1).filter(|earlier| *earlier > 0)?;
        let past = vec![0.0; lanes * earlier * spec.features.len()];
        Some(History { earlier, past, present: spec.observations() })
    }

    /// The number of observations in a row, including the current one.
    pub fn length(&self) -> usize {
        self.earlier + 1
    }

    /// Clears the history of lanes that start new episodes.
    pub fn reset(&mut self, lanes: LaneSet<'_>) {
        let row = self.earlier * self.present.width();
        for (lane, past) in self.past.chunks_exact_mut(row).enumerate() {
            if lanes.contains(lane) {
                past.fill(0.0);
            }
        }
    }

    /// Stores the observations that `observe` writes, for the lanes that are about to take a step.
    pub fn remember(
        &mut self,
        statuses: &[EpisodeStatus],
        observe: impl FnOnce(&mut Observations),
    ) {
        observe(&mut self.present);
        let width = self.present.width();
        let rows = self.past.chunks_exact_mut(self.earlier * width);
        for (lane, (past, status)) in rows.zip(statuses).enumerate() {
            if *status == EpisodeStatus::Running {
                past.copy_within(width.., 0);
                let newest = past.len() - width;
                past[newest..].copy_from_slice(self.present.row(lane));
            }
        }
    }

    /// Inserts the past before the features of the current observations, \[lanes, width\], which become
    /// \[lanes, length, width\].
    pub fn stack(&self, features: &mut Vec<f32>) {
        let width = self.present.width();
        let (earlier, lanes) = (self.earlier * width, features.len() / width);
        let row = earlier + width;
        features.resize(lanes * row, 0.0);
        // From the last lane to the first, so that no row is overwritten before it has been moved.
        for lane in (0..lanes).rev() {
            let (start, present) = (lane * row, lane * width);
            features.copy_within(present..present + width, start + earlier);
            let past = &self.past[lane * earlier..(lane + 1) * earlier];
            features[start..start + earlier].copy_from_slice(past);
        }
    }
}

resumable!([] History { fixed past });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{
        Action, ForcedNoise, LaneStreams, PhysicalActivity, Scenario, StepCount, VectorEnvironment,
    };
    use crate::rng::{Purpose, Stream};

    fn seen(environment: &PhysicalActivity) -> Observations {
        let mut seen = environment.observation_spec().observations();
        environment.observe(&mut seen);
        seen
    }

    #[test]
    fn the_last_observations_stand_in_a_row_with_the_oldest_first() {
        let scenario: Scenario = "P-H-D".parse().unwrap();
        let parameters = StepCount { time_one_hot: true, ..StepCount::paper(0.6) };
        let plain = PhysicalActivity::new(&parameters, &scenario, 2);
        let mut stacked = plain.clone().with_history(3);
        let mut plain = plain;
        let names: Vec<String> =
            stacked.observation_spec().features.into_iter().map(|one| one.name).collect();
        assert_eq!(names, ["P-2", "H-2", "D-2", "P-1", "H-1", "D-1", "P", "H", "D"]);
        let streams = || LaneStreams::Shared(Stream::new(1, Purpose::Environment));
        let (mut one, mut other) = (streams(), streams());
        plain.reset(LaneSet::All, &mut one);
        stacked.reset(LaneSet::All, &mut other);
        let mut all = [vec![vec![0.0; 3]; 2], vec![vec![0.0; 3]; 2]];
        let mut rewards = [0.0; 2];
        // An ended lane stays as it is.
        let mut moved = [true; 2];
        for step in 0..50 {
            let (present, row) = (seen(&plain), seen(&stacked));
            assert_eq!(present.moments(), row.moments());
            for (lane, all) in all.iter_mut().enumerate() {
                if moved[lane] {
                    all.push(present.row(lane).to_vec());
                }
                assert_eq!(row.row(lane), all[all.len() - 3..].concat(), "step {step}");
            }
            moved = [0, 1].map(|lane| plain.statuses()[lane] == EpisodeStatus::Running);
            let actions = [Action::uniform(step, 4), Action::uniform(2 + step / 3, 4)];
            plain.step(&actions, &mut rewards, &mut one);
            stacked.step(&actions, &mut rewards, &mut other);
            if step == 20 {
                let mask = [false, true];
                plain.reset(LaneSet::Masked(&mask), &mut one);
                stacked.reset(LaneSet::Masked(&mask), &mut other);
                (all[1], moved[1]) = (vec![vec![0.0; 3]; 2], true);
            }
        }
    }

    #[test]
    fn a_history_of_one_is_the_present() {
        let spec = ObservationSpec::of([("P", 0.0, 1.0)]);
        assert!(History::new(1, 4, &spec).is_none());
        assert_eq!(spec.stacked(1), spec);
    }

    // Replays force steps and contexts.
    #[test]
    fn forced_steps_are_remembered_as_others_are() {
        let environment =
            PhysicalActivity::new(&StepCount::paper(0.6), &"P-H-D".parse().unwrap(), 1)
                .with_history(2);
        let noise = ForcedNoise { state: None, steps: None };
        for is_forced in [false, true] {
            let mut lane = environment.clone();
            lane.reset(
                LaneSet::All,
                &mut LaneStreams::Shared(Stream::new(1, Purpose::Environment)),
            );
            for action in [1, 3, 0] {
                let before = seen(&lane).row(0)[3..].to_vec();
                let actions = [Action::uniform(action, 4)];
                if is_forced {
                    lane.force_step(&noise, &actions, &mut [0.0]);
                } else {
                    lane.apply_actions(&actions, &mut [0.0]);
                }
                assert_eq!(seen(&lane).row(0)[..3], before);
            }
            assert!(seen(&lane).row(0)[1] > 0.0, "habituation of the step before");
        }
    }
}
