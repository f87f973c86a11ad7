//! The registration of decision rules.

use crate::agent::constraint::{Constraint, Violation};
use crate::agent::policy::Policy;
use crate::agent::rule::{DecisionRule, Rule, RulePolicy};
use crate::agent::{Actions, OutOfMemory, Weights, WeightsError};
use crate::key::Parameter;

use super::algorithm::{AlgorithmParameters, Setting, Start};

impl AlgorithmParameters for DecisionRule {
    const NAME: &'static str = "rule";
    const LEARNS: bool = false;
    const CONSTRAINTS: &'static [Constraint] = &[Constraint {
        parameters: &[Parameter::Scenario, Parameter::Agent("rule")],
        violation: |chosen| {
            let optimal = Rule::Optimal.word();
            let is_optimal = chosen.is_word(Parameter::Agent("rule"), optimal);
            let scenario = chosen.scenario;
            (is_optimal && !scenario.shows_state()).then(|| Violation::Impossible {
                says: format!(
                    "rule = \"{optimal}\" needs scenarios with H and D, found {scenario}"
                ),
                help: format!(
                    "leave such cells out: [[exclude]] with agent.rule = \"{optimal}\" and \
                     scenario = \"{scenario}\""
                ),
            })
        },
    }];

    fn version(&self) -> u32 {
        match self.rule {
            Rule::Optimal => 3,
            Rule::Never | Rule::Untailored | Rule::Tailored | Rule::Threshold | Rule::Random => 1,
        }
    }

    /// None: a rule learns nothing.
    fn episodes(&self) -> u32 {
        0
    }

    fn start(&self, setting: &Setting) -> Result<Start, OutOfMemory> {
        let policy = RulePolicy::new(self, setting.environment, setting.scenario);
        Ok(Start::Rule(policy.expect("a manifest has the optimal rule where H and D are shown")))
    }

    fn trained(
        &self,
        _: &Setting,
        _: &Weights,
        _: Actions,
    ) -> Result<Box<dyn Policy>, WeightsError> {
        Err(WeightsError::NoNetwork)
    }
}
