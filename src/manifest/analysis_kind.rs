//! The kinds of analyses: the words that manifests write for them, and their keys, each with its
//! documentation and JSON Schema.

use serde_json::{Value as Json, json};

use super::limits::MOST_JOBS;
use crate::choices;

/// Declares the kinds: how manifests write each, and the keys that it has beside those of every
/// kind.
macro_rules! kinds {
    ($($Kind:ident = $word:literal, $keys:expr;)+) => {
        /// A kind, as manifests write it.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum KindName {
            $($Kind,)+
        }

        impl KindName {
            /// In the order that the documentation lists them.
            pub const ALL: &[KindName] = &[$(KindName::$Kind),+];

            /// Its word.
            pub fn word(self) -> &'static str {
                match self {
                    $(KindName::$Kind => $word,)+
                }
            }

            /// The names of all its keys, `kind` behind the name.
            pub fn key_names(self) -> Vec<&'static str> {
                let mut names: Vec<&str> = self.keys().map(|key| key.name).collect();
                names.insert(1, "kind");
                names
            }

            /// Its keys but for `kind`.
            pub fn keys(self) -> impl Iterator<Item = &'static AnalysisKey> {
                SHARED.iter().chain(self.own_keys())
            }

            /// The keys that it has beside those of every kind.
            fn own_keys(self) -> &'static [AnalysisKey] {
                match self {
                    $(KindName::$Kind => &$keys,)+
                }
            }
        }
    };
}

kinds! {
    Contrast = "contrast", [METRIC, BY, BETWEEN, PAIRING, FAMILY];
    Curve = "curve", [METRIC, CURVE_X];
    LearningCurve = "learning_curve", [MOVING_MEAN];
    HeatMap = "heat_map", [METRIC, MAP_X, Y, BY, BETWEEN];
    ActionChoice = "action_choice", [BIN_COUNT];
    Selection = "selection", [METRIC, RULE, REPORTING_SEEDS];
    InferenceError = "inference_error", [];
}

/// A key of `[[analysis]]`.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnalysisKey {
    /// Its name in the manifest.
    pub name: &'static str,
    /// One line for editors.
    pub doc: &'static str,
    /// The JSON Schema of its values.
    pub schema: fn() -> Json,
}

/// Keys of every kind, beside `kind` itself.
const SHARED: &[AnalysisKey] = &[NAME, TITLE, WHERE];

const NAME: AnalysisKey = AnalysisKey {
    name: "name",
    doc: "what files and links call it",
    schema: || json!({ "$ref": "#/$defs/name" }),
};

const TITLE: AnalysisKey = AnalysisKey {
    name: "title",
    doc: "what a reader sees above it",
    schema: || json!({ "type": "string" }),
};

const WHERE: AnalysisKey = AnalysisKey {
    name: "where",
    doc: "the jobs that it is about; all by default",
    schema: || json!({ "$ref": "#/$defs/exclude" }),
};

const METRIC: AnalysisKey = AnalysisKey {
    name: "metric",
    doc: "the metric of a run that it is about",
    schema: || json!({ "enum": ANALYSED_METRICS, "default": ANALYSED_METRICS[0] }),
};

const BY: AnalysisKey = AnalysisKey {
    name: "by",
    doc: "what tells the two sides of a difference apart",
    schema: || json!({ "anyOf": [{ "const": "agent.name" }, parameter()] }),
};

const BETWEEN: AnalysisKey = AnalysisKey {
    name: "between",
    doc: "the two sides, first minus second",
    schema: || json!({ "type": "array", "minItems": 2, "maxItems": 2 }),
};

const PAIRING: AnalysisKey = AnalysisKey {
    name: "pairing",
    doc: "whether seeds are compared one by one",
    schema: || json!({ "enum": Pairing::WORDS, "default": Pairing::WORDS[0] }),
};

const FAMILY: AnalysisKey = AnalysisKey {
    name: "family",
    doc: "the contrasts whose p values are corrected together; the name by default",
    schema: || json!({ "$ref": "#/$defs/name" }),
};

const CURVE_X: AnalysisKey = AnalysisKey {
    name: "x",
    doc: "the horizontal axis",
    schema: || json!({ "anyOf": [{ "const": ERROR_AXIS }, parameter()] }),
};

const MAP_X: AnalysisKey = AnalysisKey { name: "x", doc: "the horizontal axis", schema: parameter };

const Y: AnalysisKey = AnalysisKey { name: "y", doc: "the vertical axis", schema: parameter };

const MOVING_MEAN: AnalysisKey = AnalysisKey {
    name: "window",
    doc: "training episodes that the moving mean is over",
    schema: || {
        let mut window = count();
        window["default"] = json!(WINDOW);
        window
    },
};

const BIN_COUNT: AnalysisKey = AnalysisKey {
    name: "bins",
    doc: "bins of the context probability",
    schema: || json!({ "enum": BINS, "default": 5 }),
};

const RULE: AnalysisKey = AnalysisKey {
    name: "rule",
    doc: "how settings are ranked",
    schema: || json!({ "enum": SelectionRule::WORDS, "default": SelectionRule::WORDS[0] }),
};

const REPORTING_SEEDS: AnalysisKey = AnalysisKey {
    name: "reporting_seeds",
    doc: "seeds that chosen settings are reported on; none of this manifest's",
    schema: || {
        json!({ "anyOf": [count(), {
            "type": "array",
            "minItems": 1,
            "uniqueItems": true,
            "items": { "$ref": "#/$defs/seed" },
        }] })
    },
};

fn parameter() -> Json {
    json!({ "$ref": "#/$defs/parameter" })
}

fn count() -> Json {
    json!({ "type": "integer", "minimum": 1, "maximum": MOST_JOBS })
}

/// Metrics that an analysis can be about.
pub const ANALYSED_METRICS: &[&str] =
    &["mean_return", "lower_quartile_return", "mean_length", "disengagement_rate", "message_rate"];

/// The word of the axis that no parameter is.
pub const ERROR_AXIS: &str = "context_inference_error";

/// Numbers of bins that the ten bins of the store can be joined to.
pub(super) const BINS: &[u64] = &[1, 2, 5, 10];

/// Training episodes of a moving mean where the manifest says nothing.
pub(super) const WINDOW: u32 = 100;

choices! {
    /// How the seeds of two arms are compared.
    pub enum Pairing {
        /// As two independent samples.
        Unpaired = "unpaired",
        /// Seed by seed; a seed that one side lacks is left out.
        BySeed = "by_seed",
    }
}

choices! {
    /// How settings of hyper-parameters are ranked.
    pub enum SelectionRule {
        /// By the mean over seeds.
        HighestMean = "highest_mean",
        /// By the lower end of the 95 % interval of the mean over seeds.
        HighestLowerBound = "highest_lower_bound",
    }
}
