//! The kinds of analyses: what each computes, its word in manifests, and its keys, each with its
//! documentation and JSON Schema.

use serde_json::{Value as Json, json};
use toml::de::DeTable;

use super::fault::Fault;
use super::limits::MOST_JOBS;
use super::sides::Sides;
use super::source::{Located, Span};
use super::sweep::{Node, Reader, whole};
use super::written::{list, quoted};
use crate::choices;
use crate::key::{Kind, Parameter, Value};

/// What an analysis computes.
#[derive(Clone, Debug, PartialEq)]
pub enum AnalysisKind {
    /// Differences of means between two sides, at every setting of the other parameters.
    Contrast(Contrast),
    /// A metric along a parameter, a line an agent and scenario.
    Curve {
        /// What the horizontal axis shows.
        axis: CurveAxis,
    },
    /// The metric of training episodes, as a moving mean.
    LearningCurve {
        /// Training episodes that the moving mean is over.
        window: u32,
    },
    /// A mean, or a difference of means, over two parameters; a map an agent.
    HeatMap {
        /// The parameter along the columns.
        x: Parameter,
        /// The parameter along the rows.
        y: Parameter,
        /// The difference that is shown; the mean itself where there is none.
        sides: Option<Sides>,
    },
    /// Shares of the actions chosen in the test, by bins of the probability of context 0.
    ActionChoice {
        /// Bins that [0, 1] is cut into; divides 10.
        bins: u8,
    },
    /// The hyper-parameters that an agent would be given by these jobs.
    Selection {
        /// How the settings are ranked.
        rule: SelectionRule,
        /// Seeds on which the chosen settings are reported: none of the manifest's own.
        reporting_seeds: Vec<u64>,
    },
    /// The rate at which the most likely context is wrong, along sigma.
    InferenceError,
}

/// A difference between two sides, first minus second.
#[derive(Clone, Debug, PartialEq)]
pub struct Contrast {
    /// The sides.
    pub sides: Sides,
    /// How the seeds of the sides are compared.
    pub pairing: Pairing,
    /// The contrasts whose p values are corrected together: those of one family.
    pub family: String,
}

/// The horizontal axis of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveAxis {
    /// Phi(-1 / (2 sigma)), the exact rate at which the most likely context is wrong.
    ContextInferenceError,
    /// A swept parameter with numbers for values.
    Swept(Parameter),
}

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

const fn key(name: &'static str, doc: &'static str, schema: fn() -> Json) -> AnalysisKey {
    AnalysisKey { name, doc, schema }
}

/// Keys of every kind, beside `kind` itself.
const SHARED: &[AnalysisKey] = &[NAME, TITLE, WHERE];

const NAME: AnalysisKey =
    key("name", "what files and links call it", || json!({ "$ref": "#/$defs/name" }));

const TITLE: AnalysisKey =
    key("title", "what a reader sees above it", || json!({ "type": "string" }));

const WHERE: AnalysisKey = key(
    "where",
    "the jobs that it is about; all by default",
    || json!({ "$ref": "#/$defs/exclude" }),
);

const METRIC: AnalysisKey = key(
    "metric",
    "the metric of a run that it is about",
    || json!({ "enum": ANALYSED_METRICS, "default": ANALYSED_METRICS[0] }),
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
    "whether seeds are compared one by one",
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

const MOVING_MEAN: AnalysisKey =
    key("window", "training episodes that the moving mean is over", || {
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
    "seeds that chosen settings are reported on; none of this manifest's",
    || {
        json!({ "anyOf": [count(), {
            "type": "array",
            "minItems": 1,
            "uniqueItems": true,
            "items": { "$ref": "#/$defs/seed" },
        }] })
    },
);

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

/// A part of the results of runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataPart {
    /// A metric.
    Metric(&'static str),
    /// The learning curve of the mean return.
    LearningCurve,
    /// Choices of action.
    ActionChoice,
    /// Returns of the test episodes.
    Returns,
}

impl AnalysisKind {
    /// Reads the keys of a kind, noting faults and the parameters along axes.
    pub(super) fn read(
        kind: KindName,
        reader: &mut Reader,
        name: &str,
        (span, table): (Span, &DeTable),
        axes: &mut Vec<Located<Parameter>>,
    ) -> Option<AnalysisKind> {
        match kind {
            KindName::Contrast => contrast(reader, name, span, table).map(AnalysisKind::Contrast),
            KindName::Curve => {
                reader.curve_axis(span, table, axes).map(|axis| AnalysisKind::Curve { axis })
            }
            KindName::LearningCurve => {
                let window = match table.get("window") {
                    Some(node) => window(reader, node)?,
                    None => WINDOW,
                };
                Some(AnalysisKind::LearningCurve { window })
            }
            KindName::HeatMap => {
                let x = reader.axis("x", span, table, axes)?;
                let y = reader.axis("y", span, table, axes)?;
                let wanted = table.contains_key("by") || table.contains_key("between");
                let sides = if wanted { Some(reader.sides(span, table)?) } else { None };
                Some(AnalysisKind::HeatMap { x, y, sides })
            }
            KindName::ActionChoice => {
                let bins = match table.get("bins") {
                    Some(node) => bins(reader, node)?,
                    None => 5,
                };
                Some(AnalysisKind::ActionChoice { bins })
            }
            KindName::Selection => selection(reader, span, table),
            KindName::InferenceError => Some(AnalysisKind::InferenceError),
        }
    }

    /// Whether it shows the rate at which the most likely context is wrong.
    pub(super) fn shows_inference_error(&self) -> bool {
        match self {
            AnalysisKind::InferenceError => true,
            AnalysisKind::Curve { axis } => *axis == CurveAxis::ContextInferenceError,
            AnalysisKind::Contrast(_)
            | AnalysisKind::LearningCurve { .. }
            | AnalysisKind::HeatMap { .. }
            | AnalysisKind::ActionChoice { .. }
            | AnalysisKind::Selection { .. } => false,
        }
    }

    /// The part of the results that an analysis of this kind is computed from.
    pub(super) fn part(&self, metric: &'static str) -> DataPart {
        match self {
            AnalysisKind::LearningCurve { .. } => DataPart::LearningCurve,
            AnalysisKind::ActionChoice { .. } | AnalysisKind::InferenceError => {
                DataPart::ActionChoice
            }
            AnalysisKind::Contrast(_)
            | AnalysisKind::Curve { .. }
            | AnalysisKind::HeatMap { .. }
            | AnalysisKind::Selection { .. } => match metric {
                "lower_quartile_return" => DataPart::Returns,
                metric => DataPart::Metric(metric),
            },
        }
    }

    /// The kind, as manifests write it.
    pub(super) fn name(&self) -> KindName {
        match self {
            AnalysisKind::Contrast(_) => KindName::Contrast,
            AnalysisKind::Curve { .. } => KindName::Curve,
            AnalysisKind::LearningCurve { .. } => KindName::LearningCurve,
            AnalysisKind::HeatMap { .. } => KindName::HeatMap,
            AnalysisKind::ActionChoice { .. } => KindName::ActionChoice,
            AnalysisKind::Selection { .. } => KindName::Selection,
            AnalysisKind::InferenceError => KindName::InferenceError,
        }
    }

    /// The keys of the kind with their values, as a manifest writes them; not the metric.
    pub(super) fn written(&self) -> Vec<(&'static str, String)> {
        let mut written = self.sides().map_or_else(Vec::new, Sides::written);
        match self {
            AnalysisKind::Contrast(contrast) => {
                written.push(("pairing", quoted(&contrast.pairing.word())));
                written.push(("family", quoted(&contrast.family)));
            }
            AnalysisKind::Curve { axis: CurveAxis::ContextInferenceError } => {
                written.push(("x", quoted(&ERROR_AXIS)));
            }
            AnalysisKind::Curve { axis: CurveAxis::Swept(parameter) } => {
                written.push(("x", quoted(parameter)));
            }
            AnalysisKind::LearningCurve { window } => written.push(("window", window.to_string())),
            AnalysisKind::HeatMap { x, y, sides: _ } => {
                written.extend([("x", quoted(x)), ("y", quoted(y))]);
            }
            AnalysisKind::ActionChoice { bins } => written.push(("bins", bins.to_string())),
            AnalysisKind::Selection { rule, reporting_seeds } => {
                written.push(("rule", quoted(&rule.word())));
                written.push(("reporting_seeds", list(reporting_seeds)));
            }
            AnalysisKind::InferenceError => {}
        }
        written
    }

    /// Seeds that are none of the manifest's.
    pub(super) fn reporting_seeds(&self) -> &[u64] {
        match self {
            AnalysisKind::Selection { reporting_seeds, .. } => reporting_seeds,
            AnalysisKind::Contrast(_)
            | AnalysisKind::Curve { .. }
            | AnalysisKind::LearningCurve { .. }
            | AnalysisKind::HeatMap { .. }
            | AnalysisKind::ActionChoice { .. }
            | AnalysisKind::InferenceError => &[],
        }
    }

    /// The sides of the difference that it shows, if it shows one.
    pub fn sides(&self) -> Option<&Sides> {
        match self {
            AnalysisKind::Contrast(contrast) => Some(&contrast.sides),
            AnalysisKind::HeatMap { sides, .. } => sides.as_ref(),
            AnalysisKind::Curve { .. }
            | AnalysisKind::LearningCurve { .. }
            | AnalysisKind::ActionChoice { .. }
            | AnalysisKind::Selection { .. }
            | AnalysisKind::InferenceError => None,
        }
    }
}

fn contrast(reader: &mut Reader, name: &str, span: Span, table: &DeTable) -> Option<Contrast> {
    let sides = reader.sides(span, table)?;
    let pairing = match table.get("pairing") {
        Some(node) => Pairing::named(reader.word("pairing", Pairing::WORDS, node)?)?,
        None => Pairing::Unpaired,
    };
    let family = match table.get("family") {
        Some(node) => reader.name("family", node).value,
        None => name.to_owned(),
    };
    Some(Contrast { sides, pairing, family })
}

fn window(reader: &mut Reader, node: &Node) -> Option<u32> {
    match reader.value("window", Kind::Integer { min: 1, max: 10_000_000 }, node)? {
        Value::Integer(window) => u32::try_from(window).ok(),
        _ => None,
    }
}

fn bins(reader: &mut Reader, node: &Node) -> Option<u8> {
    let bins = whole(node).filter(|bins| BINS.contains(bins));
    if bins.is_none() {
        reader.expected("bins", "1, 2, 5 or 10", node);
    }
    bins.and_then(|bins| u8::try_from(bins).ok())
}

fn selection(reader: &mut Reader, span: Span, table: &DeTable) -> Option<AnalysisKind> {
    let rule = match table.get("rule") {
        Some(node) => SelectionRule::named(reader.word("rule", SelectionRule::WORDS, node)?)?,
        None => SelectionRule::HighestMean,
    };
    let Some(node) = table.get("reporting_seeds") else {
        let message = "missing key `reporting_seeds` in an [[analysis]] of kind \"selection\"";
        let help = "list the seeds of the manifests that report the chosen settings: settings \
                    picked on the seeds that are then reported look better than they are";
        reader.faults.add(Fault::at(span, message).help(help));
        return None;
    };
    // A few characters can ask for millions of seeds, and a thousand analyses can.
    let count = whole(node).map(|count| usize::try_from(count).ok());
    let counted = count
        .is_none_or(|count| reader.count_in("reporting_seeds", count.unwrap_or(usize::MAX), node));
    let reporting_seeds = if counted { reader.seeds("reporting_seeds", node) } else { Vec::new() };
    Some(AnalysisKind::Selection { rule, reporting_seeds })
}
