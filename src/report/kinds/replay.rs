//! Replays of a recorded trial: by how much the probabilities of agents differ from the recorded ones.

use super::{Drawn, Sheet};
use crate::analyse::declared::{ArmId, ReplayFigure, ReplayRow, SAME};
use crate::job::{Measure, counted, distinct};
use crate::record::ReplayedDecision;
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, Line, NumberFormat, PlottedPoint, Spread, axes_of, draw, facets,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::arm;

/// The decimals in which two probabilities differ.
fn digits(of: &ReplayedDecision) -> usize {
    let differ = |digits: &usize| shown(of.replayed, *digits) != shown(of.recorded, *digits);
    (4..16).find(differ).unwrap_or(16)
}

impl Drawn for ReplayFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let name = |row: &ReplayRow| sheet.names.arm(&row.name);
        let line = |row: &ReplayRow| Line {
            label: sheet.names.label(&row.name),
            look: sheet.looks.look(&name(row)),
            points: points(row),
            reference: Vec::new(),
            spread: Spread::Exact,
            facets: facets(&name(row)),
        };
        let lines: Vec<Line> = self.rows.iter().map(line).collect();
        if lines.iter().all(|line| line.points.is_empty()) {
            return Vec::new();
        }
        let note =
            "Largest difference of a day between the probabilities of the actions that were taken.";
        let description = "replayed less recorded probabilities by day".to_owned();
        let charts = [Chart { heading: None, description, lines, note: note.to_owned() }];
        let scale = sheet.style.x_scale(AxisScale::Linear);
        let x = ("day of the trial".to_owned(), NumberFormat::Plain, scale);
        let y = ("largest difference".to_owned(), NumberFormat::Plain);
        sheet.numbered(draw(&charts, &axes_of(&charts, x, y, sheet.style), sheet.style))
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let columns = [
            ("arm", "Arm"),
            ("seed", "Seed"),
            ("decisions", "Decisions"),
            ("differing", "Differ"),
            ("first_day", "First: day"),
            ("first_person", "Person"),
            ("first_step", "Decision"),
            ("first_recorded", "Recorded"),
            ("first_replayed", "Replayed"),
            ("largest", "Largest difference"),
            ("largest_day", "Day"),
            ("largest_person", "Person"),
            ("largest_step", "Decision"),
        ];
        let mut table = DataTable::new(title, &columns);
        table.rows = self.rows.iter().map(|row| cells(row, names)).collect();
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let decisions = self.rows.iter().map(|row| row.replayed.decisions).max().unwrap_or(0);
        format!(
            "Probabilities that agents would have had at {} of the recorded trial, less the recorded ones; differences up to {SAME:e} are rounding",
            counted(decisions, "decision")
        )
    }

    fn finds(&self, _: Measure, names: &Names) -> Option<String> {
        let said = self.rows.iter().map(|row| {
            let name = names.label(&row.name);
            match row.replayed.first {
                None => format!("{name} repeats the record"),
                Some(first) => format!(
                    "{name} first differs on day {} at decision {} of person {} ({} instead of {})",
                    first.day,
                    first.step,
                    first.person,
                    shown(first.replayed, digits(&first)),
                    shown(first.recorded, digits(&first))
                ),
            }
        });
        let said: Vec<String> = said.collect();
        (!said.is_empty()).then(|| said.join("; "))
    }

    fn lacks(&self) -> Option<String> {
        self.rows.is_empty().then(|| "no completed job replays a recorded trial".to_owned())
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.rows.iter().map(|row| &row.name))
    }

    fn is_table(&self) -> bool {
        true
    }
}

fn points(row: &ReplayRow) -> Vec<PlottedPoint> {
    let point = |(day, _, most): &(u32, f64, f64)| PlottedPoint {
        x: f64::from(*day),
        y: *most,
        interval: None,
        is_single: false,
        tip: format!("day {day}: {}", shown(*most, 4)),
    };
    row.replayed.days.iter().map(point).collect()
}

fn cells(row: &ReplayRow, names: &Names) -> Vec<TableEntry> {
    let replayed = &row.replayed;
    let of = |one: Option<ReplayedDecision>, number: fn(ReplayedDecision) -> f64, decimals| {
        TableEntry::of(one.map(number).ok_or("none differs"), decimals)
    };
    let (first, largest) = (replayed.first, replayed.largest);
    vec![
        arm(&row.name, names),
        TableEntry::number(row.seed as f64, 0),
        TableEntry::number(replayed.decisions as f64, 0),
        TableEntry::number(replayed.differing as f64, 0),
        of(first, |one| f64::from(one.day), 0),
        of(first, |one| f64::from(one.person), 0),
        of(first, |one| f64::from(one.step), 0),
        of(first, |one| one.recorded, 4),
        of(first, |one| one.replayed, 4),
        match largest {
            Some(one) => {
                let value = one.difference();
                TableEntry::Number { value, shown: format!("{value:.1e}") }
            }
            None => TableEntry::Missing("none differs".to_owned()),
        },
        of(largest, |one| f64::from(one.day), 0),
        of(largest, |one| f64::from(one.person), 0),
        of(largest, |one| f64::from(one.step), 0),
    ]
}
