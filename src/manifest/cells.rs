//! Reads zips and exclusions, which shape the grid.

use std::collections::HashSet;

use toml::de::DeTable;

use crate::job::Condition;
use crate::key::{Key, Kind, Parameter, SectionName, Value};
use crate::manifest::draft::Draft;
use crate::manifest::parameter::{meant, named, parameter};
use crate::manifest::read::MOST_ENTRIES;
use crate::manifest::section::Section;
use crate::manifest::value::free::PARAMETERS;
use crate::manifest::value::sweep::{Node, Reader, Repeats};
use crate::text::{Fault, Located, Span, near, nearest, shortened};

/// The keys of an exclusion in addition to the keys of the sections.
const CONDITIONS: [&str; 2] = ["scenario", "seed"];

impl Reader<'_> {
    /// Reads `zip`: a list of lists of dotted names.
    pub fn zips(&mut self, draft: &mut Draft, node: &Node) {
        let before = self.faults.len();
        let expected = "lists of dotted names, as in [[\"environment.delta_d\", \"seed\"]]";
        let lists = node.get_ref().as_array().map_or(&[][..], |lists| &lists[..]);
        let nested = lists.iter().all(|list| list.get_ref().is_array());
        if lists.is_empty() || lists.len() > MOST_ENTRIES || !nested {
            self.expected("zip", expected, node);
            draft.invalid_cells = true;
            return;
        }
        let mut zips: Vec<Located<Vec<Parameter>>> = Vec::new();
        let mut zipped = HashSet::new();
        for list in lists {
            let items = list.get_ref().as_array().map_or(&[][..], |items| &items[..]);
            if items.len() < 2 {
                self.expected("zip", "at least two dotted names that advance together", list);
            }
            let value = self.distinct("zip", items.iter(), |reader, item| reader.parameter(item));
            for (parameter, item) in value.iter().zip(items) {
                if zipped.contains(parameter) {
                    let message = format!("`zip`: {parameter} is already in another zip");
                    self.faults.add(Fault::at(item.span().into(), message));
                }
            }
            zipped.extend(value.iter().copied());
            zips.push(Located { value, span: list.span().into() });
        }
        draft.invalid_cells |= self.faults.len() > before;
        draft.zips = Some(zips);
    }

    fn parameter(&mut self, node: &Node) -> Option<Parameter> {
        let dotted = node.get_ref().as_str().unwrap_or_default();
        let parameter = parameter(dotted);
        if parameter.is_none() {
            let found = self.found(node);
            let message =
                format!("`zip`: expected the dotted name of a swept parameter, found {found}");
            let fault = Fault::at(node.span().into(), message);
            self.faults.add(match meant(dotted, &[]) {
                Some(name) => fault.help(format!("did you mean `{name}`?")),
                None => fault,
            });
        }
        parameter
    }

    /// Reads `[[exclude]]`.
    pub fn exclusions(&mut self, draft: &mut Draft, node: &Node) {
        let before = self.faults.len();
        for (span, table) in self.tables("exclude", node) {
            let value = self.conditions(table, "[[exclude]]");
            if table.is_empty() {
                let fault = Fault::at(span, "an exclusion needs at least one condition");
                self.faults.add(fault.help("name the cells to leave out: scenario = \"P-T\""));
            }
            draft.exclusions.push(Located { value, span });
        }
        draft.invalid_cells |= self.faults.len() > before;
    }

    /// The conditions of `table`; messages call the table `place`.
    pub fn conditions(&mut self, table: &DeTable, place: &str) -> Vec<Located<Condition>> {
        let mut conditions = Vec::new();
        for (key, node) in table {
            let span: Span = node.span().into();
            match key.get_ref().as_ref() {
                "scenario" => {
                    let values = self.scenarios("scenario", node);
                    let value = Condition { parameter: Parameter::SCENARIO, values };
                    conditions.push(Located { value, span });
                }
                "seed" => {
                    let values = self.seed_list("seed", node);
                    let value = Condition { parameter: Parameter::SEED, values };
                    conditions.push(Located { value, span });
                }
                word if SectionName::named(word).is_some() => {
                    self.key_conditions((word, place), node, &mut conditions);
                }
                found if self.short_condition(found, node, &mut conditions) => {}
                found => {
                    let message = format!("unknown key `{}` in {place}", shortened(found));
                    let fault = Fault::at(key.span().into(), message);
                    let words = CONDITIONS.into_iter().chain(SectionName::WORDS.iter().copied());
                    let tables = near(found, words).map(str::to_owned);
                    self.faults.add(match tables.or_else(|| meant(found, &["agent.name"])) {
                        // Quotes make the dot a part of the key.
                        Some(meant) if meant == found => {
                            fault.help(format!("write it without quotes: {meant} = …"))
                        }
                        Some(meant) => fault.help(format!("did you mean `{meant}`?")),
                        None => fault,
                    });
                }
            }
        }
        self.require_once(&conditions);
        conditions
    }

    /// Reports a parameter that is named twice, such as by its full and by its short name.
    fn require_once(&mut self, conditions: &[Located<Condition>]) {
        let mut known: Vec<Parameter> = Vec::new();
        for Located { value, span } in conditions {
            let Condition { parameter, .. } = value;
            if known.contains(parameter) {
                let fault = Fault::at(*span, format!("`{parameter}` is set twice"));
                self.faults.add(fault.help("name it once, with a list of all its values"));
            }
            known.push(*parameter);
        }
    }

    /// Reads `<key> = …` if exactly one parameter has this key; false if none or several have it.
    fn short_condition(
        &mut self,
        found: &str,
        node: &Node,
        out: &mut Vec<Located<Condition>>,
    ) -> bool {
        // A quoted full name is one key that contains dots.
        let Some(parameter) = named(self.family, found).filter(|_| !found.contains('.')) else {
            return false;
        };
        let dotted = parameter.to_string();
        let Some((section, key)) = dotted.split_once('.') else { return false };
        let Some((_, known)) = find(section, key) else { return false };
        let values = self.sweep(&dotted, known.kind, Repeats::Refused, node);
        let span = node.span().into();
        out.push(Located { value: Condition { parameter, values }, span });
        true
    }

    /// Reads `section.<key> = …`.
    fn key_conditions(
        &mut self,
        (section, place): (&str, &str),
        node: &Node,
        out: &mut Vec<Located<Condition>>,
    ) {
        let Some(table) = node.get_ref().as_table() else {
            let expected = format!("a dotted key, as in {section}.name = …");
            self.expected(section, &expected, node);
            return;
        };
        for (key, node) in table {
            let found = key.get_ref().as_ref();
            let span = node.span().into();
            if (section, found) == ("agent", "name") {
                let values = self.agent_names(node);
                let value = Condition { parameter: Parameter::AGENT_NAME, values };
                out.push(Located { value, span });
                continue;
            }
            if [("agent", PARAMETERS), ("environment", PARAMETERS)].contains(&(section, found)) {
                for (name, node) in self.free_parameters(node).unwrap_or_default() {
                    let parameter = match section {
                        "agent" => Parameter::Agent(name),
                        _ => Parameter::Environment(name),
                    };
                    let dotted = parameter.to_string();
                    let values = self.sweep(&dotted, Kind::Scalar, Repeats::Refused, node);
                    let span = node.span().into();
                    out.push(Located { value: Condition { parameter, values }, span });
                }
                continue;
            }
            let Some((section, known)) = find(section, found) else {
                let message = format!("unknown key `{section}.{}` in {place}", shortened(found));
                let fault = Fault::at(key.span().into(), message);
                let same = Section::all().into_iter().filter(|known| known.name() == section);
                let keys = same.flat_map(|section| section.keys().iter().map(|key| key.name));
                let keys = keys.chain((section == "agent").then_some("name"));
                self.faults.add(match nearest(found, keys) {
                    Some(key) => fault.help(format!("did you mean `{section}.{key}`?")),
                    None => fault,
                });
                continue;
            };
            let parameter = section.parameter(known.name);
            let values = self.sweep(&parameter.to_string(), known.kind, Repeats::Refused, node);
            out.push(Located { value: Condition { parameter, values }, span });
        }
    }

    fn agent_names(&mut self, node: &Node) -> Vec<Value> {
        let items = self.items("agent.name", node);
        let names = self.distinct("agent.name", items.iter().copied(), |reader, item| {
            let name = item.get_ref().as_str();
            if name.is_none() {
                reader.expected("agent.name", "an agent's name in quotes", item);
            }
            name.map(str::to_owned)
        });
        names.into_iter().map(Value::Text).collect()
    }
}

/// The key called `name` of a section; `section` is the name in dotted names.
fn find(section: &str, name: &str) -> Option<(Section, &'static Key)> {
    Section::all()
        .into_iter()
        .filter(|known| known.name() == section)
        .find_map(|section| section.find(name).map(|(_, key)| (section, key)))
}
