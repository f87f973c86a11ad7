//! The simulation as jobs run it: its recorded state, and the strata of choices of action.

use std::io;

use super::context::ContextDraw;
use super::full_step::INITIAL_STEPS;
use super::physical_activity::PhysicalActivity;
use crate::env::simulation::{Simulated, Simulation, StateColumn};
use crate::env::vector::{Action, ActionSpec, EpisodeStatus, VectorEnvironment};

/// The names of the recorded state, in its order: the true context; its inferred probability as the letter P shows
/// it, whether or not the agent saw it; the most likely context; and habituation and disengagement risk before the
/// step.
pub(super) const STATE: [&str; 5] =
    ["context", "probability", "likely_context", "habituation", "disengagement"];

/// The number of bins of the probability of context 0: `[bin / 10, (bin + 1) / 10)`; the last bin includes 1.
pub const PROBABILITY_BINS: usize = 10;

/// The number of strata: for each bin of the probability of context 0, both true contexts.
pub(super) const STRATA: usize = PROBABILITY_BINS * 2;

impl Simulation for PhysicalActivity {
    fn with_lanes(&self, lanes: usize) -> Simulated {
        Box::new(PhysicalActivity::with_lanes(self, lanes))
    }

    fn copied(&self) -> io::Result<Simulated> {
        Ok(Box::new(self.clone()))
    }

    fn times(&self) -> &[u32] {
        PhysicalActivity::times(self)
    }

    fn is_counted(&self, lane: usize) -> bool {
        PhysicalActivity::is_counted(self, lane)
    }

    fn is_available(&self, lane: usize) -> bool {
        PhysicalActivity::is_available(self, lane)
    }

    fn taken(&self, lane: usize, action: Action) -> Action {
        PhysicalActivity::taken(self, lane, action)
    }

    fn has_terminated(&self, lane: usize) -> bool {
        // The step after the horizon is no part of the episode.
        self.statuses()[lane] == EpisodeStatus::Terminated
            && self.times()[lane] <= self.parameters().horizon
    }

    fn message_cost(&self, lane: usize) -> f64 {
        self.person(lane).message_cost
    }

    fn stratum(&self, lane: usize) -> usize {
        let draw = self.context(lane);
        let bin = (draw.probability_of_zero * PROBABILITY_BINS as f64) as usize;
        bin.min(PROBABILITY_BINS - 1) * 2 + usize::from(draw.context)
    }

    fn show_state<'s>(&'s self, show: &mut dyn FnMut(&'s str, StateColumn<'s>)) {
        let states = self.states();
        show("context", StateColumn::Bytes(states.contexts));
        show("probability_0", StateColumn::Reals(states.probabilities));
        show("likely", StateColumn::Bytes(states.likely));
        show("habituation", StateColumn::Reals(states.habituation));
        show("disengagement", StateColumn::Reals(states.disengagement));
        show("available", StateColumn::Flags(states.available));
    }

    fn described_state(&self, lane: usize) -> String {
        let ContextDraw { context, probability_of_zero, .. } = self.context(lane);
        let (habituation, disengagement) = (self.habituation()[lane], self.disengagement()[lane]);
        format!(
            "context {context}, P(0) {probability_of_zero:.2}, habituation {habituation:.2}, disengagement \
             {disengagement:.2}"
        )
    }

    fn record_state(&self, lane: usize, state: &mut Vec<f64>) {
        let draw = self.context(lane);
        let zero = draw.probability_of_zero;
        let shown = if self.parameters().observed_probability == 0 { zero } else { 1.0 - zero };
        state.extend([
            f64::from(draw.context),
            shown,
            f64::from(draw.likely),
            self.habituation()[lane],
            self.disengagement()[lane],
        ]);
    }

    /// Those of the steps walked, the only feature without bounds of its own, in hundreds.
    fn finite_bounds(&self) -> [f32; 2] {
        let ActionSpec { lowest_reward, highest_reward, .. } = self.action_spec();
        let shown = |steps: f64| (steps / 100.0) as f32;
        let first = shown(INITIAL_STEPS);
        [shown(lowest_reward).clamp(f32::MIN, first), shown(highest_reward).clamp(first, f32::MAX)]
    }

    fn leave(&mut self, lane: usize) {
        self.end(lane);
    }

    fn participant(&self, lane: usize, values: &mut Vec<(usize, f64)>) {
        values.extend(PhysicalActivity::participant(self, lane));
    }
}
