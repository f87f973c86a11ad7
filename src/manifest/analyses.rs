//! Reads `[[analysis]]`, and checks each analysis against the rest of the manifest.

use std::cell::LazyCell;
use std::collections::HashSet;

use toml::de::DeTable;

use super::analysed_jobs;
use super::analysis::{Analysis, AnalysisDraft};
use super::analysis_keys::{ANALYSED_METRICS, ERROR_AXIS, KindName, WINDOW};
use super::analysis_kind::{AnalysisKind, CurveAxis, Recovery};
use super::declared::{DeclaredAgent, Manifest};
use super::draft::Draft;
use super::fault::{Fault, FaultList, near};
use super::limits::MOST_COMPARISONS;
use super::parameter::{meant, named};
use super::presence::absent;
use super::read::shortened;
use super::respelt::respelt;
use super::section::Section;
use super::sides::Sides;
use super::source::{Located, Span};
use super::sweep::{Node, Reader};
use crate::agent::free_key;
use crate::job::Condition;
use crate::job::{first_episodes, first_return};
use crate::key::{Distribution, Kind, Parameter, Value};

/// The probability of context 1.
const CONTEXT_PROBABILITY: Parameter = Parameter::Environment("context_probability");

impl Reader<'_> {
    /// Reads `[[analysis]]`.
    pub fn analyses(&mut self, draft: &mut Draft, node: &Node) {
        let mut names = HashSet::new();
        for (place, (span, written)) in self.tables("analysis", node).into_iter().enumerate() {
            let shared = KindName::ALL[0].key_names();
            let kind = self.kind(span, &respelt(written, &shared));
            if let Some(kind) = kind {
                self.analysis_keys(kind, written);
            }
            let known = kind.map_or(shared, KindName::key_names);
            let table = &*respelt(written, &known);
            let name = match table.get("name") {
                Some(node) => self.name("name", node),
                None => {
                    let help = "files and links use it: write name = \"figure-1\"";
                    let fault = Fault::at(span, "missing key `name` in an [[analysis]]");
                    self.faults.add(fault.help(help));
                    Located { value: String::new(), span }
                }
            };
            if !name.value.is_empty() && !names.insert(name.value.clone()) {
                let message = format!("another [[analysis]] is called `{}`", name.value);
                self.faults.add(Fault::at(name.span, message));
            }
            draft.analyses.push(self.analysis((place, kind), &name.value, span, table));
        }
    }

    /// The kind of an analysis; for an unknown word, the kind with the nearest one.
    fn kind(&mut self, span: Span, table: &DeTable) -> Option<KindName> {
        let words: Vec<&str> = KindName::ALL.iter().map(|kind| kind.word()).collect();
        let Some(node) = table.get("kind") else {
            let fault = Fault::at(span, "missing key `kind` in an [[analysis]]");
            self.faults.add(fault.help(format!("expected one of {}", words.join(", "))));
            return None;
        };
        let word = self.word("kind", &words, node);
        let word = word.or_else(|| near(node.get_ref().as_str()?, words))?;
        KindName::ALL.iter().find(|kind| kind.word() == word).copied()
    }

    fn analysis_keys(&mut self, kind: KindName, table: &DeTable) {
        let keys = kind.key_names();
        for key in table.keys() {
            let found = key.get_ref().as_ref();
            if !keys.contains(&found) {
                let found = shortened(found);
                let kind = kind.word();
                let message =
                    format!("unknown key `{found}` in an [[analysis]] of kind \"{kind}\"");
                let fault = Fault::at(key.span().into(), message);
                self.faults.add(fault.one_of("its", &keys, &found));
            }
        }
    }

    /// The analysis in a table. A faulty part has been reported, and is replaced by one that always holds.
    fn analysis(
        &mut self,
        (place, kind): (usize, Option<KindName>),
        name: &str,
        span: Span,
        table: &DeTable,
    ) -> AnalysisDraft {
        let title = table.get("title").and_then(|node| self.text("title", node));
        let metric = table.get("metric").map(|node| {
            match node.get_ref().as_str().and_then(first_episodes) {
                Some(episodes) => Some(first_return(episodes)),
                None => self.word("metric", ANALYSED_METRICS, node),
            }
        });
        let jobs = table.get("where").and_then(|node| self.table("where", node));
        let mut located = jobs.map(|jobs| self.conditions(jobs, "`where`")).unwrap_or_default();
        let conditions = located.iter().map(|condition| condition.value.clone()).collect();
        let mut axes = Vec::new();
        let kind =
            kind.and_then(|kind| AnalysisKind::read(kind, self, name, (span, table), &mut axes));
        let kind = kind.unwrap_or(AnalysisKind::LearningCurve { window: WINDOW });
        if let (Some(sides), Some(node)) = (kind.sides(), table.get("between")) {
            for side in [&sides.first, &sides.second] {
                located.push(Located { value: side.clone(), span: node.span().into() });
            }
        }
        if let AnalysisKind::Recovery(Recovery { with, without }) = &kind {
            for (side, conditions) in [("with", with), ("without", without)] {
                let span = table.get(side).map_or(span, |node| node.span().into());
                let values = conditions.iter().cloned();
                located.extend(values.map(|value| Located { value, span }));
            }
        }
        let participants = self.participants(metric.unwrap_or(Some(ANALYSED_METRICS[0])), table);
        let mut panels = Vec::new();
        let figure = self.figure_keys(table, &mut panels);
        let analysis = Analysis {
            name: name.to_owned(),
            title,
            metric: metric.flatten().unwrap_or(ANALYSED_METRICS[0]),
            participants: participants.as_ref().map(|range| range.value),
            conditions,
            figure,
            kind,
        };
        AnalysisDraft { place, analysis, conditions: located, participants, panels, axes, span }
    }

    /// The conditions on the arms of a recovery, under the key `key`.
    pub fn arms(&mut self, key: &str, span: Span, table: &DeTable) -> Option<Vec<Condition>> {
        let Some(node) = table.get(key) else {
            let fault = Fault::at(span, format!("missing key `{key}` in an [[analysis]]"));
            let help = "write conditions: { agent.name = \"ppo\", scenario = \"P-T\" }";
            self.faults.add(fault.help(help));
            return None;
        };
        let table = self.table(key, node)?;
        if table.is_empty() {
            self.expected(key, "at least one condition, as in { agent.name = \"ppo\" }", node);
        }
        let conditions = self.conditions(table, &format!("`{key}`"));
        if conditions.is_empty() {
            return None;
        }
        Some(conditions.into_iter().map(|condition| condition.value).collect())
    }

    /// The two sides, from the keys `by` and `between`.
    pub fn sides(&mut self, span: Span, table: &DeTable) -> Option<Sides> {
        let (Some(by), Some(between)) = (table.get("by"), table.get("between")) else {
            let fault = Fault::at(span, "a difference needs `by` and `between`");
            let help = "write by = \"scenario\" and between = [\"P-H-D\", \"L-H-D\"]";
            self.faults.add(fault.help(help));
            return None;
        };
        let items = between.get_ref().as_array().map_or(&[][..], |items| &items[..]);
        let [one, other] = items else {
            self.expected("between", "a list of two values, as in [\"P-H-D\", \"L-H-D\"]", between);
            return None;
        };
        let parameter = by.get_ref().as_str().unwrap_or_default();
        let is_known = matches!(parameter, "agent" | "agent.name") || named(parameter).is_some();
        let first = self.side(parameter, by, one);
        // An unknown parameter is reported once.
        let (first, second) = (first, is_known.then(|| self.side(parameter, by, other)).flatten());
        let (first, second) = (first?, second?);
        if first == second {
            self.expected("between", "two different values", other);
            return None;
        }
        Some(Sides { first, second })
    }

    /// The condition that the parameter named in `by` has the value of `node`.
    fn side(&mut self, name: &str, by: &Node, node: &Node) -> Option<Condition> {
        if matches!(name, "agent" | "agent.name") {
            let Some(agent) = node.get_ref().as_str() else {
                self.expected("between", "an agent's name in quotes", node);
                return None;
            };
            return Some(Condition::texts(Parameter::AGENT_NAME, [agent]));
        }
        match named(name) {
            Some(parameter @ Parameter::SCENARIO) => {
                let values = self.scenarios("between", node);
                (!values.is_empty()).then_some(Condition { parameter, values })
            }
            Some(
                parameter @ (Parameter::Environment(_)
                | Parameter::Population(_)
                | Parameter::Agent(_)
                | Parameter::Evaluation(_)),
            ) => {
                let value = self.value("between", kind_of(parameter)?, node)?;
                Some(Condition { parameter, values: vec![value] })
            }
            // Seeds are replications: means are taken over them, so they are no side.
            Some(Parameter::Job(_)) | None => {
                self.unknown_parameter("by", by, &["agent.name"]);
                None
            }
        }
    }

    pub fn curve_axis(
        &mut self,
        span: Span,
        table: &DeTable,
        axes: &mut Vec<Located<Parameter>>,
    ) -> Option<CurveAxis> {
        let node = table.get("x");
        if node.is_none_or(|node| node.get_ref().as_str() == Some(ERROR_AXIS)) {
            let parameter = Parameter::Environment("sigma");
            let span = node.map_or(span, |node| node.span().into());
            axes.push(Located { value: parameter, span });
            return Some(CurveAxis::ContextInferenceError);
        }
        self.axis("x", span, table, axes).map(CurveAxis::Swept)
    }

    /// A parameter with numeric values.
    pub fn axis(
        &mut self,
        key: &str,
        span: Span,
        table: &DeTable,
        axes: &mut Vec<Located<Parameter>>,
    ) -> Option<Parameter> {
        let Some(node) = table.get(key) else {
            let fault = Fault::at(span, format!("missing key `{key}` in an [[analysis]]"));
            self.faults.add(fault.help("write the dotted name of a swept parameter"));
            return None;
        };
        let named = node.get_ref().as_str().and_then(named);
        let numeric = named.filter(|parameter| {
            matches!(
                kind_of(*parameter),
                Some(
                    Kind::Real { .. }
                        | Kind::PositiveReal { .. }
                        | Kind::Integer { .. }
                        | Kind::Scalar
                )
            )
        });
        match numeric {
            Some(parameter) => axes.push(Located { value: parameter, span: node.span().into() }),
            None => self.unknown_parameter(key, node, &[ERROR_AXIS]),
        }
        numeric
    }

    fn unknown_parameter(&mut self, key: &str, node: &Node, others: &[&str]) {
        let found = self.found(node);
        let message = format!("`{key}`: expected the dotted name of a parameter, found {found}");
        let dotted = node.get_ref().as_str().unwrap_or_default();
        let fault = Fault::at(node.span().into(), message);
        // The section alone means its only name among the others.
        let section = others.iter().copied().find(|name| name.split('.').next() == Some(dotted));
        let meant = section.map(str::to_owned).or_else(|| meant(dotted, others));
        self.faults.add(match meant.filter(|name| name != dotted) {
            Some(name) => fault.help(format!("did you mean `{name}`?")),
            None => fault,
        });
    }

    /// One of `words`.
    pub fn word(
        &mut self,
        name: &str,
        words: &[&'static str],
        node: &Node,
    ) -> Option<&'static str> {
        let found = node.get_ref().as_str();
        let word = words.iter().find(|word| Some(**word) == found).copied();
        if word.is_none() {
            let quoted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
            let message =
                format!("`{name}`: expected {}, found {}", quoted.join(" or "), self.found(node));
            let fault = Fault::at(node.span().into(), message);
            self.faults.add(fault.nearest(found.unwrap_or_default(), words.iter().copied()));
        }
        word
    }
}

/// The type of a parameter's values; `None` for scenario and seed, which no table declares.
fn kind_of(parameter: Parameter) -> Option<Kind> {
    let sections = Section::all().into_iter();
    let of = |section: Section| {
        let (_, key) = section.find(parameter.key())?;
        (section.parameter(key.name) == parameter).then_some(key.kind)
    };
    sections.filter_map(of).next().or_else(|| free_key(parameter.key()).map(|key| key.kind))
}

/// The faults of each analysis that refers to something that the manifest does not declare, by its index;
/// reports analyses that are too many to be checked.
pub(super) fn lost(
    draft: &Draft,
    manifest: &Manifest,
    faults: &mut FaultList,
) -> Vec<(usize, FaultList)> {
    if !comparisons_fit(draft, manifest, faults) {
        return Vec::new();
    }
    let seeds = LazyCell::new(|| manifest.seeds().collect());
    let mut lost = Vec::new();
    for analysis in &draft.analyses {
        let mut faults = FaultList::default();
        let checked = Checked { draft, manifest, analysis };
        checked.conditions(&mut faults);
        checked.metric(&mut faults);
        checked.sides(&mut faults);
        checked.inference_error(&mut faults);
        if let AnalysisKind::Recovery(recovery) = &analysis.analysis.kind {
            analysed_jobs::of_recovery(draft, manifest, (analysis, recovery), &mut faults);
        } else if faults.is_empty() {
            analysed_jobs::of(draft, manifest, analysis, &mut faults);
        }
        checked.axes(&mut faults);
        checked.seeds(&seeds, &mut faults);
        if !faults.is_empty() {
            lost.push((analysis.place, faults));
        }
    }
    lost
}

/// An analysis that is checked against the rest of its manifest.
struct Checked<'m> {
    draft: &'m Draft,
    manifest: &'m Manifest,
    analysis: &'m AnalysisDraft,
}

impl Checked<'_> {
    fn conditions(&self, faults: &mut FaultList) {
        for condition in &self.analysis.conditions {
            if let Some(absent) = absent(self.draft, self.manifest, &condition.value) {
                faults.add(absent.fault("no job to analyse", condition.span));
            }
        }
    }

    /// Reports a metric or participants that no job records.
    fn metric(&self, faults: &mut FaultList) {
        let Checked { draft, manifest, analysis } = self;
        if let Some(episodes) = first_episodes(analysis.analysis.metric) {
            const LISTS: &str = "first_episodes";
            let lists = manifest.evaluation.get(LISTS).unwrap_or_default();
            let has =
                |list: &Value| matches!(list, Value::Wholes(list) if list.contains(&episodes));
            if !lists.iter().all(has) && !draft.is_invalid(Parameter::Evaluation(LISTS)) {
                let metric = analysis.analysis.metric;
                let message = format!("no job records the metric \"{metric}\"");
                let help = format!("list {episodes} in `evaluation.{LISTS}`");
                faults.add(Fault::at(analysis.span, message).help(help));
            }
        }
        if let Some(range) = &analysis.participants
            && !differ_in(manifest, range.value.parameter)
            && !draft.is_invalid(Parameter::Population(range.value.parameter))
            && !draft.is_invalid(Parameter::Population("rows"))
        {
            let name = range.value.parameter;
            let message = format!("`participants`: [population] gives no `{name}`");
            let help = "name a parameter that has a distribution, or is a column of `rows`";
            faults.add(Fault::at(range.span, message).help(help));
        }
    }

    /// Reports a side whose agent lacks a key of a condition.
    fn sides(&self, faults: &mut FaultList) {
        let Checked { manifest, analysis, .. } = self;
        for side in analysis.analysis.kind.sides().iter().flat_map(|sides| sides.both()) {
            let is_side = |agent: &&DeclaredAgent| side.values.contains(&agent.names[0]);
            let agent = manifest.agents.iter().find(is_side);
            let lacks = |condition: &&Located<Condition>| {
                agent.is_some_and(|agent| {
                    manifest.values(agent, condition.value.parameter).is_none()
                })
            };
            if let (Some(condition), Some(agent)) = (analysis.conditions.iter().find(lacks), agent)
            {
                let key = condition.value.name();
                let message =
                    format!("agent `{}` has no key `{key}`, so no job of it is left", agent.name);
                let help = "leave the condition out: a key that only one of the agents sweeps has a row \
                            per value";
                faults.add(Fault::at(condition.span, message).help(help));
            }
        }
    }

    /// Reports an inference error that depends on more than sigma.
    fn inference_error(&self, faults: &mut FaultList) {
        let Checked { manifest, analysis, .. } = self;
        if !analysis.analysis.kind.shows_inference_error() {
            return;
        }
        let odds = manifest.environment.get(CONTEXT_PROBABILITY.key()).unwrap_or_default();
        let is_invalid = self.draft.is_invalid(CONTEXT_PROBABILITY);
        let unequal = odds.iter().find(|value| **value != Value::Real(0.5) && !is_invalid);
        if let Some(value) = unequal {
            let message = format!(
                "the context inference error requires equally likely contexts, found \
                 `{CONTEXT_PROBABILITY}` = {value}"
            );
            let help = "use another analysis, or a curve with x = \"environment.sigma\"";
            faults.add(Fault::at(analysis.span, message).help(help));
        }
        let differing =
            ["sigma", CONTEXT_PROBABILITY.key()].into_iter().find(|name| differ_in(manifest, name));
        if let Some(name) = differing {
            let message = format!("the context inference error depends on `population.{name}`");
            let help = "use another analysis";
            faults.add(Fault::at(analysis.span, message).help(help));
        }
    }

    /// Reports axes and panels of keys that are not swept, and axes of values that are no numbers.
    fn axes(&self, faults: &mut FaultList) {
        let Checked { draft, manifest, analysis } = self;
        let is_single = |parameter| {
            let lengths = manifest.agents.iter().map(|agent| manifest.length(agent, parameter));
            lengths.max().is_some_and(|most| most < 2) && !draft.is_invalid(parameter)
        };
        for axis in analysis.axes.iter().filter(|axis| !draft.is_invalid(axis.value)) {
            let mut add = |says: &str, help: &str| {
                let message = format!("`{}` {says}", axis.value);
                faults.add(Fault::at(axis.span, message).help(help));
            };
            if is_single(axis.value) {
                let help =
                    "an axis needs a number with several values: sweep it, or name another number";
                add("is not swept: it has one value", help);
            }
            let repeats = |values: &&[Value]| {
                let mut seen = HashSet::new();
                !values.iter().all(|value| seen.insert(value))
            };
            let mut lists =
                manifest.agents.iter().filter_map(|agent| manifest.values(agent, axis.value));
            let is_number = |value: &Value| {
                matches!(value, Value::Real(_) | Value::Integer(_) | Value::Negative(_))
            };
            if lists.clone().any(|list| !list.iter().all(is_number)) {
                add("has values that are not numbers", "an axis needs numbers");
            }
            if lists.any(|list| repeats(&list)) {
                let help = "an axis needs distinct values; use another parameter of its zip";
                add("has a value twice", help);
            }
        }
        for panel in analysis.panels.iter().filter(|panel| is_single(panel.value)) {
            let message = format!("`{}` is not swept: it has one value", panel.value);
            faults
                .add(Fault::at(panel.span, message).help("panels need a key with several values"));
        }
    }

    /// Reports a selection that reports on seeds of its search.
    fn seeds(
        &self,
        seeds: &LazyCell<HashSet<u64>, impl FnOnce() -> HashSet<u64>>,
        faults: &mut FaultList,
    ) {
        let reported = self.analysis.analysis.kind.reporting_seeds();
        let shared = reported.iter().find(|seed| seeds.contains(seed));
        if let (Some(seed), false) = (shared, self.draft.is_invalid(Parameter::SEED)) {
            let message = format!("seed {seed} is used both for the search and for the report");
            let help = "search on seeds that are not reported, such as seeds = [101, 102]";
            faults.add(Fault::at(self.analysis.span, message).help(help));
        }
    }
}

/// Whether the population varies the parameter between participants in any job.
fn differ_in(manifest: &Manifest, parameter: &str) -> bool {
    let values = |key| manifest.population.get(key).unwrap_or_default().iter();
    let has_column = |value: &Value| match value {
        Value::Rows(rows) => rows.columns().contains(&parameter),
        _ => false,
    };
    let is_given = |value: &Value| *value != Value::Distribution(Distribution::Fixed);
    values(parameter).any(is_given) || values("rows").any(has_column)
}

/// Whether comparing the analyses with the agents' keys takes acceptable time; reports a fault if not.
fn comparisons_fit(draft: &Draft, manifest: &Manifest, faults: &mut FaultList) -> bool {
    let conditions = || draft.analyses.iter().flat_map(|analysis| &analysis.conditions);
    let present = |parameter: Parameter| -> usize {
        let lengths = manifest.agents.iter().map(|agent| manifest.length(agent, parameter));
        match parameter {
            Parameter::Job(_) => lengths.max().unwrap_or(0),
            _ => lengths.sum(),
        }
    };
    let comparisons: usize =
        conditions().map(|one| present(one.value.parameter) + one.value.values.len()).sum();
    let axes: usize = draft.analyses.iter().map(|analysis| analysis.axes.len()).sum();
    let comparisons = comparisons + axes * manifest.agents.len();
    if comparisons as u64 <= MOST_COMPARISONS {
        return true;
    }
    let message = format!(
        "the analyses need {comparisons} comparisons with values; the maximum is {MOST_COMPARISONS}"
    );
    let span = draft.analyses.first().map_or(Span { start: 0, end: 0 }, |first| first.span);
    faults.add(Fault::at(span, message).help(format!(
        "analyses: {}, conditions: {}; leave out conditions that every job meets",
        draft.analyses.len(),
        conditions().count()
    )));
    false
}
