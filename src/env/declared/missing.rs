//! Lags and windows that have no value at a person's first decisions, though a role needs them there.
//!
//! The first decisions are evaluated with what is known of every number: its value where it follows from the step alone,
//! that it is missing, or nothing. A model that is reported fails in every simulation, whatever its parameters are.

use crate::env::declared::expression::{Binary, ExpressionNode, Summary};
use crate::env::declared::model::{Clock, Definition, ModelFile, NamedExpression, Referent};
use crate::env::declared::numbers;
use crate::text::{Fault, FaultList, Span};

/// Maximum number of nodes and quantities that are evaluated, so that a long window costs no more than the rest of the reader.
const MOST_EVALUATED: usize = 1_000_000;

/// What is known of a number before the simulation.
#[derive(Clone, Copy, Debug, Default)]
enum Knowledge<'m> {
    Value(f64),
    /// It is missing, because of this lag or window.
    Missing(Absence<'m>),
    #[default]
    Nothing,
}

/// A lag or window without a value.
#[derive(Clone, Copy, Debug)]
struct Absence<'m> {
    formula: &'m NamedExpression,
    /// The index of a name, or of a window.
    part: Result<usize, usize>,
    step: usize,
}

/// Reports the lags and windows of a model that are missing where a number is needed.
pub(super) fn check(model: &ModelFile, faults: &mut FaultList) {
    let backs = model.quantities.iter().map(|quantity| quantity.back as usize);
    let count = model.quantities.len();
    let formulas = model.quantities.iter().flat_map(|one| ModelFile::formulas(&one.definition));
    let nodes: usize = formulas.map(|formula| formula.expression.nodes.len()).sum();
    let most = MOST_EVALUATED / (count + nodes);
    let steps = (1 + backs.max().unwrap_or(0)).min(model.horizon() as usize).min(most);
    let mut first = FirstDecisions {
        model,
        past: Vec::new(),
        last_missing: vec![None; count],
        now: Vec::new(),
        found: Vec::new(),
    };
    for _ in 0..steps {
        first.decide();
        // Behind a decision that may be the last one, nothing is known.
        let ends = model.roles.ends.map(|index| first.past[first.past.len() - 1][index]);
        if !ends.is_none_or(|ends| matches!(ends, Knowledge::Value(ends) if ends == 0.0)) {
            break;
        }
    }
    first.found.into_iter().for_each(|(_, fault)| faults.add(fault));
}

struct FirstDecisions<'m> {
    model: &'m ModelFile,
    /// \[decisions\], each \[quantities\].
    past: Vec<Vec<Knowledge<'m>>>,
    /// The last decision at which each quantity was missing, with the reason, \[quantities\].
    last_missing: Vec<Option<(usize, Absence<'m>)>>,
    now: Vec<Knowledge<'m>>,
    found: Vec<(Span, Fault)>,
}

impl<'m> FirstDecisions<'m> {
    fn decide(&mut self) {
        let model = self.model;
        self.now = vec![Knowledge::Nothing; model.quantities.len()];
        for index in model.order.iter().flatten() {
            let quantity = &model.quantities[*index];
            self.now[*index] = match &quantity.definition {
                Definition::Action | Definition::Probability | Definition::Replay(_) => {
                    Knowledge::Nothing
                }
                Definition::NamedExpression(formula) => self.formula(formula),
                // Whether a draw is made can depend on parameters: what is missing in it is reported where a role needs it.
                Definition::DrawInstruction(_, formulas)
                | Definition::ProbabilityTable(_, formulas) => {
                    let parameters = formulas.iter().map(|formula| self.formula(formula));
                    let missing = parameters.into_iter().find(Knowledge::is_missing);
                    missing.unwrap_or_default()
                }
                Definition::Linear(terms) => {
                    let parts = terms.iter().flat_map(|term| &term.factors);
                    let missing = parts.map(|part| self.target(*part)).find(Knowledge::is_missing);
                    missing.unwrap_or(Knowledge::Nothing)
                }
            };
        }
        let roles = &model.roles;
        let features = roles.features.iter().filter_map(|feature| match feature.source {
            Referent::Quantity(index) => Some(index),
            _ => None,
        });
        let others = [roles.outcome, roles.reward].into_iter();
        let others = others.chain(roles.available).chain(roles.ends);
        for index in roles.state.iter().copied().chain(features).chain(others) {
            let name = &model.quantities[index].name;
            let needed = match roles.state.contains(&index) {
                true => format!("`{name}` is recorded"),
                false => format!("`{name}` needs it"),
            };
            self.need(self.now[index], &needed);
        }
        let step = self.past.len();
        for (last, now) in self.last_missing.iter_mut().zip(&self.now) {
            if let Knowledge::Missing(absence) = now {
                *last = Some((step, *absence));
            }
        }
        self.past.push(std::mem::take(&mut self.now));
    }

    /// Reports a number that is missing where it is needed, once.
    fn need(&mut self, number: Knowledge<'m>, needed: &str) {
        let Knowledge::Missing(Absence { formula, part, step }) = number else { return };
        // The decisions that must be there, and what stands in the text.
        let (range, back, what, text) = match part {
            Ok(name) => {
                let name = &formula.expression.names[name];
                let lag = format!("{}[-{}]", name.text, name.back);
                (&name.span, name.back, format!("`{lag}`"), lag)
            }
            Err(window) => {
                let window = formula.expression.windows().nth(window);
                let window = window.expect("the window is in the formula");
                let back = window.length.unwrap_or(1);
                let what = format!("this window of {back} decisions");
                let what = if back == 1 { "this window".to_owned() } else { what };
                (&window.span, back, what, "…".to_owned())
            }
        };
        let span = formula.position.span(range);
        if self.found.iter().any(|(known, _)| *known == span) {
            return;
        }
        let says = format!("{what} has no value at decision {step}, where {needed}");
        let help = format!("give it one: default({text}, 0), or if(step < {back}, 0, {text})");
        self.found.push((span, Fault::at(span, says).help(help)));
    }

    fn target(&self, target: Referent) -> Knowledge<'m> {
        let (step, per_day) = (self.past.len() as u32, self.model.decisions_per_day);
        match target {
            Referent::One => Knowledge::Value(1.0),
            Referent::ModelParameter(_) | Referent::Column(_) => Knowledge::Nothing,
            Referent::Quantity(index) => self.now[index],
            Referent::Clock(Clock::Step) => Knowledge::Value(f64::from(step)),
            Referent::Clock(Clock::Day) => Knowledge::Value(f64::from(step / per_day)),
            Referent::Clock(Clock::Slot) => Knowledge::Value(f64::from(step % per_day)),
            Referent::Clock(Clock::CalendarDay) => Knowledge::Nothing,
        }
    }

    fn formula(&self, formula: &'m NamedExpression) -> Knowledge<'m> {
        let mut parts: Vec<Knowledge<'m>> = Vec::with_capacity(formula.expression.nodes.len());
        let mut windows = 0..formula.windows.len();
        for node in &formula.expression.nodes {
            let part = match node {
                ExpressionNode::Number(value) => Knowledge::Value(*value),
                ExpressionNode::WrittenName(name) => self.name(formula, *name),
                ExpressionNode::Unary(function, of) => match parts[*of] {
                    Knowledge::Value(x) => Knowledge::of(numbers::unary(*function, x)),
                    other => other,
                },
                ExpressionNode::Binary(Binary::Default, [x, y]) => match (parts[*x], parts[*y]) {
                    (Knowledge::Missing(_), y) => y,
                    (x, _) => x,
                },
                ExpressionNode::Binary(function, [x, y]) => match (parts[*x], parts[*y]) {
                    (Knowledge::Value(x), Knowledge::Value(y)) => {
                        Knowledge::of(numbers::binary(*function, x, y))
                    }
                    (x, y) => [x, y].into_iter().find(Knowledge::is_missing).unwrap_or_default(),
                },
                ExpressionNode::If([condition, one, other]) => {
                    match (parts[*condition], parts[*one], parts[*other]) {
                        (Knowledge::Value(condition), one, other) => {
                            if condition != 0.0 {
                                one
                            } else {
                                other
                            }
                        }
                        (missing @ Knowledge::Missing(_), ..) => missing,
                        (_, missing @ Knowledge::Missing(_), Knowledge::Missing(_)) => missing,
                        _ => Knowledge::Nothing,
                    }
                }
                ExpressionNode::PastWindow(window) => {
                    let index = windows.next().expect("every window has a quantity");
                    self.window(formula, index, (window.summary, window.length))
                }
            };
            parts.push(part);
        }
        parts.pop().unwrap_or_default()
    }

    fn name(&self, formula: &'m NamedExpression, index: usize) -> Knowledge<'m> {
        let back = formula.expression.names[index].back as usize;
        match formula.targets[index] {
            Referent::Quantity(quantity) if back > 0 => {
                let step = self.past.len();
                let absence = Absence { formula, part: Ok(index), step };
                let earlier = step.checked_sub(back);
                earlier.map_or(Knowledge::Missing(absence), |step| self.past[step][quantity])
            }
            target => self.target(target),
        }
    }

    fn window(
        &self,
        formula: &'m NamedExpression,
        index: usize,
        (summary, length): (Summary, Option<u32>),
    ) -> Knowledge<'m> {
        let step = self.past.len();
        let least = match (length, summary) {
            (Some(length), _) => length as usize,
            (None, Summary::Mean) => 1,
            (None, Summary::Sum | Summary::Count) => 0,
        };
        if step < least {
            return Knowledge::Missing(Absence { formula, part: Err(index), step });
        }
        let first = length.map_or(0, |length| step - length as usize);
        match self.last_missing[formula.windows[index]] {
            Some((last, absence)) if last >= first => Knowledge::Missing(absence),
            _ => Knowledge::Nothing,
        }
    }
}

impl Knowledge<'_> {
    /// What is known of a number that is computed; how one becomes missing by a function is found by simulations.
    fn of(value: f64) -> Self {
        if value.is_nan() { Knowledge::Nothing } else { Knowledge::Value(value) }
    }

    fn is_missing(&self) -> bool {
        matches!(self, Knowledge::Missing(_))
    }
}
