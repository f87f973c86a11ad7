//! A search: what `[search]` declares.

use std::fmt;

use crate::job::MetricName;
use crate::key::Value;
use crate::manifest::text::written;

/// A search: settings are drawn, and a race over seeds finds the best.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// The number of settings that are drawn for each agent with draws; at least 2.
    pub samples: usize,
    /// The seed of the points at which settings are drawn.
    pub seed: u64,
    /// The seeds of an arm at the end of each rung, ascending; at least one rung.
    pub rungs: Vec<usize>,
    /// Which arms leave at the end of a rung.
    pub leaving: Leaving,
    /// The seeds on which winners and agents without draws are compared; no arm races with them.
    pub fresh: Vec<u64>,
    /// The metric that arms are compared in; the highest is the best.
    pub metric: MetricName,
}

/// Which arms leave a race at the end of a rung.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leaving {
    /// All but this share of the arms, the best.
    Share(f64),
    /// Arms whose paired difference to the best is not 0 with certainty. The level, between 0 and 1, is divided by the
    /// number of comparisons of the race.
    Evidence(f64),
}

impl Search {
    /// The number of seeds of the race, which precede the fresh seeds of the manifest.
    pub fn race_seeds(&self) -> usize {
        self.rungs.last().copied().unwrap_or(0)
    }

    /// The number of comparisons by which the level of a race is divided: of every arm with the best, at every rung.
    ///
    /// With this correction (Bonferroni's), the probability that the truly best arm ever leaves is at most half the level:
    /// it leaves only if, at some rung, another arm leads it with an interval above 0, and each of these events has at
    /// most half the probability that the interval misses its difference.
    pub fn comparisons(&self) -> usize {
        self.rungs.len() * (self.samples - 1)
    }

    /// The rung in which arms get a seed, from 0; fresh seeds come after the last rung.
    pub fn rung_of(&self, seed: u64) -> usize {
        let is_fresh = self.fresh.contains(&seed);
        let rung = self.rungs.iter().position(|seeds| !is_fresh && seed <= *seeds as u64);
        rung.unwrap_or(self.rungs.len())
    }

    /// The seeds of the manifest: of the race, then fresh.
    pub(in crate::manifest) fn seeds(&self) -> Vec<Value> {
        let race = 1..=self.race_seeds() as u64;
        race.chain(self.fresh.iter().copied()).map(Value::Integer).collect()
    }
}

/// Writes the table as a manifest does.
impl fmt::Display for Search {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "samples = {}\nseed = {}", self.samples, self.seed)?;
        writeln!(f, "rungs = {}", written::list(&self.rungs))?;
        match self.leaving {
            Leaving::Share(keep) => writeln!(f, "keep = {keep:?}")?,
            Leaving::Evidence(level) => writeln!(f, "level = {level:?}")?,
        }
        let first = self.race_seeds() as u64 + 1;
        let is_count = self.fresh.iter().copied().eq(first..first + self.fresh.len() as u64);
        match is_count {
            true => writeln!(f, "fresh = {}", self.fresh.len())?,
            false => writeln!(f, "fresh = {}", written::list(&self.fresh))?,
        }
        writeln!(f, "metric = \"{}\"", self.metric)
    }
}
