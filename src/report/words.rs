//! Metrics in words, and how their numbers are written.

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Numbers {
    /// As they are.
    Plain,
    /// As per cent.
    Percent,
}

/// A metric as axes and captions call it, with its unit.
pub fn metric_title(metric: &str) -> String {
    match metric {
        "mean_return" => "mean return, steps walked".to_owned(),
        "lower_quartile_return" => "lower-quartile return, steps walked".to_owned(),
        "mean_length" => "mean episode length, steps".to_owned(),
        "disengagement_rate" => "episodes ended by disengagement, %".to_owned(),
        "message_rate" => "steps with a message, %".to_owned(),
        other => other.replace('_', " "),
    }
}

/// How a metric's numbers are written, and with how many decimals.
pub fn unit_numbers(metric: &str) -> (Numbers, usize) {
    match metric {
        "disengagement_rate" | "message_rate" => (Numbers::Percent, 1),
        "mean_length" => (Numbers::Plain, 1),
        _ => (Numbers::Plain, 0),
    }
}
