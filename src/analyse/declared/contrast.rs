//! Differences of means between two sides, at every setting of the other parameters.

use std::collections::BTreeMap;

use super::arm::{ArmId, varying};
use super::curve::ALPHA;
use super::pairs::{Pair, pairs};
use super::published::rows;
use crate::analyse::{
    self, Corrected, Detectable, Sample, SeedPairing, Undefined, correct, detectable,
};
use crate::job::{MetricName, Scalar, short_name};
use crate::manifest::kind::{Contrast, Pairing};
use crate::manifest::{Published, PublishedRow, Sides};
use crate::record::JobRecord;

/// The differences between two sides.
#[derive(Clone, Debug, PartialEq)]
pub struct ContrastFigure {
    /// The labels of the first and second side.
    pub sides: (String, String),
    /// The differences, in the manifest's order.
    pub rows: Vec<ContrastRow>,
}

/// A family of tests, over which p values are corrected.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TestFamily {
    /// The declared name.
    pub name: String,
    /// The number of its tests, those without a p value included.
    pub members: usize,
}

/// A difference at one setting of the other parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct ContrastRow {
    /// The labels of the first and second side.
    pub sides: (String, String),
    /// The agent or scenario that both sides share, and the other settings.
    pub name: ArmId,
    /// Context inference error, if both sides share it.
    pub error: Option<f64>,
    /// The metric of the first side's seeds.
    pub first: Sample,
    /// The metric of the second side's seeds.
    pub second: Sample,
    /// The comparison.
    pub contrast: analyse::Contrast,
    /// The family over which p values are corrected.
    pub family: TestFamily,
    /// P values corrected over the family.
    pub corrected: Result<Corrected, Undefined>,
    /// Published difference and p value.
    pub published: Option<(f64, Option<f64>)>,
}

impl ContrastRow {
    /// Whether seeds of both sides are matched.
    pub fn is_paired(&self) -> bool {
        self.contrast.design == SeedPairing::Matched
    }

    /// Numbers of seeds of each side that have a value but, if seeds are matched, no partner.
    pub fn unmatched(&self) -> (usize, usize) {
        let (first, second) = self.contrast.seeds;
        (self.first.n() - first, self.second.n() - second)
    }

    /// Numbers of seeds of each side that ended without a value.
    pub fn lost(&self) -> (usize, usize) {
        (self.first.lost().ended() as usize, self.second.lost().ended() as usize)
    }

    /// The difference that the row's test detects with high probability at the level that Holm's correction
    /// leaves it if it is the only difference of its family.
    pub fn detectable(&self) -> Result<Detectable, Undefined> {
        let level = ALPHA / self.family.members.max(1) as f64;
        self.contrast.test.map(|test| detectable(&test, level))
    }

    /// The means of the sides over the compared seeds, whose difference is the contrast's difference.
    pub fn means(&self) -> (Result<f64, Undefined>, Result<f64, Undefined>) {
        match self.contrast.design {
            SeedPairing::Independent => (self.first.mean(), self.second.mean()),
            SeedPairing::Matched => {
                let means = self.contrast.means;
                (means.map(|(first, _)| first), means.map(|(_, second)| second))
            }
        }
    }
}

#[cfg(test)]
impl ContrastRow {
    /// The difference between `a` and `b` of an agent `dqn`, without a corrected p value.
    pub fn between(first: Sample, second: Sample, design: SeedPairing) -> ContrastRow {
        let (agent, scenario) = ("dqn".to_owned(), "P".to_owned());
        ContrastRow {
            sides: ("a".to_owned(), "b".to_owned()),
            name: ArmId { agent, scenario, ..ArmId::default() },
            error: None,
            contrast: analyse::Contrast::new(&first, &second, design),
            family: TestFamily::default(),
            corrected: Err(Undefined::TooFewSeeds { have: 1, need: 2 }),
            published: None,
            first,
            second,
        }
    }
}

/// The differences of a contrast.
pub fn figure(
    contrast: &Contrast,
    metric: MetricName,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> ContrastFigure {
    let sides = &contrast.sides;
    let both: Vec<&JobRecord> = jobs
        .iter()
        .filter(|job| sides.first.is_met_by(job) || sides.second.is_met_by(job))
        .copied()
        .collect();
    let by = decided(sides, &both);
    let by: Vec<&str> = by.iter().map(String::as_str).collect();
    let mut rows: Vec<ContrastRow> = pairs(sides, &both, &by)
        .into_iter()
        .map(|pair| row(pair, (contrast, metric), published))
        .collect();
    name_apart(&mut rows);
    ContrastFigure { sides: labels(sides), rows }
}

/// The values of the sides, as texts.
fn words(sides: &Sides) -> (String, String) {
    (sides.first.scalars()[0].to_string(), sides.second.scalars()[0].to_string())
}

/// The labels of the sides: agents, scenarios, or a key with its values.
fn labels(sides: &Sides) -> (String, String) {
    let words = words(sides);
    match sides.key() {
        key if key.is_empty() => words,
        key => {
            let key = short_name(&key);
            (format!("{key}={}", words.0), format!("{key}={}", words.1))
        }
    }
}

/// The parameters that the sides determine: the key of the sides, and the parameters zipped with
/// it, which have a single value on each side and differ between the sides.
fn decided(sides: &Sides, both: &[&JobRecord]) -> Vec<String> {
    let by = sides.key();
    if by.is_empty() {
        return Vec::new();
    }
    let (first, second): (Vec<&JobRecord>, Vec<&JobRecord>) =
        both.iter().partition(|job| sides.first.is_met_by(job));
    let decides = |name: &String| match (only(name, &first), only(name, &second)) {
        (Some(one), Some(other)) => one != other,
        _ => false,
    };
    let mut names: Vec<String> = varying(both).into_iter().filter(decides).collect();
    if !names.contains(&by) {
        names.push(by);
    }
    names
}

/// The value of a parameter that all jobs share; `None` if values differ or a job lacks it.
fn only<'j>(name: &str, jobs: &[&'j JobRecord]) -> Option<&'j Scalar> {
    let value = jobs.first()?.setting(name)?;
    jobs.iter().all(|job| job.setting(name) == Some(value)).then_some(value)
}

/// Removes from the rows' names the settings that all rows share, which distinguish no row.
fn name_apart(rows: &mut [ContrastRow]) {
    let settings = rows.iter().map(|row| &row.name.settings);
    let Some(mut everywhere) = settings.clone().next().cloned() else { return };
    everywhere.retain(|setting| settings.clone().all(|others| others.contains(setting)));
    for row in rows {
        row.name.settings.retain(|setting| !everywhere.contains(setting));
    }
}

/// A difference.
fn row(
    Pair { name, first, second }: Pair<'_>,
    (contrast, metric): (&Contrast, MetricName),
    published: Option<&Published>,
) -> ContrastRow {
    let make_arm = |jobs| super::Arm { name: name.clone(), jobs };
    let (first, second) = (make_arm(first), make_arm(second));
    let error_of = |arm: &super::Arm<'_>| arm.jobs.first()?.context_error;
    let error = error_of(&first).filter(|error| error_of(&second) == Some(*error));
    let published = published_row(published, metric, (&name, &contrast.sides), (&first, &second));
    let (first, second) = (first.sample(metric), second.sample(metric));
    let sides = &contrast.sides;
    let design = match contrast.pairing {
        Pairing::Automatic => SeedPairing::of(&first, &second),
        Pairing::Unpaired => SeedPairing::Independent,
        Pairing::BySeed => SeedPairing::Matched,
    };
    ContrastRow {
        published: published.map(|row| (row.value, row.p)),
        sides: labels(sides),
        error,
        contrast: analyse::Contrast::new(&first, &second, design),
        family: TestFamily { name: contrast.family.0.clone(), members: 0 },
        corrected: Err(Undefined::NoSeeds),
        name,
        first,
        second,
    }
}

/// The published number of a difference between two arms.
fn published_row<'p>(
    published: Option<&'p Published>,
    metric: MetricName,
    (name, sides): (&ArmId, &Sides),
    (first, second): (&super::Arm<'p>, &super::Arm<'p>),
) -> Option<&'p PublishedRow> {
    let words = words(sides);
    let difference = format!("{} - {}", words.0, words.1);
    let value = |parameter: &str| {
        let read_setting = |arm: &super::Arm<'p>| arm.jobs.first()?.setting(parameter);
        read_setting(first).filter(|value| read_setting(second) == Some(*value))
    };
    let ways = [(difference.as_str(), &*name.scenario), (&*name.agent, difference.as_str())];
    let found: Vec<&PublishedRow> =
        ways.into_iter().flat_map(|of| rows(published, metric, of, name, &[], &value)).collect();
    // A number with a p value is that of a test; others may be tiles of a map.
    found.iter().find(|row| row.p.is_some()).or(found.first()).copied()
}

/// Corrects the p values of the rows of all contrasts, family by family.
pub fn correct_families<'r>(rows: impl IntoIterator<Item = &'r mut ContrastRow>) {
    let mut families: BTreeMap<String, Vec<&mut ContrastRow>> = BTreeMap::new();
    for row in rows {
        families.entry(row.family.name.clone()).or_default().push(row);
    }
    for rows in families.into_values() {
        let raw: Vec<_> = rows.iter().map(|row| row.contrast.test.map(|test| test.p)).collect();
        let members = raw.len();
        for (row, corrected) in rows.into_iter().zip(correct(&raw)) {
            row.corrected = corrected;
            row.family.members = members;
        }
    }
}
