//! The analyses that a manifest declares, carried out on the jobs of its experiment.
//!
//! In: analyses, jobs with their outcomes, published numbers. Out: [`Finding`]s, the numbers of a
//! figure or table with the seeds behind them. A number that cannot be computed is an
//! [`Undefined`](super::Undefined) with its reason, and missing seeds are counted.
//!
//! It neither draws nor writes findings.

mod action_choice;
mod arm;
mod contrast;
mod curve;
mod days;
mod effects;
mod heat_map;
mod inference_error;
mod learned;
mod learning_curve;
mod operating;
mod pairs;
mod published;
mod randomisation;
mod recovery;
mod replay;
mod reproduction;
mod shrinkage;
mod summary;

pub use action_choice::{ActionPanel, BinShares};
pub use arm::{Arm, ArmId, condense, implied, is_at, varying};
pub use contrast::{ContrastFigure, ContrastRow, TestFamily};
pub use curve::{ALPHA, Apart, CurveFigure, CurveLine, Ends, LinePoint, Trends};
pub use days::{DaysFigure, PersonDays};
pub use effects::{EffectRow, EffectsFigure};
pub use heat_map::{HeatFigure, HeatTile, PeakLead, Scale, heat_range};
pub use inference_error::{ErrorFigure, ErrorPoint};
pub use learned::{LearnedFigure, LearnedPanel, LearnedPoint, OverTrials};
pub use learning_curve::{HighestEnd, LearningFigure, LearningLine, LearningPanel};
pub use operating::{Diagnosand, FEW_TRIALS, OperatingFigure, OperatingRow, Sought, Term};
pub use randomisation::{DrawnPoint, RandomisationFigure, RandomisationTest};
pub use recovery::{RecoveryRow, ScenarioOptimum};
pub use replay::{ReplayFigure, ReplayRow, SAME};
pub use reproduction::{Comparison, Distance, Reproduction, reproduce};
pub use shrinkage::{ShrinkageFigure, ShrinkagePanel, TrialOfPeople};
pub use summary::{AgentSummary, ArmSummary, share_of_optimum, summarise_agents, summarise_arms};

use std::collections::HashSet;

use crate::job::{Measure, ParticipantRange};
use crate::manifest::{Analysis, AnalysisKind, Published};
use crate::record::{JobRecord, JobStatus};

/// The result of an analysis.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The name in files and links.
    pub name: String,
    /// The heading in the report.
    pub title: String,
    /// The metric analysed.
    pub metric: Measure,
    /// The participants whose test episodes are analysed; all if `None`.
    pub participants: Option<ParticipantRange>,
    /// The numbers of jobs analysed.
    pub jobs: JobCounts,
    /// The numbers of the finding.
    pub content: FindingContent,
}

/// The numbers of a finding.
#[derive(Clone, Debug, PartialEq)]
pub enum FindingContent {
    /// Differences of means.
    Contrast(ContrastFigure),
    /// A metric along a parameter.
    Curve(CurveFigure),
    /// The days of single people.
    Days(DaysFigure),
    /// Learning curves, one panel per scenario.
    LearningCurve(LearningFigure),
    /// Maps over two parameters, one per agent.
    HeatMap(Vec<HeatFigure>),
    /// Shares of actions, one panel per arm.
    ActionChoice(Vec<ActionPanel>),
    /// Recovered shares of a loss.
    Recovery(Vec<RecoveryRow>),
    /// The behaviour of estimates over trials.
    Operating(OperatingFigure),
    /// What trials learned about states.
    Learned(LearnedFigure),
    /// What trials learned about the differences between people.
    Shrinkage(ShrinkageFigure),
    /// Whether the actions of a recorded trial were drawn as recorded.
    Randomisation(RandomisationFigure),
    /// Estimates of single jobs.
    Effects(EffectsFigure),
    /// Replayed beside recorded probabilities.
    Replay(ReplayFigure),
    /// The rate at which the most likely context is wrong.
    InferenceError(ErrorFigure),
}

impl FindingContent {
    /// The rows, if the content is a contrast.
    fn contrast_mut(&mut self) -> Option<&mut Vec<ContrastRow>> {
        match self {
            FindingContent::Contrast(figure) => Some(&mut figure.rows),
            FindingContent::Curve(_)
            | FindingContent::Days(_)
            | FindingContent::LearningCurve(_)
            | FindingContent::HeatMap(_)
            | FindingContent::ActionChoice(_)
            | FindingContent::Recovery(_)
            | FindingContent::Operating(_)
            | FindingContent::Learned(_)
            | FindingContent::Shrinkage(_)
            | FindingContent::Randomisation(_)
            | FindingContent::Effects(_)
            | FindingContent::Replay(_)
            | FindingContent::InferenceError(_) => None,
        }
    }
}

/// The number of jobs in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JobCounts {
    /// Jobs with a completed run.
    pub completed: usize,
    /// Jobs whose last run failed.
    pub failed: usize,
    /// Unfinished jobs.
    pub open: usize,
}

impl JobCounts {
    /// Counts jobs by state; agents with equal content share a job, which counts once.
    pub fn of<'j>(jobs: impl IntoIterator<Item = &'j JobRecord>) -> JobCounts {
        let mut counts = JobCounts::default();
        let mut seen = HashSet::new();
        for job in jobs.into_iter().filter(|job| seen.insert(job.job_key)) {
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

    /// All jobs.
    pub fn total(&self) -> usize {
        self.completed + self.failed + self.open
    }
}

/// Runs analyses, each on its own jobs, whose returns have the unit `return_unit`. P values are corrected over the families that contrasts
/// declare.
pub fn carry_out(
    analyses: &[(&Analysis, Vec<&JobRecord>)],
    published: Option<&Published>,
    return_unit: &'static str,
) -> Vec<Finding> {
    let find = |(analysis, jobs): &(&Analysis, Vec<&JobRecord>)| Finding {
        name: analysis.name.clone(),
        title: analysis.title.clone().unwrap_or_else(|| analysis.name.clone()),
        metric: analysis.metric.in_unit(return_unit),
        participants: analysis.participants,
        jobs: JobCounts::of(jobs.iter().copied()),
        content: content(analysis, jobs, published),
    };
    let mut findings: Vec<Finding> = analyses.iter().map(find).collect();
    let rows = findings.iter_mut().filter_map(|finding| finding.content.contrast_mut());
    contrast::correct_families(rows.flatten());
    findings
}

fn content(
    analysis: &Analysis,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> FindingContent {
    let Some(range) = analysis.participants else {
        return content_of(analysis, jobs, published);
    };
    // Published numbers are over all participants, so they are not compared with a subset.
    let among: Vec<JobRecord> = jobs.iter().map(|job| job.among(range)).collect();
    content_of(analysis, &among.iter().collect::<Vec<_>>(), None)
}

fn content_of(
    analysis: &Analysis,
    jobs: &[&JobRecord],
    published: Option<&Published>,
) -> FindingContent {
    let metric = analysis.metric;
    match &analysis.kind {
        AnalysisKind::Contrast(contrast) => {
            FindingContent::Contrast(contrast::figure(contrast, metric, jobs, published))
        }
        AnalysisKind::Curve(curve) => {
            FindingContent::Curve(curve::figure(curve.x, metric, jobs, published))
        }
        AnalysisKind::Days(kind) => FindingContent::Days(days::figure(kind, jobs)),
        AnalysisKind::LearningCurve(curve) => {
            FindingContent::LearningCurve(learning_curve::figure(curve.window, jobs))
        }
        AnalysisKind::HeatMap(map) => {
            FindingContent::HeatMap(heat_map::figures(map, metric, jobs, published))
        }
        AnalysisKind::ActionChoice(choice) => {
            FindingContent::ActionChoice(action_choice::panels(choice.bins.0, jobs))
        }
        AnalysisKind::Recovery(recovery) => {
            FindingContent::Recovery(recovery::rows(recovery, jobs))
        }
        AnalysisKind::OperatingCharacteristics(kind) => {
            FindingContent::Operating(operating::figure(kind, jobs))
        }
        AnalysisKind::DidItLearn(kind) => FindingContent::Learned(learned::figure(kind, jobs)),
        AnalysisKind::Shrinkage(kind) => FindingContent::Shrinkage(shrinkage::figure(kind, jobs)),
        AnalysisKind::Randomisation(_) => {
            FindingContent::Randomisation(randomisation::figure(jobs))
        }
        AnalysisKind::Effects(kind) => {
            FindingContent::Effects(effects::figure(kind, jobs, published))
        }
        AnalysisKind::Replay(_) => FindingContent::Replay(replay::figure(jobs)),
        AnalysisKind::InferenceError(_) => {
            FindingContent::InferenceError(inference_error::figure(jobs, published))
        }
    }
}
