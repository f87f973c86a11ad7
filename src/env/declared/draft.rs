//! A model as it is written, before its names have a meaning.

use crate::env::declared::model::{ModelFile, NamedExpression, Quantity};
use crate::text::Span;

/// A model before its names are resolved.
#[derive(Debug, Default)]
pub(super) struct ModelDraft {
    /// Its simple values; it has no quantity yet.
    pub model: ModelFile,
    /// The person's draws, then the variables.
    pub quantities: Vec<Quantity>,
    pub blocks: Vec<CoefficientBlock>,
    pub roles: DraftRoles,
    /// Names of variables, blocks and parameters that were faulty, so that their use is no second fault.
    pub faulty: Vec<String>,
}

/// A block of coefficients.
#[derive(Debug)]
pub(super) struct CoefficientBlock {
    pub name: String,
    pub span: Span,
    pub prefix: String,
    /// Each feature with its position.
    pub features: Vec<(String, Span)>,
    /// The block whose features it has.
    pub same_as: Option<(String, Span)>,
}

/// The roles as they are written.
#[derive(Debug, Default)]
pub(super) struct DraftRoles {
    pub outcome: Option<NamedExpression>,
    pub reward: Option<NamedExpression>,
    pub available: Option<NamedExpression>,
    pub ends: Option<NamedExpression>,
    pub features: Vec<DraftFeature>,
    pub state: Option<Vec<(String, Span)>>,
    /// Where the table stands.
    pub span: Option<Span>,
    pub is_outcome_faulty: bool,
}

/// A feature as it is written.
#[derive(Debug)]
pub(super) struct DraftFeature {
    pub name: String,
    pub span: Span,
    pub low: f64,
    pub high: f64,
    pub unit: String,
    pub meaning: String,
}
