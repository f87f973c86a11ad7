//! Prediction of how figures of a manifest will be split into panels, before any job has run.

use super::figure::MOST_ARMS;
use super::kinds::drawn;
use super::names::Names;
use crate::analyse::declared::carry_out;
use crate::manifest::{AnalysisKind, Condition, Manifest};
use crate::plan::{self, PlannedJob};
use crate::record::{JobRecord, JobStatus, SharedSettings};

/// Maximum number of jobs of one seed for which splits are predicted. Larger figures are
/// unreadable.
const MOST_JOBS: usize = 5000;

/// The figures that have too many arms for one panel and are split, as sentences without their full stop.
pub fn splits(manifest: &Manifest) -> Vec<String> {
    let drawn_together = manifest.analyses.iter().filter(|analysis| match analysis.kind {
        AnalysisKind::Curve { .. } | AnalysisKind::LearningCurve { .. } => {
            analysis.figure.panel.is_none()
        }
        AnalysisKind::Contrast(_)
        | AnalysisKind::HeatMap { .. }
        | AnalysisKind::ActionChoice { .. }
        | AnalysisKind::Selection { .. }
        | AnalysisKind::Recovery(_)
        | AnalysisKind::InferenceError => false,
    });
    let analyses: Vec<_> = drawn_together.collect();
    if analyses.is_empty() {
        return Vec::new();
    }
    let seed = manifest.seeds.first();
    let of_one_seed = plan::jobs(manifest).filter(|planned| Some(&planned.job.seed) == seed);
    let of_one_seed: Vec<_> = of_one_seed.take(MOST_JOBS + 1).collect();
    if of_one_seed.len() > MOST_JOBS {
        return Vec::new();
    }
    let mut shared = SharedSettings::default();
    let mut record = |planned: &PlannedJob| {
        JobRecord::sharing(&mut shared, planned, planned.form.key(), JobStatus::Pending)
    };
    let jobs: Vec<JobRecord> = of_one_seed.iter().map(&mut record).collect();
    let concerned = |conditions: Vec<Condition>| -> Vec<&JobRecord> {
        jobs.iter().filter(|job| conditions.iter().all(|one| one.is_met_by(job))).collect()
    };
    let with_jobs: Vec<_> = analyses
        .iter()
        .map(|analysis| (*analysis, concerned(analysis.of_jobs().collect())))
        .collect();
    let names = Names::default();
    let sentence = |finding| {
        let finding = names.finding(finding);
        let kind = drawn(&finding.content);
        let (arms, split) = (kind.arms().len(), kind.split()?);
        let is_split = split.panels.len() > 1 && !split.added.is_empty();
        is_split.then(|| {
            format!(
                "the figure of `{}` has {arms} arms, more than {MOST_ARMS} in a panel: it is split into {} \
                 panels by {}; `panel` chooses another key",
                finding.name,
                split.panels.len(),
                split.added.iter().map(|key| Names::plain(key)).collect::<Vec<_>>().join(" and ")
            )
        })
    };
    carry_out(&with_jobs, None).iter().filter_map(sentence).collect()
}
