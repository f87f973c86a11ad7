//! The simulation as a vectorised environment whose state can be saved.

use std::io;

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
use crate::state::{Resumable, StateError, StateReader, StateWriter};

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
        if count == 1 && self.participants.is_some() && lanes.contains(0) {
            // Draws computed ahead belong to the previous participant.
            self.ahead = ContextDrawsAhead::new(self.person(0).sigma);
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
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        self.remember();
        for (drawn, status) in self.drawn.iter_mut().zip(&self.statuses) {
            *drawn = *status == EpisodeStatus::Running;
        }
        if self.full.is_some() {
            self.noisy_step(actions, rewards, streams);
        } else {
            self.act(actions, rewards);
        }
        self.sample(Moment::Step, LaneSet::All, streams);
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

impl Resumable for PhysicalActivity {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.each(0..self.lanes(), |out, lane| {
            out.one(self.times[lane])?;
            out.one(self.contexts[lane])?;
            out.one(self.probabilities[lane])?;
            out.one(self.habituation[lane])?;
            out.one(self.disengagement[lane])?;
            out.one(self.statuses[lane].number())
        })?;
        self.history.iter().try_for_each(|history| history.save(out))?;
        if self.full.is_some() {
            self.memory.save(out)?;
        }
        self.participants.as_ref().map_or(Ok(()), |people| people.save(out))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "lanes";
        let mut lanes = 0..self.lanes();
        from.each(self.lanes(), WHAT, |from| {
            let lane = lanes.next().ok_or(StateError::Misfit(WHAT))?;
            self.times[lane] = from.one()?;
            let context = from.one::<u8>()? & 1;
            self.set_context(lane, ContextDraw::new(context, from.one()?));
            self.habituation[lane] = from.one()?;
            self.disengagement[lane] = from.one()?;
            let status = EpisodeStatus::from_number(from.one()?);
            self.statuses[lane] = status.ok_or(StateError::Misfit("statuses"))?;
            Ok(())
        })?;
        if !lanes.is_empty() {
            return Err(StateError::Misfit(WHAT));
        }
        self.history.iter_mut().try_for_each(|history| history.restore(from))?;
        if self.full.is_some() {
            self.memory.restore(from)?;
        }
        if let Some(people) = &mut self.participants {
            people.restore(from)?;
            if self.times.len() == 1 {
                self.ahead = ContextDrawsAhead::new(people.person(0).sigma);
            }
        }
        Ok(())
    }
}
