//! Tables: from findings to rows.

use super::arm_tables::{optimum, share};
use super::data_table::{Cell, DataTable, shown};
use super::figure::{Numbers, arm_label, settings_label};
use super::words::{metric_title, unit_numbers};
use crate::analyse::declared::{
    ActionPanel, Chosen, Comparison, Content, ContrastRow, CurveFigure, ErrorFigure, Finding,
    HeatFigure, LearningPanel, Reproduction, varying,
};
use crate::analyse::{
    Design, FEW_SEEDS, Interval, Moments, Tests, Undefined, Verdict, mean_interval,
};
use crate::record::{JobRecord, Progress, Setting};

/// The table of a finding.
pub fn table(finding: &Finding) -> DataTable {
    let title = &finding.title;
    match &finding.content {
        Content::Contrast(rows) => contrast(title, rows, finding.metric),
        Content::Curve(figure) => curve(title, figure, finding.metric),
        Content::LearningCurve { panels, .. } => learning(title, panels),
        Content::HeatMap(figures) => heat(title, figures, finding.metric),
        Content::ActionChoice(panels) => actions(title, panels),
        Content::Selection(chosen) => selection(title, chosen, finding.metric),
        Content::InferenceError(figure) => errors(title, figure),
    }
}

/// A metric's number as readers see it, in its unit.
pub(super) fn in_unit(value: Result<f64, Undefined>, metric: &str) -> Cell {
    match (value, unit_numbers(metric)) {
        (Ok(value), (Numbers::Percent, decimals)) => {
            Cell::Number { value, shown: shown(value * 100.0, decimals) }
        }
        (value, (_, decimals)) => Cell::of(value, decimals.max(1)),
    }
}

/// An interval as readers see it.
pub(super) fn between(interval: Result<Interval, Undefined>, metric: &str) -> Cell {
    match interval {
        Ok(Interval { low, high }) => {
            let (low, high) = (in_unit(Ok(low), metric), in_unit(Ok(high), metric));
            Cell::text(format!("{} to {}", low.shown(), high.shown()))
        }
        Err(reason) => Cell::Missing(reason.to_string()),
    }
}

/// The lower end of an interval.
pub(super) fn low(interval: Result<Interval, Undefined>) -> Cell {
    Cell::of(interval.map(|interval| interval.low), 1)
}

/// The upper end of an interval.
pub(super) fn high(interval: Result<Interval, Undefined>) -> Cell {
    Cell::of(interval.map(|interval| interval.high), 1)
}

/// The mean of the seeds.
pub(super) fn mean(values: &[f64]) -> Result<f64, Undefined> {
    Moments::of(values).map(|moments| moments.mean)
}

fn contrast(title: &str, rows: &[ContrastRow], metric: &str) -> DataTable {
    let (first, second) = rows
        .first()
        .map_or(("first", "second"), |row| (row.sides.0.as_str(), row.sides.1.as_str()));
    let is_paired = rows.iter().any(ContrastRow::is_paired);
    // Readers see what some rows have; files have every column.
    let column = |is_shown: bool, names: [&'static str; 2]| names[usize::from(is_shown)];
    let is_unmatched = rows.iter().any(|row| unmatched(row) != (0, 0));
    let has_lost = rows.iter().any(|row| lost(row) != (0, 0));
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
        table.rows.push(contrast_cells(row, metric));
    }
    table
}

/// Two numbers of seeds, of the first side and the second; one where none is meant at all.
fn of_sides(numbers: (usize, usize)) -> Cell {
    Cell::Text(match numbers {
        (0, 0) => "0".to_owned(),
        (first, second) => format!("{first}, {second}"),
    })
}

/// Seeds of each side that have a value and, where seeds are matched, no partner.
fn unmatched(row: &ContrastRow) -> (usize, usize) {
    let (first, second) = row.contrast.seeds;
    (row.first.n() - first, row.second.n() - second)
}

/// Seeds of each side that ended without a value.
fn lost(row: &ContrastRow) -> (usize, usize) {
    (row.first.lost().ended() as usize, row.second.lost().ended() as usize)
}

/// The means of the sides: of the seeds that are compared, so that they differ by the difference.
fn side_means(row: &ContrastRow) -> (Result<f64, Undefined>, Result<f64, Undefined>) {
    match row.contrast.design {
        Design::Independent => (mean(row.first.values()), mean(row.second.values())),
        Design::Matched => {
            let means = row.contrast.means;
            (means.map(|(first, _)| first), means.map(|(_, second)| second))
        }
    }
}

/// Why so many seeds have no interval of their mean.
fn no_interval(seeds: usize) -> Undefined {
    match seeds {
        0 => Undefined::NoSeeds,
        1 => Undefined::TooFewSeeds { have: 1, need: 2 },
        _ => Undefined::NoVariance,
    }
}

fn contrast_cells(row: &ContrastRow, metric: &str) -> Vec<Cell> {
    let contrast = &row.contrast;
    let interval = contrast.test().map(|test| test.interval);
    let student = match contrast.tests {
        Tests::Independent { student, .. } => student,
        Tests::Matched { paired } => paired,
    };
    let (n, m) = contrast.seeds;
    let seeds = if n == m { n.to_string() } else { format!("{n}, {m}") };
    let g = contrast.hedges_g;
    let (first, second) = side_means(row);
    vec![
        Cell::text(arm_label(&row.name)),
        row.error.map_or_else(
            || Cell::Missing("no sigma".to_owned()),
            |error| Cell::Number { value: error, shown: shown(error * 100.0, 1) },
        ),
        Cell::Text(seeds),
        of_sides(unmatched(row)),
        of_sides(lost(row)),
        in_unit(first, metric),
        in_unit(second, metric),
        in_unit(contrast.difference, metric),
        between(interval, metric),
        low(interval),
        high(interval),
        Cell::p(contrast.test().map(|test| test.p)),
        Cell::p(student.map(|test| test.p)),
        Cell::p(row.corrected.map(|corrected| corrected.holm)),
        Cell::p(row.corrected.map(|corrected| corrected.benjamini_hochberg)),
        Cell::p(contrast.permutation_p),
        Cell::of(g.map(|g| g.g), 2),
        Cell::of(g.map(|g| g.interval.low), 2),
        Cell::of(g.map(|g| g.interval.high), 2),
        Cell::of(contrast.improvement.map(|improvement| improvement.probability), 2),
        in_unit(contrast.detectable, metric),
        Cell::published(row.published.map(|(effect, _)| Cell::number(effect, 1))),
        Cell::published(row.published.map(|(_, p)| Cell::number(p, 5))),
    ]
}

fn curve(title: &str, figure: &CurveFigure, metric: &str) -> DataTable {
    let axis = figure.axis.rsplit('.').next().unwrap_or(&figure.axis);
    let is_error = axis == "context_inference_error";
    let name = metric_title(metric);
    let has_optimum = figure.lines.iter().any(|line| !line.optimum.is_empty());
    let columns = [
        ("arm", "Arm"),
        ("parameter", if is_error { "σ" } else { axis }),
        ("x", if is_error { "Error, %" } else { "x" }),
        ("seeds", "n"),
        ("mean", name.as_str()),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("sd", "SD over seeds"),
        (if has_optimum { "optimum" } else { ".optimum" }, "Optimum"),
        (if has_optimum { "share_of_optimum" } else { ".share_of_optimum" }, "Share of it, %"),
        ("published", "Published"),
    ];
    let mut table = DataTable::new(title, &columns);
    for line in &figure.lines {
        for point in &line.points {
            let values = point.sample.values();
            let interval = mean_interval(values);
            let published = line.published.iter().find(|(x, _)| *x == point.x);
            let best = line.optimum.iter().find(|(x, _)| *x == point.x).map(|(_, best)| *best);
            let sd = Moments::of(values).and_then(|moments| moments.sd);
            let x = if is_error { shown(point.x * 100.0, 1) } else { point.x.to_string() };
            table.rows.push(vec![
                Cell::text(arm_label(&line.name)),
                Cell::Number { value: point.parameter, shown: point.parameter.to_string() },
                Cell::Number { value: point.x, shown: x },
                Cell::number(values.len() as f64, 0),
                in_unit(mean(values), metric),
                between(interval, metric),
                low(interval),
                high(interval),
                in_unit(sd, metric),
                optimum(best),
                share(mean(values), best),
                Cell::published(published.map(|(_, value)| Cell::number(*value, 0))),
            ]);
        }
    }
    table
}

fn learning(title: &str, panels: &[LearningPanel]) -> DataTable {
    let columns = [
        ("arm", "Arm"),
        ("seeds", "n"),
        ("episode", "Episode"),
        ("mean", "Moving mean of the return"),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
    ];
    let mut table = DataTable::new(title, &columns);
    for line in panels.iter().flat_map(|panel| &panel.lines) {
        for (episode, mean, interval) in &line.points {
            let interval = interval.ok_or(no_interval(line.seeds.0));
            table.rows.push(vec![
                Cell::text(arm_label(&line.name)),
                Cell::number(line.seeds.0 as f64, 0),
                Cell::number(f64::from(*episode), 0),
                Cell::number(*mean, 1),
                between(interval, "mean_return"),
                low(interval),
                high(interval),
            ]);
        }
    }
    table
}

fn heat(title: &str, figures: &[HeatFigure], metric: &str) -> DataTable {
    let name = metric_title(metric);
    let last = |figure: Option<&HeatFigure>, of: fn(&HeatFigure) -> &String| {
        let dotted = figure.map(of).cloned().unwrap_or_default();
        dotted.rsplit('.').next().unwrap_or_default().to_owned()
    };
    let x = last(figures.first(), |figure| &figure.x.0);
    let y = last(figures.first(), |figure| &figure.y.0);
    let columns = [
        ("agent", "Agent"),
        ("subject", "Subject"),
        ("y", y.as_str()),
        ("x", x.as_str()),
        ("seeds", "n"),
        ("value", name.as_str()),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("published", "Published"),
    ];
    let mut table = DataTable::new(title, &columns);
    for figure in figures {
        for cell in &figure.cells {
            table.rows.push(vec![
                Cell::text(&figure.agent),
                Cell::text(&figure.subject),
                Cell::Number { value: cell.y, shown: cell.y.to_string() },
                Cell::Number { value: cell.x, shown: cell.x.to_string() },
                Cell::number(cell.seeds as f64, 0),
                in_unit(cell.value, metric),
                between(cell.interval, metric),
                low(cell.interval),
                high(cell.interval),
                Cell::published(cell.published.map(|value| in_unit(Ok(value), metric))),
            ]);
        }
    }
    table
}

fn actions(title: &str, panels: &[ActionPanel]) -> DataTable {
    let columns = [
        ("arm", "Arm"),
        ("p_low", "p from"),
        ("p_high", "to"),
        ("action", "Action"),
        ("share", "Share, %"),
        ("interval", "95 % interval, %"),
        (".low", ""),
        (".high", ""),
        ("seeds", "n"),
        ("steps", "Test steps"),
    ];
    let mut table = DataTable::new(title, &columns);
    for panel in panels {
        for bin in &panel.bins {
            for (action, (share, interval)) in bin.shares.iter().flatten().enumerate() {
                let interval = interval.ok_or(no_interval(bin.seeds));
                table.rows.push(vec![
                    Cell::text(arm_label(&panel.name)),
                    Cell::number(bin.low, 1),
                    Cell::number(bin.high, 1),
                    Cell::number(action as f64, 0),
                    in_unit(Ok(*share), "message_rate"),
                    between(interval, "message_rate"),
                    low(interval),
                    high(interval),
                    Cell::number(bin.seeds as f64, 0),
                    Cell::number(bin.steps as f64, 0),
                ]);
            }
        }
    }
    table
}

fn selection(title: &str, chosen: &[Chosen], metric: &str) -> DataTable {
    let name = metric_title(metric);
    let columns = [
        ("arm", "Arm"),
        ("rank", "Rank"),
        ("settings", "Settings"),
        ("seeds", "n"),
        ("mean", name.as_str()),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
    ];
    let mut table = DataTable::new(title, &columns);
    for chosen in chosen {
        for (rank, candidate) in chosen.candidates.iter().enumerate() {
            table.rows.push(vec![
                Cell::text(arm_label(&chosen.place)),
                Cell::number(rank as f64 + 1.0, 0),
                Cell::text(settings_label(&candidate.settings)),
                Cell::number(candidate.sample.n() as f64, 0),
                in_unit(candidate.mean, metric),
                between(candidate.interval, metric),
                low(candidate.interval),
                high(candidate.interval),
            ]);
        }
    }
    table
}

fn errors(title: &str, figure: &ErrorFigure) -> DataTable {
    let columns = [
        ("sigma", "σ"),
        ("exact", "Exact, %"),
        ("seen", "Seen in tests, %"),
        ("published", "Published, %"),
        ("runs", "Runs"),
        ("steps", "Test steps"),
    ];
    let mut table = DataTable::new(title, &columns);
    let percent = |value: f64| Cell::Number { value, shown: shown(value * 100.0, 1) };
    for point in &figure.points {
        let published = figure.published.iter().find(|(sigma, _)| *sigma == point.sigma);
        table.rows.push(vec![
            Cell::Number { value: point.sigma, shown: point.sigma.to_string() },
            percent(point.exact),
            point.seen.map_or_else(|| Cell::Missing("no completed run".to_owned()), percent),
            Cell::published(published.map(|(_, rate)| percent(*rate))),
            Cell::number(point.runs as f64, 0),
            Cell::number(point.steps as f64, 0),
        ]);
    }
    table
}

/// Every published number beside ours.
pub fn reproduction(reproduction: &Reproduction) -> DataTable {
    let columns = [
        ("subject", "Subject"),
        ("agent", "Agent"),
        ("scenario", "Scenario"),
        ("settings", "At"),
        ("published", "Published"),
        ("published_standard_error", "SE"),
        (".published_p", ""),
        ("ours", "Ours"),
        ("our_standard_error", "SE"),
        ("seeds", "n"),
        ("difference", "Ours − published"),
        ("joint_interval", "Joint 95 % interval"),
        (".joint_low", ""),
        (".joint_high", ""),
        ("verdict", "Verdict"),
    ];
    let mut table = DataTable::new("Published numbers beside ours", &columns);
    table.rows = reproduction.comparisons.iter().map(comparison).collect();
    table
}

fn comparison(one: &Comparison) -> Vec<Cell> {
    let settings = one.settings.iter().map(|(name, value)| format!("{name}={value}"));
    let is_rate = one.published.abs() < 1.0;
    let decimals = if is_rate { 4 } else { 1 };
    let interval = one.agreement.as_ref().map(|agreement| agreement.interval).map_err(|e| *e);
    vec![
        Cell::text(one.subject.name()),
        Cell::text(&one.agent),
        Cell::text(&one.scenario),
        Cell::text(settings.collect::<Vec<_>>().join(" ")),
        Cell::number(one.published, decimals),
        Cell::of(one.published_error, decimals),
        one.published_p.map_or_else(|| Cell::Missing("none".to_owned()), |p| Cell::number(p, 5)),
        Cell::of(one.ours, decimals),
        Cell::of(one.our_error, decimals),
        Cell::number(one.seeds as f64, 0),
        Cell::of(one.agreement.as_ref().map(|agreement| agreement.difference), decimals),
        match interval {
            Ok(Interval { low, high }) => {
                Cell::text(format!("{} to {}", shown(low, decimals), shown(high, decimals)))
            }
            Err(reason) => Cell::Missing(reason.to_string()),
        },
        low(interval),
        high(interval),
        Cell::text(match &one.agreement {
            Ok(agreement) => match agreement.verdict {
                Verdict::Inside => "inside".to_owned(),
                Verdict::Outside => "outside".to_owned(),
            },
            Err(reason) => reason.to_string(),
        }),
    ]
}

/// The jobs that failed, with their reasons.
pub fn failures<'j>(experiments: impl Iterator<Item = (&'j str, &'j [JobRecord])>) -> DataTable {
    let columns = [
        ("experiment", "Experiment"),
        ("agent", "Agent"),
        ("scenario", "Scenario"),
        ("sigma", "σ"),
        ("settings", "Settings"),
        ("seed", "Seed"),
        ("kind", "Failure"),
        ("reason", "Reason"),
        ("episode", "After episode"),
        ("job_key", "Job key"),
    ];
    let mut table = DataTable::new("Failed jobs", &columns);
    for (experiment, jobs) in experiments {
        // Sigma has a column of its own.
        let mut told_by = varying(&jobs.iter().collect::<Vec<_>>());
        told_by.retain(|name| name != "environment.sigma");
        for job in jobs {
            table.rows.extend(failed(experiment, job, &told_by));
        }
    }
    table
}

fn failed(experiment: &str, job: &JobRecord, told_by: &[String]) -> Option<Vec<Cell>> {
    let Progress::Failed(failure) = &job.progress else { return None };
    let setting = |name: &String| Some((name.clone(), job.setting(name)?.clone()));
    let settings: Vec<(String, Setting)> = told_by.iter().filter_map(setting).collect();
    let sigma = job.number("environment.sigma").map_or_else(String::new, |s| s.to_string());
    Some(vec![
        Cell::text(experiment),
        Cell::text(&job.agent),
        Cell::text(&job.scenario),
        Cell::text(sigma),
        Cell::text(settings_label(&settings)),
        Cell::number(job.seed as f64, 0),
        Cell::text(failure.kind.name()),
        Cell::text(&failure.message),
        Cell::number(f64::from(failure.episode), 0),
        Cell::text(job.job_key.to_string()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::declared::{ArmId, BinShares, LearningLine};
    use crate::analyse::{Contrast, Sample};

    fn name() -> ArmId {
        ArmId { agent: "dqn".into(), scenario: "P-H-D".into(), settings: Vec::new() }
    }

    fn row(first: Sample, second: Sample, design: Design) -> ContrastRow {
        ContrastRow {
            sides: ("a".into(), "b".into()),
            name: name(),
            error: None,
            contrast: Contrast::new(&first, &second, design),
            family: String::new(),
            corrected: Err(Undefined::NoSeeds),
            published: None,
            first,
            second,
        }
    }

    fn sample(values: &[(u64, f64)], failed: u32) -> Sample {
        Sample::new(values.iter().copied(), failed, 0).unwrap()
    }

    /// The cell of a column in the first row.
    fn cell<'t>(table: &'t DataTable, name: &str) -> &'t Cell {
        let place = table.columns.iter().position(|column| column.name == name);
        &table.rows[0][place.unwrap()]
    }

    fn is_shown(table: &DataTable, name: &str) -> bool {
        table.shown_columns().any(|place| table.columns[place].name == name)
    }

    fn number(table: &DataTable, name: &str) -> f64 {
        match cell(table, name) {
            Cell::Number { value, .. } => *value,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn means_of_matched_seeds_differ_by_the_difference() {
        // Seeds 2 and 3 are pairs: 30 and 35 in the mean.
        let first = sample(&[(1, 900.0), (2, 20.0), (3, 40.0)], 0);
        let second = sample(&[(2, 25.0), (3, 45.0), (4, 1.0), (5, 2.0)], 0);
        let table = contrast("", &[row(first, second, Design::Matched)], "mean_return");
        assert_eq!([number(&table, "first"), number(&table, "second")], [30.0, 35.0]);
        assert_eq!(number(&table, "difference"), -5.0);
        assert_eq!(cell(&table, "seeds").shown(), "2");
        assert_eq!(cell(&table, "unmatched").shown(), "1, 2");
        assert!(is_shown(&table, "unmatched") && !is_shown(&table, "lost"));
    }

    #[test]
    fn seeds_of_independent_sides_need_no_partner() {
        let first = sample(&[(1, 10.0), (2, 20.0)], 1);
        let second = sample(&[(3, 30.0)], 0);
        let table = contrast("", &[row(first, second, Design::Independent)], "mean_return");
        assert_eq!([number(&table, "first"), number(&table, "second")], [15.0, 30.0]);
        assert!(!is_shown(&table, "unmatched") && is_shown(&table, "lost"));
        assert_eq!(cell(&table, "lost").shown(), "1, 0");
    }

    #[test]
    fn what_few_seeds_detect_stands_beside_what_they_found() {
        let of = |n: u64| {
            let values: Vec<(u64, f64)> = (1..=n).map(|seed| (seed, seed as f64 * 0.01)).collect();
            let (first, second) = (sample(&values, 0), sample(&values, 0));
            contrast("", &[row(first, second, Design::Independent)], "disengagement_rate")
        };
        assert!(is_shown(&of(9), "detectable") && !is_shown(&of(10), "detectable"));
        // The deviation of 1, 2, 3 % is 1 %, and three seeds detect 3.1 deviations.
        assert_eq!(cell(&of(3), "detectable").shown(), "3.1");
        assert!(of(3).markdown().contains("Detectable (80 % power)"));
    }

    #[test]
    fn one_seed_is_too_few_and_equal_seeds_have_no_variance() {
        let learning_of = |n: usize| {
            let line = LearningLine {
                name: name(),
                seeds: (n, 3),
                optimum: None,
                points: vec![(100, 5.0, None)],
            };
            learning("", &[LearningPanel { scenario: "P-H-D".into(), lines: vec![line] }])
        };
        let actions_of = |n: usize| {
            let shares = Some([(0.25, None); 4]);
            let bin = BinShares { low: 0.0, high: 0.1, seeds: n, steps: 9, shares };
            let panel = ActionPanel { name: name(), seeds: (3, 3), bins: vec![bin] };
            actions("", &[panel])
        };
        let few = Undefined::TooFewSeeds { have: 1, need: 2 };
        for (n, reason) in [(1, few), (3, Undefined::NoVariance)] {
            for table in [learning_of(n), actions_of(n)] {
                assert_eq!(*cell(&table, "interval"), Cell::Missing(reason.to_string()));
            }
        }
        // Of three seeds that completed, one has a step in the bin.
        assert_eq!(number(&actions_of(1), "seeds"), 1.0);
    }
}
