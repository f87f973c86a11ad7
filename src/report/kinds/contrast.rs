//! Contrasts: differences with their intervals, with one row per comparison.

use super::forest::{MOST_ROWS, forest_figures, sides};
use super::{Drawn, Sheet, gap, gap_title, metric_words, related, test_name};
use crate::analyse::declared::{ALPHA, ContrastFigure, ContrastRow, TestFamily};
use crate::analyse::{FEW_SEEDS, Undefined};
use crate::job::{Measure, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::seeds;
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, between, high, in_unit, low};

impl Drawn for ContrastFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        // Axes without any difference would be an empty figure.
        let is_answered = self.rows.iter().any(|row| row.contrast.difference.is_ok());
        if is_answered { forest_figures(&self.rows, sheet) } else { Vec::new() }
    }

    fn wholes(&self, sheet: &Sheet<'_>, panels: usize) -> Vec<(String, usize)> {
        let stem = || sheet.stem.to_owned();
        // Parts of a panel that is higher than a page stay apart.
        match self.rows.len() > MOST_ROWS {
            true => (0..panels).map(|_| (stem(), 1)).collect(),
            false => vec![(stem(), panels)],
        }
    }

    fn table(&self, title: &str, metric: Measure, names: &Names) -> DataTable {
        table(title, self, metric, names)
    }

    fn shows(&self, metric: Measure, names: &Names) -> String {
        let [first, second] = self.named_sides(names);
        let counts = self.rows.iter().flat_map(|row| <[usize; 2]>::from(row.contrast.seeds));
        let (words, seeds) = (metric_words(metric), seeds(counts.filter(|n| *n > 0)));
        let tested = self.rows.iter().filter(|row| row.contrast.test.is_ok());
        let intervals = test_name(tested.map(|row| row.contrast.design)).map(|test| {
            format!(
                " ({test}) with their 95 % intervals, not corrected for the number of comparisons"
            )
        });
        let intervals = intervals.unwrap_or_default();
        format!("Differences in {words} between {first} and {second}{intervals}, {seeds} per side")
    }

    fn finds(&self, metric: Measure, names: &Names) -> Option<String> {
        let [first, second] = self.named_sides(names);
        let answered: Vec<(&ContrastRow, f64)> =
            self.rows.iter().filter_map(|row| Some((row, row.contrast.difference.ok()?))).collect();
        if answered.is_empty() {
            return None;
        }
        let tested: Vec<(&ContrastRow, f64)> =
            answered.iter().filter(|(row, _)| row.corrected.is_ok()).copied().collect();
        if answered.iter().all(|(_, difference)| *difference == 0.0) {
            let all = match answered.len() {
                1 => String::new(),
                all => format!(" in all {all} comparisons"),
            };
            return Some(format!("{first} and {second} have equal means{all}"));
        }
        if tested.is_empty() {
            let reason = answered.iter().find_map(|(row, _)| row.corrected.err());
            let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
            return Some(format!(
                "No difference can be tested{reason}; {}",
                widest(&answered, metric, names)
            ));
        }
        let family = family(tested[0].0);
        let significant: Vec<(&ContrastRow, f64)> =
            tested.iter().filter(|(row, _)| is_significant(row)).copied().collect();
        if let ([(row, _)], [_]) = (&tested[..], &self.rows[..]) {
            let verdict = if significant.is_empty() { "not significant" } else { "significant" };
            return Some(format!(
                "{}: {verdict}{}{family}",
                widest(&tested, metric, names),
                statistic(row)
            ));
        }
        let all = tested.len();
        let count = |sign: f64| significant.iter().filter(|one| one.1 * sign > 0.0).count();
        let signs = match (count(1.0), count(-1.0)) {
            (0, 0) => format!("None of {all} tested differences is significant"),
            (above, 0) if above == all => {
                format!("{first} is significantly above {second} in all {all} tested comparisons")
            }
            (0, below) if below == all => {
                format!("{first} is significantly below {second} in all {all} tested comparisons")
            }
            (above, below) => format!(
                "Of {all} tested comparisons, {first} is significantly above {second} in {above} and \
                 significantly below it in {below}"
            ),
        };
        let (quoted, which) = match significant.is_empty() {
            true => (&tested, "the widest"),
            false => (&significant, "the widest significant one"),
        };
        Some(format!(
            "{signs}; at {which}, {}{}{family}",
            widest(quoted, metric, names),
            statistic(widest_of(quoted))
        ))
    }

    fn lacks(&self) -> Option<String> {
        if self.rows.is_empty() {
            return Some(
                "no comparison, because no setting of the other keys is on both sides".to_owned(),
            );
        }
        let unanswered = self.rows.iter().filter_map(|row| row.contrast.difference.err());
        let open = unanswered.clone().count();
        let reasons = distinct(unanswered.map(|reason| reason.to_string()));
        let open = (open > 0).then(|| {
            format!("{open} of {} ({})", counted(self.rows.len(), "comparison"), reasons.join(", "))
        });
        let constant = self.rows.iter().filter(|row| {
            let difference = row.contrast.difference.is_ok_and(|difference| difference != 0.0);
            difference && row.contrast.test == Err(Undefined::NoVariance)
        });
        let constant = match constant.count() {
            0 => None,
            1 => Some("the test of 1 difference that is the same for every seed".to_owned()),
            some => {
                Some(format!("the tests of {some} differences that are the same for every seed"))
            }
        };
        let all: Vec<String> = open.into_iter().chain(constant).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }

    fn is_table(&self) -> bool {
        true
    }
}

impl ContrastFigure {
    /// The sides as they are displayed. They are agents if the rows have none.
    fn named_sides(&self, names: &Names) -> [String; 2] {
        let has_agents = self.rows.iter().all(|row| row.name.agent.is_empty());
        [&self.sides.0, &self.sides.1].map(|side| names.words(side, has_agents))
    }
}

/// "9 degrees of freedom".
fn freedom(df: f64) -> String {
    if df == 1.0 { "1 degree of freedom".to_owned() } else { format!("{df} degrees of freedom") }
}

/// The row with the largest difference.
fn widest_of<'r>(rows: &[(&'r ContrastRow, f64)]) -> &'r ContrastRow {
    let size = |one: &&(&ContrastRow, f64)| one.1.abs();
    let widest = rows.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
    widest.expect("there is a row").0
}

/// The largest of some differences: "a is above b by 12, for dqn".
fn widest(rows: &[(&ContrastRow, f64)], metric: Measure, names: &Names) -> String {
    let row = widest_of(rows);
    let difference = row.contrast.difference.unwrap_or_default();
    let side = if difference < 0.0 { "below" } else { "above" };
    let label = names.label(&row.name);
    let subject = if label.is_empty() { String::new() } else { format!(", for {label}") };
    let [first, second] = sides(row, names);
    format!("{first} is {side} {second} by {}{subject}", gap(difference.abs(), metric))
}

/// The name of the t test of a row.
fn test(row: &ContrastRow) -> &'static str {
    if row.is_paired() { "paired" } else { "unpaired" }
}

fn is_significant(row: &ContrastRow) -> bool {
    row.corrected.is_ok_and(|p| p.holm < ALPHA)
}

/// The correction of a row's p value: "; p corrected by Holm over the 24 tests of family f".
fn family(row: &ContrastRow) -> String {
    let TestFamily { name, members } = &row.family;
    match members {
        0 | 1 => String::new(),
        _ => format!("; Holm’s correction is over the {members} tests of the family {name}"),
    }
}

/// The test of a row: " (paired t = 2.31, 9 degrees of freedom, p = 0.03)"; empty if it is undefined.
fn statistic(row: &ContrastRow) -> String {
    match (row.contrast.test, row.corrected) {
        (Ok(found), Ok(p)) => {
            let t = format!(
                "{} t = {}, {}, p {}",
                test(row),
                shown(found.t, 2),
                freedom(found.df),
                related(found.p)
            );
            match row.family.members {
                0 | 1 => format!(" ({t})"),
                _ => format!(" ({t}, corrected {})", related(p.holm)),
            }
        }
        _ => String::new(),
    }
}

fn table(title: &str, figure: &ContrastFigure, metric: Measure, names: &Names) -> DataTable {
    let ([first, second], rows) = (figure.named_sides(names), &figure.rows);
    let is_paired = !rows.is_empty() && rows.iter().all(ContrastRow::is_paired);
    let is_mixed = !is_paired && rows.iter().any(ContrastRow::is_paired);
    // Readers see only columns that some row needs; files have every column.
    let column = |is_shown: bool, names: [&'static str; 2]| names[usize::from(is_shown)];
    let is_unmatched = rows.iter().any(|row| row.unmatched() != (0, 0));
    let has_lost = rows.iter().any(|row| row.lost() != (0, 0));
    let members = rows.first().map_or(0, |row| row.family.members);
    let corrected = match members {
        0 | 1 => "p (Holm)".to_owned(),
        _ => format!("p (Holm, {members} tests)"),
    };
    let level = if members > 1 { format!("0.05/{members}") } else { "0.05".to_owned() };
    let detectable = format!("Detectable (80 % power at {level})");
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
        ("test", "t test"),
        (".df", ""),
        ("p", "p"),
        (".p_student", ""),
        (".family", ""),
        (".tests", ""),
        ("p_holm", corrected.as_str()),
        (".p_benjamini_hochberg", ""),
        (".p_permutation", ""),
        ("hedges_g", if is_paired { "Hedges’ g (paired)" } else { "Hedges’ g" }),
        (".hedges_g_low", ""),
        (".hedges_g_high", ""),
        ("improvement", "P(greater)"),
        (".improvement_low", ""),
        (".improvement_high", ""),
        (column(is_few, [".detectable", "detectable"]), detectable.as_str()),
        (column(is_few, [".detectable_interval", "detectable_interval"]), "its 95 % interval"),
        (".detectable_low", ""),
        (".detectable_high", ""),
        ("published", "Published"),
        ("published_p", "Published p"),
    ];
    let family = rows.first().map_or_else(String::new, family);
    let designs = rows.iter().map(|row| row.contrast.design);
    let test = test_name(designs).map_or_else(String::new, |test| format!("; {test}"));
    let caption = format!("{title}: {}{test}{family}", gap_title(metric));
    let mut table = DataTable::new(caption, &columns);
    for row in rows {
        let mut entries = vec![arm(&row.name, names)];
        entries.extend(contrast_entries(row, metric, is_mixed));
        table.rows.push(entries);
    }
    table
}

/// The numbers of seeds of the first and the second side; a single 0 if both are 0.
fn of_sides(numbers: (usize, usize)) -> TableEntry {
    TableEntry::text(match numbers {
        (0, 0) => "0".to_owned(),
        (first, second) => format!("{first}, {second}"),
    })
}

fn contrast_entries(row: &ContrastRow, metric: Measure, is_mixed: bool) -> Vec<TableEntry> {
    let contrast = &row.contrast;
    let interval = contrast.test.map(|test| test.interval);
    let improvement = contrast.improvement.map(|improvement| improvement.interval);
    let detectable = row.detectable();
    let of_detectable = detectable.map(|detectable| detectable.interval);
    let (n, m) = contrast.seeds;
    let seeds = if n == m { n.to_string() } else { format!("{n}, {m}") };
    let g = contrast.hedges_g;
    let (first, second) = row.means();
    vec![
        row.error.map_or_else(
            || TableEntry::Missing("not the same on both sides".to_owned()),
            |error| TableEntry::Number { value: error, shown: shown(error * 100.0, 1) },
        ),
        TableEntry::text(seeds),
        of_sides(row.unmatched()),
        of_sides(row.lost()),
        in_unit(first, metric),
        in_unit(second, metric),
        in_unit(contrast.difference, metric),
        between(interval, metric),
        low(interval),
        high(interval),
        TableEntry::text(test(row)),
        TableEntry::of(contrast.test.map(|test| test.df), 0),
        TableEntry::p(contrast.test.map(|test| test.p)),
        TableEntry::p(contrast.student.map(|test| test.p)),
        TableEntry::text(row.family.name.clone()),
        TableEntry::number(row.family.members as f64, 0),
        TableEntry::p(row.corrected.map(|corrected| corrected.holm)),
        TableEntry::p(row.corrected.map(|corrected| corrected.benjamini_hochberg)),
        TableEntry::p(contrast.permutation_p),
        match (g, is_mixed && row.is_paired()) {
            // The unit is another one than that of unpaired rows.
            (Ok(g), true) => {
                TableEntry::Number { value: g.g, shown: format!("{} (paired)", shown(g.g, 2)) }
            }
            (g, _) => TableEntry::of(g.map(|g| g.g), 2),
        },
        TableEntry::of(g.map(|g| g.interval.low), 2),
        TableEntry::of(g.map(|g| g.interval.high), 2),
        TableEntry::of(contrast.improvement.map(|improvement| improvement.probability), 2),
        TableEntry::of(improvement.map(|interval| interval.low), 2),
        TableEntry::of(improvement.map(|interval| interval.high), 2),
        in_unit(detectable.map(|detectable| detectable.difference), metric),
        between(of_detectable, metric),
        low(of_detectable),
        high(of_detectable),
        TableEntry::published(row.published.map(|(effect, _)| TableEntry::number(effect, 1))),
        TableEntry::published(row.published.and_then(|(_, p)| p).map(|p| TableEntry::number(p, 5))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::{Corrected, Sample, SeedPairing};
    use crate::job::metric::MEAN_RETURN;

    const RETURN: Measure = MEAN_RETURN.in_unit("points");

    fn row(first: f64, holm: Option<f64>) -> ContrastRow {
        let sample = |mean: f64| Sample::new([(1, mean - 1.0), (2, mean + 1.0)], 0, 0).unwrap();
        let row = ContrastRow::between(sample(first), sample(10.0), SeedPairing::Independent);
        match holm {
            Some(holm) => {
                ContrastRow { corrected: Ok(Corrected { holm, benjamini_hochberg: holm }), ..row }
            }
            None => row,
        }
    }

    fn figure(rows: Vec<ContrastRow>) -> ContrastFigure {
        ContrastFigure { sides: ("a".into(), "b".into()), rows }
    }

    #[test]
    fn only_tested_differences_are_counted_and_the_widest_significant_one_is_quoted() {
        let describe = |all: &[(f64, Option<f64>)]| {
            let rows: Vec<ContrastRow> = all.iter().map(|(mean, holm)| row(*mean, *holm)).collect();
            let members = rows.len();
            let family = TestFamily { name: "f".into(), members };
            let rows = rows.into_iter().map(|row| ContrastRow { family: family.clone(), ..row });
            figure(rows.collect()).finds(RETURN, &Names::default()).unwrap()
        };
        assert_eq!(
            describe(&[(12.0, Some(0.2)), (16.0, Some(0.05)), (90.0, None)]),
            "None of 2 tested differences is significant; at the widest, a is above b by 6, for dqn P \
             (unpaired t = 4.24, 1 degree of freedom, p = 0.147, corrected = 0.050); Holm’s correction is \
             over the 3 tests of the family f"
        );
        assert_eq!(
            describe(&[(12.0, Some(0.01)), (16.0, Some(0.2)), (7.0, Some(0.3))]),
            "Of 3 tested comparisons, a is significantly above b in 1 and significantly below it in 0; at \
             the widest significant one, a is above b by 2, for dqn P (unpaired t = 1.41, 1 degree of \
             freedom, p = 0.392, corrected = 0.010); Holm’s correction is over the 3 tests of the family f"
        );
        assert_eq!(
            describe(&[(12.0, Some(0.01)), (13.0, Some(0.02))]),
            "a is significantly above b in all 2 tested comparisons; at the widest significant one, a is \
             above b by 3, for dqn P (unpaired t = 2.12, 1 degree of freedom, p = 0.280, corrected = \
             0.020); Holm’s correction is over the 2 tests of the family f"
        );
        assert_eq!(
            describe(&[(12.0, Some(0.01))]),
            "a is above b by 2, for dqn P: significant (unpaired t = 1.41, 1 degree of freedom, p = 0.392)"
        );
        assert_eq!(
            describe(&[(12.0, None), (16.0, None)]),
            "No difference can be tested (too few seeds: 1 of at least 2); a is above b by 6, for dqn P"
        );
        assert!(!describe(&[(12.0, Some(0.5)), (12.0, Some(0.5))]).contains(". "));
    }

    #[test]
    fn equal_means_are_called_equal() {
        let equal = || row(10.0, Some(1.0));
        let describe = |rows| figure(rows).finds(RETURN, &Names::default()).unwrap();
        assert_eq!(
            describe(vec![equal(), equal()]),
            "a and b have equal means in all 2 comparisons"
        );
        assert_eq!(describe(vec![equal()]), "a and b have equal means");
    }

    #[test]
    fn a_contrast_without_comparisons_names_its_sides_and_its_reason() {
        let none = figure(Vec::new());
        let table = none.table("", RETURN, &Names::default());
        let headings: Vec<&str> = table.columns.iter().map(|one| one.heading.as_str()).collect();
        assert!(headings.contains(&"a") && headings.contains(&"b"), "{headings:?}");
        assert!(none.shows(RETURN, &Names::default()).contains("between a and b"));
        assert!(none.lacks().unwrap().starts_with("no comparison"));
    }
}
