//! Reads the subset of participants that an analysis is restricted to.

use serde_json::{Value as Json, json};
use toml::de::DeTable;

use crate::env::ParticipantSampler;
use crate::job::metric::metrics_with;
use crate::job::{MetricName, MetricPlace, ParticipantRange};
use crate::key::{Kind, Value};
use crate::manifest::value::respelt::respelt;
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, Located, Span};

/// The range as a manifest writes it.
pub(in crate::manifest) fn written(range: &ParticipantRange) -> String {
    let ParticipantRange { parameter, from, to, .. } = range;
    format!("{{ parameter = \"{parameter}\", from_quantile = {from:?}, to_quantile = {to:?} }}")
}

pub(in crate::manifest) fn schema() -> Json {
    let names: Vec<&str> = ParticipantSampler::all_names().collect();
    let share =
        |default: f64| json!({ "type": "number", "minimum": 0, "maximum": 1, "default": default });
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

impl Reader<'_> {
    /// Reads the key `participants` of an analysis of `metric`, `None` for a faulty metric; `None` if the key
    /// is absent or faulty.
    pub(in crate::manifest) fn participants(
        &mut self,
        metric: Option<MetricName>,
        table: &DeTable,
    ) -> Option<Located<ParticipantRange>> {
        const KEYS: [&str; 3] = ["parameter", "from_quantile", "to_quantile"];
        let node = table.get("participants")?;
        let Some(keys) = node.get_ref().as_table() else {
            let expected = "a table, as in { parameter = \"delta_d\", from_quantile = 0.8 }";
            self.expected("participants", expected, node);
            return None;
        };
        self.only_keys("`participants`", &KEYS, keys);
        let here = Span::from(node.span());
        let keys = &*respelt(keys, &KEYS);
        if let Some(metric) = metric.filter(|one| !one.is_in(MetricPlace::Participants)) {
            let message = format!("`participants`: `{metric}` is not recorded per episode");
            let termination = self.family.termination_metric;
            let known = metrics_with(MetricPlace::Participants, termination);
            let words: Vec<_> = known.map(MetricName::text).collect();
            let help = format!("use one of {}", words.join(", "));
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
        let index = names.iter().position(|name| *name == parameter)? as u8;
        Some(Located { value: ParticipantRange { parameter, index, from, to }, span: here })
    }

    fn share(&mut self, name: &str, node: &Node) -> Option<f64> {
        match self.value(name, Kind::PROBABILITY, node)? {
            Value::Real(share) => Some(share),
            _ => None,
        }
    }
}
