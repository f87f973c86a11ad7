//! `--set KEY=VALUE`: replaces the value of a manifest's key for one command.
//!
//! In: the text of a valid manifest and overrides. Out: the text with the new values, with all other keys
//! and comments unchanged, and a last line that lists the overrides. The edited text is validated like any
//! other, and is the text that the store and a submission keep.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, TableLike, Value};

use crate::env::recorded::DATA;
use crate::job::short_name;
use crate::key::printable;
use crate::key::{Parameter, SectionName, free_key};
use crate::manifest::commas::decimal_comma;
use crate::manifest::declared::Manifest;
use crate::manifest::load::{load_from, parse_from, read_text};
use crate::manifest::parameter::{is_in, parameters};
use crate::manifest::search;
use crate::manifest::search::declared::Search;
use crate::manifest::table::{Fields, names};
use crate::manifest::text::edits::Edits;
use crate::manifest::value::sweep::Runs;
use crate::text::{Fault, Faults, Source, nearest};

/// Top-level keys that can be set.
const TOP: [&str; 6] =
    ["name", "question", "hypothesis", "time_limit_seconds", "scenarios", "seeds"];

/// A key and its value in TOML, in the notation of `--set`: `agent.gamma=0.9`.
///
/// The key is a top-level key, `environment.KEY`, `population.KEY`, `evaluation.KEY`, `agent.KEY` for every
/// agent with this key, `agent.NAME.KEY` for one agent, or `KEY` alone if only one section has the key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Override {
    key: String,
    value: String,
}

/// An argument that does not have the form `KEY=VALUE`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a key, an equals sign and a value, such as agent.gamma=0.9")]
pub struct OverrideForm;

impl FromStr for Override {
    type Err = OverrideForm;

    fn from_str(text: &str) -> Result<Self, OverrideForm> {
        let (key, value) = text.split_once('=').ok_or(OverrideForm)?;
        let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
        if key.is_empty() || value.is_empty() {
            return Err(OverrideForm);
        }
        Ok(Override { key, value })
    }
}

impl fmt::Display for Override {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.key, self.value)
    }
}

/// The place of an override in the manifest.
enum Place<'m> {
    Top(&'static str),
    Section(&'static str, &'static str),
    Agents(Vec<&'m str>, &'static str),
}

impl Place<'_> {
    /// The dotted name of the parameter, if it has one.
    fn dotted(&self) -> Option<String> {
        match self {
            Place::Top(_) => None,
            Place::Section(section, key) => Some(format!("{section}.{key}")),
            Place::Agents(_, key) => Some(format!("agent.{key}")),
        }
    }
}

/// A manifest with its overrides.
#[derive(Clone, Debug)]
pub struct Overridden {
    /// The manifest.
    pub manifest: Manifest,
    /// The analyses that were left out, because they refer to values that an override replaced; one
    /// sentence fragment each.
    pub left_out: Vec<String>,
}

/// Reads and validates the manifest at `path` with overrides; later overrides replace earlier ones. An
/// analysis that does not hold with the overrides is left out.
///
/// # Errors
/// Every fault of the file; or the first override whose key the manifest cannot have; or every fault of the
/// manifest with its overrides.
pub fn load_with(path: &Path, overrides: &[Override], runs: Runs) -> Result<Overridden, Faults> {
    overridden(load_from(path, runs)?, overrides, runs)
}

/// [`load_with`] of a text; messages call it `label`, and files are relative to the working directory.
///
/// # Errors
/// As [`load_with`].
pub fn parse_with(
    label: &str,
    text: &str,
    overrides: &[Override],
    runs: Runs,
) -> Result<Overridden, Faults> {
    overridden(parse_from(label, text.as_bytes(), runs)?, overrides, runs)
}

fn overridden(
    manifest: Manifest,
    overrides: &[Override],
    runs: Runs,
) -> Result<Overridden, Faults> {
    if overrides.is_empty() {
        return Ok(Overridden { manifest, left_out: Vec::new() });
    }
    let label = &manifest.path;
    let edited = with(&manifest, overrides).map_err(|fault| Faults::of_file(label, fault))?;
    let options: Vec<String> = edited.options.iter().map(|set| format!("--set {set}")).collect();
    let origin = |span| {
        let (span, option) = edited.edits.original(span);
        (span, option.map(|index| options[index].clone()))
    };
    let traced = |faults: Faults| faults.in_original(&manifest.source, origin);
    let (read, faults, lost) = read_text(label, &edited.text, runs).map_err(traced)?;
    if !faults.is_empty() {
        return Err(traced(faults.of(label, Source::new(&edited.text))));
    }
    if lost.is_empty() {
        return Ok(Overridden { manifest: read, left_out: Vec::new() });
    }
    let left_out = lost.iter().map(|(index, faults)| {
        let name = read.analyses.get(*index).map_or("", |analysis| &analysis.name);
        let reasons: Vec<&str> = faults.messages().collect();
        format!("analysis `{}` is left out: {}", printable(name), reasons.join("; "))
    });
    let left_out = left_out.collect();
    let text = without_analyses(&edited.text, lost.iter().map(|(index, _)| *index))
        .map_err(|fault| Faults::of_file(label, fault))?;
    let manifest = parse_from(label, text.as_bytes(), runs).map_err(traced)?;
    Ok(Overridden { manifest, left_out })
}

/// The text without the analyses at these indices.
fn without_analyses(text: &str, indices: impl Iterator<Item = usize>) -> Result<String, Fault> {
    let mut document = editable(text)?;
    let indices: Vec<usize> = indices.collect();
    let is_left = match document.get_mut("analysis") {
        Some(Item::ArrayOfTables(tables)) => {
            indices.iter().rev().for_each(|index| drop(tables.remove(*index)));
            !tables.is_empty()
        }
        Some(Item::Value(Value::Array(tables))) => {
            indices.iter().rev().for_each(|index| drop(tables.remove(*index)));
            !tables.is_empty()
        }
        _ => true,
    };
    if !is_left {
        document.remove("analysis");
    }
    Ok(document.to_string())
}

fn editable(text: &str) -> Result<DocumentMut, Fault> {
    text.parse().map_err(|error| Fault::whole(format!("cannot be edited: {error}")))
}

/// A manifest's text with overrides.
struct Edited<'s> {
    text: String,
    edits: Edits,
    /// The override of each edit.
    options: Vec<&'s Override>,
}

/// The fault of a value with commas that is not TOML: decimal ones, or those of a list without brackets.
fn comma(key: &str, value: &str) -> Option<Fault> {
    let items: Vec<&str> = value.split(',').map(str::trim).collect();
    let list = format!("[{}]", items.join(", "));
    let is_list = items.len() > 1 && list.parse::<Value>().is_ok();
    let unbracketed = || {
        let fault = Fault::whole(format!("`{key}`: a list without brackets"));
        is_list.then(|| fault.help(format!("write {key} = {list}")))
    };
    decimal_comma(key, value).or_else(unbracketed)
}

/// The manifest's text with overrides.
fn with<'s>(manifest: &Manifest, overrides: &'s [Override]) -> Result<Edited<'s>, Fault> {
    let mut document = editable(&manifest.source)?;
    let mut edited =
        Edited { text: manifest.source.clone(), edits: Edits::default(), options: Vec::new() };
    for set in overrides {
        let place = place(manifest, set)?;
        if !matches!(place, Place::Top("name" | "question" | "hypothesis"))
            && set.value.parse::<Value>().is_err()
            && let Some(fault) = comma(short_name(&set.key), &set.value)
        {
            let hint = fault.hint().unwrap_or_default().to_owned();
            return Err(Fault::whole(format!("--set {set}: {}", fault.message())).help(hint));
        }
        match place {
            Place::Top(key) => put(document.as_table_mut(), key, set.value_of(key)),
            Place::Section(section, key) => {
                let is_recorded = section == "environment" && document.contains_key(DATA);
                let section = if is_recorded { DATA } else { section };
                let table = document.entry(section).or_insert_with(|| Item::Table(Table::new()));
                let not_editable = || set.not_editable(section);
                let mut table = table.as_table_like_mut().ok_or_else(not_editable)?;
                let mut key = key;
                // A parameter of a program stands in a table of its own.
                if let Some((of_program, name)) = key.split_once('.') {
                    let parameters = table.get_mut(of_program).and_then(Item::as_table_like_mut);
                    (table, key) = (parameters.ok_or_else(not_editable)?, name);
                }
                put(table, key, set.value_of(key));
                // An option that says when arms leave replaces the manifest's way.
                if let Some(other) = search::declared::other_way(section, key)
                    && !overrides.iter().any(|set| set.key == format!("search.{other}"))
                {
                    table.remove(other);
                }
            }
            Place::Agents(agents, key) => {
                for agent in agents {
                    let list = document
                        .entry("agent")
                        .or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()));
                    set_agent(list, agent, key, set)?;
                    edited.record(set, document.to_string());
                }
                continue;
            }
        }
        edited.record(set, document.to_string());
    }
    if !edited.text.ends_with('\n') {
        edited.text.push('\n');
    }
    let named: Vec<String> = overrides.iter().map(|set| format!("--set {set}")).collect();
    // A value may contain a line break; a comment may not.
    let comment: String =
        named.join(" ").chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    edited.text += &format!("# {comment}\n");
    Ok(edited)
}

impl<'s> Edited<'s> {
    /// Takes the text after an override.
    fn record(&mut self, set: &'s Override, text: String) {
        self.edits.add(&self.text, &text);
        self.options.push(set);
        self.text = text;
    }
}

/// Sets a key of one agent, in its table or in a new table that is laid over the preset's agent.
fn set_agent(list: &mut Item, agent: &str, key: &str, set: &Override) -> Result<(), Fault> {
    let value = set.value_of(key);
    if free_key(key).is_some() {
        return set_free(list, agent, key, set);
    }
    match list {
        Item::ArrayOfTables(tables) => {
            let is_named =
                |table: &&mut Table| table.get("name").and_then(Item::as_str) == Some(agent);
            if let Some(table) = tables.iter_mut().find(is_named) {
                put(table, key, value);
            } else {
                let mut table = Table::new();
                table.insert("name", Item::Value(agent.into()));
                put(&mut table, key, value);
                tables.push(table);
            }
            Ok(())
        }
        Item::Value(Value::Array(tables)) => {
            let tables = tables.iter_mut().filter_map(Value::as_inline_table_mut);
            let mut named = tables.filter(|t| t.get("name").and_then(Value::as_str) == Some(agent));
            let table = named.next().ok_or_else(|| set.not_editable("agent"))?;
            put(table, key, value);
            Ok(())
        }
        Item::None | Item::Value(_) | Item::Table(_) => Err(set.not_editable("agent")),
    }
}

/// Sets a parameter of an agent that is an outside program and has the parameter.
fn set_free(list: &mut Item, agent: &str, key: &str, set: &Override) -> Result<(), Fault> {
    let not_editable = || set.not_editable("agent");
    let (section, name) = key.split_once('.').ok_or_else(not_editable)?;
    let is_named = |table: &dyn TableLike| table.get("name").and_then(Item::as_str) == Some(agent);
    let parameters = match list {
        Item::ArrayOfTables(tables) => {
            let mut named = tables.iter_mut().filter(|table| is_named(&**table));
            named.next().and_then(|table| table.get_mut(section)?.as_table_like_mut())
        }
        Item::Value(Value::Array(tables)) => {
            let tables = tables.iter_mut().filter_map(Value::as_inline_table_mut);
            let mut named = tables.filter(|table| is_named(&**table));
            let parameters = named.next().and_then(|table| table.get_mut(section));
            parameters.and_then(Value::as_inline_table_mut).map(|table| table as &mut dyn TableLike)
        }
        Item::None | Item::Value(_) | Item::Table(_) => None,
    };
    let parameters = parameters.ok_or_else(not_editable)?;
    put(parameters, name, set.value_of(name));
    Ok(())
}

/// Sets a key, and keeps the comments above it and behind it.
fn put(table: &mut dyn TableLike, key: &str, mut value: Value) {
    match table.get_mut(key) {
        Some(Item::Value(present)) => {
            *value.decor_mut() = present.decor().clone();
            *present = value;
        }
        Some(Item::None | Item::Table(_) | Item::ArrayOfTables(_)) | None => {
            table.insert(key, Item::Value(value));
        }
    }
}

impl Override {
    /// The value as TOML; text if it is not valid TOML. A single scenario becomes a list of one.
    fn value_of(&self, key: &str) -> Value {
        let value = self.value.parse().unwrap_or_else(|_| Value::from(self.value.as_str()));
        match value {
            Value::String(_) if key == "scenarios" => Value::Array(Array::from_iter([value])),
            value => value,
        }
    }

    fn not_editable(&self, section: &str) -> Fault {
        Fault::whole(format!("--set {self}: `{section}` of the manifest cannot be edited"))
            .help(format!("write `{section}` as tables"))
    }
}

/// The place of an override in a manifest.
fn place<'m>(manifest: &'m Manifest, set: &Override) -> Result<Place<'m>, Fault> {
    let key = match set.key.as_str() {
        "scenario" => "scenarios",
        "seed" => "seeds",
        key => key,
    };
    if let Some(top) = TOP.into_iter().find(|top| *top == key) {
        return Ok(Place::Top(top));
    }
    let fault = |message: String| Fault::whole(format!("--set {set}: {message}"));
    if let (Some(short), Some(_)) = (key.strip_prefix("search."), &manifest.search) {
        let keys = names(&Search::keys());
        let known = keys.iter().copied().find(|known| *known == short);
        let unknown = || fault(format!("no key `{key}`")).nearest(short, keys);
        return Ok(Place::Section("search", known.ok_or_else(unknown)?));
    }
    if let Some(place) = in_program(manifest, key, &fault)? {
        return Ok(place);
    }
    if let Some((name, short)) = of_named_agent(key) {
        let names = || manifest.agents.iter().map(|agent| agent.name.as_str());
        let Some(agent) = names().find(|known| *known == name) else {
            return Err(fault(format!("no agent is named `{name}`")).nearest(name, names()));
        };
        return agents(manifest, short, |known| known == agent)
            .ok_or_else(|| fault(format!("agent `{name}` has no key `{short}`")));
    }
    let is_meant = |parameter: &Parameter| {
        let dotted = parameter.to_string();
        is_in(manifest.family(), *parameter)
            && (dotted == key || (!key.contains('.') && short_name(&dotted) == key))
    };
    let meant: Vec<Parameter> = parameters().into_iter().filter(is_meant).collect();
    match meant.as_slice() {
        [Parameter::Agent(key)] => agents(manifest, key, |_| true)
            .ok_or_else(|| fault(format!("no agent has a key `{key}`"))),
        [Parameter::Job(_)] | [] => {
            let unknown = fault(format!("no key `{key}`"));
            Err(match near(manifest, key) {
                Some(meant) => unknown.help(format!("did you mean `{meant}`?")),
                None => unknown,
            })
        }
        [shared] => {
            let section = shared.section().map_or("", SectionName::word);
            Ok(Place::Section(section, shared.key()))
        }
        several => {
            let names: Vec<String> = several.iter().map(Parameter::to_string).collect();
            Err(fault(ambiguous(key, &names)))
        }
    }
}

/// The parameter of an outside program that a key means; `None` if it means none. A bare name can be one.
///
/// **Errors**: the key means another parameter, too, or one that no agent has.
fn in_program<'m>(
    manifest: &'m Manifest,
    key: &str,
    fault: &dyn Fn(String) -> Fault,
) -> Result<Option<Place<'m>>, Fault> {
    let of_program = if key.contains('.') { key.to_owned() } else { format!("parameters.{key}") };
    let free = of_program.strip_prefix("agent.").unwrap_or(&of_program);
    let of_agents = free_key(free).and_then(|_| agents(manifest, free, |_| true));
    let of_programs = [environment_parameter(manifest, &of_program), of_agents];
    let mut of_programs: Vec<Place> = of_programs.into_iter().flatten().collect();
    let mut names: Vec<String> = Vec::new();
    if !key.contains('.') {
        let is_meant = |parameter: &Parameter| {
            short_name(&parameter.to_string()) == key
                && is_in(manifest.family(), *parameter)
                && match parameter {
                    Parameter::Agent(key) => agents(manifest, key, |_| true).is_some(),
                    _ => true,
                }
        };
        names.extend(parameters().iter().filter(|one| is_meant(one)).map(Parameter::to_string));
    }
    names.extend(of_programs.iter().filter_map(Place::dotted));
    match (of_programs.pop(), names.as_slice()) {
        (Some(place), [_]) => Ok(Some(place)),
        (Some(_), several) => Err(fault(ambiguous(key, several))),
        (None, _) if key.contains('.') && free_key(free).is_some() => {
            Err(fault(format!("no agent has a key `{free}`")))
        }
        (None, _) => Ok(None),
    }
}

fn ambiguous(key: &str, names: &[String]) -> String {
    let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    format!("`{key}` is ambiguous; use one of {}", names.join(", "))
}

/// The agent that a key names, and the agent's key. Names of agents may contain dots. Keys contain none, except
/// parameters of outside programs.
fn of_named_agent(key: &str) -> Option<(&str, &str)> {
    let rest = key.strip_prefix("agent.")?;
    let (name, short) = rest.rsplit_once('.')?;
    let free = name.strip_suffix(".parameters").map(|name| (name, &rest[name.len() + 1..]));
    Some(free.unwrap_or((name, short)))
}

/// The key that an unknown key probably means.
fn near(manifest: &Manifest, key: &str) -> Option<String> {
    let starts_with_an_agent = |name: &str| key.strip_prefix(name)?.strip_prefix('.');
    if manifest.agents.iter().any(|agent| starts_with_an_agent(&agent.name).is_some()) {
        return Some(format!("agent.{key}"));
    }
    let names: Vec<String> = parameters().iter().map(Parameter::to_string).collect();
    let words = names.iter().flat_map(|name| [name.as_str(), short_name(name)]);
    nearest(key, words.chain(TOP)).map(str::to_owned)
}

/// The place of a parameter of the environment's program, if it has the parameter.
fn environment_parameter(manifest: &Manifest, key: &str) -> Option<Place<'static>> {
    let free = free_key(key.strip_prefix("environment.").unwrap_or(key))?;
    let family = manifest.family();
    let has = family.keys.iter().any(|known| known.name == free.name);
    // A model has parameters that the manifest does not set, and reports names that it does not have.
    let is_of_model = family.with_parameters.is_some() && !family.is_external();
    (has || is_of_model && key.starts_with("environment."))
        .then_some(Place::Section("environment", free.name))
}

/// The agents that have a key and whose names meet a condition.
fn agents<'m>(
    manifest: &'m Manifest,
    key: &str,
    is_meant: impl Fn(&str) -> bool,
) -> Option<Place<'m>> {
    let mut found = None;
    let mut names = Vec::new();
    for agent in manifest.agents.iter().filter(|agent| is_meant(&agent.name)) {
        if let Some(known) = agent.algorithm.keys().iter().find(|known| known.name == key) {
            found = Some(known.name);
            names.push(agent.name.as_str());
        }
    }
    Some(Place::Agents(names, found?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::load::parse;
    use crate::plan;

    const TEXT: &str = "# A comment.\nformat = 1\nname = \"t\"\nextends = \"paper\"\n\
                        scenarios = [\"P\"] # one\nseeds = 2\nenvironment.sigma = 0.6\n\
                        [[agent]]\nname = \"own\"\nalgorithm = \"dueling_dqn\"\nepisodes = 5\n";

    fn set(overrides: &[&str]) -> Result<Manifest, String> {
        let overrides: Vec<Override> = overrides.iter().map(|text| text.parse().unwrap()).collect();
        let manifest = parse("t.toml", TEXT.as_bytes()).unwrap();
        let edited = with(&manifest, &overrides).map_err(|fault| fault.message().to_owned())?;
        parse("t.toml", edited.text.as_bytes()).map_err(|faults| faults.to_string())
    }

    fn values(manifest: &Manifest, name: &str) -> Vec<String> {
        let jobs = plan::jobs(manifest);
        let values = jobs.flat_map(|planned| {
            let parameters = planned.job.parameters();
            let found = parameters.into_iter().find(|(known, _)| known == name);
            found.map(|(_, value)| format!("{}={value:?}", planned.agent))
        });
        let mut values: Vec<String> = values.collect();
        values.dedup();
        values
    }

    #[test]
    fn keys_are_set_in_sections_agents_and_above_all_tables() {
        let manifest = set(&[
            "environment.sigma=[0.2, 0.4]",
            "first_context=sampled",
            "evaluation.test_episodes=7",
            "seeds=[5]",
            "population.delta_d={ uniform = [0.1, 0.2] }",
            "scenario=C-T",
        ])
        .unwrap();
        assert!(manifest.seeds().eq([5]));
        assert_eq!(manifest.scenarios().next().unwrap().to_string(), "C-T");
        assert_eq!(plan::count(&manifest), 3 * 2);
        assert_eq!(values(&manifest, "environment.first_context")[0], "dqn=Text(\"sampled\")");
        assert_eq!(values(&manifest, "evaluation.test_episodes")[0], "dqn=Integer(7)");
        assert!(manifest.source.starts_with("# A comment.\nformat = 1\n"), "{}", manifest.source);
        assert!(manifest.source.ends_with(
            "# --set environment.sigma=[0.2, 0.4] --set \
            first_context=sampled --set evaluation.test_episodes=7 --set seeds=[5] --set \
            population.delta_d={ uniform = [0.1, 0.2] } --set \
            scenario=C-T\n"
        ));
    }

    #[test]
    fn keys_of_agents_are_set_for_all_that_have_them_or_for_one() {
        let all = set(&["agent.gamma=0.5"]).unwrap();
        let expected = ["dqn=Real(0.5)", "reinforce=Real(0.5)", "own=Real(0.5)"];
        let mut found = values(&all, "agent.gamma");
        found.sort_by_key(|value| expected.iter().position(|known| known == value));
        assert_eq!(found, expected);
        let one = set(&["agent.own.gamma=0.5", "batch=32"]).unwrap();
        assert!(values(&one, "agent.gamma").contains(&"dqn=Real(0.99)".to_owned()));
        assert!(values(&one, "agent.gamma").contains(&"own=Real(0.5)".to_owned()));
        assert_eq!(values(&one, "agent.batch").len(), 2);
    }

    #[test]
    fn comments_and_layout_are_kept_where_values_change() {
        let text = "# Title.\nformat = 1\nname   =   'n' # its name\n# Where it is.\nscenarios = [\"P\"] # one\n\
                    # How often.\nseeds = 2 # few\n[environment] # table\n# How noisy.\nsigma = [\n  0.6, # usual\n] # \
                    noise\n\n[[agent]]\n# It learns.\nname = \"own\"\nalgorithm = \"dueling_dqn\"\n# Far sight.\n\
                    gamma = 0.9 # below 1\n# The end.\n";
        let manifest = parse("t.toml", text.as_bytes()).unwrap();
        let overrides = ["name=m", "scenario=C-T", "seeds=3", "sigma=0.2", "agent.own.gamma=0.5"];
        let overrides: Vec<Override> = overrides.iter().map(|set| set.parse().unwrap()).collect();
        let expected = text
            .replace("'n'", "\"m\"")
            .replace("[\"P\"]", "[\"C-T\"]")
            .replace("= 2", "= 3")
            .replace("[\n  0.6, # usual\n]", "0.2")
            .replace("= 0.9", "= 0.5");
        let found = with(&manifest, &overrides).unwrap().text;
        let last = "# --set name=m --set scenario=C-T --set seeds=3 --set sigma=0.2 --set agent.own.gamma=0.5\n";
        assert_eq!(found, expected + last);
    }

    #[test]
    fn a_way_in_which_arms_leave_replaces_the_other() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nenvironment.sigma = 0.6\n\
                    [search]\nsamples = 4\nrungs = [2, 3]\nkeep = 0.5\n[[agent]]\nname = \"a\"\n\
                    algorithm = \"reinforce\"\nlearning_rate = { log_uniform = [1e-4, 1e-3] }\n";
        let level: Override = "search.level=0.05".parse().unwrap();
        let keep: Override = "search.keep=0.25".parse().unwrap();
        let text_of = |overrides: &[Override]| {
            with(&parse("t.toml", text.as_bytes()).unwrap(), overrides).unwrap().text
        };
        let replaced = text_of(std::slice::from_ref(&level));
        assert!(replaced.contains("level = 0.05") && !replaced.contains("keep"), "{replaced}");
        parse("t.toml", replaced.as_bytes()).unwrap();
        // Two options contradict each other.
        let both = text_of(&[level, keep]);
        assert!(both.contains("level = 0.05") && both.contains("keep = 0.25"), "{both}");
    }

    #[test]
    fn what_cannot_be_set_is_named() {
        for (text, expected) in [
            ("siggma=1", "--set siggma=1: no key `siggma`"),
            ("agent.nobody.gamma=1", "no agent is named `nobody`"),
            ("agent.reinforce.batch=1", "agent `reinforce` has no key `batch`"),
            ("environment.sigma=-1", "`sigma`"),
            ("seeds=none", "`seeds`"),
        ] {
            let error = set(&[text]).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
        assert_eq!("gamma".parse::<Override>(), Err(OverrideForm));
        assert_eq!("=1".parse::<Override>(), Err(OverrideForm));
    }
}
