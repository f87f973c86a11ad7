//! The registration of decision rules.

use crate::agent::actor::Actor;
use crate::agent::constraint::{Chosen, Constraint, HORIZON, TEST_DECISIONS_FIT, Violation};
use crate::agent::learner::Actions;
use crate::agent::rule::{DecisionRule, RuleParameters, RulePolicy};
use crate::agent::weights::{Weights, WeightsError};
use crate::key::Parameter;
use crate::optimum::LONGEST_OPTIMUM;

use super::algorithm::{AlgorithmParameters, Setting, Start, StartError};

const RULE: Parameter = Parameter::Agent("rule");

fn is_optimal(chosen: &Chosen) -> bool {
    chosen.is_word(RULE, DecisionRule::Optimal.word())
}

impl AlgorithmParameters for RuleParameters {
    const NAME: &'static str = "rule";
    const LEARNS: bool = false;
    const CONSTRAINTS: &'static [Constraint] = &[
        TEST_DECISIONS_FIT,
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
