//! How each kind of finding is drawn: its figures, its table and its caption, a file a kind.

mod action_choice;
mod contrast;
mod curve;
mod heat_map;
mod inference_error;
mod learning_curve;
mod selection;

use super::data_table::{DataTable, shown};
use super::figure::{Looks, Numbers};
use super::scene::Scene;
use super::words::unit_numbers;
use crate::analyse::declared::{ArmId, Content, Finding};

/// A kind of finding, as readers see it.
pub(super) trait Drawn {
    /// Its figures, with the stems of their files, which begin with `stem`.
    fn figures(&self, stem: &str, metric: &str, looks: &Looks) -> Vec<(String, Scene)>;

    /// Whether it is drawn, where there are results.
    fn has_figures(&self) -> bool {
        true
    }

    /// Its numbers.
    fn table(&self, title: &str, metric: &str) -> DataTable;

    /// What is shown, with n and what the intervals are; a sentence without its full stop.
    fn shows(&self, metric: &str) -> String;

    /// The main finding with its test, if there is any; a sentence without its full stop.
    fn finds(&self, metric: &str) -> Option<String>;

    /// What is missing beside jobs, if anything is.
    fn lacks(&self) -> Option<String> {
        None
    }

    /// The arms that its figures draw.
    fn arms(&self) -> Vec<&ArmId> {
        Vec::new()
    }

    /// Labels of the lines that a reader can hide; those of the first panel, which all panels share.
    fn series(&self) -> Vec<String> {
        Vec::new()
    }

    /// Whether it is a table in papers, which readers see at once.
    fn is_table(&self) -> bool {
        false
    }
}

/// The finding as its kind is drawn.
pub(super) fn drawn(content: &Content) -> &dyn Drawn {
    match content {
        Content::Contrast(rows) => rows,
        Content::Curve(figure) => figure,
        Content::LearningCurve(figure) => figure,
        Content::HeatMap(figures) => figures,
        Content::ActionChoice(panels) => panels,
        Content::Selection(rankings) => rankings,
        Content::InferenceError(figure) => figure,
    }
}

/// What a reader sees, in at most three sentences: what is shown, what is found, what is missing.
pub(super) fn caption(finding: &Finding) -> String {
    let drawn = drawn(&finding.content);
    let jobs = finding.jobs;
    let failed =
        if jobs.failed > 0 { format!(", {} of which failed", jobs.failed) } else { String::new() };
    let open = jobs.total() - jobs.completed;
    let open = (open > 0).then(|| format!("{open} of {} jobs{failed}", jobs.total()));
    let missing: Vec<String> = open.into_iter().chain(drawn.lacks()).collect();
    let missing = (!missing.is_empty()).then(|| format!("Missing: {}", missing.join("; ")));
    let sentences = [Some(drawn.shows(finding.metric)), drawn.finds(finding.metric), missing];
    sentences.into_iter().flatten().map(|one| one + ".").collect::<Vec<_>>().join(" ")
}

/// A metric's number with its unit.
fn amount(value: f64, metric: &str) -> String {
    match unit_numbers(metric) {
        (Numbers::Percent, decimals) => format!("{} %", shown(value * 100.0, decimals)),
        (Numbers::Plain, decimals) => shown(value, decimals),
    }
}

#[cfg(test)]
mod tests {
    use std::slice;

    use super::*;
    use crate::analyse::declared::{
        ActionPanel, BinShares, Candidate, ContrastRow, CurveFigure, CurveLine, CurvePoint,
        JobCounts, LearningFigure, LearningLine, LearningPanel, Ranking,
    };
    use crate::analyse::{Contrast, Corrected, Design, Sample, Undefined};
    use crate::manifest::Setting;
    use crate::report::data_table::Entry;

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

    /// The entry of a column in the first row.
    fn entry<'t>(table: &'t DataTable, name: &str) -> &'t Entry {
        let place = table.columns.iter().position(|column| column.name == name);
        &table.rows[0][place.unwrap()]
    }

    fn is_shown(table: &DataTable, name: &str) -> bool {
        table.shown_columns().any(|place| table.columns[place].name == name)
    }

    fn number(table: &DataTable, name: &str) -> f64 {
        match entry(table, name) {
            Entry::Number { value, .. } => *value,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn means_of_matched_seeds_differ_by_the_difference() {
        // Seeds 2 and 3 are pairs: 30 and 35 in the mean.
        let first = sample(&[(1, 900.0), (2, 20.0), (3, 40.0)], 0);
        let second = sample(&[(2, 25.0), (3, 45.0), (4, 1.0), (5, 2.0)], 0);
        let table = vec![row(first, second, Design::Matched)].table("", "mean_return");
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
        let table = vec![row(first, second, Design::Independent)].table("", "mean_return");
        assert_eq!([number(&table, "first"), number(&table, "second")], [15.0, 30.0]);
        assert!(!is_shown(&table, "unmatched") && is_shown(&table, "lost"));
        assert_eq!(entry(&table, "lost").shown(), "1, 0");
    }

    #[test]
    fn what_few_seeds_detect_stands_beside_what_they_found() {
        let of = |n: u64| {
            let values: Vec<(u64, f64)> = (1..=n).map(|seed| (seed, seed as f64 * 0.01)).collect();
            let (first, second) = (sample(&values, 0), sample(&values, 0));
            vec![row(first, second, Design::Independent)].table("", "disengagement_rate")
        };
        assert!(is_shown(&of(9), "detectable") && !is_shown(&of(10), "detectable"));
        // The deviation of 1, 2, 3 % is 1 %, and three seeds detect 3.1 deviations.
        assert_eq!(entry(&of(3), "detectable").shown(), "3.1");
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
            let panels = vec![LearningPanel { scenario: "P-H-D".into(), lines: vec![line] }];
            LearningFigure { window: 1, panels }.table("", "mean_return")
        };
        let actions_of = |n: usize| {
            let shares = Some([(0.25, None); 4]);
            let bin = BinShares { low: 0.0, high: 0.1, seeds: n, steps: 9, shares };
            let panel = ActionPanel { name: name(), seeds: (3, 3), bins: vec![bin] };
            vec![panel].table("", "mean_return")
        };
        let few = Undefined::TooFewSeeds { have: 1, need: 2 };
        for (n, reason) in [(1, few), (3, Undefined::NoVariance)] {
            for table in [learning_of(n), actions_of(n)] {
                assert_eq!(*entry(&table, "interval"), Entry::Missing(reason.to_string()));
            }
        }
        // Of three seeds that completed, one has a step in the bin.
        assert_eq!(number(&actions_of(1), "seeds"), 1.0);
    }

    fn said(content: Content, jobs: JobCounts) -> String {
        let (name, title) = (String::new(), String::new());
        caption(&Finding { name, title, metric: "mean_return", jobs, content })
    }

    const ALL: JobCounts = JobCounts { completed: 4, failed: 0, open: 0 };

    #[test]
    fn the_caption_of_a_contrast_states_n_the_largest_difference_its_test_and_what_is_missing() {
        let of = |p: f64, first: &[(u64, f64)]| ContrastRow {
            corrected: Ok(Corrected { holm: p, benjamini_hochberg: p }),
            ..row(sample(first, 0), sample(&[(1, 1.0), (2, 3.0)], 0), Design::Independent)
        };
        let rows = vec![
            of(0.01, &[(1, 51.0), (2, 53.0)]),
            of(0.2, &[(1, 0.0), (2, 2.0)]),
            row(sample(&[(1, 5.0)], 0), sample(&[], 3), Design::Independent),
        ];
        let jobs = JobCounts { completed: 9, failed: 3, open: 1 };
        assert_eq!(
            said(Content::Contrast(rows), jobs),
            "Differences in mean return, steps walked between a and b with their 95 % intervals, n = \
             2 seeds a side. a is above b in 1 of 2 comparisons, by 50 at most, at dqn P-H-D; 1 \
             differ by more than chance (Welch’s t, Holm-corrected p < 0.05). Missing: 4 of 13 jobs, \
             3 of which failed; 1 of 3 comparisons (no seed completed)."
        );
    }

    #[test]
    fn the_caption_of_a_curve_states_what_is_beyond_chance_alone() {
        let line = |agent: &str, points: &[(f64, f64)]| CurveLine {
            name: ArmId { agent: agent.into(), ..name() },
            points: (1..)
                .map(f64::from)
                .zip(points)
                .map(|(x, (mean, spread))| {
                    let values = [(1, *mean), (2, mean - spread), (3, mean + spread)];
                    CurvePoint { x, parameter: x, sample: sample(&values, 0) }
                })
                .collect(),
            optimum: Vec::new(),
            published: Vec::new(),
        };
        let of = |lines: &[CurveLine]| {
            let axis = "environment.delta_d".to_owned();
            let said = said(Content::Curve(CurveFigure { axis, lines: lines.to_vec() }), ALL);
            let (shown, found) = said.split_once(". ").unwrap();
            assert_eq!(
                shown,
                "Mean and its 95 % interval of mean return, steps walked against delta_d, n = 3 seeds \
                 a point"
            );
            found.to_owned()
        };
        let [falls, noise] = [
            line("a", &[(90.0, 1.0), (50.0, 1.0), (20.0, 1.0)]),
            line("b", &[(90.0, 90.0), (60.0, 90.0), (30.0, 90.0)]),
        ];
        let (falls, noise) = (&falls, &noise);
        assert_eq!(
            of(slice::from_ref(falls)),
            "a P-H-D falls from 90 at delta_d = 1 to 20 at delta_d = 3 (Welch’s t, p < 0.05)."
        );
        assert!(of(slice::from_ref(noise)).contains("no further apart than chance makes them"));
        assert_eq!(
            of(&[falls.clone(), noise.clone()]),
            "a P-H-D and b P-H-D differ at no point by more than chance (Welch’s t, \
             Bonferroni-corrected p < 0.05)."
        );
        let other = line("c", &[(90.0, 1.0), (10.0, 1.0), (20.0, 1.0)]);
        assert!(of(&[falls.clone(), other.clone()]).starts_with(
            "a P-H-D and c P-H-D are furthest apart at delta_d = 2, by 40 (Welch’s t"
        ));
        assert!(
            of(&[falls.clone(), noise.clone(), other]).starts_with("Of 3 lines 2 fall and 0 rise")
        );
    }

    #[test]
    fn the_caption_of_a_search_counts_the_settings_that_have_run() {
        let candidate = |rate: f64, values: &[(u64, f64)]| {
            let sample = sample(values, 0);
            Candidate {
                settings: vec![("agent.learning_rate".to_owned(), Setting::Number(rate))],
                mean: sample.mean(),
                interval: sample.interval(),
                sample,
            }
        };
        let candidates = vec![
            candidate(0.1, &[(1, 90.0), (2, 92.0)]),
            candidate(0.2, &[(1, 50.0), (2, 52.0)]),
            candidate(0.3, &[]),
        ];
        let ranking = Ranking { place: name(), rule: "highest_mean", candidates };
        let said = said(Content::Selection(vec![ranking]), ALL);
        assert!(said.contains("learning_rate=0.1: 91 (best of 2 settings that have run"), "{said}");
    }
}
