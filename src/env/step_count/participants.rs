//! The participants in the lanes: the parameters of every lane.

use crate::env::step_count::context::{ContextChain, Inference, LaneInference};
use crate::env::step_count::dynamics::{Dynamics, LaneDynamics};
use crate::env::step_count::parameters::StepCount;
use crate::env::step_count::population::{ParticipantSampler, Population};
use crate::rng::Stream;
use crate::state::resumable;

/// The participants in the lanes; every array except `values` is \[lanes\] or longer.
#[derive(Clone, Debug)]
pub(super) struct Participants {
    population: Population,
    sampler: ParticipantSampler,
    /// The drawn parameters, \[lanes, parameters\].
    values: Vec<f64>,
    people: Vec<StepCount>,
    dynamics: Vec<Dynamics>,
    /// Padded like the arrays of contexts.
    inference: Vec<Inference>,
    chains: Vec<ContextChain>,
}

impl Participants {
    /// The environment's own parameters in every lane, before the first draw. `padded` is the length of the
    /// arrays of contexts.
    pub(super) fn new(
        environment: &StepCount,
        population: &Population,
        lanes: usize,
        padded: usize,
    ) -> Self {
        let sampler = ParticipantSampler::new(population);
        Participants {
            values: vec![0.0; lanes * sampler.indices().len()],
            population: population.clone(),
            sampler,
            people: vec![environment.clone(); lanes],
            dynamics: vec![Dynamics::of(environment); lanes],
            inference: vec![Inference::of(environment); padded],
            chains: vec![ContextChain::of(environment); lanes],
        }
    }

    /// The population that participants are drawn from.
    pub(super) fn population(&self) -> &Population {
        &self.population
    }

    /// The indices of the drawn parameters and their values in a lane.
    pub(super) fn values(&self, lane: usize) -> impl Iterator<Item = (usize, f64)> {
        let indices = self.sampler.indices();
        let values = &self.values[lane * indices.len()..(lane + 1) * indices.len()];
        indices.iter().copied().zip(values.iter().copied())
    }

    /// The parameters of a lane.
    pub(super) fn person(&self, lane: usize) -> &StepCount {
        &self.people[lane]
    }

    /// The dynamics of every lane, for a step.
    pub(super) fn dynamics(&self) -> Each<'_, Dynamics> {
        Each(&self.dynamics)
    }

    /// The parameters of context inference in every lane.
    pub(super) fn inference(&self) -> Each<'_, Inference> {
        Each(&self.inference)
    }

    /// The context process of every lane, \[lanes\].
    pub(super) fn chains(&self) -> &[ContextChain] {
        &self.chains
    }

    /// Draws the stream's next participant for a lane.
    pub(super) fn draw(&mut self, lane: usize, stream: &mut Stream) {
        let count = self.sampler.indices().len();
        self.sampler.fill(stream, &mut self.values[lane * count..(lane + 1) * count]);
        self.derive(lane);
    }

    /// Updates the parameters of a lane from its drawn values.
    fn derive(&mut self, lane: usize) {
        let count = self.sampler.indices().len();
        let values = &self.values[lane * count..(lane + 1) * count];
        self.sampler.give(values, &mut self.people[lane]);
        let person = &self.people[lane];
        self.dynamics[lane] = Dynamics::of(person);
        self.inference[lane] = Inference::of(person);
        self.chains[lane] = ContextChain::of(person);
    }

    /// Derives the values of all lanes.
    fn derive_all(&mut self) {
        (0..self.people.len()).for_each(|lane| self.derive(lane));
    }
}

resumable!([] Participants { fixed values; then derive_all });

/// One value per lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Each<'a, T>(&'a [T]);

impl LaneDynamics for Each<'_, Dynamics> {
    #[inline(always)]
    fn of(&self, lane: usize) -> &Dynamics {
        &self.0[lane]
    }
}

impl LaneInference for Each<'_, Inference> {
    #[inline(always)]
    fn of(&self, lane: usize) -> Inference {
        self.0[lane]
    }
}
