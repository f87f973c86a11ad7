//! `--filter agent=dqn,gamma=0.9`: restricts a command to some jobs of a manifest.

use serde_json::Value as Json;
use std::collections::HashSet;
use std::fmt;
use std::str::FromStr;

use crate::agent::Algorithm;
use crate::job::{Condition, Described, PlannedJob, short_name, shown, value_of};
use crate::key::printable;
use crate::key::{Kind, Parameter, Value, free_key};
use crate::manifest::{
    Section, free_parameters, nearest, nearest_value, parameters, written_value,
};

/// Maximum number of values that a message lists.
const VALUES_SHOWN: usize = 10;
/// Number of similar names that a message lists.
const NAMES_SHOWN: usize = 5;

/// Number of letters of a name that are compared with other names.
const LONGEST_COMPARED: usize = 60;

/// A conjunction of conditions on a job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Filter(Vec<Term>);

/// A condition, with its text for messages.
#[derive(Clone, Debug, PartialEq)]
struct Term {
    name: String,
    /// Alternatives; one must hold.
    values: Vec<String>,
    /// One for each parameter that the name can mean, of which the jobs have at most one. Empty if no
    /// parameter has the name.
    met: Vec<Condition>,
}

/// What is wrong with a filter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FilterError {
    /// A part without a name, an equals sign or a value.
    #[error(
        "`{}`: expected `name=value`, as in agent=dqn,gamma=0.9|0.99,scenario=P-H-D; a value with a comma \
         or a bar has double quotes, as in 'agent=\"a,b\"'",
        printable(.0)
    )]
    Form(String),
    /// A comma within a number, or a list.
    #[error("`{}`: {}", printable(.0), printable(.1))]
    DecimalComma(String, String),
    /// No parameter has the name.
    #[error(
        "no job has a parameter `{}`{}; similar names are {known}",
        printable(.name), meant(.nearest)
    )]
    Unknown {
        /// The unknown name.
        name: String,
        /// The name that was probably meant.
        nearest: Option<String>,
        /// Similar names.
        known: String,
    },
    /// The jobs have several parameters whose last part is the name.
    #[error("`{}` is ambiguous; use one of {}", printable(.0), .1.join(", "))]
    Ambiguous(String, Vec<String>),
    /// No job that meets the preceding conditions has the parameter.
    #[error("no job{} has a parameter `{name}`", with(.before))]
    Absent {
        /// The parameter's name.
        name: String,
        /// The preceding conditions.
        before: String,
    },
    /// No job that meets the preceding conditions meets this one.
    #[error(
        "no job{} has {}{}; its values: {values}",
        with(.before), printable(.condition), meant(.nearest)
    )]
    Unmet {
        /// The condition.
        condition: String,
        /// The preceding conditions.
        before: String,
        /// The value that was probably meant.
        nearest: Option<String>,
        /// The values of the jobs.
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

    /// Reads conditions that commas separate; bars separate the alternatives of a condition. Separators in
    /// double quotes and in brackets belong to the value. In quotes, `\"` and `\\` stand for a quote and a
    /// backslash.
    fn from_str(text: &str) -> Result<Self, FilterError> {
        let condition = |part: &str| {
            let fault = || FilterError::Form(part.to_owned());
            let (name, values) = part.split_once('=').ok_or_else(fault)?;
            let values = split(values, '|').ok_or_else(fault)?;
            let values: Vec<String> = values.iter().map(|value| value.trim().to_owned()).collect();
            if name.trim().is_empty() || values.iter().any(String::is_empty) {
                return Err(fault());
            }
            // Exclusions use this name.
            let name = if name.trim() == "agent.name" { "agent" } else { name.trim() };
            Ok(Term::written(name.to_owned(), values))
        };
        let parts = split(text, ',').ok_or_else(|| FilterError::Form(text.to_owned()))?;
        let is_number = |part: &str| part.trim().parse::<f64>().is_ok();
        if let Some(at) = parts.iter().position(|part| is_number(part)).filter(|at| *at > 0)
            && parts[at - 1].split_once('=').is_some_and(|(_, value)| is_number(value))
        {
            let written = parts[at - 1..=at].join(",");
            let either = format!("`{}` for either value", written.replace(',', "|"));
            let is_whole = !parts[at - 1..=at].join("").contains('.');
            let says = match is_whole {
                true => format!(
                    "a decimal comma, or a list; write `{}` for one number, and {either}",
                    written.replace(',', ".")
                ),
                false => format!("a list; write {either}"),
            };
            return Err(FilterError::DecimalComma(written, says));
        }
        Ok(Filter(parts.into_iter().map(condition).collect::<Result<_, _>>()?))
    }
}

/// The parts of a text between separators outside of quotes and brackets; `None` if a quote is not closed.
/// A quote opens where a value begins, and anywhere in brackets.
fn split(text: &str, separator: char) -> Option<Vec<&str>> {
    let (mut parts, mut start) = (Vec::new(), 0);
    let (mut depth, mut is_quoted, mut is_escaped, mut begins) = (0_usize, false, false, true);
    for (at, c) in text.char_indices() {
        match c {
            _ if is_escaped => is_escaped = false,
            '\\' if is_quoted => is_escaped = true,
            '"' if is_quoted => is_quoted = false,
            _ if is_quoted => {}
            '"' if begins || depth > 0 => is_quoted = true,
            '[' | '{' => depth += 1,
            ']' | '}' => depth = depth.saturating_sub(1),
            _ if c == separator && depth == 0 => {
                parts.push(&text[start..at]);
                start = at + c.len_utf8();
            }
            _ => {}
        }
        begins = matches!(c, '=' | '|' | ',') || (begins && c.is_whitespace());
    }
    parts.push(&text[start..]);
    (!is_quoted).then_some(parts)
}

/// A value without its quotes.
fn unquoted(written: &str) -> String {
    let inner = written.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
    let text = inner.and_then(|_| serde_json::from_str(written).ok());
    text.unwrap_or_else(|| inner.unwrap_or(written).to_owned())
}

/// A value as a filter writes it, in quotes if it contains a separator.
fn quoted(value: String) -> String {
    let is_list = value.starts_with(['[', '{']);
    let is_plain = !value.contains([',', '|']) && !value.starts_with('"');
    if is_list || is_plain { value } else { serde_json::json!(value).to_string() }
}

impl Filter {
    /// Whether the job meets every condition.
    pub fn meets(&self, job: &impl Described) -> bool {
        self.0.iter().all(|condition| condition.meets(job))
    }

    /// The reason why no job meets all conditions: the first condition that no job meets together with the
    /// preceding ones.
    pub fn why_none<I: Iterator<Item = PlannedJob>>(&self, jobs: impl Fn() -> I) -> FilterError {
        let mut known = names();
        for planned in jobs() {
            let sections = planned.job.sections();
            let named = sections.iter().flat_map(|(section, keys, _)| {
                let free = keys.iter().filter(|key| free_key(key.name).is_some());
                free.map(move |key| section.parameter(key.name).to_string())
            });
            let new: Vec<String> = named.filter(|name| !known.contains(name)).collect();
            known.extend(new);
        }
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

    /// The error for a name that means several parameters of the jobs.
    pub fn ambiguous(&self, jobs: impl Iterator<Item = PlannedJob>) -> Option<FilterError> {
        let mut had: Vec<Vec<Parameter>> = vec![Vec::new(); self.0.len()];
        for planned in jobs {
            for (term, had) in self.0.iter().zip(&mut had) {
                let parameters = term.met.iter().map(|condition| condition.parameter);
                let unseen = parameters.filter(|one| planned.value(*one).is_some());
                let unseen: Vec<Parameter> = unseen.filter(|one| !had.contains(one)).collect();
                had.extend(unseen);
            }
        }
        let (term, had) = self.0.iter().zip(had).find(|(_, had)| had.len() > 1)?;
        let names = had.iter().map(|parameter| format!("`{parameter}`")).collect();
        Some(FilterError::Ambiguous(term.name.clone(), names))
    }

    /// The error for a value that no job has, although other values of its condition occur.
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
    /// The condition with this name and these values; no job meets values that no job can have.
    fn written(name: String, values: Vec<String>) -> Term {
        // These are the whole names of parameters.
        let is_short = !name.contains('.') && !matches!(&*name, "agent" | "scenario" | "seed");
        let of_programs = is_short.then(|| format!("parameters.{name}"));
        let names = [Some(name.as_str()), of_programs.as_deref()].into_iter().flatten();
        let met = names.flat_map(|name| conditions(name, &values)).collect();
        Term { name, values, met }
    }

    fn is_known(&self, names: &[String]) -> bool {
        let is_free = free_parameters(&self.name).next().is_some();
        is_free || names.iter().any(|name| *name == self.name || short_name(name) == self.name)
    }

    /// One condition per value.
    fn alternatives(&self) -> impl Iterator<Item = Term> {
        self.values.iter().map(|value| Term::written(self.name.clone(), vec![value.clone()]))
    }

    fn meets(&self, job: &impl Described) -> bool {
        self.met.iter().any(|condition| condition.is_met_by(job))
    }

    fn value_in(&self, planned: &PlannedJob) -> Option<String> {
        value_of(&planned.agent, &planned.job, &self.name).map(|value| quoted(shown(&value)))
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
        let nearest = nearest.map(str::to_owned);
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

impl fmt::Display for Filter {
    /// Writes the filter so that it can be read again.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.iter().map(ToString::to_string).collect::<Vec<_>>().join(","))
    }
}

impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.name, self.values.join("|"))
    }
}

/// The names that conditions can have; for a dotted name, its last part suffices.
fn names() -> Vec<String> {
    let mut names = vec!["agent".to_owned(), "agent.algorithm".to_owned()];
    names.extend(parameters().into_iter().map(|parameter| parameter.to_string()));
    names
}

/// The conditions that this name and these words can mean, one for each parameter of the name.
fn conditions(name: &str, written: &[String]) -> Vec<Condition> {
    let is_named = |parameter: Parameter, values| vec![Condition { parameter, values }];
    let texts = || written.iter().map(|word| Value::Text(unquoted(word))).collect();
    match name {
        "agent" => return is_named(Parameter::AGENT_NAME, texts()),
        "scenario" => return is_named(Parameter::SCENARIO, texts()),
        "seed" => {
            let seed = |word: &String| whole(&unquoted(word)).map(Value::Integer);
            return is_named(Parameter::SEED, written.iter().filter_map(seed).collect());
        }
        "algorithm" | "agent.algorithm" => {
            let known =
                |word: &String| Some(Value::Choice(Algorithm::named(&unquoted(word))?.name()));
            return is_named(Parameter::ALGORITHM, written.iter().filter_map(known).collect());
        }
        _ => {}
    }
    let named = parameters().into_iter().filter(|one| {
        let dotted = one.to_string();
        dotted == name || short_name(&dotted) == name
    });
    let of_parameter = |parameter: Parameter| {
        let of_section = |section: Section| {
            let (_, key) = section.find(parameter.key())?;
            (section.parameter(key.name) == parameter).then_some(key.kind)
        };
        let kinds = Section::all().into_iter().filter_map(of_section);
        let kinds: Vec<Kind> = kinds.chain(free_key(parameter.key()).map(|key| key.kind)).collect();
        let value = |word: &String| kinds.iter().find_map(|kind| value(*kind, word));
        Condition { parameter, values: written.iter().filter_map(value).collect() }
    };
    named.chain(free_parameters(name)).map(of_parameter).collect()
}

/// The value of a kind for a word, in range or not, read as a manifest reads it. Quotes make a scalar a text; of
/// other kinds, they are no part of the value. Flags and whole numbers may also be written as the store shows them.
fn value(kind: Kind, written: &str) -> Option<Value> {
    let word = unquoted(written);
    let text = || kind.value(&Json::String(word.clone()));
    match kind {
        Kind::Choice(_)
        | Kind::Text { .. }
        | Kind::Distribution(_)
        | Kind::Rows(_)
        | Kind::Content(_) => text(),
        Kind::Integer { .. } => whole(&word).map(Value::Integer),
        Kind::Flag if word == "1" => Some(Value::Flag(true)),
        Kind::Flag if word == "0" => Some(Value::Flag(false)),
        Kind::AnyOf(kinds) => kinds.iter().find_map(|kind| value(*kind, written)),
        Kind::Scalar => {
            let value = written_value(written).and_then(|value| kind.value(&value));
            value.or_else(text)
        }
        _ => kind.value(&written_value(&word)?),
    }
}

/// The integer for a word such as `64` or `64.0`.
fn whole(word: &str) -> Option<u64> {
    // Larger integers can be equal as floating-point numbers.
    const END: f64 = (1_u64 << f64::MANTISSA_DIGITS) as f64;
    let real = || word.parse().ok().filter(|x: &f64| x.fract() == 0.0 && (0.0..END).contains(x));
    word.parse().ok().or_else(|| real().map(|x| x as u64))
}

/// The known names most similar to an unknown name, most similar first.
fn nearest_names(name: &str, known: &[String]) -> String {
    // For a text longer than every known name, its beginning suffices.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{Agent, DuelingDqn, Reinforce};
    use crate::env::StepCount;
    use crate::job::Evaluation;
    use crate::job::Job;

    fn jobs() -> Vec<PlannedJob> {
        let agents = [
            ("dqn", Agent::of(&DuelingDqn::default())),
            ("reinforce", Agent::of(&Reinforce::default())),
        ];
        let mut jobs = Vec::new();
        for (name, agent) in agents {
            for sigma in [0.4, 0.6, 1.0] {
                let job = Job {
                    environment: StepCount::paper(sigma).into(),
                    scenario: "P-H-D".parse().unwrap(),
                    agent: agent.clone(),
                    evaluation: Evaluation::default(),
                    trial: None,
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
        // No job has the value under the other conditions, but another job does.
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
        let expected = "no job has a parameter `siggma`, did you mean `sigma`?; similar names are ";
        assert!(unknown.starts_with(expected), "{unknown}");
        assert!(unknown.contains("environment.sigma"), "{unknown}");
        assert_eq!(unknown.matches(", ").count(), NAMES_SHOWN, "{unknown}");
        assert_eq!(
            why_none("sigma=0.7,agent=nobody"),
            "no job has sigma=0.7, did you mean 0.6?; its values: 0.4, 0.6, 1"
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
