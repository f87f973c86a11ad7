//! The whole report: every file of it, by name.
//!
//! In: experiments with their jobs and what their analyses found. Out: files to write, which depend
//! on nothing else: two reports of one store are equal to the byte.

use super::arm_tables;
use super::data_table::DataTable;
use super::escape::file_stem;
use super::figure::Looks;
use super::kinds::{caption, drawn};
use super::latex::{is_printed, latex};
use super::page;
use super::scene::{Scene, png, svg};
use super::section::{ArmTables, ReportedExperiment, Section, Shown};
use super::tables;
use crate::analyse::declared::{Finding, Reproduction, summarise_agents};

/// A file of the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportFile {
    /// Its name below the report's folder, with `/` between folders; never leads out of it.
    pub name: String,
    /// What is in it.
    pub bytes: Vec<u8>,
}

/// Every file of the report of these experiments. `store` is what readers call the store.
pub fn report(experiments: &[ReportedExperiment], store: &str) -> Vec<ReportFile> {
    let looks = Looks::of(experiments.iter().flat_map(|experiment| {
        experiment.findings.iter().flat_map(|(finding, _)| drawn(&finding.content).arms())
    }));
    let mut stems: Vec<String> = Vec::new();
    let mut files = Vec::new();
    let mut sections = Vec::new();
    // The names of these do not depend on those of analyses.
    let mut named = |experiment: &ReportedExperiment, table: &str| {
        let stem = unused(&stems, &format!("{} {table}", experiment.name));
        stems.push(stem.clone());
        stem
    };
    let of_arms: Vec<[String; 2]> = experiments
        .iter()
        .map(|experiment| ["arms", "agents"].map(|table| named(experiment, table)))
        .collect();
    for (experiment, [arms, agents]) in experiments.iter().zip(of_arms) {
        let shown = experiment.findings.iter().map(|(finding, sql)| {
            let stem = unused(&stems, &format!("{} {}", experiment.name, finding.name));
            stems.push(stem.clone());
            shown(finding, sql, stem, &looks)
        });
        let shown: Vec<Shown<'_>> = shown.collect();
        shown.iter().for_each(|finding| write_finding(finding, &mut files));
        let tables = ArmTables {
            arms: (arms, arm_tables::arms(&experiment.arms, &experiment.unknown_optima)),
            agents: (agents, arm_tables::agents(&summarise_agents(&experiment.arms))),
        };
        for (stem, table) in [&tables.arms, &tables.agents] {
            write_table(&format!("tables/{stem}"), table, &mut files);
        }
        sections.push(Section { experiment, shown, tables });
    }
    let reproduction = merged(experiments);
    if !reproduction.comparisons.is_empty() {
        write_table("reproduction", &tables::reproduction(&reproduction), &mut files);
    }
    let page = page::index(&sections, &reproduction, store);
    files.push(ReportFile { name: "index.html".to_owned(), bytes: page.into_bytes() });
    files
}

/// The comparisons of all experiments, each published number once.
fn merged(experiments: &[ReportedExperiment]) -> Reproduction {
    let mut merged = Reproduction::default();
    for one in experiments.iter().filter_map(|experiment| experiment.reproduction.as_ref()) {
        for comparison in &one.comparisons {
            let is_same = |known: &crate::analyse::declared::Comparison| {
                (known.subject, &known.agent, &known.scenario, &known.settings)
                    == (
                        comparison.subject,
                        &comparison.agent,
                        &comparison.scenario,
                        &comparison.settings,
                    )
            };
            if !merged.comparisons.iter().any(is_same) {
                merged.comparisons.push(comparison.clone());
            }
        }
    }
    merged.comparisons.sort_by_key(|comparison| comparison.subject);
    merged
}

/// A file name that no other finding has.
fn unused(taken: &[String], name: &str) -> String {
    let stem = file_stem(name);
    let numbered = (2..).map(|number| format!("{stem}-{number}"));
    let mut candidates = std::iter::once(stem.clone()).chain(numbered);
    candidates.find(|candidate| !taken.contains(candidate)).unwrap_or(stem)
}

fn shown<'e>(finding: &'e Finding, sql: &'e str, stem: String, looks: &Looks) -> Shown<'e> {
    let kind = drawn(&finding.content);
    let mut scenes = kind.figures(&stem, finding.metric, looks);
    tell_apart(&mut scenes);
    Shown {
        caption: caption(finding),
        table: kind.table(&finding.title, finding.metric),
        series: kind.series(),
        is_table: kind.is_table(),
        lacks_figure: kind.has_figures() && scenes.is_empty(),
        finding,
        stem,
        scenes,
        sql,
    }
}

/// Numbers the stems that two panels of a finding share.
fn tell_apart(scenes: &mut [(String, Scene)]) {
    for at in 0..scenes.len() {
        let (before, rest) = scenes.split_at_mut(at);
        let taken: Vec<String> = before.iter().map(|(stem, _)| stem.clone()).collect();
        if taken.contains(&rest[0].0) {
            rest[0].0 = format!("{}-{}", rest[0].0, at + 1);
        }
    }
}

fn write_finding(shown: &Shown<'_>, files: &mut Vec<ReportFile>) {
    for (stem, scene) in &shown.scenes {
        let text = svg(scene);
        files.push(ReportFile { name: format!("figures/{stem}.svg"), bytes: text.into_bytes() });
        if let Some(bytes) = png(scene) {
            files.push(ReportFile { name: format!("figures/{stem}.png"), bytes });
        }
    }
    write_table(&format!("tables/{}", shown.stem), &shown.table, files);
    let name = format!("sql/{}.sql", shown.stem);
    files.push(ReportFile { name, bytes: shown.sql.as_bytes().to_vec() });
}

fn write_table(stem: &str, table: &DataTable, files: &mut Vec<ReportFile>) {
    let mut push = |extension: &str, text: String| {
        let name = format!("{stem}.{extension}");
        files.push(ReportFile { name, bytes: text.into_bytes() });
    };
    push("csv", table.csv());
    push("md", table.markdown());
    if is_printed(table) {
        push("tex", latex(table));
    }
}
