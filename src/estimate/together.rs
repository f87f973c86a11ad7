//! Estimates that need all decisions together: log relative risks, and the value of a policy.

use super::effect::{unfinished, with_standard_error};
use super::emee::{NoRisks, Rows};
use super::layout::{Feature, Layout};
use super::value::{Courses, LEAST_SIZE, Made, NoValue, Valued, Values};
use crate::job::{Decision, Effect, EstimateDeclaration, Estimator, TargetPolicy, counted};

/// What an estimator keeps of the decisions that it has read.
#[derive(Clone, Debug)]
pub(super) enum Together {
    /// Sums by person suffice.
    Nothing,
    Rows(Rows),
    /// Those of each policy.
    Courses(Vec<Courses>),
    /// Why nothing can be estimated.
    Unfit(String),
}

/// What is known of the actions of a policy at a decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Tried {
    Known,
    /// One of them had probability 0.
    Never,
    /// The probability of the action that was taken is not known.
    Unknown,
}

impl Together {
    /// Nothing yet, in an environment with this number of actions.
    pub(super) fn new(declaration: &EstimateDeclaration, actions: usize) -> Together {
        let (controls, terms) = (1 + declaration.control.len(), 1 + declaration.moderators.len());
        match declaration.estimator {
            Estimator::Wcls => Together::Nothing,
            Estimator::Emee => {
                let treatments = declaration.treatment.count(actions);
                Together::Rows(Rows {
                    columns: controls + treatments * terms,
                    controls,
                    terms,
                    centre: declaration.numerator / treatments as f64,
                    numbers: Vec::new(),
                })
            }
            Estimator::Value if declaration.policy.is_none() => {
                Together::Unfit("it has no `policy`".to_owned())
            }
            Estimator::Value => {
                let steps = declaration.steps as usize;
                let new = || Courses { steps, controls, terms, actions, ..Courses::default() };
                let policies = declaration.policies();
                let all = policies.map(|(key, one)| match one.probabilities(actions, 0.5) {
                    Ok(_) => Ok(new()),
                    Err(why) => Err(format!("`{key}` {why}")),
                });
                all.collect::<Result<_, _>>().map_or_else(Together::Unfit, Together::Courses)
            }
        }
    }

    /// Sets how many decisions each person stays for.
    pub(super) fn stay(&mut self, stays: Vec<u32>) {
        if let Together::Courses(all) = self {
            all.iter_mut().for_each(|courses| courses.stays.clone_from(&stays));
        }
    }

    /// Adds the row of a decision of a person, from 0.
    pub(super) fn add(&mut self, person: usize, row: &[f64], weight: f64, outcome: f64) {
        if let Together::Rows(rows) = self {
            rows.add(person, row, weight, outcome);
        }
    }

    /// Adds a decision to the courses of its person. Returns what is least known of the policies.
    pub(super) fn follow(
        &mut self,
        layout: &Layout,
        declaration: &EstimateDeclaration,
        decision: &Decision,
    ) -> Tried {
        let Together::Courses(all) = self else { return Tried::Known };
        let policies = declaration.policies().zip(&layout.policies);
        let each = all.iter_mut().zip(policies).map(|(courses, ((_, policy), feature))| {
            courses.follow(layout, declaration, (policy, *feature), decision)
        });
        each.max().unwrap_or(Tried::Known)
    }

    /// The coefficients of the treatments on the scale of the log relative risk, from this number of people and rows, whose
    /// treatment has this variance.
    pub(super) fn relative_risks(
        &self,
        people: usize,
        decisions: u64,
        treatment_variance: Option<f64>,
    ) -> Result<Vec<Result<Effect, String>>, String> {
        let Together::Rows(rows) = self else { return Err(NO_ROWS.to_owned()) };
        let fit = rows.fit(true).map_err(no_risks)?;
        let (columns, df) = (rows.columns, (people - rows.columns) as f64);
        let effect = |index: usize| {
            let effect = unfinished(fit.coefficients[index], df, decisions, fit.residual_sd);
            let effect = Effect { treatment_variance, ..effect };
            with_standard_error(effect, fit.covariance[index * columns + index].sqrt())
        };
        Ok((rows.controls..columns).map(effect).collect())
    }

    /// The value of the policy, by each of its terms, less that of the policy that it is compared with.
    pub(super) fn values(&self) -> Result<Vec<Result<Effect, String>>, String> {
        let all = match self {
            Together::Courses(all) => all,
            Together::Unfit(why) => return Err(why.clone()),
            Together::Nothing | Together::Rows(_) => return Err(NO_ROWS.to_owned()),
        };
        let alone = all.len() == 1;
        let value = |courses: &Courses, key: &str| match courses.misfit {
            Some((person, step, message)) => Err(format!(
                "its `{key}` is {message} at step {step} of person {person}, which is no probability"
            )),
            None => courses.value().map_err(|why| {
                let why = no_value(why, courses.steps);
                if alone { why } else { format!("`{key}`: {why}") }
            }),
        };
        let own = value(&all[0], "policy")?;
        let other = all.get(1).map(|other| value(other, "against")).transpose()?;
        let size = |of: &Values, term: usize| of.values[term].value.abs();
        let scales = [0, 1, 2].map(|term| {
            size(&own, term).max(other.as_ref().map_or(0.0, |other| size(other, term)))
        });
        let found = match other {
            Some(other) => own.less(&other),
            None => own,
        };
        let df = (found.people.len() - 1) as f64;
        let effect = |(of, scale): (&Valued, f64)| {
            let effect = unfinished(of.value, df, found.courses as u64, found.outcome_sd);
            if of.standard_error() <= 1e-12 * scale {
                let what = if alone { "it" } else { "the difference" };
                return Err(format!(
                    "its standard error is rounding alone: {what} is the same for every person"
                ));
            }
            let size = Some(found.effective_size);
            with_standard_error(
                Effect { effective_sample_size: size, ..effect },
                of.standard_error(),
            )
        };
        Ok(found.values.iter().zip(scales).map(effect).collect())
    }
}

impl Courses {
    /// Adds a decision to the course of its person under a policy. A named policy has a feature: its probability of a message.
    fn follow(
        &mut self,
        layout: &Layout,
        declaration: &EstimateDeclaration,
        policy: (&TargetPolicy, Option<Feature>),
        decision: &Decision,
    ) -> Tried {
        let (person, action) = (decision.episode as usize - 1, usize::from(decision.action));
        let is_next = |last: &Made| last.person == person && last.step + 1 == decision.step;
        let later = layout.outcome.filter(|_| !layout.is_own);
        let last = self.made.last_mut().filter(|last| is_next(last));
        if let (Some(index), Some(last)) = (later, last) {
            last.outcome = decision.state[index];
        }
        let outcome = match (layout.outcome, layout.is_own) {
            (None, _) => decision.reward_for(declaration),
            (Some(index), true) => decision.state[index],
            (Some(_), false) => f64::NAN,
        };
        let policy = self.policy_at(policy, decision);
        let taken = match layout.recorded {
            Some(index) => decision.state[index],
            None => decision.probabilities[action],
        };
        let wanted = policy[action];
        let ratio = match decision.can_send {
            true if wanted == 0.0 => 0.0,
            true => wanted / taken,
            false => 1.0,
        };
        self.features.push(1.0);
        self.features.extend(layout.control.iter().map(|one| one.of(decision)));
        self.features.push(1.0);
        self.features.extend(layout.moderators.iter().map(|one| one.of(decision)));
        let Decision { step, can_send, terminated, .. } = *decision;
        self.made.push(Made { person, step, action, can_send, ratio, outcome, terminated });
        let tried = tried(layout, decision, &policy, taken);
        self.policy.extend(policy);
        tried
    }

    /// The probabilities of a policy at a decision, \[actions\].
    fn policy_at(
        &mut self,
        (policy, feature): (&TargetPolicy, Option<Feature>),
        decision: &Decision,
    ) -> Vec<f64> {
        // Where nothing can be sent, the number of the state may be missing.
        if !decision.can_send {
            return (0..self.actions).map(|action| f64::from(u8::from(action == 0))).collect();
        }
        match (policy, feature) {
            (_, Some(feature)) => {
                let message = feature.of(decision);
                if !(0.0..=1.0).contains(&message) && !message.is_nan() {
                    self.misfit.get_or_insert((decision.episode, decision.step, message));
                }
                policy.probabilities(self.actions, message).unwrap_or_default()
            }
            (TargetPolicy::Named(_), None) => decision.probabilities.to_vec(),
            (_, None) => policy.probabilities(self.actions, 0.0).unwrap_or_default(),
        }
    }
}

/// What is known of the actions of a policy at a decision whose action was taken with the probability `taken`.
///
/// The state of a recorded trial has this probability alone. The others are 0 if it is 1; otherwise they are those of the
/// agent if the agent has the same one, as the rule `recorded` has, and are not known if it has another.
fn tried(layout: &Layout, decision: &Decision, policy: &[f64], taken: f64) -> Tried {
    if !decision.can_send {
        return Tried::Known;
    }
    let (action, agent) = (usize::from(decision.action), &decision.probabilities);
    let is_recorded = layout.recorded.is_some();
    let is_of_agent = !is_recorded || agent[action] == taken;
    let is_zero = |other: usize| match other == action {
        true => taken == 0.0,
        false if is_of_agent => agent[other] == 0.0,
        false => taken >= 1.0,
    };
    if (0..policy.len()).any(|other| policy[other] > 0.0 && is_zero(other)) {
        return Tried::Never;
    }
    // A decision of a recorded trial without its probability is left out.
    if taken.is_nan() && !is_recorded { Tried::Unknown } else { Tried::Known }
}

const NO_ROWS: &str = "it has read no decisions";

fn no_risks(why: NoRisks) -> String {
    match why {
        NoRisks::Outcome(person, outcome) => format!(
            "person {} has the outcome {outcome}; a relative risk is of outcomes that are 0 or 1, or counts. \
             `estimator` = \"wcls\" is for other outcomes",
            person + 1
        ),
        NoRisks::Nothing => "no outcome is above 0, so that there is no relative risk".to_owned(),
        NoRisks::Unsolved => "its equations have no finite solution; a relative risk needs outcomes above 0 with every \
                              treatment and without, and few features"
            .to_owned(),
        NoRisks::Determined(person) => {
            format!("person {} alone determines a coefficient; use fewer features", person + 1)
        }
    }
}

fn no_value(why: NoValue, steps: usize) -> String {
    match why {
        NoValue::People(people) => format!(
            "it needs at least 2 people with {} one after the other; found {people}",
            counted(steps, "decision")
        ),
        NoValue::Size(size, courses) => {
            let fewer = if steps > 1 { ", fewer `steps`" } else { "" };
            format!(
                "its effective sample size is {size:.1} of {courses}, below {LEAST_SIZE}: the policy seldom takes the \
                 actions that were taken; take a policy nearer to them{fewer}, or more people"
            )
        }
        NoValue::Determined => "one person has all the weight; it needs more people".to_owned(),
    }
}
