//! Constraints between the keys of the environment and of its population: the size of a noise requires the
//! matching kind of noise, and a parameter of participants is given once.

use super::filter;
use super::parameters::{StateNoise, StepCount, StepNoise};
use super::population::Population;
use crate::env::scenario::Scenario;
use crate::key::{Assignment, Constraint, Keyed, Parameter, Value, Violation};

const STATE_NOISE: Parameter = Parameter::Environment("state_noise");
const STATE_SPREAD: Parameter = Parameter::Environment("state_spread");
const KAPPA_H: Parameter = Parameter::Environment("kappa_h");
const KAPPA_D: Parameter = Parameter::Environment("kappa_d");
const STEP_NOISE: Parameter = Parameter::Environment("step_noise");
const SIGMA_S: Parameter = Parameter::Environment("sigma_s");
const PARAMETER_SPREAD: Parameter = Parameter::Environment("parameter_spread");
const CONTEXT_PERSISTENCE: Parameter = Parameter::Environment("context_persistence");

/// Constraints on every environment beyond the ranges of single keys.
pub const CONSTRAINTS: &[Constraint] = &[
    Constraint {
        parameters: &[STATE_NOISE, STATE_SPREAD],
        violation: |assignment| {
            let is_set = assignment.real(STATE_SPREAD) != UNIFORM_SPREAD;
            let is_read = assignment.is_word(STATE_NOISE, StateNoise::Uniform.word());
            let idle = || {
                let back = format!("{} = {UNIFORM_SPREAD}, its default", STATE_SPREAD.key());
                is_idle(assignment, STATE_SPREAD, STATE_NOISE, StateNoise::Uniform.word(), &back)
            };
            (is_set && !is_read).then(idle)
        },
    },
    Constraint {
        parameters: &[STATE_NOISE, KAPPA_H],
        violation: |assignment| {
            goes_with(assignment, KAPPA_H, STATE_NOISE, StateNoise::Beta.word())
        },
    },
    Constraint {
        parameters: &[STATE_NOISE, KAPPA_D],
        violation: |assignment| {
            goes_with(assignment, KAPPA_D, STATE_NOISE, StateNoise::Beta.word())
        },
    },
    Constraint {
        parameters: &[STEP_NOISE, SIGMA_S],
        violation: |assignment| goes_with(assignment, SIGMA_S, STEP_NOISE, StepNoise::Gamma.word()),
    },
];

/// The default of `state_spread`, which the key keeps under other kinds of noise.
const UNIFORM_SPREAD: f64 = 0.01;

/// A violation, unless the size is above 0 exactly if the noise is of the kind that reads the size.
fn goes_with(
    assignment: &Assignment,
    size: Parameter,
    noise: Parameter,
    kind: &str,
) -> Option<Violation> {
    let is_set = assignment.real(size) > 0.0;
    let is_read = assignment.shown(noise) == format!("{kind:?}");
    match (is_set, is_read) {
        (true, false) => {
            Some(is_idle(assignment, size, noise, kind, &format!("{} = 0", size.key())))
        }
        (false, true) => Some(Violation::Impossible {
            says: format!("`{}` = {kind:?} needs `{}` above 0", noise.key(), size.key()),
            help: format!(
                "{} has no default; where {} is swept, zip the two",
                size.key(),
                noise.key()
            ),
        }),
        (true, true) | (false, false) => None,
    }
}

/// The violation by a size that is set although the kind of noise does not read it.
fn is_idle(
    assignment: &Assignment,
    size: Parameter,
    noise: Parameter,
    kind: &str,
    back: &str,
) -> Violation {
    let (set, found) = (assignment.shown(size), assignment.shown(noise));
    let (size, noise) = (size.key(), noise.key());
    Violation::Impossible {
        says: format!("`{size}` = {set} requires `{noise}` = {kind:?}, found {found}"),
        help: format!("write {noise} = {kind:?} or {back}; where {noise} is swept, zip the two"),
    }
}

/// Every key of the population, in the order of the keys.
const KEYS: [Parameter; Population::KEYS.len()] = {
    let mut all = [Parameter::Population(""); Population::KEYS.len()];
    let mut index = 0;
    while index < all.len() {
        all[index] = Parameter::Population(Population::KEYS[index].name);
        index += 1;
    }
    all
};

/// The keys of the population, and the keys of the environment for the kinds of noise.
const KEYS_AND_NOISE: [Parameter; KEYS.len() + 2] = {
    let mut all = [STATE_NOISE; KEYS.len() + 2];
    let mut index = 0;
    while index < KEYS.len() {
        all[index] = KEYS[index];
        index += 1;
    }
    all[KEYS.len() + 1] = STEP_NOISE;
    all
};

/// The keys of the population, and what decides whether beliefs can be computed.
const KEYS_OF_BELIEFS: [Parameter; KEYS.len() + 5] = {
    let mut all = [Parameter::SCENARIO; KEYS.len() + 5];
    let mut index = 0;
    while index < KEYS.len() {
        all[index] = KEYS[index];
        index += 1;
    }
    all[KEYS.len() + 1] = STATE_NOISE;
    all[KEYS.len() + 2] = STEP_NOISE;
    all[KEYS.len() + 3] = PARAMETER_SPREAD;
    all[KEYS.len() + 4] = CONTEXT_PERSISTENCE;
    all
};

/// The environment of a cell with the parameters that decide whether beliefs can be computed.
fn environment_of_beliefs(assignment: &Assignment) -> Option<StepCount> {
    let word = |key| match assignment.value(key) {
        Some(Value::Choice(word)) => Some(*word),
        _ => None,
    };
    let environment = StepCount {
        state_noise: StateNoise::named(word(STATE_NOISE)?)?,
        step_noise: StepNoise::named(word(STEP_NOISE)?)?,
        parameter_spread: assignment.real(PARAMETER_SPREAD),
        context_persistence: assignment.real(CONTEXT_PERSISTENCE),
        ..StepCount::paper(0.0)
    };
    Some(population(assignment)?.widest(&environment))
}

/// Constraints on every population beyond the ranges of single keys.
pub const PEOPLE_CONSTRAINTS: &[Constraint] = &[
    Constraint {
        parameters: &KEYS_OF_BELIEFS,
        violation: |assignment| {
            let scenario: Scenario = assignment.text(Parameter::SCENARIO).parse().ok()?;
            let environment = environment_of_beliefs(assignment)?;
            filter::is_undefined(&environment, &scenario).then(|| Violation::Impossible {
                says: format!(
                    "no beliefs are computed for {scenario}, whose letter S shows steps without noise of a state \
                     with noise"
                ),
                help: format!(
                    "write {} = \"{}\" with {}, or leave S out of the scenario",
                    STEP_NOISE.key(),
                    StepNoise::Gamma.word(),
                    SIGMA_S.key()
                ),
            })
        },
    },
    Constraint {
        parameters: &KEYS,
        violation: |assignment| {
            let population = population(assignment)?;
            let twice = population.given_twice().map(|name| Violation::Impossible {
                says: format!("`population.{name}` has a distribution and a column of `rows`"),
                help: "leave out one of the two".to_owned(),
            });
            let idle = || {
                let phases = assignment.shown(Parameter::Population("phases"));
                let is_idle = population.is_homogeneous() && population != Population::default();
                is_idle.then(|| Violation::Impossible {
                    says: format!(
                        "`population.phases` = {phases} has no effect: all participants are alike"
                    ),
                    help: "give a key of [population] a distribution".to_owned(),
                })
            };
            twice.or_else(idle)
        },
    },
    Constraint {
        parameters: &KEYS_AND_NOISE,
        violation: |assignment| {
            let population = population(assignment)?;
            let uniform = (STATE_NOISE, StateNoise::Uniform.word());
            let beta = (STATE_NOISE, StateNoise::Beta.word());
            let needs = [
                ("state_spread", uniform),
                ("kappa_h", beta),
                ("kappa_d", beta),
                ("sigma_s", (STEP_NOISE, StepNoise::Gamma.word())),
            ];
            let idle = |(name, (noise, word)): &(&str, (Parameter, &'static str))| {
                population.names().any(|given| given == *name) && !assignment.is_word(*noise, word)
            };
            needs.into_iter().find(idle).map(|(name, (noise, word))| Violation::Impossible {
                says: format!(
                    "`population.{name}` requires `{}` = \"{word}\", found {}",
                    noise.key(),
                    assignment.shown(noise)
                ),
                help: format!("write {noise} = \"{word}\", or leave {name} out of [population]"),
            })
        },
    },
];

/// The population with the values of a cell.
pub fn population(assignment: &Assignment) -> Option<Population> {
    assignment.keyed(|key| matches!(key, Parameter::Population(_)))
}
