//! The registration of decision rules.

use crate::agent::constraint::HORIZON;
use crate::agent::rule::{DecisionRule, RuleParameters, RulePolicy};
use crate::env::recorded::RecordedModel;
use crate::env::{Population, Scenario, StepCount, population};
use crate::key::{Assignment, Constraint, Key, Keyed, Parameter, Size, Value, Violation};
use crate::optimum::{LONGEST_OPTIMUM, NoOptimum, check, check_people};

use super::algorithm::{AlgorithmParameters, Start, StartError, Task, Work};

const RULE: Parameter = Parameter::Agent("rule");

const SIGMA: Parameter = Parameter::Environment("sigma");

/// A key that recorded trials alone have.
const KEEP_IDENTIFIERS: Parameter = Parameter::Environment("keep_identifiers");

/// Cost of computing an optimum per step of its horizon, in multiply-adds that take equally long.
const OPTIMUM_PER_STEP: u64 = 100_000_000;

/// Keys of the environment.
const KEYS: &[Key] = StepCount::KEYS;

/// The rule, all keys of the environment in their order, and the scenario.
const RULE_AND_ENVIRONMENT: [Parameter; KEYS.len() + 2] = {
    let mut all = [RULE; KEYS.len() + 2];
    all[KEYS.len() + 1] = Parameter::SCENARIO;
    let mut index = 0;
    while index < KEYS.len() {
        all[index + 1] = Parameter::Environment(KEYS[index].name);
        index += 1;
    }
    all
};

const POPULATION: &[Key] = Population::KEYS;

/// The rule and all keys of the population, in their order.
const RULE_AND_POPULATION: [Parameter; POPULATION.len() + 1] = {
    let mut all = [RULE; POPULATION.len() + 1];
    let mut index = 0;
    while index < POPULATION.len() {
        all[index + 1] = Parameter::Population(POPULATION[index].name);
        index += 1;
    }
    all
};

/// The environment, given the values of [`RULE_AND_ENVIRONMENT`].
fn environment(assignment: &Assignment) -> Option<StepCount> {
    assignment.keyed(|key| matches!(key, Parameter::Environment(_)))
}

/// The scenario, given its name among the values.
fn scenario(assignment: &Assignment) -> Option<Scenario> {
    assignment.text(Parameter::SCENARIO).parse().ok()
}

fn not_possible(error: &NoOptimum) -> Violation {
    Violation::Impossible {
        says: format!("rule = \"optimal\" is not possible: {error}"),
        help: "use another rule, or leave out these cells with [[exclude]]".to_owned(),
    }
}

fn is_optimal(assignment: &Assignment) -> bool {
    assignment.is_word(RULE, DecisionRule::Optimal.word())
}

impl AlgorithmParameters for RuleParameters {
    const NAME: &'static str = "rule";
    const UNREAD_IN_TRIALS: Option<&'static [&'static str]> = Some(&[]);
    const LEARNS: bool = false;
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[RULE, SIGMA],
            violation: |assignment| {
                // Environments of other families have no such key.
                let rule = assignment.value(RULE).filter(|_| assignment.value(SIGMA).is_none())?;
                let Value::Choice(word) = rule else { return None };
                let acts = DecisionRule::named(word).and_then(RulePolicy::anywhere).is_some();
                (!acts).then(|| Violation::Impossible {
                    says: format!("rule = \"{word}\" needs an environment of the family step_count"),
                    help: "in every family, the rules are \"never\", which takes action 0, and \"random\""
                        .to_owned(),
                })
            },
        },
        Constraint {
            parameters: &[RULE, KEEP_IDENTIFIERS],
            violation: |assignment| {
                let is_recorded = assignment.is_word(RULE, DecisionRule::Recorded.word())
                    && assignment.value(KEEP_IDENTIFIERS).is_none();
                is_recorded.then(|| Violation::Impossible {
                    says: "rule = \"recorded\" repeats the actions of a recorded trial, and the manifest has no [data]"
                        .to_owned(),
                    help: "use another rule, or write [data] in the place of [environment]".to_owned(),
                })
            },
        },
        Constraint {
            parameters: &[Parameter::SCENARIO, RULE],
            violation: |assignment| {
                let scenario = scenario(assignment)?;
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
                violated.then_some(Violation::TooLarge(Size { what, unit, size, most }))
            },
        },
        Constraint {
            parameters: &RULE_AND_ENVIRONMENT,
            violation: |assignment| {
                let not_known = |error: &NoOptimum| matches!(error, NoOptimum::NotKnown { .. });
                let environment = environment(assignment).filter(|_| is_optimal(assignment))?;
                let error = check(&environment, &scenario(assignment)?).err().filter(not_known)?;
                Some(not_possible(&error))
            },
        },
        Constraint {
            parameters: &RULE_AND_POPULATION,
            violation: |assignment| {
                let population = population(assignment).filter(|_| is_optimal(assignment))?;
                check_people(&population).err().as_ref().map(not_possible)
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
            | DecisionRule::Random
            | DecisionRule::Recorded => 1,
        }
    }

    /// 0, because a rule does not learn.
    fn episodes(&self) -> u32 {
        0
    }

    /// A rule reads one or two numbers per step; the optimal rule is computed before its first
    /// episode.
    fn work(&self, task: &Task) -> Work {
        let training = match self.rule {
            DecisionRule::Optimal => task.steps(1).saturating_mul(OPTIMUM_PER_STEP),
            DecisionRule::Never
            | DecisionRule::Untailored
            | DecisionRule::Tailored
            | DecisionRule::Threshold
            | DecisionRule::Random
            | DecisionRule::Recorded => 0,
        };
        Work { training, choice: 1 }
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        Ok(Start::Actor(Box::new(self.policy(task)?)))
    }
}

impl RuleParameters {
    /// The rule of a task.
    ///
    /// **Errors**: the rule does not exist in the task's environment.
    pub fn policy(&self, task: &Task) -> Result<RulePolicy, StartError> {
        if self.rule == DecisionRule::Recorded
            && task.environment.model::<RecordedModel>().is_none()
        {
            return Err(StartError::NotRecorded);
        }
        let Some(model) = task.step_count() else {
            let policy = RulePolicy::anywhere(self.rule);
            return policy.ok_or(StartError::Family { rule: self.rule.word() });
        };
        if self.rule == DecisionRule::Optimal {
            check_people(&model.population)?;
        }
        let policy = RulePolicy::new(self, &model.parameters, task.scenario)?;
        Ok(policy.among(&model.widest(), task.scenario))
    }
}
