//! Reads decisions in the terms of a model.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::io::Read;
use std::ops::Range;

use crate::env::declared::distribution::DrawLaw;
use crate::env::declared::expression::{ExpressionNode, Unary};
use crate::env::declared::model::{
    Definition, ModelFile, Moment, NamedExpression, Quantity, Referent,
};
use crate::env::declared::pilot::calendar::{Calendar, SKIPPED};
use crate::env::declared::pilot::design::{Clamped, Unit};
use crate::env::declared::pilot::file::{self, ColumnFormula, DataFaults, Header, RecordedRows};
use crate::env::declared::pilot::linear_form::{FitTarget, Forms, LinearForm};
use crate::env::declared::pilot::section::{self, FitSection, RowsToOne, WrittenColumn};
use crate::env::declared::pilot::{
    DrawCounts, DrawPredictor, EffectSource, FitCoefficient, FitLaw, FitMethod, FittedDraw,
    ImputedColumn, Pilot, PilotError,
};
use crate::env::declared::read;
use crate::env::declared::rows::Numbers;
use crate::text::{Fault, FaultList, Span, shortened};

/// What a coefficient estimates, and the coefficient.
type Estimable = (FitTarget, FitCoefficient);

/// People and decisions from which it is found which coefficients are effects.
const LOOKED_AT: usize = 50;

impl Pilot {
    /// Reads a model with `[fit]` and its data. `stop` is asked now and then.
    ///
    /// **Errors**: every fault of the model, or else every fault of the data.
    pub fn read(text: &str, data: impl Read, stop: &dyn Fn() -> bool) -> Result<Pilot, PilotError> {
        let (model, section) = match (read::read(text), section::read(text)) {
            (Ok(model), Ok(section)) => (model, section),
            (Err(mut faults), section) => {
                section.err().into_iter().for_each(|more| faults.append(more));
                return Err(PilotError::Model(faults));
            }
            (_, Err(faults)) => return Err(PilotError::Model(faults)),
        };
        let mut reader = file::reader(data);
        let header = file::header(&mut reader).map_err(PilotError::Data)?;
        let mut faults = FaultList::default();
        let sources = Sources::new(&model, &section, &header, &mut faults);
        let plan = FitPlan::new(&model, &section, &sources, &mut faults);
        if !faults.is_empty() {
            return Err(PilotError::Model(faults));
        }
        let person = sources.person.unwrap_or(0);
        let used = sources.columns();
        let table =
            file::rows(&mut reader, header, person, &used, stop).map_err(PilotError::Data)?;
        if stop() {
            return Err(PilotError::Stopped);
        }
        let calendar = Calendar::new(&table, &sources.order, model.decisions_per_day);
        let calendar = calendar.map_err(PilotError::Data)?;
        let mut assembly = Assembly::new(&model, &section, &sources, plan, &table, calendar);
        let pilot = assembly.pilot();
        if stop() {
            return Err(PilotError::Stopped);
        }
        if assembly.faults.is_empty() { Ok(pilot) } else { Err(PilotError::Data(assembly.faults)) }
    }
}

/// Where everything comes from: expressions of columns of the file.
struct Sources {
    person: Option<usize>,
    order: Vec<ColumnFormula>,
    filter: Option<ColumnFormula>,
    action: Option<ColumnFormula>,
    probability: Vec<ColumnFormula>,
    available: Option<ColumnFormula>,
    /// By quantity.
    given: BTreeMap<usize, ColumnFormula>,
    /// Columns of people, by their index.
    people: BTreeMap<usize, (RowsToOne, ColumnFormula)>,
    /// Columns of people that the file has under their own name.
    constant: BTreeMap<usize, usize>,
}

impl Sources {
    fn new(
        model: &ModelFile,
        section: &FitSection,
        header: &Header,
        faults: &mut FaultList,
    ) -> Sources {
        let mut formula = |written: &WrittenColumn| match header.formula(written) {
            Ok(formula) => Some(formula),
            Err(fault) => {
                faults.add(fault);
                None
            }
        };
        let mut one = |written: &Option<WrittenColumn>| written.as_ref().and_then(&mut formula);
        let person = one(&section.person);
        let (filter, action, available) =
            (one(&section.filter), one(&section.action), one(&section.available));
        let order = section.order.iter().filter_map(&mut formula).collect();
        let probability: Vec<ColumnFormula> =
            section.probability.iter().filter_map(&mut formula).collect();
        let mut given = BTreeMap::new();
        let named = |name: &str| model.quantities.iter().position(|one| one.name == name);
        let is_variable = |index: usize| {
            let definition = &model.quantities[index].definition;
            index > 1 && !matches!(definition, Definition::Linear(_))
        };
        let mut unknown = Vec::new();
        for (name, at, written) in &section.columns {
            match named(name).filter(|index| is_variable(*index)) {
                Some(index) => _ = formula(written).map(|of| given.insert(index, of)),
                None => unknown.push((name, *at, "variable")),
            }
        }
        let mut people = BTreeMap::new();
        for (name, at, way, written) in &section.people {
            match model.columns.iter().position(|column| column.name == *name) {
                Some(index) => _ = formula(written).map(|of| people.insert(index, (*way, of))),
                None => unknown.push((name, *at, "column of people")),
            }
        }
        for (name, at) in &section.standardised {
            if !section.columns.iter().any(|(given, ..)| given == name)
                && !model.replayed.contains(name)
            {
                let says =
                    format!("`standardise`: the data give no variable `{}`", shortened(name));
                faults.add(Fault::at(*at, says).help("list it in `columns` of [fit] as well"));
            }
        }
        for (name, at, what) in unknown {
            let fault = Fault::at(at, format!("the model has no {what} `{}`", shortened(name)));
            let names = model.names();
            faults.add(fault.nearest(name, names));
        }
        if let Some(written) = section
            .person
            .as_ref()
            .filter(|_| !matches!(person, Some(ColumnFormula::Column(_)) | None))
        {
            faults.add(Fault::at(written.span, "`person`: expected the name of a column"));
        }
        let expected = model.actions.len() - 1;
        if !probability.is_empty() && probability.len() != expected {
            let says =
                format!("`probability`: expected {expected}, one for each action but the first");
            faults.add(Fault::at(section.probability[0].span, says));
        }
        // Rows that the model replays have the names of the file's columns, unless they are listed.
        for name in &model.replayed {
            let Some(index) = named(name).filter(|index| !given.contains_key(index)) else {
                continue;
            };
            if let Some(column) = header.column(name) {
                given.insert(index, ColumnFormula::Column(column));
            } else if !name.starts_with("residual_") {
                let says =
                    format!("the data have no column `{name}`, which the model's [replay] lists");
                faults.add(Fault::whole(says).help("say in `columns` of [fit] what it is"));
            }
        }
        let blocks: HashSet<usize> = block_columns(model);
        let constant = model.columns.iter().enumerate().filter_map(|(index, column)| {
            let own = header.column(&column.name)?;
            (!people.contains_key(&index) && !blocks.contains(&index)).then_some((index, own))
        });
        let constant = constant.collect();
        let person = person.map(|person| match person {
            ColumnFormula::Column(index) => index,
            ColumnFormula::Expression(..) => 0,
        });
        Sources { person, order, filter, action, probability, available, given, people, constant }
    }

    /// The columns of the file that are read as numbers.
    fn columns(&self) -> Vec<usize> {
        let lists = self.order.iter().chain(&self.filter).chain(&self.action);
        let lists = lists.chain(&self.probability).chain(&self.available);
        let lists = lists.chain(self.given.values());
        let lists = lists.chain(self.people.values().map(|(_, formula)| formula));
        lists.flat_map(ColumnFormula::columns).chain(self.constant.values().copied()).collect()
    }
}

/// The columns of people that are coefficients of blocks.
fn block_columns(model: &ModelFile) -> HashSet<usize> {
    let terms = model.quantities.iter().filter_map(|quantity| match &quantity.definition {
        Definition::Linear(terms) => Some(terms),
        _ => None,
    });
    let column = |referent: Referent| match referent {
        Referent::Column(index) => Some(index),
        _ => None,
    };
    terms.flatten().filter_map(|term| column(term.coefficient)).collect()
}

/// What is fitted.
#[derive(Default)]
struct FitPlan {
    draws: Vec<PlannedDraw>,
    /// Tables that are counted, by quantity.
    tables: Vec<usize>,
    /// The coefficients, in the order of the model.
    coefficients: Vec<FitTarget>,
    /// Columns that no parameter is linear in, with the draw and parameter.
    nonlinear: BTreeMap<usize, (usize, usize)>,
}

struct PlannedDraw {
    quantity: usize,
    law: FitLaw,
    method: FitMethod,
    /// By parameter: its key, its formula as the fit sees it, and its form.
    predictors: Vec<(&'static str, NamedExpression, LinearForm)>,
}

impl FitPlan {
    fn new(
        model: &ModelFile,
        section: &FitSection,
        sources: &Sources,
        faults: &mut FaultList,
    ) -> FitPlan {
        let mut given = vec![false; model.quantities.len()];
        given[0] = true;
        given[1] = !sources.probability.is_empty();
        sources.given.keys().for_each(|index| given[*index] = true);
        for (index, quantity) in model.quantities.iter().enumerate() {
            given[index] |= quantity.name.starts_with("residual_")
                && matches!(quantity.definition, Definition::Replay(_));
        }
        let of_blocks: BTreeSet<usize> = block_parameters(model);
        let is_coefficient = |target: FitTarget| match target {
            FitTarget::Column(index) => {
                !sources.people.contains_key(&index) && !sources.constant.contains_key(&index)
            }
            FitTarget::ModelParameter(index) => section.pooled && of_blocks.contains(&index),
        };
        let mut forms = Forms::new(model, &given, &is_coefficient);
        let mut plan = FitPlan::default();
        for index in sources.given.keys() {
            plan.add(model, section, &mut forms, *index, faults);
        }
        for (name, at, _) in section
            .methods
            .iter()
            .filter_map(|(name, at, method)| Some((name.as_ref()?, *at, method)))
        {
            let is_known = |quantity: usize| model.quantities[quantity].name == *name;
            if !plan.draws.iter().any(|draw| is_known(draw.quantity))
                && !plan.tables.iter().any(|one| is_known(*one))
            {
                let says = format!("`method`: `{}` is no draw that is fitted", shortened(name));
                let names: Vec<&str> =
                    plan.draws.iter().map(|draw| &*model.quantities[draw.quantity].name).collect();
                faults.add(Fault::at(at, says).nearest(name, names));
            }
        }
        if plan.draws.is_empty() && plan.tables.is_empty() && faults.is_empty() {
            let help = "list a variable in `columns` that is a draw whose parameters have columns of people, or [linear] blocks of them; with `pooled = true`, coefficients can be parameters of the model";
            faults.add(Fault::whole("[fit]: there is nothing to estimate").help(help));
        }
        plan.finish(model, section, sources, faults);
        plan
    }

    fn add(
        &mut self,
        model: &ModelFile,
        section: &FitSection,
        forms: &mut Forms<'_>,
        index: usize,
        faults: &mut FaultList,
    ) {
        let quantity = &model.quantities[index];
        let method = section.method(&quantity.name);
        let (law, formulas) = match &quantity.definition {
            Definition::DrawInstruction(law, formulas) => (law, formulas),
            Definition::ProbabilityTable(_, formulas) => {
                let form = formulas.iter().map(|formula| forms.formula(formula));
                let drawn = form.flat_map(|form| form.drawn).collect();
                report_drawn(model, quantity, &drawn, faults);
                self.tables.push(index);
                return;
            }
            _ => return,
        };
        let forms_of: Vec<LinearForm> = formulas.iter().map(|one| forms.formula(one)).collect();
        if forms_of.iter().all(|form| form.linear.is_empty() && form.other.is_empty()) {
            // A context of the study, which nothing explains.
            return;
        }
        let (law, formulas) = match fitted_form(*law, formulas) {
            Ok(form) => form,
            Err(help) => {
                let says = format!(
                    "`{}`: its distribution cannot be fitted as it is written",
                    quantity.name
                );
                faults.add(Fault::at(quantity.span, says).help(help));
                return;
            }
        };
        if method == FitMethod::Counts {
            let says = format!("`{}`: only a draw of a table is counted", quantity.name);
            faults.add(
                Fault::at(quantity.span, says)
                    .help("the other methods are \"least squares\", \"ridge\" and \"map\""),
            );
        }
        let predictors: Vec<_> = formulas
            .into_iter()
            .map(|(key, formula)| {
                let form = forms.formula(&formula);
                (key, formula, form)
            })
            .collect();
        let drawn = predictors.iter().flat_map(|(.., form)| form.drawn.iter().copied()).collect();
        report_drawn(model, quantity, &drawn, faults);
        self.draws.push(PlannedDraw { quantity: index, law, method, predictors });
    }

    /// Lists the coefficients, and reports columns of people that nothing determines.
    fn finish(
        &mut self,
        model: &ModelFile,
        section: &FitSection,
        sources: &Sources,
        faults: &mut FaultList,
    ) {
        let mut linear = BTreeSet::new();
        for (draw, planned) in self.draws.iter().enumerate() {
            for (parameter, (.., form)) in planned.predictors.iter().enumerate() {
                linear.extend(&form.linear);
                for target in &form.other {
                    if let FitTarget::Column(index) = target {
                        self.nonlinear.entry(*index).or_insert((draw, parameter));
                    }
                }
            }
        }
        linear.retain(|target| match target {
            FitTarget::Column(index) => !self.nonlinear.contains_key(index),
            FitTarget::ModelParameter(_) => true,
        });
        self.coefficients = linear.into_iter().collect();
        let is_imputed = section.effect != EffectSource::Fitted;
        for (index, column) in model.columns.iter().enumerate() {
            let is_known =
                sources.people.contains_key(&index) || sources.constant.contains_key(&index);
            if is_known || self.coefficients.contains(&FitTarget::Column(index)) {
                continue;
            }
            let name = &column.name;
            let fault = match self.nonlinear.get(&index) {
                Some(_) if is_imputed => continue,
                Some((draw, parameter)) => {
                    let draw = &self.draws[*draw];
                    let (key, owner) = (draw.predictors[*parameter].0, &model.quantities[draw.quantity].name);
                    Fault::at(column.span, format!("`{name}` is a column of people, and {key} of `{owner}` is not linear in it: it cannot be estimated"))
                        .help("give it in `people` of [fit] from columns of the data, or impute it: effect = { standardised = 0.3 }")
                }
                None => Fault::at(column.span, format!("`{name}` is a column of people that the data do not determine"))
                    .help("give it in `people` of [fit], as in people = { age = { first = \"age\" } }, or list the draw that it explains in `columns`"),
            };
            if faults.is_empty() || self.nonlinear.contains_key(&index) {
                faults.add(fault);
            }
        }
    }
}

/// Reports draws that a fitted draw needs and that the data do not have.
fn report_drawn(
    model: &ModelFile,
    quantity: &Quantity,
    drawn: &BTreeSet<usize>,
    faults: &mut FaultList,
) {
    for index in drawn {
        let name = &model.quantities[*index].name;
        let says = format!(
            "`{}` needs `{name}`, which is drawn, and which the data do not have",
            quantity.name
        );
        let help =
            format!("list `{name}` in `columns` of [fit], or a variable that is computed from it");
        faults.add(Fault::at(quantity.span, says).help(help));
    }
}

/// The parameters of the model that are coefficients of blocks.
fn block_parameters(model: &ModelFile) -> BTreeSet<usize> {
    let terms = model.quantities.iter().filter_map(|quantity| match &quantity.definition {
        Definition::Linear(terms) => Some(terms),
        _ => None,
    });
    let parameter = |referent: Referent| match referent {
        Referent::ModelParameter(index) => Some(index),
        _ => None,
    };
    terms.flatten().filter_map(|term| parameter(term.coefficient)).collect()
}

type FormulasByKey = Vec<(&'static str, NamedExpression)>;

/// A distribution with its parameters as a fit sees them: logits and logarithms.
///
/// **Errors**: how to write it instead.
fn fitted_form(
    law: DrawLaw,
    formulas: &[NamedExpression],
) -> Result<(FitLaw, FormulasByKey), &'static str> {
    let inner = |formula: &NamedExpression, function: Unary| {
        let mut inner = formula.clone();
        match inner.expression.nodes.pop() {
            Some(ExpressionNode::Unary(last, _)) if last == function => Some(inner),
            _ => None,
        }
    };
    let one = &formulas[0];
    Ok(match law {
        DrawLaw::Gaussian => {
            (FitLaw::Normal, vec![("mean", one.clone()), ("sd", formulas[1].clone())])
        }
        DrawLaw::Lognormal => {
            (FitLaw::Lognormal, vec![("log_mean", one.clone()), ("log_sd", formulas[1].clone())])
        }
        DrawLaw::BernoulliLogit => (FitLaw::Bernoulli, vec![("logit", one.clone())]),
        DrawLaw::Bernoulli => {
            let help = "write it as { bernoulli = { logit = \"…\" } }: a logit can be any number";
            (FitLaw::Bernoulli, vec![("logit", inner(one, Unary::Sigmoid).ok_or(help)?)])
        }
        DrawLaw::PoissonLog => (FitLaw::Poisson, vec![("log_mean", one.clone())]),
        DrawLaw::Poisson => {
            let help =
                "write it as { poisson = { log_mean = \"…\" } }: a logarithm can be any number";
            (FitLaw::Poisson, vec![("log_mean", inner(one, Unary::Exp).ok_or(help)?)])
        }
        DrawLaw::ZeroInflatedPoisson => (
            FitLaw::ZeroInflatedPoisson,
            vec![("zero", one.clone()), ("log_mean", formulas[1].clone())],
        ),
        DrawLaw::CategoricalLogit => {
            (FitLaw::Categorical, formulas.iter().map(|one| ("logits", one.clone())).collect())
        }
        DrawLaw::Categorical => return Err("write it as { categorical = { logits = […] } }"),
        DrawLaw::Uniform | DrawLaw::Gamma | DrawLaw::Beta => {
            return Err(
                "a fit knows gaussian, lognormal, bernoulli, poisson, zero_inflated_poisson and categorical",
            );
        }
    })
}

/// The data in the terms of a model, while they are put together.
struct Assembly<'a> {
    model: &'a ModelFile,
    section: &'a FitSection,
    sources: &'a Sources,
    plan: FitPlan,
    table: &'a RecordedRows,
    calendar: Calendar,
    faults: DataFaults,
    notes: Vec<String>,
}

impl<'a> Assembly<'a> {
    fn new(
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

    fn pilot(&mut self) -> Pilot {
        let decisions = self.calendar.rows.len();
        let used = self.used();
        let actions = self.actions();
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
        let mut certain = 0;
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
                self.faults
                    .add(format!("{line}the probability is {p}, expected a number from 0 to 1"));
            }
            certain += usize::from((p == 0.0 || p == 1.0) && is_available != 0.0);
        }
        if certain > 0 {
            self.notes.push(format!(
                "{certain} decisions have the probability 0 or 1: they say nothing about the effect"
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
            if sd <= 0.0 || sd.is_nan() {
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
            terms.iter().any(|term: &crate::env::declared::model::LinearTerm| {
                term.coefficient == Referent::Column(column)
            })
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
    ) -> (Vec<Estimable>, Vec<(f64, Vec<f64>)>) {
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
        coefficients: &[Estimable],
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
                    let is_own =
                        |(_, (target, _)): &(usize, &Estimable)| form.linear.contains(target);
                    coefficients.iter().enumerate().filter(is_own).map(|(index, _)| index).collect()
                })
                .collect();
            let mut without = [0, 0];
            let (mut decisions, mut people) = (Vec::new(), Vec::new());
            for person in &self.calendar.people {
                let start = decisions.len();
                for decision in person.decisions.clone().filter(|one| used[*one]) {
                    let known = places.clone().zip(&own).all(|(place, own)| {
                        let is_known = |unit: &usize| !all[*unit][place][decision].is_nan();
                        is_known(&0) && own.iter().all(|one| is_known(&(one + 1)))
                    });
                    match (values[decision].is_nan(), known) {
                        (true, _) => without[0] += 1,
                        (_, false) => without[1] += 1,
                        _ => decisions.push(decision as u32),
                    }
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

impl FitPlan {
    /// The draw and parameter that a coefficient is in.
    fn place(&self, target: FitTarget) -> (usize, usize) {
        let draws = self.draws.iter().enumerate().flat_map(|(draw, planned)| {
            planned
                .predictors
                .iter()
                .enumerate()
                .map(move |(index, (.., form))| (draw, index, form))
        });
        let mut draws = draws.filter(|(.., form)| form.linear.contains(&target));
        draws.next().map_or((0, 0), |(draw, index, _)| (draw, index))
    }
}
