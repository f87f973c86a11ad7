//! A declared estimate while decisions are read, one at a time.

use std::sync::Arc;

use super::student::{t_of_p, two_sided_p};
use super::wcls::{Correction, NoFit, Sums};
use crate::job::{
    CONSTANT, Decision, Effect, Estimate, EstimateDeclaration, Estimates, Estimator, Messages,
    STEP, StateNames, Treatment, counted,
};
use crate::state::resumable;

/// The probability outside of a confidence interval.
const OUTSIDE: f64 = 0.05;

/// An estimate of the decisions that were read so far.
#[derive(Clone, Debug)]
pub struct Estimation {
    declaration: Arc<EstimateDeclaration>,
    /// The number of actions.
    actions: usize,
    /// The number of treatments.
    treatments: usize,
    /// The features; an error says which is unknown.
    layout: Result<Layout, String>,
    sums: Sums,
    /// By person, with the state as outcome: the weight of the last decision, its step, and its row. A weight of 0
    /// stands for none.
    last: Vec<f64>,
    /// By person, the sum of p (1 - p) over the rows, with p the probability of treatment.
    variances: Vec<f64>,
    /// The number of decisions with a probability of 0 or 1, and the person and step of the first.
    certain: u64,
    first_certain: [u32; 2],
    /// The number of decisions with unknown probabilities.
    unknown: u64,
    /// Buffer: the row of a decision.
    row: Vec<f64>,
}

/// Where the numbers of a decision are.
#[derive(Clone, Debug)]
pub struct Layout {
    control: Vec<Feature>,
    /// The features that the effect depends on.
    pub moderators: Vec<Feature>,
    /// The index of the outcome in the state; `None` for the reward.
    pub outcome: Option<usize>,
    /// Whether the outcome stands in the state of its own decision, which it follows, and not in that of the next.
    pub is_own: bool,
}

/// A number that is known before a decision.
#[derive(Clone, Copy, Debug)]
pub enum Feature {
    /// The number of steps before the decision.
    Step,
    /// The number at this index of the state.
    State(usize),
}

impl Feature {
    fn named(name: &str, state_names: &[String]) -> Result<Feature, String> {
        match state_names.iter().position(|known| known == name) {
            Some(_) if name == STEP => Err(format!(
                "`{STEP}` is the number of steps before the decision and a number of the program's state; give that \
                 another name"
            )),
            Some(index) => Ok(Feature::State(index)),
            None if name == STEP => Ok(Feature::Step),
            None => {
                let known: Vec<&str> = state_names.iter().map(String::as_str).collect();
                let known = known.join(", ");
                Err(format!("the recorded state has no `{name}`; it has {known} and {STEP}"))
            }
        }
    }

    /// The number before a decision.
    pub fn of(self, decision: &Decision) -> f64 {
        match self {
            Feature::Step => f64::from(decision.step),
            Feature::State(index) => decision.state[index],
        }
    }
}

/// The weight of a decision and its treatment, from 0; `None` for no message.
enum Drawn {
    Weighted(f64, Option<usize>),
    /// The decision has another action than those compared.
    Other,
    /// The probability of a compared action is 0 or 1.
    Certain,
    /// A probability is not known.
    Unknown,
}

impl Estimator {
    /// The sums that are kept of each person, before the first decision. A row has this number of columns.
    fn sums(self, columns: usize) -> Sums {
        match self {
            Estimator::Wcls => Sums { columns, ..Sums::default() },
        }
    }
}

impl Estimation {
    /// An estimate before the first decision, in an environment with this number of actions and these names of the
    /// numbers in the state.
    pub fn new(
        declaration: Arc<EstimateDeclaration>,
        actions: usize,
        state_names: &StateNames,
    ) -> Estimation {
        let layout = Layout::of(&declaration, actions, state_names);
        let treatments = declaration.treatment.count(actions);
        let columns =
            1 + declaration.control.len() + treatments * (1 + declaration.moderators.len());
        Estimation {
            actions,
            treatments,
            layout,
            sums: declaration.estimator.sums(columns),
            last: Vec::new(),
            variances: Vec::new(),
            certain: 0,
            first_certain: [0; 2],
            unknown: 0,
            row: Vec::new(),
            declaration,
        }
    }

    /// The declaration.
    pub fn declaration(&self) -> &Arc<EstimateDeclaration> {
        &self.declaration
    }

    /// The sums of the decisions so far.
    pub(crate) fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Reads a decision. Decisions of a person, who has the number of the episode, come in the order of steps.
    pub fn add(&mut self, decision: &Decision) {
        let Ok(layout) = &self.layout else { return };
        let person = decision.episode as usize - 1;
        if let Some(outcome) = layout.outcome.filter(|_| !layout.is_own) {
            self.pay(person, decision, decision.state[outcome]);
        }
        if !decision.can_send {
            return;
        }
        let (weight, treatment) = match self.drawn(decision) {
            Drawn::Weighted(weight, treatment) => (weight, treatment),
            Drawn::Other => return,
            Drawn::Certain => {
                if self.certain == 0 {
                    self.first_certain = [decision.episode, decision.step];
                }
                return self.certain += 1;
            }
            Drawn::Unknown => return self.unknown += 1,
        };
        self.fill_row(decision, treatment);
        // A recorded trial may lack a feature of the decision.
        if self.row.iter().any(|number| number.is_nan()) {
            return;
        }
        let outcome = match self.layout.as_ref().map(|layout| (layout.outcome, layout.is_own)) {
            Ok((None, _)) => decision.reward_for(&self.declaration),
            Ok((Some(index), true)) => decision.state[index],
            _ => return self.keep(person, decision.step, weight),
        };
        self.vary(person, self.row[1 + self.declaration.control.len()], weight);
        self.sums.add(person, &self.row, weight, outcome);
    }

    /// The weight and the row of a decision, with the reward as outcome; `None` if the estimate does not use it.
    pub(crate) fn weighted_row(&mut self, decision: &Decision) -> Option<(f64, &[f64])> {
        let Drawn::Weighted(weight, treatment) = self.drawn(decision) else { return None };
        self.fill_row(decision, treatment);
        decision.can_send.then_some((weight, &self.row[..]))
    }

    /// 1 / p for each action of the treatment that a decision took, of probability p together, and 0 for other actions,
    /// \[actions\]; `None` if the estimate does not use the decision.
    pub(crate) fn compared(&self, decision: &Decision) -> Option<Vec<f64>> {
        let Drawn::Weighted(..) = self.drawn(decision) else { return None };
        let taken = usize::from(decision.action);
        let is_any = self.declaration.treatment == Treatment::Messages(Messages::Any);
        let is_of = |action: usize| match taken {
            0 => action == 0,
            _ if is_any => action > 0,
            taken => action == taken,
        };
        let all = decision.probabilities.iter().enumerate();
        let together: f64 = all.clone().filter(|(action, _)| is_of(*action)).map(|(_, p)| p).sum();
        Some(all.map(|(action, _)| if is_of(action) { 1.0 / together } else { 0.0 }).collect())
    }

    /// The weight and treatment of a decision at which a message can be sent.
    fn drawn(&self, decision: &Decision) -> Drawn {
        let (all, action) = (&decision.probabilities, usize::from(decision.action));
        let share = self.declaration.numerator;
        let treatment = match self.declaration.treatment {
            _ if action == 0 => None,
            Treatment::Messages(Messages::Any) => Some(0),
            Treatment::Messages(Messages::Each) => Some(action - 1),
            Treatment::Action(wanted) if action == usize::from(wanted) => Some(0),
            Treatment::Action(_) => return Drawn::Other,
        };
        let is_any = self.declaration.treatment == Treatment::Messages(Messages::Any);
        let probability = match treatment {
            Some(_) if is_any => all[1..].iter().sum(),
            Some(_) | None => all[action],
        };
        let compared = |number: &usize| match self.declaration.treatment {
            Treatment::Messages(_) => true,
            Treatment::Action(wanted) => *number == 0 || *number == usize::from(wanted),
        };
        // Probabilities that are not known are NaN, which is neither.
        let is_zero = match is_any {
            true => all[1..].iter().sum::<f64>() == 0.0 || all[0] == 0.0,
            false => (0..all.len()).filter(compared).any(|number| all[number] == 0.0),
        };
        if is_zero || probability >= 1.0 {
            return Drawn::Certain;
        }
        if probability.is_nan() {
            return Drawn::Unknown;
        }
        let numerator = match treatment {
            Some(_) => share / self.treatments as f64,
            None => 1.0 - share,
        };
        Drawn::Weighted(numerator / probability, treatment)
    }

    /// Sets the row of a decision: 1 and the control features, then 1 and the moderators times each centred treatment.
    fn fill_row(&mut self, decision: &Decision, treatment: Option<usize>) {
        let Ok(layout) = &self.layout else { return };
        self.row.clear();
        self.row.push(1.0);
        self.row.extend(layout.control.iter().map(|feature| feature.of(decision)));
        let centre = self.declaration.numerator / self.treatments as f64;
        for number in 0..self.treatments {
            let is_treated = f64::from(u8::from(treatment == Some(number)));
            let centred = is_treated - centre;
            self.row.push(centred);
            let moderators = layout.moderators.iter().map(|one| centred * one.of(decision));
            self.row.extend(moderators);
        }
    }

    /// Keeps the row of a decision until the person's next one.
    fn keep(&mut self, person: usize, step: u32, weight: f64) {
        let stride = 2 + self.sums.columns;
        if self.last.len() < (person + 1) * stride {
            self.last.resize((person + 1) * stride, 0.0);
        }
        let own = &mut self.last[person * stride..(person + 1) * stride];
        (own[0], own[1]) = (weight, f64::from(step));
        own[2..].copy_from_slice(&self.row);
    }

    /// Adds the person's last row, whose outcome is known with the next decision.
    fn pay(&mut self, person: usize, next: &Decision, outcome: f64) {
        let stride = 2 + self.sums.columns;
        let Some(own) = self.last.get_mut(person * stride..(person + 1) * stride) else { return };
        let weight = std::mem::take(&mut own[0]);
        if weight > 0.0 && own[1] + 1.0 == f64::from(next.step) {
            self.sums.add(person, &own[2..], weight, outcome);
            let centred = own[3 + self.declaration.control.len()];
            self.vary(person, centred, weight);
        }
    }

    /// Adds p (1 - p) of a row, from its centred treatment and its weight.
    fn vary(&mut self, person: usize, centred: f64, weight: f64) {
        let share = self.declaration.numerator;
        let numerator = if centred > 0.0 { share } else { 1.0 - share };
        let probability = numerator / weight;
        if self.variances.len() <= person {
            self.variances.resize(person + 1, 0.0);
        }
        self.variances[person] += probability * (1.0 - probability);
    }

    /// The mean of p (1 - p) over the rows; `None` if there are other actions than treatment and no treatment.
    pub(super) fn treatment_variance(&self) -> Option<f64> {
        let is_any = self.declaration.treatment == Treatment::Messages(Messages::Any);
        let mean = self.variances.iter().sum::<f64>() / self.sums.rows() as f64;
        // Rounding could leave the range.
        (is_any || self.actions == 2).then_some(mean.clamp(0.0, 0.25))
    }

    /// The estimates from all decisions so far.
    pub fn finish(&self) -> Estimates {
        let names = self.declaration.terms(self.actions);
        // An environment with one action has no terms.
        let names = if names.is_empty() { vec![CONSTANT.to_owned()] } else { names };
        let effects = self.effects();
        let effect = |index: usize| match &effects {
            Ok(effects) => Result::clone(&effects[index]),
            Err(why) => Err(why.clone()),
        };
        let terms = names.into_iter().enumerate();
        let terms = terms.map(|(index, term)| Estimate { term, effect: effect(index) });
        Estimates { declaration: self.declaration.clone(), terms: terms.collect() }
    }

    /// The coefficients of the treatments.
    fn effects(&self) -> Result<Vec<Result<Effect, String>>, String> {
        let layout = self.layout.as_ref().map_err(Clone::clone)?;
        if self.unknown > 0 {
            return Err(format!(
                "the probabilities of the compared actions are not known at {}; the agent's program reports only the \
                 probability of its choice",
                counted(self.unknown, "decision")
            ));
        }
        if self.certain > 0 {
            let [person, step] = self.first_certain;
            return Err(format!(
                "{} of a compared action with probability 0 or 1, the first at step {step} of person {person}; the \
                 effect needs decisions that are randomised, as with a `pi_min` above 0",
                counted(self.certain, "decision")
            ));
        }
        match self.declaration.estimator {
            Estimator::Wcls => self.least_squares(layout),
        }
    }

    /// The coefficients of the treatments, by weighted and centred least squares.
    fn least_squares(&self, layout: &Layout) -> Result<Vec<Result<Effect, String>>, String> {
        let fit =
            self.sums.fit(Correction::ManclDeRouen).map_err(|why| self.reason(layout, why))?;
        let columns = self.sums.columns;
        let df = (fit.people - columns) as f64;
        let first = 1 + layout.control.len();
        let effect = |index: usize| {
            let effect = Effect {
                value: fit.coefficients[index],
                standard_error: f64::NAN,
                degrees_of_freedom: df,
                low: f64::NAN,
                high: f64::NAN,
                p_value: f64::NAN,
                decisions: self.sums.rows(),
                residual_sd: fit.residual_sd,
                truth: None,
                treatment_variance: self.treatment_variance(),
            };
            let standard_error = fit.covariance[index * columns + index].sqrt();
            if standard_error <= fit.rounding[index] {
                let size = if standard_error == 0.0 { "0" } else { "rounding alone" };
                return Err(format!(
                    "its standard error is {size}: the outcome does not vary beyond what the features explain"
                ));
            }
            with_standard_error(effect, standard_error)
        };
        Ok((first..columns).map(effect).collect())
    }

    fn reason(&self, layout: &Layout, why: NoFit) -> String {
        let columns = self.sums.columns;
        match why {
            NoFit::People(found) => format!(
                "it needs at least {} people with decisions at which a message could be sent, one more than its {columns} \
                 coefficients; found {found}",
                columns + 1
            ),
            NoFit::Dependent(column) => {
                let control = layout.control.len();
                let name = match column.checked_sub(1 + control) {
                    Some(index) => {
                        format!("the term `{}`", self.declaration.terms(self.actions)[index])
                    }
                    None if column == 0 => "the constant".to_owned(),
                    None => {
                        format!("the control feature `{}`", self.declaration.control[column - 1])
                    }
                };
                format!("{name} is a linear combination of the terms before it; leave it out")
            }
            NoFit::Determined(person) => {
                format!("person {} alone determines a coefficient; use fewer features", person + 1)
            }
        }
    }
}

impl Layout {
    /// Finds the features and the outcome of a declaration.
    ///
    /// **Errors**: a name is unknown, or the environment does not have the treatment.
    pub fn of(
        of: &EstimateDeclaration,
        actions: usize,
        names: &StateNames,
    ) -> Result<Layout, String> {
        let feature = |name: &String| match Feature::named(name, names)? {
            Feature::State(index) if names.is_late(index) => {
                Err(format!("`{name}` follows the action: it is an outcome alone"))
            }
            feature => Ok(feature),
        };
        let features = |list: &[String]| -> Result<Vec<Feature>, String> {
            list.iter().map(feature).collect()
        };
        let outcome = match of.outcome.as_str() {
            _ if of.is_of_reward() => None,
            name => match Feature::named(name, names)? {
                Feature::State(index) => Some(index),
                Feature::Step => return Err(format!("`{STEP}` is no outcome")),
            },
        };
        match of.treatment {
            Treatment::Action(action) if usize::from(action) >= actions => {
                return Err(format!("the environment has no action {action}"));
            }
            _ if actions < 2 => return Err("the environment has a single action".to_owned()),
            _ => {}
        }
        let (control, moderators) = (features(&of.control)?, features(&of.moderators)?);
        let is_own = outcome.is_some_and(|index| names.is_late(index));
        Ok(Layout { control, moderators, outcome, is_own })
    }
}

/// An effect with this standard error, and with the interval and the p-value that follow from it.
///
/// **Errors**: the standard error is 0 or not a number, or a number is too large to be stored.
pub(crate) fn with_standard_error(effect: Effect, standard_error: f64) -> Result<Effect, String> {
    if standard_error.is_nan() {
        return Err("its standard error is not a number".to_owned());
    }
    if standard_error <= 0.0 {
        return Err("its standard error is 0".to_owned());
    }
    let (value, df) = (effect.value, effect.degrees_of_freedom);
    let (low, high) = {
        let half = t_of_p(OUTSIDE, df) * standard_error;
        (value - half, value + half)
    };
    let numbers = [value, standard_error, low, high, effect.residual_sd];
    // The negation holds for NaN, too.
    if !numbers.iter().all(|number| number.abs() < 1e300) {
        return Err("its numbers are too large".to_owned());
    }
    let p_value = two_sided_p(value / standard_error, df);
    Ok(Effect { standard_error, low, high, p_value, ..effect })
}

resumable!([] Sums { grown numbers });

resumable!([] Estimation { parts certain, first_certain, unknown, sums; grown last, variances });
