//! The whole report: all files by name.
//!
//! In: experiments with their jobs and findings. Out: files to write. The files depend only on the
//! input, so two reports of one store are byte-identical.

use std::path::Path;
use std::{fs, io};

use super::arm_tables;
use super::data_table::DataTable;
use super::escape::{unused, unused_stem};
use super::figure::{Looks, Style};
use super::kinds::{Sheet, caption, drawn, table};
use super::latex::{is_printed, latex};
use super::legend::Legend;
use super::names::Names;
use super::page::{self, Hosts};
use super::race::ReportedRace;
use super::scene::{Scene, pdf, png, svg};
use super::section::{ArmTables, ReportSection, ReportedExperiment, ShownFinding, ShownRace};
use super::tables;
use crate::analyse::declared::{Comparison, Finding, Reproduction, summarise_agents};

/// A file of the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportFile {
    /// Its path inside the report's folder, with `/` between folders.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl ReportFile {
    /// Writes the file into a folder, whole or not at all.
    ///
    /// **Errors**: the system refuses.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        write_whole(&folder.join(&self.name), &self.bytes)
    }
}

/// Writes a file under a temporary name, and renames it once it is complete. Makes its folder.
///
/// **Errors**: the system refuses.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent)?;
    }
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    fs::write(&partial, bytes)
        .and_then(|()| fs::rename(&partial, path))
        .inspect_err(|_| _ = fs::remove_file(&partial))
}

/// All files of the report of these experiments. `store` is the displayed name of the store.
pub fn report(experiments: &[ReportedExperiment], store: &str, hosts: Hosts) -> Vec<ReportFile> {
    let mut files = Vec::new();
    let sections = sections(experiments);
    for section in &sections {
        section.shown.iter().for_each(|one| write_finding(one, &mut files));
        for (stem, table) in [&section.tables.arms, &section.tables.agents] {
            write_table(&format!("tables/{stem}"), table, &mut files);
        }
        section.race.iter().for_each(|race| write_race(race, &mut files));
    }
    let reproduction = merged(experiments);
    if !reproduction.comparisons.is_empty() {
        let table = tables::reproduction(&reproduction);
        write_table("reproduction", &table, &mut files);
    }
    let page = page::index(&sections, &reproduction, store, hosts);
    files.push(ReportFile { name: "index.html".to_owned(), bytes: page.into_bytes() });
    files
}

/// A figure of the report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportFigure {
    /// The experiment.
    pub experiment: String,
    /// The analysis; `race` for the race of a search.
    pub analysis: String,
    /// The name of its file in the report, without extension.
    pub name: String,
    /// The image as SVG.
    pub svg: String,
    /// What it shows.
    pub caption: String,
}

/// The figures of the report of these experiments, in the order of the page.
pub fn figures(experiments: &[ReportedExperiment]) -> Vec<ReportFigure> {
    let of_section = |section: &ReportSection<'_>| {
        let figure = |(analysis, caption): (&String, &String), name: &String, scene| ReportFigure {
            experiment: section.experiment.name.clone(),
            analysis: analysis.clone(),
            name: name.clone(),
            svg: svg(scene),
            caption: caption.clone(),
        };
        let mut figures = Vec::new();
        if let Some(one) = &section.race {
            let of = (&"race".to_owned(), &one.race.caption);
            figures.extend(one.scenes.iter().map(|(name, scene)| figure(of, name, scene)));
        }
        for one in &section.shown {
            let of = (&one.finding.name, &one.caption);
            figures.extend(one.scenes.iter().map(|(name, scene)| figure(of, name, scene)));
        }
        figures
    };
    sections(experiments).iter().flat_map(of_section).collect()
}

/// The experiments in displayed form.
fn sections(experiments: &[ReportedExperiment]) -> Vec<ReportSection<'_>> {
    let find_names =
        |one: &ReportedExperiment| Names::of(&one.jobs, &one.styles, &one.labels, &one.files);
    let names: Vec<Names> = experiments.iter().map(find_names).collect();
    let arms = experiments.iter().zip(&names).flat_map(|(experiment, names)| {
        let findings = experiment.findings.iter();
        findings.flat_map(|(finding, _)| names.arms(drawn(&finding.content).arms()))
    });
    let looks = Looks::of(&arms.collect::<Vec<_>>());
    let stems = Stems::of(experiments);
    let mut figures = stems.taken.clone();
    let mut sections = Vec::new();
    for ((experiment, names), named) in experiments.iter().zip(&names).zip(stems.named) {
        let mut shown = Vec::new();
        for (at, stem) in named.findings.into_iter().enumerate() {
            let finding = &experiment.findings[at].0;
            let style = Style::of(&experiment.styles[at]);
            let sheet =
                Sheet { stem: &stem, metric: finding.metric, names, looks: &looks, style: &style };
            let (scenes, wholes) = figures_of(finding, &sheet, &mut figures);
            shown.push(self::shown((experiment, at), names, (stem, scenes, wholes)));
        }
        let summaries = summarise_agents(&experiment.arms);
        let arms = arm_tables::arms(
            &experiment.arms,
            names,
            &experiment.unknown_optima,
            &experiment.words,
        );
        let agents = arm_tables::agents(&summaries, names, &experiment.words);
        let tables = ArmTables { arms: (named.arms, arms), agents: (named.agents, agents) };
        let legend = Legend::of(shown.iter().flat_map(|one| &one.scenes), &looks);
        let race = experiment.race.as_ref().zip(named.race);
        let race = race.map(|(race, stem)| shown_race(race, stem, &mut figures));
        let anchor = named.anchor;
        sections.push(ReportSection { experiment, anchor, shown, race, tables, legend });
    }
    sections
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
    race: Option<String>,
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
            let findings = findings.collect();
            // An experiment without a search has no such files, and its analyses keep their names.
            let race = experiment.race.as_ref().map(|_| take(format!("{} race", experiment.name)));
            Named { anchor, arms, agents, race, findings }
        });
        let named = named.collect();
        Stems { named, taken }
    }
}

/// The comparisons of all experiments, with each published number once.
fn merged(experiments: &[ReportedExperiment]) -> Reproduction {
    let mut merged = Reproduction::default();
    fn cell(one: &Comparison) -> impl PartialEq {
        let Comparison {
            subject, competitor, metric, agent, scenario, settings, published, ..
        } = one;
        (subject, competitor, metric, agent, scenario, settings, published)
    }
    for one in experiments.iter().filter_map(|experiment| experiment.reproduction.as_ref()) {
        for comparison in &one.comparisons {
            let is_same = |known: &Comparison| cell(known) == cell(comparison);
            if !merged.comparisons.iter().any(is_same) {
                merged.comparisons.push(comparison.clone());
            }
        }
    }
    let subjects: Vec<String> = merged.subjects().into_iter().map(str::to_owned).collect();
    let index = |one: &Comparison| subjects.iter().position(|subject| *subject == one.subject);
    merged.comparisons.sort_by_key(index);
    merged
}

/// Maximum number of panels of a figure; more make several figures.
const MOST_PANELS: usize = 12;

/// A finding of an experiment in displayed form.
fn shown<'e>(
    (experiment, at): (&'e ReportedExperiment, usize),
    names: &Names,
    (stem, scenes, wholes): (String, Scenes, Scenes),
) -> ShownFinding<'e> {
    let (finding, sql) = &experiment.findings[at];
    let kind = drawn(&finding.content);
    ShownFinding {
        caption: caption(finding, names),
        table: table(finding, names),
        is_table: kind.is_table(),
        lacks_figure: kind.has_figures() && scenes.is_empty(),
        finding,
        stem,
        scenes,
        wholes,
        sql,
    }
}

/// The races of an experiment in displayed form. `taken` holds the stems of all figures, to which it adds its own.
fn shown_race<'e>(race: &'e ReportedRace, stem: String, taken: &mut Vec<String>) -> ShownRace<'e> {
    let figure = |(agent, scene): &'e (String, Scene)| {
        let name = unused_stem(taken, &format!("{stem} {agent}"));
        taken.push(name.clone());
        (name, scene)
    };
    ShownRace { race, scenes: race.figures.iter().map(figure).collect(), stem }
}

/// Figures with the stems of their files.
type Scenes = Vec<(String, Scene)>;

/// The figures of a finding, and those that its panels make together. `taken` holds the stems of all figures,
/// to which it adds its own.
fn figures_of(finding: &Finding, sheet: &Sheet<'_>, taken: &mut Vec<String>) -> (Scenes, Scenes) {
    let (kind, stem) = (drawn(&finding.content), sheet.stem);
    // A figure without panels has the stem of its finding.
    let mut is_own_free = true;
    let mut name = |wanted: &str| {
        if wanted == stem && std::mem::take(&mut is_own_free) {
            return stem.to_owned();
        }
        let stem = unused(taken, wanted);
        taken.push(stem.clone());
        stem
    };
    let panels = kind.figures(sheet);
    let all = kind.wholes(sheet, panels.len());
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
    let scenes: Scenes =
        panels.into_iter().map(|(wanted, scene)| (name(&wanted), sheet.style.set(scene))).collect();
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
    (scenes, wholes)
}

/// Adds the files of a finding.
fn write_finding(shown: &ShownFinding<'_>, files: &mut Vec<ReportFile>) {
    for (stem, scene) in shown.scenes.iter().chain(&shown.wholes) {
        write_figure(stem, scene, files);
    }
    write_table(&format!("tables/{}", shown.stem), &shown.table, files);
    let name = format!("sql/{}.sql", shown.stem);
    files.push(ReportFile { name, bytes: shown.sql.as_bytes().to_vec() });
}

/// Adds the files of a figure.
pub fn write_figure(stem: &str, scene: &Scene, files: &mut Vec<ReportFile>) {
    let mut push = |extension: &str, bytes: Vec<u8>| {
        files.push(ReportFile { name: format!("figures/{stem}.{extension}"), bytes });
    };
    push("svg", svg(scene).into_bytes());
    push("pdf", pdf(scene));
    if let Some(bytes) = png(scene) {
        push("png", bytes);
    }
}

/// Adds the files of an experiment's races.
fn write_race(ShownRace { race, stem, scenes }: &ShownRace<'_>, files: &mut Vec<ReportFile>) {
    scenes.iter().for_each(|(stem, scene)| write_figure(stem, scene, files));
    write_table(&format!("tables/{stem}"), &race.table, files);
    if let Some(winners) = &race.winners {
        let name = format!("tables/{stem}.toml");
        files.push(ReportFile { name, bytes: winners.as_bytes().to_vec() });
    }
}

/// Adds a table for readers, and its data as CSV.
pub fn write_table(stem: &str, table: &DataTable, files: &mut Vec<ReportFile>) {
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
