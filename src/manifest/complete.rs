//! Completes a draft: reports missing required keys, and fills in all other keys with their defaults.

use crate::env::Family;
use crate::job::EvaluatedOn;
use crate::key::{Content, Distribution, Key, Kind, Parameter, Rows, SectionName, Value};
use crate::manifest::declared::{DeclaredAgent, Exclusion, Manifest, Zip};
use crate::manifest::draft::{Draft, Settings};
use crate::manifest::parameter::Parameters;
use crate::manifest::search::draw::Draw;
use crate::manifest::section::Section;
use crate::manifest::text::written;
use crate::text::{Fault, FaultList, Located, Span};

/// The manifest that `draft` declares; reports missing keys.
///
/// A missing or faulty value is replaced by one valid value, so that the remaining checks can run. If
/// faults were reported, the manifest is valid for these checks only.
pub(super) fn complete(
    draft: &mut Draft,
    path: &str,
    text: &str,
    faults: &mut FaultList,
) -> Manifest {
    let mut missing = |is_missing: bool, message: &str, help: &str| {
        if is_missing {
            faults.add(Fault::at(Span { start: 0, end: 0 }, message).help(help));
        }
    };
    missing(!draft.has_format, "missing key `format`", "write format = 1 at the top");
    missing(draft.name.is_none(), "missing key `name`", "write name = \"my-experiment\"");
    let family = draft.family();
    let help = format!("write scenarios = {}", written::list(&examples(family)));
    missing(draft.scenarios.is_none(), "missing key `scenarios`", &help);
    missing(draft.seeds.is_none(), "missing key `seeds`", "write seeds = 3");
    let agents_missing = draft.agents.is_empty() && !draft.invalid_agents();
    let help = "write an [[agent]] with name and algorithm, or extends = \"paper\"";
    missing(agents_missing, "missing [[agent]]", help);
    if agents_missing {
        draft.unread_agents.push(None);
    }
    for settings in draft.all_settings() {
        require(settings, faults);
    }
    let scenarios = draft.scenarios.as_ref().map(|scenarios| scenarios.value.clone());
    let seeds = draft.seeds.as_ref().map(|seeds| seeds.value.clone());
    let exclusions = draft.exclusions.iter().map(|exclusion| {
        let conditions = exclusion.value.iter().map(|condition| condition.value.clone());
        Exclusion { conditions: conditions.collect() }
    });
    let zips = draft.zips.iter().flatten().filter(|zip| zip.value.len() > 1);
    Manifest {
        path: path.to_owned(),
        source: text.to_owned(),
        name: draft.name.as_ref().map(|name| name.value.clone()).unwrap_or_default(),
        question: draft.question.clone(),
        hypothesis: draft.hypothesis.clone(),
        published: draft.published.clone(),
        time_limit_seconds: draft.time_limit_seconds,
        scenarios: given_or(scenarios, || examples(family)[0].clone()),
        seeds: given_or(seeds, || Value::Integer(1)),
        agents: draft
            .agents
            .iter()
            .map(|agent| DeclaredAgent {
                name: agent.name.value.clone(),
                names: [Value::Text(agent.name.value.clone())],
                label: agent.label.as_ref().map(|label| label.value.clone()),
                algorithm: agent.algorithm,
                parameters: parameters(&agent.settings),
                draws: draws(&agent.settings),
            })
            .collect(),
        sections: draft.sections.map(|name, settings| match name {
            SectionName::Evaluation => evaluation(settings),
            _ => parameters(settings),
        }),
        search: draft.search.as_ref().map(|search| search.value.clone()),
        zips: zips.map(|zip| Zip { parameters: zip.value.clone() }).collect(),
        exclusions: exclusions.filter(|exclusion| !exclusion.conditions.is_empty()).collect(),
        estimates: draft.estimates.iter().map(|draft| draft.estimate.clone()).collect(),
        analyses: draft.analyses.iter().map(|draft| draft.analysis.clone()).collect(),
        named_runs: Vec::new(),
    }
}

/// The example scenarios of a family.
fn examples(family: &Family) -> Vec<Value> {
    family.example_scenarios.iter().map(|scenario| Value::Text((*scenario).to_owned())).collect()
}

fn given_or<T>(given: Option<Vec<T>>, harmless: impl Fn() -> T) -> Vec<T> {
    given.filter(|list| !list.is_empty()).unwrap_or_else(|| vec![harmless()])
}

/// Reports the keys of a section that are missing, and marks them as faulty.
fn require(settings: &mut Settings, faults: &mut FaultList) {
    let section = settings.section;
    for (index, key) in section.keys().iter().enumerate() {
        if settings.given.contains_key(&index) || key.default().is_some() {
            continue;
        }
        let span = settings.span.unwrap_or(Span { start: 0, end: 0 });
        let message = format!("missing key `{}` in {}", key.name, section.header());
        let help = format!("it is {}: {}", key.kind.expectation(), key.doc());
        faults.add(Fault::at(span, message).help(help));
        settings.mark_invalid(index, span);
    }
}

/// The parameters of `[evaluation]`. No test follows a trial that is the evaluation itself.
fn evaluation(settings: &Settings) -> Parameters {
    let mut settings = settings.clone();
    let index = |name| Section::Evaluation.find(name).map_or(usize::MAX, |(index, _)| index);
    let in_trial = [Value::Choice(EvaluatedOn::Trial.word())];
    if let Some(on) = settings.given.get(&index("on"))
        && on.value == in_trial
    {
        let none = Located { value: vec![Value::Integer(0)], span: on.span };
        settings.given.entry(index("test_episodes")).or_insert(none);
    }
    parameters(&settings)
}

fn draws(settings: &Settings) -> Vec<(Parameter, Draw)> {
    let section = settings.section;
    let draws = settings.draws.iter();
    draws
        .map(|(index, draw)| (section.parameter(section.keys()[*index].name), draw.value.clone()))
        .collect()
}

fn parameters(settings: &Settings) -> Parameters {
    let section = settings.section;
    let value = |(index, key): (usize, &Key)| {
        let given = settings.given.get(&index).map(|values| values.value.clone());
        given_or(given, || key.default().unwrap_or_else(|| harmless(key.kind)))
    };
    Parameters::new(section, section.keys().iter().enumerate().map(value).collect())
}

/// A valid value of `kind`.
fn harmless(kind: Kind) -> Value {
    match kind {
        Kind::Real { min, .. } => Value::Real(min),
        Kind::PositiveReal { max } => Value::Real(max),
        Kind::Integer { min, .. } => Value::Integer(min),
        Kind::Flag => Value::Flag(false),
        Kind::Choice(words) => Value::Choice(words[0]),
        Kind::RealPair { min, .. } => Value::RealPair([min, min]),
        Kind::Reals { least, min, .. } => Value::Reals(vec![min; least]),
        Kind::Counts { .. } => Value::Wholes(Vec::new()),
        Kind::Widths { .. } => Value::Wholes(vec![1]),
        Kind::Text { .. } => Value::Text("x".to_owned()),
        Kind::Words { .. } => Value::Words(vec!["x".to_owned()]),
        Kind::Scalar => Value::Flag(false),
        Kind::Distribution(_) => Value::Distribution(Distribution::Fixed),
        Kind::Rows(_) => Value::Rows(Rows::default()),
        Kind::Content(_) => Value::Content(Content::default()),
        Kind::AnyOf(kinds) => harmless(kinds[0]),
    }
}
