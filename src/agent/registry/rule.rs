//! The registration of decision rules.

use crate::agent::actor::Actor;
use crate::agent::constraint::{Assignment, Constraint, HORIZON, TEST_DECISIONS_FIT, Violation};
use crate::agent::learner::Actions;
use crate::agent::rule::{DecisionRule, RuleParameters, RulePolicy};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::Environment;
use crate::key::{Key, Keyed, Parameter, Value};
use crate::optimum::{LONGEST_OPTIMUM, NoOptimum, check};

use super::algorithm::{AlgorithmParameters, Start, StartError, Task, Work};

const RULE: Parameter = Parameter::Agent("rule");

/// Multiply-adds that take as long as computing an optimum does per step of its horizon.
const OPTIMUM_PER_STEP: u64 = 100_000_000;

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
fn environment(assignment: &Assignment) -> Option<Environment> {
    let is_of_environment = |key: &Parameter| matches!(key, Parameter::Environment(_));
    let of_environment = assignment.keys.iter().filter(|(key, _)| is_of_environment(key));
    let values: Vec<Value> = of_environment.map(|(_, value)| (*value).clone()).collect();
    Environment::from_values(&values)
}

fn is_optimal(assignment: &Assignment) -> bool {
    assignment.is_word(RULE, DecisionRule::Optimal.word())
}

impl AlgorithmParameters for RuleParameters {
    const NAME: &'static str = "rule";
    const LEARNS: bool = false;
    const CONSTRAINTS: &'static [Constraint] = &[
        TEST_DECISIONS_FIT,
        Constraint {
            parameters: &[Parameter::Scenario, RULE],
            violation: |assignment| {
                let scenario = assignment.scenario;
                let hidden = is_optimal(assignment) && !scenario.shows_state();
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
            violation: |assignment| {
                let (size, most) = (assignment.whole(HORIZON), u64::from(LONGEST_OPTIMUM));
                let (what, unit) = ("rule = \"optimal\" plans for a horizon of", "steps");
                let violated = is_optimal(assignment) && size > most;
                violated.then_some(Violation::TooLarge { what, unit, size, most })
            },
        },
        Constraint {
            parameters: &RULE_AND_ENVIRONMENT,
            violation: |assignment| {
                let not_known = |error: &NoOptimum| matches!(error, NoOptimum::NotKnown { .. });
                let environment = environment(assignment).filter(|_| is_optimal(assignment))?;
                let error = check(&environment, assignment.scenario).err().filter(not_known)?;
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

    /// A rule looks at a number or two; the optimal one is computed before its first episode.
    fn work(&self, task: &Task) -> Work {
        let training = match self.rule {
            DecisionRule::Optimal => task.steps(1).saturating_mul(OPTIMUM_PER_STEP),
            DecisionRule::Never
            | DecisionRule::Untailored
            | DecisionRule::Tailored
            | DecisionRule::Threshold
            | DecisionRule::Random => 0,
        };
        Work { training, choice: 1 }
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        Ok(Start::Actor(Box::new(RulePolicy::new(self, task.environment, task.scenario)?)))
    }

    fn trained(&self, _: &Task, _: &Weights, _: Actions) -> Result<Box<dyn Actor>, WeightsError> {
        Err(WeightsError::NoNetwork)
    }
}
