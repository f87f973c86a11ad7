//! A search: what `[search]` declares.

use serde_json::{Value as Json, json};

use crate::job::MetricName;
use crate::job::metric::MEAN_RETURN;
use crate::key::{Kind, Value};
use crate::manifest::search::keys::{Fresh, KEEP, LEVEL, Leaving, RacedMetric, Rungs};
use crate::manifest::table::{Fields, fields, table_schema};

fields! {
    /// A search: settings are drawn, and a race over seeds finds the best.
    pub struct Search {
        /// number of settings that are drawn for each agent with draws
        samples: usize, in Kind::Integer { min: 2, max: 10_000 }, missing "write samples = 32";
        /// seed of the points at which settings are drawn; 1 by default
        seed: u64 = 1, in Kind::Integer { min: 0, max: i64::MAX as u64 };
        /// seeds per arm at the end of each rung, ascending
        rungs: Vec<usize> as Rungs, missing "write rungs = [2, 4, 8]";
        /// which arms leave at the end of a rung
        leaving: Leaving;
        /// seeds that the race does not use, on which winners are tested: a count (10 by default) or a list
        fresh: Fresh = Fresh::Count(10);
        /// the metric of the race; mean_return by default
        metric: MetricName as RacedMetric = MEAN_RETURN;
    }
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
        let rung = self.rungs.iter().position(|seeds| seed <= *seeds as u64);
        // A list of fresh seeds may have 0, which is before the seeds of the race.
        rung.filter(|_| seed > 0).unwrap_or(self.rungs.len())
    }

    /// The number of fresh seeds.
    pub fn fresh_count(&self) -> usize {
        match &self.fresh {
            Fresh::Count(count) => *count as usize,
            Fresh::Seeds(seeds) => seeds.len(),
        }
    }

    /// The seeds of the manifest: of the race, then fresh.
    pub(in crate::manifest) fn seeds(&self) -> Vec<Value> {
        let raced = self.race_seeds() as u64;
        let fresh: Vec<u64> = match &self.fresh {
            Fresh::Count(count) => (raced + 1..=raced + count).collect(),
            Fresh::Seeds(seeds) => seeds.clone(),
        };
        (1..=raced).chain(fresh).map(Value::Integer).collect()
    }
}

/// The JSON Schema of `[search]`.
pub(in crate::manifest) fn schema() -> Json {
    let mut schema = table_schema(&Search::keys());
    schema["oneOf"] = json!([{ "required": [KEEP.name] }, { "required": [LEVEL.name] }]);
    schema
}

/// The key that says when arms leave in another way than this key of `[search]`; the two exclude each other.
pub(in crate::manifest) fn other_way(section: &str, key: &str) -> Option<&'static str> {
    let [keep, level] = [KEEP.name, LEVEL.name];
    match section {
        "search" if key == keep => Some(level),
        "search" if key == level => Some(keep),
        _ => None,
    }
}
