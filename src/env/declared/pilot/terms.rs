//! What a pilot is in the terms of a model.

use std::ops::Range;
use std::sync::Arc;

use crate::env::declared::model::ModelFile;
use crate::env::declared::pilot::design::Clamped;
use crate::env::declared::pilot::file::DataFaults;
use crate::env::declared::pilot::section::{EffectSource, FitMethod};
use crate::text::FaultList;

/// Why decisions cannot be read.
#[derive(Debug)]
pub enum PilotError {
    /// The model or its section `[fit]` has faults.
    Model(FaultList),
    /// The file has.
    Data(DataFaults),
    /// The caller asked to stop.
    Stopped,
}

/// The distribution of a fitted draw, with its parameters as a fit sees them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitLaw {
    /// Mean and standard deviation.
    Normal,
    /// Mean and standard deviation of the logarithm.
    Lognormal,
    /// The logit of 1.
    Bernoulli,
    /// The logarithm of the mean.
    Poisson,
    /// The logit of a certain 0, and the logarithm of the mean otherwise.
    ZeroInflatedPoisson,
    /// Logarithms of weights.
    Categorical,
}

/// A person of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotPerson {
    /// The name in the file.
    pub name: String,
    /// The person's decisions; those that the file skips are among them.
    pub decisions: Range<usize>,
}

/// A number that a fit estimates.
#[derive(Clone, Debug, PartialEq)]
pub struct FitCoefficient {
    /// The column of people, or the parameter.
    pub name: String,
    /// Whether it is a parameter of the model instead of a column of people.
    pub is_parameter: bool,
    /// Whether it matters only where an action is taken.
    pub is_effect: bool,
    /// The variables of its terms that need a share of both values, by their index in the pilot.
    pub rare: Vec<usize>,
}

/// A parameter of a fitted draw.
#[derive(Clone, Debug)]
pub struct DrawPredictor {
    /// The name of the parameter.
    pub key: &'static str,
    /// The coefficients that it is linear in, by their index in the pilot.
    pub coefficients: Vec<usize>,
    /// What it is with all of them 0, \[rows\].
    pub offset: Vec<f64>,
    /// \[rows, coefficients\].
    pub design: Vec<f64>,
    /// The parameter of the model that is the whole of it.
    pub parameter: Option<String>,
}

/// A draw whose values the data have.
#[derive(Clone, Debug)]
pub struct FittedDraw {
    /// The variable.
    pub name: String,
    /// The distribution.
    pub law: FitLaw,
    /// How it is fitted.
    pub method: FitMethod,
    /// By parameter of the distribution.
    pub predictors: Vec<DrawPredictor>,
    /// The rows that are used, by the numbers of their decisions.
    pub decisions: Vec<u32>,
    /// Its values, \[rows\]; of a lognormal draw their logarithms.
    pub outcome: Vec<f64>,
    /// \[people\]: their rows.
    pub people: Vec<Range<usize>>,
    /// The numbers of decisions without a value, and without a feature, each with the line of the first.
    pub without: [(usize, u32); 2],
}

impl FittedDraw {
    /// How many rows are used, and how many are not.
    pub fn counts(&self) -> String {
        let left_out = |(count, first): (usize, u32), what: &str| match count {
            0 => format!("0 {what}"),
            _ => format!("{count} {what} (the first in line {first})"),
        };
        let [value, features] = self.without;
        let value = left_out(value, "without a value");
        let features = left_out(features, "without a feature");
        let (name, rows) = (&self.name, self.decisions.len());
        format!("{name}: {rows} rows used; {value} and {features} left out")
    }

    /// The draw with some of its rows.
    pub fn of_rows(&self, is_taken: impl Fn(usize) -> bool) -> FittedDraw {
        let rows: Vec<usize> = (0..self.decisions.len()).filter(|row| is_taken(*row)).collect();
        let mut people = Vec::new();
        let mut start = 0;
        for own in &self.people {
            let count = rows[start..].iter().take_while(|row| **row < own.end).count();
            people.push(start..start + count);
            start += count;
        }
        let predictor = |one: &DrawPredictor| {
            let width = one.coefficients.len();
            let design = rows.iter().flat_map(|row| &one.design[row * width..(row + 1) * width]);
            DrawPredictor {
                offset: rows.iter().map(|row| one.offset[*row]).collect(),
                design: design.copied().collect(),
                ..one.clone()
            }
        };
        FittedDraw {
            predictors: self.predictors.iter().map(predictor).collect(),
            decisions: rows.iter().map(|row| self.decisions[*row]).collect(),
            outcome: rows.iter().map(|row| self.outcome[*row]).collect(),
            people,
            ..self.clone()
        }
    }
}

/// A draw of a table whose values the data have.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawCounts {
    /// The variable.
    pub name: String,
    /// Each combination of what is given and of the value, in ascending order, with its number of decisions.
    pub counts: Vec<(Vec<f64>, usize)>,
}

/// A column of people whose number the data do not determine.
#[derive(Clone, Debug, PartialEq)]
pub struct ImputedColumn {
    /// The column.
    pub name: String,
    /// The draw and the parameter that it is in, by their indices.
    pub of: (usize, usize),
    /// Its sign, or 0 where another column has the whole effect.
    pub sign: f64,
}

/// Recorded decisions in the terms of a model.
#[derive(Debug)]
pub struct Pilot {
    pub(super) model: Arc<ModelFile>,
    pub(super) clamped: Clamped,
    /// The people in the order of the file.
    pub people: Vec<PilotPerson>,
    /// What is estimated.
    pub coefficients: Vec<FitCoefficient>,
    /// The draws that are fitted.
    pub draws: Vec<FittedDraw>,
    /// The draws that are counted.
    pub counts: Vec<DrawCounts>,
    /// Where effects come from.
    pub effect: EffectSource,
    /// What is imputed.
    pub imputed: Vec<ImputedColumn>,
    /// Whether everybody has the same coefficients.
    pub pooled: bool,
    /// Variables of which 0 and 1 must each have more than this share of a person's rows, with their values by decision.
    pub rare: Vec<(f64, Vec<f64>)>,
    /// The needed columns of people, and for those that the data give, their numbers by person.
    pub columns: Vec<(String, Option<Vec<f64>>)>,
    /// The names and means and standard deviations of standardised variables.
    pub scales: Vec<(String, f64, f64)>,
    /// The action of each decision, the probability of a message, and whether one could be sent; NaN where unknown.
    pub actions: [Vec<f64>; 3],
    /// Whether a decision is a row of the file that `where` admits.
    pub used: Vec<bool>,
    /// Lines about what was read.
    pub notes: Vec<String>,
}

impl Pilot {
    /// The title of the model, and the unit of its outcome.
    pub fn title(&self) -> (&str, &str) {
        let model = &self.model;
        (&model.title, model.unit.as_deref().unwrap_or("outcome"))
    }

    /// The number of decisions of a day.
    pub fn decisions_per_day(&self) -> usize {
        self.model.decisions_per_day as usize
    }

    /// The columns of the model's rows, each with its numbers by decision.
    pub fn replayed(&self) -> Vec<(&str, Vec<f64>)> {
        self.clamped.replayed()
    }

    /// The number of actions, and the names of the features that agents may observe.
    pub fn actions_and_features(&self) -> (usize, Vec<&str>) {
        let model = &self.model;
        let names = model.roles.features.iter().map(|feature| feature.name.as_str());
        (model.actions.len(), names.collect())
    }

    /// By decision: the features that agents may observe, then the reward and the outcome; NaN where the data do not
    /// determine them.
    pub fn observed(&self) -> Vec<Vec<f64>> {
        self.clamped.observed()
    }
}
