//! Contrasts: differences with their intervals, a line a comparison.

use super::{Drawn, amount};
use crate::analyse::declared::{ALPHA, ContrastRow};
use crate::analyse::{FEW_SEEDS, Tests};
use crate::report::data_table::{DataTable, Entry, shown};
use crate::report::figure::{
    Axis, AxisScale, FAINT, GRID, INK, Look, Looks, Marker, NOTE, PUBLISHED, TEXT, WIDTH,
    arm_label, fitting, marker, round_range, seeds, text,
};
use crate::report::scene::{Anchor, Mark, Scene, Shape, Stroke, Weight, width};
use crate::report::tables::{between, high, in_unit, low};
use crate::report::words::{metric_title, unit_numbers};

impl Drawn for Vec<ContrastRow> {
    fn figures(&self, stem: &str, metric: &str, _: &Looks) -> Vec<(String, Scene)> {
        // Axes without a difference on them would say nothing.
        let is_answered = self.iter().any(|row| row.contrast.difference.is_ok());
        is_answered.then(|| (stem.to_owned(), forest_figure(self, metric))).into_iter().collect()
    }

    fn table(&self, title: &str, metric: &str) -> DataTable {
        table(title, self, metric)
    }

    fn shows(&self, metric: &str) -> String {
        let sides = self.first().map_or_else(String::new, |row| {
            format!(" between {} and {}", row.sides.0, row.sides.1)
        });
        let counts = self.iter().map(|row| row.contrast.seeds.0.min(row.contrast.seeds.1));
        let seeds = seeds(counts.filter(|n| *n > 0));
        format!(
            "Differences in {}{sides} with their 95 % intervals, {seeds} a side",
            metric_title(metric)
        )
    }

    fn finds(&self, metric: &str) -> Option<String> {
        let answered: Vec<(&ContrastRow, f64)> =
            self.iter().filter_map(|row| Some((row, row.contrast.difference.ok()?))).collect();
        let size = |one: &&(&ContrastRow, f64)| one.1.abs();
        let (row, largest) = answered.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?;
        let above = answered.iter().filter(|(_, difference)| *difference > 0.0).count();
        let is_certain = |row: &ContrastRow| row.corrected.is_ok_and(|p| p.holm < ALPHA);
        let certain = answered.iter().filter(|(row, _)| is_certain(row)).count();
        let place = match arm_label(&row.name) {
            place if place.is_empty() => place,
            place => format!(", at {place}"),
        };
        Some(format!(
            "{} is above {} in {above} of {} comparisons, by {} at most{place}; {certain} differ by \
             more than chance ({} t, Holm-corrected p < {ALPHA})",
            row.sides.0,
            row.sides.1,
            answered.len(),
            amount(*largest, metric),
            if row.is_paired() { "paired" } else { "Welch’s" },
        ))
    }

    fn lacks(&self) -> Option<String> {
        let mut reasons: Vec<String> = Vec::new();
        let unanswered = self.iter().filter_map(|row| row.contrast.difference.err());
        let open = unanswered.clone().count();
        for reason in unanswered.map(|reason| reason.to_string()) {
            if !reasons.contains(&reason) {
                reasons.push(reason);
            }
        }
        (open > 0).then(|| format!("{open} of {} comparisons ({})", self.len(), reasons.join(", ")))
    }

    fn is_table(&self) -> bool {
        true
    }
}

const TOP: f64 = 24.0;
const ROW: f64 = 15.0;
const BOTTOM: f64 = 50.0;
/// Width of the axis, at least.
const LEAST_PLOT: f64 = 150.0;

/// The rows of a contrast.
fn forest_figure(rows: &[ContrastRow], metric: &str) -> Scene {
    let labels: Vec<String> = rows.iter().map(|row| arm_label(&row.name)).collect();
    let widest = labels.iter().map(|label| width(label, TEXT, Weight::Regular));
    let left = widest.fold(40.0, f64::max) + 12.0;
    let right = (WIDTH - 14.0).max(left + LEAST_PLOT);
    let whole = right + 14.0;
    let axis = axis(rows, metric);
    let height = TOP + ROW * rows.len() as f64 + BOTTOM;
    let bottom = TOP + ROW * rows.len() as f64;
    let across = |value: f64| left + axis.share(value).clamp(0.0, 1.0) * (right - left);
    let mut marks = ruler(&axis, (left, right), bottom);
    if let Some(row) = rows.first() {
        let heading = format!("{} − {}", row.sides.0, row.sides.1);
        let weight = (TEXT + 1.0, Weight::SemiBold);
        marks.push(text((left, 15.0), heading, weight, INK, Anchor::Start).into());
    }
    for (at, (row, label)) in rows.iter().zip(&labels).enumerate() {
        let middle = TOP + ROW * (at as f64 + 0.5);
        let place = (left - 6.0, middle + TEXT * 0.35);
        let plain = (TEXT, Weight::Regular);
        marks.push(text(place, label, plain, INK, Anchor::End).into());
        marks.extend(row_marks(row, label, middle, across));
    }
    let counts = rows.iter().map(|row| row.contrast.seeds.0.min(row.contrast.seeds.1));
    let is_compared = rows.iter().any(|row| row.published.is_some());
    let note = format!(
        "Difference and 95 % interval{}, {} a side.{}",
        if rows.iter().any(ContrastRow::is_paired) { ", paired by seed" } else { "" },
        seeds(counts.filter(|n| *n > 0)),
        if is_compared { " Diamonds: published." } else { "" }
    );
    let at = (whole / 2.0, height - 5.0);
    marks.push(fitting(at, note, (NOTE, whole - 8.0), FAINT).into());
    let description = format!("differences in {}", metric_title(metric));
    Scene { width: whole, height, description, marks }
}

fn axis(rows: &[ContrastRow], metric: &str) -> Axis {
    let mut numbers = vec![0.0];
    for row in rows {
        numbers.extend(row.contrast.difference.ok());
        numbers.extend(row.published.map(|(effect, _)| effect));
        let interval = row.contrast.test().map(|test| test.interval);
        numbers.extend(interval.iter().flat_map(|interval| [interval.low, interval.high]));
    }
    let low = numbers.iter().copied().fold(f64::INFINITY, f64::min);
    let high = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Axis {
        title: format!("difference in {}", metric_title(metric)),
        range: round_range(low, high.max(low + 1e-9)),
        scale: AxisScale::Linear,
        numbers: unit_numbers(metric).0,
    }
}

fn ruler(axis: &Axis, (left, right): (f64, f64), bottom: f64) -> Vec<Mark> {
    let mut marks = Vec::new();
    let ticks = axis.ticks(5);
    let step = ticks.get(1).map_or(1.0, |second| second - ticks[0]);
    for tick in &ticks {
        let x = left + axis.share(*tick) * (right - left);
        let stroke =
            if *tick == 0.0 { Stroke::solid(FAINT, 1.0) } else { Stroke::solid(GRID, 0.6) };
        marks.push(Shape::Line { points: vec![(x, TOP), (x, bottom)], stroke }.into());
        let at = (x, bottom + 4.0 + TEXT);
        let words = axis.written(*tick, step);
        marks.push(text(at, words, (TEXT, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    // Under the axis, as far as the figure's edges let it.
    let half = width(&axis.title, TEXT, Weight::Regular) / 2.0;
    let middle = ((left + right) / 2.0).min(right + 10.0 - half).max(half + 4.0);
    let at = (middle, bottom + 7.0 + 2.0 * TEXT);
    marks.push(fitting(at, &axis.title, (TEXT, right + 6.0), INK).into());
    marks
}

fn row_marks(
    row: &ContrastRow,
    label: &str,
    middle: f64,
    across: impl Fn(f64) -> f64,
) -> Vec<Mark> {
    let mut marks = Vec::new();
    let interval = row.contrast.test().ok().map(|test| test.interval);
    if let Some(interval) = interval {
        let points = vec![(across(interval.low), middle), (across(interval.high), middle)];
        marks.push(Shape::Line { points, stroke: Stroke::solid(INK, 1.5) }.into());
    }
    if let Ok(difference) = row.contrast.difference {
        // Rates are below 1, returns in the hundreds.
        let decimals = if difference.abs() >= 10.0 { 0 } else { 3 };
        let spread = interval.map_or_else(String::new, |interval| {
            format!(
                ", 95 % interval {} to {}",
                shown(interval.low, decimals),
                shown(interval.high, decimals)
            )
        });
        let tip = format!("{label}: {}{spread}", shown(difference, decimals));
        let look = Look { color: INK, dash: None, marker: Marker::Disc };
        marks.push(Mark::from(marker((across(difference), middle), &look, 3.0)).saying(tip));
    }
    // Above ours, whose rim shows around it where both are the same.
    if let Some((effect, p)) = row.published {
        let look = Look { color: PUBLISHED, dash: None, marker: Marker::Diamond };
        let tip = format!("{label}: published {} (p = {p})", shown(effect, 0));
        marks.push(Mark::from(marker((across(effect), middle), &look, 3.2)).saying(tip));
    }
    marks
}

fn table(title: &str, rows: &[ContrastRow], metric: &str) -> DataTable {
    let (first, second) = rows
        .first()
        .map_or(("first", "second"), |row| (row.sides.0.as_str(), row.sides.1.as_str()));
    let is_paired = rows.iter().any(ContrastRow::is_paired);
    // Readers see what some rows have; files have every column.
    let column = |is_shown: bool, names: [&'static str; 2]| names[usize::from(is_shown)];
    let is_unmatched = rows.iter().any(|row| row.unmatched() != (0, 0));
    let has_lost = rows.iter().any(|row| row.lost() != (0, 0));
    let is_few = rows.iter().any(|row| row.contrast.seeds.0.min(row.contrast.seeds.1) < FEW_SEEDS);
    let columns = [
        ("arm", "Arm"),
        ("error", "Error, %"),
        ("seeds", "n"),
        (column(is_unmatched, [".unmatched", "unmatched"]), "Without partner"),
        (column(has_lost, [".lost", "lost"]), "Lost"),
        ("first", first),
        ("second", second),
        ("difference", "Difference"),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("p", "p"),
        (".p_student", ""),
        ("p_holm", "p (Holm)"),
        (".p_benjamini_hochberg", ""),
        (".p_permutation", ""),
        ("hedges_g", if is_paired { "Hedges’ g (paired)" } else { "Hedges’ g" }),
        (".hedges_g_low", ""),
        (".hedges_g_high", ""),
        ("improvement", "P(greater)"),
        (column(is_few, [".detectable", "detectable"]), "Detectable (80 % power)"),
        ("published", "Published"),
        ("published_p", "Published p"),
    ];
    let paired = if is_paired { ", paired by seed" } else { "" };
    let caption = format!("{title}: {}{paired}", metric_title(metric));
    let mut table = DataTable::new(caption, &columns);
    for row in rows {
        table.rows.push(contrast_entries(row, metric));
    }
    table
}

/// Two numbers of seeds, of the first side and the second; one where none is meant at all.
fn of_sides(numbers: (usize, usize)) -> Entry {
    Entry::Text(match numbers {
        (0, 0) => "0".to_owned(),
        (first, second) => format!("{first}, {second}"),
    })
}

fn contrast_entries(row: &ContrastRow, metric: &str) -> Vec<Entry> {
    let contrast = &row.contrast;
    let interval = contrast.test().map(|test| test.interval);
    let student = match contrast.tests {
        Tests::Independent { student, .. } => student,
        Tests::Matched { paired } => paired,
    };
    let (n, m) = contrast.seeds;
    let seeds = if n == m { n.to_string() } else { format!("{n}, {m}") };
    let g = contrast.hedges_g;
    let (first, second) = row.means();
    vec![
        Entry::text(arm_label(&row.name)),
        row.error.map_or_else(
            || Entry::Missing("no sigma".to_owned()),
            |error| Entry::Number { value: error, shown: shown(error * 100.0, 1) },
        ),
        Entry::Text(seeds),
        of_sides(row.unmatched()),
        of_sides(row.lost()),
        in_unit(first, metric),
        in_unit(second, metric),
        in_unit(contrast.difference, metric),
        between(interval, metric),
        low(interval),
        high(interval),
        Entry::p(contrast.test().map(|test| test.p)),
        Entry::p(student.map(|test| test.p)),
        Entry::p(row.corrected.map(|corrected| corrected.holm)),
        Entry::p(row.corrected.map(|corrected| corrected.benjamini_hochberg)),
        Entry::p(contrast.permutation_p),
        Entry::of(g.map(|g| g.g), 2),
        Entry::of(g.map(|g| g.interval.low), 2),
        Entry::of(g.map(|g| g.interval.high), 2),
        Entry::of(contrast.improvement.map(|improvement| improvement.probability), 2),
        in_unit(contrast.detectable, metric),
        Entry::published(row.published.map(|(effect, _)| Entry::number(effect, 1))),
        Entry::published(row.published.map(|(_, p)| Entry::number(p, 5))),
    ]
}
