//! The keys of analyses: which kinds there are, their words in manifests, and the keys of each, with
//! documentation and JSON Schema.

use serde_json::{Value as Json, json};

use super::figure_keys::{FigureKeys, LETTERS, SIDES};
use super::limits::MOST_JOBS;
use super::participant_range;
use crate::key::choices;

/// Declares the kinds: the word of each in manifests, and its own keys in addition to the shared ones.
macro_rules! kinds {
    ($($Kind:ident = $word:literal, $keys:expr;)+) => {
        /// A kind of analysis.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum KindName {
            $($Kind,)+
        }

        impl KindName {
            /// Every kind, in the order of the documentation.
            pub const ALL: &[KindName] = &[$(KindName::$Kind),+];

            /// The word of the kind in manifests.
            pub fn word(self) -> &'static str {
                match self {
                    $(KindName::$Kind => $word,)+
                }
            }

            /// The names of all keys of the kind; `kind` comes second, after the name.
            pub fn key_names(self) -> Vec<&'static str> {
                let mut names: Vec<&str> = self.keys().map(|key| key.name).collect();
                names.insert(1, "kind");
                names
            }

            /// All keys of the kind except `kind`.
            pub fn keys(self) -> impl Iterator<Item = &'static AnalysisKey> {
                SHARED.iter().chain(self.own_keys())
            }

            /// The keys of the kind in addition to the shared ones.
            fn own_keys(self) -> &'static [AnalysisKey] {
                match self {
                    $(KindName::$Kind => &$keys,)+
                }
            }
        }
    };
}

kinds! {
    Contrast = "contrast", [METRIC, PARTICIPANTS, BY, BETWEEN, PAIRING, FAMILY, PANEL, WIDTH, HEIGHT, FONT_SIZE, THEME];
    Curve = "curve", [METRIC, PARTICIPANTS, CURVE_X, X_SCALE, PANEL, WIDTH, HEIGHT, FONT_SIZE, Y_MIN, Y_MAX, THEME];
    LearningCurve = "learning_curve", [MOVING_MEAN, X_SCALE, PANEL, WIDTH, HEIGHT, FONT_SIZE, Y_MIN, Y_MAX, THEME];
    HeatMap = "heat_map", [METRIC, PARTICIPANTS, MAP_X, Y, BY, BETWEEN, PANEL, WIDTH, HEIGHT, FONT_SIZE, THEME];
    ActionChoice = "action_choice", [BIN_COUNT, PANEL, WIDTH, HEIGHT, FONT_SIZE, THEME];
    Selection = "selection", [METRIC, RULE, REPORTING_SEEDS];
    Recovery = "recovery", [WITH, WITHOUT];
    InferenceError = "inference_error", [WIDTH, HEIGHT, FONT_SIZE, THEME];
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

const fn key(name: &'static str, doc: &'static str, schema: fn() -> Json) -> AnalysisKey {
    AnalysisKey { name, doc, schema }
}

/// Keys that every kind has, in addition to `kind`.
const SHARED: &[AnalysisKey] = &[NAME, TITLE, WHERE];

const NAME: AnalysisKey =
    key("name", "the name in files and links", || json!({ "$ref": "#/$defs/name" }));

const TITLE: AnalysisKey =
    key("title", "the heading in the report", || json!({ "type": "string" }));

const WHERE: AnalysisKey =
    key("where", "the jobs to analyse; all by default", || json!({ "$ref": "#/$defs/exclude" }));

const METRIC: AnalysisKey = key("metric", "the metric to analyse", || {
    json!({
        "anyOf": [
            { "enum": ANALYSED_METRICS },
            { "type": "string", "pattern": "^mean_return_first_[1-9][0-9]*$" },
        ],
        "default": ANALYSED_METRICS[0],
    })
});

const PARTICIPANTS: AnalysisKey = key(
    "participants",
    "the test episodes of participants between two quantiles of a parameter",
    participant_range::schema,
);

const BY: AnalysisKey = key(
    "by",
    "the parameter in which the two sides of a difference differ",
    || json!({ "anyOf": [{ "const": "agent.name" }, parameter()] }),
);

const BETWEEN: AnalysisKey = key(
    "between",
    "the two sides, first minus second",
    || json!({ "type": "array", "minItems": 2, "maxItems": 2 }),
);

const PAIRING: AnalysisKey = key(
    "pairing",
    "whether seeds are compared in pairs",
    || json!({ "enum": Pairing::WORDS, "default": Pairing::WORDS[0] }),
);

const FAMILY: AnalysisKey = key(
    "family",
    "the contrasts whose p values are corrected together; the name by default",
    || json!({ "$ref": "#/$defs/name" }),
);

const CURVE_X: AnalysisKey =
    key("x", "the horizontal axis", || json!({ "anyOf": [{ "const": ERROR_AXIS }, parameter()] }));

const MAP_X: AnalysisKey = key("x", "the horizontal axis", parameter);

const Y: AnalysisKey = key("y", "the vertical axis", parameter);

const PANEL: AnalysisKey =
    key("panel", "the key by whose values figures are split into panels", FigureKeys::panel_schema);

const WIDTH: AnalysisKey = key("width", "the width of a figure in mm", side);

const HEIGHT: AnalysisKey = key("height", "the height of a figure in mm", side);

const FONT_SIZE: AnalysisKey = key(
    "font_size",
    "the font size in points",
    || json!({ "type": "number", "minimum": LETTERS.0, "maximum": LETTERS.1 }),
);

const Y_MIN: AnalysisKey = key("y_min", "the lower end of the vertical axis", limit);

const Y_MAX: AnalysisKey = key("y_max", "the upper end of the vertical axis", limit);

const X_SCALE: AnalysisKey = key(
    "x_scale",
    "the scale of the horizontal axis; chosen by its numbers by default",
    FigureKeys::x_scale_schema,
);

const THEME: AnalysisKey =
    key("theme", "\"print\" for figures without heading and note", FigureKeys::theme_schema);

fn side() -> Json {
    json!({ "type": "number", "minimum": SIDES.0, "maximum": SIDES.1 })
}

fn limit() -> Json {
    json!({ "type": "number" })
}

const MOVING_MEAN: AnalysisKey = key("window", "training episodes in the moving mean", || {
    let mut window = count();
    window["default"] = json!(WINDOW);
    window
});

const BIN_COUNT: AnalysisKey =
    key("bins", "bins of the context probability", || json!({ "enum": BINS, "default": 5 }));

const RULE: AnalysisKey = key(
    "rule",
    "how settings are ranked",
    || json!({ "enum": SelectionRule::WORDS, "default": SelectionRule::WORDS[0] }),
);

const REPORTING_SEEDS: AnalysisKey = key(
    "reporting_seeds",
    "seeds for reporting the chosen settings; none may be a seed of this manifest",
    || {
        json!({ "anyOf": [count(), {
            "type": "array",
            "minItems": 1,
            "uniqueItems": true,
            "items": { "$ref": "#/$defs/seed" },
        }] })
    },
);

const WITH: AnalysisKey =
    key("with", "the arms that recover part of the loss", || json!({ "$ref": "#/$defs/exclude" }));

const WITHOUT: AnalysisKey = key(
    "without",
    "the arms whose distance to the optimum is the loss",
    || json!({ "$ref": "#/$defs/exclude" }),
);

fn parameter() -> Json {
    json!({ "$ref": "#/$defs/parameter" })
}

fn count() -> Json {
    json!({ "type": "integer", "minimum": 1, "maximum": MOST_JOBS })
}

/// Metrics that an analysis can have, in addition to the metrics of `evaluation.first_episodes`.
pub const ANALYSED_METRICS: &[&str] = &[
    "mean_return",
    "mean_net_return",
    "lower_quartile_return",
    "mean_length",
    "disengagement_rate",
    "message_rate",
];

/// The word for the axis that is not a parameter.
pub const ERROR_AXIS: &str = "context_inference_error";

/// Numbers of bins into which the ten bins of the store can be merged.
pub(super) const BINS: &[u64] = &[1, 2, 5, 10];

/// Default number of training episodes per moving mean.
pub(super) const WINDOW: u32 = 100;

choices! {
    /// How the seeds of two arms are compared.
    pub enum Pairing {
        /// Paired by seed if both sides were given the same seeds, and unpaired otherwise.
        Automatic = "automatic",
        /// As two independent samples.
        Unpaired = "unpaired",
        /// Paired by seed; a seed that one side lacks is left out.
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
        /// By the mean over seeds, the lowest first.
        LowestMean = "lowest_mean",
    }
}
