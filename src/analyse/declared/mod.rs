//! The analyses that a manifest declares, carried out on the jobs of its experiment.
//!
//! In: analyses, jobs with what has become of them, published numbers. Out: [`Finding`]s, the
//! numbers of a figure or table with the seeds behind them. What cannot be computed is told by an
//! [`Undefined`](super::Undefined), and seeds that are missing are counted.
//!
//! It does not know how a finding is drawn or written.

mod action_choice;
mod arm;
mod contrast;
mod curve;
mod heat_map;
mod inference_error;
mod learning_curve;
mod reproduction;
mod selection;
mod summary;

pub use action_choice::{ActionPanel, BinShares};
pub use arm::{Arm, ArmId, varying};
pub use contrast::ContrastRow;
pub use curve::{ALPHA, Apart, CurveFigure, CurveLine, CurvePoint, Ends, Trends};
pub use heat_map::{HeatFigure, HeatTile, Scale, heat_range};
pub use inference_error::{ErrorFigure, ErrorPoint};
pub use learning_curve::{LearningFigure, LearningLine, LearningPanel};
pub use reproduction::{Comparison, Distance, Reproduction, Subject, reproduce};
pub use selection::{Candidate, Ranking};
pub use summary::{AgentSummary, ArmSummary, share_of_optimum, summarise_agents, summarise_arms};

use crate::manifest::{Analysis, AnalysisKind, Published};
use crate::record::{JobRecord, JobStatus};

/// What an analysis came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What files and links call it.
    pub name: String,
    /// What a reader sees above it.
    pub title: String,
    /// The metric that it is about.
    pub metric: &'static str,
    /// The jobs that it is about.
    pub jobs: JobCounts,
    /// Its numbers.
    pub content: Content,
}

/// The numbers of a finding.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// Differences of means.
    Contrast(Vec<ContrastRow>),
    /// A metric along a parameter.
    Curve(CurveFigure),
    /// Learning curves, a panel a scenario.
    LearningCurve(LearningFigure),
    /// Maps over two parameters, one an agent.
    HeatMap(Vec<HeatFigure>),
    /// Shares of actions, a panel an arm.
    ActionChoice(Vec<ActionPanel>),
    /// Settings in order, a ranking per agent.
    Selection(Vec<Ranking>),
    /// Context inference error along sigma.
    InferenceError(ErrorFigure),
}

impl Content {
    /// The rows of a contrast, if it is one.
    fn contrast_mut(&mut self) -> Option<&mut Vec<ContrastRow>> {
        match self {
            Content::Contrast(rows) => Some(rows),
            Content::Curve(_)
            | Content::LearningCurve(_)
            | Content::HeatMap(_)
            | Content::ActionChoice(_)
            | Content::Selection(_)
            | Content::InferenceError(_) => None,
        }
    }
}

/// How many jobs are in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JobCounts {
    /// With their completed run.
    pub completed: usize,
    /// Whose last run failed.
    pub failed: usize,
    /// That have not ended.
    pub open: usize,
}

impl JobCounts {
    /// Counts jobs.
    pub fn of<'j>(jobs: impl IntoIterator<Item = &'j JobRecord>) -> JobCounts {
        let mut counts = JobCounts::default();
        for job in jobs {
            *match job.status {
                JobStatus::Completed(_) => &mut counts.completed,
                JobStatus::Failed(_) => &mut counts.failed,
                JobStatus::Pending | JobStatus::Interrupted | JobStatus::Running => {
                    &mut counts.open
                }
            } += 1;
        }
        counts
    }

    /// All of them.
    pub fn total(&self) -> usize {
        self.completed + self.failed + self.open
    }
}

/// Carries out analyses, each on the jobs that it is about. P values are corrected over the families
/// that contrasts declare.
pub fn carry_out(
    analyses: &[(&Analysis, Vec<&JobRecord>)],
    published: Option<&Published>,
) -> Vec<Finding> {
    let find = |(analysis, jobs): &(&Analysis, Vec<&JobRecord>)| Finding {
        name: analysis.name.clone(),
        title: analysis.title.clone().unwrap_or_else(|| analysis.name.clone()),
        metric: analysis.metric,
        jobs: JobCounts::of(jobs.iter().copied()),
        content: content(analysis, jobs, published),
    };
    let mut findings: Vec<Finding> = analyses.iter().map(find).collect();
    let rows = findings.iter_mut().filter_map(|finding| finding.content.contrast_mut());
    contrast::correct_families(rows.flatten());
    findings
}

fn content(analysis: &Analysis, jobs: &[&JobRecord], published: Option<&Published>) -> Content {
    let metric = analysis.metric;
    match &analysis.kind {
        AnalysisKind::Contrast(contrast) => {
            Content::Contrast(contrast::rows(contrast, metric, jobs, published))
        }
        AnalysisKind::Curve { axis } => {
            Content::Curve(curve::figure(*axis, metric, jobs, published))
        }
        AnalysisKind::LearningCurve { window } => {
            Content::LearningCurve(learning_curve::figure(*window, jobs))
        }
        AnalysisKind::HeatMap { x, y, sides } => {
            Content::HeatMap(heat_map::figures((*x, *y), sides.as_ref(), metric, jobs, published))
        }
        AnalysisKind::ActionChoice { bins } => {
            Content::ActionChoice(action_choice::panels(*bins, jobs))
        }
        AnalysisKind::Selection { rule, reporting_seeds: _ } => {
            Content::Selection(selection::rankings(*rule, metric, jobs))
        }
        AnalysisKind::InferenceError => {
            Content::InferenceError(inference_error::figure(jobs, published))
        }
    }
}
