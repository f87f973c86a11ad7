//! Whether the actions of a recorded trial were drawn as recorded: shares beside probabilities, by group.

use super::{Drawn, Sheet, related};
use crate::analyse::declared::{ArmId, DrawnPoint, RandomisationFigure, RandomisationTest};
use crate::job::{Measure, counted};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, FAINT, INK, Line, Look, Marker, NumberFormat, PlottedPoint, Spread, axes_of,
    draw,
};
use crate::report::names::Names;
use crate::report::scene::Scene;

/// The quantile of the normal distribution of a 95 % interval.
const WIDE: f64 = 1.96;
/// Below this corrected probability, a test contradicts the recorded probabilities.
const SMALL: f64 = 0.01;

impl Drawn for RandomisationFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        // Of single messages, those that contradict their probabilities.
        let is_shown =
            |test: &&RandomisationTest| test.is_of_all || test.corrected.is_some_and(|p| p < SMALL);
        let tests = self.tests.iter().filter(|test| test.points.len() > 1).filter(is_shown);
        let charts: Vec<Chart> = tests.map(chart).collect();
        if charts.is_empty() {
            return Vec::new();
        }
        let scale = sheet.style.x_scale(AxisScale::Linear);
        let x = ("groups in their order, %".to_owned(), NumberFormat::Plain, scale);
        let y = ("share less probability".to_owned(), NumberFormat::Plain);
        sheet.numbered(draw(&charts, &axes_of(&charts, x, y, sheet.style), sheet.style))
    }

    fn table(&self, title: &str, _: Measure, _: &Names) -> DataTable {
        let columns = [
            ("by", "Decisions by"),
            ("count", "Count"),
            ("groups", "Groups"),
            ("decisions", "Decisions"),
            ("share", "Share with an action"),
            ("expected", "Mean probability"),
            ("chi_squared", "χ²"),
            ("degrees_of_freedom", "df"),
            ("p", "p"),
            ("p_holm", "Corrected p"),
            ("furthest", "Furthest group"),
            ("standardised", "Its standardised difference"),
        ];
        let mut table = DataTable::new(title, &columns);
        table.rows = self.tests.iter().map(cells).collect();
        let counts = self.counts.iter().map(|(what, count)| {
            let mut row = vec![TableEntry::text(what)];
            row.push(TableEntry::number(*count as f64, 0));
            row.resize_with(columns.len(), || TableEntry::text(""));
            row
        });
        table.rows.extend(counts);
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let all = self.tests.first();
        let decisions = all.map_or(0, |test| test.decisions);
        let anonymous = match self.is_anonymous {
            true => "; people are numbered, and their names are left in the file",
            false => "; the store keeps the names of people",
        };
        let notes: String = self.notes.iter().map(|note| format!("; {note}")).collect();
        format!(
            "Shares of actions less their recorded probabilities at {}, with 95 % of what draws with these \
             probabilities give{notes}{anonymous}",
            counted(decisions, "decision")
        )
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        let all = self.tests.first()?;
        let overall = format!(
            "An action was taken at {} % of decisions, and {} % were expected",
            shown(100.0 * all.share, 1),
            shown(100.0 * all.expected, 1)
        );
        let count = counted(self.tests.iter().filter(|test| test.p.is_some()).count(), "test");
        let tested = self.tests.iter().filter_map(|test| Some((test, test.corrected?)));
        let least = tested.min_by(|one, other| one.1.total_cmp(&other.1));
        Some(match least {
            None => {
                format!("{overall}; every action was certain, so that no effect can be estimated")
            }
            Some((test, p)) if p < SMALL => {
                let unless = match test.is_of_state {
                    true => format!(", unless `{}` is known only after the action", test.by),
                    false => String::new(),
                };
                format!(
                    "{overall}; grouped by {}, the actions contradict the recorded probabilities (p {}, corrected for {count}): \
                     estimates that rest on them cannot be trusted{unless}",
                    test.by,
                    related(p)
                )
            }
            Some((test, p)) => format!(
                "{overall}; nothing contradicts the recorded probabilities, the smallest p, corrected for {count}, being {} by {}",
                shown(p, 3),
                test.by
            ),
        })
    }

    fn lacks(&self) -> Option<String> {
        self.tests.is_empty().then(|| "no completed job has the decisions of a trial".to_owned())
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.name.iter().collect()
    }

    fn is_table(&self) -> bool {
        true
    }
}

fn chart(test: &RandomisationTest) -> Chart {
    let place = |index: usize| 100.0 * (index as f64 + 0.5) / test.points.len() as f64;
    let point = |(index, group): (usize, &DrawnPoint)| PlottedPoint {
        x: place(index),
        y: group.difference,
        interval: None,
        is_single: false,
        tip: format!(
            "{} {}: {} over {}",
            test.by,
            group.name,
            shown(group.difference, 3),
            counted(group.decisions, "decision")
        ),
    };
    let band = |(index, group): (usize, &DrawnPoint)| PlottedPoint {
        x: place(index),
        y: 0.0,
        interval: Some((-WIDE * group.deviation, WIDE * group.deviation)),
        is_single: false,
        tip: String::new(),
    };
    let line = |label: &str, color, spread, points| Line {
        label: label.to_owned(),
        look: Look { color, dash: None, marker: Marker::Disc },
        points,
        reference: Vec::new(),
        spread,
        facets: Vec::new(),
    };
    let points = || test.points.iter().enumerate();
    let heading = match test.corrected {
        Some(p) => format!("by {}, corrected p {}", test.by, related(p)),
        None => format!("by {}", test.by),
    };
    Chart {
        heading: Some(heading),
        description: format!("shares of actions less their probabilities by {}", test.by),
        lines: vec![
            line("as recorded", FAINT, Spread::Band, points().map(band).collect()),
            line("observed", INK, Spread::Points, points().map(point).collect()),
        ],
        note: "Band: 95 % of what draws with the recorded probabilities give.".to_owned(),
    }
}

fn cells(test: &RandomisationTest) -> Vec<TableEntry> {
    let certain = || "every action was certain".to_owned();
    let furthest = test.furthest.as_ref();
    vec![
        TableEntry::text(&test.by),
        TableEntry::text(""),
        TableEntry::number(test.groups as f64, 0),
        TableEntry::number(test.decisions as f64, 0),
        TableEntry::number(test.share, 4),
        TableEntry::number(test.expected, 4),
        TableEntry::number(test.chi_squared, 2),
        TableEntry::number(test.degrees_of_freedom, 1),
        TableEntry::p(test.p.ok_or_else(certain)),
        TableEntry::p(test.corrected.ok_or_else(certain)),
        TableEntry::text(furthest.map_or("", |(name, _)| name)),
        TableEntry::of(furthest.map(|(_, z)| *z).ok_or_else(certain), 2),
    ]
}
