//! Published numbers of the arms of an analysis.

use super::arm::ArmId;
use crate::job::{MetricName, Scalar};
use crate::manifest::{Published, PublishedRow};

/// The published numbers of a metric about an agent and a scenario, or about their differences, at the settings of
/// an arm. `value` is that of a parameter in the jobs of the arm; along the parameters `along`, which every
/// number states, all values are numbers of the arm.
pub(super) fn rows<'p>(
    published: Option<&'p Published>,
    metric: MetricName,
    (agent, scenario): (&str, &str),
    arm: &ArmId,
    along: &[&str],
    value: &dyn Fn(&str) -> Option<&'p Scalar>,
) -> Vec<&'p PublishedRow> {
    let is_meant = |row: &&PublishedRow| {
        let names: Vec<String> = row.parameters.iter().map(|(name, _)| name.to_string()).collect();
        let states = |name: &str| names.iter().any(|known| known == name);
        let mut values = names.iter().zip(&row.parameters);
        (row.metric, row.agent.as_str(), row.scenario.as_str()) == (Some(metric), agent, scenario)
            && along.iter().all(|name| states(name))
            && arm.settings.iter().all(|(name, _)| states(name))
            && values.all(|(name, (_, stated))| {
                along.contains(&name.as_str()) || value(name) == Some(stated)
            })
    };
    let rows = published.into_iter().flat_map(|published| &published.rows);
    rows.filter(|row| row.competitor.is_empty()).filter(is_meant).collect()
}
