//! Which columns of people a formula is linear in, and what the data must have so that it can be computed.

use std::collections::BTreeSet;

use crate::env::declared::expression::{Binary, ExpressionNode, Unary};
use crate::env::declared::model::{Definition, ModelFile, NamedExpression, Referent};

/// A coefficient: a column of people, or a parameter that a fit of everybody estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum FitTarget {
    Column(usize),
    ModelParameter(usize),
}

/// How a number depends on coefficients: it is linear in some of them given the others.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LinearForm {
    pub linear: BTreeSet<FitTarget>,
    pub other: BTreeSet<FitTarget>,
    /// Quantities that are drawn, and that the data do not have.
    pub drawn: BTreeSet<usize>,
}

impl LinearForm {
    fn is_known(&self) -> bool {
        self.linear.is_empty() && self.other.is_empty()
    }

    fn join(mut self, more: LinearForm) -> LinearForm {
        self.linear.extend(more.linear);
        self.other.extend(more.other);
        self.drawn.extend(more.drawn);
        self
    }

    fn nonlinear(mut self) -> LinearForm {
        self.other.append(&mut self.linear);
        self
    }
}

/// Forms of a model's formulas.
pub(super) struct Forms<'m> {
    pub model: &'m ModelFile,
    /// Which quantities the data give.
    pub given: &'m [bool],
    /// What can be a coefficient.
    pub is_coefficient: &'m dyn Fn(FitTarget) -> bool,
    /// By quantity, once it is known.
    known: Vec<Option<LinearForm>>,
}

impl<'m> Forms<'m> {
    pub fn new(
        model: &'m ModelFile,
        given: &'m [bool],
        is_coefficient: &'m dyn Fn(FitTarget) -> bool,
    ) -> Forms<'m> {
        Forms { model, given, is_coefficient, known: vec![None; model.quantities.len()] }
    }

    fn coefficient(&self, target: FitTarget) -> LinearForm {
        let linear = (self.is_coefficient)(target).then_some(target);
        LinearForm { linear: linear.into_iter().collect(), ..LinearForm::default() }
    }

    fn referent(&mut self, referent: Referent) -> LinearForm {
        match referent {
            Referent::One | Referent::Clock(_) => LinearForm::default(),
            Referent::Column(index) => self.coefficient(FitTarget::Column(index)),
            Referent::ModelParameter(index) => self.coefficient(FitTarget::ModelParameter(index)),
            Referent::Quantity(index) => self.quantity(index),
        }
    }

    /// The form of a quantity.
    pub fn quantity(&mut self, index: usize) -> LinearForm {
        if self.given[index] {
            return LinearForm::default();
        }
        if let Some(known) = &self.known[index] {
            return known.clone();
        }
        // A quantity that needs its own past is not linear in anything.
        self.known[index] = Some(LinearForm::default());
        let model = self.model;
        let form = match &model.quantities[index].definition {
            Definition::Action | Definition::Probability => LinearForm::default(),
            Definition::NamedExpression(formula) => self.formula(formula),
            Definition::Linear(terms) => terms.iter().fold(LinearForm::default(), |sum, term| {
                let factors = term.factors.iter().map(|factor| self.referent(*factor));
                let factors = factors.collect::<Vec<_>>().into_iter();
                let factors = factors.fold(LinearForm::default(), times);
                sum.join(times(self.referent(term.coefficient), factors))
            }),
            Definition::Replay(_)
            | Definition::DrawInstruction(..)
            | Definition::ProbabilityTable(..) => {
                LinearForm { drawn: [index].into(), ..LinearForm::default() }
            }
        };
        self.known[index] = Some(form.clone());
        form
    }

    /// The form of a formula.
    pub fn formula(&mut self, formula: &NamedExpression) -> LinearForm {
        let mut parts: Vec<LinearForm> = Vec::new();
        let mut windows = formula.windows.iter();
        for node in &formula.expression.nodes {
            let of = |index: &usize| parts[*index].clone();
            let part = match node {
                ExpressionNode::Number(_) => LinearForm::default(),
                ExpressionNode::WrittenName(name) => {
                    let form = self.referent(formula.targets[*name]);
                    let is_past = formula.expression.names[*name].back > 0;
                    if is_past { form.nonlinear() } else { form }
                }
                ExpressionNode::Unary(Unary::Minus, x) => of(x),
                ExpressionNode::Unary(_, x) => of(x).nonlinear(),
                ExpressionNode::Binary(Binary::Plus | Binary::Minus, [x, y]) => of(x).join(of(y)),
                ExpressionNode::Binary(Binary::Times, [x, y]) => times(of(x), of(y)),
                ExpressionNode::Binary(Binary::Divided, [x, y]) => of(x).join(of(y).nonlinear()),
                ExpressionNode::Binary(_, [x, y]) => of(x).join(of(y)).nonlinear(),
                ExpressionNode::If([condition, x, y]) => {
                    of(condition).nonlinear().join(of(x)).join(of(y))
                }
                ExpressionNode::PastWindow(_) => match windows.next() {
                    Some(window) => self.quantity(*window).nonlinear(),
                    None => LinearForm::default(),
                },
            };
            parts.push(part);
        }
        let mut form = parts.pop().unwrap_or_default();
        let other = form.other.clone();
        form.linear.retain(|target| !other.contains(target));
        form
    }
}

fn times(x: LinearForm, y: LinearForm) -> LinearForm {
    if x.is_known() || y.is_known() { x.join(y) } else { x.join(y).nonlinear() }
}
