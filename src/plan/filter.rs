//! `--filter agent=dqn,sigma=0.6`: which jobs of a manifest a command is about.

use std::collections::HashSet;
use std::fmt;
use std::str::FromStr;

use super::PlannedJob;
use super::described::{shown, value_of};
use crate::agent::Algorithm;
use crate::env::Scenario;
use crate::key::{Kind, Parameter, Value};
use crate::manifest::{self, Section, nearest, parameters, printable, short_name};

/// Values that a message lists before it breaks off.
const VALUES_SHOWN: usize = 10;
/// Names that a message lists, the nearest ones.
const NAMES_SHOWN: usize = 5;

/// Letters of a name that are compared with those of others.
const LONGEST_COMPARED: usize = 60;

/// Conditions that a job must all meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Filter(Vec<Term>);

/// A condition with the words it was written in, which messages repeat.
#[derive(Clone, Debug, PartialEq)]
struct Term {
    name: String,
    /// Any of them will do.
    values: Vec<String>,
    /// `None` if there is no parameter of the name.
    met: Option<manifest::Condition>,
}

/// What is wrong with a filter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FilterError {
    /// A part without a name, an equals sign or a value.
    #[error(
        "`{}` is not `name=value`; write for instance agent=dqn,sigma=0.4|0.6,scenario=P-H-D",
        printable(.0)
    )]
    Form(String),
    /// There is no parameter of that name.
    #[error(
        "no job has a parameter `{}`{}; the nearest names are {known}",
        printable(.name), meant(.nearest)
    )]
    Unknown {
        /// The name given.
        name: String,
        /// The name that was probably meant.
        nearest: Option<String>,
        /// The nearest names.
        known: String,
    },
    /// None of the jobs that meet the conditions before this one has the parameter.
    #[error("no job{} has a parameter `{name}`", with(.before))]
    Absent {
        /// The parameter's name.
        name: String,
        /// The conditions before.
        before: String,
    },
    /// None of the jobs that meet the conditions before this one meets it.
    #[error(
        "no job{} has {}{}; its values: {values}",
        with(.before), printable(.condition), meant(.nearest)
    )]
    Unmet {
        /// The condition.
        condition: String,
        /// The conditions before.
        before: String,
        /// The value that was probably meant.
        nearest: Option<String>,
        /// The values there are.
        values: String,
    },
}

fn with(conditions: &str) -> String {
    if conditions.is_empty() { String::new() } else { format!(" with {}", printable(conditions)) }
}

fn meant(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or(String::new(), |word| format!(", did you mean {}?", printable(word)))
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
            // As exclusions name it.
            let name = if name.trim() == "agent.name" { "agent" } else { name.trim() };
            Ok(Term::written(name.to_owned(), values))
        };
        let mut depth = 0usize;
        let parts = text.split(|c| {
            match c {
                '[' => depth += 1,
                ']' => depth = depth.saturating_sub(1),
                _ => {}
            }
            // The commas of a list do not separate conditions.
            c == ',' && depth == 0
        });
        Ok(Filter(parts.map(condition).collect::<Result<_, _>>()?))
    }
}

impl Filter {
    /// Whether the job meets every condition.
    pub fn meets(&self, planned: &PlannedJob) -> bool {
        self.0.iter().all(|condition| condition.meets(planned))
    }

    /// Why none of the jobs meets every condition: the first that none meets together with those
    /// before it.
    pub fn why_none<I: Iterator<Item = PlannedJob>>(&self, jobs: impl Fn() -> I) -> FilterError {
        let known = names();
        let unknown = self.0.iter().find(|condition| !condition.is_known(&known));
        if let Some(Term { name, .. }) = unknown {
            let words = known.iter().flat_map(|word| [word.as_str(), short_name(word)]);
            let meant = nearest(name, words).map(|word| format!("`{word}`"));
            let known = nearest_names(name, &known);
            return FilterError::Unknown { name: name.clone(), nearest: meant, known };
        }
        let unmet = (1..self.0.len()).find(|count| {
            !jobs().any(|planned| self.0[..*count].iter().all(|c| c.meets(&planned)))
        });
        let (before, rest) = self.0.split_at(unmet.unwrap_or(self.0.len()) - 1);
        rest[0].why_unmet(before, jobs())
    }

    /// What is wrong with a value that no job has, where others of its condition are met.
    pub fn unmet_alternative<I: Iterator<Item = PlannedJob>>(
        &self,
        jobs: impl Fn() -> I,
    ) -> Option<FilterError> {
        let several = self.0.iter().filter(|condition| condition.values.len() > 1);
        let mut alternatives: Vec<Term> = several.flat_map(Term::alternatives).collect();
        for planned in jobs() {
            if alternatives.is_empty() {
                return None;
            }
            alternatives.retain(|alternative| !alternative.meets(&planned));
        }
        alternatives.first().map(|alternative| alternative.why_unmet(&[], jobs()))
    }
}

impl Term {
    /// The condition that is written so; values that no job can have are met by none.
    fn written(name: String, values: Vec<String>) -> Term {
        let met = condition(&name, &values);
        Term { name, values, met }
    }

    fn is_known(&self, names: &[String]) -> bool {
        names.iter().any(|name| *name == self.name || short_name(name) == self.name)
    }

    /// A condition for each of the values.
    fn alternatives(&self) -> impl Iterator<Item = Term> {
        self.values.iter().map(|value| Term::written(self.name.clone(), vec![value.clone()]))
    }

    fn meets(&self, planned: &PlannedJob) -> bool {
        self.met.as_ref().is_some_and(|condition| condition.is_met_by(planned))
    }

    fn value_in(&self, planned: &PlannedJob) -> Option<String> {
        value_of(&planned.agent, &planned.job, &self.name).map(|value| shown(&value))
    }

    fn why_unmet(&self, before: &[Term], jobs: impl Iterator<Item = PlannedJob>) -> FilterError {
        let met_before = before.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
        let jobs = jobs.filter(|planned| before.iter().all(|condition| condition.meets(planned)));
        let mut seen = HashSet::new();
        let mut values: Vec<String> = jobs
            .filter_map(|planned| self.value_in(&planned))
            .filter(|value| seen.insert(value.clone()))
            .collect();
        if values.is_empty() {
            return FilterError::Absent { name: self.name.clone(), before: met_before };
        }
        let nearest = self.values.iter().find_map(|wanted| nearest_value(wanted, &values));
        let left_out = values.len() > VALUES_SHOWN;
        values.truncate(VALUES_SHOWN);
        if left_out {
            values.push("…".to_owned());
        }
        FilterError::Unmet {
            condition: self.to_string(),
            before: met_before,
            nearest,
            values: printable(&values.join(", ")),
        }
    }
}

impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.values.join("|"))
    }
}

/// The names that conditions can have; the last part of a dotted one will do.
fn names() -> Vec<String> {
    let mut names = vec!["agent".to_owned(), "agent.algorithm".to_owned()];
    names.extend(parameters().into_iter().map(|parameter| parameter.to_string()));
    names
}

/// What a condition of these words asks for; `None` if there is no parameter of the name.
fn condition(name: &str, written: &[String]) -> Option<manifest::Condition> {
    fn read<T>(written: &[String], read: impl Fn(&str) -> Option<T>) -> Vec<T> {
        written.iter().filter_map(|word| read(word)).collect()
    }
    if name == "agent" {
        return Some(manifest::Condition::AgentName(written.to_vec()));
    }
    if matches!(name, "algorithm" | "agent.algorithm") {
        let known = |word: &str| Some(Value::Choice(Algorithm::named(word)?.name()));
        let values = read(written, known);
        let parameter = Parameter::Agent("algorithm");
        return Some(manifest::Condition::Key { parameter, values });
    }
    let mut named = parameters().into_iter().filter(|one| {
        let dotted = one.to_string();
        dotted == name || short_name(&dotted) == name
    });
    Some(match named.next()? {
        Parameter::Scenario => {
            manifest::Condition::Scenario(read(written, |word| word.parse::<Scenario>().ok()))
        }
        Parameter::Seed => manifest::Condition::Seed(read(written, whole)),
        parameter @ (Parameter::Environment(key)
        | Parameter::Agent(key)
        | Parameter::Evaluation(key)) => {
            let sections = Section::all().into_iter();
            let kinds = sections.filter_map(|section| section.find(key).map(|(_, key)| key.kind));
            let kinds: Vec<Kind> = kinds.collect();
            let value = |word: &str| kinds.iter().find_map(|kind| value(*kind, word));
            manifest::Condition::Key { parameter, values: read(written, value) }
        }
    })
}

/// The value of a kind that is written so, in its range or not.
fn value(kind: Kind, word: &str) -> Option<Value> {
    let numbers = || serde_json::from_str::<Vec<f64>>(word).ok();
    match kind {
        Kind::Real { .. } | Kind::PositiveReal { .. } => word.parse().ok().map(Value::Real),
        Kind::Integer { .. } => whole(word).map(Value::Integer),
        Kind::Flag => match word {
            "true" | "1" => Some(Value::Flag(true)),
            "false" | "0" => Some(Value::Flag(false)),
            _ => None,
        },
        Kind::Choice(words) => {
            words.iter().find(|known| **known == word).map(|known| Value::Choice(known))
        }
        Kind::RealPair { .. } => numbers()?.try_into().ok().map(Value::RealPair),
        Kind::Widths { .. } => {
            let width = |number: f64| whole(&number.to_string())?.try_into().ok();
            numbers()?.into_iter().map(width).collect::<Option<_>>().map(Value::Widths)
        }
    }
}

/// The whole number that is written so, such as `64` or `64.0`.
fn whole(word: &str) -> Option<u64> {
    // As numbers with a fraction, larger ones would be equal to their neighbours.
    const END: f64 = (1_u64 << f64::MANTISSA_DIGITS) as f64;
    let real = || word.parse().ok().filter(|x: &f64| x.fract() == 0.0 && (0.0..END).contains(x));
    word.parse().ok().or_else(|| real().map(|x| x as u64))
}

/// The names nearest to one that there is not, nearest first.
fn nearest_names(name: &str, known: &[String]) -> String {
    // Longer than any name, what it begins with tells as much as the whole.
    let name: String = name.chars().take(LONGEST_COMPARED).collect();
    let distance = |word: &str| strsim::damerau_levenshtein(&name, word);
    let mut known: Vec<&str> = known.iter().map(String::as_str).collect();
    known.sort_by_cached_key(|word| match short_name(word) {
        part if part == *word => distance(word),
        part => distance(word).min(distance(part)),
    });
    known.truncate(NAMES_SHOWN);
    known.join(", ")
}

/// The value that comes nearest: the number, or the text if one is near enough to be meant.
fn nearest_value(wanted: &str, values: &[String]) -> Option<String> {
    let Ok(number) = wanted.parse::<f64>() else {
        return nearest(wanted, values.iter().map(String::as_str)).map(str::to_owned);
    };
    let distance =
        |value: &&String| value.parse::<f64>().map_or(f64::INFINITY, |x| (x - number).abs());
    let near = values.iter().min_by(|one, other| distance(one).total_cmp(&distance(other)))?;
    distance(&near).is_finite().then(|| near.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{Agent, DuelingDqn, Reinforce};
    use crate::env::Environment;
    use crate::manifest::Evaluation;
    use crate::plan::Job;

    fn jobs() -> Vec<PlannedJob> {
        let agents = [
            ("dqn", Agent::of(&DuelingDqn::default())),
            ("reinforce", Agent::of(&Reinforce::default())),
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
                jobs.push(PlannedJob { agent: name.into(), form: job.form(), job });
            }
        }
        jobs
    }

    fn filter(text: &str) -> Filter {
        text.parse().unwrap()
    }

    fn selected(text: &str) -> usize {
        jobs().iter().filter(|planned| filter(text).meets(planned)).count()
    }

    fn why_none(text: &str) -> String {
        assert_eq!(selected(text), 0, "{text}");
        filter(text).why_none(|| jobs().into_iter()).to_string()
    }

    #[test]
    fn conditions_select_by_agent_scenario_and_any_parameter() {
        assert_eq!(selected("agent=dqn"), 3);
        assert_eq!(selected("agent=dqn,sigma=0.6"), 1);
        assert_eq!(selected("agent.name=dqn"), 3);
        assert_eq!(selected("sigma=0.4|1"), 4);
        assert_eq!(selected("environment.sigma=0.40, scenario=P-H-D"), 2);
        assert_eq!(selected("agent.batch=64"), 3);
        assert_eq!(selected("batch=64.0"), 3);
        assert_eq!(selected("algorithm=reinforce"), 3);
        assert_eq!(selected("time_one_hot=false"), 6);
        assert_eq!(selected("scenario=L-H-D"), 0);
    }

    #[test]
    fn every_value_of_a_condition_has_to_be_one_that_a_job_has() {
        let unmet = |text: &str| {
            assert_ne!(selected(text), 0, "{text}");
            filter(text).unmet_alternative(|| jobs().into_iter()).map(|error| error.to_string())
        };
        assert_eq!(
            unmet("agent=reinforce|dq").as_deref(),
            Some("no job has agent=dq, did you mean dqn?; its values: dqn, reinforce")
        );
        assert_eq!(unmet("sigma=0.4|0.60|1,agent=dqn|reinforce,seed=1"), None);
        // No job that the other conditions let through has it, but there is one that does.
        assert_eq!(unmet("agent=reinforce,layers=[128]|[128,128]"), None);
    }

    #[test]
    fn lists_are_values_with_commas_of_their_own() {
        assert_eq!(selected("layers=[128]"), 3);
        assert_eq!(selected("layers=[128,128]"), 3);
        assert_eq!(selected("agent=dqn,layers=[128, 128]|[64],sigma=1"), 1);
        assert_eq!(selected("mu=[0.10,0.1]"), 6);
        assert_eq!(selected("layers=128"), 0);
        assert_eq!(selected("layers=[128,64]"), 0);
    }

    #[test]
    fn large_whole_numbers_are_not_confused_with_their_neighbours() {
        let mut planned = jobs().remove(0);
        planned.job.seed = (1 << 53) + 1;
        assert!(filter("seed=9007199254740993").meets(&planned));
        for other in
            ["9007199254740992", "9007199254740994", "9007199254740992.0", "9.007199254740993e15"]
        {
            assert!(!filter(&format!("seed={other}")).meets(&planned), "{other}");
        }
    }

    #[test]
    fn faulty_filters_are_refused() {
        for text in ["", "agent", "agent=", "=dqn", "agent=dqn,,", "sigma=1,[2,3]"] {
            assert!(text.parse::<Filter>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_filter_that_no_job_meets_says_which_condition_and_what_there_is() {
        let unknown = why_none("agent=dqn,siggma=1");
        let expected =
            "no job has a parameter `siggma`, did you mean `sigma`?; the nearest names are ";
        assert!(unknown.starts_with(expected), "{unknown}");
        assert!(unknown.contains("environment.sigma"), "{unknown}");
        assert_eq!(unknown.matches(", ").count(), NAMES_SHOWN, "{unknown}");
        assert_eq!(
            why_none("sigma=0.7,agent=nobody"),
            "no job has sigma=0.7, did you mean 0.6?; its values: 0.4, 0.6, 1.0"
        );
        assert_eq!(
            why_none("sigma=0.6,agent=reinforced"),
            "no job with sigma=0.6 has agent=reinforced, did you mean reinforce?; its values: dqn, \
             reinforce"
        );
        assert_eq!(why_none("scenario=C\u{1b}"), "no job has scenario=C\\u{1b}; its values: P-H-D");
        assert_eq!(
            why_none("agent=dqn,loss_divisor=50"),
            "no job with agent=dqn has a parameter `loss_divisor`"
        );
        assert_eq!(
            why_none("agent=dqn,layers=[128]"),
            "no job with agent=dqn has layers=[128]; its values: [128,128]"
        );
    }
}
