//! The registration of decision rules.

use crate::agent::actor::Actor;
use crate::agent::constraint::{Chosen, Constraint, HORIZON, Violation};
use crate::agent::learner::Actions;
use crate::agent::rule::{DecisionRule, RuleParameters, RulePolicy};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::Environment;
use crate::key::{Key, Keyed, Parameter, Value};
use crate::optimum::{LONGEST_OPTIMUM, NoOptimum, check};

use super::algorithm::{AlgorithmParameters, Setting, Start, StartError};

const RULE: Parameter = Parameter::Agent("rule");

/// Keys of the environment.
const KEYS: &[Key] = Environment::KEYS;

/// The rule, and every key of the environment in their order.
const RULE_AND_ENVIRONMENT: [Parameter; KEYS.len() + 1] = {
    let mut all = [RULE; KEYS.len() + 1];
    let mut place = 0;
    while place < KEYS.len() {
        all[place + 1] = Parameter::Environment(KEYS[place].name);
        place += 1;
    }
    all
};

/// The environment of the values of [`RULE_AND_ENVIRONMENT`].
fn environment(chosen: &Chosen) -> Option<Environment> {
    let is_of_environment = |key: &Parameter| matches!(key, Parameter::Environment(_));
    let of_environment = chosen.keys.iter().filter(|(key, _)| is_of_environment(key));
    let values: Vec<Value> = of_environment.map(|(_, value)| (*value).clone()).collect();
    Environment::from_values(&values)
}

fn is_optimal(chosen: &Chosen) -> bool {
    chosen.is_word(RULE, DecisionRule::Optimal.word())
}

impl AlgorithmParameters for RuleParameters {
    const NAME: &'static str = "rule";
    const LEARNS: bool = false;
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[Parameter::Scenario, RULE],
            violation: |chosen| {
                let scenario = chosen.scenario;
                let hidden = is_optimal(chosen) && !scenario.shows_state();
                hidden.then(|| Violation::Impossible {
                    says: format!(
                        "rule = \"optimal\" needs scenarios with H and D, found {scenario}"
                    ),
                    help: format!(
                        "leave such cells out: [[exclude]] with agent.rule = \"optimal\" and \
                         scenario = \"{scenario}\""
                    ),
                })
            },
        },
        Constraint {
            parameters: &[RULE, HORIZON],
            violation: |chosen| {
                let (size, most) = (chosen.whole(HORIZON), u64::from(LONGEST_OPTIMUM));
                let (what, unit) = ("rule = \"optimal\" plans for a horizon of", "steps");
                let violated = is_optimal(chosen) && size > most;
                violated.then_some(Violation::TooLarge { what, unit, size, most })
            },
        },
        Constraint {
            parameters: &RULE_AND_ENVIRONMENT,
            violation: |chosen| {
                let not_known = |error: &NoOptimum| matches!(error, NoOptimum::NotKnown { .. });
                let environment = environment(chosen).filter(|_| is_optimal(chosen))?;
                let error = check(&environment, chosen.scenario).err().filter(not_known)?;
                Some(Violation::Impossible {
                    says: format!("rule = \"optimal\" is not possible: {error}"),
                    help: "take another rule, or leave such cells out with [[exclude]]".to_owned(),
                })
            },
        },
    ];

    fn version(&self) -> u32 {
        match self.rule {
            DecisionRule::Optimal => 4,
            DecisionRule::Never
            | DecisionRule::Untailored
            | DecisionRule::Tailored
            | DecisionRule::Threshold
            | DecisionRule::Random => 1,
        }
    }

    /// None: a rule learns nothing.
    fn episodes(&self) -> u32 {
        0
    }

    fn start(&self, setting: &Setting) -> Result<Start, StartError> {
        Ok(Start::Actor(Box::new(RulePolicy::new(self, setting.environment, setting.scenario)?)))
    }

    fn trained(
        &self,
        _: &Setting,
        _: &Weights,
        _: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        Err(WeightsError::NoNetwork)
    }
}
