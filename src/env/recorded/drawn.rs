//! Counts of actions beside their probabilities, as a store keeps them.

use serde::{Deserialize, Serialize};

/// Counts of the available decisions whose action and probability are known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Randomisation {
    /// The counts by what decisions are grouped by, all decisions first.
    pub groupings: Vec<Grouping>,
    /// Numbers of decisions and people that bear on the randomisation, each with what it counts.
    pub counts: Vec<(String, u64)>,
}

/// Counts of decisions in groups.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grouping {
    /// What decisions are grouped by.
    pub by: String,
    /// The action that is counted; any above 0 without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<usize>,
    /// The groups, in their order.
    pub groups: Vec<DrawnGroup>,
}

/// Decisions that are alike.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DrawnGroup {
    /// What they have in common.
    pub name: String,
    /// Their number.
    pub decisions: u64,
    /// The number of counted actions.
    pub taken: u64,
    /// The sum of their probabilities p.
    pub expected: f64,
    /// The sum of p (1 - p).
    pub variance: f64,
    /// The sum of the fourth cumulants p (1 - p) (1 - 6 p (1 - p)); stores of earlier releases do not have it.
    #[serde(default)]
    pub fourth_cumulant: f64,
}
