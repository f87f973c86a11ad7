//! The order of a person's rows: which decision of the person each row is.

use std::collections::HashMap;
use std::ops::Range;

use crate::env::declared::pilot::file::{ColumnFormula, DataFaults, RecordedRows};
use crate::env::declared::pilot::terms::PilotPerson;
use crate::text::shortened;

/// Stands for a decision that the file skips.
pub(in crate::env) const SKIPPED: u32 = u32::MAX;
/// A person may have this many decisions per row, and this many more.
const MOST_PER_ROW: f64 = 20.0;
const MOST_MORE: f64 = 1000.0;
/// All people may have this many decisions per row, and this many more.
const MOST_OF_ALL: [usize; 2] = [10, 10_000_000];
/// The largest number of a day or of a decision.
const LARGEST: f64 = 1e9;

/// The number of everybody's first decision: 0 or 1, if the file counts from it and more than half of the people have it.
/// Otherwise the first row of each person is the first decision. The rows of each person are sorted.
fn shared_first(own: &[Vec<(f64, u32)>]) -> Option<f64> {
    let firsts = || own.iter().filter_map(|rows| Some(rows.first()?.0));
    let least = firsts().min_by(f64::total_cmp).filter(|least| [0.0, 1.0].contains(least))?;
    (2 * firsts().filter(|first| *first == least).count() > own.len()).then_some(least)
}

/// The decisions of a file, person by person.
#[derive(Debug, Default)]
pub(in crate::env) struct Calendar {
    pub people: Vec<PilotPerson>,
    /// \[decisions\]: the row, or [`SKIPPED`].
    pub rows: Vec<u32>,
}

impl Calendar {
    /// The decisions by the formulas of their order: none, one that counts decisions, or the day and the decision of the
    /// day. Decisions that are skipped between others are missing decisions.
    ///
    /// **Errors**: an order is missing or no whole number, or two rows are one decision.
    pub fn new(
        table: &RecordedRows,
        order: &[ColumnFormula],
        per_day: u32,
    ) -> Result<Calendar, DataFaults> {
        let mut faults = DataFaults::default();
        let mut own: Vec<Vec<(f64, u32)>> = vec![Vec::new(); table.people.len()];
        for (row, person) in table.person.iter().enumerate() {
            let rows = &mut own[*person as usize];
            let line = table.lines[row];
            let written: Vec<f64> =
                order.iter().map(|formula| formula.value(table, row, 0)).collect();
            let is_count = |number: f64| number.fract() == 0.0 && number.abs() <= LARGEST;
            let broken = written.iter().find(|number| !is_count(**number));
            if let Some(number) = broken {
                let is = match number {
                    number if number.is_nan() => "missing".to_owned(),
                    number if number.abs() > LARGEST => format!("{number:e}"),
                    number => number.to_string(),
                };
                faults.add(format!(
                    "line {line}: the order of the decision is {is}, expected a whole number up to {LARGEST:e} in size that counts days or decisions"
                ));
                continue;
            }
            let mut numbers = written.into_iter();
            let number = match (numbers.next(), numbers.next()) {
                (None, _) => rows.len() as f64,
                (Some(number), None) => number,
                (Some(day), Some(slot)) => {
                    if !(0.0..f64::from(per_day)).contains(&slot) {
                        let most = per_day - 1;
                        faults.add(format!("line {line}: the decision of the day is {slot}, expected 0 to {most}, because `decisions_per_day` is {per_day}; where the file counts from 1, write the number less 1, as in \"slot - 1\""));
                    }
                    day * f64::from(per_day) + slot
                }
            };
            rows.push((number, row as u32));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        own.iter_mut().for_each(|rows| rows.sort_by(|one, other| one.0.total_cmp(&other.0)));
        let shared = if order.len() == 1 { shared_first(&own) } else { None };
        let mut calendar = Calendar::default();
        for (person, rows) in own.iter().enumerate() {
            let Some((first, _)) = rows.first() else { continue };
            let first = match order.len() {
                // A person begins with the first decision of the day.
                2 => (first / f64::from(per_day)).floor() * f64::from(per_day),
                // A person with more decisions before the first row than rows has entered late.
                _ => shared.filter(|shared| first - shared <= rows.len() as f64).unwrap_or(*first),
            };
            calendar.add(table, person, rows, first, &mut faults);
            let [per_row, more] = MOST_OF_ALL;
            if calendar.rows.len() > table.lines.len() * per_row + more {
                faults.add(format!("{} rows, and with the decisions that the file skips more than {}: `order` must count decisions, or days and the decisions of a day", table.lines.len(), calendar.rows.len()));
                break;
            }
        }
        if faults.is_empty() { Ok(calendar) } else { Err(faults) }
    }

    fn add(
        &mut self,
        table: &RecordedRows,
        person: usize,
        rows: &[(f64, u32)],
        first: f64,
        faults: &mut DataFaults,
    ) {
        let name = table.people[person].clone();
        let shown = shortened(&name);
        for pair in rows.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
            let [one, other] = [pair[0].1, pair[1].1].map(|row| table.lines[row as usize]);
            faults.add(format!("line {other}: the same decision of person {shown} as line {one}"));
        }
        let Some((last, _)) = rows.last() else { return };
        let count = last - first + 1.0;
        if count > rows.len() as f64 * MOST_PER_ROW + MOST_MORE {
            faults.add(format!("person {shown}: {} rows from decision {first} to {last}: `order` must count decisions, or days and the decisions of a day", rows.len()));
            return;
        }
        let start = self.rows.len();
        self.rows.resize(start + count as usize, SKIPPED);
        for (number, row) in rows {
            self.rows[start + (number - first) as usize] = *row;
        }
        self.people.push(PilotPerson { name, decisions: start..self.rows.len() });
    }

    /// The rows that are not skipped, each with its decision and the number of the decision of its person.
    pub fn recorded(&self) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        self.people.iter().flat_map(move |person| {
            let start = person.decisions.start;
            let own = person.decisions.clone().filter(|decision| self.rows[*decision] != SKIPPED);
            own.map(move |decision| (decision, self.rows[decision] as usize, decision - start))
        })
    }

    /// The number of decisions that are skipped, and of the people who have some.
    pub fn skipped(&self) -> (usize, usize) {
        let skipped = |person: &PilotPerson| {
            let own: Range<usize> = person.decisions.clone();
            self.rows[own].iter().filter(|row| **row == SKIPPED).count()
        };
        let counts: HashMap<usize, usize> =
            self.people.iter().map(skipped).enumerate().filter(|(_, count)| *count > 0).collect();
        (counts.values().sum(), counts.len())
    }
}
