//! A race with what its words, its table and its figure need.

use crate::analyse::{Moments, Undefined};
use crate::job::{Measure, Score, short_beside};
use crate::key::{Parameter, Value, printable, shortened};
use crate::manifest::{Manifest, Search};
use crate::plan::{Fate, Race, RaceOutcome, Reference};

/// Values by the index of the seed in the list of seeds.
pub type BySeed = Vec<(usize, f64)>;

/// A race and where it belongs.
pub struct RaceContext<'r> {
    pub race: &'r Race,
    pub manifest: &'r Manifest,
    pub search: &'r Search,
    pub metric: Measure,
    pub references: &'r [Reference],
}

impl RaceContext<'_> {
    /// The arm that has won, its values in the race, and its fresh values.
    pub fn won(&self) -> Option<(usize, Vec<f64>, BySeed)> {
        let RaceOutcome::Won { arm, fresh } = &self.race.outcome else { return None };
        let last = self.race.rungs.last()?;
        let winner = last.entrants.iter().find(|one| one.arm == *arm)?;
        Some((*arm, winner.values.clone(), known(fresh)))
    }

    /// The drawn values of an arm: `learning_rate=0.001 batch=32`.
    pub fn settings(&self, arm: usize) -> String {
        let settings = &self.race.settings[arm];
        let names: Vec<String> = settings.iter().map(|(one, _)| one.to_string()).collect();
        let written = |(name, (_, value)): (&String, &(Parameter, Value))| {
            format!("{}={}", short_beside(name, &names), shortened(&value.to_string()))
        };
        names.iter().zip(settings).map(written).collect::<Vec<_>>().join(" ")
    }

    /// The label of an agent for readers.
    pub fn label(&self, agent: &str) -> String {
        let declared = self.manifest.agents.iter().find(|one| one.name == *agent);
        printable(declared.and_then(|one| one.label.as_deref()).unwrap_or(agent))
    }
}

/// What became of an arm in a rung of this many arms, in words.
pub fn end(fate: Fate, arms: usize) -> String {
    match fate {
        Fate::Undecided => "in the race".to_owned(),
        Fate::GoesOn => "goes on".to_owned(),
        Fate::Won => "has won".to_owned(),
        Fate::Failed => "a job failed".to_owned(),
        Fate::Behind => format!("not among the best of {arms}"),
        Fate::Worse => "worse than the best: the interval excludes 0".to_owned(),
        Fate::NotShownWorse => "behind in the last rung, not shown to be worse".to_owned(),
    }
}

/// The mean of values.
pub fn mean_of(values: &[f64]) -> Result<f64, Undefined> {
    Moments::of(values).map(|moments| moments.mean)
}

/// The values among scores, with the indices of their seeds.
pub fn known(scores: &[Score]) -> BySeed {
    let value = |(seed, score): (usize, &Score)| match score {
        Score::Value(value) => Some((seed, *value)),
        Score::Open | Score::Lost => None,
    };
    scores.iter().enumerate().filter_map(value).collect()
}
