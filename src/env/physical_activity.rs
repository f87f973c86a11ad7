//! The physical-activity simulation of Karine et al. (2023), section 3.1, and what StepCountJITAI (2024)
//! and the manifest's keys add to it; `docs/environment.md` states the model.

use std::io;

use crate::env::context::{ContextChain, ContextDraw, ContextDrawsAhead, Draws, prior_odds};
use crate::env::dynamics::{Alike, Dynamics};
use crate::env::full_step::{FullStep, Memory, is_needed};
use crate::env::noise::{DrawnNoise, ForcedNoise, Noise, Silence};
use crate::env::observation::{ObservationSpec, Observations};
use crate::env::observer::{LaneStates, Observer};
use crate::env::parameters::{Environment, FirstContext, StepNoise};
use crate::env::plain_step::PlainStep;
use crate::env::scenario::Scenario;
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::kernel::{Isa, LINE};
use crate::rng::{Companion, unit_from_bits};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// `f64`s in the widest register.
const REGISTER: usize = LINE / size_of::<f64>();

/// Many episodes of the simulation; entry i of every array belongs to lane i.
///
/// A step of the simulation draws one word per lane. With a shared stream it draws for every lane in
/// lane order, ended lanes included; with one stream per lane it draws for the running lanes. A reset
/// draws one word for each lane that it resets if the first context is sampled or messages are not always
/// available, and none otherwise. Noise comes from companions of the streams, at the place of the word.
#[derive(Clone, Debug)]
pub struct PhysicalActivity {
    parameters: Environment,
    dynamics: Alike,
    scenario: Scenario,
    observer: Observer,
    times: Vec<u32>,
    /// As `probabilities` and `likely` padded, so that draws fill whole registers.
    contexts: Vec<u8>,
    probabilities: Vec<f64>,
    likely: Vec<u8>,
    habituation: Vec<f64>,
    disengagement: Vec<f64>,
    statuses: Vec<EpisodeStatus>,
    /// Without effect where the plain step is enough.
    memory: Memory,
    /// The noise of full steps; `None` where the plain step is enough.
    full: Option<DrawnNoise>,
    /// Which lanes get a new context: those that were running before the step, or are being reset.
    drawn: Vec<bool>,
    /// Words of the streams for the next contexts, and of a companion of them.
    words: Vec<u64>,
    companion_words: Vec<u64>,
    /// `None` where both contexts are equally likely in every step.
    chain: Option<ContextChain>,
    /// Contexts for the steps of a single lane.
    ahead: ContextDrawsAhead,
    isa: Isa,
}

/// When contexts are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Moment {
    /// For the first step of episodes.
    Reset,
    /// For the step after another.
    Step,
}

impl PhysicalActivity {
    /// As many lanes as `lanes`, all ended, with the observations of a scenario.
    pub fn new(parameters: &Environment, scenario: &Scenario, lanes: usize) -> Self {
        let padded = lanes.next_multiple_of(REGISTER);
        PhysicalActivity {
            observer: Observer::new(parameters, scenario),
            times: vec![0; lanes],
            contexts: vec![0; padded],
            probabilities: vec![0.0; padded],
            likely: vec![0; padded],
            habituation: vec![0.0; lanes],
            disengagement: vec![0.0; lanes],
            statuses: vec![EpisodeStatus::Truncated; lanes],
            memory: Memory::new(lanes),
            full: is_needed(parameters, scenario).then(|| DrawnNoise::new(parameters, lanes)),
            drawn: vec![false; padded],
            words: vec![0; padded],
            companion_words: vec![0; lanes],
            chain: ContextChain::of(parameters),
            ahead: ContextDrawsAhead::new(parameters.sigma),
            isa: Isa::chosen(),
            parameters: parameters.clone(),
            dynamics: Alike(Dynamics::of(parameters)),
            scenario: scenario.clone(),
        }
    }

    /// The same simulation with another number of lanes, all ended.
    pub fn with_lanes(&self, lanes: usize) -> Self {
        PhysicalActivity::new(&self.parameters, &self.scenario, lanes)
    }

    /// A step without noise: rewards, habituation, disengagement risk, clocks and statuses. The contexts
    /// stay as they are.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\].
    pub fn apply_actions(&mut self, actions: &[Action], rewards: &mut [f64]) {
        assert_eq!(actions.len(), self.lanes(), "one action per lane");
        assert_eq!(rewards.len(), self.lanes(), "one reward per lane");
        if self.full.is_some() {
            self.full_step(&Silence, actions, rewards);
        } else {
            self.isa.run(PlainStep {
                dynamics: &self.dynamics,
                horizon: self.parameters.horizon,
                contexts: &self.contexts,
                actions,
                times: &mut self.times,
                habituation: &mut self.habituation,
                disengagement: &mut self.disengagement,
                statuses: &mut self.statuses,
                rewards,
            });
        }
    }

    /// A step whose noise is given, the same for every lane. The contexts stay as they are.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\].
    pub fn force_step(&mut self, noise: &ForcedNoise, actions: &[Action], rewards: &mut [f64]) {
        self.full_step(noise, actions, rewards);
    }

    /// A full step with the noise of its streams.
    fn noisy_step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &LaneStreams) {
        if let Some(mut noise) = self.full.take() {
            noise.draw(&self.drawn, streams);
            self.full_step(&noise, actions, rewards);
            self.full = Some(noise);
        }
    }

    fn full_step(&mut self, noise: &impl Noise, actions: &[Action], rewards: &mut [f64]) {
        self.isa.run(FullStep {
            environment: &self.parameters,
            dynamics: &self.dynamics,
            noise,
            contexts: &self.contexts,
            actions,
            times: &mut self.times,
            habituation: &mut self.habituation,
            disengagement: &mut self.disengagement,
            statuses: &mut self.statuses,
            memory: &mut self.memory,
            rewards,
        });
    }

    /// Draws what the next step of the lanes marked in `drawn` brings: their contexts, and whether a
    /// message can be sent. From a shared stream, all of `lanes` take a word, marked or not.
    fn sample(&mut self, moment: Moment, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        let count = self.lanes();
        if count == 1 && self.chain.is_none() && self.parameters.availability == 1.0 {
            let takes = match streams {
                LaneStreams::Shared(_) => lanes.contains(0),
                LaneStreams::PerLane(_) => self.drawn[0],
            };
            if takes {
                let draw = self.ahead.take(self.isa, streams.of(0));
                if self.drawn[0] {
                    self.set_context(0, draw);
                }
            }
            return;
        }
        self.sample_availability(lanes, streams);
        if let Some(chain) = self.chain {
            let words = &mut self.companion_words;
            streams.fill_companion(Companion::Context, lanes, &self.drawn, words);
            streams.fill(lanes, &self.drawn, &mut self.words[..count]);
            let words = self.words.iter_mut().zip(&self.companion_words).zip(&self.contexts);
            for ((word, companion), context) in words {
                let before = (moment == Moment::Step).then_some(*context);
                *word = chain.word(*word, *companion, before);
            }
        } else {
            streams.fill(lanes, &self.drawn, &mut self.words[..count]);
        }
        if moment == Moment::Reset && self.parameters.first_context == FirstContext::Fixed {
            return;
        }
        self.isa.run(Draws {
            drawn: &self.drawn,
            sigma: self.parameters.sigma,
            odds: prior_odds(&self.parameters),
            words: &self.words,
            contexts: &mut self.contexts,
            probabilities: &mut self.probabilities,
            likely: &mut self.likely,
        });
    }

    fn sample_availability(&mut self, lanes: LaneSet<'_>, streams: &LaneStreams) {
        let availability = self.parameters.availability;
        if availability == 1.0 {
            return;
        }
        let words = &mut self.companion_words;
        streams.fill_companion(Companion::Availability, lanes, &self.drawn, words);
        let words = self.companion_words.iter().zip(&self.drawn);
        for (available, (word, drawn)) in self.memory.available.iter_mut().zip(words) {
            if *drawn {
                *available = unit_from_bits(*word) < availability;
            }
        }
    }

    /// Sets the context of a lane, as a replay does.
    pub fn set_context(&mut self, lane: usize, draw: ContextDraw) {
        self.contexts[lane] = draw.context;
        self.probabilities[lane] = draw.probability_of_zero;
        self.likely[lane] = draw.likely;
    }

    /// Sets the habituation and disengagement risk of a lane, both in [0, 1].
    pub fn set_state(&mut self, lane: usize, habituation: f64, disengagement: f64) {
        self.habituation[lane] = habituation;
        self.disengagement[lane] = disengagement;
    }

    /// Sets whether a message can be sent in a lane.
    pub fn set_available(&mut self, lane: usize, available: bool) {
        self.memory.available[lane] = available;
    }

    /// The context of a lane with its inference.
    pub fn context(&self, lane: usize) -> ContextDraw {
        ContextDraw {
            context: self.contexts[lane],
            probability_of_zero: self.probabilities[lane],
            likely: self.likely[lane],
        }
    }

    /// The parameters of the simulation.
    pub fn parameters(&self) -> &Environment {
        &self.parameters
    }

    /// Steps taken in the episode of every lane, \[lanes\].
    pub fn times(&self) -> &[u32] {
        &self.times
    }

    /// Habituation in [0, 1], \[lanes\].
    pub fn habituation(&self) -> &[f64] {
        &self.habituation
    }

    /// Disengagement risk in [0, 1], \[lanes\].
    pub fn disengagement(&self) -> &[f64] {
        &self.disengagement
    }

    /// Whether a message can be sent in a lane's present step, its budget aside.
    pub fn is_available(&self, lane: usize) -> bool {
        self.memory.available[lane]
    }

    /// The action that is taken in a lane where an agent chooses `action`: action 0 where no message can be
    /// sent, or where the budget of messages is spent.
    pub fn taken(&self, lane: usize, action: Action) -> Action {
        self.memory.taken(self.parameters.message_budget, lane, action)
    }

    /// The steps walked in the last step of every lane, \[lanes\]; kept up where the scenario or a key of
    /// the manifest needs them.
    pub fn previous_steps(&self) -> &[f64] {
        &self.memory.steps
    }
}

impl VectorEnvironment for PhysicalActivity {
    fn lanes(&self) -> usize {
        self.statuses.len()
    }

    fn action_spec(&self) -> ActionSpec {
        let e = &self.parameters;
        let [least, most] = match (Dynamics::of(e).range(), e.step_noise) {
            (_, StepNoise::Gamma) => [0.0, f64::INFINITY],
            (range, StepNoise::None) if e.steps_cut_at_zero => range.map(|steps| steps.max(0.0)),
            (range, StepNoise::None) => range,
        };
        let [least, most] = match e.can_pay_nothing() {
            true => [least.min(0.0), most.max(0.0)],
            false => [least, most],
        };
        ActionSpec {
            count: Action::COUNT,
            lowest_reward: least - e.message_cost,
            highest_reward: most,
        }
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.observer.spec()
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        let count = self.lanes();
        self.drawn.fill(false);
        for lane in (0..count).filter(|lane| lanes.contains(*lane)) {
            self.drawn[lane] = true;
            self.times[lane] = 0;
            self.habituation[lane] = self.parameters.initial_habituation;
            self.disengagement[lane] = self.parameters.initial_disengagement;
            self.statuses[lane] = EpisodeStatus::Running;
            self.memory.reset(lane);
        }
        let is_fixed = self.parameters.first_context == FirstContext::Fixed;
        if is_fixed {
            for lane in (0..count).filter(|lane| lanes.contains(*lane)) {
                self.set_context(lane, ContextDraw::FIXED_FIRST);
            }
        }
        if !is_fixed || self.parameters.availability < 1.0 {
            self.sample(Moment::Reset, lanes, streams);
        }
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        for (drawn, status) in self.drawn.iter_mut().zip(&self.statuses) {
            *drawn = *status == EpisodeStatus::Running;
        }
        if self.full.is_some() {
            self.noisy_step(actions, rewards, streams);
        } else {
            self.apply_actions(actions, rewards);
        }
        self.sample(Moment::Step, LaneSet::All, streams);
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        let lanes = self.lanes();
        let states = LaneStates {
            times: &self.times,
            contexts: &self.contexts[..lanes],
            probabilities: &self.probabilities[..lanes],
            likely: &self.likely[..lanes],
            habituation: &self.habituation,
            disengagement: &self.disengagement,
            available: &self.memory.available,
            messages: &self.memory.messages,
            actions: &self.memory.actions,
            steps: &self.memory.steps,
        };
        self.observer.observe(states, out);
    }

    /// The steps walked: without the cost of messages.
    fn outcomes<'a>(&'a self, rewards: &'a [f64]) -> &'a [f64] {
        if self.parameters.message_cost > 0.0 { &self.memory.walked } else { rewards }
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
        if self.full.is_some() { self.memory.save(out) } else { Ok(()) }
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
        if self.full.is_some() { self.memory.restore(from) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests;
