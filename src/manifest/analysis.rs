//! What an author wants computed from the results: analyses, as the report draws them.
//!
//! Analyses are no part of any job: declaring, changing or dropping one runs nothing.

use super::analysis_kind::{AnalysisKind, DataPart};
use super::condition::Condition;
use super::source::{Located, Span};
use crate::key::Parameter;

/// A figure or table that an author declares with `[[analysis]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// What files and links call it; no other analysis of the manifest has it.
    pub name: String,
    /// What a reader sees above it; the name stands in where there is none.
    pub title: Option<String>,
    /// The metric of a run that it is about, one of [`super::ANALYSED_METRICS`].
    pub metric: &'static str,
    /// Which jobs it is about: those that meet every condition.
    pub conditions: Vec<Condition>,
    /// What it computes from them.
    pub kind: AnalysisKind,
}

/// An analysis as it is written.
#[derive(Clone, Debug)]
pub(super) struct AnalysisDraft {
    pub analysis: Analysis,
    /// Where its jobs and sides are named.
    pub conditions: Vec<Located<Condition>>,
    /// The parameters along its axes.
    pub axes: Vec<Located<Parameter>>,
    /// Where its table begins.
    pub span: Span,
}

impl Analysis {
    /// What a job has to meet to be one that the analysis is about: its conditions, and to be on
    /// one of its sides.
    pub fn of_jobs(&self) -> impl Iterator<Item = Condition> {
        let either = self.kind.sides().and_then(|sides| sides.first.or(&sides.second));
        self.conditions.iter().cloned().chain(either)
    }

    /// The part of the results that it is computed from.
    pub fn part(&self) -> DataPart {
        self.kind.part(self.metric)
    }
}
