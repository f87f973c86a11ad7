//! Filters: what a phone can know about contexts, habituation and disengagement risk that it does not observe.
//!
//! In: the parameters of a lane's person and, step by step, the [`Evidence`]: the action taken, the steps walked if
//! the scenario shows them, how the episode stands, and the probability inferred from the new feature. Out: the
//! numbers that the letters `F`, `E` and `R` show. The true state never enters, so that equal evidence gives equal
//! beliefs. `docs/environment.md` defines the letters.
//!
//! The context is one probability ([`contexts`]), and without noise of the state, habituation follows from the actions:
//! both are exact. Particles stand for the rest ([`particles`]): disengagement risk, and where the state has noise
//! also habituation, and the contexts that persist and that steps tell of.

mod contexts;
mod evidence;
mod moments;
mod particles;
mod steps;
#[cfg(test)]
mod tests;

use pulp::{Simd, WithSimd};

use self::contexts::ContextEvidence as Seen;
pub(super) use self::evidence::Evidence;
use self::moments::SIDE;
use self::particles::{ParticleScratch, Particles};
use crate::env::companion_words::CompanionWords;
use crate::env::scenario::Scenario;
use crate::env::step_count::dynamics::Dynamics;
use crate::env::step_count::parameters::{FirstContext, StepCount, StepNoise};
use crate::env::step_count::scenario::Feature;
use crate::env::vector::{LaneSet, LaneStreams};
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

/// What particles stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Method {
    /// Disengagement risk.
    risk: bool,
    /// Habituation.
    habituation: bool,
    /// Contexts, which the steps of a noisy habituation tell of.
    contexts: bool,
}

impl Method {
    /// The method for a scenario in an environment; `None` if the scenario has no letter of a belief.
    fn of(e: &StepCount, scenario: &Scenario) -> Option<Method> {
        let shows = |feature| scenario.features().contains(&feature);
        let (filtered, habituation, risk) = (
            shows(Feature::Filtered),
            shows(Feature::EstimatedHabituation),
            shows(Feature::EstimatedRisk),
        );
        let is_noisy = e.has_noise_of_state();
        let reads_steps = shows(Feature::PreviousSteps) && e.context_persistence > 0.0;
        let contexts = is_noisy && reads_steps;
        let method = Method { risk, habituation: is_noisy && (habituation || risk), contexts };
        (filtered || habituation || risk).then_some(method)
    }

    /// Whether there are particles at all.
    fn has_particles(self) -> bool {
        self.risk || self.habituation || self.contexts
    }
}

/// Whether beliefs of a scenario are approximated by particles.
pub(super) fn has_particles(e: &StepCount, scenario: &Scenario) -> bool {
    Method::of(e, scenario).is_some_and(Method::has_particles)
}

/// Whether the steps that a scenario shows would reveal a noisy habituation that its beliefs do not know: the filter
/// has no such measurements without noise.
pub(super) fn is_undefined(e: &StepCount, scenario: &Scenario) -> bool {
    has_particles(e, scenario)
        && e.has_noise_of_state()
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
    particles: Vec<Particles>,
    /// The words from which the draws of particles come.
    words: CompanionWords,
    /// The draws and the room for a step of one lane; `None` without particles.
    draws: Option<Box<ParticleScratch>>,
}

impl Filters {
    /// The filters for a scenario; `None` if it has no letter of a belief. `widest` is the environment with the
    /// features that any participant needs.
    pub(super) fn new(widest: &StepCount, scenario: &Scenario, lanes: usize) -> Option<Filters> {
        let method = Method::of(widest, scenario)?;
        let shows = |feature| scenario.features().contains(&feature);
        let count_lanes = |is: bool| if is { lanes } else { 0 };
        let with_particles = method.has_particles();
        let most = (widest.belief_particles as usize).next_multiple_of(SIDE);
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
            particles: vec![Particles::new(most); count_lanes(with_particles)],
            words: CompanionWords::new(Companion::Belief, count_lanes(with_particles)),
            draws: with_particles
                .then(|| Box::new(ParticleScratch::new(widest, method.risk, most))),
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
        let mut near = 0.0;
        if let (Some(particles), Some(draws)) = (self.particles.get_mut(lane), &mut self.draws) {
            particles.begin(habituation, risk, zero, draws);
            near = draws.near(&Dynamics::of(person), risk);
        }
        self.zero[lane] = zero;
        (self.habituation[lane], self.habituation_deviation[lane]) = (habituation, 0.0);
        (self.risk[lane], self.risk_deviation[lane], self.near[lane]) = (risk, 0.0, near);
    }

    /// Draws the words of the next step for the lanes marked in `drawn`.
    pub(super) fn draw(&mut self, drawn: &[bool], streams: &LaneStreams) {
        if !self.words.words().is_empty() {
            self.words.fill(streams, LaneSet::All, drawn);
        }
    }

    /// Updates the beliefs of a lane after a step.
    #[inline(always)]
    fn update(&mut self, lane: usize, person: &StepCount, evidence: &Evidence) {
        let dynamics = Dynamics::of(person);
        let seen = Seen::new(person, evidence.probability);
        let method = self.method;
        if !method.habituation {
            // Without noise, it does not depend on the context.
            let before = self.habituation[lane];
            let effect = dynamics.apply(0, evidence.action, before, 0.0);
            self.habituation[lane] = effect.habituation;
        }
        if seen.is_independent() {
            self.zero[lane] = evidence.probability;
        } else if !method.contexts {
            let steps = steps::of_contexts(person, &dynamics, self.habituation[lane], evidence);
            self.zero[lane] = seen.next(self.zero[lane], steps);
        }
        let (Some(particles), Some(draws)) = (self.particles.get_mut(lane), &mut self.draws) else {
            return;
        };
        // No closures: they would be compiled without the instructions that the caller chose.
        let mut moments = None;
        for evidence in [*evidence, evidence.of_action()] {
            if moments.is_none() {
                draws.expand(self.words.words()[lane]);
                moments = particles.update(person, &seen, &evidence, draws);
            }
        }
        let Some(moments) = moments else { return };
        if method.contexts && !seen.is_independent() {
            self.zero[lane] = moments.zero;
        }
        if method.habituation {
            [self.habituation[lane], self.habituation_deviation[lane]] = moments.habituation;
        }
        [self.risk[lane], self.risk_deviation[lane]] = moments.risk;
        self.near[lane] = moments.near;
    }
}

resumable!([] Filters {
    fixed zero, habituation, habituation_deviation, risk, risk_deviation, near;
    each particles
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
    fn with_simd<S: Simd>(self, _: S) {
        for lane in 0..self.filters.zero.len() {
            if self.ran[lane] {
                let evidence = (self.evidence)(lane);
                self.filters.update(lane, (self.person)(lane), &evidence);
            }
        }
    }
}
