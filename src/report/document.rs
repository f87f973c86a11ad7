//! The whole report: all files by name.
//!
//! In: experiments with their jobs and findings. Out: files to write. The files depend only on the
//! input, so two reports of one store are byte-identical.

use std::collections::HashSet;

use super::arm_tables;
use super::data_table::DataTable;
use super::escape::unused_stem;
use super::figure::{Looks, Style};
use super::kinds::{Sheet, caption, drawn, table};
use super::latex::{is_printed, latex};
use super::legend::Legend;
use super::names::Names;
use super::page::{self, Hosts};
use super::scene::{Scene, pdf, png, svg};
use super::section::{ArmTables, ReportedExperiment, Section, Shown};
use super::tables;
use crate::analyse::declared::{Finding, Reproduction, summarise_agents};

/// A file of the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportFile {
    /// Its path inside the report's folder, with `/` between folders.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// All files of the report of these experiments. `store` is the displayed name of the store.
pub fn report(experiments: &[ReportedExperiment], store: &str, hosts: Hosts) -> Vec<ReportFile> {
    // CSV files use the names of keys; everything else uses displayed names.
    let names: Vec<Names> = experiments.iter().map(Names::of).collect();
    let displayed = experiments.iter().zip(&names).map(|(experiment, names)| {
        let findings = experiment.findings.iter();
        findings.map(|(finding, _)| names.finding(finding)).collect()
    });
    let displayed: Vec<Vec<Finding>> = displayed.collect();
    let looks =
        Looks::of(displayed.iter().flatten().flat_map(|finding| drawn(&finding.content).arms()));
    let mut stems: Vec<String> = Vec::new();
    let mut files = Vec::new();
    let mut sections = Vec::new();
    // Tables of arms are named first, so that their names do not depend on the names of analyses.
    let mut named = |experiment: &ReportedExperiment, table: &str| {
        let stem = unused_stem(&stems, &format!("{} {table}", experiment.name));
        stems.push(stem.clone());
        stem
    };
    let of_arms: Vec<[String; 2]> = experiments
        .iter()
        .map(|experiment| ["arms", "agents"].map(|table| named(experiment, table)))
        .collect();
    let all = experiments.iter().zip(&names).zip(&displayed).zip(of_arms);
    for (((experiment, names), displayed), [arms, agents]) in all {
        let analyses = experiment.findings.iter().zip(&experiment.winners);
        let analyses = analyses.zip(displayed).zip(&experiment.styles);
        let shown = analyses.map(|((((finding, sql), winners), displayed), keys)| {
            let stem = unused_stem(&stems, &format!("{} {}", experiment.name, finding.name));
            stems.push(stem.clone());
            let shown = Shown {
                winners: winners.as_deref(),
                ..shown(displayed, sql, stem, (&looks, &Style::of(keys)))
            };
            let data = table(finding);
            write_finding(&shown, &data, &mut files);
            shown
        });
        let shown: Vec<Shown<'_>> = shown.collect();
        let unknown = &experiment.unknown_optima;
        let summaries = summarise_agents(&experiment.arms);
        let tables = ArmTables {
            arms: (arms, arm_tables::arms(&names.arms(&experiment.arms), unknown)),
            agents: (agents, arm_tables::agents(&names.agents(&summaries))),
        };
        let data = [arm_tables::arms(&experiment.arms, unknown), arm_tables::agents(&summaries)];
        for ((stem, table), data) in [&tables.arms, &tables.agents].into_iter().zip(data) {
            write_table(&format!("tables/{stem}"), (table, &data), &mut files);
        }
        let legend = Legend::of(shown.iter().flat_map(|one| &one.scenes), &looks);
        sections.push(Section { experiment, shown, tables, legend });
    }
    let reproduction = merged(experiments);
    if !reproduction.comparisons.is_empty() {
        let table = tables::reproduction(&reproduction);
        write_table("reproduction", (&table, &table), &mut files);
    }
    let page = page::index(&sections, &reproduction, store, hosts);
    files.push(ReportFile { name: "index.html".to_owned(), bytes: page.into_bytes() });
    files
}

/// The comparisons of all experiments, with each published number once.
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

fn shown<'e>(
    finding: &'e Finding,
    sql: &'e str,
    stem: String,
    (looks, style): (&Looks, &Style),
) -> Shown<'e> {
    let kind = drawn(&finding.content);
    let sheet = Sheet { stem: &stem, metric: finding.metric, looks, style };
    let figures = kind.figures(&sheet).into_iter();
    let mut scenes: Vec<(String, Scene)> =
        figures.map(|(stem, scene)| (stem, style.set(scene))).collect();
    tell_apart(&mut scenes);
    let is_whole = scenes.iter().any(|(panel, _)| *panel == stem);
    let whole = (scenes.len() > 1 && kind.has_panels() && !is_whole).then(|| {
        let panels: Vec<&Scene> = scenes.iter().map(|(_, scene)| scene).collect();
        Scene::in_rows(&panels, panels[0].description.clone())
    });
    Shown {
        caption: caption(finding),
        table: table(finding),
        is_table: kind.is_table(),
        lacks_figure: kind.has_figures() && scenes.is_empty(),
        finding,
        stem,
        scenes,
        whole,
        sql,
        winners: None,
    }
}

/// Appends a number to stems that several panels of a finding share.
fn tell_apart(scenes: &mut [(String, Scene)]) {
    let mut taken = HashSet::new();
    for (number, (stem, _)) in (1..).zip(scenes) {
        if taken.contains(stem) {
            *stem = format!("{stem}-{number}");
        }
        taken.insert(stem.clone());
    }
}

/// Adds the files of a finding; `data` is its table with the names of keys.
fn write_finding(shown: &Shown<'_>, data: &DataTable, files: &mut Vec<ReportFile>) {
    let panels = shown.scenes.iter().map(|(stem, scene)| (stem, scene));
    for (stem, scene) in panels.chain(shown.whole.iter().map(|whole| (&shown.stem, whole))) {
        let mut push = |extension: &str, bytes: Vec<u8>| {
            files.push(ReportFile { name: format!("figures/{stem}.{extension}"), bytes });
        };
        push("svg", svg(scene).into_bytes());
        push("pdf", pdf(scene));
        if let Some(bytes) = png(scene) {
            push("png", bytes);
        }
    }
    write_table(&format!("tables/{}", shown.stem), (&shown.table, data), files);
    let name = format!("sql/{}.sql", shown.stem);
    files.push(ReportFile { name, bytes: shown.sql.as_bytes().to_vec() });
    if let Some(winners) = shown.winners {
        let name = format!("tables/{}.toml", shown.stem);
        files.push(ReportFile { name, bytes: winners.as_bytes().to_vec() });
    }
}

/// Adds a table for readers, and its data as CSV.
fn write_table(stem: &str, (table, data): (&DataTable, &DataTable), files: &mut Vec<ReportFile>) {
    let mut push = |extension: &str, text: String| {
        let name = format!("{stem}.{extension}");
        files.push(ReportFile { name, bytes: text.into_bytes() });
    };
    push("csv", data.csv());
    push("md", table.markdown());
    if is_printed(table) {
        push("tex", latex(table));
    }
}
