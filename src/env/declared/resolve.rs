//! Gives every name of a model its meaning, and every quantity its stage and order.

use std::collections::{HashMap, HashSet};

use crate::env::declared::draft::{CoefficientBlock, DraftRoles, ModelDraft};
use crate::env::declared::expression::{Binary, Expression, ExpressionNode, Summary, WrittenName};
use crate::env::declared::model::{
    Clock, Definition, LinearTerm, ModelFile, Moment, NamedExpression, NeededColumn, Quantity,
    Referent, RoleFeature, Roles, TextPosition,
};
use crate::env::declared::numbers;
use crate::text::{Fault, FaultList, Span, shortened};

/// The model of a draft. Every fault is reported; with any fault, the model serves for nothing.
pub(super) fn resolve(draft: ModelDraft, faults: &mut FaultList) -> ModelFile {
    let ModelDraft { model, quantities, blocks, roles, faulty } = draft;
    let mut resolver = Resolver { model, faults, known: HashMap::new(), faulty };
    resolver.add_quantities(quantities, &blocks);
    let own = resolver.model.quantities.len();
    resolver.resolve_formulas();
    resolver.resolve_blocks(blocks, own);
    let is_state_written = roles.state.is_some();
    let features = resolver.resolve_roles(roles);
    resolver.resolve_formulas();
    resolver.check_memory();
    resolver.order();
    resolver.check_stages(&features);
    resolver.check_use(is_state_written);
    resolver.check_constants();
    resolver.model
}

/// Maximum numbers of quantities, and of earlier values that are kept of a person.
const MOST_QUANTITIES: usize = 5000;
const MOST_REMEMBERED: u64 = 20_000;

struct Resolver<'f> {
    model: ModelFile,
    faults: &'f mut FaultList,
    /// What names mean.
    known: HashMap<String, Referent>,
    /// Names whose declaration is faulty.
    faulty: Vec<String>,
}

const NOWHERE: Span = Span { start: 0, end: 0 };

impl Resolver<'_> {
    fn quantity(&mut self, name: &str, span: Span, stage: Moment, definition: Definition) -> usize {
        let name = name.to_owned();
        self.model.quantities.push(Quantity { name, span, stage, definition, back: 0 });
        self.model.quantities.len() - 1
    }

    fn name(&mut self, name: &str, span: Span, target: Referent) {
        if self.known.insert(name.to_owned(), target).is_some() {
            let says = format!("`{}` names two things", shortened(name));
            let help = "parameters, rows, draws of people, blocks and variables share their names";
            self.faults.add(Fault::at(span, says).help(help));
        }
    }

    fn add_quantities(&mut self, quantities: Vec<Quantity>, blocks: &[CoefficientBlock]) {
        for (name, clock) in Clock::NAMED {
            self.known.insert(name.to_owned(), Referent::Clock(clock));
        }
        let action = self.quantity("action", NOWHERE, Moment::After, Definition::Action);
        self.known.insert("action".to_owned(), Referent::Quantity(action));
        let probability =
            self.quantity("probability", NOWHERE, Moment::After, Definition::Probability);
        self.known.insert("probability".to_owned(), Referent::Quantity(probability));
        let parameters = self.model.parameters.clone();
        for (index, parameter) in parameters.iter().enumerate() {
            self.name(&parameter.name, parameter.span, Referent::ModelParameter(index));
        }
        for (index, name) in self.model.replayed.clone().iter().enumerate() {
            let target = self.quantity(name, NOWHERE, Moment::Before, Definition::Replay(index));
            self.name(name, NOWHERE, Referent::Quantity(target));
        }
        for quantity in quantities {
            let target = Referent::Quantity(self.model.quantities.len());
            self.name(&quantity.name, quantity.span, target);
            self.model.quantities.push(quantity);
        }
        for block in blocks {
            let definition = Definition::Linear(Vec::new());
            let target = self.quantity(&block.name, block.span, Moment::Before, definition);
            self.name(&block.name, block.span, Referent::Quantity(target));
        }
    }

    /// Resolves the names in the formulas of all quantities whose names are not resolved yet.
    fn resolve_formulas(&mut self) {
        // Windows append quantities, whose formulas have their turn.
        let mut index = 0;
        while index < self.model.quantities.len() {
            let definition =
                std::mem::replace(&mut self.model.quantities[index].definition, Definition::Action);
            self.model.quantities[index].definition = match definition {
                Definition::NamedExpression(formula) => {
                    Definition::NamedExpression(self.formula(formula))
                }
                Definition::DrawInstruction(distribution, formulas) => Definition::DrawInstruction(
                    distribution,
                    formulas.into_iter().map(|formula| self.formula(formula)).collect(),
                ),
                Definition::ProbabilityTable(table, formulas) => Definition::ProbabilityTable(
                    table,
                    formulas.into_iter().map(|formula| self.formula(formula)).collect(),
                ),
                other => other,
            };
            index += 1;
        }
    }

    fn formula(&mut self, mut formula: NamedExpression) -> NamedExpression {
        if !formula.targets.is_empty() || !formula.windows.is_empty() {
            return formula;
        }
        let position = formula.position;
        let names = formula.expression.names.iter();
        formula.targets = names.map(|name| self.target(name, position.span(&name.span))).collect();
        let windows: Vec<_> = formula.expression.windows().cloned().collect();
        for window in windows {
            let span = position.span(&window.span);
            if let Some(factor) = &window.factor {
                self.check_factor(factor, position, span);
            }
            let length = window.length.unwrap_or(0);
            if length >= self.model.horizon() {
                let says = format!(
                    "a window of {length} decisions is never full: a person has {}",
                    self.model.horizon()
                );
                self.faults.add(Fault::at(span, says).help("shorten it, or lengthen `days`"));
            }
            let mut expression = window.of;
            if window.summary == Summary::Count {
                // What is counted is 1.
                let last = expression.nodes.len() - 1;
                expression.nodes.push(ExpressionNode::Number(0.0));
                expression.nodes.push(ExpressionNode::Binary(Binary::Unequal, [last, last + 1]));
            }
            let inner = NamedExpression { expression, position, ..NamedExpression::default() };
            let name = "a window".to_owned();
            let index =
                self.quantity(&name, span, Moment::Before, Definition::NamedExpression(inner));
            self.model.quantities[index].back = length;
            formula.windows.push(index);
        }
        formula
    }

    /// A factor of a window is the same for everybody at all times.
    fn check_factor(&mut self, factor: &Expression, position: TextPosition, span: Span) {
        for name in &factor.names {
            if !matches!(self.known.get(&name.text), Some(Referent::ModelParameter(_)))
                || name.back > 0
            {
                let says = format!(
                    "the factor of a window has numbers and parameters only, not `{}`",
                    name.text
                );
                self.faults.add(Fault::at(position.span(&name.span), says));
            }
        }
        if factor.windows().next().is_some() {
            self.faults.add(Fault::at(span, "the factor of a window has no window"));
        }
    }

    fn target(&mut self, name: &WrittenName, span: Span) -> Referent {
        let Some(target) = self.known.get(&name.text).copied() else {
            if self.faulty.contains(&name.text) {
                return Referent::One;
            }
            if name.back > 0 {
                let says = format!(
                    "`{}[-{}]`: there is no variable `{}`",
                    name.text, name.back, name.text
                );
                self.unknown(&name.text, span, says);
                return Referent::One;
            }
            return self.column(&name.text, None, span);
        };
        if name.back > 0 {
            match target {
                Referent::Quantity(index)
                    if self.model.quantities[index].stage != Moment::Person =>
                {
                    if name.back >= self.model.horizon() {
                        let says = format!(
                            "a lag of {} decisions: a person has {}",
                            name.back,
                            self.model.horizon()
                        );
                        self.faults.add(Fault::at(span, says));
                    }
                    let quantity = &mut self.model.quantities[index];
                    quantity.back = quantity.back.max(name.back);
                }
                Referent::Clock(_) => {
                    let says = format!("a clock has no lag: write {} - {}", name.text, name.back);
                    self.faults.add(Fault::at(span, says));
                }
                _ => {
                    let says =
                        format!("`{}` does not change between decisions: it has no lag", name.text);
                    self.faults.add(Fault::at(span, says));
                }
            }
        }
        target
    }

    fn unknown(&mut self, name: &str, span: Span, says: String) {
        let fault = Fault::at(span, says);
        let names: Vec<&str> = self.known.keys().map(String::as_str).collect();
        let mut names = names;
        names.sort_unstable();
        self.faults.add(fault.nearest(name, names));
    }

    /// A column of the file of people.
    fn column(&mut self, name: &str, alias: Option<String>, span: Span) -> Referent {
        let known = self.model.columns.iter().position(|column| column.name == name);
        Referent::Column(known.unwrap_or_else(|| {
            self.model.columns.push(NeededColumn { name: name.to_owned(), alias, span });
            self.model.columns.len() - 1
        }))
    }

    fn resolve_blocks(&mut self, blocks: Vec<CoefficientBlock>, own: usize) {
        // Blocks are the last ones of the quantities with a name.
        let first = own - blocks.len();
        for (place, block) in blocks.iter().enumerate() {
            let features = match &block.same_as {
                None => &block.features,
                Some((other, span)) => {
                    let known = blocks.iter().find(|known| known.name == *other);
                    match known.filter(|known| known.same_as.is_none()) {
                        Some(known) => &known.features,
                        None => {
                            let says = format!(
                                "`{}`: there is no block `{other}` with a list of features",
                                block.name
                            );
                            let names: Vec<&str> =
                                blocks.iter().map(|block| block.name.as_str()).collect();
                            self.faults.add(Fault::at(*span, says).nearest(other, names));
                            continue;
                        }
                    }
                }
            };
            let terms = features.iter().map(|(feature, span)| self.term(block, feature, *span));
            let terms: Vec<LinearTerm> = terms.collect();
            if terms.is_empty() {
                self.faults.add(Fault::at(block.span, format!("`{}` has no features", block.name)));
            }
            self.model.quantities[first + place].definition = Definition::Linear(terms);
        }
    }

    /// A coefficient and its feature: a variable, a product of variables, or 1.
    fn term(&mut self, block: &CoefficientBlock, feature: &str, span: Span) -> LinearTerm {
        let names = feature.split('*').map(str::trim).filter(|name| *name != "1");
        let factors = names
            .map(|name| {
                let is_word = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
                if name.is_empty() || !is_word {
                    let says = format!("`{}` is not a feature", shortened(feature));
                    let help = "a feature is a variable, a product as in \"sent*dose\", or \"1\"";
                    self.faults.add(Fault::at(span, says).help(help));
                    return Referent::One;
                }
                let name = WrittenName { text: name.to_owned(), back: 0, span: 0..0 };
                self.target(&name, span)
            })
            .collect();
        let plain: String = feature.chars().filter(|c| !c.is_whitespace()).collect();
        let name = format!("{}{plain}", block.prefix);
        let alias = (plain == "1").then(|| format!("{}one", block.prefix));
        let coefficient = match self.known.get(&name) {
            Some(target) => *target,
            _ => self.column(&name, alias, span),
        };
        LinearTerm { name, coefficient, factors }
    }

    /// Adds the quantities of the roles. Returns the features with their positions.
    fn resolve_roles(&mut self, roles: DraftRoles) -> Vec<(Referent, Span)> {
        let span = roles.span.unwrap_or(NOWHERE);
        let mut role = |name: &str, formula: Option<NamedExpression>| {
            let formula = formula?;
            let span = formula.position.span(&(0..0));
            let span = Span { end: formula.position.whole.1, ..span };
            Some(self.quantity(
                &format!("roles.{name}"),
                span,
                Moment::Before,
                Definition::NamedExpression(formula),
            ))
        };
        let outcome = role("outcome", roles.outcome);
        let reward = role("reward", roles.reward);
        let [available, ends] = [role("available", roles.available), role("ends", roles.ends)];
        if outcome.is_none() && !roles.is_outcome_faulty {
            let fault =
                Fault::at(span, "[roles]: `outcome` is missing: what a person's return sums");
            self.faults.add(fault);
        }
        let outcome = outcome.unwrap_or(0);
        let (mut features, mut targets) = (Vec::<RoleFeature>::new(), Vec::new());
        for feature in roles.features {
            let name = WrittenName { text: feature.name.clone(), back: 0, span: 0..0 };
            let source = self.target(&name, feature.span);
            if features.iter().any(|known| known.name == feature.name) {
                let says = format!("feature `{}` is listed twice", feature.name);
                self.faults.add(Fault::at(feature.span, says));
            }
            targets.push((source, feature.span));
            features.push(RoleFeature {
                name: feature.name,
                source,
                low: feature.low,
                high: feature.high,
                unit: feature.unit,
                meaning: feature.meaning,
            });
        }
        let mut state = Vec::new();
        for (name, span) in roles.state.iter().flatten() {
            match self.known.get(name) {
                Some(Referent::Quantity(index)) if !state.contains(index) => state.push(*index),
                Some(Referent::Quantity(_)) => {
                    self.faults.add(Fault::at(*span, format!("`{name}` is recorded twice")));
                }
                _ if self.faulty.contains(name) => {}
                _ => self.unknown(
                    name,
                    *span,
                    format!("[roles]: there is no variable `{name}` to record"),
                ),
            }
        }
        if roles.state.is_none() {
            // The variables; draws of people are recorded as well, because they are what a person is.
            let is_recorded = |quantity: &Quantity| {
                !matches!(quantity.definition, Definition::Action | Definition::Probability)
                    && self.known.contains_key(&quantity.name)
            };
            let recorded = self.model.quantities.iter().enumerate();
            state = recorded.filter(|(_, one)| is_recorded(one)).map(|(index, _)| index).collect();
        }
        self.model.roles =
            Roles { outcome, reward: reward.unwrap_or(outcome), available, ends, features, state };
        targets
    }

    /// The quantities that a quantity is computed from in the same decision.
    fn sources(&self, index: usize) -> Vec<usize> {
        let referents = self.model.quantities[index].definition.referents();
        let present = referents.into_iter().filter(|(_, back)| *back == 0);
        let quantity = |(target, _)| match target {
            Referent::Quantity(source) => Some(source),
            _ => None,
        };
        present.filter_map(quantity).collect()
    }

    /// Reports a model that remembers more than memory has room for.
    fn check_memory(&mut self) {
        let remembered: u64 =
            self.model.quantities.iter().map(|quantity| u64::from(quantity.back)).sum();
        let (count, windows) = (self.model.quantities.len(), MOST_QUANTITIES);
        if remembered > MOST_REMEMBERED || count > windows {
            let says = format!(
                "the model has {count} variables, blocks and windows, of which {remembered} earlier values of each person \
                 are kept; the maximum is {windows} and {MOST_REMEMBERED}"
            );
            self.faults.add(Fault::whole(says).help("shorten lags and windows, or use fewer"));
        }
    }

    /// Puts every quantity behind its sources, and into its stage.
    fn order(&mut self) {
        let count = self.model.quantities.len();
        // 0: not visited, 1: on the path, 2: done.
        let mut marks = vec![0u8; count];
        let mut order = Vec::with_capacity(count);
        let mut in_cycle = HashSet::new();
        for start in 0..count {
            if marks[start] > 0 {
                continue;
            }
            let mut path = vec![(start, self.sources(start))];
            marks[start] = 1;
            while let Some((index, left)) = path.last_mut() {
                let index = *index;
                match left.pop() {
                    Some(next) if marks[next] == 0 => {
                        marks[next] = 1;
                        path.push((next, self.sources(next)));
                    }
                    Some(next) if marks[next] == 1 => {
                        let from = path.iter().position(|(one, _)| *one == next).unwrap_or(0);
                        let cycle: Vec<usize> = path[from..].iter().map(|(one, _)| *one).collect();
                        if cycle.iter().all(|one| !in_cycle.contains(one)) {
                            self.report_cycle(&cycle);
                        }
                        in_cycle.extend(cycle);
                    }
                    Some(_) => {}
                    None => {
                        marks[index] = 2;
                        order.push(index);
                        path.pop();
                    }
                }
            }
        }
        for index in order {
            let latest =
                self.sources(index).into_iter().map(|one| self.model.quantities[one].stage);
            let latest = latest.max().unwrap_or(Moment::Person);
            let quantity = &mut self.model.quantities[index];
            quantity.stage = quantity.stage.max(match quantity.stage {
                // Draws of people do not wait for anything; what they refer to is checked.
                Moment::Person => Moment::Person,
                _ => latest,
            });
            self.model.order[quantity.stage as usize].push(index);
        }
    }

    fn report_cycle(&mut self, cycle: &[usize]) {
        // From the quantity that stands first in the file.
        let quantities = &self.model.quantities;
        let first = (0..cycle.len()).min_by_key(|place| quantities[cycle[*place]].span.start);
        let first = first.unwrap_or(0);
        let turned = cycle[first..].iter().chain(&cycle[..=first]);
        let names: Vec<String> =
            turned.map(|index| format!("`{}`", quantities[*index].name)).collect();
        let says = format!("a cycle: {}", names.join(" needs "));
        let help = "a variable may need its own past, as in x[-1], but not its present value";
        let fault = Fault::at(quantities[cycle[first]].span, says).help(help);
        self.faults.add(fault);
    }

    fn check_stages(&mut self, features: &[(Referent, Span)]) {
        let mut late = Vec::new();
        for index in 0..self.model.quantities.len() {
            let quantity = &self.model.quantities[index];
            if quantity.stage != Moment::Person {
                continue;
            }
            let clocks = ModelFile::formulas(&quantity.definition).iter().any(|formula| {
                let clock = |target: &Referent| matches!(target, Referent::Clock(_));
                formula.targets.iter().any(clock)
                    || !formula.windows.is_empty()
                    || formula.expression.names.iter().any(|name| name.back > 0)
            });
            let mut sources = self.sources(index).into_iter();
            let changes = sources.any(|one| self.model.quantities[one].stage != Moment::Person);
            if clocks || changes {
                let says = format!(
                    "`{}` is drawn once per person, and refers to what changes between decisions",
                    quantity.name
                );
                late.push(Fault::at(quantity.span, says).help("move it to [variables]"));
            }
        }
        for (target, span) in features {
            if let Referent::Quantity(index) = target
                && self.model.quantities[*index].stage == Moment::After
            {
                let says = format!(
                    "`{}` follows the choice of an action, and cannot be observed before it",
                    self.model.quantities[*index].name
                );
                let help = format!(
                    "observe its last value: a variable \"default({}[-1], 0)\"",
                    self.model.quantities[*index].name
                );
                late.push(Fault::at(*span, says).help(help));
            }
        }
        if let Some(index) = self.model.roles.available {
            let quantity = &self.model.quantities[index];
            if quantity.stage == Moment::After {
                late.push(Fault::at(quantity.span, "`available` is known before the choice of an action, and refers to `action` or `probability`"));
            }
        }
        late.into_iter().for_each(|fault| self.faults.add(fault));
        // What is known before the choice stands first in the recorded state.
        let quantities = &self.model.quantities;
        self.model.roles.state.sort_by_key(|index| quantities[*index].stage == Moment::After);
    }

    /// Finds what nothing needs. It is a fault once all columns of people are known: a misspelt name seems to be one.
    fn check_use(&mut self, is_state_written: bool) {
        let mut needed = HashSet::new();
        let roles = &self.model.roles;
        let mut open: Vec<usize> = vec![roles.outcome, roles.reward];
        open.extend(roles.available.iter().chain(&roles.ends));
        if is_state_written {
            open.extend(&roles.state);
        }
        let targets = roles.features.iter().map(|feature| feature.source);
        let mut parameters = HashSet::new();
        for target in targets {
            match target {
                Referent::Quantity(index) => open.push(index),
                Referent::ModelParameter(index) => _ = parameters.insert(index),
                _ => {}
            }
        }
        while let Some(index) = open.pop() {
            if !needed.insert(index) {
                continue;
            }
            let mut add = |target: &Referent| match target {
                Referent::Quantity(index) => open.push(*index),
                Referent::ModelParameter(index) => _ = parameters.insert(*index),
                _ => {}
            };
            let definition = &self.model.quantities[index].definition;
            definition.referents().iter().for_each(|(target, _)| add(target));
            for formula in ModelFile::formulas(definition) {
                formula.windows.iter().for_each(|window| add(&Referent::Quantity(*window)));
                for window in formula.expression.windows() {
                    for name in window.factor.iter().flat_map(|factor| &factor.names) {
                        self.known.get(&name.text).into_iter().for_each(&mut add);
                    }
                }
            }
        }
        // With other faults, what seems to be unused may be what a faulty line needs.
        if !self.faults.is_empty() {
            return;
        }
        let quantities = self.model.quantities.iter().enumerate();
        let own = quantities.filter(|(_, one)| {
            !matches!(
                one.definition,
                Definition::Action | Definition::Probability | Definition::Replay(_)
            )
        });
        let named = own.filter(|(_, one)| self.known.contains_key(&one.name));
        let unused = named.filter(|(index, _)| !needed.contains(index));
        let parameters = self
            .model
            .parameters
            .iter()
            .enumerate()
            .filter(|(index, _)| !parameters.contains(index));
        let all = unused
            .map(|(_, one)| (one.name.clone(), one.span))
            .chain(parameters.map(|(_, one)| (one.name.clone(), one.span)));
        let all: Vec<_> = all.collect();
        self.model.unused = all;
    }

    /// Reports parameters of distributions that are constant and out of range.
    fn check_constants(&mut self) {
        let mut faults = Vec::new();
        for quantity in &self.model.quantities {
            let Definition::DrawInstruction(distribution, formulas) = &quantity.definition else {
                continue;
            };
            for (index, formula) in formulas.iter().enumerate() {
                let Some(value) = numbers::constant(&formula.expression, &|_| None) else {
                    continue;
                };
                let (least, most) = distribution.range(index);
                if !(value >= least && value <= most) {
                    let keys = distribution.form().keys;
                    let key = keys[index.min(keys.len() - 1)];
                    let whole = formula.position.whole;
                    let says = format!(
                        "`{}`: {key} is {}, found {value}",
                        quantity.name,
                        numbers::range_in_words(least, most)
                    );
                    faults.push(Fault::at(Span { start: whole.0, end: whole.1 }, says));
                }
            }
        }
        faults.into_iter().for_each(|fault| self.faults.add(fault));
    }
}
