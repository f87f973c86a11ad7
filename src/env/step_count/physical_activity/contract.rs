//! The simulation as a vectorised environment whose state can be saved.

use super::{Moment, PhysicalActivity};
use crate::env::observation::{ObservationSpec, Observations};
use crate::env::step_count::context::{ContextDraw, ContextDrawsAhead};
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::intervention::OPTIONS;
use crate::env::step_count::parameters::{FirstContext, StepNoise};
use crate::env::step_count::population::Extreme;
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::state::resumable;

impl VectorEnvironment for PhysicalActivity {
    fn lanes(&self) -> usize {
        self.statuses.len()
    }

    fn action_spec(&self) -> ActionSpec {
        let e = &self.parameters;
        let end = |extreme| match &self.participants {
            Some(people) => people.population().extreme(e, extreme),
            None => e.clone(),
        };
        let (smallest, largest) = (end(Extreme::Smallest), end(Extreme::Largest));
        let range = [Dynamics::of(&smallest).range()[0], Dynamics::of(&largest).range()[1]];
        let [least, most] = match (range, e.step_noise) {
            (_, StepNoise::Gamma) => [0.0, f64::INFINITY],
            (range, StepNoise::None) if e.steps_cut_at_zero => range.map(|steps| steps.max(0.0)),
            (range, StepNoise::None) => range,
        };
        let [least, most] = match e.can_pay_nothing() {
            true => [least.min(0.0), most.max(0.0)],
            false => [least, most],
        };
        ActionSpec {
            count: OPTIONS,
            lowest_reward: least - largest.message_cost,
            highest_reward: most,
        }
    }

    fn can_send(&self, lane: usize) -> bool {
        self.taken(lane, Action::UNTAILORED) == Action::UNTAILORED
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.observer.spec().stacked(self.history_length())
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        let count = self.lanes();
        if let Some(history) = &mut self.history {
            history.reset(lanes);
        }
        self.drawn.fill(false);
        for lane in (0..count).filter(|lane| lanes.contains(*lane)) {
            self.drawn[lane] = true;
            if let Some(people) = &mut self.participants {
                people.draw(lane, streams.of(lane));
            }
            let person = self.participants.as_ref().map(|people| people.person(lane));
            let person = person.unwrap_or(&self.parameters);
            self.times[lane] = 0;
            self.habituation[lane] = person.initial_habituation;
            self.disengagement[lane] = person.initial_disengagement;
            self.statuses[lane] = EpisodeStatus::Running;
            self.memory.reset(lane);
        }
        if lanes.contains(0) {
            // Draws computed ahead belong to the previous participant.
            self.draw_ahead();
        }
        let is_fixed = self.parameters.first_context == FirstContext::Fixed;
        if is_fixed {
            for lane in (0..count).filter(|lane| lanes.contains(*lane)) {
                self.set_context(lane, ContextDraw::FIXED_FIRST);
            }
        }
        if !is_fixed || self.is_limited {
            self.sample(Moment::Reset, lanes, streams);
        }
        self.begin_beliefs(lanes);
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        self.remember();
        for (drawn, status) in self.drawn.iter_mut().zip(&self.statuses) {
            *drawn = *status == EpisodeStatus::Running;
        }
        if self.noise.is_some() {
            self.noisy_step(actions, rewards, streams);
        } else {
            self.act(actions, rewards);
        }
        self.draw_beliefs(streams);
        self.sample(Moment::Step, LaneSet::All, streams);
        self.update_beliefs(actions);
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        self.observer.observe(self.states(), out);
        if let Some(history) = &self.history {
            history.stack(&mut out.features);
        }
    }

    /// The steps walked, without the cost of messages.
    fn outcomes<'a>(&'a self, rewards: &'a [f64]) -> &'a [f64] {
        if self.has_costs { &self.memory.walked } else { rewards }
    }
}

resumable!([] PhysicalActivity {
    fixed times, contexts, probabilities, likely, habituation, disengagement;
    each statuses, history;
    parts memory;
    each participants, filters;
    check fits, "contexts";
    then draw_ahead
});

impl PhysicalActivity {
    /// Whether contexts are 0 or 1.
    fn fits(&self) -> bool {
        self.contexts.iter().chain(&self.likely).all(|context| *context <= 1)
    }

    /// Draws contexts ahead for the participant of a single lane.
    fn draw_ahead(&mut self) {
        if self.lanes() == 1 && self.participants.is_some() {
            self.ahead = ContextDrawsAhead::new(self.person(0).sigma);
        }
    }
}
