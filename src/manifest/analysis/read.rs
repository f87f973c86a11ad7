//! Reads `[[analysis]]`, and checks each analysis against the rest of the manifest.

use std::collections::HashSet;

use toml::de::DeTable;

use crate::env::Scenario;
use crate::job::metric::UPPER_QUARTILE_RETURN;
use crate::job::metric::{MEAN_RETURN, metrics_with};
use crate::job::{Condition, MetricName, MetricPlace, RecordedEpisodes, RecordedQuartiles, Scalar};
use crate::key::{Distribution, Parameter, SectionName, Value};
use crate::manifest::analysis::declared::{Analysis, AnalysisDraft};
use crate::manifest::analysis::figure_keys::FigureKeys;
use crate::manifest::analysis::jobs;
use crate::manifest::analysis::kind::{
    AnalysisKind, Declares, KINDS, KindDeclaration, LearningCurve, SHARED,
};
use crate::manifest::declared::{DeclaredAgent, Manifest, Zip};
use crate::manifest::draft::Draft;
use crate::manifest::limits::MOST_COMPARISONS;
use crate::manifest::presence::absent;
use crate::manifest::table::{Fields, Need, TableReader};
use crate::manifest::value::respelt::respelt;
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, FaultList, Located, Span, near};

/// The probability of context 1.
const CONTEXT_PROBABILITY: Parameter = Parameter::Environment("context_probability");

impl Reader<'_> {
    /// Reads `[[analysis]]`.
    pub fn analyses(&mut self, draft: &mut Draft, node: &Node) {
        let mut names = HashSet::new();
        for (index, (span, written)) in self.tables("analysis", node).into_iter().enumerate() {
            let kind = self.kind(span, &respelt(written, &SHARED));
            let word = kind.map(|kind| format!(" of kind \"{}\"", kind.word)).unwrap_or_default();
            let title = format!("an [[analysis]]{word}");
            let table = match kind {
                Some(kind) => self.known_keys(&title, &kind.key_names(), written),
                None => respelt(written, &SHARED),
            };
            let says = ("[[analysis]]", "files and links use it: write name = \"figure-1\"", None);
            let name = self.name_among(says, span, &table, &mut names).value;
            let table = TableReader {
                reader: self,
                title: &title,
                name: &name,
                span,
                table: &table,
                needs: Vec::new(),
            };
            draft.analyses.push(analysis(index, kind, table));
        }
    }

    /// The kind of an analysis; for an unknown word, the kind with the nearest one.
    fn kind(&mut self, span: Span, table: &DeTable) -> Option<&'static KindDeclaration> {
        let words: Vec<&str> = KINDS.iter().map(|kind| kind.word).collect();
        let Some(node) = table.get("kind") else {
            let fault = Fault::at(span, "missing key `kind` in an [[analysis]]");
            self.faults.add(fault.help(format!("expected one of {}", words.join(", "))));
            return None;
        };
        if node.get_ref().as_str() == Some("selection") {
            self.no_selection(node);
            return None;
        }
        let word = self.word("kind", &words, node);
        let word = word.or_else(|| near(node.get_ref().as_str()?, words))?;
        KINDS.iter().find(|kind| kind.word == word)
    }

    /// Reports an analysis of an earlier release, with what is written in its place.
    fn no_selection(&mut self, node: &Node) {
        let message = "`kind`: \"selection\" has given way to [search], which finds the best settings by a race";
        let help = "replace it, and the manifest's `seeds`, by `search = { samples = 16, rungs = [2, 4], keep = 0.5, fresh = 10 }`, \
                    with the `reporting_seeds` as `fresh`, and each list of an agent by a draw such as { choices = [0.001, 0.01] }";
        self.faults.add(Fault::at(node.span().into(), message).help(help));
    }

    /// A metric that an analysis can have.
    fn metric(&mut self, node: &Node) -> Option<MetricName> {
        let named = node.get_ref().as_str().and_then(MetricName::named);
        let mut known = metrics_with(MetricPlace::Analyses, self.family.termination_metric);
        let words: Vec<_> = known.clone().map(MetricName::text).collect();
        let is_known = |metric: &MetricName| {
            metric.first_episodes().is_some() || known.any(|one| one == *metric)
        };
        named.filter(is_known).or_else(|| {
            self.not_one_of("metric", &words, node);
            None
        })
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
            self.not_one_of(name, words, node);
        }
        word
    }

    /// Reports a value that is none of `words`.
    fn not_one_of(&mut self, name: &str, words: &[impl AsRef<str>], node: &Node) {
        let words = || words.iter().map(AsRef::as_ref);
        let quoted: Vec<String> = words().map(|word| format!("\"{word}\"")).collect();
        let message =
            format!("`{name}`: expected {}, found {}", quoted.join(" or "), self.found(node));
        let fault = Fault::at(node.span().into(), message);
        self.faults.add(fault.nearest(node.get_ref().as_str().unwrap_or_default(), words()));
    }
}

/// The analysis in a table. A faulty part has been reported, and is replaced by one that always holds.
fn analysis(
    index: usize,
    kind: Option<&KindDeclaration>,
    mut table: TableReader<'_, '_>,
) -> AnalysisDraft {
    let TableReader { reader, name, span, table: keys, .. } = &mut table;
    let (name, span, keys) = (*name, *span, *keys);
    let title = keys.get("title").and_then(|node| reader.prose("title", node));
    let metric = keys.get("metric").map(|node| reader.metric(node));
    let jobs = keys.get("where").and_then(|node| reader.table("where", node));
    let located = jobs.map(|jobs| reader.conditions(jobs, "`where`")).unwrap_or_default();
    let participants = reader.participants(metric.unwrap_or(Some(MEAN_RETURN)), keys);
    for condition in &located {
        table.need(condition.span, Need::Jobs(condition.value.clone()));
    }
    let kind = kind.and_then(|kind| (kind.read)(&mut table));
    let figure = FigureKeys::read(&mut table).unwrap_or_default();
    if let (Some(low), Some(high), Some(node)) = (figure.y_min, figure.y_max, table.node("y_max"))
        && low >= high
    {
        table.reader.expected("y_max", "a number above `y_min`", node);
    }
    let analysis = Analysis {
        name: name.to_owned(),
        title,
        metric: metric.flatten().unwrap_or(MEAN_RETURN),
        participants: participants.as_ref().map(|range| range.value),
        conditions: located.into_iter().map(|condition| condition.value).collect(),
        figure,
        kind: kind.unwrap_or(AnalysisKind::LearningCurve(LearningCurve { window: 1 })),
    };
    let mut draft = AnalysisDraft {
        index,
        analysis,
        conditions: Vec::new(),
        participants,
        panels: Vec::new(),
        axes: Vec::new(),
        span,
    };
    for Located { value, span } in table.needs {
        match value {
            Need::Jobs(value) => draft.conditions.push(Located { value, span }),
            Need::Values(value) => draft.panels.push(Located { value, span }),
            Need::Numbers(value) => draft.axes.push(Located { value, span }),
        }
    }
    draft
}

/// The faults of each analysis that refers to something that the manifest does not declare, by its index;
/// reports analyses that are too many to be checked.
pub(in crate::manifest) fn lost(
    draft: &Draft,
    manifest: &Manifest,
    faults: &mut FaultList,
) -> Vec<(usize, FaultList)> {
    if !comparisons_fit(draft, manifest, faults) {
        return Vec::new();
    }
    let mut lost = Vec::new();
    for analysis in &draft.analyses {
        let mut faults = FaultList::default();
        let checked = Checked { draft, manifest, analysis };
        let rules = analysis.analysis.kind.rules();
        checked.family(&mut faults);
        rules.check(&checked, analysis.span, &mut faults);
        checked.conditions(&mut faults);
        checked.metric(&mut faults);
        checked.sides(&mut faults);
        checked.inference_error(&mut faults);
        if let Some(groups) = rules.groups() {
            jobs::of_groups(draft, manifest, (analysis, groups), &mut faults);
        } else if faults.is_empty() {
            jobs::of(draft, manifest, analysis, &mut faults);
        }
        checked.axes(&mut faults);
        if !faults.is_empty() {
            lost.push((analysis.index, faults));
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

impl Declares for Checked<'_> {
    fn values(&self, parameter: Parameter) -> Option<&[Value]> {
        self.manifest.sections[parameter.section()?].get(parameter.key())
    }

    fn has_together(&self, parameters: &[Parameter], numbers: &[f64]) -> bool {
        let numbers_of = |parameter: &Parameter| -> Vec<Option<f64>> {
            let values = self.values(*parameter).unwrap_or_default();
            values.iter().map(|value| Scalar::from(value).number()).collect()
        };
        let all: Vec<Vec<Option<f64>>> = parameters.iter().map(numbers_of).collect();
        let mut pairs = all.iter().zip(numbers);
        let is_zipped = |zip: &Zip| parameters.iter().all(|one| zip.parameters.contains(one));
        match self.manifest.zips.iter().any(is_zipped) {
            false => pairs.all(|(values, number)| values.contains(&Some(*number))),
            true => {
                let has = |index: usize| {
                    let mut pairs = all.iter().zip(numbers);
                    pairs.all(|(values, number)| values.get(index) == Some(&Some(*number)))
                };
                (0..all[0].len()).any(has)
            }
        }
    }

    fn scenarios(&self) -> Vec<Scenario> {
        let is_invalid = self.draft.is_invalid(Parameter::SCENARIO);
        if is_invalid { Vec::new() } else { self.manifest.scenarios().collect() }
    }

    fn estimates(&self) -> Option<Vec<&str>> {
        let has_some = !(self.manifest.estimates.is_empty() && self.draft.estimates.is_empty());
        let names = self.manifest.estimates.iter().map(|one| one.declaration.name.as_str());
        has_some.then(|| names.collect())
    }
}

impl Checked<'_> {
    fn conditions(&self, faults: &mut FaultList) {
        for condition in &self.analysis.conditions {
            if let Some(absent) = absent(self.draft, self.manifest, &condition.value) {
                faults.add(absent.fault("no job to analyse", condition.span));
            }
        }
    }

    /// Reports a kind that needs something that the family of the environment does not have.
    fn family(&self, faults: &mut FaultList) {
        let Checked { manifest, analysis, .. } = self;
        let family = manifest.family();
        let kind = &analysis.analysis.kind;
        let Some(needed) = kind.rules().lacking(family) else { return };
        let message = format!(
            "kind \"{}\" is not possible with environment.family = \"{}\", which lacks {needed}",
            kind.word(),
            family.name
        );
        faults.add(Fault::at(analysis.span, message));
    }

    /// Reports a metric or participants that no job records.
    fn metric(&self, faults: &mut FaultList) {
        let Checked { draft, manifest, analysis } = self;
        if let Some(episodes) = analysis.analysis.metric.first_episodes() {
            const LISTS: &str = "first_episodes";
            let lists = manifest.sections[SectionName::Evaluation].get(LISTS).unwrap_or_default();
            let has =
                |list: &Value| matches!(list, Value::Wholes(list) if list.contains(&episodes));
            if !lists.iter().all(has) && !draft.is_invalid(Parameter::Evaluation(LISTS)) {
                let metric = analysis.analysis.metric;
                let message = format!("no job records the metric \"{metric}\"");
                let help = format!("list {episodes} in `evaluation.{LISTS}`");
                faults.add(Fault::at(analysis.span, message).help(help));
            }
        }
        let kept =
            manifest.sections[SectionName::Evaluation].get("record_episodes").unwrap_or_default();
        let quartiles =
            manifest.sections[SectionName::Evaluation].get("record_quartiles").unwrap_or_default();
        // Where some jobs store their episodes, the analysis can be of these.
        if analysis.analysis.metric == UPPER_QUARTILE_RETURN
            && kept == [Value::Choice(RecordedEpisodes::None.word())]
            && !quartiles.contains(&Value::Choice(RecordedQuartiles::Both.word()))
        {
            let message = format!(
                "no job with record_episodes = \"none\" records the metric \"{UPPER_QUARTILE_RETURN}\""
            );
            let help = "set `record_quartiles = \"both\"` in [evaluation]";
            faults.add(Fault::at(analysis.span, message).help(help));
        }
        if let Some(range) = &analysis.participants
            && kept.contains(&Value::Choice(RecordedEpisodes::None.word()))
        {
            let message =
                "`participants` needs episodes, and `record_episodes` of [evaluation] is \"none\"";
            faults.add(Fault::at(range.span, message).help("remove record_episodes"));
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
        if !analysis.analysis.kind.rules().shows_inference_error() {
            return;
        }
        let odds = manifest.sections[SectionName::Environment]
            .get(CONTEXT_PROBABILITY.key())
            .unwrap_or_default();
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
}

/// Whether the population varies the parameter between participants in any job.
fn differ_in(manifest: &Manifest, parameter: &str) -> bool {
    let values =
        |key| manifest.sections[SectionName::Population].get(key).unwrap_or_default().iter();
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
