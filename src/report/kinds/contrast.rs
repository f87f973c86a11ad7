//! Contrasts: differences with their intervals, with one row per comparison.

use super::forest::forest_figures;
use super::{Drawn, Sheet, amount, related};
use crate::analyse::declared::{ALPHA, ContrastRow};
use crate::analyse::{FEW_SEEDS, Tests};
use crate::report::data_table::{DataTable, Entry, shown};
use crate::report::figure::{arm_label, seeds};
use crate::report::scene::Scene;
use crate::report::tables::{between, high, in_unit, low};
use crate::report::words::metric_title;

impl Drawn for Vec<ContrastRow> {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        // Axes without any difference would be an empty figure.
        let is_answered = self.iter().any(|row| row.contrast.difference.is_ok());
        if is_answered { forest_figures(self, sheet) } else { Vec::new() }
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
            "Differences in {}{sides} with their 95 % intervals, {seeds} per side",
            metric_title(metric)
        )
    }

    fn finds(&self, metric: &str) -> Option<String> {
        let answered: Vec<(&ContrastRow, f64)> =
            self.iter().filter_map(|row| Some((row, row.contrast.difference.ok()?))).collect();
        let size = |one: &&(&ContrastRow, f64)| one.1.abs();
        let (row, largest) = answered.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?;
        let count = |is: fn(f64) -> bool| answered.iter().filter(|one| is(one.1)).count();
        let (above, below) = (count(|d| d > 0.0), count(|d| d < 0.0));
        let is_certain = |row: &ContrastRow| row.corrected.is_ok_and(|p| p.holm < ALPHA);
        let certain = answered.iter().filter(|(row, _)| is_certain(row)).count();
        let label = arm_label(&row.name);
        let (first, second) = (&row.sides.0, &row.sides.1);
        let test = if row.is_paired() { "paired" } else { "Welch’s" };
        let side = if *largest < 0.0 { "below" } else { "above" };
        let size = amount(largest.abs(), metric);
        if let [_] = &answered[..]
            && let (Ok(found), Ok(p)) = (row.contrast.test(), row.corrected)
        {
            let place = if label.is_empty() { String::new() } else { format!(", for {label}") };
            let verdict = if is_certain(row) { "significant" } else { "not significant" };
            return Some(format!(
                "{first} is {side} {second} by {size}{place}: {verdict} ({test} t = {:.2}, {:.1} \
                 degrees of freedom, Holm-corrected p {})",
                found.t,
                found.df,
                related(p.holm),
            ));
        }
        let all = answered.len();
        let signs = match (above, below) {
            _ if all == 1 => format!("{first} is {side} {second}"),
            (above, _) if above == all => {
                format!("{first} is above {second} in all {all} comparisons")
            }
            (_, below) if below == all => {
                format!("{first} is below {second} in all {all} comparisons")
            }
            (above, below) => format!(
                "{first} is above {second} in {above} of {all} comparisons and below it in {below}"
            ),
        };
        let place = if label.is_empty() { String::new() } else { format!("for {label}, ") };
        let verdict = match certain {
            0 => "no difference is".to_owned(),
            certain if certain == all => "every difference is".to_owned(),
            1 => format!("1 of {all} differences is"),
            certain => format!("{certain} of {all} differences are"),
        };
        Some(format!(
            "{signs}; it is furthest {side} {place}by {size}{}; {verdict} significant ({test} t, \
             Holm-corrected p < {ALPHA})",
            statistic(row),
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

/// The test of a row: " (t = 2.31, Holm-corrected p = 0.03)"; empty if it is undefined.
fn statistic(row: &ContrastRow) -> String {
    match (row.contrast.test(), row.corrected) {
        (Ok(test), Ok(p)) => {
            format!(" (t = {:.2}, Holm-corrected p {})", test.t, related(p.holm))
        }
        _ => String::new(),
    }
}

fn table(title: &str, rows: &[ContrastRow], metric: &str) -> DataTable {
    let (first, second) = rows
        .first()
        .map_or(("first", "second"), |row| (row.sides.0.as_str(), row.sides.1.as_str()));
    let is_paired = rows.iter().any(ContrastRow::is_paired);
    // Readers see only columns that some row needs; files have every column.
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

/// The numbers of seeds of the first and the second side; a single 0 if both are 0.
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
            || Entry::Missing("not the same on both sides".to_owned()),
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
