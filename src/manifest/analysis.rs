//! What an author wants computed from the results: analyses, as the report draws them.
//!
//! Analyses are no part of any job: declaring, changing or dropping one runs nothing.

use super::condition::Condition;
use super::parameter::Parameter;

/// A figure or table that an author declares with `[[analysis]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// What files and links call it; no other analysis of the manifest has it.
    pub name: String,
    /// What a reader sees above it; the name stands in where there is none.
    pub title: Option<String>,
    /// The metric of a run that it is about, one of [`ANALYSED_METRICS`].
    pub metric: &'static str,
    /// Which jobs it is about: those that meet every condition.
    pub conditions: Vec<Condition>,
    /// What it computes from them.
    pub kind: AnalysisKind,
}

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

/// Two sides of a difference: each a condition on the same parameter with one value.
#[derive(Clone, Debug, PartialEq)]
pub struct Sides {
    /// What is diminished.
    pub first: Condition,
    /// What is taken away.
    pub second: Condition,
}

/// How the seeds of two arms are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pairing {
    /// As two independent groups.
    Unpaired,
    /// Seed by seed; a seed that one side lacks is left out.
    BySeed,
}

/// The horizontal axis of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveAxis {
    /// Phi(-1 / (2 sigma)), the exact rate at which the most likely context is wrong.
    ContextInferenceError,
    /// A swept parameter with numbers for values.
    Swept(Parameter),
}

/// How settings of hyper-parameters are ranked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SelectionRule {
    /// By the mean over seeds.
    HighestMean,
    /// By the lower end of the 95 % interval of the mean over seeds.
    HighestLowerBound,
}

/// Metrics that an analysis can be about.
pub const ANALYSED_METRICS: &[&str] =
    &["mean_return", "lower_quartile_return", "mean_length", "disengagement_rate", "message_rate"];

/// The words of the kinds, in the order that the documentation lists them.
pub(super) const KINDS: &[&str] = &[
    "contrast",
    "curve",
    "learning_curve",
    "heat_map",
    "action_choice",
    "selection",
    "inference_error",
];

/// The word of the axis that no parameter is.
pub(super) const ERROR_AXIS: &str = "context_inference_error";

/// Numbers of bins that the ten bins of the store can be joined to.
pub(super) const BINS: &[u64] = &[1, 2, 5, 10];

/// Training episodes of a moving mean where the manifest says nothing.
pub(super) const WINDOW: u32 = 100;

/// Keys of every `[[analysis]]`.
pub(super) const SHARED_KEYS: &[&str] = &["name", "kind", "title", "where"];

/// The keys that a kind has beside [`SHARED_KEYS`].
pub(super) fn keys_of(kind: &str) -> &'static [&'static str] {
    match kind {
        "contrast" => &["metric", "by", "between", "pairing", "family"],
        "curve" => &["metric", "x"],
        "learning_curve" => &["window"],
        "heat_map" => &["metric", "x", "y", "by", "between"],
        "action_choice" => &["bins"],
        "selection" => &["metric", "rule", "reporting_seeds"],
        _ => &[],
    }
}

impl Analysis {
    /// What a job has to meet to be one that the analysis is about: its conditions, and to be on
    /// one of its sides.
    pub fn of_jobs(&self) -> impl Iterator<Item = Condition> {
        let either = self.kind.sides().and_then(|sides| sides.first.or(&sides.second));
        self.conditions.iter().cloned().chain(either)
    }

    /// The part of the results that it is computed from.
    pub fn part(&self) -> Part {
        match (&self.kind, self.metric) {
            (AnalysisKind::LearningCurve { .. }, _) => Part::LearningCurve,
            (AnalysisKind::ActionChoice { .. } | AnalysisKind::InferenceError, _) => {
                Part::ActionChoice
            }
            (
                AnalysisKind::Contrast(_)
                | AnalysisKind::Curve { .. }
                | AnalysisKind::HeatMap { .. }
                | AnalysisKind::Selection { .. },
                metric,
            ) => match metric {
                "lower_quartile_return" => Part::Returns,
                metric => Part::Metric(metric),
            },
        }
    }
}

/// A part of the results of runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
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
    /// The word that manifests write.
    pub fn name(&self) -> &'static str {
        match self {
            AnalysisKind::Contrast(_) => "contrast",
            AnalysisKind::Curve { .. } => "curve",
            AnalysisKind::LearningCurve { .. } => "learning_curve",
            AnalysisKind::HeatMap { .. } => "heat_map",
            AnalysisKind::ActionChoice { .. } => "action_choice",
            AnalysisKind::Selection { .. } => "selection",
            AnalysisKind::InferenceError => "inference_error",
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

impl Sides {
    /// The dotted name of the key that tells the sides apart; empty where no key does.
    pub fn key(&self) -> String {
        match &self.first {
            Condition::Key { parameter, .. } => parameter.to_string(),
            Condition::Scenario(_) | Condition::Seed(_) | Condition::AgentName(_) => String::new(),
        }
    }
}

impl Pairing {
    /// The word that manifests write.
    pub fn name(self) -> &'static str {
        match self {
            Pairing::Unpaired => "unpaired",
            Pairing::BySeed => "by_seed",
        }
    }
}

impl SelectionRule {
    /// The word that manifests write.
    pub fn name(self) -> &'static str {
        match self {
            SelectionRule::HighestMean => "highest_mean",
            SelectionRule::HighestLowerBound => "highest_lower_bound",
        }
    }
}
