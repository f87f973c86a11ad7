//! The presentation of each kind of finding: its figures, table and caption, with one file per kind.

mod action_choice;
mod contrast;
mod curve;
mod days;
mod effects;
mod forest;
mod heat_map;
mod inference_error;
mod learned;
mod learning_curve;
pub(super) mod operating;
mod randomisation;
mod recovery;
mod replay;
mod shrinkage;

use super::data_table::{DataTable, p_value, shown, shown_ends, signed};
use super::figure::{Looks, NumberFormat, Panels, Style};
use super::names::Names;
use super::scene::Scene;
use super::words::unit_numbers;
use crate::analyse::declared::{ArmId, Finding, FindingContent};
use crate::analyse::{Interval, SeedPairing};
use crate::job::{
    CONSTANT, GROSS_REWARD, Measure, MetricUnit, REWARD, Scalar, VALUE_TERMS, counted,
};
use crate::report::symbols;

/// Inputs that all figures of a finding share.
pub(super) struct Sheet<'s> {
    /// The beginning of the stems of their files.
    pub stem: &'s str,
    pub metric: Measure,
    pub names: &'s Names,
    pub looks: &'s Looks,
    pub style: &'s Style,
}

impl Sheet<'_> {
    /// Scenes with the stems of their files, which are numbered if there are several.
    fn numbered(&self, scenes: Vec<Scene>) -> Vec<(String, Scene)> {
        let is_single = scenes.len() == 1;
        let stem = |index: usize| match is_single {
            true => self.stem.to_owned(),
            false => format!("{}-{}", self.stem, index + 1),
        };
        scenes.into_iter().enumerate().map(|(index, scene)| (stem(index), scene)).collect()
    }
}

/// The presentation of a kind of finding.
pub(super) trait Drawn {
    /// Its figures, with the stems of their files, in a layout that [`Style::set`] scales.
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)>;

    /// The figures that its panels make together: a stem, and how many of the next panels it has. `panels` is the
    /// number of all panels.
    fn wholes(&self, sheet: &Sheet<'_>, panels: usize) -> Vec<(String, usize)> {
        vec![(sheet.stem.to_owned(), panels)]
    }

    /// The panels that its arms are split into if none is declared; `None` if the kind does not
    /// draw arms together.
    fn split(&self) -> Option<Panels> {
        None
    }

    /// Whether it has figures if there are results.
    fn has_figures(&self) -> bool {
        true
    }

    /// Its numbers.
    fn table(&self, title: &str, metric: Measure, names: &Names) -> DataTable;

    /// The content, with n and the kind of intervals; a sentence without its full stop.
    fn shows(&self, metric: Measure, names: &Names) -> String;

    /// The main finding with its test, if there is one; a sentence without its full stop.
    fn finds(&self, metric: Measure, names: &Names) -> Option<String>;

    /// The missing data other than jobs, if any.
    fn lacks(&self) -> Option<String> {
        None
    }

    /// The arms that its figures draw.
    fn arms(&self) -> Vec<&ArmId> {
        Vec::new()
    }

    /// Whether papers present it as a table. The page then shows the table open.
    fn is_table(&self) -> bool {
        false
    }
}

/// The presentation of a finding.
pub(super) fn drawn(content: &FindingContent) -> &dyn Drawn {
    match content {
        FindingContent::Contrast(figure) => figure,
        FindingContent::Curve(figure) => figure,
        FindingContent::Days(figure) => figure,
        FindingContent::LearningCurve(figure) => figure,
        FindingContent::HeatMap(figures) => figures,
        FindingContent::ActionChoice(panels) => panels,
        FindingContent::Recovery(rows) => rows,
        FindingContent::Operating(figure) => figure,
        FindingContent::Learned(figure) => figure,
        FindingContent::Shrinkage(figure) => figure,
        FindingContent::Randomisation(figure) => figure,
        FindingContent::Effects(figure) => figure,
        FindingContent::Replay(figure) => figure,
        FindingContent::InferenceError(figure) => figure,
    }
}

/// The caption of a finding, in at most three sentences: content, main result, missing data.
pub(super) fn caption(finding: &Finding, names: &Names) -> String {
    let drawn = drawn(&finding.content);
    let jobs = finding.jobs;
    let failed =
        if jobs.failed > 0 { format!(", {} of which failed", jobs.failed) } else { String::new() };
    let open = jobs.total() - jobs.completed;
    let open = (open > 0).then(|| format!("{open} of {}{failed}", counted(jobs.total(), "job")));
    let missing: Vec<String> = open.into_iter().chain(drawn.lacks()).collect();
    let missing = (!missing.is_empty()).then(|| format!("Missing: {}", missing.join("; ")));
    let shown = drawn.shows(finding.metric, names) + &among(finding);
    let sentences = [Some(shown), drawn.finds(finding.metric, names), missing];
    sentences.into_iter().flatten().map(|one| one + ".").collect::<Vec<_>>().join(" ")
}

/// The table of a finding.
pub(super) fn table(finding: &Finding, names: &Names) -> DataTable {
    let mut table = drawn(&finding.content).table(&finding.title, finding.metric, names);
    table.caption += &among(finding);
    table
}

/// The participants to whom an analysis is restricted, as the end of a caption.
fn among(finding: &Finding) -> String {
    let among = finding.participants.map(|range| {
        let symbol = symbols::key(range.parameter);
        format!(", among {range}").replace(range.parameter, &symbol)
    });
    among.unwrap_or_default()
}

/// A metric's number with its unit.
pub(super) fn amount(value: f64, metric: Measure) -> String {
    match unit_numbers(metric) {
        (NumberFormat::Percent, decimals) => format!("{} %", shown(value * 100.0, decimals)),
        (NumberFormat::Plain, decimals) => shown(value, decimals),
    }
}

/// The name of the t tests of these designs; `None` without a test.
pub(super) fn test_name(designs: impl IntoIterator<Item = SeedPairing>) -> Option<&'static str> {
    let (mut paired, mut unpaired) = (false, false);
    for design in designs {
        paired |= design == SeedPairing::Matched;
        unpaired |= design == SeedPairing::Independent;
    }
    match (paired, unpaired) {
        (true, false) => Some("t test paired by seed"),
        (true, true) => Some("t test, paired by seed where both sides share their seeds"),
        (false, true) => Some("unpaired t test"),
        (false, false) => None,
    }
}

/// A difference of a metric with its unit: of rates, percentage points.
pub(super) fn gap(value: f64, metric: Measure) -> String {
    match unit_numbers(metric) {
        (NumberFormat::Percent, decimals) => {
            format!("{} percentage points", shown(value * 100.0, decimals))
        }
        (NumberFormat::Plain, decimals) => shown(value, decimals),
    }
}

/// The ends of an interval of a difference with their unit.
pub(super) fn gap_ends(Interval { low, high }: Interval, metric: Measure) -> String {
    match unit_numbers(metric) {
        (NumberFormat::Percent, decimals) => {
            let ends = shown_ends(low * 100.0, high * 100.0, decimals);
            format!("{} percentage points", ends.join(" to "))
        }
        (NumberFormat::Plain, _) => ends(Interval { low, high }, metric),
    }
}

/// Whether differences of a metric are in percentage points.
pub(super) fn is_rate(metric: Measure) -> bool {
    unit_numbers(metric).0 == NumberFormat::Percent
}

/// The title of a metric in a sentence, its unit in parentheses.
pub(super) fn metric_words(metric: Measure) -> String {
    let unit = metric.unit_word().map(|unit| format!(" ({unit})"));
    metric.quantity() + &unit.unwrap_or_default()
}

/// The title of the differences of a metric, with their unit.
pub(super) fn gap_title(metric: Measure) -> String {
    match is_rate(metric) {
        true => format!("{}, differences in percentage points", metric.quantity()),
        false => metric.title(),
    }
}

/// The ends of a metric's interval with their unit: "5 % to 7 %".
pub(super) fn ends(Interval { low, high }: Interval, unit: impl Into<MetricUnit>) -> String {
    match unit_numbers(unit) {
        (NumberFormat::Percent, decimals) => {
            let [low, high] = shown_ends(low * 100.0, high * 100.0, decimals);
            format!("{low} % to {high} %")
        }
        (NumberFormat::Plain, decimals) => shown_ends(low, high, decimals).join(" to "),
    }
}

/// The end of a tooltip or a clause: ", 95 % interval 5 % to 7 %"; empty without an interval.
pub(super) fn spread<E>(interval: Result<Interval, E>, unit: impl Into<MetricUnit>) -> String {
    let words = interval.map(|interval| format!(", 95 % interval {}", ends(interval, unit)));
    words.unwrap_or_default()
}

/// The unit of an outcome of an estimate.
fn unit_of_outcome(outcome: &str, metric: Measure) -> &str {
    match outcome {
        REWARD | GROSS_REWARD => metric.unit_word().unwrap_or("reward"),
        state => state,
    }
}

/// The end of the unit of a term: " per unit of day" for a moderator, empty for the constant and for values.
fn per_moderator(term: &str) -> String {
    // With several treatments, the name of a term begins with its action.
    match term.rsplit(": ").next().unwrap_or(CONSTANT) {
        CONSTANT => String::new(),
        term if VALUE_TERMS.contains(&term) => String::new(),
        moderator => format!(" per unit of {moderator}"),
    }
}

/// A number of a parameter with its sign: every digit, or an exponent if it is very small or very large.
fn parameter(value: f64) -> String {
    signed(&Scalar::Real(value).to_string())
}

/// A p value with its relation: "= 0.03" or "< 0.001".
fn related(p: f64) -> String {
    let shown = p_value(p);
    match shown.strip_prefix('<') {
        Some(least) => format!("< {}", least.trim_start()),
        None => format!("= {shown}"),
    }
}

#[cfg(test)]
mod tests {
    use std::slice;

    use super::*;
    use crate::analyse::declared::{
        ActionPanel, BinShares, ContrastFigure, ContrastRow, CurveFigure, CurveLine, JobCounts,
        LearningFigure, LearningLine, LearningPanel, LinePoint,
    };
    use crate::analyse::{Corrected, Sample, SeedPairing, Undefined};
    use crate::job::ParticipantRange;
    use crate::job::metric::{DISENGAGEMENT_RATE, MEAN_RETURN};
    use crate::manifest::FigureKeys;
    use crate::report::data_table::TableEntry;
    use crate::report::scene::SceneShape;

    const RETURN: Measure = MEAN_RETURN.in_unit("points");
    const RATE: Measure = DISENGAGEMENT_RATE.in_unit("points");

    fn name() -> ArmId {
        ArmId { agent: "dqn".into(), scenario: "P-H-D".into(), settings: Vec::new() }
    }

    fn contrast(rows: Vec<ContrastRow>) -> ContrastFigure {
        ContrastFigure { sides: rows[0].sides.clone(), rows }
    }

    fn sample(values: &[(u64, f64)], failed: u32) -> Sample {
        Sample::new(values.iter().copied(), failed, 0).unwrap()
    }

    /// The entry of a column in the first row.
    fn entry<'t>(table: &'t DataTable, name: &str) -> &'t TableEntry {
        let index = table.columns.iter().position(|column| column.name == name);
        &table.rows[0][index.unwrap()]
    }

    fn is_shown(table: &DataTable, name: &str) -> bool {
        table.shown_columns().any(|index| table.columns[index].name == name)
    }

    fn number(table: &DataTable, name: &str) -> f64 {
        match entry(table, name) {
            TableEntry::Number { value, .. } => *value,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn means_of_matched_seeds_differ_by_the_difference() {
        // Seeds 2 and 3 are matched, with means of 30 and 35.
        let first = sample(&[(1, 900.0), (2, 20.0), (3, 40.0)], 0);
        let second = sample(&[(2, 25.0), (3, 45.0), (4, 1.0), (5, 2.0)], 0);
        let table = contrast(vec![ContrastRow::between(first, second, SeedPairing::Matched)])
            .table("", RETURN, &Names::default());
        assert_eq!([number(&table, "first"), number(&table, "second")], [30.0, 35.0]);
        assert_eq!(number(&table, "difference"), -5.0);
        assert_eq!(entry(&table, "seeds").shown(), "2");
        assert_eq!(entry(&table, "unmatched").shown(), "1, 2");
        assert!(is_shown(&table, "unmatched") && !is_shown(&table, "lost"));
    }

    #[test]
    fn seeds_of_independent_sides_need_no_partner() {
        let first = sample(&[(1, 10.0), (2, 20.0)], 1);
        let second = sample(&[(3, 30.0)], 0);
        let table = contrast(vec![ContrastRow::between(first, second, SeedPairing::Independent)])
            .table("", RETURN, &Names::default());
        assert_eq!([number(&table, "first"), number(&table, "second")], [15.0, 30.0]);
        assert!(!is_shown(&table, "unmatched") && is_shown(&table, "lost"));
        assert_eq!(entry(&table, "lost").shown(), "1, 0");
    }

    #[test]
    fn what_few_seeds_detect_stands_beside_what_they_found() {
        let draw_table = |n: u64| {
            let values: Vec<(u64, f64)> = (1..=n).map(|seed| (seed, seed as f64 * 0.01)).collect();
            let (first, second) = (sample(&values, 0), sample(&values, 0));
            contrast(vec![ContrastRow::between(first, second, SeedPairing::Independent)]).table(
                "",
                RATE,
                &Names::default(),
            )
        };
        assert!(is_shown(&draw_table(9), "detectable") && !is_shown(&draw_table(10), "detectable"));
        // The standard deviation of 1, 2, 3 % is 1 %; t with 2 degrees of freedom detects 5.65 standard errors.
        assert_eq!(entry(&draw_table(3), "detectable").shown(), "4.6");
        assert!(draw_table(3).markdown().contains("Detectable (80 % power at 0.05)"));
    }

    #[test]
    fn one_seed_is_too_few_and_equal_seeds_have_no_variance() {
        let learning_of = |n: usize| {
            let line = LearningLine {
                name: name(),
                seeds: (n, 3),
                optimum: None,
                end: Sample::default(),
                points: vec![(100, 5.0, None)],
            };
            let panels = vec![LearningPanel { scenario: "P-H-D".into(), lines: vec![line] }];
            LearningFigure { window: 1, panels }.table("", RETURN, &Names::default())
        };
        let actions_of = |n: usize| {
            let shares = Some([(0.25, None); 4]);
            let bin = BinShares { low: 0.0, high: 0.1, seeds: n, steps: 9, shares };
            let panel = ActionPanel { name: name(), seeds: (3, 3), bins: vec![bin] };
            vec![panel].table("", RETURN, &Names::default())
        };
        let few = Undefined::TooFewSeeds { have: 1, need: 2 };
        for (n, reason) in [(1, few), (3, Undefined::NoVariance)] {
            for table in [learning_of(n), actions_of(n)] {
                assert_eq!(*entry(&table, "interval"), TableEntry::Missing(reason.to_string()));
            }
        }
        // One of three completed seeds has a step in the bin.
        assert_eq!(number(&actions_of(1), "seeds"), 1.0);
    }

    fn said(content: FindingContent, jobs: JobCounts) -> String {
        let (name, title) = (String::new(), String::new());
        let metric = RETURN;
        caption(
            &Finding { name, title, metric, participants: None, jobs, content },
            &Names::default(),
        )
    }

    const ALL: JobCounts = JobCounts { completed: 4, failed: 0, open: 0 };

    #[test]
    fn the_caption_of_a_contrast_states_n_the_largest_difference_its_test_and_what_is_missing() {
        let make_row = |p: f64, first: &[(u64, f64)]| ContrastRow {
            corrected: Ok(Corrected { holm: p, benjamini_hochberg: p }),
            ..ContrastRow::between(
                sample(first, 0),
                sample(&[(1, 1.0), (2, 3.0)], 0),
                SeedPairing::Independent,
            )
        };
        let rows = vec![
            make_row(0.01, &[(1, 51.0), (2, 53.0)]),
            make_row(0.2, &[(1, 0.0), (2, 2.0)]),
            ContrastRow::between(sample(&[(1, 5.0)], 0), sample(&[], 3), SeedPairing::Independent),
        ];
        let jobs = JobCounts { completed: 9, failed: 3, open: 1 };
        assert_eq!(
            said(FindingContent::Contrast(contrast(rows)), jobs),
            "Differences in mean return per episode (points) between a and b (unpaired t test) with their 95 % \
             intervals, not corrected for the number of comparisons, n = 1–2 seeds per side. Of 2 tested \
             comparisons, a is significantly above b in 1 and significantly below it in 0; at the widest \
             significant one, a is above b by 50, for dqn P (unpaired t = 35.36, 1 degree of \
             freedom, p = 0.018). Missing: 4 of 13 jobs, 3 of which failed; 1 of 3 comparisons (no seed \
             completed)."
        );
    }

    #[test]
    fn the_caption_of_one_comparison_answers_it_with_its_test() {
        let one = |holm: f64| ContrastRow {
            corrected: Ok(Corrected { holm, benjamini_hochberg: holm }),
            ..ContrastRow::between(
                sample(&[(1, 1.0), (2, 3.0)], 0),
                sample(&[(1, 51.0), (2, 53.5)], 0),
                SeedPairing::Matched,
            )
        };
        let range = ParticipantRange { parameter: "epsilon_d", index: 4, from: 0.8, to: 1.0 };
        let finding = |p| Finding {
            name: String::new(),
            title: String::new(),
            metric: RETURN,
            participants: Some(range),
            jobs: ALL,
            content: FindingContent::Contrast(contrast(vec![one(p)])),
        };
        // Differences -50 and -50.5: mean -50.25, standard error 0.25.
        assert_eq!(
            caption(&finding(0.003_2), &Names::default()),
            "Differences in mean return per episode (points) between a and b (t test paired by seed) with their \
             95 % intervals, not corrected for the number of comparisons, n = 2 seeds per side, among the \
             20 % of participants with the largest ε_d. a is below b by 50, for dqn P: significant \
             (paired t = −201.00, 1 degree of freedom, p = 0.0032)."
        );
        assert!(caption(&finding(0.2), &Names::default()).contains("not significant (paired t"));
        assert_eq!(
            table(&finding(0.2), &Names::default()).caption,
            ": mean return per episode, points; t test paired by seed, among the 20 % of participants with the \
             largest ε_d"
        );
    }

    /// A line with these means and spreads of three seeds.
    fn line(agent: &str, points: &[(f64, f64)]) -> CurveLine {
        CurveLine {
            name: ArmId { agent: agent.into(), ..name() },
            points: (1..)
                .map(f64::from)
                .zip(points)
                .map(|(x, (mean, spread))| {
                    let values = [(1, *mean), (2, mean - spread), (3, mean + spread)];
                    LinePoint { x, parameter: x, sample: sample(&values, 0) }
                })
                .collect(),
            across: None,
            optimum: Vec::new(),
            published: Vec::new(),
        }
    }

    #[test]
    fn the_caption_of_a_curve_states_only_what_is_significant() {
        let describe = |lines: &[CurveLine]| {
            let axis = "environment.delta_d".to_owned();
            let said =
                said(FindingContent::Curve(CurveFigure { axis, lines: lines.to_vec() }), ALL);
            let (shown, found) = said.split_once(". ").unwrap();
            assert_eq!(
                shown,
                "Mean and its 95 % interval of mean return per episode (points) against disengagement decay δ_d, n = 3 seeds \
                 per point"
            );
            found.to_owned()
        };
        let [falls, noise] = [
            line("a", &[(90.0, 1.0), (50.0, 1.0), (20.0, 2.0)]),
            line("b", &[(90.0, 90.0), (60.0, 50.0), (30.0, 9.0)]),
        ];
        let (falls, noise) = (&falls, &noise);
        assert_eq!(
            describe(slice::from_ref(falls)),
            "a P-H-D falls from 90 at δ_d = 1 to 20 at δ_d = 3 (t test paired by seed, p < 0.05)."
        );
        assert_eq!(
            describe(slice::from_ref(noise)),
            "b P-H-D is at 90 at δ_d = 1 and at 30 at δ_d = 3; the difference is not significant \
             (t test paired by seed, p ≥ 0.05)."
        );
        assert_eq!(
            describe(&[falls.clone(), noise.clone()]),
            "a P-H-D and b P-H-D do not differ significantly at any point (t test paired by seed, \
             Bonferroni-corrected p ≥ 0.05)."
        );
        let other = line("c", &[(90.0, 1.0), (10.0, 2.0), (20.0, 2.0)]);
        assert!(describe(&[falls.clone(), other.clone()]).starts_with(
            "a P-H-D and c P-H-D are furthest apart at δ_d = 2, by 40 (t test paired by seed"
        ));
        assert!(
            describe(&[falls.clone(), noise.clone(), other])
                .starts_with("Of 3 lines, 2 fall and 0 rise significantly")
        );
        assert_eq!(
            describe(&[noise.clone(), noise.clone(), noise.clone()]),
            "Of 3 lines, none falls or rises significantly from the first to the last point (t test paired by seed, \
             Bonferroni-corrected p ≥ 0.05)."
        );
        assert!(
            describe(&[falls.clone(), line("d", &[]), line("e", &[(5.0, 1.0)])])
                .starts_with("Of 1 line that can be tested, 1 falls and 0 rise significantly")
        );
    }

    #[test]
    fn an_arm_that_lacks_the_key_of_a_curve_is_compared_at_every_point() {
        let values = |mean: f64| sample(&[(1, mean), (2, mean - 1.0), (3, mean + 1.0)], 0);
        let point = |(x, mean): (f64, f64)| LinePoint { x, parameter: x, sample: values(mean) };
        let swept = CurveLine {
            name: name(),
            points: [(0.001, 20.0), (0.01, 60.0)].map(point).into(),
            across: None,
            optimum: Vec::new(),
            published: Vec::new(),
        };
        let rule = CurveLine {
            name: ArmId { agent: "rule".into(), ..name() },
            points: Vec::new(),
            across: Some(sample(&[(1, 50.0), (2, 48.0), (3, 52.0)], 0)),
            ..swept.clone()
        };
        let figure = CurveFigure { axis: "agent.rate".into(), lines: vec![rule, swept] };
        let table = figure.table("", RETURN, &Names::default());
        assert_eq!(table.rows.len(), 3);
        assert_eq!([entry(&table, "x").shown(), entry(&table, "mean").shown()], ["–", "50.0"]);
        assert_eq!(
            said(FindingContent::Curve(figure.clone()), ALL),
            "Mean and its 95 % interval of mean return per episode (points) against rate, n = 3 seeds per point; \
             arms without rate are lines across. rule P-H-D and dqn P-H-D are furthest apart at rate = \
             0.001, by 30 (t test paired by seed, Bonferroni-corrected p < 0.05)."
        );
        let style = Style::of(&FigureKeys::default());
        let looks = Looks::of(figure.arms());
        let names = &Names::default();
        let sheet = Sheet { stem: "s", metric: RETURN, names, looks: &looks, style: &style };
        let (_, scene) = figure.figures(&sheet).remove(0);
        let line = scene.marks.iter().find_map(|mark| match &mark.shape {
            SceneShape::Line { points, stroke } if mark.series == Some(0) && stroke.width > 1.0 => {
                Some(points.clone())
            }
            _ => None,
        });
        let line = line.unwrap();
        // From the first to the last point of the other line, at one height.
        assert!(line[0].1 == line[1].1 && line[1].0 - line[0].0 > 100.0, "{line:?}");
        let tips = scene.marks.iter().filter_map(|mark| mark.tip.as_ref());
        assert_eq!(tips.filter(|tip| tip.contains("which lacks rate: 50")).count(), 2);
    }
}
