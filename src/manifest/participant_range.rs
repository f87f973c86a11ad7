//! A subset of the participants of a test: those between two quantiles of a parameter.

use std::fmt;

use serde_json::{Value as Json, json};
use toml::de::DeTable;

use super::fault::Fault;
use super::respelt::respelt;
use super::source::{Located, Span};
use super::sweep::{Node, Reader};
use crate::env::ParticipantSampler;
use crate::key::{Kind, Value};

/// The participants of a job's test whose parameter lies between two of its quantiles.
///
/// The n participants of a job are ranked 0 to n - 1 by the parameter's value, ties by episode. The range
/// has the participants with `from` <= rank / n < `to`. In jobs with equal seeds and populations, the range
/// has the same people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParticipantRange {
    /// The parameter, as `[population]` calls it.
    pub parameter: &'static str,
    /// Its place among the parameters of participants.
    pub place: u8,
    /// The lower end, in [0, 1).
    pub from: f64,
    /// The upper end, in (0, 1].
    pub to: f64,
}

/// Metrics that are known for single test episodes.
pub(super) const METRICS: [&str; 4] =
    ["mean_return", "lower_quartile_return", "mean_length", "disengagement_rate"];

impl ParticipantRange {
    /// Whether the range has the participant of this rank, among `of` participants.
    pub fn contains(&self, rank: usize, of: usize) -> bool {
        let share = rank as f64 / of as f64;
        share >= self.from && (share < self.to || self.to == 1.0)
    }

    /// The range as a manifest writes it.
    pub(super) fn written(&self) -> String {
        let ParticipantRange { parameter, from, to, .. } = self;
        format!("{{ parameter = \"{parameter}\", from_quantile = {from:?}, to_quantile = {to:?} }}")
    }

    pub(super) fn schema() -> Json {
        let names: Vec<&str> = ParticipantSampler::all_names().collect();
        let share = |default: f64| json!({ "type": "number", "minimum": 0, "maximum": 1, "default": default });
        json!({
            "type": "object",
            "additionalProperties": false,
            "required": ["parameter"],
            "properties": {
                "parameter": { "enum": names },
                "from_quantile": share(0.0),
                "to_quantile": share(1.0),
            },
        })
    }
}

impl fmt::Display for ParticipantRange {
    /// Writes the participants in words: "the 20 % of participants with the largest delta_d".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ParticipantRange { parameter, from, to, .. } = self;
        // Percent, rounded to one decimal.
        let percent = |share: f64| (share * 1000.0).round() / 10.0;
        if *to == 1.0 {
            let share = percent(1.0 - from);
            write!(f, "the {share} % of participants with the largest {parameter}")
        } else if *from == 0.0 {
            write!(f, "the {} % of participants with the smallest {parameter}", percent(*to))
        } else {
            let (from, to) = (percent(*from), percent(*to));
            write!(f, "participants between the {from} % and the {to} % quantile of {parameter}")
        }
    }
}

impl Reader<'_> {
    /// Reads the key `participants` of an analysis of `metric`, `None` for a faulty metric; `None` if the key
    /// is absent or faulty.
    pub(super) fn participants(
        &mut self,
        metric: Option<&str>,
        table: &DeTable,
    ) -> Option<Located<ParticipantRange>> {
        const KEYS: [&str; 3] = ["parameter", "from_quantile", "to_quantile"];
        let node = table.get("participants")?;
        let Some(keys) = node.get_ref().as_table() else {
            let expected = "a table, as in { parameter = \"delta_d\", from_quantile = 0.8 }";
            self.expected("participants", expected, node);
            return None;
        };
        for key in keys.keys().filter(|key| !KEYS.contains(&key.get_ref().as_ref())) {
            let found = key.get_ref();
            let message = format!("unknown key `{found}` in `participants`");
            self.faults.add(Fault::at(key.span().into(), message).nearest(found, KEYS));
        }
        let here = Span::from(node.span());
        let keys = &*respelt(keys, &KEYS);
        if let Some(metric) = metric.filter(|metric| !METRICS.contains(metric)) {
            let message = format!("`participants`: `{metric}` is not recorded per episode");
            let help = format!("use one of {}", METRICS.join(", "));
            self.faults.add(Fault::at(here, message).help(help));
        }
        let names: Vec<&'static str> = ParticipantSampler::all_names().collect();
        let parameter = match keys.get("parameter") {
            Some(named) => self.word("parameter", &names, named),
            None => {
                let fault = Fault::at(here, "`participants`: missing key `parameter`");
                self.faults.add(fault.help("name a key of [population]: parameter = \"delta_d\""));
                None
            }
        };
        let mut share = |name: &str, default: f64| match keys.get(name) {
            Some(node) => self.share(name, node),
            None => Some(default),
        };
        let (from, to) = (share("from_quantile", 0.0), share("to_quantile", 1.0));
        let (from, to) = (from?, to?);
        if from >= to {
            let message = "`participants`: `from_quantile` is not below `to_quantile`";
            self.faults.add(Fault::at(here, message));
            return None;
        }
        let parameter = parameter?;
        let place = names.iter().position(|name| *name == parameter)? as u8;
        Some(Located { value: ParticipantRange { parameter, place, from, to }, span: here })
    }

    fn share(&mut self, name: &str, node: &Node) -> Option<f64> {
        match self.value(name, Kind::PROBABILITY, node)? {
            Value::Real(share) => Some(share),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(from: f64, to: f64) -> ParticipantRange {
        ParticipantRange { parameter: "delta_d", place: 3, from, to }
    }

    #[test]
    fn fifths_hold_a_fifth_each_and_everybody_once() {
        let fifths = [0.0, 0.2, 0.4, 0.6, 0.8].map(|from| range(from, from + 0.2));
        let fifths = [fifths[0], fifths[1], range(0.4, 0.6), range(0.6, 0.8), range(0.8, 1.0)];
        for count in [5, 1000] {
            for rank in 0..count {
                let held = fifths.iter().filter(|fifth| fifth.contains(rank, count)).count();
                assert_eq!(held, 1, "{rank} of {count}");
            }
            let last = (0..count).filter(|rank| fifths[4].contains(*rank, count)).count();
            assert_eq!(last, count / 5);
        }
        assert!(range(0.0, 1.0).contains(0, 1));
    }

    #[test]
    fn ranges_read_well() {
        let said = |from, to| range(from, to).to_string();
        assert_eq!(said(0.8, 1.0), "the 20 % of participants with the largest delta_d");
        assert_eq!(said(0.0, 0.25), "the 25 % of participants with the smallest delta_d");
        assert_eq!(
            said(0.4, 0.6),
            "participants between the 40 % and the 60 % quantile of delta_d"
        );
    }
}
