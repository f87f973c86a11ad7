//! A model file: what it declares, with names resolved and in an order of evaluation.

use crate::env::declared::distribution::DrawLaw;
use crate::env::declared::expression::Expression;
use crate::env::declared::rows::{ColumnFault, Numbers};
use crate::text::Span;

/// Maximum number of days.
pub(super) const MOST_DAYS: i64 = 10_000;

/// The models that manifests can name without a file: the test beds of Oralytics, `docs/oralytics.md`.
pub(super) static SHIPPED: [(&str, &str); 3] = [
    ("oralytics_v1", include_str!("../../../experiments/oralytics/v1.toml")),
    ("oralytics_v2", include_str!("../../../experiments/oralytics/v2.toml")),
    ("oralytics_v4", include_str!("../../../experiments/oralytics/v4.toml")),
];

/// A model.
#[derive(Clone, Debug, Default)]
pub struct ModelFile {
    pub(super) title: String,
    pub(super) unit: Option<String>,
    pub(super) actions: Vec<String>,
    pub(super) decisions_per_day: u32,
    pub(super) days: u32,
    pub(super) parameters: Vec<ModelParameter>,
    pub(super) people: PeopleDraw,
    /// How rows follow one another; `None` without rows.
    pub(super) replay: Option<ReplayOrder>,
    /// The names of the columns of rows.
    pub(super) replayed: Vec<String>,
    /// The columns that the file of people must have, in the order of their first use.
    pub(super) columns: Vec<NeededColumn>,
    pub(super) quantities: Vec<Quantity>,
    /// The quantities of each stage, each behind those that it is computed from.
    pub(super) order: [Vec<usize>; Moment::COUNT],
    pub(super) roles: Roles,
    /// What no role needs.
    pub(super) unused: Vec<(String, Span)>,
}

/// A parameter, with its default.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ModelParameter {
    pub name: String,
    pub default: f64,
    pub span: Span,
}

/// A column of the file of people.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NeededColumn {
    pub name: String,
    /// Another name that it may have.
    pub alias: Option<String>,
    /// Where the model first needs it.
    pub span: Span,
}

/// How the people of a trial are drawn from the rows of their file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum PeopleDraw {
    /// Each person is any row.
    #[default]
    WithReplacement,
    /// The first person is the first row, and so on; behind the last row comes the first.
    Each,
}

/// Which row of a person a decision has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReplayOrder {
    /// The row of the decision's number.
    Own,
    /// The same, and behind the last row comes the first.
    Cyclic,
    /// Any row.
    Random,
}

/// When a quantity is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Moment {
    /// Once per person.
    Person,
    /// Before the choice of an action.
    Before,
    /// After it.
    After,
}

impl Moment {
    pub const COUNT: usize = 3;
}

/// A number that the model computes: a variable, a block, or what a window or role needs.
#[derive(Clone, Debug)]
pub(super) struct Quantity {
    /// The name of a variable or block; the text of another quantity.
    pub name: String,
    pub span: Span,
    pub stage: Moment,
    pub definition: Definition,
    /// The number of earlier decisions of which single values are needed.
    pub back: u32,
}

/// How a quantity is computed.
#[derive(Clone, Debug)]
pub(super) enum Definition {
    /// The action of the decision.
    Action,
    /// The probability with which it was chosen.
    Probability,
    /// The column of the rows at this index.
    Replay(usize),
    /// By a formula.
    NamedExpression(NamedExpression),
    /// A draw, by the formulas of its parameters.
    DrawInstruction(DrawLaw, Vec<NamedExpression>),
    /// A row of a table of probabilities, by the formulas of what is given.
    ProbabilityTable(ProbabilityTable, Vec<NamedExpression>),
    /// The sum of products of a coefficient and factors.
    Linear(Vec<LinearTerm>),
}

impl Definition {
    /// What the quantity is computed from, each with how many decisions ago it is meant; windows are not among them.
    pub(super) fn referents(&self) -> Vec<(Referent, u32)> {
        if let Definition::Linear(terms) = self {
            let factors =
                |term: &LinearTerm| [term.coefficient].into_iter().chain(term.factors.clone());
            return terms.iter().flat_map(factors).map(|target| (target, 0)).collect();
        }
        let named = |formula: &NamedExpression| {
            let names = formula.expression.names.iter();
            formula
                .targets
                .iter()
                .zip(names)
                .map(|(target, name)| (*target, name.back))
                .collect::<Vec<_>>()
        };
        ModelFile::formulas(self).iter().flat_map(named).collect()
    }
}

/// A term of a block.
#[derive(Clone, Debug)]
pub(super) struct LinearTerm {
    /// The name of the coefficient.
    pub name: String,
    pub coefficient: Referent,
    pub factors: Vec<Referent>,
}

/// A table of probabilities of values, given other values.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ProbabilityTable {
    /// \[rows, given\].
    pub given: Vec<f64>,
    /// \[rows\]: the value, and its probability.
    pub values: Vec<(f64, f64)>,
}

/// An expression with the meaning of its names.
#[derive(Clone, Debug, Default)]
pub(super) struct NamedExpression {
    pub expression: Expression,
    /// \[names\].
    pub targets: Vec<Referent>,
    /// The quantity that each window summarises, \[windows\].
    pub windows: Vec<usize>,
    pub position: TextPosition,
}

/// Where the text of an expression stands in the file.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TextPosition {
    /// The first byte, if the text stands in the file as it is.
    pub start: Option<usize>,
    /// The value in the file.
    pub whole: (usize, usize),
}

impl TextPosition {
    /// The span of a part of the text.
    pub fn span(self, part: &std::ops::Range<usize>) -> Span {
        match self.start {
            Some(start) => Span { start: start + part.start, end: start + part.end },
            None => Span { start: self.whole.0, end: self.whole.1 },
        }
    }
}

/// What a name means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Referent {
    /// A clock.
    Clock(Clock),
    /// A parameter.
    ModelParameter(usize),
    /// A column of the file of people.
    Column(usize),
    /// A quantity.
    Quantity(usize),
    /// 1.
    One,
}

/// A number that depends on time alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Clock {
    /// The number of decisions before the present one.
    Step,
    /// The number of whole days before it.
    Day,
    /// The number of decisions of the same day before it.
    Slot,
    /// The day of the trial.
    CalendarDay,
}

impl Clock {
    /// The clocks by their names.
    pub const NAMED: [(&'static str, Clock); 4] = [
        ("step", Clock::Step),
        ("day", Clock::Day),
        ("slot", Clock::Slot),
        ("calendar_day", Clock::CalendarDay),
    ];
}

/// What the quantities are used for.
#[derive(Clone, Debug, Default)]
pub(super) struct Roles {
    pub outcome: usize,
    pub reward: usize,
    pub available: Option<usize>,
    pub ends: Option<usize>,
    pub features: Vec<RoleFeature>,
    /// The recorded quantities: those known before the choice, then those behind it.
    pub state: Vec<usize>,
}

/// A number that agents can observe.
#[derive(Clone, Debug)]
pub(super) struct RoleFeature {
    pub name: String,
    pub source: Referent,
    pub low: f64,
    pub high: f64,
    pub unit: String,
    pub meaning: String,
}

impl ModelFile {
    /// The number of decisions of a person.
    pub fn horizon(&self) -> u32 {
        self.days * self.decisions_per_day
    }

    /// The number of recorded quantities that follow the choice of the action; they are the last ones.
    pub(super) fn late_state(&self) -> usize {
        let stage = |index: &&usize| self.quantities[**index].stage == Moment::After;
        self.roles.state.iter().filter(stage).count()
    }

    /// The formulas of a quantity.
    pub(super) fn formulas(definition: &Definition) -> &[NamedExpression] {
        match definition {
            Definition::NamedExpression(formula) => std::slice::from_ref(formula),
            Definition::DrawInstruction(_, formulas)
            | Definition::ProbabilityTable(_, formulas) => formulas,
            _ => &[],
        }
    }
}

impl ModelFile {
    /// The names that expressions can use, apart from columns of people.
    pub(super) fn names(&self) -> Vec<&str> {
        let quantities = self.quantities.iter().map(|quantity| quantity.name.as_str());
        let parameters = self.parameters.iter().map(|parameter| parameter.name.as_str());
        let clocks = Clock::NAMED.iter().map(|(name, _)| *name);
        let is_word = |name: &&str| name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        quantities.chain(parameters).chain(clocks).filter(is_word).collect()
    }
}

impl NeededColumn {
    /// The index of the column in a file.
    ///
    /// **Errors**: the file has no such column, or a text in it.
    pub fn find(&self, people: &Numbers) -> Result<usize, ColumnFault> {
        match (people.column(&self.name), &self.alias) {
            (Err(ColumnFault::Missing), Some(alias)) => people.column(alias),
            (found, _) => found,
        }
    }
}
