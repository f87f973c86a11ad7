//! A manifest written out in full: no preset, every default, every sweep a list.

use std::fmt::{self, Write};

use crate::env::Family;
use crate::job::Condition;
use crate::key::{Key, Parameter, SectionName, Value};
use crate::manifest::analysis::declared::Analysis;
use crate::manifest::analysis::participants;
use crate::manifest::declared::{DeclaredAgent, Manifest};
use crate::manifest::estimate;
use crate::manifest::estimate::declared::DeclaredEstimate;
use crate::manifest::read::FORMAT;
use crate::manifest::table::Fields;
use crate::manifest::text::written::{self, list, quoted};
use crate::manifest::value::free::FAMILY;

impl Manifest {
    /// Complete TOML that declares the same jobs, independent of presets and defaults.
    pub fn resolved(&self) -> String {
        let mut out = String::new();
        self.write(&mut out).expect("writing to a string cannot fail");
        out
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        writeln!(out, "format = {FORMAT}")?;
        writeln!(out, "name = {}", quoted(&self.name))?;
        let prose = [
            ("question", &self.question),
            ("hypothesis", &self.hypothesis),
            ("published", &self.published),
        ];
        for (key, text) in prose {
            text.iter().try_for_each(|text| writeln!(out, "{key} = {}", quoted(text)))?;
        }
        let limit = self.time_limit_seconds;
        limit.iter().try_for_each(|seconds| writeln!(out, "time_limit_seconds = {seconds}"))?;
        writeln!(out, "scenarios = {}", list(&self.scenarios))?;
        let is_count = self.seeds().eq(1..=self.seeds.len() as u64);
        match is_count {
            _ if self.search.is_some() => {}
            true => writeln!(out, "seeds = {}", self.seeds.len())?,
            false => writeln!(out, "seeds = {}", list(&self.seeds))?,
        }
        let zip = |zip: &super::Zip| list(&zip.parameters.iter().map(quoted).collect::<Vec<_>>());
        let zips: Vec<String> = self.zips.iter().map(zip).collect();
        if !zips.is_empty() {
            writeln!(out, "zip = {}", list(&zips))?;
        }
        for section in SectionName::ALL {
            match section {
                SectionName::Agent => {
                    self.agents.iter().try_for_each(|agent| write_agent(out, agent))?;
                }
                shared => self.write_section(out, shared)?,
            }
        }
        if let Some(search) = &self.search {
            writeln!(out, "\n[search]")?;
            write_table(out, Fields::written(search))?;
        }
        for exclusion in &self.exclusions {
            writeln!(out, "\n[[exclude]]")?;
            exclusion
                .conditions
                .iter()
                .try_for_each(|condition| write_condition(out, condition))?;
        }
        self.estimates.iter().try_for_each(|estimate| write_estimate(out, estimate))?;
        self.analyses.iter().try_for_each(|analysis| write_analysis(out, analysis))
    }

    fn write_section(&self, out: &mut String, name: SectionName) -> fmt::Result {
        let parameters = &self.sections[name];
        let is_given = |(key, values): (&Key, &[Value])| {
            key.default().as_ref().is_none_or(|it| values != [it.clone()])
        };
        let is_written = match name {
            // The list is long, and participants rarely differ.
            SectionName::Population => parameters.iter().any(is_given),
            _ => parameters.section().is_declared(),
        };
        if !is_written {
            return Ok(());
        }
        // A recorded trial is written as the environment that it is read as.
        writeln!(out, "\n[{}]", name.word())?;
        if name == SectionName::Environment && self.family() != Family::first() {
            writeln!(out, "{FAMILY} = \"{}\"", self.family().name)?;
        }
        parameters.iter().try_for_each(|(key, values)| write_key(out, key, values))
    }
}

impl DeclaredAgent {
    /// A table `[[agent]]` for other manifests, with one value of every key: the result of `value`, or the
    /// first declared value. Swept keys have the comment `chosen`.
    pub fn chosen(&self, value: impl Fn(Parameter) -> Option<Value>) -> String {
        let mut out = String::new();
        write_head(&mut out, self).expect("writing to a string cannot fail");
        for (key, values) in self.parameters.iter() {
            let value = value(self.parameters.section().parameter(key.name));
            let value = value.unwrap_or_else(|| values[0].clone());
            // A declared value has the text of a file, which the value of a stored job lacks.
            let value = values.iter().find(|declared| **declared == value).unwrap_or(&value);
            let comment = if values.len() > 1 { "  # chosen" } else { "" };
            out += &format!("{} = {}{comment}\n", key.name, text_of(value));
        }
        out
    }
}

fn write_head(out: &mut String, agent: &DeclaredAgent) -> fmt::Result {
    writeln!(out, "[[agent]]\nname = {}", quoted(&agent.name))?;
    writeln!(out, "algorithm = \"{}\"", agent.algorithm.name())?;
    let label = agent.label.as_ref();
    label.iter().try_for_each(|label| writeln!(out, "label = {}", quoted(label)))
}

/// A value as a manifest writes it, with the text of a file in place of its name.
fn text_of(value: &Value) -> String {
    match value {
        Value::Content(content) => content.text().map_or_else(|| value.to_string(), quoted),
        value => value.to_string(),
    }
}

/// An agent, with the draws of a search in place of the drawn values.
fn write_agent(out: &mut String, agent: &DeclaredAgent) -> fmt::Result {
    writeln!(out)?;
    write_head(out, agent)?;
    let section = agent.parameters.section();
    agent.parameters.iter().try_for_each(|(key, values)| {
        let parameter = section.parameter(key.name);
        match agent.draws.iter().find(|(drawn, _)| *drawn == parameter) {
            Some((_, draw)) => writeln!(out, "{} = {draw}", key.name),
            None => write_key(out, key, values),
        }
    })
}

fn write_key(out: &mut String, key: &Key, values: &[Value]) -> fmt::Result {
    match values {
        [value] => writeln!(out, "{} = {}", key.name, text_of(value)),
        values => {
            let values: Vec<String> = values.iter().map(text_of).collect();
            writeln!(out, "{} = {}", key.name, list(&values))
        }
    }
}

fn write_estimate(out: &mut String, estimate: &DeclaredEstimate) -> fmt::Result {
    writeln!(out, "\n[[estimate]]\nname = {}", quoted(&estimate.declaration.name))?;
    write_table(out, estimate::keys::written(estimate))
}

/// The keys of a table with their values.
fn write_table(out: &mut String, written: Vec<(&str, String)>) -> fmt::Result {
    written.into_iter().try_for_each(|(key, value)| writeln!(out, "{key} = {value}"))
}

fn write_analysis(out: &mut String, analysis: &Analysis) -> fmt::Result {
    let (name, word) = (quoted(&analysis.name), analysis.kind.word());
    writeln!(out, "\n[[analysis]]\nname = {name}\nkind = \"{word}\"")?;
    analysis.title.iter().try_for_each(|title| writeln!(out, "title = {}", quoted(title)))?;
    if analysis.kind.declaration().key_names().contains(&"metric") {
        writeln!(out, "metric = \"{}\"", analysis.metric)?;
    }
    let range = analysis.participants.as_ref();
    range
        .iter()
        .try_for_each(|range| writeln!(out, "participants = {}", participants::written(range)))?;
    write_table(out, [analysis.kind.written(), Fields::written(&analysis.figure)].concat())?;
    // Written last, because keys below its header belong to it.
    if !analysis.conditions.is_empty() {
        writeln!(out, "[analysis.where]")?;
    }
    analysis.conditions.iter().try_for_each(|condition| write_condition(out, condition))
}

fn write_condition(out: &mut String, condition: &Condition) -> fmt::Result {
    writeln!(out, "{}", written::condition(condition))
}

#[cfg(test)]
mod tests {
    use crate::manifest::parse;

    #[test]
    fn a_label_and_the_keys_of_a_figure_read_back_as_written() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P\"]\nseeds = 1\nenvironment.sigma = [0.4, 0.6]\n\
                    [[agent]]\nname = \"a\"\nlabel = \"An agent\"\nalgorithm = \"reinforce\"\n\
                    [[analysis]]\nname = \"c\"\nkind = \"curve\"\nx = \"sigma\"\npanel = \"sigma\"\nwidth = 85\n\
                    height = 60.5\nfont_size = 8\ny_min = -1\ny_max = 9e3\ntheme = \"print\"\n";
        let manifest = parse("t", text.as_bytes()).unwrap();
        let again = parse("t", manifest.resolved().as_bytes()).unwrap();
        assert_eq!(again.agents[0].label.as_deref(), Some("An agent"));
        assert_eq!(again.analyses, manifest.analyses);
        assert_eq!(manifest.analyses[0].figure.height, Some(60.5));
        let same = text.replace(
            "[[analysis]]",
            "[[agent]]\nname = \"An agent\"\nalgorithm = \"reinforce\"\n[[analysis]]",
        );
        assert!(parse("t", same.as_bytes()).is_err(), "two agents with one label");
    }

    #[test]
    fn prose_of_any_kind_reads_back_as_written() {
        let text = "format = 1\nname = '<b>\"é\\'\nquestion = \"\"\"two\nlines\t\\u007f \\\\ \"\"\"\n\
                    hypothesis = \"\"\nextends = \"paper\"\nscenarios = [\"C\"]\nseeds = [5, 1]\n\
                    environment.sigma = 1e-7\nenvironment.mu = [[0, 1], [-1e5, 2]]";
        let written = parse("written", text.as_bytes()).unwrap();
        let resolved = parse("resolved", written.resolved().as_bytes()).unwrap();
        assert_eq!(resolved.name, "<b>\"é\\");
        assert_eq!(resolved.question.as_deref(), Some("two\nlines\t\u{7f} \\ "));
        assert_eq!(resolved.hypothesis.as_deref(), Some(""));
        assert!(resolved.seeds().eq([5, 1]));
        assert_eq!(resolved.sections, written.sections);
        assert_eq!(resolved.agents, written.agents);
    }
}
