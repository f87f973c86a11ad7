//! Reads the tree of a TOML document as a [`Draft`], and reports every fault.

use std::sync::LazyLock;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::agent::Algorithm;
use crate::env::recorded::DATA;
use crate::env::{Family, Scenario, ScenarioError};
use crate::key::{DIRECTION, Kind, SectionName, Value, free_key, hidden};
use crate::manifest::data;
use crate::manifest::draft::{AgentDraft, Draft, Settings};
use crate::manifest::limits::MOST_JOBS;
use crate::manifest::preset;
use crate::manifest::search::draw::is_draw;
use crate::manifest::section::Section;
use crate::manifest::value::free::{FAMILY, Free, PARAMETERS};
use crate::manifest::value::respelt::respelt;
use crate::manifest::value::sweep::{Node, Reader, Repeats, whole, zipped};
use crate::text::{Fault, Located, Span, nearest, shortened};

/// The top-level keys of a manifest: first the keys above all tables, then the tables.
pub(super) static TOP_KEYS: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| [&ABOVE_TABLES[..], SectionName::WORDS, &OTHER_TABLES].concat());

/// The top-level keys above all tables.
const ABOVE_TABLES: [&str; 10] = [
    "format",
    "name",
    "extends",
    "question",
    "hypothesis",
    "published",
    "time_limit_seconds",
    "scenarios",
    "seeds",
    "zip",
];

/// The tables that are no sections.
const OTHER_TABLES: [&str; 5] = [DATA, "search", "exclude", "estimate", "analysis"];

/// The keys of [`TOP_KEYS`] that are arrays of tables, with double brackets.
pub(super) const TABLES: [&str; 4] = ["agent", "exclude", "estimate", "analysis"];

/// The version of the format that this program reads and writes.
pub(super) const FORMAT: u64 = 1;

/// Maximum number of agents, of zips and of exclusions: each is compared with all others.
pub(super) const MOST_ENTRIES: usize = 1000;

/// Maximum time limit of a job, in seconds: a thousand years.
pub(super) const LONGEST_TIME_LIMIT: u64 = 31_557_600_000;

/// Maximum length of a name, which must fit into tables and figures.
pub(super) const LONGEST_NAME: usize = 100;

/// The fault of a document with a newer format, whose keys can have another meaning.
pub(super) fn newer_format(root: &DeTable) -> Option<Fault> {
    let node = root.get("format")?;
    let version = whole(node).filter(|version| *version > FORMAT)?;
    let message = format!("`format`: expected {FORMAT}, found {version}");
    Some(Fault::at(node.span().into(), message).help("a newer version of jitai may read it"))
}

impl Reader<'_> {
    /// The content of the document, merged over the preset that it extends.
    pub fn draft(&mut self, root: &DeTable) -> Draft {
        let root = &*data::unfolded(root, &mut self.faults);
        let environment = root.get("environment").and_then(|node| table_in(node));
        let extended = root.get("extends").and_then(|node| node.get_ref().as_str());
        self.beside.extend(extended.into_iter().flat_map(preset::parameters));
        let (family, free) =
            environment.map(|table| self.family(table)).unwrap_or((Family::first(), Free::new()));
        self.family = family;
        let mut draft = Draft::new(family);
        for key in root.keys().filter(|key| !TOP_KEYS.contains(&key.get_ref().as_ref())) {
            self.astray(&mut draft, key.get_ref(), key.span().into());
        }
        let root = &*respelt(root, &TOP_KEYS);
        let inherited = self.inherited(root);
        self.zipped = zipped(root);
        for (key, node) in root {
            self.top_key(&mut draft, &inherited, key.get_ref(), node);
        }
        for (key, node) in free {
            self.setting(&mut draft.sections[SectionName::Environment], key, node);
        }
        // Keys above all tables that stand in a table have been reported, and are read all the same.
        for key in ABOVE_TABLES.iter().filter(|key| **key != "name") {
            let stray = tables_of(root).find_map(|table| table.get(*key));
            if let Some(node) = stray.filter(|_| !root.contains_key(*key)) {
                self.top_key(&mut draft, &inherited, key, node);
            }
        }
        for (name, span) in std::mem::take(&mut self.misplaced) {
            if let Some((index, _)) = Section::Environment(family).find(name) {
                draft.sections[SectionName::Environment].mark_invalid(index, span);
            }
        }
        let seeds = draft.seeds.as_ref().map(|seeds| seeds.span);
        let mut draft = inherited.overridden_by(draft);
        self.drawn(&mut draft, seeds);
        data::complete(&mut draft, &mut self.faults);
        draft
    }

    /// Reads a top-level key; unknown keys have been reported.
    fn top_key(&mut self, draft: &mut Draft, inherited: &Draft, key: &str, node: &Node) {
        match key {
            "format" => {
                self.format(node);
                draft.has_format = true;
            }
            "name" => draft.name = Some(self.name("name", node)),
            "question" => draft.question = self.prose("question", node),
            "hypothesis" => draft.hypothesis = self.prose("hypothesis", node),
            "published" => draft.published = self.text("published", node),
            "time_limit_seconds" => draft.time_limit_seconds = self.time_limit(node),
            "scenarios" => {
                let value = self.scenarios("scenarios", node);
                draft.scenarios = Some(Located { value, span: node.span().into() });
            }
            "seeds" => {
                let value = self.seeds("seeds", node);
                draft.seeds = Some(Located { value, span: node.span().into() });
            }
            "search" => {
                let span = node.span().into();
                draft.search = self.search(node).map(|value| Located { value, span });
                draft.invalid_search = draft.search.is_none();
            }
            "agent" => self.agents(draft, inherited, node),
            "zip" => self.zips(draft, node),
            "exclude" => self.exclusions(draft, node),
            "estimate" => self.estimates(draft, node),
            "analysis" => self.analyses(draft, node),
            other => {
                let name = SectionName::named(other);
                if let Some(section) = name.and_then(|name| Section::opened(name, self.family)) {
                    self.shared_section(draft, section, node);
                }
            }
        }
    }

    /// Reads a section that agents share.
    fn shared_section(&mut self, draft: &mut Draft, section: Section, node: &Node) {
        let read = match section {
            Section::Environment(family) => {
                let others = match family.with_parameters {
                    Some(_) => &[FAMILY, PARAMETERS][..],
                    None => &[FAMILY],
                };
                self.section(section, others, node)
            }
            Section::Population(family) if family.people.is_empty() => {
                let people = match family.is_external() {
                    true => "a program may draw its own people",
                    false => "the people come from the file that [environment] names",
                };
                let says =
                    format!("`population` does not apply to the family {}: {people}", family.name);
                self.faults.add(Fault::at(node.span().into(), says).help("remove the table"));
                return;
            }
            Section::Trial(_) => self.trial(section, node),
            _ => self.section(section, &[], node),
        };
        draft.sections[section.which()].override_with(read);
    }

    /// The keys of `[trial]`. Its tables `entry` and `update` are keys that begin with their names.
    fn trial(&mut self, section: Section, node: &Node) -> Settings {
        let Some(table) = node.get_ref().as_table() else {
            return self.section(section, &[], node);
        };
        let mut flat = DeTable::new();
        for (key, node) in table {
            match node.get_ref() {
                DeValue::Table(below) if ["entry", "update"].contains(&key.get_ref().as_ref()) => {
                    for (own, node) in below {
                        let name = format!("{}_{}", key.get_ref(), own.get_ref());
                        if table.contains_key(name.as_str()) {
                            let says = format!(
                                "`{name}` is given twice: by itself, and in `{}`",
                                key.get_ref()
                            );
                            self.faults
                                .add(Fault::at(own.span().into(), says).help("remove one of them"));
                        }
                        flat.insert(Spanned::new(own.span(), name.into()), node.clone());
                    }
                }
                _ if key.get_ref() == "update" => {
                    self.expected("update", "a table, as in { every_days = 7 }", node);
                }
                _ => {
                    flat.insert(key.clone(), node.clone());
                }
            }
        }
        self.section(section, &[], &Spanned::new(node.span(), DeValue::Table(flat)))
    }

    /// Reports an unknown top-level key. The key that was probably meant is not reported as missing.
    fn astray(&mut self, draft: &mut Draft, found: &str, span: Span) {
        let fault = Fault::at(span, format!("unknown key `{}`", shortened(found)));
        self.faults.add(belonging(fault, None, found, &TOP_KEYS));
        match Section::Environment(self.family).find(found) {
            Some((index, _)) => {
                draft.sections[SectionName::Environment].mark_invalid(index, span);
            }
            None => draft
                .mark_invalid(nearest(found, TOP_KEYS.iter().copied()).unwrap_or_default(), span),
        }
    }

    fn format(&mut self, node: &Node) {
        if whole(node) != Some(FORMAT) {
            self.expected("format", &FORMAT.to_string(), node);
        }
    }

    /// The draft of the preset that the document extends.
    fn inherited(&mut self, root: &DeTable) -> Draft {
        let (name, span) = match root.get("extends") {
            Some(node) => (self.extends(node), node.span()),
            None => return Draft::new(self.family),
        };
        let own = self.family.keys.iter().map(|key| key.name);
        let own = own.filter(|name| free_key(name).is_some()).collect();
        let inherited = preset::draft(name, own).moved_to(span.clone().into());
        if inherited.family() != self.family {
            let (preset, own) = (inherited.family().name, self.family.name);
            let message = format!(
                "`extends`: the environment of \"{name}\" is of the family {preset}, that of this manifest of {own}"
            );
            let fault = Fault::at(span.into(), message);
            self.faults.add(fault.help(format!(
                "write family = \"{preset}\" in [environment], or remove `extends` and write out the agents"
            )));
        }
        inherited
    }

    /// The name of the preset; for an unknown name, the nearest or the first one.
    fn extends(&mut self, node: &Node) -> &'static str {
        let names = preset::names();
        let found = node.get_ref().as_str().unwrap_or_default();
        if let Some(name) = names.into_iter().find(|name| *name == found) {
            return name;
        }
        let expected = names.map(|name| format!("\"{name}\"")).join(" or ");
        let message = format!("`extends`: expected {expected}, found {}", self.found(node));
        self.faults.add(Fault::at(node.span().into(), message).nearest(found, names));
        nearest(found, names).unwrap_or(names[0])
    }

    fn time_limit(&mut self, node: &Node) -> Option<u64> {
        let seconds = whole(node).filter(|seconds| (1..=LONGEST_TIME_LIMIT).contains(seconds));
        if seconds.is_none() {
            let expected = format!("a whole number from 1 to {LONGEST_TIME_LIMIT}");
            self.expected("time_limit_seconds", &expected, node);
        }
        seconds
    }

    pub fn text(&mut self, name: &str, node: &Node) -> Option<String> {
        if node.get_ref().as_str().is_none() {
            self.expected(name, "text in quotes", node);
        }
        node.get_ref().as_str().map(str::to_owned)
    }

    /// A text without marks of text direction, which would turn the text around it.
    pub fn prose(&mut self, name: &str, node: &Node) -> Option<String> {
        let mut text = self.text(name, node)?;
        text.retain(|c| hidden(c) != Some(DIRECTION));
        Some(text)
    }

    /// A name that tables and figures can show; empty if faulty.
    pub fn name(&mut self, name: &str, node: &Node) -> Located<String> {
        let text = node.get_ref().as_str().unwrap_or_default();
        let seen = text.chars().find_map(|c| hidden(c).map(|what| (c, what)));
        let length = text.chars().count();
        let span = node.span().into();
        if text.trim().is_empty() || length > LONGEST_NAME {
            let expected = format!("1 to {LONGEST_NAME} visible characters in quotes");
            let found = match length > LONGEST_NAME {
                true => format!("{length} of them"),
                false => self.found(node),
            };
            let message = format!("`{name}`: expected {expected}, found {found}");
            self.faults.add(Fault::at(span, message));
        } else if let Some((character, what)) = seen {
            let code = u32::from(character);
            let message = format!("`{name}`: a name cannot have U+{code:04X}, {what}");
            let help = "tables and figures cannot show this character; remove it";
            self.faults.add(Fault::at(span, message).help(help));
        } else {
            return Located { value: text.to_owned(), span };
        }
        Located { value: String::new(), span }
    }

    /// A scenario or a list of scenarios; empty if any is faulty.
    pub fn scenarios(&mut self, name: &str, node: &Node) -> Vec<Value> {
        let items = self.items(name, node);
        let scenarios =
            self.distinct(name, items.iter().copied(), |reader, item| reader.scenario(name, item));
        scenarios.iter().map(|scenario| Value::Text(scenario.to_string())).collect()
    }

    fn scenario(&mut self, name: &str, node: &Node) -> Option<Scenario> {
        let family = self.family;
        let expected = (family.expected_scenario)();
        let checked = |scenario: Scenario| (family.check_scenario)(&scenario).map(|()| scenario);
        let read = match node.get_ref() {
            DeValue::String(text) => text.parse().and_then(checked),
            // A list of features is one scenario, where scenarios are names.
            DeValue::Array(names) if !family.has_letters => {
                let names: Option<Vec<&str>> =
                    names.iter().map(|name| name.get_ref().as_str()).collect();
                names.map_or(Err(ScenarioError::Empty), Scenario::of_names).and_then(checked)
            }
            _ => {
                self.expected(name, &expected, node);
                return None;
            }
        };
        match read {
            Ok(scenario) => Some(scenario),
            Err(reason) => {
                let found = self.found(node);
                let message = format!("`{name}`: {reason}; expected {expected}, found {found}");
                let fault = Fault::at(node.span().into(), message);
                let letters = found.chars().filter(char::is_ascii_alphanumeric);
                let respelt: Vec<String> =
                    letters.map(|letter| letter.to_ascii_uppercase().to_string()).collect();
                self.faults.add(match respelt.join("-").parse().and_then(checked) {
                    Ok(meant) if family.has_letters => {
                        fault.help(format!("did you mean `{meant}`?"))
                    }
                    Ok(_) | Err(_) => fault,
                });
                None
            }
        }
    }

    /// The entries of a list, or the node itself if it is not a list; reports an empty list.
    pub fn items<'n>(&mut self, name: &str, node: &'n Node<'n>) -> Vec<&'n Node<'n>> {
        match node.get_ref().as_array() {
            Some(items) if items.is_empty() => {
                self.expected(name, "at least one value", node);
                Vec::new()
            }
            Some(items) => items.iter().collect(),
            None => vec![node],
        }
    }

    /// A number of seeds or a list of seeds; empty if faulty.
    pub fn seeds(&mut self, name: &str, node: &Node) -> Vec<Value> {
        if node.get_ref().is_array() {
            return self.seed_list(name, node);
        }
        match whole(node).filter(|count| (1..=MOST_JOBS).contains(count)) {
            Some(count) => (1..=count).map(Value::Integer).collect(),
            None => {
                let expected = format!("a count from 1 to {MOST_JOBS} or a list of seeds");
                self.expected(name, &expected, node);
                Vec::new()
            }
        }
    }

    /// A seed or a list of seeds; empty if any is faulty.
    pub fn seed_list(&mut self, name: &str, node: &Node) -> Vec<Value> {
        let seed = Kind::Integer { min: 0, max: i64::MAX as u64 };
        let items = self.items(name, node);
        if !self.count_in(name, items.len(), node) {
            return Vec::new();
        }
        self.distinct(name, items.iter().copied(), |reader, item| reader.value(name, seed, item))
    }

    /// The table in `node`; reports any other type.
    pub fn table<'n>(&mut self, name: &str, node: &'n Node) -> Option<&'n DeTable<'n>> {
        let table = node.get_ref().as_table();
        if table.is_none() {
            self.expected(name, &format!("a table, opened by [{name}]"), node);
        }
        table
    }

    /// The entries of a list of tables; reports any other type.
    pub fn tables<'n>(&mut self, name: &str, node: &'n Node) -> Vec<(Span, &'n DeTable<'n>)> {
        let Some(entries) = node.get_ref().as_array() else {
            self.expected(name, &format!("tables, each opened by [[{name}]]"), node);
            return Vec::new();
        };
        if entries.len() > MOST_ENTRIES {
            let message = format!("at most {MOST_ENTRIES} [[{name}]], found {}", entries.len());
            self.faults.add(Fault::at(node.span().into(), message));
            return Vec::new();
        }
        let mut tables = Vec::new();
        for entry in entries.iter() {
            match entry.get_ref() {
                DeValue::Table(table) => tables.push((entry.span().into(), table)),
                _ => self.expected(name, &format!("a table, opened by [[{name}]]"), entry),
            }
        }
        tables
    }

    /// Reads a section, except the keys `others`.
    fn section(&mut self, section: Section, others: &[&str], node: &Node) -> Settings {
        let mut settings = Settings::new(section);
        settings.span = Some(node.span().into());
        match self.table(section.name(), node).or(table_in(node)) {
            Some(table) => self.settings(&mut settings, table, others),
            None => {
                for index in 0..section.keys().len() {
                    settings.mark_invalid(index, node.span().into());
                }
            }
        }
        settings
    }

    /// Reads the keys of `table` except `others`, which the caller reads.
    fn settings(&mut self, settings: &mut Settings, table: &DeTable, others: &[&str]) {
        let section = settings.section;
        let mut known: Vec<&str> = section.keys().iter().map(|key| key.name).collect();
        known.extend(others);
        for key in table.keys().filter(|key| !known.contains(&key.get_ref().as_ref())) {
            let (found, span) = (key.get_ref().as_ref(), Span::from(key.span()));
            self.unknown_key(section, span, found, others);
            if let Some((_, key)) = Section::Environment(self.family).find(found) {
                self.misplaced.push((key.name, span));
            }
            let meant = nearest(found, section.keys().iter().map(|key| key.name));
            if let Some((index, _)) = meant.and_then(|meant| section.find(meant)) {
                settings.mark_invalid(index, span);
            }
        }
        for (key, node) in &*respelt(table, &known) {
            if let Some((_, known)) = section.find(key.get_ref()) {
                self.setting(settings, known.name, node);
            }
        }
    }

    /// Reads the values of a key that the section has.
    fn setting(&mut self, settings: &mut Settings, key: &'static str, node: &Node) {
        let section = settings.section;
        let Some((index, known)) = section.find(key) else { return };
        if is_draw(node) && !matches!(known.kind, Kind::Distribution(_)) {
            return self.drawn_setting(settings, key, node);
        }
        let repeats = match self.zipped.contains(&section.parameter(known.name)) {
            true => Repeats::Zipped,
            false => Repeats::Refused,
        };
        let value = self.sweep(key, known.kind, repeats, node);
        settings.given.insert(index, Located { value, span: node.span().into() });
    }

    /// Reads the draw of a key, which has no values until the search gives it some.
    fn drawn_setting(&mut self, settings: &mut Settings, key: &'static str, node: &Node) {
        let section = settings.section;
        let Some((index, known)) = section.find(key) else { return };
        let span = node.span().into();
        settings.mark_invalid(index, span);
        if section.algorithm().is_none() {
            let says = format!("`{key}`: only keys of an [[agent]] are drawn");
            let help =
                "a race compares settings of an agent in one environment; write a list or a range";
            self.faults.add(Fault::at(span, says).help(help));
            return;
        }
        if let Some(value) = self.draw(key, known.kind, node) {
            settings.draws.insert(index, Located { value, span });
        }
    }

    fn unknown_key(&mut self, section: Section, span: Span, found: &str, others: &[&str]) {
        let place = match section.algorithm() {
            Some(algorithm) => format!("an [[agent]] with algorithm = \"{}\"", algorithm.name()),
            None => section.header(),
        };
        let message = format!("unknown key `{}` in {place}", shortened(found));
        let names: Vec<&str> = section.keys().iter().map(|key| key.name).collect();
        let fault = Fault::at(span, message);
        self.faults.add(belonging(fault, Some(section), found, &[&names, others].concat()));
    }

    fn agents(&mut self, draft: &mut Draft, inherited: &Draft, node: &Node) {
        let entries = node.get_ref().as_array().map_or(0, |agents| agents.len());
        if node.get_ref().is_array() && entries == 0 && inherited.agents.is_empty() {
            self.expected("agent", "at least one [[agent]]", node);
        }
        let tables = self.tables("agent", node);
        if tables.len() < entries || tables.is_empty() {
            draft.unread_agents.push(None);
        }
        let mut names: Vec<Located<String>> = Vec::new();
        for (span, table) in tables {
            let agent = self.agent(inherited, span, table);
            let name = match &agent {
                Ok(agent) => Some(agent.name.clone()),
                Err(name) => name.clone(),
            };
            let name = name.filter(|name| !name.value.is_empty());
            let same = name.as_ref().and_then(|name| {
                names.iter().find(|other| other.value == name.value).map(|first| (name, first))
            });
            if let Some((name, first)) = same {
                let first = self.text[..first.span.start].matches('\n').count() + 1;
                let fault = Fault::at(name.span, format!("two agents are called `{}`", name.value));
                self.faults.add(fault.help(format!("the first is on line {first}")));
            }
            let is_first = same.is_none();
            match agent {
                Ok(agent) if is_first && name.is_some() => draft.agents.push(agent),
                Ok(agent) if is_first => {
                    draft.unread_agents.push(None);
                    draft.agents.push(agent);
                }
                Ok(_) | Err(_) => {
                    draft.unread_agents.push(name.as_ref().map(|name| name.value.clone()));
                }
            }
            names.extend(name);
        }
        for agent in &draft.agents {
            let Some(label) = &agent.label else { continue };
            let is_shown = |other: &&AgentDraft| {
                let shown = other.label.as_ref().unwrap_or(&other.name);
                other.name.value != agent.name.value && shown.value == label.value
            };
            if let Some(other) = draft.agents.iter().find(is_shown) {
                let message = format!("`label`: agent `{}` has the same label", other.name.value);
                let fault = Fault::at(label.span, message);
                self.faults.add(fault.help("figures distinguish agents by their labels"));
            }
        }
    }

    /// The agent in a table; its name, if that could be read, for an agent that could not.
    fn agent(
        &mut self,
        inherited: &Draft,
        span: Span,
        written: &DeTable,
    ) -> Result<AgentDraft, Option<Located<String>>> {
        let mut others = vec!["name", "label", "algorithm"];
        let of_agents = Section::all().into_iter().filter(|one| one.algorithm().is_some());
        let mut known: Vec<&str> =
            of_agents.flat_map(|section| section.keys()).map(|key| key.name).collect();
        known.extend(others.iter().chain([&PARAMETERS]));
        let table = &*respelt(written, &known);
        let name = match table.get("name") {
            Some(node) => Some(self.name("name", node)).filter(|name| !name.value.is_empty()),
            None => {
                self.faults.add(
                    Fault::at(span, "missing key `name` in [[agent]]")
                        .help("tables and figures use it: write name = \"dqn\""),
                );
                None
            }
        };
        let called = name.as_ref().map(|name| name.value.as_str());
        let algorithm = self.algorithm(inherited, called, span, table);
        // Without a valid algorithm, keys are read as keys of the algorithm that has most of them.
        let known = |algorithm: &&'static Algorithm| {
            let section = Section::Agent(algorithm);
            table.keys().filter(|key| section.find(key.get_ref()).is_some()).count()
        };
        let likely = algorithm.or(Algorithm::all().into_iter().max_by_key(known));
        let likely = likely.expect("there are algorithms");
        let free = table.get(PARAMETERS).filter(|_| likely.is_external());
        let free = free.and_then(|node| self.free_parameters(node)).unwrap_or_default();
        let likely = match free.is_empty() {
            true => likely,
            false => Algorithm::external(free.iter().map(|(name, _)| *name)).unwrap_or(likely),
        };
        if likely.is_external() {
            others.push(PARAMETERS);
        }
        let mut settings = Settings::new(Section::Agent(likely));
        settings.span = Some(span);
        self.settings(&mut settings, written, &others);
        for (key, node) in free {
            self.setting(&mut settings, key, node);
        }
        let label = self.label(table);
        let is_preset = |one: &AgentDraft| Some(one.name.value.as_str()) == called;
        let of_preset = inherited.agents.iter().find(|one| is_preset(one));
        let fits = of_preset.is_none_or(|preset| preset.algorithm.name() == likely.name());
        if algorithm.is_none() || !fits {
            return Err(name);
        }
        // An agent without a name is checked all the same.
        let name = name.unwrap_or(Located { value: String::new(), span });
        Ok(AgentDraft { name, label, algorithm: likely, settings })
    }

    /// The name of an agent in figures and tables.
    fn label(&mut self, table: &DeTable) -> Option<Located<String>> {
        let node = table.get("label")?;
        Some(self.name("label", node))
    }

    /// The algorithm of an agent, from its table or from the preset's agent of the same name.
    fn algorithm(
        &mut self,
        inherited: &Draft,
        called: Option<&str>,
        at: Span,
        table: &DeTable,
    ) -> Option<&'static Algorithm> {
        let of_presets = |agent: &&AgentDraft| Some(agent.name.value.as_str()) == called;
        let preset = inherited.agents.iter().find(of_presets).map(|agent| agent.algorithm);
        let names = Algorithm::all().into_iter().map(Algorithm::name);
        let quoted = names.clone().map(|name| format!("\"{name}\""));
        let expected = quoted.collect::<Vec<_>>().join(" or ");
        let Some(node) = table.get("algorithm") else {
            if preset.is_none() {
                let of_presets = inherited.agents.iter().map(|agent| agent.name.value.as_str());
                let help = match nearest(called.unwrap_or_default(), of_presets) {
                    Some(meant) => format!("did you mean the preset's agent `{meant}`?"),
                    None => format!("write algorithm = {expected}"),
                };
                let fault = Fault::at(at, "missing key `algorithm` in [[agent]]");
                self.faults.add(fault.help(help));
            }
            return preset;
        };
        let found = node.get_ref().as_str().unwrap_or_default();
        let algorithm = Algorithm::named(found);
        match (algorithm, preset) {
            (None, _) => {
                let found_text = self.found(node);
                let message = format!("`algorithm`: expected {expected}, found {found_text}");
                self.faults.add(Fault::at(node.span().into(), message).nearest(found, names));
                preset
            }
            (Some(algorithm), Some(preset)) if algorithm != preset => {
                let preset_name = preset.name();
                let message = format!("`algorithm`: the preset's agent is a \"{preset_name}\"");
                let fault = Fault::at(node.span().into(), message);
                self.faults
                    .add(fault.help("give the agent another name to add it to the preset's"));
                Some(algorithm)
            }
            (Some(algorithm), _) => Some(algorithm),
        }
    }
}

/// The table in a node. A table that double brackets opened is one all the same.
fn table_in<'n>(node: &'n Node<'n>) -> Option<&'n DeTable<'n>> {
    match node.get_ref() {
        DeValue::Table(table) => Some(table),
        DeValue::Array(entries) if entries.len() == 1 => entries[0].get_ref().as_table(),
        _ => None,
    }
}

/// The tables below a table, and the tables in its lists.
fn tables_of<'r, 'n>(root: &'r DeTable<'n>) -> impl Iterator<Item = &'r DeTable<'n>> {
    root.values().flat_map(|node| match node.get_ref() {
        DeValue::Table(table) => vec![table],
        DeValue::Array(list) => {
            list.iter().filter_map(|entry| entry.get_ref().as_table()).collect()
        }
        _ => Vec::new(),
    })
}

/// Adds a hint to a fault: where a key belongs, or which key was probably meant.
fn belonging(fault: Fault, here: Option<Section>, found: &str, names: &[&str]) -> Fault {
    if here.is_some() && ABOVE_TABLES.contains(&found) {
        return fault.help(format!("`{found}` belongs above the first table"));
    }
    let mut elsewhere: Vec<Section> = Section::all()
        .into_iter()
        .filter(|section| Some(*section) != here && section.find(found).is_some())
        .collect();
    // A key of another family stands in the right table.
    let of_family = |section: &Section| matches!(section, Section::Environment(_));
    elsewhere.sort_by_key(|section| !(here.as_ref().is_some_and(of_family) && of_family(section)));
    let agent_here = here.and_then(Section::algorithm);
    match elsewhere.first().map(|section| (*section, section.algorithm(), here)) {
        Some((_, Some(_), Some(Section::Agent(_)))) => {
            let others = elsewhere.iter().filter_map(|section| section.algorithm());
            let others: Vec<String> = others.map(|other| format!("{:?}", other.name())).collect();
            fault.help(format!("`{found}` is a key of {}", others.join(", ")))
        }
        Some((_, Some(_), _)) => fault.help(format!("`{found}` belongs in [[agent]]")),
        Some((Section::Environment(family), None, Some(Section::Environment(_)))) => {
            fault.help(format!("`{found}` is a key of the family {}", family.name))
        }
        Some((section, None, _)) => {
            fault.help(format!("`{found}` belongs in {}", section.header()))
        }
        None if here.is_none() && nearest(found, TABLES).is_some() => {
            let table = nearest(found, TABLES).unwrap_or_default();
            fault.help(format!("did you mean [[{table}]], once for each {table}?"))
        }
        None if agent_here.is_some() && found == "budget" => {
            fault.help("did you mean `episodes`, the budget of training?")
        }
        None if nearest(found, names.iter().copied()).is_none() => {
            let keys = Section::all()
                .into_iter()
                .flat_map(|section| section.keys().iter().map(move |key| (section, key.name)));
            let keys: Vec<(Section, &str)> = keys.collect();
            let meant = nearest(found, keys.iter().map(|(_, key)| *key));
            match keys.iter().find(|(_, key)| Some(*key) == meant) {
                Some((section, key)) => {
                    fault.help(format!("did you mean `{key}` of {}?", section.header()))
                }
                None => fault.one_of(
                    if here.is_some() { "its" } else { "the manifest's" },
                    names,
                    found,
                ),
            }
        }
        None => fault.one_of(if here.is_some() { "its" } else { "the manifest's" }, names, found),
    }
}
