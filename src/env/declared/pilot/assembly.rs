//! Puts the data together in the terms of a model.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use crate::env::declared::expression::ExpressionNode;
use crate::env::declared::model::{
    Definition, LinearTerm, ModelFile, Moment, NamedExpression, Quantity, Referent,
};
use crate::env::declared::pilot::calendar::{Calendar, SKIPPED};
use crate::env::declared::pilot::design::{Clamped, Unit};
use crate::env::declared::pilot::file::{ColumnFormula, DataFaults, RecordedRows};
use crate::env::declared::pilot::linear_form::FitTarget;
use crate::env::declared::pilot::plan::FitPlan;
use crate::env::declared::pilot::section::{EffectSource, FitSection, RowsToOne};
use crate::env::declared::pilot::sources::Sources;
use crate::env::declared::pilot::terms::{
    DrawCounts, DrawPredictor, FitCoefficient, FitLaw, FittedDraw, ImputedColumn, Pilot,
};
use crate::env::declared::rows::Numbers;
use crate::text::{Span, shortened};

/// People and decisions from which it is found which coefficients are effects.
const LOOKED_AT: usize = 50;

/// What is estimated, each with the place that it has in the model.
type Estimated = Vec<(FitTarget, FitCoefficient)>;

/// The data in the terms of a model, while they are put together.
pub(super) struct Assembly<'a> {
    model: &'a ModelFile,
    section: &'a FitSection,
    sources: &'a Sources,
    plan: FitPlan,
    table: &'a RecordedRows,
    calendar: Calendar,
    pub faults: DataFaults,
    notes: Vec<String>,
}

impl<'a> Assembly<'a> {
    pub fn new(
        model: &'a ModelFile,
        section: &'a FitSection,
        sources: &'a Sources,
        plan: FitPlan,
        table: &'a RecordedRows,
        calendar: Calendar,
    ) -> Assembly<'a> {
        let mut notes = Vec::new();
        let (skipped, people) = calendar.skipped();
        if skipped > 0 {
            notes.push(format!("{skipped} decisions of {people} people are no rows of the file; they are missing decisions"));
        }
        let faults = DataFaults::default();
        Assembly { model, section, sources, plan, table, calendar, faults, notes }
    }

    fn line(&self, decision: usize) -> String {
        let row = self.calendar.rows[decision];
        self.table.lines.get(row as usize).map_or(String::new(), |line| format!("line {line}: "))
    }

    /// The value of a formula at each decision.
    fn values(&self, formula: &ColumnFormula) -> Vec<f64> {
        let mut values = vec![f64::NAN; self.calendar.rows.len()];
        for (decision, row, step) in self.calendar.recorded() {
            values[decision] = formula.value(self.table, row, step);
        }
        values
    }

    pub fn pilot(&mut self) -> Pilot {
        let decisions = self.calendar.rows.len();
        let used = self.used();
        let actions = self.actions();
        self.codes(&used);
        let columns = self.person_columns();
        let (given, mut by_quantity) = self.given(&actions);
        let scales = self.standardise(&given, &mut by_quantity, &used);
        let width = given.len();
        let mut numbers = vec![f64::NAN; decisions * width];
        for (column, values) in by_quantity.iter().enumerate() {
            for (decision, value) in values.iter().enumerate() {
                numbers[decision * width + column] = *value;
            }
        }
        drop(by_quantity);
        let mut model = self.model.clone();
        let wanted = self.wanted(&mut model);
        let indices: Vec<usize> = wanted.iter().flatten().copied().collect();
        Clamped::clamp(&mut model, &given, &indices);
        let replayed = self.model.replayed.iter();
        let replayed = replayed
            .filter_map(|name| self.model.quantities.iter().position(|one| one.name == *name))
            .collect();
        let clamped = Clamped {
            model,
            given,
            numbers: Numbers::of(width, numbers),
            people: self.calendar.people.iter().map(|one| one.decisions.clone()).collect(),
            columns: columns.clone(),
            parameters: self.model.parameters.iter().map(|one| one.default).collect(),
            replayed,
        };
        let effects = self.effects(&clamped, &wanted);
        let imputed = self.imputed(&effects);
        let (coefficients, rare) = self.coefficients(&clamped, &effects, &imputed);
        let draws = self.draws(&clamped, &wanted, &coefficients, &used);
        let counts = self.counts(&clamped, &wanted, &used);
        let names = self.model.columns.iter().map(|column| column.name.clone());
        Pilot {
            people: self.calendar.people.clone(),
            coefficients: coefficients.into_iter().map(|(_, one)| one).collect(),
            draws,
            counts,
            effect: self.section.effect,
            imputed,
            pooled: self.section.pooled,
            rare,
            columns: names.zip(columns).collect(),
            scales,
            actions,
            used,
            notes: std::mem::take(&mut self.notes),
            model: Arc::new(self.model.clone()),
            clamped,
        }
    }

    /// Whether each decision is a row that `where` admits.
    fn used(&mut self) -> Vec<bool> {
        let is_row = |row: &u32| *row != SKIPPED;
        let mut used: Vec<bool> = self.calendar.rows.iter().map(is_row).collect();
        if let Some(filter) = &self.sources.filter {
            let values = self.values(filter);
            let all = used.iter().filter(|used| **used).count();
            for (used, value) in used.iter_mut().zip(values) {
                *used &= value != 0.0 && !value.is_nan();
            }
            let left = used.iter().filter(|used| **used).count();
            self.notes.push(format!("`where` admits {left} of {all} rows"));
            if left == 0 {
                self.faults.add("`where` admits no row");
            }
        }
        used
    }

    /// Notes usual codes for missing numbers that are read as numbers of used rows.
    fn codes(&mut self, used: &[bool]) {
        let mut rows = vec![false; self.table.lines.len()];
        for (decision, row, _) in self.calendar.recorded() {
            rows[row] = used[decision];
        }
        let codes = self.table.codes(&self.sources.numbers(), |row| rows[row]);
        self.notes.extend(codes);
    }

    /// The actions, probabilities and availability by decision.
    fn actions(&mut self) -> [Vec<f64>; 3] {
        let decisions = self.calendar.rows.len();
        let unknown = || vec![f64::NAN; decisions];
        let of = |formula: &Option<ColumnFormula>| formula.as_ref().map(|one| self.values(one));
        let (action, available) = (of(&self.sources.action), of(&self.sources.available));
        let mut probability = unknown();
        for (index, formula) in self.sources.probability.iter().enumerate() {
            for (sum, value) in probability.iter_mut().zip(self.values(formula)) {
                *sum = if index == 0 { value } else { *sum + value };
            }
        }
        let has_action = action.is_some();
        let mut action = action.unwrap_or_else(|| vec![0.0; decisions]);
        let available = available.unwrap_or_else(unknown);
        let count = self.model.actions.len() as f64;
        let (mut certain, mut first_certain) = (0, 0);
        let written = self.section.probability.first().map_or("", |one| &one.text);
        let help = self.table.header.percentages(written, probability.iter().copied());
        for decision in (0..decisions).filter(|one| self.calendar.rows[*one] != SKIPPED) {
            let (taken, p, is_available) =
                (action[decision], probability[decision], available[decision]);
            let line = self.line(decision);
            if !is_available.is_nan() && is_available != 0.0 && is_available != 1.0 {
                self.faults.add(format!("{line}available is {is_available}, expected 0 or 1"));
            }
            if is_available == 0.0 && taken > 0.0 {
                self.faults.add(format!("{line}action {taken} where available is 0"));
            }
            if is_available == 0.0 && taken.is_nan() {
                action[decision] = 0.0;
            }
            if !taken.is_nan() && (taken.fract() != 0.0 || taken < 0.0 || taken >= count) {
                self.faults.add(format!(
                    "{line}the action is {taken}, expected a whole number from 0 to {}",
                    count - 1.0
                ));
            }
            if !p.is_nan() && !(0.0..=1.0).contains(&p) {
                self.faults.add(format!(
                    "{line}the probability is {p}, expected a number from 0 to 1{help}"
                ));
            }
            if (p == 0.0 || p == 1.0) && is_available != 0.0 {
                let row = self.calendar.rows[decision] as usize;
                first_certain = if certain == 0 { self.table.lines[row] } else { first_certain };
                certain += 1;
            }
        }
        if certain > 0 {
            self.notes.push(format!(
                "{certain} decisions have the probability 0 or 1, the first in line {first_certain}: they say nothing about \
                 the effect"
            ));
        }
        let first = action.iter().find(|action| !action.is_nan());
        if has_action && action.iter().all(|action| action.is_nan() || Some(action) == first) {
            self.notes
                .push("the action never varies: the data say nothing about its effect".to_owned());
        }
        [action, probability, available]
    }

    /// By column of people: the numbers that the data give, by person.
    fn person_columns(&mut self) -> Vec<Option<Vec<f64>>> {
        let mut columns = vec![None; self.model.columns.len()];
        for (index, (way, formula)) in &self.sources.people {
            let values = self.values(formula);
            let name = self.model.columns[*index].name.clone();
            let mut numbers = Vec::new();
            for person in &self.calendar.people {
                let own = values[person.decisions.clone()].iter().copied().filter(|x| !x.is_nan());
                let number = match way {
                    RowsToOne::First => own.clone().next(),
                    RowsToOne::Mean => Some(own.clone().sum::<f64>() / own.clone().count() as f64),
                    RowsToOne::Least => own.clone().reduce(f64::min),
                    RowsToOne::Most => own.clone().reduce(f64::max),
                };
                numbers.push(number.unwrap_or(f64::NAN));
            }
            self.report_missing(&name, &numbers);
            columns[*index] = Some(numbers);
        }
        for (index, column) in &self.sources.constant {
            let values = self.values(&ColumnFormula::Column(*column));
            let name = self.model.columns[*index].name.clone();
            let mut numbers = Vec::new();
            for person in self.calendar.people.clone() {
                let own = person.decisions.clone().filter(|one| !values[*one].is_nan());
                let own: Vec<usize> = own.collect();
                let first = own.first().map_or(f64::NAN, |one| values[*one]);
                if let Some(other) = own.iter().find(|one| values[**one] != first) {
                    let line = self.line(*other);
                    let who = shortened(&person.name);
                    self.faults.add(format!("{line}column `{name}` is {}, and {first} in an earlier row of person {who}: say in `people` of [fit] which number it is", values[*other]));
                }
                numbers.push(first);
            }
            self.report_missing(&name, &numbers);
            columns[*index] = Some(numbers);
        }
        columns
    }

    fn report_missing(&mut self, name: &str, numbers: &[f64]) {
        for (person, _) in
            self.calendar.people.iter().zip(numbers).filter(|(_, number)| number.is_nan())
        {
            let who = shortened(&person.name);
            self.faults.add(format!("person {who}: no row gives `{name}`, a column of people"));
        }
    }

    /// The given quantities, and their values by decision.
    fn given(&mut self, actions: &[Vec<f64>; 3]) -> (Vec<usize>, Vec<Vec<f64>>) {
        let mut given = vec![0, 1];
        let mut values = vec![actions[0].clone(), actions[1].clone()];
        for (index, formula) in &self.sources.given {
            let own = self.values(formula);
            self.check_domain(*index, &own);
            given.push(*index);
            values.push(own);
        }
        for (index, quantity) in self.model.quantities.iter().enumerate() {
            if matches!(quantity.definition, Definition::Replay(_)) && !given.contains(&index) {
                given.push(index);
                values.push(vec![0.0; self.calendar.rows.len()]);
            }
        }
        (given, values)
    }

    /// Reports values that a draw cannot have.
    fn check_domain(&mut self, quantity: usize, values: &[f64]) {
        let Some(draw) = self.plan.draws.iter().find(|draw| draw.quantity == quantity) else {
            return;
        };
        let count = draw.predictors.len() as f64;
        let law = draw.law;
        let name = &self.model.quantities[quantity].name;
        for (decision, value) in values.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            let is_whole = value.fract() == 0.0 && *value >= 0.0;
            let expected = match law {
                FitLaw::Lognormal if *value <= 0.0 => "a number above 0",
                FitLaw::Bernoulli if !is_whole || *value > 1.0 => "0 or 1",
                FitLaw::Poisson | FitLaw::ZeroInflatedPoisson if !is_whole || *value > 1e9 => {
                    "a whole number of at least 0"
                }
                FitLaw::Categorical if !is_whole || *value >= count => {
                    "the number of a category, from 0"
                }
                _ => continue,
            };
            let line = self.line(decision);
            self.faults.add(format!("{line}`{name}` is {value}, expected {expected}"));
        }
    }

    /// Standardises variables over the rows that are used.
    fn standardise(
        &mut self,
        given: &[usize],
        values: &mut [Vec<f64>],
        used: &[bool],
    ) -> Vec<(String, f64, f64)> {
        let mut scales = Vec::new();
        for (name, _) in &self.section.standardised {
            let is_named = |quantity: &usize| self.model.quantities[*quantity].name == *name;
            let Some(column) = given.iter().position(is_named) else { continue };
            let own = values[column].iter().zip(used);
            let known = own.filter(|(value, used)| **used && !value.is_nan());
            let (mean, sd) = mean_and_sd(&known.map(|(value, _)| *value).collect::<Vec<f64>>());
            if sd.is_nan() || sd == 0.0 {
                self.faults
                    .add(format!("`{name}` is the same in all rows: it cannot be standardised"));
            }
            values[column].iter_mut().for_each(|value| *value = (*value - mean) / sd);
            scales.push((name.clone(), mean, sd));
        }
        scales
    }

    /// Adds the quantities that are wanted of every draw, and of every table, to the model.
    fn wanted(&self, model: &mut ModelFile) -> Vec<Vec<usize>> {
        let mut add = |formula: &NamedExpression| {
            let index = model.quantities.len();
            model.quantities.push(Quantity {
                name: "a parameter of a draw".to_owned(),
                span: Span { start: 0, end: 0 },
                stage: Moment::After,
                definition: Definition::NamedExpression(formula.clone()),
                back: 0,
            });
            model.order[Moment::After as usize].push(index);
            index
        };
        let mut wanted: Vec<Vec<usize>> = Vec::new();
        for draw in &self.plan.draws {
            wanted.push(draw.predictors.iter().map(|(_, formula, _)| add(formula)).collect());
        }
        for table in &self.plan.tables {
            let formulas = ModelFile::formulas(&self.model.quantities[*table].definition);
            wanted.push(formulas.iter().map(&mut add).collect());
        }
        wanted
    }

    fn unknown_parameters(&self) -> Vec<usize> {
        let parameter = |target: &FitTarget| match target {
            FitTarget::ModelParameter(index) => Some(*index),
            FitTarget::Column(_) => None,
        };
        self.plan.coefficients.iter().filter_map(parameter).collect()
    }

    /// Whether each coefficient matters only where an action is taken.
    fn effects(&self, clamped: &Clamped, wanted: &[Vec<usize>]) -> Vec<bool> {
        let indices: Vec<Referent> = wanted[..self.plan.draws.len()]
            .iter()
            .flatten()
            .map(|one| Referent::Quantity(*one))
            .collect();
        let part = self.part(clamped);
        let units: Vec<Unit> = [Unit::default()]
            .into_iter()
            .chain(self.plan.coefficients.iter().map(|one| one.unit()))
            .collect();
        let unknown = self.unknown_parameters();
        let [never, always] =
            [0.0, 1.0].map(|action| part.with_action(action).run_all(&units, &unknown, &indices));
        let matters = |all: &[Vec<Vec<f64>>], unit: usize| {
            { all[unit].iter().zip(&all[0]) }.any(|(with, without)| {
                { with.iter().zip(without) }
                    .any(|(with, without)| with != without && !with.is_nan())
            })
        };
        (1..units.len()).map(|unit| matters(&always, unit) && !matters(&never, unit)).collect()
    }

    /// A few people with all their decisions.
    fn part(&self, clamped: &Clamped) -> Clamped {
        let width = clamped.given.len();
        let (mut numbers, mut people) = (Vec::new(), Vec::new());
        for own in clamped.people.iter().take(LOOKED_AT) {
            let start = numbers.len() / width;
            let few: Range<usize> = own.start..own.end.min(own.start + LOOKED_AT);
            numbers.extend(
                few.clone()
                    .flat_map(|row| (0..width).map(move |column| (row, column)))
                    .map(|(row, column)| clamped.numbers.number(row, column)),
            );
            people.push(start..start + few.len());
        }
        Clamped {
            model: clamped.model.clone(),
            given: clamped.given.clone(),
            numbers: Numbers::of(width, numbers),
            people,
            columns: clamped.columns.clone(),
            parameters: clamped.parameters.clone(),
            replayed: clamped.replayed.clone(),
        }
    }

    /// The columns that are imputed: effects, and what no parameter is linear in. Of the effects of one block, the
    /// intercept has the whole.
    fn imputed(&mut self, effects: &[bool]) -> Vec<ImputedColumn> {
        if self.section.effect == EffectSource::Fitted {
            return Vec::new();
        }
        let mut imputed = Vec::new();
        for (target, is_effect) in self.plan.coefficients.iter().zip(effects) {
            let (FitTarget::Column(index), true) = (target, *is_effect) else { continue };
            let of = self.plan.place(*target);
            let name = self.model.columns[*index].name.clone();
            imputed.push(ImputedColumn { sign: self.share(*index), name, of });
        }
        for (index, of) in &self.plan.nonlinear {
            let name = self.model.columns[*index].name.clone();
            imputed.push(ImputedColumn { name, of: *of, sign: 1.0 });
        }
        for column in &mut imputed {
            if self.section.negative.iter().any(|(name, _)| *name == column.name) {
                column.sign = -column.sign;
            }
        }
        for (name, _) in &self.section.negative {
            if !imputed.iter().any(|column| column.name == *name) {
                self.faults.add(format!(
                    "`negative` of `effect` lists `{}`, which is not imputed",
                    shortened(name)
                ));
            }
        }
        if imputed.is_empty() {
            self.faults.add("`effect` of [fit] imputes effects, and no column of people is one");
        }
        imputed
    }

    /// 1 for a column that has the effect of its block: the intercept, or the only one; 0 for the others.
    fn share(&self, column: usize) -> f64 {
        let terms =
            self.model.quantities.iter().filter_map(|quantity| match &quantity.definition {
                Definition::Linear(terms) => Some(terms),
                _ => None,
            });
        let own = |terms: &&Vec<_>| {
            terms.iter().any(|term: &LinearTerm| term.coefficient == Referent::Column(column))
        };
        let Some(terms) = { terms }.find(own) else { return 1.0 };
        let main = terms.iter().find(|term| term.factors.is_empty()).unwrap_or(&terms[0]);
        if main.coefficient == Referent::Column(column) { 1.0 } else { 0.0 }
    }

    /// The coefficients that are estimated, and the variables that need both values.
    fn coefficients(
        &self,
        clamped: &Clamped,
        effects: &[bool],
        imputed: &[ImputedColumn],
    ) -> (Estimated, Vec<(f64, Vec<f64>)>) {
        let mut rare = Vec::new();
        let mut quantities = Vec::new();
        for (name, _, share) in &self.section.least_share {
            let index = self.model.quantities.iter().position(|one| one.name == *name);
            let Some(index) = index else { continue };
            rare.push((*share, Vec::new()));
            quantities.push(index);
        }
        if !quantities.is_empty() {
            let wanted: Vec<Referent> =
                quantities.iter().map(|one| Referent::Quantity(*one)).collect();
            let values = clamped.run(Unit::default(), &self.unknown_parameters(), &wanted);
            rare.iter_mut().zip(values).for_each(|((_, to), values)| *to = values);
        }
        let mut all = Vec::new();
        for (target, is_effect) in self.plan.coefficients.iter().zip(effects) {
            let (name, is_parameter) = match target {
                FitTarget::Column(index) => (self.model.columns[*index].name.clone(), false),
                FitTarget::ModelParameter(index) => {
                    (self.model.parameters[*index].name.clone(), true)
                }
            };
            if imputed.iter().any(|one| one.name == name) {
                continue;
            }
            let own = quantities
                .iter()
                .enumerate()
                .filter(|(_, quantity)| self.has_factor(*target, **quantity));
            let rare = own.map(|(index, _)| index).collect();
            all.push((*target, FitCoefficient { name, is_parameter, is_effect: *is_effect, rare }));
        }
        (all, rare)
    }

    /// Whether a coefficient's terms have this variable.
    fn has_factor(&self, target: FitTarget, quantity: usize) -> bool {
        self.model.quantities.iter().any(|one| {
            let Definition::Linear(terms) = &one.definition else { return false };
            terms.iter().any(|term| {
                target.is(term.coefficient) && term.factors.contains(&Referent::Quantity(quantity))
            })
        })
    }

    fn draws(
        &mut self,
        clamped: &Clamped,
        wanted: &[Vec<usize>],
        coefficients: &[(FitTarget, FitCoefficient)],
        used: &[bool],
    ) -> Vec<FittedDraw> {
        let of_draws = &wanted[..self.plan.draws.len()];
        let flat: Vec<Referent> =
            of_draws.iter().flatten().map(|one| Referent::Quantity(*one)).collect();
        let units: Vec<Unit> = [Unit::default()]
            .into_iter()
            .chain(coefficients.iter().map(|(one, _)| one.unit()))
            .collect();
        let all = clamped.run_all(&units, &self.unknown_parameters(), &flat);
        let mut first = 0;
        let mut draws = Vec::new();
        for planned in &self.plan.draws {
            let places = first..first + planned.predictors.len();
            first = places.end;
            let values = clamped.given(planned.quantity).unwrap_or_default();
            let own: Vec<Vec<usize>> = planned
                .predictors
                .iter()
                .map(|(.., form)| {
                    let is_own = |(_, (target, _)): &(usize, &(FitTarget, FitCoefficient))| {
                        form.linear.contains(target)
                    };
                    coefficients.iter().enumerate().filter(is_own).map(|(index, _)| index).collect()
                })
                .collect();
            let mut without = [(0, 0); 2];
            let line = |decision: usize| self.table.lines[self.calendar.rows[decision] as usize];
            let (mut decisions, mut people) = (Vec::new(), Vec::new());
            for person in &self.calendar.people {
                let start = decisions.len();
                for decision in person.decisions.clone().filter(|one| used[*one]) {
                    let known = places.clone().zip(&own).all(|(place, own)| {
                        let is_known = |unit: &usize| !all[*unit][place][decision].is_nan();
                        is_known(&0) && own.iter().all(|one| is_known(&(one + 1)))
                    });
                    let lacks = match (values[decision].is_nan(), known) {
                        (true, _) => 0,
                        (_, false) => 1,
                        _ => {
                            decisions.push(decision as u32);
                            continue;
                        }
                    };
                    let (count, first) = &mut without[lacks];
                    *first = if *count == 0 { line(decision) } else { *first };
                    *count += 1;
                }
                people.push(start..decisions.len());
            }
            let predictors = places.zip(own).zip(&planned.predictors).map(
                |((place, own), (key, formula, _))| {
                    let at = |unit: usize, decision: u32| all[unit][place][decision as usize];
                    let offset: Vec<f64> = decisions.iter().map(|one| at(0, *one)).collect();
                    let design = decisions.iter().zip(&offset).flat_map(|(one, offset)| {
                        own.iter().map(move |index| at(index + 1, *one) - offset)
                    });
                    DrawPredictor {
                        key,
                        design: design.collect(),
                        offset,
                        parameter: self.whole(formula),
                        coefficients: own,
                    }
                },
            );
            let predictors = predictors.collect();
            let outcome = decisions.iter().map(|one| values[*one as usize]);
            let outcome = match planned.law {
                FitLaw::Lognormal => outcome.map(libm::log).collect(),
                _ => outcome.collect(),
            };
            let name = self.model.quantities[planned.quantity].name.clone();
            if decisions.is_empty() {
                self.faults
                    .add(format!("`{name}` has no row with its value and all of its features"));
            }
            draws.push(FittedDraw {
                name,
                law: planned.law,
                method: planned.method,
                predictors,
                decisions,
                outcome,
                people,
                without,
            });
        }
        draws
    }

    /// The parameter of the model that a formula is.
    fn whole(&self, formula: &NamedExpression) -> Option<String> {
        match (&formula.expression.nodes[..], &formula.targets[..]) {
            ([ExpressionNode::WrittenName(_)], [Referent::ModelParameter(index)]) => {
                Some(self.model.parameters[*index].name.clone())
            }
            _ => None,
        }
    }

    fn counts(&self, clamped: &Clamped, wanted: &[Vec<usize>], used: &[bool]) -> Vec<DrawCounts> {
        let mut all = Vec::new();
        for (table, wanted) in self.plan.tables.iter().zip(&wanted[self.plan.draws.len()..]) {
            let referents: Vec<Referent> =
                wanted.iter().map(|one| Referent::Quantity(*one)).collect();
            let given = clamped.run(Unit::default(), &[], &referents);
            let values = clamped.given(*table).unwrap_or_default();
            let mut counts: BTreeMap<Vec<u64>, (Vec<f64>, usize)> = BTreeMap::new();
            for decision in (0..values.len()).filter(|one| used[*one]) {
                let key: Vec<f64> = given
                    .iter()
                    .map(|one| one[decision])
                    .chain([values[decision]])
                    .map(|x| x + 0.0)
                    .collect();
                if key.iter().all(|number| !number.is_nan()) {
                    let bits = key.iter().map(|number| ordered(*number)).collect();
                    counts.entry(bits).or_insert((key, 0)).1 += 1;
                }
            }
            let name = self.model.quantities[*table].name.clone();
            all.push(DrawCounts { name, counts: counts.into_values().collect() });
        }
        all
    }
}

/// The mean of numbers, and their standard deviation, by n - 1.
fn mean_and_sd(numbers: &[f64]) -> (f64, f64) {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    let squares: f64 = numbers.iter().map(|x| (x - mean) * (x - mean)).sum();
    (mean, (squares / (count - 1.0)).sqrt())
}

/// Bits that have the order of their numbers.
fn ordered(number: f64) -> u64 {
    let bits = number.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

impl FitTarget {
    fn unit(self) -> Unit {
        match self {
            FitTarget::Column(index) => Unit { column: Some(index), parameter: None },
            FitTarget::ModelParameter(index) => Unit { column: None, parameter: Some(index) },
        }
    }

    fn is(self, referent: Referent) -> bool {
        match self {
            FitTarget::Column(index) => referent == Referent::Column(index),
            FitTarget::ModelParameter(index) => referent == Referent::ModelParameter(index),
        }
    }
}
