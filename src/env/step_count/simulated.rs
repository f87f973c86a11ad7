//! The simulation as jobs run it: its recorded state, and the strata of choices of action.

use super::physical_activity::PhysicalActivity;
use crate::env::simulation::{Simulated, Simulation};
use crate::env::vector::{Action, EpisodeStatus, VectorEnvironment};

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

    fn time(&self, lane: usize) -> u32 {
        self.times()[lane]
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

    fn leave(&mut self, lane: usize) {
        self.end(lane);
    }

    fn participant(&self, lane: usize) -> Vec<(usize, f64)> {
        PhysicalActivity::participant(self, lane).collect()
    }
}
