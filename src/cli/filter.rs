//! `--filter agent=dqn,sigma=0.6`: which jobs of a manifest a command is about.

use std::str::FromStr;

use crate::plan::{PlannedJob, Scalar};

/// Conditions that a job must all meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Filter(Vec<Condition>);

#[derive(Clone, Debug, PartialEq)]
struct Condition {
    name: String,
    /// Any of them will do.
    values: Vec<String>,
}

/// What is wrong with a filter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum FilterError {
    /// A part without a name, an equals sign or a value.
    #[error("`{0}` is not `name=value`; write for instance agent=dqn,sigma=0.4|0.6,scenario=P-H-D")]
    Form(String),
    /// No job has a parameter of that name.
    #[error("no job has a parameter `{name}`; there are {known}")]
    Unknown {
        /// The name given.
        name: String,
        /// The names there are.
        known: String,
    },
}

impl FromStr for Filter {
    type Err = FilterError;

    fn from_str(text: &str) -> Result<Self, FilterError> {
        let condition = |part: &str| {
            let fault = || FilterError::Form(part.to_owned());
            let (name, values) = part.split_once('=').ok_or_else(fault)?;
            let values: Vec<String> = values.split('|').map(|v| v.trim().to_owned()).collect();
            if name.trim().is_empty() || values.iter().any(String::is_empty) {
                return Err(fault());
            }
            Ok(Condition { name: name.trim().to_owned(), values })
        };
        Ok(Filter(text.split(',').map(condition).collect::<Result<_, _>>()?))
    }
}

impl Filter {
    /// The jobs that meet every condition.
    ///
    /// **Errors**: a condition names a parameter that none of the jobs has.
    pub(super) fn select(&self, jobs: Vec<PlannedJob>) -> Result<Vec<PlannedJob>, FilterError> {
        if self.0.is_empty() {
            return Ok(jobs);
        }
        let mut known = vec![false; self.0.len()];
        let mut names = std::collections::BTreeSet::new();
        let mut selected = Vec::new();
        for planned in jobs {
            let facts = facts(&planned);
            let meets = self.0.iter().zip(&mut known).fold(true, |meets, (condition, known)| {
                let value = facts.iter().find(|(name, _)| condition.is_about(name));
                *known |= value.is_some();
                meets & value.is_some_and(|(_, value)| condition.allows(value))
            });
            if meets {
                selected.push(planned);
            }
            if known.contains(&false) {
                names.extend(facts.into_iter().map(|(name, _)| name));
            }
        }
        match self.0.iter().zip(known).find(|(_, known)| !known) {
            Some((condition, _)) if !names.is_empty() => Err(FilterError::Unknown {
                name: condition.name.clone(),
                known: names.into_iter().collect::<Vec<_>>().join(", "),
            }),
            _ => Ok(selected),
        }
    }
}

impl Condition {
    /// Whether this is about the parameter: by its dotted name, or the last part of it.
    fn is_about(&self, name: &str) -> bool {
        name == self.name || name.rsplit('.').next() == Some(self.name.as_str())
    }

    fn allows(&self, value: &Scalar) -> bool {
        self.values.iter().any(|wanted| match value {
            Scalar::Text(text) => text == wanted,
            Scalar::Integer(0 | 1) if wanted == "true" || wanted == "false" => {
                (*value == Scalar::Integer(1)) == (wanted == "true")
            }
            Scalar::Integer(number) => wanted.parse() == Ok(*number as f64),
            Scalar::Real(number) => wanted.parse() == Ok(*number),
        })
    }
}

/// What conditions can be about: the agent's name and every parameter.
fn facts(planned: &PlannedJob) -> Vec<(String, Scalar)> {
    let mut facts = vec![("agent".to_owned(), Scalar::Text(planned.agent.to_string()))];
    facts.extend(planned.job.parameters());
    facts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::{Agent, DuelingDqn, Environment, Evaluation, Reinforce};
    use crate::plan::Job;

    fn jobs() -> Vec<PlannedJob> {
        let agents = [
            ("dqn", Agent::DuelingDqn(DuelingDqn::default())),
            ("reinforce", Agent::Reinforce(Reinforce::default())),
        ];
        let mut jobs = Vec::new();
        for (name, agent) in agents {
            for sigma in [0.4, 0.6, 1.0] {
                let job = Job {
                    environment: Environment::paper(sigma),
                    scenario: "P-H-D".parse().unwrap(),
                    agent: agent.clone(),
                    evaluation: Evaluation::default(),
                    seed: 1,
                };
                jobs.push(PlannedJob { agent: name.into(), job });
            }
        }
        jobs
    }

    fn selected(filter: &str) -> usize {
        filter.parse::<Filter>().unwrap().select(jobs()).unwrap().len()
    }

    #[test]
    fn conditions_select_by_agent_scenario_and_any_parameter() {
        assert_eq!(selected("agent=dqn"), 3);
        assert_eq!(selected("agent=dqn,sigma=0.6"), 1);
        assert_eq!(selected("sigma=0.4|1"), 4);
        assert_eq!(selected("environment.sigma=0.40, scenario=P-H-D"), 2);
        assert_eq!(selected("agent.batch=64"), 3);
        assert_eq!(selected("time_one_hot=false"), 6);
        assert_eq!(selected("layers=[128]"), 3);
        assert_eq!(selected("scenario=L-H-D"), 0);
    }

    #[test]
    fn faulty_filters_are_refused() {
        for text in ["", "agent", "agent=", "=dqn", "agent=dqn,,"] {
            assert!(text.parse::<Filter>().is_err(), "{text}");
        }
        let fault = "siggma=1".parse::<Filter>().unwrap().select(jobs()).unwrap_err();
        assert!(fault.to_string().contains("environment.sigma"), "{fault}");
    }
}
