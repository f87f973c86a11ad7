//! A manifest written out in full: no preset, every default, every sweep a list.

use std::fmt::{self, Write};

use super::analysis::Analysis;
use super::condition::Condition;
use super::declared::Manifest;
use super::parameter::Parameters;
use super::read::FORMAT;
use super::written::{list, quoted};

impl Manifest {
    /// Complete TOML that declares the same jobs, whatever becomes of presets and defaults.
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
        let scenarios: Vec<String> = self.scenarios.iter().map(quoted).collect();
        writeln!(out, "scenarios = {}", list(&scenarios))?;
        let is_count = self.seeds.iter().copied().eq(1..=self.seeds.len() as u64);
        match is_count {
            true => writeln!(out, "seeds = {}", self.seeds.len())?,
            false => writeln!(out, "seeds = {}", list(&self.seeds))?,
        }
        let zip = |zip: &super::Zip| list(&zip.parameters.iter().map(quoted).collect::<Vec<_>>());
        let zips: Vec<String> = self.zips.iter().map(zip).collect();
        if !zips.is_empty() {
            writeln!(out, "zip = {}", list(&zips))?;
        }
        writeln!(out, "\n[environment]")?;
        write_parameters(out, &self.environment)?;
        for agent in &self.agents {
            writeln!(out, "\n[[agent]]\nname = {}", quoted(&agent.name))?;
            writeln!(out, "algorithm = \"{}\"", agent.algorithm.name())?;
            write_parameters(out, &agent.parameters)?;
        }
        writeln!(out, "\n[evaluation]")?;
        write_parameters(out, &self.evaluation)?;
        for exclusion in &self.exclusions {
            writeln!(out, "\n[[exclude]]")?;
            exclusion
                .conditions
                .iter()
                .try_for_each(|condition| write_condition(out, condition))?;
        }
        self.analyses.iter().try_for_each(|analysis| write_analysis(out, analysis))
    }
}

fn write_parameters(out: &mut String, parameters: &Parameters) -> fmt::Result {
    parameters.iter().try_for_each(|(key, values)| match values {
        [value] => writeln!(out, "{} = {value}", key.name),
        values => writeln!(out, "{} = {}", key.name, list(values)),
    })
}

fn write_analysis(out: &mut String, analysis: &Analysis) -> fmt::Result {
    let kind = analysis.kind.name();
    let (name, word) = (quoted(&analysis.name), kind.word());
    writeln!(out, "\n[[analysis]]\nname = {name}\nkind = \"{word}\"")?;
    analysis.title.iter().try_for_each(|title| writeln!(out, "title = {}", quoted(title)))?;
    if kind.key_names().contains(&"metric") {
        writeln!(out, "metric = \"{}\"", analysis.metric)?;
    }
    for (key, value) in analysis.kind.written() {
        writeln!(out, "{key} = {value}")?;
    }
    // Last, because the keys below its header belong to it.
    if !analysis.conditions.is_empty() {
        writeln!(out, "[analysis.where]")?;
    }
    analysis.conditions.iter().try_for_each(|condition| write_condition(out, condition))
}

fn write_condition(out: &mut String, condition: &Condition) -> fmt::Result {
    match condition {
        Condition::Scenario(scenarios) => {
            let scenarios: Vec<String> = scenarios.iter().map(quoted).collect();
            writeln!(out, "scenario = {}", list(&scenarios))
        }
        Condition::Seed(seeds) => writeln!(out, "seed = {}", list(seeds)),
        Condition::AgentName(names) => {
            let names: Vec<String> = names.iter().map(quoted).collect();
            writeln!(out, "agent.name = {}", list(&names))
        }
        Condition::Key { parameter, values } => writeln!(out, "{parameter} = {}", list(values)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::parse;

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
        assert_eq!(resolved.seeds, [5, 1]);
        assert_eq!(resolved.environment, written.environment);
        assert_eq!(resolved.agents, written.agents);
    }
}
