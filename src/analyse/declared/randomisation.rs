//! Whether the actions of a recorded trial were drawn with the recorded probabilities.

use statrs::function::gamma::gamma_ur;

use super::arm::{ArmId, arms};
use crate::analyse::{Undefined, correct};
use crate::env::recorded::{DrawnGroup, Grouping, LogDescription};
use crate::record::JobRecord;

/// The groups of a grouping that are drawn, from the first on.
const MOST_DRAWN: usize = 400;

/// The actions of a recorded trial beside their probabilities.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomisationFigure {
    /// The arm; `None` without a completed job.
    pub name: Option<ArmId>,
    /// One test for each grouping, all decisions first.
    pub tests: Vec<RandomisationTest>,
    /// Numbers of decisions and people that bear on the randomisation, each with what it counts.
    pub counts: Vec<(String, u64)>,
    /// What was found in the file that is no fault.
    pub notes: Vec<String>,
    /// Whether people are numbered alone, their names being left in the file.
    pub is_anonymous: bool,
}

/// A test that the actions in groups were drawn with their probabilities.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomisationTest {
    /// What decisions are grouped by, and the action that is counted where it is one alone.
    pub by: String,
    /// Whether every action above 0 is counted.
    pub is_of_all: bool,
    /// Whether decisions are grouped by a number of the state.
    pub is_of_state: bool,
    /// The groups with their shares.
    pub points: Vec<DrawnPoint>,
    /// The number of groups.
    pub groups: usize,
    /// The number of decisions.
    pub decisions: u64,
    /// The share of decisions with a counted action, and the mean probability.
    pub share: f64,
    /// See `share`.
    pub expected: f64,
    /// The sum of squared standardised differences, scaled so that its mean and its variance are those of a chi-squared
    /// distribution.
    pub chi_squared: f64,
    /// The degrees of freedom of this distribution; for groups of many decisions, the number of groups with chance.
    pub degrees_of_freedom: f64,
    /// The probability of a larger sum; `None` if every action was certain.
    pub p: Option<f64>,
    /// The same, corrected for the number of tests (Holm).
    pub corrected: Option<f64>,
    /// The group with the largest standardised difference, and this difference.
    pub furthest: Option<(String, f64)>,
}

/// The decisions of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnPoint {
    /// What they have in common.
    pub name: String,
    /// Their number.
    pub decisions: u64,
    /// The share of counted actions, less the mean probability.
    pub difference: f64,
    /// The standard deviation of this difference if actions were drawn as recorded.
    pub deviation: f64,
}

/// The check of the first completed job.
pub fn figure(jobs: &[&JobRecord]) -> RandomisationFigure {
    let none = RandomisationFigure {
        name: None,
        tests: Vec::new(),
        counts: Vec::new(),
        notes: Vec::new(),
        is_anonymous: true,
    };
    let description = |job: &JobRecord| -> Option<LogDescription> {
        serde_json::from_str(job.completed()?.description.as_deref()?).ok()
    };
    for arm in arms(jobs, &[]) {
        if let Some(description) = arm.jobs.iter().find_map(|job| description(job)) {
            let drawn = description.randomisation;
            let of_state = |grouping: &Grouping| RandomisationTest {
                is_of_state: description.state.contains(&grouping.by),
                ..test(grouping)
            };
            return RandomisationFigure {
                name: Some(arm.name.clone()),
                tests: together(drawn.groupings.iter().map(of_state).collect()),
                counts: drawn.counts,
                notes: description.notes,
                is_anonymous: description.identifiers.is_none(),
            };
        }
    }
    none
}

/// The test of a grouping.
///
/// Given the recorded probabilities p, the number of actions in a group has the mean Σ p and the variance Σ p (1 − p), and
/// groups are independent, because every action is drawn anew. A squared standardised difference has the mean 1 and the
/// variance 2 + κ, with κ the excess kurtosis of the number of actions: its fourth cumulant, divided by the square of its
/// variance. The sum over groups has a scaled chi-squared distribution with this mean and variance.
///
/// **Source**: Satterthwaite, "An approximate distribution of estimates of variance components", 1946.
fn test(grouping: &Grouping) -> RandomisationTest {
    let groups = &grouping.groups;
    let standardised = |group: &DrawnGroup| {
        (group.variance > 0.0)
            .then(|| (group.taken as f64 - group.expected) / group.variance.sqrt())
    };
    let with_chance: Vec<(&DrawnGroup, f64)> =
        groups.iter().filter_map(|group| Some((group, standardised(group)?))).collect();
    let mean = with_chance.len() as f64;
    let kurtosis = |group: &DrawnGroup| group.fourth_cumulant / (group.variance * group.variance);
    let variance = with_chance.iter().map(|(group, _)| 2.0 + kurtosis(group)).sum::<f64>();
    // Where every sum is the same, as of single draws with probability 0.5, it says nothing.
    let is_constant = variance <= 1e-9 * mean;
    let scale = if is_constant { 1.0 } else { variance / (2.0 * mean) };
    let chi_squared = with_chance.iter().map(|(_, z)| z * z).sum::<f64>() / scale;
    let degrees_of_freedom = mean / scale;
    let p = match with_chance.is_empty() {
        true => None,
        // The gamma function is not defined at 0.
        false if is_constant || chi_squared <= 0.0 => Some(1.0),
        false => Some(gamma_ur(degrees_of_freedom / 2.0, chi_squared / 2.0)),
    };
    let furthest = with_chance.iter().max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()));
    let sum = |number: fn(&DrawnGroup) -> f64| groups.iter().map(number).sum::<f64>();
    let decisions = groups.iter().map(|group| group.decisions).sum::<u64>();
    let point = |group: &DrawnGroup| DrawnPoint {
        name: group.name.clone(),
        decisions: group.decisions,
        difference: (group.taken as f64 - group.expected) / group.decisions as f64,
        deviation: group.variance.sqrt() / group.decisions as f64,
    };
    RandomisationTest {
        by: match grouping.action {
            None => grouping.by.clone(),
            Some(action) if groups.len() == 1 => format!("action {action}"),
            Some(action) => format!("{}, action {action}", grouping.by),
        },
        is_of_all: grouping.action.is_none(),
        is_of_state: false,
        points: groups.iter().take(MOST_DRAWN).map(point).collect(),
        groups: groups.len(),
        decisions,
        share: sum(|group| group.taken as f64) / decisions as f64,
        expected: sum(|group| group.expected) / decisions as f64,
        chi_squared,
        degrees_of_freedom,
        p,
        corrected: None,
        furthest: furthest.map(|(group, z)| (group.name.clone(), *z)),
    }
}

/// The tests with their p values corrected together.
fn together(mut tests: Vec<RandomisationTest>) -> Vec<RandomisationTest> {
    let family: Vec<Result<f64, Undefined>> =
        tests.iter().filter_map(|one| one.p.map(Ok)).collect();
    let with_p = tests.iter_mut().filter(|one| one.p.is_some());
    for (test, corrected) in with_p.zip(correct(&family)) {
        test.corrected = corrected.ok().map(|of| of.holm);
    }
    tests
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(name: &str, decisions: u64, taken: u64, p: f64) -> DrawnGroup {
        let n = decisions as f64;
        let (expected, variance) = (n * p, n * p * (1.0 - p));
        let fourth_cumulant = variance * (1.0 - 6.0 * p * (1.0 - p));
        DrawnGroup { name: name.to_owned(), decisions, taken, expected, variance, fourth_cumulant }
    }

    #[test]
    fn shares_are_tested_against_their_probabilities() {
        let groups = vec![group("1", 100, 60, 0.5), group("2", 50, 40, 0.8), group("3", 4, 4, 1.0)];
        let test = test(&Grouping { by: "person".to_owned(), action: None, groups });
        // (60 - 50)^2 / 25 = 4; certain actions say nothing.
        // Their excess kurtosis is -0.5 / 25 = -0.02, and 0.04 / 8 = 0.005: the variance is 3.985, and not 4.
        let scale = 3.985 / 4.0;
        assert!((test.chi_squared - 4.0 / scale).abs() < 1e-12);
        assert!((test.degrees_of_freedom - 2.0 / scale).abs() < 1e-12);
        // The upper incomplete gamma function by its series.
        assert!((test.p.unwrap() - 0.135_147_676_634_349_87).abs() < 1e-9);
        assert_eq!(test.furthest, Some(("1".to_owned(), 2.0)));
        assert_eq!((test.decisions, test.share), (154, 104.0 / 154.0));
        assert!((test.points[0].difference - 0.1).abs() < 1e-12);
        assert!((test.points[0].deviation - 0.05).abs() < 1e-12);
    }

    #[test]
    fn one_group_has_a_normal_test_and_certain_actions_none() {
        let all = |groups| test(&Grouping { by: "all".to_owned(), action: None, groups });
        // That of a normal distribution is 0.0455; fifty draws vary a little less.
        let p = all(vec![group("all", 100, 60, 0.5)]).p.unwrap();
        assert!((p - 0.045_095_954_509_227_73).abs() < 1e-9, "{p}");
        assert_eq!(all(vec![group("all", 3, 3, 1.0)]).p, None);
        assert_eq!(all(vec![group("all", 100, 50, 0.5)]).p, Some(1.0));
        // A single draw with probability 0.5 has the square 1, whatever it is.
        assert_eq!(all(vec![group("1", 1, 1, 0.5), group("2", 1, 0, 0.5)]).p, Some(1.0));
    }

    /// The exact probability that this number of groups, of 3 decisions with probability 0.05 each, has a p value of at
    /// most `level`: over the numbers of groups with 0, 1, 2 and 3 actions.
    fn level(groups: u64, level: f64) -> f64 {
        let chances = [0.857_375, 0.135_375, 0.007_125, 0.000_125_f64];
        let ln_factorial = |n: u64| (1..=n).map(|k| (k as f64).ln()).sum::<f64>();
        let mut reached = 0.0;
        for one in 0..=groups {
            for two in 0..=groups - one {
                for three in 0..=groups - one - two {
                    let counts = [groups - one - two - three, one, two, three];
                    let ways = ln_factorial(groups)
                        - counts.iter().map(|count| ln_factorial(*count)).sum::<f64>();
                    let pairs = counts.iter().zip(chances);
                    let chance = ways + pairs.map(|(n, p)| *n as f64 * p.ln()).sum::<f64>();
                    let of = |taken: usize| {
                        (0..counts[taken]).map(move |_| group("", 3, taken as u64, 0.05))
                    };
                    let groups = (0..4).flat_map(of).collect();
                    let test = test(&Grouping { by: "person".to_owned(), action: None, groups });
                    reached += if test.p.unwrap() <= level { chance.exp() } else { 0.0 };
                }
            }
        }
        reached
    }

    #[test]
    fn tests_of_small_groups_keep_their_level() {
        // Chi-squared with 20 degrees of freedom would reach 0.167 and 0.075.
        for (wanted, expected) in [(0.05, 0.0435), (0.01, 0.0102)] {
            let reached = level(20, wanted);
            assert!((reached - expected).abs() < 1e-4, "{wanted}: {reached}");
        }
    }

    #[test]
    fn the_tests_of_a_trial_are_corrected_together() {
        let all = |taken: u64| {
            test(&Grouping {
                by: "all".to_owned(),
                action: None,
                groups: vec![group("all", 100, taken, 0.5)],
            })
        };
        let certain = test(&Grouping {
            by: "all".to_owned(),
            action: None,
            groups: vec![group("all", 3, 3, 1.0)],
        });
        let tests = together(vec![all(60), certain, all(50)]);
        let corrected: Vec<Option<f64>> = tests.iter().map(|one| one.corrected).collect();
        assert_eq!(corrected, [tests[0].p.map(|p| 2.0 * p), None, Some(1.0)]);
    }
}
