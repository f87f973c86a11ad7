//! Filters: what a phone can know about contexts, habituation and disengagement risk that it does not observe.
//!
//! In: the parameters of a lane's person and, step by step, the [`Evidence`]: the action taken, the steps walked if
//! the scenario shows them, how the episode stands, and the probability inferred from the new feature. Out: the
//! numbers that the letters `F`, `E` and `R` show. The true state never enters, so that equal evidence gives equal
//! beliefs. `docs/environment.md` defines the letters.
//!
//! Without noise of the state, habituation follows from the actions, the context is one probability
//! ([`contexts`]), and disengagement risk is a finite mixture over the contexts that a phone does not know
//! ([`mixture`]). With noise, particles stand for all three ([`particles`]).

mod contexts;
mod evidence;
mod mixture;
mod moments;
mod particles;
mod steps;
#[cfg(test)]
mod tests;

use pulp::{Simd, WithSimd};

use self::contexts::Feature as Seen;
pub(super) use self::evidence::Evidence;
use self::mixture::{ATOMS, Mixture, Successors};
use self::moments::{Moments, is_near};
use self::particles::{Draws, PARTICLES, Particles};
use crate::env::companion_words::CompanionWords;
use crate::env::scenario::Scenario;
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::parameters::{FirstContext, StateNoise, StepCount, StepNoise};
use crate::env::step_count::scenario::Feature;
use crate::env::vector::{Action, LaneSet, LaneStreams};
use crate::rng::Companion;
use crate::state::resumable;

/// What the letters of beliefs show; every array is \[lanes\].
#[derive(Clone, Copy, Debug)]
pub struct Beliefs<'a> {
    /// The probability of context 0.
    pub zero: &'a [f64],
    /// Mean and standard deviation of habituation.
    pub habituation: [&'a [f64]; 2],
    /// Mean and standard deviation of disengagement risk.
    pub risk: [&'a [f64]; 2],
    /// The probability that a wrong message would reach the threshold.
    pub near: &'a [f64],
}

impl Beliefs<'_> {
    /// No beliefs, for scenarios without their letters.
    pub const NONE: Beliefs<'static> =
        Beliefs { zero: &[], habituation: [&[]; 2], risk: [&[]; 2], near: &[] };
}

/// What a scenario shows of what matters to beliefs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shows {
    /// The steps walked, where the filter has their density.
    pub(super) steps: bool,
    /// The estimated risk. Beliefs then take into account whether the episode runs.
    pub(super) risk: bool,
}

/// How beliefs are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Method {
    /// One probability, and habituation from the actions.
    Contexts,
    /// A mixture of disengagement risks.
    Mixture,
    /// Particles.
    Particles,
}

impl Method {
    /// The method for a scenario in an environment; `None` if the scenario has no letter of a belief.
    fn of(e: &StepCount, scenario: &Scenario) -> Option<Method> {
        let shows = |feature| scenario.features().contains(&feature);
        let (habituation, risk) =
            (shows(Feature::EstimatedHabituation), shows(Feature::EstimatedRisk));
        let filtered = shows(Feature::Filtered);
        if !(filtered || habituation || risk) {
            return None;
        }
        let is_noisy = e.state_noise != StateNoise::None || e.parameter_spread > 0.0;
        // Steps tell of a context by way of habituation.
        let reads_steps = shows(Feature::PreviousSteps) && e.context_persistence > 0.0;
        if is_noisy && (habituation || risk || reads_steps) {
            Some(Method::Particles)
        } else if risk {
            Some(Method::Mixture)
        } else {
            Some(Method::Contexts)
        }
    }
}

/// Whether the steps that a scenario shows would reveal a noisy habituation that its beliefs do not know: the filter
/// has no such measurements without noise.
pub(super) fn is_undefined(e: &StepCount, scenario: &Scenario) -> bool {
    Method::of(e, scenario) == Some(Method::Particles)
        && scenario.features().contains(&Feature::PreviousSteps)
        && e.step_noise == StepNoise::None
}

/// The filters of all lanes; every array is \[lanes\], or empty if the method does not need it.
#[derive(Clone, Debug)]
pub(super) struct Filters {
    method: Method,
    shows: Shows,
    zero: Vec<f64>,
    habituation: Vec<f64>,
    habituation_deviation: Vec<f64>,
    risk: Vec<f64>,
    risk_deviation: Vec<f64>,
    near: Vec<f64>,
    mixtures: Vec<Mixture>,
    /// Room for a step of one lane.
    successors: Successors,
    particles: Vec<Particles>,
    /// The words from which the draws of particles come.
    words: CompanionWords,
    /// The draws and the room for a step of one lane; `None` without particles.
    draws: Option<Box<Draws>>,
}

impl Filters {
    /// The filters for a scenario; `None` if it has no letter of a belief. `widest` is the environment with the
    /// features that any participant needs.
    pub(super) fn new(widest: &StepCount, scenario: &Scenario, lanes: usize) -> Option<Filters> {
        let method = Method::of(widest, scenario)?;
        let shows = |feature| scenario.features().contains(&feature);
        let of = |is: bool| if is { lanes } else { 0 };
        let with_particles = method == Method::Particles;
        Some(Filters {
            method,
            shows: Shows {
                steps: shows(Feature::PreviousSteps) && !is_undefined(widest, scenario),
                risk: shows(Feature::EstimatedRisk),
            },
            zero: vec![0.5; lanes],
            habituation: vec![0.0; lanes],
            habituation_deviation: vec![0.0; lanes],
            risk: vec![0.0; lanes],
            risk_deviation: vec![0.0; lanes],
            near: vec![0.0; lanes],
            mixtures: vec![Mixture::new(ATOMS); of(method == Method::Mixture)],
            successors: Successors::new(ATOMS),
            particles: vec![Particles::new(PARTICLES); of(with_particles)],
            words: CompanionWords::new(Companion::Belief, of(with_particles)),
            draws: with_particles.then(|| Box::new(Draws::new(widest, PARTICLES))),
        })
    }

    /// The beliefs of all lanes.
    #[inline]
    pub(super) fn beliefs(&self) -> Beliefs<'_> {
        Beliefs {
            zero: &self.zero,
            habituation: [&self.habituation, &self.habituation_deviation],
            risk: [&self.risk, &self.risk_deviation],
            near: &self.near,
        }
    }

    /// What the scenario shows.
    pub(super) fn shows(&self) -> Shows {
        self.shows
    }

    /// Begins an episode in a lane, where `probability` is inferred from the first feature.
    pub(super) fn begin(&mut self, lane: usize, person: &StepCount, probability: f64) {
        let zero = match person.first_context {
            FirstContext::Fixed => 1.0,
            FirstContext::Sampled => probability,
        };
        let (habituation, risk) = (person.initial_habituation, person.initial_disengagement);
        let is_near = is_near(&Dynamics::of(person), risk);
        self.set(
            lane,
            Moments {
                zero,
                habituation: [habituation, 0.0],
                risk: [risk, 0.0],
                near: f64::from(u8::from(is_near)),
            },
        );
        if let Some(mixture) = self.mixtures.get_mut(lane) {
            mixture.begin(risk, zero);
        }
        if let Some(particles) = self.particles.get_mut(lane) {
            particles.begin(habituation, risk, zero);
        }
    }

    /// Draws the words of the next step for the lanes marked in `drawn`.
    pub(super) fn draw(&mut self, drawn: &[bool], streams: &LaneStreams) {
        if !self.words.words().is_empty() {
            self.words.fill(streams, LaneSet::All, drawn);
        }
    }

    /// Updates the beliefs of a lane after a step.
    #[inline(always)]
    fn update<S: Simd>(&mut self, simd: S, lane: usize, person: &StepCount, evidence: &Evidence) {
        let dynamics = Dynamics::of(person);
        let seen = Seen::new(person, evidence.probability);
        match self.method {
            Method::Contexts => {
                let habituation = self.habituated(lane, &dynamics, evidence.action);
                if !seen.is_independent() {
                    let steps = steps::of_contexts(person, &dynamics, habituation, evidence);
                    self.zero[lane] = seen.next(self.zero[lane], steps);
                }
            }
            Method::Mixture => {
                let habituation = self.habituated(lane, &dynamics, evidence.action);
                for evidence in [*evidence, evidence.of_action()] {
                    let steps = steps::of_contexts(person, &dynamics, habituation, &evidence);
                    let (mixture, room) = (&mut self.mixtures[lane], &mut self.successors);
                    let moments = mixture.update(simd, &dynamics, &seen, steps, &evidence, room);
                    if let Some(moments) = moments {
                        self.set(lane, Moments { habituation: [habituation, 0.0], ..moments });
                        break;
                    }
                }
            }
            Method::Particles => {
                let Some(draws) = &mut self.draws else { return };
                draws.expand(self.words.words()[lane]);
                for evidence in [*evidence, evidence.of_action()] {
                    let moments = self.particles[lane].update(person, &seen, &evidence, draws);
                    if let Some(moments) = moments {
                        self.set(lane, moments);
                        break;
                    }
                }
            }
        }
        if seen.is_independent() {
            self.zero[lane] = evidence.probability;
        }
    }

    /// Habituation after an action without noise; it does not depend on the context.
    #[inline(always)]
    fn habituated(&mut self, lane: usize, dynamics: &Dynamics, action: Action) -> f64 {
        let effect = dynamics.apply(0, action, self.habituation[lane], 0.0);
        self.habituation[lane] = effect.habituation;
        effect.habituation
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, moments: Moments) {
        self.zero[lane] = moments.zero;
        [self.habituation[lane], self.habituation_deviation[lane]] = moments.habituation;
        [self.risk[lane], self.risk_deviation[lane]] = moments.risk;
        self.near[lane] = moments.near;
    }
}

resumable!([] Filters {
    fixed zero, habituation, habituation_deviation, risk, risk_deviation, near;
    each mixtures, particles
});

/// The update of the filters of the lanes marked in `ran`, \[lanes\] or longer, after a step.
pub(super) struct Update<'a, P, E> {
    pub(super) filters: &'a mut Filters,
    pub(super) ran: &'a [bool],
    /// The parameters of the person in a lane.
    pub(super) person: P,
    /// What a step in a lane tells.
    pub(super) evidence: E,
}

impl<'p, P: Fn(usize) -> &'p StepCount, E: Fn(usize) -> Evidence> WithSimd for Update<'_, P, E> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for lane in 0..self.filters.zero.len() {
            if self.ran[lane] {
                let evidence = (self.evidence)(lane);
                self.filters.update(simd, lane, (self.person)(lane), &evidence);
            }
        }
    }
}
