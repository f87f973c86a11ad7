//! What of a model is fitted, given what the data have.

use std::collections::{BTreeMap, BTreeSet};

use crate::env::declared::distribution::DrawLaw;
use crate::env::declared::expression::{ExpressionNode, Unary};
use crate::env::declared::model::{Definition, ModelFile, NamedExpression, Quantity, Referent};
use crate::env::declared::pilot::linear_form::{FitTarget, Forms, LinearForm};
use crate::env::declared::pilot::section::{EffectSource, FitMethod, FitSection};
use crate::env::declared::pilot::sources::Sources;
use crate::env::declared::pilot::terms::FitLaw;
use crate::text::{Fault, FaultList, shortened};

/// What is fitted.
#[derive(Default)]
pub(super) struct FitPlan {
    pub draws: Vec<PlannedDraw>,
    /// Tables that are counted, by quantity.
    pub tables: Vec<usize>,
    /// The coefficients, in the order of the model.
    pub coefficients: Vec<FitTarget>,
    /// Columns that no parameter is linear in, with the draw and parameter.
    pub nonlinear: BTreeMap<usize, (usize, usize)>,
}

pub(super) struct PlannedDraw {
    pub quantity: usize,
    pub law: FitLaw,
    pub method: FitMethod,
    /// By parameter: its key, its formula as the fit sees it, and its form.
    pub predictors: Vec<(&'static str, NamedExpression, LinearForm)>,
}

impl FitPlan {
    pub fn new(
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

impl FitPlan {
    /// The draw and parameter that a coefficient is in.
    pub fn place(&self, target: FitTarget) -> (usize, usize) {
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
