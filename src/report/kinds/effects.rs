//! Estimates of single jobs with their intervals, beside published ones.

use super::{Drawn, Sheet, parameter, related};
use crate::analyse::declared::{ArmId, EffectRow, EffectsFigure};
use crate::job::{Measure, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, INK, Line, Look, Marker, NumberFormat, PUBLISHED, PlottedPoint, Spread,
    axes_of, draw,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, range};

/// Decimals of estimates.
const DECIMALS: usize = 4;
/// The column of the mean outcome of a recorded trial, before the published numbers.
const OF_TRIAL: usize = 9;

impl Drawn for EffectsFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        if self.rows.iter().all(|row| row.effect.is_err()) {
            return Vec::new();
        }
        let line = |label: String, (color, marker), spread, points| Line {
            label,
            look: Look { color, dash: None, marker },
            points,
            reference: Vec::new(),
            spread,
            facets: Vec::new(),
        };
        let at = |(index, row): (usize, &EffectRow), of: fn(&EffectRow) -> Option<PlottedPoint>| {
            of(row).map(|point| PlottedPoint { x: index as f64 + 1.0, ..point })
        };
        let rows = || self.rows.iter().enumerate();
        // A line would lead from one term to another.
        let own = |(index, row): (usize, &EffectRow)| {
            let label = format!("{}: {}", row.estimate, row.term);
            let points = at((index, row), estimated).into_iter().collect();
            line(label, (INK, Marker::Disc), Spread::Bars, points)
        };
        let mut lines: Vec<Line> = rows().map(own).collect();
        let others: Vec<PlottedPoint> = rows().filter_map(|one| at(one, published)).collect();
        let look = (PUBLISHED, Marker::Diamond);
        lines.push(line("published".to_owned(), look, Spread::Points, others));
        lines.retain(|line| !line.points.is_empty());
        let note = "Bars: 95 % intervals.".to_owned();
        let description = "estimates with their intervals".to_owned();
        let charts = [Chart { heading: None, description, lines, note }];
        let scale = sheet.style.x_scale(AxisScale::Linear);
        let x = ("terms, in the order of the table".to_owned(), NumberFormat::Plain, scale);
        let y = ("effect".to_owned(), NumberFormat::Plain);
        sheet.numbered(draw(&charts, &axes_of(&charts, x, y, sheet.style), sheet.style))
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let mut columns = vec![
            ("arm", "Arm"),
            ("seed", "Seed"),
            ("estimate", "Estimate"),
            ("term", "Term"),
            ("value", "Effect"),
            ("standard_error", "SE"),
            ("interval", "95 % interval"),
            ("p", "p"),
            ("decisions", "Decisions"),
            ("published", "Published"),
            ("published_standard_error", "Published SE"),
            ("published_p", "Published p"),
        ];
        let mut rows: Vec<Vec<TableEntry>> =
            self.rows.iter().map(|row| cells(row, names)).collect();
        if self.rows.iter().any(|row| row.of_trial.is_some()) {
            columns.insert(OF_TRIAL, ("trial_mean", "Mean of the trial"));
            rows.iter_mut().zip(&self.rows).for_each(|(cells, row)| {
                let none = "not the value of a policy".to_owned();
                cells.insert(OF_TRIAL, TableEntry::of(row.of_trial.ok_or(none), DECIMALS));
            });
        }
        let mut table = DataTable::new(title, &columns);
        table.rows = rows;
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let names = distinct(self.rows.iter().map(|row| row.estimate.as_str()));
        let beside = match self.rows.iter().any(|row| row.published.is_some()) {
            true => ", beside the published numbers",
            false => "",
        };
        format!("Estimates of {} with 95 % intervals{beside}", names.join(", "))
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        let published = |row: &&EffectRow| row.published.is_some() && row.effect.is_ok();
        let compared: Vec<&EffectRow> = self.rows.iter().filter(published).collect();
        if !compared.is_empty() {
            let same = compared.iter().filter(|row| row.is_published()).count();
            return Some(format!(
                "{same} of {} are the published ones to their last digit",
                counted(compared.len(), "number")
            ));
        }
        let row = self.rows.iter().find(|row| row.effect.is_ok())?;
        let effect = row.effect.as_ref().ok()?;
        Some(format!(
            "{}, {}: {} ({} to {}), p {}",
            row.estimate,
            row.term,
            shown(effect.value, DECIMALS),
            shown(effect.low, DECIMALS),
            shown(effect.high, DECIMALS),
            related(effect.p_value)
        ))
    }

    fn lacks(&self) -> Option<String> {
        (self.lacking > 0)
            .then(|| format!("the estimates of {}", counted(self.lacking, "completed job")))
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.rows.iter().map(|row| &row.name))
    }

    fn is_table(&self) -> bool {
        true
    }
}

impl EffectRow {
    /// Whether the estimate rounds to the published number.
    fn is_published(&self) -> bool {
        match (&self.effect, &self.published) {
            (Ok(effect), Some(published)) => {
                (effect.value - published.value).abs() <= published.rounding * (1.0 + 1e-9)
            }
            _ => false,
        }
    }
}

fn estimated(row: &EffectRow) -> Option<PlottedPoint> {
    let effect = row.effect.as_ref().ok()?;
    let tip = format!("{}, {}: {}", row.estimate, row.term, shown(effect.value, DECIMALS));
    let interval = Some((effect.low, effect.high));
    Some(PlottedPoint { y: effect.value, interval, tip, ..PlottedPoint::default() })
}

fn published(row: &EffectRow) -> Option<PlottedPoint> {
    let published = row.published.as_ref()?;
    let tip = format!("{}, {}: {} published", row.estimate, row.term, published.value);
    Some(PlottedPoint { y: published.value, tip, ..PlottedPoint::default() })
}

fn cells(row: &EffectRow, names: &Names) -> Vec<TableEntry> {
    let effect = row.effect.as_ref();
    let of = |number: fn(&crate::job::Effect) -> f64| {
        TableEntry::of(effect.map(number).map_err(Clone::clone), DECIMALS)
    };
    let published = |number: Option<f64>| {
        TableEntry::published(
            number.map(|number| TableEntry::Number { value: number, shown: parameter(number) }),
        )
    };
    let of_publication = row.published.as_ref();
    vec![
        arm(&row.name, names),
        TableEntry::number(row.seed as f64, 0),
        TableEntry::text(&row.estimate),
        TableEntry::text(&row.term),
        of(|effect| effect.value),
        of(|effect| effect.standard_error),
        match effect {
            Ok(effect) => TableEntry::text(range(effect.low, effect.high, DECIMALS)),
            Err(why) => TableEntry::Missing(why.clone()),
        },
        TableEntry::p(effect.map(|effect| effect.p_value).map_err(Clone::clone)),
        TableEntry::of(effect.map(|effect| effect.decisions as f64).map_err(Clone::clone), 0),
        published(of_publication.map(|one| one.value)),
        published(of_publication.and_then(|one| one.standard_error)),
        published(of_publication.and_then(|one| one.p)),
    ]
}
