//! Estimates of causal effects as plain data: what a manifest declares, and what a job has of it.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use crate::key::choices;

use super::counted;

/// The outcome that is the reward of the step, less the cost of the message.
pub const REWARD: &str = "reward";
/// The outcome that is the reward of the step before the cost of the message, as decisions record it.
pub const GROSS_REWARD: &str = "gross_reward";
/// The feature that counts the steps that a person took before the decision.
pub const STEP: &str = "step";
/// The term of the constant 1.
pub const CONSTANT: &str = "1";

choices! {
    /// What is estimated, and how.
    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Estimator {
        /// The effect of a treatment, by weighted and centred least squares.
        Wcls = "wcls",
        /// The log relative risk of a treatment, by the estimator of the marginal excursion effect.
        Emee = "emee",
        /// The mean outcome under another policy.
        Value = "value",
    }
}

impl Estimator {
    /// Whether it reads all decisions of a run at the end, and does not add up sums of each person.
    pub fn reads_all(self) -> bool {
        match self {
            Estimator::Wcls => false,
            Estimator::Emee | Estimator::Value => true,
        }
    }

    /// Whether it uses a key of `[[estimate]]`.
    pub fn uses(self, key: &str) -> bool {
        match self {
            Estimator::Wcls => !["policy", "against", "steps"].contains(&key),
            Estimator::Emee => !["policy", "against", "steps", "standard_errors"].contains(&key),
            Estimator::Value => !["treatment", "numerator", "standard_errors"].contains(&key),
        }
    }
}

/// The terms of the value of a policy: by inverse probability, self-normalised, and doubly robust.
pub const VALUE_TERMS: [&str; 3] = ["inverse_probability", "self_normalised", "doubly_robust"];

choices! {
    /// What the standard errors of an estimate account for.
    #[derive(Default, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum StandardErrors {
        /// People who are independent.
        #[default]
        Nominal = "nominal",
        /// An agent that learned from everybody, too.
        AfterStudy = "after_study",
    }
}

impl StandardErrors {
    fn is_nominal(&self) -> bool {
        *self == StandardErrors::Nominal
    }
}

/// A declared estimate: its name and everything that its numbers depend on. Estimates with equal declarations are
/// the same estimate, in every manifest and store.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EstimateDeclaration {
    /// The policy whose value is subtracted; `None` for the value itself, and for an effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub against: Option<TargetPolicy>,
    /// The features of the model of the outcome without treatment, beside the constant 1.
    pub control: Vec<String>,
    /// How the effect is estimated.
    pub estimator: Estimator,
    /// Whether messages have a cost in any job of the manifest, which the outcome [`REWARD`] then counts.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub less_costs: bool,
    /// The features that the effect depends on, beside the constant 1.
    pub moderators: Vec<String>,
    /// The name.
    pub name: String,
    /// The probability of treatment in the numerator of the weights, in (0, 1); several treatments share it equally.
    pub numerator: f64,
    /// [`REWARD`], [`GROSS_REWARD`], or a name of the recorded state, whose value before the person's next decision is the outcome.
    pub outcome: String,
    /// The policy whose value is estimated; `None` for an effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<TargetPolicy>,
    /// What its standard errors account for.
    #[serde(default, skip_serializing_if = "StandardErrors::is_nominal")]
    pub standard_errors: StandardErrors,
    /// The number of consecutive decisions that the policy makes.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub steps: u32,
    /// What is compared with action 0.
    pub treatment: Treatment,
    /// Whether the truth is simulated, too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub truth: bool,
}

fn one() -> u32 {
    1
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_one(steps: &u32) -> bool {
    *steps == 1
}

/// The policy of the job's own agent, in [`TargetPolicy::Named`].
pub const AGENT: &str = "agent";

/// A policy whose value is estimated, at decisions at which a message can be sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum TargetPolicy {
    /// The probability of a message; several messages share it equally.
    Message(f64),
    /// The probabilities of all actions, \[actions\]; their sum is 1.
    Actions(Vec<f64>),
    /// A number of the recorded state is the probability of a message; or [`AGENT`].
    Named(String),
}

impl TargetPolicy {
    /// The number of the recorded state that is the probability of a message.
    pub fn feature(&self) -> Option<&str> {
        match self {
            TargetPolicy::Named(name) if name != AGENT => Some(name),
            TargetPolicy::Named(_) | TargetPolicy::Message(_) | TargetPolicy::Actions(_) => None,
        }
    }

    /// The probabilities in an environment with this number of actions, \[actions\], where a named policy sends a message
    /// with the probability `named`.
    ///
    /// **Errors**: the list has another length.
    pub fn probabilities(&self, actions: usize, named: f64) -> Result<Vec<f64>, String> {
        match self {
            TargetPolicy::Message(_) | TargetPolicy::Named(_) => {
                let probability =
                    if let TargetPolicy::Message(fixed) = self { *fixed } else { named };
                let each = probability / actions.saturating_sub(1) as f64;
                let messages = std::iter::repeat_n(each, actions.saturating_sub(1));
                Ok([1.0 - probability].into_iter().chain(messages).collect())
            }
            TargetPolicy::Actions(all) if all.len() == actions => Ok(all.clone()),
            TargetPolicy::Actions(all) => Err(format!(
                "lists {}, and the environment has {}",
                counted(all.len(), "number"),
                counted(actions, "action")
            )),
        }
    }
}

/// What an estimate compares with action 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Treatment {
    /// Any other action than 0, or each of them.
    Messages(Messages),
    /// The action of this number, above 0. Decisions with other actions than this one and 0 have weight 0.
    Action(u8),
}

choices! {
    /// How an estimate treats several messages.
    #[derive(Serialize, Deserialize)]
    pub enum Messages {
        /// As one treatment.
        #[serde(rename = "any message")]
        Any = "any message",
        /// As a treatment of its own each.
        #[serde(rename = "each message")]
        Each = "each message",
    }
}

impl Treatment {
    /// The number of treatments in an environment with this number of actions.
    pub fn count(self, actions: usize) -> usize {
        match self {
            Treatment::Messages(Messages::Each) => actions.saturating_sub(1),
            Treatment::Messages(Messages::Any) | Treatment::Action(_) => 1,
        }
    }
}

impl EstimateDeclaration {
    /// The declaration as one line of JSON with sorted keys; equal declarations have equal texts.
    pub fn canonical(&self) -> String {
        serde_json::to_string(self).expect("texts and finite numbers are written as JSON")
    }

    /// The declaration of a canonical text.
    ///
    /// **Errors**: the text is of a newer release, or damaged; what is unknown in it.
    pub fn from_canonical(text: &str) -> Result<EstimateDeclaration, String> {
        serde_json::from_str(text).map_err(|error| {
            let written: Json = serde_json::from_str(text).unwrap_or_default();
            match written["estimator"].as_str().filter(|word| Estimator::named(word).is_none()) {
                Some(word) => format!("the estimator \"{word}\" is unknown"),
                None => error.to_string(),
            }
        })
    }

    /// The policies whose values are estimated, by their keys; none for an effect.
    pub fn policies(&self) -> impl Iterator<Item = (&'static str, &TargetPolicy)> {
        let against = self.against.iter().map(|policy| ("against", policy));
        self.policy.iter().map(|policy| ("policy", policy)).chain(against)
    }

    /// Whether one of its policies is that of the job's own agent.
    pub fn is_of_agent(&self) -> bool {
        self.policies()
            .any(|(_, policy)| matches!(policy, TargetPolicy::Named(name) if name == AGENT))
    }

    /// Whether it is the value of a policy, and neither an effect nor a difference of two policies.
    pub fn is_value(&self) -> bool {
        self.estimator == Estimator::Value && self.against.is_none()
    }

    /// Whether the outcome is a reward of the step.
    pub fn is_of_reward(&self) -> bool {
        [REWARD, GROSS_REWARD].contains(&self.outcome.as_str())
    }

    /// The terms of the effect in an environment with this number of actions: 1 and the moderators, for each treatment.
    /// Those of a value are [`VALUE_TERMS`].
    pub fn terms(&self, actions: usize) -> Vec<String> {
        if self.estimator == Estimator::Value {
            return VALUE_TERMS.map(str::to_owned).into();
        }
        let own = || [CONSTANT].into_iter().chain(self.moderators.iter().map(String::as_str));
        match self.treatment {
            Treatment::Messages(Messages::Each) => (1..actions)
                .flat_map(|action| own().map(move |term| format!("action {action}: {term}")))
                .collect(),
            Treatment::Messages(Messages::Any) | Treatment::Action(_) => {
                own().map(str::to_owned).collect()
            }
        }
    }
}

/// What a job has of a declared estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimates {
    /// The declaration.
    pub declaration: Arc<EstimateDeclaration>,
    /// The terms of the effect, in the order of [`EstimateDeclaration::terms`]; at least one.
    pub terms: Vec<Estimate>,
}

/// One term of an estimated effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The term.
    pub term: String,
    /// The estimate; an error says why it could not be computed.
    pub effect: Result<Effect, String>,
}

/// An estimated coefficient. All numbers are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// The estimate.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// The degrees of freedom of Student's t.
    pub degrees_of_freedom: f64,
    /// The lower end of the 95 % confidence interval.
    pub low: f64,
    /// The upper end of the 95 % confidence interval.
    pub high: f64,
    /// The two-sided p-value of the hypothesis that the coefficient is 0.
    pub p_value: f64,
    /// The number of decisions that the estimate uses.
    pub decisions: u64,
    /// The weighted standard deviation of the residuals.
    pub residual_sd: f64,
    /// What the estimate estimates, in the job's trial: the coefficient of the effects that the simulation has at the
    /// trial's own decisions. `None` where it is not simulated.
    pub truth: Option<f64>,
    /// The mean of p (1 - p) over the decisions that the estimate uses, with p the probability of treatment. `None`
    /// if several treatments are compared.
    pub treatment_variance: Option<f64>,
    /// The number of equally weighted decisions that say as much about a value as the weighted ones do. `None` for an
    /// effect.
    pub effective_sample_size: Option<f64>,
}

impl Effect {
    /// Why no store accepts the numbers, with the name of the first such number; `None` if they are acceptable.
    pub fn unusable_number(&self) -> Option<String> {
        let most = 1e308;
        let real = |value: f64| value.abs() < most;
        let positive = |value: f64| (0.0..=most).contains(&value);
        let truth = self.truth.unwrap_or_default();
        let size = self.effective_sample_size.unwrap_or_default();
        let numbers = [
            ("its value", self.value, real(self.value)),
            ("its standard error", self.standard_error, positive(self.standard_error)),
            (
                "its degrees of freedom",
                self.degrees_of_freedom,
                (1.0..=most).contains(&self.degrees_of_freedom),
            ),
            ("the lower end of its interval", self.low, real(self.low)),
            ("the upper end of its interval", self.high, real(self.high)),
            ("its p-value", self.p_value, (0.0..=1.0).contains(&self.p_value)),
            ("its residual standard deviation", self.residual_sd, positive(self.residual_sd)),
            ("its true value", truth, real(truth)),
            ("its effective sample size", size, positive(size)),
        ];
        let unusable = numbers.into_iter().find(|(_, _, is_usable)| !is_usable);
        unusable.map(|(name, value, _)| format!("{name} is {value}"))
    }
}
