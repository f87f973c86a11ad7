//! Declared analyses, which the report computes from the results.
//!
//! Analyses are not part of any job, so declaring, changing or dropping one runs no job.

use crate::job::DataPart;
use crate::job::ParticipantRange;
use crate::job::{Condition, MetricName};
use crate::key::Parameter;
use crate::manifest::analysis::figure_keys::FigureKeys;
use crate::manifest::analysis::kind::AnalysisKind;
use crate::text::{Located, Span};

/// A figure or table that an author declares with `[[analysis]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// The name in files and links, unique in the manifest.
    pub name: String,
    /// The heading in the report; the name if none was given.
    pub title: Option<String>,
    /// The metric to analyse.
    pub metric: MetricName,
    /// The participants whose test episodes are analysed; `None` for all.
    pub participants: Option<ParticipantRange>,
    /// The conditions that a job must meet to be analysed.
    pub conditions: Vec<Condition>,
    /// The layout of its figures.
    pub figure: FigureKeys,
    /// The kind of analysis.
    pub kind: AnalysisKind,
}

/// An analysis with the positions of its parts in the manifest.
#[derive(Clone, Debug)]
pub(in crate::manifest) struct AnalysisDraft {
    /// Its index among the analyses of the file.
    pub index: usize,
    pub analysis: Analysis,
    /// The conditions on its jobs and sides, with their positions.
    pub conditions: Vec<Located<Condition>>,
    /// Its participants, with their position.
    pub participants: Option<Located<ParticipantRange>>,
    /// The key that distinguishes its panels, with its position; at most one.
    pub panels: Vec<Located<Parameter>>,
    /// The parameters along its axes, with their positions.
    pub axes: Vec<Located<Parameter>>,
    /// Where its table begins.
    pub span: Span,
}

impl Analysis {
    /// The conditions on the jobs to analyse, including the conditions of its sides.
    pub fn of_jobs(&self) -> impl Iterator<Item = Condition> {
        let either = self.kind.sides().and_then(|sides| sides.first.or(&sides.second));
        self.conditions.iter().cloned().chain(either)
    }

    /// The part of the results that the analysis needs.
    pub fn part(&self) -> DataPart {
        match self.participants {
            Some(range) => DataPart::Participants(range),
            None => self.kind.rules().part(self.metric),
        }
    }
}
