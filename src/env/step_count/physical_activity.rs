//! The physical-activity simulation of Karine et al. (2023), section 3.1, with the additions of
//! StepCountJITAI (2024) and of the manifest's keys. `docs/environment.md` states the model.

use crate::env::companion_words::CompanionWords;
use crate::env::history::History;
use crate::env::observation::Observations;
use crate::env::scenario::Scenario;
use crate::env::step_count::context::{
    ContextChain, ContextDraw, ContextDraws, ContextDrawsAhead, Inference, LaneInference,
};
use crate::env::step_count::dynamics::{Alike, Dynamics, LaneDynamics};
use crate::env::step_count::filter::{Beliefs, Evidence, Filters, Update};
use crate::env::step_count::full_step::{FullStep, Memory, is_needed};
use crate::env::step_count::noise::{DrawnNoise, ForcedNoise, Noise, Silence};
use crate::env::step_count::observer::{LaneStates, Observer};
use crate::env::step_count::parameters::{
    DisengagementReward, FirstContext, RewardHabituation, StateNoise, StepCount,
};
use crate::env::step_count::participants::Participants;
use crate::env::step_count::plain_step::{PlainNoise, PlainStep, UniformNoise};
use crate::env::step_count::population::Population;
use crate::env::vector::{Action, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment};
use crate::kernel::{Isa, LINE};
use crate::rng::{Companion, unit_from_bits};

/// The number of `f64`s in the widest register.
const REGISTER: usize = LINE / size_of::<f64>();

/// Many episodes of the simulation; entry i of every array belongs to lane i.
///
/// A step draws one word per lane. From a shared stream, it draws for every lane in lane order, including
/// ended lanes. With one stream per lane, it draws for the running lanes. A reset draws one word for each
/// lane that it resets if the first context is sampled or messages are not always available, and no words
/// otherwise. Noise comes from companions of the streams, at the position of that word.
#[derive(Clone, Debug)]
pub struct PhysicalActivity {
    parameters: StepCount,
    dynamics: Alike,
    scenario: Scenario,
    observer: Observer,
    /// `None` if observations show only the current step.
    history: Option<History>,
    times: Vec<u32>,
    /// Padded like `probabilities` and `likely`, so that draws fill whole registers.
    contexts: Vec<u8>,
    probabilities: Vec<f64>,
    likely: Vec<u8>,
    habituation: Vec<f64>,
    disengagement: Vec<f64>,
    statuses: Vec<EpisodeStatus>,
    /// Plain steps do not maintain it: their lanes stay as at a reset, where messages are available and none is sent.
    memory: Memory,
    /// `None` if steps have no noise and are not full. Plain steps have uniform noise of the state.
    noise: Option<Box<DrawnNoise>>,
    /// Whether steps are full: the plain step does not suffice.
    is_full: bool,
    /// The lanes that get a new context: lanes that were running before the step, or that are being reset.
    drawn: Vec<bool>,
    /// The stream words for the next contexts, and the words of companions for them and for their availability.
    words: Vec<u64>,
    context_words: CompanionWords,
    availability_words: CompanionWords,
    /// Whether contexts persist or have unequal probabilities.
    is_chained: bool,
    /// Whether messages can be unavailable at some steps, and whether messages have a cost.
    is_limited: bool,
    has_costs: bool,
    /// `None` if the scenario has no letter of a belief.
    filters: Option<Box<Filters>>,
    /// `None` if every lane has the environment's parameters.
    participants: Option<Box<Participants>>,
    /// Contexts computed ahead for a single lane.
    ahead: ContextDrawsAhead,
    isa: Isa,
}

/// The occasions on which contexts are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Moment {
    /// Before the first step of an episode.
    Reset,
    /// After a step.
    Step,
}

impl PhysicalActivity {
    /// `lanes` lanes, all ended, with the observations of a scenario.
    pub fn new(parameters: &StepCount, scenario: &Scenario, lanes: usize) -> Self {
        PhysicalActivity::of_people(parameters, &Population::default(), scenario, lanes)
    }

    /// The same simulation with participants of a population, all lanes ended. Every episode has the next
    /// participant of its lane's stream.
    pub fn with_population(&self, population: &Population) -> Self {
        let lanes = self.lanes();
        PhysicalActivity::of_people(&self.parameters, population, &self.scenario, lanes)
            .with_history(self.history_length())
    }

    fn of_people(
        parameters: &StepCount,
        population: &Population,
        scenario: &Scenario,
        lanes: usize,
    ) -> Self {
        let padded = lanes.next_multiple_of(REGISTER);
        // The features that any participant needs.
        let widest = population.widest(parameters);
        let participants = (!population.is_homogeneous())
            .then(|| Box::new(Participants::new(parameters, population, lanes, padded)));
        let is_full = is_needed(&widest, scenario);
        let has_noise = is_full || widest.state_noise == StateNoise::Uniform;
        PhysicalActivity {
            observer: Observer::new(parameters, scenario),
            history: None,
            times: vec![0; lanes],
            contexts: vec![0; padded],
            probabilities: vec![0.0; padded],
            likely: vec![0; padded],
            habituation: vec![0.0; lanes],
            disengagement: vec![0.0; lanes],
            statuses: vec![EpisodeStatus::Truncated; lanes],
            memory: Memory::new(lanes),
            noise: has_noise.then(|| Box::new(DrawnNoise::new(&widest, lanes))),
            is_full,
            drawn: vec![false; padded],
            words: vec![0; padded],
            context_words: CompanionWords::new(Companion::Context, lanes),
            availability_words: CompanionWords::new(Companion::Availability, lanes),
            is_chained: !widest.has_independent_fair_contexts(),
            is_limited: widest.availability < 1.0,
            has_costs: widest.message_cost > 0.0,
            filters: Filters::new(&widest, scenario, lanes).map(Box::new),
            participants,
            ahead: ContextDrawsAhead::new(parameters.sigma),
            isa: Isa::chosen(),
            parameters: parameters.clone(),
            dynamics: Alike(Dynamics::of(parameters)),
            scenario: scenario.clone(),
        }
    }

    /// The same simulation with another number of lanes, all ended.
    pub fn with_lanes(&self, lanes: usize) -> Self {
        let none = Population::default();
        let population = self.participants.as_ref().map_or(&none, |people| people.population());
        PhysicalActivity::of_people(&self.parameters, population, &self.scenario, lanes)
            .with_history(self.history_length())
    }

    /// The same simulation, all lanes ended, with the last `length` observations of an episode stacked in
    /// every observation; see [`History`].
    pub fn with_history(self, length: usize) -> Self {
        let history = History::new(length, self.lanes(), &self.observer.spec());
        PhysicalActivity { history, ..self }
    }

    /// The number of observations stacked in every observation.
    fn history_length(&self) -> usize {
        self.history.as_ref().map_or(1, History::length)
    }

    /// The states as an observer sees them.
    #[inline]
    pub(super) fn states(&self) -> LaneStates<'_> {
        let lanes = self.lanes();
        LaneStates {
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
            beliefs: self.filters.as_ref().map_or(Beliefs::NONE, |filters| filters.beliefs()),
        }
    }

    /// Stores the current observations in the history, before a step.
    fn remember(&mut self) {
        if let Some(mut history) = self.history.take() {
            let observe = |out: &mut Observations| self.observer.observe(self.states(), out);
            history.remember(&self.statuses, observe);
            self.history = Some(history);
        }
    }

    /// Takes a step without noise, which changes rewards, habituation, disengagement risk, clocks and
    /// statuses, but not contexts.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\].
    pub fn apply_actions(&mut self, actions: &[Action], rewards: &mut [f64]) {
        self.remember();
        self.act(actions, rewards);
    }

    /// A step without noise; the caller has stored the observations.
    fn act(&mut self, actions: &[Action], rewards: &mut [f64]) {
        if self.is_full {
            self.full_step(&Silence, actions, rewards);
        } else {
            self.plain_step(Silence, actions, rewards);
        }
    }

    fn plain_step(&mut self, noise: impl PlainNoise, actions: &[Action], rewards: &mut [f64]) {
        assert_eq!(actions.len(), self.lanes(), "one action per lane");
        assert_eq!(rewards.len(), self.lanes(), "one reward per lane");
        if let Some(people) = self.participants.take() {
            self.plain_step_of(&people.dynamics(), noise, actions, rewards);
            self.participants = Some(people);
        } else {
            let alike = self.dynamics;
            self.plain_step_of(&alike, noise, actions, rewards);
        }
    }

    fn plain_step_of(
        &mut self,
        dynamics: &(impl LaneDynamics + Copy),
        noise: impl PlainNoise,
        actions: &[Action],
        rewards: &mut [f64],
    ) {
        self.isa.run(PlainStep {
            dynamics,
            noise,
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

    /// Takes a step with the given noise, the same in every lane. The contexts stay as they are.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\].
    pub fn force_step(&mut self, noise: &ForcedNoise, actions: &[Action], rewards: &mut [f64]) {
        self.remember();
        self.full_step(noise, actions, rewards);
    }

    /// Takes a step with noise from the streams.
    fn noisy_step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &LaneStreams) {
        let mut noise = self.noise.take().expect("only steps with noise are noisy");
        noise.draw(&self.drawn, streams);
        if self.is_full {
            self.full_step(&*noise, actions, rewards);
        } else {
            let is_reward_drawn = self.parameters.reward_habituation == RewardHabituation::Drawn;
            let noise = UniformNoise { words: noise.state_words(), is_reward_drawn };
            self.plain_step(noise, actions, rewards);
        }
        self.noise = Some(noise);
    }

    fn full_step(&mut self, noise: &impl Noise, actions: &[Action], rewards: &mut [f64]) {
        if let Some(people) = self.participants.take() {
            self.full_step_of(&people.dynamics(), noise, actions, rewards);
            self.participants = Some(people);
        } else {
            let alike = self.dynamics;
            self.full_step_of(&alike, noise, actions, rewards);
        }
    }

    fn full_step_of(
        &mut self,
        dynamics: &impl LaneDynamics,
        noise: &impl Noise,
        actions: &[Action],
        rewards: &mut [f64],
    ) {
        self.isa.run(FullStep {
            environment: &self.parameters,
            dynamics,
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

    /// Draws contexts and availability of the next step for the lanes marked in `drawn`. From a shared
    /// stream, all of `lanes` consume a word, marked or not.
    fn sample(&mut self, moment: Moment, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        let count = self.lanes();
        if count == 1 && !self.is_chained && !self.is_limited {
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
        if self.is_chained {
            self.context_words.fill(streams, lanes, &self.drawn);
            streams.fill(lanes, &self.drawn, &mut self.words[..count]);
            let chain = ContextChain::of(&self.parameters);
            let chains = self.participants.as_ref().map(|people| people.chains());
            let words = self.words.iter_mut().zip(self.context_words.words()).zip(&self.contexts);
            for (lane, ((word, companion), context)) in words.enumerate() {
                let before = (moment == Moment::Step).then_some(*context);
                let chain = chains.map_or(chain, |chains| chains[lane]);
                *word = chain.word(*word, *companion, before);
            }
        } else {
            streams.fill(lanes, &self.drawn, &mut self.words[..count]);
        }
        if moment == Moment::Reset && self.parameters.first_context == FirstContext::Fixed {
            return;
        }
        if let Some(people) = self.participants.take() {
            self.draw_contexts(people.inference());
            self.participants = Some(people);
        } else {
            self.draw_contexts(Inference::of(&self.parameters));
        }
    }

    /// Derives contexts from the words, for the lanes marked in `drawn`.
    fn draw_contexts(&mut self, inference: impl LaneInference) {
        self.isa.run(ContextDraws {
            drawn: &self.drawn,
            inference,
            words: &self.words,
            contexts: &mut self.contexts,
            probabilities: &mut self.probabilities,
            likely: &mut self.likely,
        });
    }

    /// Begins the beliefs of lanes whose episodes begin.
    fn begin_beliefs(&mut self, lanes: LaneSet<'_>) {
        if let Some(mut filters) = self.filters.take() {
            for lane in (0..self.lanes()).filter(|lane| lanes.contains(*lane)) {
                filters.begin(lane, self.person(lane), self.probabilities[lane]);
            }
            self.filters = Some(filters);
        }
    }

    /// Draws the words for the beliefs after the next step.
    fn draw_beliefs(&mut self, streams: &LaneStreams) {
        if let Some(filters) = &mut self.filters {
            filters.draw(&self.drawn, streams);
        }
    }

    /// Updates the beliefs of the lanes marked in `drawn` after a step.
    pub(super) fn update_beliefs(&mut self, actions: &[Action]) {
        if let Some(mut filters) = self.filters.take() {
            let (has_memory, shows) = (self.is_full, filters.shows());
            let person = |lane: usize| self.person(lane);
            let evidence = |lane: usize| {
                // Plain steps keep no actions, and take every action that is chosen.
                let taken = self.memory.actions[lane].filter(|_| has_memory);
                let is_paid = self.is_paid(lane);
                Evidence {
                    action: taken.unwrap_or(actions[lane]),
                    steps: (shows.steps && is_paid).then_some(self.memory.steps[lane]),
                    disengaged: shows.risk.then_some(self.has_disengaged(lane)),
                    probability: self.probabilities[lane],
                }
            };
            self.isa.run(Update { filters: &mut filters, ran: &self.drawn, person, evidence });
            self.filters = Some(filters);
        }
    }

    /// Whether a lane's episode ended by disengagement.
    fn has_disengaged(&self, lane: usize) -> bool {
        self.statuses[lane] == EpisodeStatus::Terminated
    }

    /// Whether the last step of a lane pays the steps walked.
    fn is_paid(&self, lane: usize) -> bool {
        let zero = self.parameters.disengagement_reward == DisengagementReward::Zero;
        self.times[lane] <= self.parameters.horizon && !(zero && self.has_disengaged(lane))
    }

    fn sample_availability(&mut self, lanes: LaneSet<'_>, streams: &LaneStreams) {
        if !self.is_limited {
            return;
        }
        self.availability_words.fill(streams, lanes, &self.drawn);
        for (lane, word) in self.availability_words.words().iter().enumerate() {
            if self.drawn[lane] {
                let availability = self.person(lane).availability;
                self.memory.available[lane] = unit_from_bits(*word) < availability;
            }
        }
    }

    /// Sets the context of a lane, for replays.
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

    /// Makes what a rule reads of a lane that of another simulation.
    pub(in crate::env) fn show(&mut self, lane: usize, of: &PhysicalActivity) {
        self.set_context(lane, of.context(lane));
        self.set_state(lane, of.habituation[lane], of.disengagement[lane]);
        (self.times[lane], self.statuses[lane]) = (of.times[lane], of.statuses[lane]);
    }

    /// Ends the episode of a lane before its horizon.
    pub fn end(&mut self, lane: usize) {
        self.statuses[lane] = EpisodeStatus::Truncated;
    }

    /// Sets whether a message can be sent in a lane.
    pub fn set_available(&mut self, lane: usize, available: bool) {
        self.memory.available[lane] = available;
    }

    /// The context of a lane and what is inferred about it.
    pub fn context(&self, lane: usize) -> ContextDraw {
        ContextDraw {
            context: self.contexts[lane],
            probability_of_zero: self.probabilities[lane],
            likely: self.likely[lane],
        }
    }

    /// The beliefs of the lanes; `None` if the scenario has no letter of a belief.
    #[cfg(test)]
    pub(super) fn filters(&self) -> Option<&Filters> {
        self.filters.as_deref()
    }

    /// The parameters of the simulation.
    pub fn parameters(&self) -> &StepCount {
        &self.parameters
    }

    /// The parameters of the person in a lane.
    pub fn person(&self, lane: usize) -> &StepCount {
        self.participants.as_ref().map_or(&self.parameters, |people| people.person(lane))
    }

    /// The values drawn for the participant in a lane, with the indices of their parameters; empty without a
    /// population.
    pub fn participant(&self, lane: usize) -> impl Iterator<Item = (usize, f64)> {
        self.participants.iter().flat_map(move |people| people.values(lane))
    }

    /// Whether messages have a cost for any participant.
    pub fn has_costs(&self) -> bool {
        self.has_costs
    }

    /// The number of steps taken in each lane's episode, \[lanes\].
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

    /// Whether a message can be sent in a lane's current step, apart from the budget.
    pub fn is_available(&self, lane: usize) -> bool {
        self.memory.available[lane]
    }

    /// Whether a lane's next step counts: the step after the horizon of `unpaid_last_step` does not.
    pub fn is_counted(&self, lane: usize) -> bool {
        self.times[lane] < self.parameters.horizon
    }

    /// The action that is taken in a lane if an agent chooses `action`: action 0 if messages are unavailable
    /// or the budget is spent.
    pub fn taken(&self, lane: usize, action: Action) -> Action {
        self.memory.taken(self.parameters.message_budget, lane, action)
    }

    /// The steps walked in the last step of every lane, \[lanes\]. They are maintained only if the scenario
    /// or a key of the manifest needs them; uniform noise of the state alone does not.
    pub fn previous_steps(&self) -> &[f64] {
        &self.memory.steps
    }
}

mod contract;
#[cfg(test)]
mod tests;
