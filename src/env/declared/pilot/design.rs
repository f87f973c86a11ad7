//! The model's program on recorded decisions: what the data give is taken from them, all else is computed.

use std::ops::Range;
use std::sync::Arc;
use std::thread;

use crate::env::declared::columns::{Inputs, LaneColumns};
use crate::env::declared::model::{Definition, ModelFile, Moment, Referent};
use crate::env::declared::program::compile;
use crate::env::declared::rows::Numbers;

/// People that are computed at a time.
const TOGETHER: usize = 128;

/// A model whose quantities the data give.
#[derive(Clone, Debug)]
pub(super) struct Clamped {
    /// The model; what the data give are columns of rows.
    pub model: ModelFile,
    /// The given quantities, in the order of the columns.
    pub given: Vec<usize>,
    /// \[decisions, given\].
    pub numbers: Numbers,
    /// \[people\]: their decisions.
    pub people: Vec<Range<usize>>,
    /// By column of people, for those that are known, \[people\].
    pub columns: Vec<Option<Vec<f64>>>,
    /// The values of parameters.
    pub parameters: Vec<f64>,
    /// The columns of the model's rows, by their quantity.
    pub replayed: Vec<usize>,
}

/// Values of coefficients that a pass sets; all others are 0.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Unit {
    pub column: Option<usize>,
    pub parameter: Option<usize>,
}

impl Clamped {
    /// Makes the given quantities columns of rows, and all that is wanted recorded.
    pub fn clamp(model: &mut ModelFile, given: &[usize], wanted: &[usize]) {
        for (index, quantity) in given.iter().enumerate() {
            model.quantities[*quantity].definition = Definition::Replay(index);
        }
        model.roles.available = None;
        model.roles.ends = None;
        model.roles.state = wanted.to_vec();
    }

    /// The numbers of quantities at every decision, \[wanted, decisions\], with one coefficient 1 and the others 0.
    pub fn run(
        &self,
        unit: Unit,
        unknown_parameters: &[usize],
        wanted: &[Referent],
    ) -> Vec<Vec<f64>> {
        let mut parameters = self.parameters.clone();
        for index in unknown_parameters {
            parameters[*index] = if unit.parameter == Some(*index) { 1.0 } else { 0.0 };
        }
        let program = Arc::new(compile(&self.model, &parameters));
        let decisions = self.numbers.rows();
        let mut out = vec![vec![f64::NAN; decisions]; wanted.len()];
        let mut order: Vec<usize> = (0..self.people.len()).collect();
        order.sort_by_key(|person| std::cmp::Reverse(self.people[*person].len()));
        let replayed: Vec<usize> = (0..self.given.len()).collect();
        for lanes in order.chunks(TOGETHER) {
            let count = lanes.len();
            let mut columns = LaneColumns::new(Arc::clone(&program), count);
            for (column, to) in program.people.iter().enumerate() {
                for (lane, person) in lanes.iter().enumerate() {
                    columns.all[*to][lane] = match &self.columns[column] {
                        Some(known) => known[*person],
                        None => f64::from(u8::from(unit.column == Some(column))),
                    };
                }
            }
            let longest = self.people[lanes[0]].len();
            let (no, yes) = (vec![false; count], vec![true; count]);
            let (words, entered) = (vec![0; count], vec![0.0; count]);
            let mut rows = vec![u32::MAX; count];
            let mut times = vec![0; count];
            for time in 0..longest {
                times.fill(time as u32);
                for (row, person) in rows.iter_mut().zip(lanes) {
                    let own = &self.people[*person];
                    *row = if time < own.len() { (own.start + time) as u32 } else { u32::MAX };
                }
                columns.set_clocks(0..count, &times, &entered, self.model.decisions_per_day);
                let inputs = Inputs {
                    span: 0..count,
                    clock: time as u64,
                    times: &times,
                    words: &words,
                    drawn: &no,
                    checked: &no,
                    replay: Some((&self.numbers, &rows)),
                    replayed: &replayed,
                };
                if time == 0 {
                    columns.compute(Moment::Person, &inputs);
                }
                columns.compute(Moment::Before, &inputs);
                columns.compute(Moment::After, &inputs);
                for (out, referent) in out.iter_mut().zip(wanted) {
                    for (lane, row) in rows.iter().enumerate().filter(|(_, row)| **row != u32::MAX)
                    {
                        out[*row as usize] = match referent {
                            Referent::Quantity(index) => columns.all[program.values[*index]][lane],
                            Referent::Column(index) => columns.all[program.people[*index]][lane],
                            Referent::ModelParameter(index) => parameters[*index],
                            Referent::Clock(clock) => program
                                .clocks
                                .iter()
                                .find(|(known, _)| known == clock)
                                .map_or(f64::NAN, |(_, column)| columns.all[*column][lane]),
                            Referent::One => 1.0,
                        };
                    }
                }
                columns.remember(0..count, time as u64, &yes);
            }
        }
        out
    }

    /// The same for several units side by side, \[units, wanted, decisions\].
    pub fn run_all(
        &self,
        units: &[Unit],
        unknown_parameters: &[usize],
        wanted: &[Referent],
    ) -> Vec<Vec<Vec<f64>>> {
        let workers =
            thread::available_parallelism().map_or(1, usize::from).min(units.len().max(1));
        let mut all: Vec<Option<Vec<Vec<f64>>>> = vec![None; units.len()];
        let size = units.len().div_ceil(workers).max(1);
        thread::scope(|scope| {
            for (units, out) in units.chunks(size).zip(all.chunks_mut(size)) {
                scope.spawn(move || {
                    for (unit, out) in units.iter().zip(out) {
                        *out = Some(self.run(*unit, unknown_parameters, wanted));
                    }
                });
            }
        });
        all.into_iter().flatten().collect()
    }

    /// The same decisions with this action at all of them.
    pub fn with_action(&self, action: f64) -> Clamped {
        let width = self.given.len();
        let mut numbers = Vec::with_capacity(self.numbers.rows() * width);
        for row in 0..self.numbers.rows() {
            let own = (0..width).map(|column| match self.given[column] {
                0 => action,
                _ => self.numbers.number(row, column),
            });
            numbers.extend(own);
        }
        Clamped { numbers: Numbers::of(width, numbers), ..self.clone() }
    }

    /// The numbers of a given quantity by decision.
    pub fn given(&self, quantity: usize) -> Option<Vec<f64>> {
        let column = self.given.iter().position(|given| *given == quantity)?;
        Some((0..self.numbers.rows()).map(|row| self.numbers.number(row, column)).collect())
    }

    /// The columns of the model's rows, each with its numbers by decision.
    pub fn replayed(&self) -> Vec<(&str, Vec<f64>)> {
        let column = |index: &usize| {
            (self.model.quantities[*index].name.as_str(), self.given(*index).unwrap_or_default())
        };
        self.replayed.iter().map(column).collect()
    }

    /// The features that agents may observe, then the reward and the outcome, by decision.
    pub fn observed(&self) -> Vec<Vec<f64>> {
        let roles = &self.model.roles;
        let mut wanted: Vec<Referent> = roles.features.iter().map(|one| one.source).collect();
        wanted.extend([roles.reward, roles.outcome].map(Referent::Quantity));
        self.run(Unit::default(), &[], &wanted)
    }
}
