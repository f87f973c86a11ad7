//! `[data]`: a trial that happened, in the place of `[environment]`.
//!
//! The table is read as an environment of the family `recorded`. What the file says of the trial need not be written:
//! its people and their days, an agent that repeats the recorded actions, and that decisions are stored.

use std::borrow::Cow;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::agent::{Algorithm, DecisionRule, UNAVAILABLE, Unavailable};
use crate::env::Scenario;
use crate::env::recorded::{DATA, FAMILY, LIST, RecordedLog, RecordedModel};
use crate::job::{Condition, Estimator, EvaluatedOn, MetricName, RecordedDecisions, STAYS};
use crate::key::{Content, Key, Parameter, SectionName, Value};
use crate::manifest::analysis::declared::{Analysis, AnalysisDraft};
use crate::manifest::analysis::figure_keys::FigureKeys;
use crate::manifest::analysis::forms::NameList;
use crate::manifest::analysis::kind::{AnalysisKind, Effects, Randomisation};
use crate::manifest::declared::{DeclaredAgent, Manifest};
use crate::manifest::draft::{AgentDraft, Draft, Settings};
use crate::manifest::section::Section;
use crate::manifest::value::free;
use crate::manifest::value::sweep::Node;
use crate::text::{Fault, FaultList, Located, Span};

/// The name of the agent that repeats the recorded actions, where none is declared.
const RECORDED: &str = "recorded";

/// The most people of a trial.
const MOST_PEOPLE: usize = 10_000;

/// The keys of `[trial]` that a file answers.
const ANSWERED: [&str; 4] = ["dropout", "missing_outcomes", "unreported", "people_file"];

/// The document with its `[data]` as an environment.
pub(super) fn unfolded<'r, 't>(
    root: &'r DeTable<'t>,
    faults: &mut FaultList,
) -> Cow<'r, DeTable<'t>> {
    let Some((key, node)) = root.get_key_value(DATA) else { return Cow::Borrowed(root) };
    if let Some(other) = root.get("environment") {
        let says = "a manifest has [environment] or [data], not both";
        faults.add(Fault::at(other.span().into(), says).help("remove one of the two tables"));
    }
    let mut unfolded = DeTable::new();
    for (other, node) in root.iter().filter(|(other, _)| *other != key) {
        if other.get_ref() != "environment" {
            unfolded.insert(other.clone(), node.clone());
        }
    }
    let mut node = node.clone();
    if let DeValue::Table(table) = node.get_mut() {
        if let Some((written, _)) = table.get_key_value(free::FAMILY) {
            let says = "`family`: [data] is a recorded trial, and has no family";
            faults.add(Fault::at(written.span().into(), says).help("remove it"));
            table.remove(free::FAMILY);
        }
        let lists = |key: &str| ["order", "probability", "state"].contains(&key);
        table.iter_mut().filter(|(key, _)| lists(key.get_ref())).for_each(|(_, node)| join(node));
        let family = Spanned::new(key.span(), DeValue::String(FAMILY.name.into()));
        table.insert(Spanned::new(key.span(), free::FAMILY.into()), family);
    }
    unfolded.insert(Spanned::new(key.span(), "environment".into()), node);
    Cow::Owned(unfolded)
}

/// Makes a list of texts, or a table of texts by name, one text.
fn join(node: &mut Node<'_>) {
    let text = |node: &Node<'_>| node.get_ref().as_str().map(str::to_owned);
    let joined: Option<Vec<String>> = match node.get_ref() {
        DeValue::Array(list) if !list.is_empty() => list.iter().map(text).collect(),
        DeValue::Table(table) => {
            let mut entries: Vec<_> = table.iter().collect();
            entries.sort_by_key(|(name, _)| name.span().start);
            let entry = |(name, node): (&Spanned<_>, &Node<'_>)| {
                Some(format!("{} = {}", name.get_ref(), text(node)?))
            };
            entries.into_iter().map(entry).collect()
        }
        _ => None,
    };
    if let Some(joined) = joined {
        *node = Spanned::new(node.span(), DeValue::String(joined.join(LIST).into()));
    }
}

/// Completes a draft of the family `recorded` by what its file says.
pub(super) fn complete(draft: &mut Draft, faults: &mut FaultList) {
    if draft.family() != &FAMILY {
        return;
    }
    let environment = &draft.sections[SectionName::Environment];
    let span = environment.span.unwrap_or(Span { start: 0, end: 0 });
    let swept = environment.given.iter().filter(|(_, given)| given.value.len() > 1);
    for (index, given) in swept {
        let key = FAMILY.keys[*index].name;
        let says = format!(
            "`{key}`: a manifest reads one recorded trial in one way, and this is a list of several"
        );
        faults.add(Fault::at(given.span, says).help("write a manifest for each"));
    }
    let located = |value| Located { value: vec![value], span };
    draft.scenarios.get_or_insert(located(Value::Text(Scenario::all().to_string())));
    draft.seeds.get_or_insert(located(Value::Integer(1)));
    let agents: Vec<String> =
        draft.agents.iter().filter(|one| is_recorded(one)).map(named).collect();
    if agents.is_empty() {
        if let Some(other) = draft.agents.iter().find(|one| one.name.value == RECORDED) {
            let says = format!(
                "agent `{RECORDED}`: this is the name of the agent that repeats the recorded actions"
            );
            let help = "give it another name, or declare an agent with rule = \"recorded\"";
            faults.add(Fault::at(other.name.span, says).help(help));
        }
        draft.agents.insert(0, recorded_agent(span));
    }
    let agents = if agents.is_empty() { vec![RECORDED.to_owned()] } else { agents };
    let replaying = draft.agents.iter().map(named).filter(|name| !agents.contains(name));
    let replaying: Vec<String> = replaying.collect();
    // Effects rest on the probabilities by which actions were drawn; the value of the agent's policy is that of agents that replay.
    let effects = draft.estimates.iter_mut().map(|one| &mut one.estimate);
    for estimate in effects {
        let is_of_agent = estimate.declaration.is_of_agent();
        let own = match estimate.declaration.estimator {
            Estimator::Value if !is_of_agent || replaying.is_empty() => continue,
            Estimator::Value => &replaying,
            Estimator::Wcls | Estimator::Emee => &agents,
        };
        estimate.agents.get_or_insert_with(|| own.clone());
    }
    analyses(draft, &agents, span);
    let has_trial = draft.sections[SectionName::Trial].section.is_declared();
    let evaluation = &mut draft.sections[SectionName::Evaluation];
    give(evaluation, "record_decisions", Value::Choice(RecordedDecisions::Test.word()), span);
    if has_trial {
        give(evaluation, "on", Value::Choice(EvaluatedOn::Trial.word()), span);
    }
    let model = first(&draft.sections[SectionName::Environment]);
    let Some((model, log)) = model.as_ref().and_then(|model| Some((model, model.log()?))) else {
        // Faults of the file are reported, and people and days are its own.
        return unknown(&mut draft.sections[SectionName::Trial]);
    };
    if let Some(file) = model.numbered() {
        let environment = &mut draft.sections[SectionName::Environment];
        let (index, _) = environment.section.find("file").expect("a key of the family");
        if let Some(given) = environment.given.get_mut(&index) {
            given.value = vec![Value::Content(file)];
        }
    }
    if has_trial {
        return trial(&mut draft.sections[SectionName::Trial], model, faults);
    }
    let people = log.people.len();
    let evaluation = &mut draft.sections[SectionName::Evaluation];
    if let Some(own) = other_than(evaluation, "test_episodes", people) {
        let says =
            format!("`test_episodes`: the file has {people} people, and each is one episode");
        faults.add(Fault::at(own, says).help("remove it"));
    }
    give(evaluation, "test_episodes", Value::Integer(people as u64), span);
}

/// Marks the keys of `[trial]` that a faulty file would give.
fn unknown(settings: &mut Settings) {
    let span = settings.span.unwrap_or(Span { start: 0, end: 0 });
    for key in ["people", "days"] {
        if let Some((index, _)) = settings.section.find(key) {
            settings.mark_invalid(index, span);
        }
    }
}

/// Where a key has another number than the file.
fn other_than(settings: &Settings, key: &str, number: usize) -> Option<Span> {
    let (index, _) = settings.section.find(key)?;
    let given = settings.given.get(&index).filter(|given| !given.value.is_empty())?;
    (given.value != [Value::Integer(number as u64)]).then_some(given.span)
}

/// Adds what the report of every recorded trial has.
fn analyses(draft: &mut Draft, agents: &[String], span: Span) {
    let has = |draft: &Draft, word: &str| {
        draft.analyses.iter().any(|one| one.analysis.kind.word() == word)
    };
    let conditions = vec![Condition::texts(Parameter::AGENT_NAME, agents)];
    let add = |draft: &mut Draft, kind: AnalysisKind, title: &str, conditions: Vec<Condition>| {
        if has(draft, kind.word()) {
            return;
        }
        let mut name = kind.word().to_owned();
        while draft.analyses.iter().any(|one| one.analysis.name == name) {
            name.push('-');
        }
        let analysis = Analysis {
            name,
            title: Some(title.to_owned()),
            metric: MetricName::default(),
            participants: None,
            conditions,
            figure: FigureKeys::default(),
            kind,
        };
        draft.analyses.push(AnalysisDraft {
            index: draft.analyses.len(),
            analysis,
            conditions: Vec::new(),
            participants: None,
            panels: Vec::new(),
            axes: Vec::new(),
            span,
        });
    };
    let drawn = AnalysisKind::Randomisation(Randomisation {});
    add(draft, drawn, "Was it randomised as recorded?", conditions);
    if !draft.estimates.is_empty() {
        let effects = AnalysisKind::Effects(Effects { estimates: NameList(Vec::new()) });
        add(draft, effects, "Estimates", Vec::new());
    }
}

fn named(agent: &AgentDraft) -> String {
    agent.name.value.clone()
}

/// Whether an agent repeats the recorded actions.
fn is_recorded(agent: &AgentDraft) -> bool {
    let rule = agent.settings.section.find("rule");
    let rule = rule.and_then(|(index, _)| agent.settings.given.get(&index));
    rule.is_some_and(|rule| rule.value == [Value::Choice(DecisionRule::Recorded.word())])
}

fn recorded_agent(span: Span) -> AgentDraft {
    let algorithm = Algorithm::named("rule").expect("rules are an algorithm");
    let mut settings = Settings::new(Section::Agent(algorithm));
    give(&mut settings, "rule", Value::Choice(DecisionRule::Recorded.word()), span);
    let name = Located { value: RECORDED.to_owned(), span };
    AgentDraft { name, label: None, algorithm, settings }
}

/// Gives a key that a manifest does not have a value.
fn give(settings: &mut Settings, key: &str, value: Value, span: Span) {
    if let Some((index, _)) = settings.section.find(key) {
        settings.given.entry(index).or_insert(Located { value: vec![value], span });
    }
}

/// The environment with the first value of each key; `None` if one is missing or faulty.
fn first(settings: &Settings) -> Option<RecordedModel> {
    let value = |(index, key): (usize, &Key)| match settings.given.get(&index) {
        Some(given) => given.value.first().cloned(),
        None => key.default(),
    };
    let values: Option<Vec<Value>> = FAMILY.keys.iter().enumerate().map(value).collect();
    (FAMILY.read)(&FAMILY, &values?, &[])?.model().cloned()
}

/// What was found in the file of a manifest that is no fault, as fragments.
pub(super) fn notes(manifest: &Manifest) -> Vec<String> {
    if !manifest.is_recorded() {
        return Vec::new();
    }
    let parameters = manifest.sections[SectionName::Environment].iter();
    let values: Option<Vec<Value>> =
        parameters.map(|(_, values)| values.first().cloned()).collect();
    let environment = values.and_then(|values| (FAMILY.read)(&FAMILY, &values, &[]));
    let model: Option<&RecordedModel> = environment.as_ref().and_then(|of| of.model());
    let log = model.and_then(RecordedModel::log);
    let mut notes = log.map_or_else(Vec::new, |log| log.notes.clone());
    if !manifest.has_trial() && manifest.seeds().count() > 1 {
        notes.push(
            "the decisions of the file are the same for every seed: write seeds = 1".to_owned(),
        );
    }
    notes
}

impl Manifest {
    /// Whether its jobs are about a trial that happened.
    pub fn is_recorded(&self) -> bool {
        self.family() == &FAMILY
    }

    /// Whether an agent replays a recorded trial: the returns of its jobs are of actions that it did not take.
    pub fn replays(&self, agent: &str) -> bool {
        let recorded = [Value::Choice(DecisionRule::Recorded.word())];
        let own = self.agents.iter().find(|one| one.name == agent);
        let rule = own.and_then(|one| one.parameters.get("rule"));
        self.is_recorded() && rule != Some(&recorded)
    }
}

/// Completes `[trial]`, and reports what contradicts the file.
fn trial(settings: &mut Settings, model: &RecordedModel, faults: &mut FaultList) {
    let Some(log) = model.log() else { return };
    for key in ANSWERED {
        if let Some(span) = settings.differs(key) {
            let says = format!("`{key}` is for simulated people, and the file says what happened");
            faults.add(Fault::at(span, says).help("remove it"));
        }
    }
    let span = settings.span.unwrap_or(Span { start: 0, end: 0 });
    let people = log.people.len();
    if people > MOST_PEOPLE {
        let says = format!("the file has {people} people; a replay has at most {MOST_PEOPLE}");
        faults.add(Fault::at(span, says).help("replay a part of the people"));
    }
    if let Some(own) = other_than(settings, "people", people) {
        let says = format!("`people`: the file has {people} people");
        faults.add(Fault::at(own, says).help("remove it"));
    }
    if model.has_calendar() {
        calendar(settings, log, span, faults);
    }
    let per_day = u64::from(log.per_day);
    give(settings, "people", Value::Integer(people as u64), span);
    give(settings, "days", Value::Integer(u64::from(log.horizon()) / per_day), span);
    give(settings, "decisions_per_day", Value::Integer(per_day), span);
}

/// People enter by the calendar of the file.
fn calendar(settings: &mut Settings, log: &RecordedLog, span: Span, faults: &mut FaultList) {
    let mut of_file = None;
    if log.stays().any(|(start, _)| start > 0) {
        let rows = log.stays().map(|(start, end)| format!("{start},{end}\n"));
        let text = format!("start_day,end_day\n{}", rows.collect::<String>());
        of_file = Content::read(&STAYS, &text).ok().map(Value::Content);
    }
    for key in ["entry", "entry_every_days", "entry_people", "entry_first_day"] {
        let Some(own) = settings.differs(key) else { continue };
        // A manifest that is written out in full has what the file says.
        let given = settings.section.find(key).and_then(|(index, _)| settings.given.get(&index));
        if key == "entry" && given.is_some_and(|given| given.value.iter().eq(of_file.iter())) {
            continue;
        }
        let says = format!("`{key}`: people enter by `calendar_day` of [data]");
        faults.add(Fault::at(own, says).help("remove one of the two"));
        // Beside it, what the file says would be a second fault.
        of_file = None;
    }
    if let Some(entry) = of_file {
        give(settings, "entry", entry, span);
    }
}

/// Reports agents that cannot replay a recorded trial.
pub(super) fn check(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) {
    if !manifest.is_recorded() {
        return;
    }
    let recorded: Vec<String> =
        draft.agents.iter().filter(|one| is_recorded(one)).map(named).collect();
    for estimate in &draft.estimates {
        let is_effect = estimate.estimate.declaration.estimator != Estimator::Value;
        let others = estimate.estimate.agents.iter().flatten();
        let others = others.filter(|name| is_effect && !recorded.contains(name));
        for name in others {
            let says = format!(
                "`agents`: an effect rests on the recorded probabilities, and agent `{name}` has others"
            );
            let fault = Fault::at(estimate.span_of("agents"), says);
            faults.add(fault.help(format!("agents of recorded actions: {}", recorded.join(", "))));
        }
    }
    let model = first(&draft.sections[SectionName::Environment]);
    let log = model.as_ref().and_then(RecordedModel::log);
    for (declared, agent) in manifest.agents.iter().zip(&draft.agents) {
        let name = &declared.name;
        let mut fault = |says: String, help: &str| {
            faults.add(Fault::at(agent.name.span, format!("agent `{name}`: {says}")).help(help));
        };
        match declared.algorithm.name() {
            "rule" if manifest.has_trial() || recorded.contains(name) => {}
            "rule" => fault(
                "it replays the updates of a trial, and the manifest has no [trial]".to_owned(),
                "write [trial] with `update_every_days`, such as 1, or rule = \"recorded\"",
            ),
            "linear_thompson" => {
                if !manifest.has_trial() {
                    let says = "it learns at the updates of a trial, and the manifest has no [trial]";
                    fault(says.to_owned(), "write [trial] with `update_every_days`, such as 1");
                }
                if let Some(says) = log.and_then(|log| lacking(manifest, declared, log)) {
                    fault(says, "give the number a value there, as in \"default(log(steps), 0)\"");
                }
            }
            _ if declared.algorithm.is_external() => fault(
                "an outside program cannot replay a recorded trial: it answers for decisions that it makes itself"
                    .to_owned(),
                ABLE,
            ),
            other => {
                fault(format!("{other} cannot replay a recorded trial: it learns from episodes that it plays itself"), ABLE);
            }
        }
    }
}

/// What to write instead of an agent that cannot replay.
const ABLE: &str =
    "agents that can: linear_thompson, and the rules \"recorded\", \"random\" and \"never\"";

/// What an agent observes that some decisions lack.
fn lacking(manifest: &Manifest, agent: &DeclaredAgent, log: &RecordedLog) -> Option<String> {
    let history = manifest.values(agent, Parameter::Agent("history")).unwrap_or_default();
    if history.iter().any(|value| *value != Value::Integer(1)) {
        return Some("a replay shows the present decision alone: write history = 1".to_owned());
    }
    let unavailable = manifest.values(agent, Parameter::Agent(UNAVAILABLE)).unwrap_or_default();
    let chosen = Value::Choice(Unavailable::Chosen.word());
    if unavailable.contains(&chosen) && log.can_withhold() {
        return Some(
            "with unavailable = \"chosen\" it learns from choices that were not taken, which no file has"
                .to_owned(),
        );
    }
    let is_shown = |name: &str| {
        let mut scenarios = manifest.scenarios();
        scenarios.any(|scenario: Scenario| {
            scenario.names().is_none_or(|mut names| names.any(|known| known == name))
        })
    };
    let mut names = log.names.iter().enumerate().filter(|(_, name)| is_shown(name));
    names.find_map(|(index, name)| {
        let (count, line) = log.lacking(index)?;
        Some(format!(
            "it observes `{name}`, which {count} decisions of the file lack, the first in line {line}"
        ))
    })
}
