//! Declared estimates of causal effects.
//!
//! Estimates are not part of any job, so declaring, changing or dropping one changes no job.

use std::sync::Arc;

use crate::job::EstimateDeclaration;
use crate::text::Span;

/// An estimate of a manifest, and the agents whose jobs have it.
#[derive(Clone, Debug, PartialEq)]
pub struct DeclaredEstimate {
    /// The estimate.
    pub declaration: Arc<EstimateDeclaration>,
    /// The names of agents; `None` for all agents.
    pub agents: Option<Vec<String>>,
}

/// An estimate with the positions of its parts.
#[derive(Clone, Debug)]
pub(in crate::manifest) struct EstimateDraft {
    pub estimate: DeclaredEstimate,
    /// Where its table begins.
    pub span: Span,
    /// The keys that a check may refer to.
    pub spans: Vec<(&'static str, Span)>,
}

impl EstimateDraft {
    pub fn span_of(&self, key: &str) -> Span {
        let found = self.spans.iter().find(|(name, _)| *name == key);
        found.map_or(self.span, |(_, span)| *span)
    }
}
