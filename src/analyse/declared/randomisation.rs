//! Whether the actions of a recorded trial were drawn with the recorded probabilities.

use statrs::function::gamma::gamma_ur;

use super::arm::{ArmId, arms};
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
    /// What decisions are grouped by.
    pub by: String,
    /// The groups with their shares.
    pub points: Vec<DrawnPoint>,
    /// The number of groups.
    pub groups: usize,
    /// The number of decisions.
    pub decisions: u64,
    /// The share of decisions with an action above 0, and the mean probability.
    pub share: f64,
    /// See `share`.
    pub expected: f64,
    /// The sum of squared standardised differences, chi-squared with as many degrees of freedom as groups with chance.
    pub chi_squared: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// The probability of a larger sum; `None` if every action was certain.
    pub p: Option<f64>,
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
    /// The share of actions above 0, less the mean probability.
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
            return RandomisationFigure {
                name: Some(arm.name.clone()),
                tests: drawn.groupings.iter().map(test).collect(),
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
/// groups are independent, because every action is drawn anew.
fn test(grouping: &Grouping) -> RandomisationTest {
    let groups = &grouping.groups;
    let standardised = |group: &DrawnGroup| {
        (group.variance > 0.0)
            .then(|| (group.taken as f64 - group.expected) / group.variance.sqrt())
    };
    let with_chance: Vec<(&DrawnGroup, f64)> =
        groups.iter().filter_map(|group| Some((group, standardised(group)?))).collect();
    let chi_squared = with_chance.iter().map(|(_, z)| z * z).sum::<f64>();
    let degrees_of_freedom = with_chance.len();
    let p = match degrees_of_freedom {
        0 => None,
        df => Some(gamma_ur(df as f64 / 2.0, chi_squared / 2.0)),
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
        by: grouping.by.clone(),
        points: groups.iter().take(MOST_DRAWN).map(point).collect(),
        groups: groups.len(),
        decisions,
        share: sum(|group| group.taken as f64) / decisions as f64,
        expected: sum(|group| group.expected) / decisions as f64,
        chi_squared,
        degrees_of_freedom,
        p,
        furthest: furthest.map(|(group, z)| (group.name.clone(), *z)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(name: &str, decisions: u64, taken: u64, p: f64) -> DrawnGroup {
        let n = decisions as f64;
        let (expected, variance) = (n * p, n * p * (1.0 - p));
        DrawnGroup { name: name.to_owned(), decisions, taken, expected, variance }
    }

    #[test]
    fn shares_are_tested_against_their_probabilities() {
        let groups = vec![group("1", 100, 60, 0.5), group("2", 50, 40, 0.8), group("3", 4, 4, 1.0)];
        let test = test(&Grouping { by: "person".to_owned(), groups });
        // (60 - 50)^2 / 25 = 4; certain actions say nothing.
        assert!((test.chi_squared - 4.0).abs() < 1e-12 && test.degrees_of_freedom == 2);
        // scipy.stats.chi2.sf(4, 2)
        assert!((test.p.unwrap() - 0.135_335_283_236_612_7).abs() < 1e-12);
        assert_eq!(test.furthest, Some(("1".to_owned(), 2.0)));
        assert_eq!((test.decisions, test.share), (154, 104.0 / 154.0));
        assert!((test.points[0].difference - 0.1).abs() < 1e-12);
        assert!((test.points[0].deviation - 0.05).abs() < 1e-12);
    }

    #[test]
    fn one_group_has_a_normal_test_and_certain_actions_none() {
        let all = |groups| test(&Grouping { by: "all".to_owned(), groups });
        // scipy.stats.norm.sf(2) * 2
        let p = all(vec![group("all", 100, 60, 0.5)]).p.unwrap();
        assert!((p - 0.045_500_263_896_358_42).abs() < 1e-12, "{p}");
        assert_eq!(all(vec![group("all", 3, 3, 1.0)]).p, None);
    }
}
