//! The whole report: all files by name.
//!
//! In: experiments with their jobs and findings. Out: files to write. The files depend only on the
//! input, so two reports of one store are byte-identical.

use super::arm_tables;
use super::data_table::DataTable;
use super::escape::{unused, unused_stem};
use super::figure::{Looks, Style};
use super::kinds::{Sheet, caption, displayed, drawn, table};
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
        findings.map(|(finding, _)| displayed(finding, names)).collect()
    });
    let displayed: Vec<Vec<Finding>> = displayed.collect();
    let looks =
        Looks::of(displayed.iter().flatten().flat_map(|finding| drawn(&finding.content).arms()));
    let stems = Stems::of(experiments);
    let mut figures = stems.taken.clone();
    let mut files = Vec::new();
    let mut sections = Vec::new();
    let all = experiments.iter().zip(&names).zip(&displayed).zip(stems.named);
    for (((experiment, names), displayed), named) in all {
        let analyses = experiment.findings.iter().zip(&experiment.winners);
        let analyses = analyses.zip(displayed).zip(&experiment.styles).zip(named.findings);
        let shown = analyses.map(|(((((finding, sql), winners), displayed), keys), stem)| {
            let shown = Shown {
                winners: winners.as_deref(),
                ..shown(displayed, sql, stem, (&looks, &Style::of(keys)), &mut figures)
            };
            let data = table(finding);
            write_finding(&shown, &data, &mut files);
            shown
        });
        let shown: Vec<Shown<'_>> = shown.collect();
        let unknown = &experiment.unknown_optima;
        let summaries = summarise_agents(&experiment.arms);
        let tables = ArmTables {
            arms: (named.arms, arm_tables::arms(&names.arms(&experiment.arms), unknown)),
            agents: (named.agents, arm_tables::agents(&names.agents(&summaries))),
        };
        let data = [arm_tables::arms(&experiment.arms, unknown), arm_tables::agents(&summaries)];
        for ((stem, table), data) in [&tables.arms, &tables.agents].into_iter().zip(data) {
            write_table(&format!("tables/{stem}"), (table, &data), &mut files);
        }
        let legend = Legend::of(shown.iter().flat_map(|one| &one.scenes), &looks);
        sections.push(Section { experiment, anchor: named.anchor, shown, tables, legend });
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

/// The stems of files and the anchors of the page. All of them are distinct, in lower case, so that no file
/// replaces another and every link leads to one place.
struct Stems {
    named: Vec<Named>,
    taken: Vec<String>,
}

/// The stems of an experiment.
struct Named {
    anchor: String,
    arms: String,
    agents: String,
    findings: Vec<String>,
}

impl Stems {
    /// Tables of arms and anchors are named first, so that their names do not depend on the names of analyses.
    fn of(experiments: &[ReportedExperiment]) -> Stems {
        let mut taken: Vec<String> = page::ANCHORS.map(str::to_owned).to_vec();
        let mut take = |name: String| {
            let stem = unused_stem(&taken, &name);
            taken.push(stem.clone());
            stem
        };
        let tables: Vec<[String; 3]> = experiments
            .iter()
            .map(|ReportedExperiment { name, .. }| {
                [format!("experiment {name}"), format!("{name} arms"), format!("{name} agents")]
            })
            .map(|names| names.map(&mut take))
            .collect();
        let named = experiments.iter().zip(tables).map(|(experiment, [anchor, arms, agents])| {
            let findings = experiment.findings.iter();
            let findings =
                findings.map(|(finding, _)| take(format!("{} {}", experiment.name, finding.name)));
            Named { anchor, arms, agents, findings: findings.collect() }
        });
        let named = named.collect();
        Stems { named, taken }
    }
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

/// Maximum number of panels of a figure; more make several figures.
const MOST_PANELS: usize = 12;

/// A finding in displayed form. `taken` holds the stems of all figures, to which it adds its own.
fn shown<'e>(
    finding: &'e Finding,
    sql: &'e str,
    stem: String,
    (looks, style): (&Looks, &Style),
    taken: &mut Vec<String>,
) -> Shown<'e> {
    let kind = drawn(&finding.content);
    let sheet = Sheet { stem: &stem, metric: finding.metric, looks, style };
    // A figure without panels has the stem of its finding.
    let mut is_own_free = true;
    let mut name = |wanted: &str| {
        if wanted == stem && std::mem::take(&mut is_own_free) {
            return stem.clone();
        }
        let stem = unused(taken, wanted);
        taken.push(stem.clone());
        stem
    };
    let panels = kind.figures(&sheet);
    let all = kind.wholes(&sheet, panels.len());
    // Figures of several panels are named first, so that their names do not depend on the panels.
    let mut groups: Vec<(String, usize)> = Vec::new();
    for (of_group, count) in all.into_iter().filter(|(_, count)| *count > 0) {
        let parts = count.div_ceil(MOST_PANELS);
        for part in 0..parts {
            let panels = MOST_PANELS.min(count - part * MOST_PANELS);
            let wanted = match part {
                0 => of_group.clone(),
                part => format!("{of_group}-part-{}", part + 1),
            };
            let is_drawn = count > 1;
            groups.push((if is_drawn { name(&wanted) } else { String::new() }, panels));
        }
    }
    let scenes: Vec<(String, Scene)> =
        panels.into_iter().map(|(wanted, scene)| (name(&wanted), style.set(scene))).collect();
    let mut rest = &scenes[..];
    let mut wholes = Vec::new();
    for (of_group, count) in groups {
        let (members, others) = rest.split_at(count);
        rest = others;
        if !of_group.is_empty() {
            let panels: Vec<&Scene> = members.iter().map(|(_, scene)| scene).collect();
            wholes.push((of_group, Scene::in_rows(&panels, panels[0].description.clone())));
        }
    }
    Shown {
        caption: caption(finding),
        table: table(finding),
        is_table: kind.is_table(),
        lacks_figure: kind.has_figures() && scenes.is_empty(),
        finding,
        stem,
        scenes,
        wholes,
        sql,
        winners: None,
    }
}

/// Adds the files of a finding; `data` is its table with the names of keys.
fn write_finding(shown: &Shown<'_>, data: &DataTable, files: &mut Vec<ReportFile>) {
    let panels = shown.scenes.iter().map(|(stem, scene)| (stem, scene));
    for (stem, scene) in panels.chain(shown.wholes.iter().map(|(stem, whole)| (stem, whole))) {
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
