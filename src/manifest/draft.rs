//! A manifest as written: the content of one file, key by key, before defaults and presets.
//!
//! An empty list of values marks a key whose values are faulty and have been reported: the key is present,
//! so it is not reported as missing, and checks that need its values are skipped.

use std::collections::BTreeMap;

use crate::agent::Algorithm;
use crate::env::Family;
use crate::job::Condition;
use crate::key::{Parameter, SectionName, Value};
use crate::manifest::analysis::declared::AnalysisDraft;
use crate::manifest::estimate::declared::EstimateDraft;
use crate::manifest::search::declared::Search;
use crate::manifest::search::draw::Draw;
use crate::manifest::section::{Section, SharedSections};
use crate::text::{Located, Span};

/// The content of a manifest or a preset.
#[derive(Clone, Debug)]
pub(super) struct Draft {
    pub name: Option<Located<String>>,
    pub question: Option<String>,
    pub hypothesis: Option<String>,
    pub published: Option<String>,
    pub time_limit_seconds: Option<u64>,
    pub scenarios: Option<Located<Vec<Value>>>,
    pub seeds: Option<Located<Vec<Value>>>,
    /// The sections that agents share.
    pub sections: SharedSections<Settings>,
    pub search: Option<Located<Search>>,
    pub agents: Vec<AgentDraft>,
    pub zips: Option<Vec<Located<Vec<Parameter>>>>,
    pub exclusions: Vec<Located<Vec<Located<Condition>>>>,
    pub estimates: Vec<EstimateDraft>,
    pub analyses: Vec<AnalysisDraft>,
    /// Whether the file states a version of the format.
    pub has_format: bool,
    /// The names of agents that could not be read; `None` for an agent whose name is unknown.
    pub unread_agents: Vec<Option<String>>,
    /// Whether some zips or exclusions could not be read.
    pub invalid_cells: bool,
    /// Whether there is a search that could not be read.
    pub invalid_search: bool,
}

/// The values that a section of a file gives its keys, by the keys' index in the table.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    pub section: Section,
    /// Where the section is opened.
    pub span: Option<Span>,
    pub given: BTreeMap<usize, Located<Vec<Value>>>,
    /// The draws among the keys, whose values a search gives.
    pub draws: BTreeMap<usize, Located<Draw>>,
}

/// An agent with the keys that a file gives it.
#[derive(Clone, Debug)]
pub(super) struct AgentDraft {
    pub name: Located<String>,
    /// The agent's name in figures.
    pub label: Option<Located<String>>,
    pub algorithm: &'static Algorithm,
    pub settings: Settings,
}

impl Settings {
    pub fn new(section: Section) -> Settings {
        Settings { section, span: None, given: BTreeMap::new(), draws: BTreeMap::new() }
    }

    /// The position of the values of the key called `name`.
    pub fn span_of(&self, name: &str) -> Option<Span> {
        let (index, _) = self.section.find(name)?;
        self.given.get(&index).map(|values| values.span)
    }

    /// The position of the values of the key called `name`, if they are not its default alone.
    pub fn differs(&self, name: &str) -> Option<Span> {
        let (index, key) = self.section.find(name)?;
        let given = self.given.get(&index)?;
        (key.default() != given.value.first().cloned() || given.value.len() > 1)
            .then_some(given.span)
    }

    /// Whether the key called `name` was given values that could not be read.
    pub fn is_invalid(&self, name: &str) -> bool {
        let given = self.section.find(name).and_then(|(index, _)| self.given.get(&index));
        given.is_some_and(|values| values.value.is_empty())
    }

    /// Marks the key at this index of the table as present but invalid.
    pub fn mark_invalid(&mut self, index: usize, span: Span) {
        self.given.entry(index).or_insert(Located { value: Vec::new(), span });
    }

    pub fn override_with(&mut self, other: Settings) {
        if self.section != other.section {
            return *self = other;
        }
        self.span = other.span.or(self.span);
        self.draws.retain(|index, _| !other.given.contains_key(index));
        self.given.extend(other.given);
        self.draws.extend(other.draws);
    }

    fn move_to(&mut self, span: Span) {
        self.span = self.span.map(|_| span);
        self.given.values_mut().for_each(|values| values.span = span);
    }
}

impl Draft {
    /// An empty file about an environment of this family.
    pub fn new(family: &'static Family) -> Draft {
        Draft {
            name: None,
            question: None,
            hypothesis: None,
            published: None,
            time_limit_seconds: None,
            scenarios: None,
            seeds: None,
            sections: SharedSections::of(family, Settings::new),
            search: None,
            agents: Vec::new(),
            zips: None,
            exclusions: Vec::new(),
            estimates: Vec::new(),
            analyses: Vec::new(),
            has_format: false,
            unread_agents: Vec::new(),
            invalid_cells: false,
            invalid_search: false,
        }
    }

    /// The family of the environment.
    pub fn family(&self) -> &'static Family {
        self.sections[SectionName::Environment].section.family().unwrap_or(Family::first())
    }

    /// This draft with the keys of `other` laid over it.
    pub fn overridden_by(mut self, other: Draft) -> Draft {
        for (name, settings) in other.sections.into_iter() {
            if settings.section.is_declared() {
                self.sections[name].override_with(settings);
            }
        }
        for agent in other.agents {
            let name = &agent.name.value;
            let mut same = self.agents.iter_mut().filter(|mine| mine.name.value == *name);
            match same.next().filter(|_| !name.is_empty()) {
                Some(mine) => {
                    mine.name = agent.name;
                    mine.label = agent.label.or(mine.label.take());
                    mine.settings.override_with(agent.settings);
                }
                None => self.agents.push(agent),
            }
        }
        self.unread_agents.extend(other.unread_agents);
        self.exclusions.extend(other.exclusions);
        self.estimates.extend(other.estimates);
        self.analyses.extend(other.analyses);
        Draft {
            name: other.name.or(self.name),
            question: other.question.or(self.question),
            hypothesis: other.hypothesis.or(self.hypothesis),
            published: other.published.or(self.published),
            time_limit_seconds: other.time_limit_seconds.or(self.time_limit_seconds),
            scenarios: other.scenarios.or(self.scenarios),
            seeds: other.seeds.or(self.seeds),
            zips: other.zips.or(self.zips),
            has_format: other.has_format,
            invalid_cells: other.invalid_cells || self.invalid_cells,
            search: other.search.or(self.search),
            invalid_search: other.invalid_search || self.invalid_search,
            ..self
        }
    }

    /// This draft with all positions at `span`, where faults in a preset are reported.
    pub fn moved_to(mut self, span: Span) -> Draft {
        self.name.iter_mut().for_each(|name| name.span = span);
        self.scenarios.iter_mut().for_each(|scenarios| scenarios.span = span);
        self.seeds.iter_mut().for_each(|seeds| seeds.span = span);
        self.sections.values_mut().for_each(|settings| settings.move_to(span));
        for agent in &mut self.agents {
            agent.name.span = span;
            agent.settings.move_to(span);
        }
        self.zips.iter_mut().flatten().for_each(|zip| zip.span = span);
        for exclusion in &mut self.exclusions {
            exclusion.span = span;
            exclusion.value.iter_mut().for_each(|condition| condition.span = span);
        }
        self
    }

    /// The settings of every section.
    pub fn all_settings(&mut self) -> impl Iterator<Item = &mut Settings> {
        let of_agents = self.agents.iter_mut().map(|agent| &mut agent.settings);
        self.sections.values_mut().chain(of_agents)
    }

    /// Whether some agents could not be read.
    pub fn invalid_agents(&self) -> bool {
        !self.unread_agents.is_empty()
    }

    /// Whether the values of `parameter` are faulty, for at least one agent that has the parameter.
    pub fn is_invalid(&self, parameter: Parameter) -> bool {
        match parameter {
            Parameter::SCENARIO => self.scenarios.as_ref().is_none_or(|list| list.value.is_empty()),
            Parameter::SEED => self.seeds.as_ref().is_none_or(|list| list.value.is_empty()),
            // An agent that could not be read has its name all the same, unless the name is unknown.
            Parameter::AGENT_NAME => self.unread_agents.contains(&None),
            Parameter::Agent(key) => {
                self.invalid_agents()
                    || self.agents.iter().any(|agent| agent.settings.is_invalid(key))
            }
            shared => shared
                .section()
                .is_some_and(|section| self.sections[section].is_invalid(shared.key())),
        }
    }

    /// Whether the values of `parameter` are faulty for the agent at this index.
    pub fn is_invalid_for(&self, agent: usize, parameter: Parameter) -> bool {
        match parameter {
            Parameter::Agent(key) => self.agents[agent].settings.is_invalid(key),
            shared => self.is_invalid(shared),
        }
    }

    /// Marks the top-level key `meant` as present, although its name or place is wrong.
    pub fn mark_invalid(&mut self, meant: &str, span: Span) {
        match meant {
            "format" => self.has_format = true,
            "name" => {
                self.name.get_or_insert(Located { value: String::new(), span });
            }
            "scenarios" => {
                self.scenarios.get_or_insert(Located { value: Vec::new(), span });
            }
            "seeds" => {
                self.seeds.get_or_insert(Located { value: Vec::new(), span });
            }
            "agent" => self.unread_agents.push(None),
            "zip" | "exclude" => self.invalid_cells = true,
            "search" => self.invalid_search = true,
            "environment" => {
                let environment = &mut self.sections[SectionName::Environment];
                for index in 0..environment.section.keys().len() {
                    environment.mark_invalid(index, span);
                }
            }
            _ => {}
        }
    }

    /// The position of the values of `parameter` for the agent at this index.
    pub fn span_of(&self, agent: usize, parameter: Parameter) -> Option<Span> {
        match parameter {
            Parameter::SCENARIO => self.scenarios.as_ref().map(|list| list.span),
            Parameter::SEED => self.seeds.as_ref().map(|list| list.span),
            Parameter::Agent(key) => self.agents.get(agent)?.settings.span_of(key),
            shared => self.sections[shared.section()?].span_of(shared.key()),
        }
    }
}
