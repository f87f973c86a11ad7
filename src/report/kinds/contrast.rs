//! Contrasts: differences with their intervals, with one row per comparison.

use super::forest::forest_figures;
use super::{Drawn, Sheet, amount, related};
use crate::analyse::declared::{ALPHA, ContrastFigure, ContrastRow};
use crate::analyse::{FEW_SEEDS, Tests};
use crate::plan::counted;
use crate::report::data_table::{DataTable, Entry, shown};
use crate::report::figure::{arm_label, seeds};
use crate::report::scene::Scene;
use crate::report::tables::{between, high, in_unit, low};
use crate::report::words::metric_title;

impl Drawn for ContrastFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        // Axes without any difference would be an empty figure.
        let is_answered = self.rows.iter().any(|row| row.contrast.difference.is_ok());
        if is_answered { forest_figures(&self.rows, sheet) } else { Vec::new() }
    }

    fn table(&self, title: &str, metric: &str) -> DataTable {
        table(title, self, metric)
    }

    fn shows(&self, metric: &str) -> String {
        let sides = format!(" between {} and {}", self.sides.0, self.sides.1);
        let counts = self.rows.iter().map(|row| row.contrast.seeds.0.min(row.contrast.seeds.1));
        let seeds = seeds(counts.filter(|n| *n > 0));
        format!(
            "Differences in {}{sides} with their 95 % intervals, not corrected for the number of \
             comparisons, {seeds} per side",
            metric_title(metric)
        )
    }

    fn finds(&self, metric: &str) -> Option<String> {
        let answered: Vec<(&ContrastRow, f64)> =
            self.rows.iter().filter_map(|row| Some((row, row.contrast.difference.ok()?))).collect();
        let size = |one: &&(&ContrastRow, f64)| one.1.abs();
        let (row, largest) = answered.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?;
        let label = arm_label(&row.name);
        let (first, second) = (&row.sides.0, &row.sides.1);
        let test = test(row);
        let side = if *largest < 0.0 { "below" } else { "above" };
        let size = amount(largest.abs(), metric);
        let rows: Vec<&ContrastRow> = answered.iter().map(|(row, _)| *row).collect();
        if *largest == 0.0 {
            let all = match answered.len() {
                1 => String::new(),
                all => format!(" in all {all} comparisons"),
            };
            return Some(format!("{first} and {second} have equal means{all}; {}", verdict(&rows)));
        }
        if let [_] = &answered[..]
            && let (Ok(found), Ok(p)) = (row.contrast.test(), row.corrected)
        {
            let place = if label.is_empty() { String::new() } else { format!(", for {label}") };
            let verdict = if is_significant(row) { "significant" } else { "not significant" };
            return Some(format!(
                "{first} is {side} {second} by {size}{place}: {verdict} ({test} t = {}, {} degrees of \
                 freedom, Holm-corrected p {})",
                shown(found.t, 2),
                shown(found.df, 1),
                related(p.holm),
            ));
        }
        let count = |is: fn(f64) -> bool| answered.iter().filter(|one| is(one.1)).count();
        let (above, below) = (count(|d| d > 0.0), count(|d| d < 0.0));
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
        Some(format!(
            "{signs}; it is furthest {side} {place}by {size}{}; {}",
            statistic(row),
            verdict(&rows)
        ))
    }

    fn lacks(&self) -> Option<String> {
        let mut reasons: Vec<String> = Vec::new();
        if self.rows.is_empty() {
            return Some(
                "no comparison, because no setting of the other keys is on both sides".to_owned(),
            );
        }
        let unanswered = self.rows.iter().filter_map(|row| row.contrast.difference.err());
        let open = unanswered.clone().count();
        for reason in unanswered.map(|reason| reason.to_string()) {
            if !reasons.contains(&reason) {
                reasons.push(reason);
            }
        }
        (open > 0).then(|| {
            format!("{open} of {} ({})", counted(self.rows.len(), "comparison"), reasons.join(", "))
        })
    }

    fn is_table(&self) -> bool {
        true
    }
}

/// The name of the t test of a row.
fn test(row: &ContrastRow) -> &'static str {
    if row.is_paired() { "paired" } else { "Welch’s" }
}

fn is_significant(row: &ContrastRow) -> bool {
    row.corrected.is_ok_and(|p| p.holm < ALPHA)
}

/// How many of these differences are significant, with the relation of their p values to the level.
fn verdict(rows: &[&ContrastRow]) -> String {
    let (all, tested) = (rows.len(), rows.iter().filter(|row| row.corrected.is_ok()).count());
    let significant = rows.iter().filter(|row| is_significant(row)).count();
    let test = rows.first().map_or("Welch’s", |row| test(row));
    let (words, relation) = match significant {
        _ if tested == 0 => {
            let reason = rows.iter().find_map(|row| row.corrected.err());
            let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
            return format!("no difference can be tested{reason}");
        }
        0 if tested < all => (format!("none of {tested} tested differences is"), "≥"),
        0 => ("no difference is".to_owned(), "≥"),
        all_of_them if all_of_them == all => ("every difference is".to_owned(), "<"),
        1 => (format!("1 of {all} differences is"), "<"),
        several => (format!("{several} of {all} differences are"), "<"),
    };
    format!("{words} significant ({test} t, Holm-corrected p {relation} {ALPHA})")
}

/// The test of a row: " (t = 2.31, Holm-corrected p = 0.03)"; empty if it is undefined.
fn statistic(row: &ContrastRow) -> String {
    match (row.contrast.test(), row.corrected) {
        (Ok(test), Ok(p)) => {
            format!(" (t = {}, Holm-corrected p {})", shown(test.t, 2), related(p.holm))
        }
        _ => String::new(),
    }
}

fn table(title: &str, figure: &ContrastFigure, metric: &str) -> DataTable {
    let ContrastFigure { sides: (first, second), rows } = figure;
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
        ("first", first.as_str()),
        ("second", second.as_str()),
        ("difference", "Difference"),
        ("interval", "95 % interval, not corrected"),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::declared::ArmId;
    use crate::analyse::{Contrast, Corrected, Design, Sample, Undefined};

    fn row(first: f64, holm: Option<f64>) -> ContrastRow {
        let sample = |mean: f64| Sample::new([(1, mean - 1.0), (2, mean + 1.0)], 0, 0).unwrap();
        let (first, second) = (sample(first), sample(10.0));
        ContrastRow {
            sides: ("a".into(), "b".into()),
            name: ArmId { agent: "dqn".into(), scenario: "P".into(), settings: Vec::new() },
            error: None,
            contrast: Contrast::new(&first, &second, Design::Independent),
            family: String::new(),
            corrected: holm
                .map(|holm| Corrected { holm, benjamini_hochberg: holm })
                .ok_or(Undefined::TooFewSeeds { have: 1, need: 2 }),
            published: None,
            first,
            second,
        }
    }

    fn figure(rows: Vec<ContrastRow>) -> ContrastFigure {
        ContrastFigure { sides: ("a".into(), "b".into()), rows }
    }

    #[test]
    fn a_verdict_has_the_relation_of_its_p_values_to_the_level() {
        let of = |all: &[Option<f64>]| {
            let rows: Vec<ContrastRow> = all.iter().map(|holm| row(12.0, *holm)).collect();
            verdict(&rows.iter().collect::<Vec<_>>())
        };
        let t = "significant (Welch’s t, Holm-corrected p";
        assert_eq!(of(&[Some(0.2), Some(0.05)]), format!("no difference is {t} ≥ 0.05)"));
        assert_eq!(of(&[Some(0.2), Some(0.01)]), format!("1 of 2 differences is {t} < 0.05)"));
        assert_eq!(of(&[Some(0.01); 2]), format!("every difference is {t} < 0.05)"));
        assert_eq!(of(&[Some(0.3), None]), format!("none of 1 tested differences is {t} ≥ 0.05)"));
        assert_eq!(
            of(&[None, None]),
            "no difference can be tested (too few seeds: 1 of at least 2)"
        );
    }

    #[test]
    fn equal_means_are_called_equal() {
        let equal = || row(10.0, Some(1.0));
        assert_eq!(
            figure(vec![equal(), equal()]).finds("mean_return").unwrap(),
            "a and b have equal means in all 2 comparisons; no difference is significant (Welch’s t, \
             Holm-corrected p ≥ 0.05)"
        );
        assert!(
            figure(vec![equal()])
                .finds("mean_return")
                .unwrap()
                .starts_with("a and b have equal means; ")
        );
    }

    #[test]
    fn a_contrast_without_comparisons_names_its_sides_and_its_reason() {
        let none = figure(Vec::new());
        let table = none.table("", "mean_return");
        let headings: Vec<&str> = table.columns.iter().map(|one| one.heading.as_str()).collect();
        assert!(headings.contains(&"a") && headings.contains(&"b"), "{headings:?}");
        assert!(none.shows("mean_return").contains("between a and b"));
        assert!(none.lacks().unwrap().starts_with("no comparison"));
    }
}
