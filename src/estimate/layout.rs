//! Where the features and the outcome of an estimate are in the decisions of a job.

use crate::job::{Decision, EstimateDeclaration, STEP, StateNames, Treatment};

/// Where the numbers of a decision are.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The features of the model without treatment.
    pub control: Vec<Feature>,
    /// For each policy of a value, the number that is its probability of a message, if it is named.
    pub policies: Vec<Option<Feature>>,
    /// The index in the state of the probability with which the action was taken, where the agent's is another one.
    pub recorded: Option<usize>,
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
        let named = of.policies().map(|(_, policy)| policy.feature());
        let named = named.map(|name| name.map(|name| feature(&name.to_owned())).transpose());
        let policies = named.collect::<Result<Vec<_>, _>>()?;
        let recorded = names.recorded();
        let is_own = outcome.is_some_and(|index| names.is_late(index));
        Ok(Layout { control, policies, recorded, moderators, outcome, is_own })
    }
}
