//! Titles, units and number formats of metrics.

use crate::job::first_episodes;

/// The format of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Numbers {
    /// Unchanged.
    Plain,
    /// As a percentage.
    Percent,
}

/// The title of a metric in axes and captions, with its unit.
pub fn metric_title(metric: &str) -> String {
    match metric {
        "mean_return" => "mean return per episode, steps walked".to_owned(),
        "mean_net_return" => "mean return minus the cost of messages, steps walked".to_owned(),
        "lower_quartile_return" => "lower-quartile return, steps walked".to_owned(),
        "mean_length" => "mean episode length, steps".to_owned(),
        "disengagement_rate" => "episodes ended by disengagement, %".to_owned(),
        "message_rate" => "steps with a message, %".to_owned(),
        other => match first_episodes(other) {
            Some(1) => "return of the first episode, steps walked".to_owned(),
            Some(episodes) => format!("mean return of the first {episodes} episodes, steps walked"),
            None => other.replace('_', " "),
        },
    }
}

/// The format of a metric's numbers, and their number of decimals.
pub fn unit_numbers(metric: &str) -> (Numbers, usize) {
    match metric {
        "disengagement_rate" | "message_rate" => (Numbers::Percent, 1),
        "mean_length" => (Numbers::Plain, 1),
        _ => (Numbers::Plain, 0),
    }
}
