//! The kinds of analyses: what each computes, from which results, and how it is read and written.

use toml::de::DeTable;

use super::analysis_keys::{BINS, ERROR_AXIS, KindName, Pairing, SelectionRule, WINDOW};
use super::fault::Fault;
use super::parameter::seed_of;
use super::sides::Sides;
use super::source::{Located, Span};
use super::sweep::{Node, Reader, whole};
use super::written::{condition, list, quoted};
use crate::job::{Condition, DataPart};
use crate::key::{Kind, Parameter, Value};

/// The kind of an analysis.
#[derive(Clone, Debug, PartialEq)]
pub enum AnalysisKind {
    /// Differences of means between two sides, at every setting of the other parameters.
    Contrast(Contrast),
    /// A metric along a parameter, one line per agent and scenario.
    Curve {
        /// The horizontal axis.
        axis: CurveAxis,
    },
    /// A moving mean of the metric over training episodes.
    LearningCurve {
        /// Training episodes per moving mean.
        window: u32,
    },
    /// A mean, or a difference of means, over two parameters; one map per agent.
    HeatMap {
        /// The parameter along the columns.
        x: Parameter,
        /// The parameter along the rows.
        y: Parameter,
        /// The sides of the difference; `None` to show the mean itself.
        sides: Option<Sides>,
    },
    /// Shares of the actions chosen in the test, by bins of the probability of context 0.
    ActionChoice {
        /// Number of bins of [0, 1]; divides 10.
        bins: u8,
    },
    /// The hyper-parameters selected for each agent.
    Selection {
        /// How the settings are ranked.
        rule: SelectionRule,
        /// Seeds on which the selected settings are evaluated; disjoint from the manifest's own.
        reporting_seeds: Vec<u64>,
    },
    /// The share of the distance to the optimum that some arms recover relative to others.
    Recovery(Recovery),
    /// The rate at which the most likely context is wrong, along sigma.
    InferenceError,
}

/// The two groups of arms of a recovery, each as conditions on jobs.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovery {
    /// Conditions on the arms whose recovery is measured.
    pub with: Vec<Condition>,
    /// Conditions on the arms whose distance to the optimum is the loss.
    pub without: Vec<Condition>,
}

/// A difference between two sides, first minus second.
#[derive(Clone, Debug, PartialEq)]
pub struct Contrast {
    /// The sides.
    pub sides: Sides,
    /// Whether the seeds of the sides are paired.
    pub pairing: Pairing,
    /// The family of contrasts whose p values are corrected together.
    pub family: String,
}

/// The horizontal axis of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveAxis {
    /// Phi(-1 / (2 sigma)), the exact rate at which the most likely context is wrong.
    ContextInferenceError,
    /// A swept parameter with numeric values.
    Swept(Parameter),
}

impl AnalysisKind {
    /// Reads the keys of a kind, and records faults and the parameters along axes.
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
                let x = reader.axis("x", span, table, axes);
                let y = reader.axis("y", span, table, axes);
                let wanted = table.contains_key("by") || table.contains_key("between");
                let sides = if wanted { Some(reader.sides(span, table)) } else { None };
                let sides = match sides {
                    Some(sides) => Some(sides?),
                    None => None,
                };
                Some(AnalysisKind::HeatMap { x: x?, y: y?, sides })
            }
            KindName::ActionChoice => {
                let bins = match table.get("bins") {
                    Some(node) => bins(reader, node)?,
                    None => 5,
                };
                Some(AnalysisKind::ActionChoice { bins })
            }
            KindName::Selection => selection(reader, span, table),
            KindName::Recovery => {
                let with = reader.arms("with", span, table);
                let without = reader.arms("without", span, table);
                Some(AnalysisKind::Recovery(Recovery { with: with?, without: without? }))
            }
            KindName::InferenceError => Some(AnalysisKind::InferenceError),
        }
    }

    /// Whether the analysis shows the rate at which the most likely context is wrong.
    pub(super) fn shows_inference_error(&self) -> bool {
        match self {
            AnalysisKind::InferenceError => true,
            AnalysisKind::Curve { axis } => *axis == CurveAxis::ContextInferenceError,
            AnalysisKind::Contrast(_)
            | AnalysisKind::LearningCurve { .. }
            | AnalysisKind::HeatMap { .. }
            | AnalysisKind::ActionChoice { .. }
            | AnalysisKind::Recovery(_)
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
            | AnalysisKind::Recovery(_)
            | AnalysisKind::Selection { .. } => match metric {
                "lower_quartile_return" => DataPart::Returns,
                metric => DataPart::Metric(metric),
            },
        }
    }

    /// The name of the kind.
    pub(super) fn name(&self) -> KindName {
        match self {
            AnalysisKind::Contrast(_) => KindName::Contrast,
            AnalysisKind::Curve { .. } => KindName::Curve,
            AnalysisKind::LearningCurve { .. } => KindName::LearningCurve,
            AnalysisKind::HeatMap { .. } => KindName::HeatMap,
            AnalysisKind::ActionChoice { .. } => KindName::ActionChoice,
            AnalysisKind::Selection { .. } => KindName::Selection,
            AnalysisKind::Recovery(_) => KindName::Recovery,
            AnalysisKind::InferenceError => KindName::InferenceError,
        }
    }

    /// The keys of the kind except the metric, with their values as a manifest writes them.
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
            AnalysisKind::Recovery(Recovery { with, without }) => {
                written.extend([("with", conditions(with)), ("without", conditions(without))]);
            }
            AnalysisKind::InferenceError => {}
        }
        written
    }

    /// Seeds that the analysis needs in addition to the seeds of the manifest.
    pub(super) fn reporting_seeds(&self) -> &[u64] {
        match self {
            AnalysisKind::Selection { reporting_seeds, .. } => reporting_seeds,
            AnalysisKind::Contrast(_)
            | AnalysisKind::Curve { .. }
            | AnalysisKind::LearningCurve { .. }
            | AnalysisKind::HeatMap { .. }
            | AnalysisKind::ActionChoice { .. }
            | AnalysisKind::Recovery(_)
            | AnalysisKind::InferenceError => &[],
        }
    }

    /// The sides of the difference; `None` if the analysis shows no difference.
    pub fn sides(&self) -> Option<&Sides> {
        match self {
            AnalysisKind::Contrast(contrast) => Some(&contrast.sides),
            AnalysisKind::HeatMap { sides, .. } => sides.as_ref(),
            AnalysisKind::Curve { .. }
            | AnalysisKind::LearningCurve { .. }
            | AnalysisKind::ActionChoice { .. }
            | AnalysisKind::Selection { .. }
            | AnalysisKind::Recovery(_)
            | AnalysisKind::InferenceError => None,
        }
    }
}

/// Conditions as an inline table.
fn conditions(conditions: &[Condition]) -> String {
    let written: Vec<String> = conditions.iter().map(condition).collect();
    format!("{{ {} }}", written.join(", "))
}

fn contrast(reader: &mut Reader, name: &str, span: Span, table: &DeTable) -> Option<Contrast> {
    let sides = reader.sides(span, table);
    let pairing =
        table.get("pairing").and_then(|node| reader.word("pairing", Pairing::WORDS, node));
    let pairing = pairing.and_then(Pairing::named).unwrap_or(Pairing::Automatic);
    let family = match table.get("family") {
        Some(node) => reader.name("family", node).value,
        None => name.to_owned(),
    };
    Some(Contrast { sides: sides?, pairing, family })
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
    let rule = table.get("rule").and_then(|node| reader.word("rule", SelectionRule::WORDS, node));
    let rule = rule.and_then(SelectionRule::named).unwrap_or(SelectionRule::HighestMean);
    let Some(node) = table.get("reporting_seeds") else {
        let message = "missing key `reporting_seeds` in an [[analysis]] of kind \"selection\"";
        let help = "list the seeds of the manifests that report the chosen settings; results on \
                    the seeds of the search are biased upwards";
        reader.faults.add(Fault::at(span, message).help(help));
        return None;
    };
    // A few characters can request millions of seeds, and a manifest can have a thousand analyses.
    let count = whole(node).map(|count| usize::try_from(count).ok());
    let counted = count
        .is_none_or(|count| reader.count_in("reporting_seeds", count.unwrap_or(usize::MAX), node));
    let reporting_seeds = if counted { reader.seeds("reporting_seeds", node) } else { Vec::new() };
    let reporting_seeds = reporting_seeds.iter().map(seed_of).collect();
    Some(AnalysisKind::Selection { rule, reporting_seeds })
}
