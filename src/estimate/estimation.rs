//! A declared estimate while decisions are read, one at a time.

use std::sync::Arc;

use super::effect::{unfinished, with_standard_error};
use super::layout::Layout;
use super::together::{Together, Tried};
use super::wcls::{Correction, NoFit, Sums};
use crate::job::{
    CONSTANT, Decision, Effect, Estimate, EstimateDeclaration, Estimates, Estimator, Messages,
    StateNames, Treatment, counted,
};
use crate::state::resumable;

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
    /// What an estimator that reads all decisions together keeps of them; no checkpoint has it.
    pub(super) together: Together,
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
            together: Together::new(&declaration, actions),
            layout,
            sums: Sums { columns, ..Sums::default() },
            last: Vec::new(),
            variances: Vec::new(),
            certain: 0,
            first_certain: [0; 2],
            unknown: 0,
            row: Vec::new(),
            declaration,
        }
    }

    /// The same, of people who stay for these numbers of decisions, \[people\].
    pub fn of_stays(mut self, stays: Vec<u32>) -> Estimation {
        self.together.stay(stays);
        self
    }

    /// The declaration.
    pub fn declaration(&self) -> &Arc<EstimateDeclaration> {
        &self.declaration
    }

    /// The sums of the decisions so far.
    pub(crate) fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Reads a decision. Decisions of a person, who has the number of the episode, come in the order of steps. An estimator
    /// that reads all decisions together has all of one person before those of the next.
    pub fn add(&mut self, decision: &Decision) {
        let Ok(layout) = &self.layout else { return };
        if self.declaration.estimator == Estimator::Value {
            return match self.together.follow(layout, &self.declaration, decision) {
                Tried::Known => {}
                Tried::Never => self.add_certain(decision),
                Tried::Unknown => self.unknown += 1,
            };
        }
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
            Drawn::Certain => return self.add_certain(decision),
            Drawn::Unknown => return self.unknown += 1,
        };
        self.fill_row(decision, treatment);
        // A recorded trial may lack a feature of the decision, or its outcome.
        if self.row.iter().any(|number| number.is_nan()) {
            return;
        }
        let outcome = match self.layout.as_ref().map(|layout| (layout.outcome, layout.is_own)) {
            Ok((None, _)) => decision.reward_for(&self.declaration),
            Ok((Some(index), true)) => decision.state[index],
            _ => return self.keep(person, decision.step, weight),
        };
        if outcome.is_nan() {
            return;
        }
        self.vary(person, self.row[1 + self.declaration.control.len()], weight);
        self.sums.add(person, &self.row, weight, outcome);
        self.together.add(person, &self.row, weight, outcome);
    }

    /// Counts a decision of a compared action with probability 0 or 1.
    fn add_certain(&mut self, decision: &Decision) {
        if self.certain == 0 {
            self.first_certain = [decision.episode, decision.step];
        }
        self.certain += 1;
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
        if weight > 0.0 && own[1] + 1.0 == f64::from(next.step) && !outcome.is_nan() {
            self.sums.add(person, &own[2..], weight, outcome);
            self.together.add(person, &own[2..], weight, outcome);
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
            if self.declaration.estimator == Estimator::Value {
                return Err(format!(
                    "{} at which an action of the policy had probability 0, the first at step {step} of person {person}; \
                     what it leads to was not tried",
                    counted(self.certain, "decision")
                ));
            }
            // Nobody randomises a recorded trial afterwards.
            let advice = match layout.recorded {
                Some(_) => {
                    "; leave them out by a `probability` of [data] without a value there, such as \
                     \"if(p > 0 and p < 1, p, log(0))\" of a column `p`"
                }
                None => ", as with a `pi_min` above 0",
            };
            return Err(format!(
                "{} of a compared action with probability 0 or 1, the first at step {step} of person {person}; the \
                 effect needs decisions that are randomised{advice}",
                counted(self.certain, "decision")
            ));
        }
        match self.declaration.estimator {
            Estimator::Wcls => self.least_squares(layout),
            Estimator::Emee => {
                // Linear dependence and people are as in least squares.
                let squares = self.sums.fit(Correction::None);
                let people = squares.map_err(|why| self.reason(layout, why))?.people;
                self.together.relative_risks(people, self.sums.rows(), self.treatment_variance())
            }
            Estimator::Value => self.together.values(),
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
                treatment_variance: self.treatment_variance(),
                ..unfinished(fit.coefficients[index], df, self.sums.rows(), fit.residual_sd)
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

resumable!([] Sums { grown numbers });

resumable!([] Estimation { parts certain, first_certain, unknown, sums; grown last, variances });
