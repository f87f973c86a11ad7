//! Reads distributions and rows of participants, and holds the constraints on populations.

use std::fs::{self, File};
use std::io::Read;

use toml::de::DeValue;

use super::fault::Fault;
use super::source::Span;
use super::sweep::{Node, Reader};
use crate::env::{Population, StateNoise, StepNoise};
use crate::key::{
    Assignment, Column, Constraint, Distribution, Keyed, Kind, NumberRange, Parameter, Rows, Value,
    Violation,
};

/// Maximum size of a file of rows in bytes.
const MOST_BYTES: u64 = 10_000_000;

impl Reader<'_> {
    /// A distribution of numbers in a range.
    pub(super) fn distribution(
        &mut self,
        name: &str,
        of: NumberRange,
        node: &Node,
    ) -> Option<Value> {
        match Distribution::read(of, node) {
            Ok(distribution) => Some(Value::Distribution(distribution)),
            Err(error) => {
                let fault = Fault::at(error.span.into(), format!("`{name}`: {}", error.says));
                self.faults.add(match error.help {
                    Some(help) => fault.help(help),
                    None => fault,
                });
                None
            }
        }
    }

    /// Rows, from tables, from a CSV file or from the text of one.
    pub(super) fn rows(
        &mut self,
        name: &str,
        known: &'static [Column],
        node: &Node,
    ) -> Option<Value> {
        let here = Span::from(node.span());
        let read = match node.get_ref() {
            DeValue::Array(items) => Rows::from_tables(known, items).map_err(|error| {
                let span = error.span.map_or(here, Span::from);
                Fault::at(span, format!("`{name}`: {}", error.says))
            }),
            DeValue::String(text) if Rows::is_none(text) => Ok(Rows::default()),
            DeValue::String(text) if Rows::is_csv(text) => Rows::from_csv(known, text)
                .map_err(|error| Fault::at(here, format!("`{name}`: {}", error.says))),
            DeValue::String(file) => self
                .file(file)
                .and_then(|text| {
                    Rows::from_csv(known, &text)
                        .map_err(|error| format!("`{file}`, {}", error.says))
                })
                .map_err(|says| {
                    let fault = Fault::at(here, format!("`{name}`: {says}"));
                    fault.help("a CSV file has a line of names, then one line per row")
                }),
            _ => {
                self.expected(name, &Kind::Rows(known).expectation(), node);
                return None;
            }
        };
        match read {
            Ok(rows) if self.count_in(name, rows.len() * rows.columns().len(), node) => {
                Some(Value::Rows(rows))
            }
            Ok(_) => None,
            Err(fault) => {
                self.faults.add(fault);
                None
            }
        }
    }

    /// The text of a file beside the manifest.
    fn file(&self, name: &str) -> Result<String, String> {
        let path = self.folder.join(name);
        let shown = path.display();
        let unreadable = |reason: &str| format!("`{shown}` cannot be read: {reason}");
        let kind = fs::metadata(&path).map_err(|error| unreadable(&error.to_string()))?;
        // Opening a pipe could block forever.
        if !kind.is_file() {
            return Err(unreadable("it is not a regular file"));
        }
        let mut text = String::new();
        let file = File::open(&path).map_err(|error| unreadable(&error.to_string()))?;
        let read = file.take(MOST_BYTES + 1).read_to_string(&mut text);
        read.map_err(|error| unreadable(&error.to_string()))?;
        if text.len() as u64 > MOST_BYTES {
            return Err(unreadable(&format!("it is larger than {MOST_BYTES} bytes")));
        }
        Ok(text.trim_start_matches('\u{feff}').to_owned())
    }
}

const STATE_NOISE: Parameter = Parameter::Environment("state_noise");
const STEP_NOISE: Parameter = Parameter::Environment("step_noise");

/// Every key of the population, in the order of the keys.
const KEYS: [Parameter; Population::KEYS.len()] = {
    let mut all = [Parameter::Population(""); Population::KEYS.len()];
    let mut place = 0;
    while place < all.len() {
        all[place] = Parameter::Population(Population::KEYS[place].name);
        place += 1;
    }
    all
};

/// The keys of the population, and the keys of the environment for the kinds of noise.
const KEYS_AND_NOISE: [Parameter; KEYS.len() + 2] = {
    let mut all = [STATE_NOISE; KEYS.len() + 2];
    let mut place = 0;
    while place < KEYS.len() {
        all[place] = KEYS[place];
        place += 1;
    }
    all[KEYS.len() + 1] = STEP_NOISE;
    all
};

/// Constraints on every population beyond the ranges of single keys.
pub(super) const CONSTRAINTS: &[Constraint] = &[
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
fn population(assignment: &Assignment) -> Option<Population> {
    let of_population = |key: &Parameter| matches!(key, Parameter::Population(_));
    let keys = assignment.0.iter().filter(|(key, _)| of_population(key));
    let values: Vec<Value> = keys.map(|(_, value)| value.clone().into_owned()).collect();
    Population::from_values(&values)
}
