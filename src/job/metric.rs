//! The metrics of runs: one table with the name, meaning and unit of each, and where each occurs.

use std::borrow::Cow;
use std::fmt;

/// The name of a metric, which is declared in the table of this module.
#[derive(Clone, Copy)]
pub struct MetricName {
    declared: &'static Declared,
    /// The number of first episodes that the metric covers; 0 for other metrics.
    episodes: u32,
}

/// The declaration of a metric.
struct Declared {
    /// The name in stores, manifests and files; the beginning of the name for a metric of first episodes.
    name: &'static str,
    /// The title in axes and captions, without unit.
    title: &'static str,
    meaning: &'static str,
    unit: MetricUnit,
    places: &'static [MetricPlace],
}

/// The unit of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MetricUnit {
    /// The unit of the return, which the environment declares.
    Return,
    /// Steps of the simulation.
    Steps,
    /// A share, from 0 to 1; shown in percent.
    Share,
    /// A plain number.
    Plain,
}

/// Where a metric occurs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MetricPlace {
    /// Among the metrics of a run, over its test episodes.
    Test,
    /// In learning curves. A point covers the training episodes since the previous point.
    Curve,
    /// In analyses.
    Analyses,
    /// In analyses of the test episodes of some participants.
    Participants,
}

use MetricPlace::{Analyses, Curve, Participants, Test};

macro_rules! metrics {
    ($($NAME:ident = $name:literal, $title:literal, $unit:ident, $places:expr, $meaning:literal;)+) => {
        $(
            #[doc = concat!("`", $name, "`: ", $meaning, ".")]
            pub const $NAME: MetricName = MetricName {
                declared: &Declared {
                    name: $name,
                    title: $title,
                    meaning: $meaning,
                    unit: MetricUnit::$unit,
                    places: &$places,
                },
                episodes: 0,
            };
        )+

        /// Every metric except those of first episodes, in the order of messages and documentation.
        pub const METRICS: &[MetricName] = &[$($NAME),+];
    };
}

metrics! {
    MEAN_RETURN = "mean_return", "mean return per episode", Return, [Test, Curve, Analyses, Participants],
        "mean undiscounted return";
    SD_RETURN = "sd_return", "standard deviation of the return", Return, [Test],
        "standard deviation of the return (n - 1); absent for one episode";
    NET_RETURN = "mean_net_return", "mean return minus the cost of messages", Return, [Test, Analyses],
        "mean undiscounted return minus the cost of messages; absent if messages cost nothing";
    LOWER_QUARTILE_RETURN = "lower_quartile_return", "lower-quartile return", Return, [Analyses, Participants],
        "lower quartile of the return over evaluated episodes; computed when it is read, and recorded where episodes are not";
    UPPER_QUARTILE_RETURN = "upper_quartile_return", "upper-quartile return", Return, [Analyses, Participants],
        "upper quartile of the return over evaluated episodes; computed when it is read, and recorded with \
         record_quartiles = \"both\" where episodes are not";
    MEAN_LENGTH = "mean_length", "mean episode length", Steps, [Test, Curve, Analyses, Participants],
        "mean episode length";
    DISENGAGEMENT_RATE = "disengagement_rate", "episodes ended by disengagement", Share,
        [Test, Curve, Analyses, Participants], "share of episodes that ended in disengagement";
    MESSAGE_RATE = "message_rate", "steps with a message", Share, [Test, Analyses],
        "share of steps on which a message was sent";
    MESSAGES = "messages_per_episode", "messages per episode", Plain, [],
        "mean number of messages per test episode; computed when it is read";
    MEAN_LOSS = "mean_loss", "mean loss of the updates", Plain, [Curve],
        "mean loss of the updates; absent if there were none";
    EPSILON = "epsilon", "exploration rate", Plain, [Curve],
        "exploration rate at the last of these episodes (DQN)";
    TERMINATION_RATE = "termination_rate", "episodes that were terminated", Share,
        [Test, Curve, Analyses, Participants],
        "share of episodes that ended in a terminal state; in other families than step_count";
}

/// The metrics that `evaluation.first_episodes` asks for; the number of episodes follows the name.
const FIRST_RETURN: MetricName = MetricName {
    declared: &Declared {
        name: "mean_return_first_",
        title: "mean return of the first",
        meaning: "mean undiscounted return of the first training episodes; of the first test episodes if the \
                  agent does not train",
        unit: MetricUnit::Return,
        places: &[Test, Analyses],
    },
    episodes: 0,
};

/// The metric for the mean undiscounted return of the first `episodes` training episodes; of the first test
/// episodes if the agent does not train.
pub const fn first_return(episodes: u32) -> MetricName {
    MetricName { episodes, ..FIRST_RETURN }
}

/// The quantile of at least one value, in ascending order, by linear interpolation.
pub fn quantile_of_sorted(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let (below, part) = (position.floor(), position - position.floor());
    let low = sorted[below as usize];
    let high = sorted[(below as usize + 1).min(sorted.len() - 1)];
    low + part * (high - low)
}

/// The metrics that occur in a place, except those of first episodes.
pub fn metrics_of(place: MetricPlace) -> impl Iterator<Item = MetricName> + Clone {
    METRICS.iter().copied().filter(move |metric| metric.is_in(place))
}

/// The metrics that occur in a place, of environments in which this metric is the share of terminated episodes.
pub fn metrics_with(
    place: MetricPlace,
    termination: &'static str,
) -> impl Iterator<Item = MetricName> + Clone {
    metrics_of(place).filter(move |metric| {
        ![DISENGAGEMENT_RATE, TERMINATION_RATE].contains(metric) || *metric == termination
    })
}

/// The mean return.
impl Default for MetricName {
    fn default() -> Self {
        MEAN_RETURN
    }
}

impl MetricName {
    /// The metric of this name.
    pub fn named(name: &str) -> Option<MetricName> {
        let listed = METRICS.iter().copied().find(|metric| metric.declared.name == name);
        listed.or_else(|| {
            let episodes = name.strip_prefix(FIRST_RETURN.declared.name)?.parse().ok()?;
            let metric = first_return(episodes);
            (episodes > 0 && metric.text() == name).then_some(metric)
        })
    }

    /// The name in stores, manifests and files.
    pub fn text(self) -> Cow<'static, str> {
        match self.episodes {
            0 => self.declared.name.into(),
            episodes => format!("{}{episodes}", self.declared.name).into(),
        }
    }

    /// What the metric measures, as a sentence fragment.
    pub fn meaning(self) -> &'static str {
        self.declared.meaning
    }

    /// The share of evaluated episodes with a lower return, if it is a quantile of the return.
    pub fn quantile(self) -> Option<f64> {
        let quantiles = [(LOWER_QUARTILE_RETURN, 0.25), (UPPER_QUARTILE_RETURN, 0.75)];
        quantiles.into_iter().find(|(metric, _)| *metric == self).map(|(_, share)| share)
    }

    /// Its unit.
    pub fn unit(self) -> MetricUnit {
        self.declared.unit
    }

    /// Whether it occurs in a place.
    pub fn is_in(self, place: MetricPlace) -> bool {
        self.declared.places.contains(&place)
    }

    /// The number of first episodes that it covers; `None` for other metrics.
    pub fn first_episodes(self) -> Option<u32> {
        (self.episodes > 0).then_some(self.episodes)
    }

    /// The metric where returns have this unit.
    pub const fn in_unit(self, return_unit: &'static str) -> Measure {
        Measure { metric: self, return_unit }
    }
}

impl PartialEq for MetricName {
    fn eq(&self, other: &MetricName) -> bool {
        (self.declared.name, self.episodes) == (other.declared.name, other.episodes)
    }
}

impl Eq for MetricName {}

impl PartialEq<str> for MetricName {
    fn eq(&self, name: &str) -> bool {
        *self.text() == *name
    }
}

impl PartialEq<&str> for MetricName {
    fn eq(&self, name: &&str) -> bool {
        *self == **name
    }
}

impl fmt::Debug for MetricName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

impl fmt::Display for MetricName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text())
    }
}

/// A metric with the unit of returns, as tables, axes and captions show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measure {
    /// The metric.
    pub metric: MetricName,
    return_unit: &'static str,
}

impl Measure {
    /// The title without unit.
    pub fn quantity(self) -> String {
        match self.metric.first_episodes() {
            None => self.metric.declared.title.to_owned(),
            Some(1) => "return of the first episode".to_owned(),
            Some(episodes) => format!("{} {episodes} episodes", self.metric.declared.title),
        }
    }

    /// The word for its unit; `None` for a plain number.
    pub fn unit_word(self) -> Option<&'static str> {
        match self.metric.unit() {
            MetricUnit::Return => Some(self.return_unit),
            MetricUnit::Steps => Some("steps"),
            MetricUnit::Share => Some("%"),
            MetricUnit::Plain => None,
        }
    }

    /// The title with its unit.
    pub fn title(self) -> String {
        let unit = self.unit_word().map(|unit| format!(", {unit}"));
        self.quantity() + &unit.unwrap_or_default()
    }
}

impl From<MetricName> for MetricUnit {
    fn from(metric: MetricName) -> MetricUnit {
        metric.unit()
    }
}

impl From<Measure> for MetricUnit {
    fn from(measure: Measure) -> MetricUnit {
        measure.metric.unit()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_found_and_names_of_first_episodes_have_one_spelling() {
        for metric in METRICS {
            assert_eq!(MetricName::named(&metric.text()), Some(*metric));
            assert!(!metric.meaning().is_empty());
        }
        assert_eq!(first_return(140), "mean_return_first_140");
        assert_eq!(MetricName::named("mean_return_first_140"), Some(first_return(140)));
        for name in ["mean_return_first_", "mean_return_first_0", "mean_return_first_07", "returns"]
        {
            assert_eq!(MetricName::named(name), None, "{name}");
        }
    }

    #[test]
    fn a_title_ends_with_the_unit_of_the_environment() {
        assert_eq!(MEAN_RETURN.in_unit("points").title(), "mean return per episode, points");
        assert_eq!(
            first_return(1).in_unit("points").title(),
            "return of the first episode, points"
        );
        let first = first_return(20).in_unit("points").title();
        assert_eq!(first, "mean return of the first 20 episodes, points");
        assert_eq!(MESSAGE_RATE.in_unit("points").title(), "steps with a message, %");
        assert_eq!(EPSILON.in_unit("points").title(), "exploration rate");
    }
}
