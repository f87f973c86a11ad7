//! Populations: distributions of the environment's parameters over participants.
//!
//! In: the keys of `[population]`, an environment and a random stream. Out: the environment of each
//! participant. A participant takes part in one episode. Participant i of a stream is the same person for any
//! actions and any set of varying parameters, because every parameter uses its own word among the
//! participant's words.

use crate::env::step_count::parameters::StepCount;
use crate::key::{Column, Distribution, Keyed, Kind, Rows, choices, keys};
use crate::rng::{Stream, open_unit_from_bits};

choices! {
    /// The phases of a job that meet the participants.
    pub enum PopulationPhases {
        /// Training and test.
        All = "all",
        /// The test. The training meets one person, who has the parameters of the environment.
        Test = "test",
    }
}

/// Declares the keys of distributions: one for each real-valued parameter.
macro_rules! distributions {
    ($($(#[doc = $doc:literal])+ $name:ident in $kind:expr, $set:expr;)+) => {
        keys! {
            /// How the parameters of participants are distributed. A parameter without a distribution
            /// has the value of `[environment]`.
            pub struct Population {
                /// phases of a job that draw participants: "all", or "test" only, so that training
                /// uses one person with the parameters of the environment
                phases: PopulationPhases = PopulationPhases::All, before PopulationPhases::All;
                /// rows of parameters that participants are drawn from, so that parameters can be
                /// correlated, with an optional column of weights
                rows: Rows = Rows::default(), before Rows::default(), in Kind::Rows(COLUMNS);
                $(
                    $(#[doc = $doc])+
                    $name: Distribution = Distribution::Fixed, before Distribution::Fixed,
                        in Kind::Distribution($kind.number_range());
                )+
            }
        }

        /// The parameters that rows can have columns for.
        const COLUMNS: &[Column] = &[$(Column { name: stringify!($name), of: $kind.number_range() }),+];

        /// The functions that set each column's value in an environment.
        const SETTERS: &[fn(&mut StepCount, f64)] = &[$($set),+];

        impl Population {
            /// The distributions, in the order of [`COLUMNS`].
            fn distributions(&self) -> [&Distribution; COLUMNS.len()] {
                [$(&self.$name),+]
            }
        }
    };
}

// The index of a parameter is the index of its word among a participant's words, so new parameters come last.
distributions! {
    /// feature noise of participants; context inference uses each participant's value
    sigma in Kind::NON_NEGATIVE, |e, x| e.sigma = x;
    /// habituation decay of participants
    delta_h in Kind::PROBABILITY, |e, x| e.delta_h = x;
    /// habituation increment of participants
    epsilon_h in Kind::PROBABILITY, |e, x| e.epsilon_h = x;
    /// disengagement-risk decay of participants
    delta_d in Kind::PROBABILITY, |e, x| e.delta_d = x;
    /// disengagement-risk increment of participants
    epsilon_d in Kind::PROBABILITY, |e, x| e.epsilon_d = x;
    /// base reward of an untailored message for participants, in steps
    rho_1 in Kind::ANY_REAL, |e, x| e.rho_1 = x;
    /// base reward of a message tailored to the true context for participants, in steps
    rho_2 in Kind::ANY_REAL, |e, x| e.rho_2 = x;
    /// base reward of a wrongly tailored message for participants, in steps
    rho_3 in Kind::ANY_REAL, |e, x| e.rho_3 = x;
    /// baseline reward of participants, the same in both contexts, in steps
    mu in Kind::ANY_REAL, |e, x| e.mu = [x; 2];
    /// baseline reward of participants in context 0, in steps; overrides `mu`
    mu_0 in Kind::ANY_REAL, |e, x| e.mu[0] = x;
    /// baseline reward of participants in context 1, in steps; overrides `mu`
    mu_1 in Kind::ANY_REAL, |e, x| e.mu[1] = x;
    /// habituation of participants at the start
    initial_habituation in Kind::PROBABILITY, |e, x| e.initial_habituation = x;
    /// disengagement risk of participants at the start
    initial_disengagement in Kind::PROBABILITY, |e, x| e.initial_disengagement = x;
    /// disengagement risk at which participants leave
    disengagement_threshold in THRESHOLD, |e, x| e.disengagement_threshold = x;
    /// width of participants' uniform noise; only with state_noise = "uniform"
    state_spread in SPREAD, |e, x| e.state_spread = x;
    /// concentration of participants' noise of habituation; only with state_noise = "beta"
    kappa_h in Kind::POSITIVE, |e, x| e.kappa_h = x;
    /// concentration of participants' noise of disengagement risk; only with state_noise = "beta"
    kappa_d in Kind::POSITIVE, |e, x| e.kappa_d = x;
    /// standard deviation of participants' steps; only with step_noise = "gamma"
    sigma_s in Kind::POSITIVE, |e, x| e.sigma_s = x;
    /// width of the noise of participants' delta_h, epsilon_h, delta_d and epsilon_d
    parameter_spread in SPREAD, |e, x| e.parameter_spread = x;
    /// probability of context 1 for participants; context inference uses each participant's value
    context_probability in Kind::PROBABILITY, |e, x| e.context_probability = x;
    /// correlation of a participant's consecutive contexts
    context_persistence in Kind::PROBABILITY, |e, x| e.context_persistence = x;
    /// probability that a message can be sent to participants at a step
    availability in Kind::PROBABILITY, |e, x| e.availability = x;
    /// cost of a message to participants in the reward that agents learn from, in steps
    message_cost in Kind::NON_NEGATIVE, |e, x| e.message_cost = x;
}

/// The range of thresholds, as in the environment.
const THRESHOLD: Kind = Kind::PositiveReal { max: 1.0 };
/// The range of widths of relative noise, as in the environment.
const SPREAD: Kind = Kind::Real { min: 0.0, max: 2.0 };

impl Default for Population {
    fn default() -> Self {
        Population::with_required(&[])
    }
}

impl Population {
    /// Whether the population gives values for the parameter of this name.
    fn gives(&self, name: &str) -> bool {
        self.rows.columns().contains(&name) || self.range(name).is_some()
    }

    /// The smallest and largest values of a parameter that the population gives.
    fn range(&self, name: &str) -> Option<[f64; 2]> {
        let index = COLUMNS.iter().position(|column| column.name == name)?;
        self.rows.range(name).or_else(|| self.distributions()[index].range())
    }

    /// Whether every participant has the environment's own parameters.
    pub fn is_homogeneous(&self) -> bool {
        self.names().next().is_none()
    }

    /// The parameters that the population gives, in the order of the keys.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        COLUMNS.iter().map(|column| column.name).filter(|name| self.gives(name))
    }

    /// A parameter that has both a distribution and a column of rows, if there is one.
    pub fn given_twice(&self) -> Option<&'static str> {
        let both = COLUMNS.iter().zip(self.distributions()).find(|(column, distribution)| {
            distribution.range().is_some() && self.rows.columns().contains(&column.name)
        });
        both.map(|(column, _)| column.name)
    }

    /// The environment with all features that any participant needs: the largest noise and costs, the
    /// smallest availability, and unequal or persistent contexts.
    pub fn widest(&self, environment: &StepCount) -> StepCount {
        let [smallest, mut widest] =
            [Extreme::Smallest, Extreme::Largest].map(|end| self.extreme(environment, end));
        widest.availability = smallest.availability;
        if widest.context_probability == 0.5 {
            widest.context_probability = smallest.context_probability;
        }
        widest
    }

    /// Whether messages can be unavailable at some steps for anybody, for lack of availability or budget.
    pub fn can_withhold(&self, environment: &StepCount) -> bool {
        let smallest = self.range("availability").map(|range| range[Extreme::Smallest as usize]);
        smallest.unwrap_or(environment.availability) < 1.0 || environment.can_spend_budget()
    }

    /// The environment with the smallest or largest values that participants can have.
    pub(super) fn extreme(&self, environment: &StepCount, extreme: Extreme) -> StepCount {
        let mut with = environment.clone();
        for (column, set) in COLUMNS.iter().zip(SETTERS) {
            if let Some(range) = self.range(column.name) {
                set(&mut with, range[extreme as usize]);
            }
        }
        with
    }
}

/// An end of the ranges of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Extreme {
    Smallest = 0,
    Largest = 1,
}

/// Draws participants.
#[derive(Clone, Debug)]
pub struct ParticipantSampler {
    rows: Rows,
    /// The indices in [`COLUMNS`] of the rows' columns.
    row_indices: Vec<usize>,
    /// Index in [`COLUMNS`] and distribution of single parameters.
    single: Vec<(usize, Distribution)>,
    /// The indices in [`COLUMNS`] of all parameters that the population gives.
    given: Vec<usize>,
}

/// The participant's word that chooses a row; the words of parameters follow it.
const ROW_WORD: usize = 0;

impl ParticipantSampler {
    /// A sampler of the population's participants.
    pub fn new(population: &Population) -> Self {
        let index = |name: &str| COLUMNS.iter().position(|column| column.name == name);
        let distributions = population.distributions().into_iter().cloned().enumerate();
        let single = distributions.filter(|(_, distribution)| distribution.range().is_some());
        let given = (0..COLUMNS.len()).filter(|index| population.gives(COLUMNS[*index].name));
        ParticipantSampler {
            rows: population.rows.clone(),
            row_indices: population.rows.columns().iter().filter_map(|name| index(name)).collect(),
            single: single.collect(),
            given: given.collect(),
        }
    }

    /// The names of all parameters that can differ between participants, by index.
    pub fn all_names() -> impl Iterator<Item = &'static str> {
        COLUMNS.iter().map(|column| column.name)
    }

    /// The indices of the parameters that are drawn, in ascending order.
    pub fn indices(&self) -> &[usize] {
        &self.given
    }

    /// Draws the stream's next participant: the values of the parameters, in the order of their indices.
    pub fn participant(&self, stream: &mut Stream) -> Vec<f64> {
        let mut values = vec![0.0; self.given.len()];
        self.fill(stream, &mut values);
        values
    }

    /// Draws the stream's next participant: fills `values` with one value per parameter, in the order of
    /// their indices.
    pub(super) fn fill(&self, stream: &mut Stream, values: &mut [f64]) {
        let words = stream.next_participant();
        let share = |index: usize| open_unit_from_bits(words[index]);
        // `mu` is set before `mu_0` and `mu_1`, which override it.
        let mut drawn = [f64::NAN; COLUMNS.len()];
        let row = self.rows.row(share(ROW_WORD));
        for (index, value) in self.row_indices.iter().zip(row) {
            drawn[*index] = *value;
        }
        for (index, distribution) in &self.single {
            if let Some(value) = distribution.quantile(share(ROW_WORD + 1 + index)) {
                drawn[*index] = value;
            }
        }
        for (index, value) in self.given.iter().zip(values) {
            *value = drawn[*index];
        }
    }

    /// Sets drawn values in an environment.
    pub(super) fn give(&self, values: &[f64], person: &mut StepCount) {
        for (index, value) in self.given.iter().zip(values) {
            SETTERS[*index](person, *value);
        }
    }
}

#[cfg(test)]
mod tests;
