//! The parts of the page: cards, tables, provenance.

use std::collections::BTreeMap;

use maud::{Markup, PreEscaped, html};

use crate::analyse::declared::FindingContent;
use crate::report::data_table::{DataTable, TableEntry};
use crate::report::latex::is_printed;
use crate::report::legend::{Legend, LegendValue};
use crate::report::scene::{Color, Level, inline_svg, runs};
use crate::report::section::{ArmTables, ReportedExperiment, ShownFinding, ShownRace};

/// Maximum number of rows of a table on the page; the CSV file has all rows.
const MOST_ROWS: usize = 400;

/// The files of a figure, by extension.
const IMAGES: [(&str, &str); 3] = [("svg", "SVG"), ("pdf", "PDF"), ("png", "PNG")];

/// A finding: title, figures, caption, data.
pub fn figure_card(shown: &ShownFinding<'_>, legend: &Legend) -> Markup {
    // The text of maps names their colours, so a dark theme must not change them.
    let is_map = matches!(shown.finding.content, FindingContent::HeatMap(_));
    let size = match shown.scenes.len() {
        1 if shown.table.shown_columns().count() <= 10 => "card",
        _ => "card wide",
    };
    html! {
        article class=(size) id=(shown.stem) {
            h3 { (shown.finding.title) }
            div.figures {
                @for (stem, scene) in &shown.scenes {
                    figure.map[is_map] {
                        (PreEscaped(inline_svg(scene, &|series| legend.classes(series))))
                        figcaption.links { (links(&format!("figures/{stem}"), &IMAGES)) }
                    }
                }
                @if shown.lacks_figure {
                    p.note {
                        @match shown.finding.content {
                            FindingContent::Days(_) => "No figure: nothing that it shows is recorded.",
                            _ => "No figure: no comparison has completed jobs on both sides.",
                        }
                    }
                }
            }
            p.seen { (sentences(&shown.caption)) }
            @for (stem, _) in &shown.wholes {
                p.links {
                    @if shown.wholes.len() == 1 { "All panels: " } @else { "Panels, " (stem) ": " }
                    (links(&format!("figures/{stem}"), &IMAGES))
                }
            }
            p.links {
                (table_links(&format!("tables/{}", shown.stem), &shown.table)) " "
                (links(&format!("sql/{}", shown.stem), &[("sql", "SQL")]))
            }
            details open[shown.is_table] {
                summary { "Numbers (" (shown.table.rows.len()) " rows)" }
                (html_table(&shown.table))
            }
            details { summary { "SQL query for this data" } pre { (shown.sql) } }
        }
    }
}

/// Maximum length of a hyphenated word that is not broken across lines; scenarios have seven letters.
const KEPT_WHOLE: usize = 9;

/// Text without line breaks inside a scenario, such as `P-H-D`, or before a `%`.
fn sentences(text: &str) -> Markup {
    let is_whole = |word: &str| word.contains('-') && word.chars().count() <= KEPT_WHOLE;
    html! {
        @for (index, word) in text.replace(" %", "\u{a0}%").split(' ').enumerate() {
            @if index > 0 { " " }
            @if is_whole(word) { span.whole { (word) } } @else { (symbols(word)) }
        }
    }
}

/// The tables of the agents and arms of an experiment.
pub fn arm_tables(tables: &ArmTables) -> Markup {
    html! {
        article.card.arms id=(tables.arms.0) {
            h3 { "All arms" }
            @for ((stem, table), is_open) in [(&tables.agents, true), (&tables.arms, false)] {
                details open[is_open] {
                    summary { (table.caption) " (" (table.rows.len()) " rows)" }
                    (html_table(table))
                    p.links { (table_links(&format!("tables/{stem}"), table)) }
                }
            }
        }
    }
}

/// The races of an experiment: their courses, where they stand, the winners, and when and why each arm left.
pub fn race_card(ShownRace { race, stem, scenes }: &ShownRace<'_>) -> Markup {
    html! {
        article.card.wide id=(stem) {
            h3 { "The race" }
            @for sentence in &race.sentences { p.seen { (sentences(sentence)) } }
            @if !scenes.is_empty() {
                div.figures {
                    @for (stem, scene) in scenes {
                        figure {
                            (PreEscaped(inline_svg(scene, &|_| String::new())))
                            figcaption.links { (links(&format!("figures/{stem}"), &IMAGES)) }
                        }
                    }
                }
                p.seen { (sentences(&race.caption)) }
            }
            p.links {
                (table_links(&format!("tables/{stem}"), &race.table))
                @if race.winners.is_some() {
                    " " (links(&format!("tables/{stem}"), &[("toml", "TOML")]))
                }
            }
            @if let Some(winners) = &race.winners {
                details open { summary { "Winners as TOML" } pre { (winners) } }
            }
            details open {
                summary { (race.table.caption) " (" (race.table.rows.len()) " arms)" }
                (html_table(&race.table))
            }
        }
    }
}

/// Checkboxes that show and hide arms in all figures of an experiment at once.
pub fn switches(legend: &Legend) -> Markup {
    let dot = |Color(red, green, blue): Color| format!("background:rgb({red} {green} {blue})");
    html! {
        @if !legend.facets.is_empty() {
            details.switches open {
                summary { "Show in all figures of this experiment" }
                @for (facet, (name, values)) in legend.facets.iter().enumerate() {
                    fieldset {
                        legend { (symbols(name)) }
                        @for (index, LegendValue { value, color }) in values.iter().enumerate() {
                            label {
                                input type="checkbox" checked data-toggle=(legend.class(facet, index));
                                @if let Some(color) = color { span.dot style=(dot(*color)) {} }
                                (symbols(value))
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A text with its subscripts as HTML.
pub fn symbols(text: &str) -> Markup {
    html! {
        @for run in runs(text) {
            @match run.level {
                Level::Base => (run.text),
                Level::Subscript => sub { (run.text) },
            }
        }
    }
}

/// Links to a table's files.
pub fn table_links(stem: &str, table: &DataTable) -> Markup {
    match is_printed(table) {
        true => links(stem, &[("csv", "CSV"), ("md", "Markdown"), ("tex", "LaTeX")]),
        false => links(stem, &[("csv", "CSV"), ("md", "Markdown")]),
    }
}

/// Links to files of one stem, by extension.
fn links(stem: &str, files: &[(&str, &str)]) -> Markup {
    html! {
        @for (index, (extension, name)) in files.iter().enumerate() {
            @if index > 0 { " " }
            a href={ (stem) "." (extension) } { (name) }
        }
    }
}

/// A table that a reader can sort.
pub fn html_table(table: &DataTable) -> Markup {
    let columns: Vec<(usize, Option<&str>)> = table
        .shown_columns()
        .map(|index| (index, table.is_numeric(index).then_some("number")))
        .collect();
    let every = table.rows.len().div_ceil(MOST_ROWS).max(1);
    html! {
        div.table {
          p.hint hidden { "Scroll sideways for more columns →" }
          div.scroll tabindex="0" {
            table {
                thead {
                    tr {
                        @for (index, class) in &columns {
                            th scope="col" class=[class] aria-sort="none" {
                                button type="button" { (symbols(&table.columns[*index].heading)) }
                            }
                        }
                    }
                }
                tbody {
                    @for row in thinned(&table.rows, every) {
                        tr { @for (index, class) in &columns { (html_entry(&row[*index], *class)) } }
                    }
                }
            }
          }
        }
        @if every > 1 {
            p.note {
                "Shows one row in " (every) ", and the last row of each arm; the CSV file has all rows."
            }
        }
    }
}

fn html_entry(entry: &TableEntry, class: Option<&str>) -> Markup {
    let (value, reason) = match entry {
        TableEntry::Number { value, .. } => (Some(*value), None),
        TableEntry::Missing(reason) => (None, Some(reason)),
        TableEntry::Text { .. } => (None, None),
    };
    html! { td class=[class] data-value=[value] title=[reason] { (symbols(entry.shown())) } }
}

/// One row in `every`, spread evenly over each run of rows with the same words, and the last of
/// each run.
fn thinned(rows: &[Vec<TableEntry>], every: usize) -> impl Iterator<Item = &Vec<TableEntry>> {
    let same_words = |one: &Vec<TableEntry>, next: &Vec<TableEntry>| {
        one.iter().zip(next).all(|entries| match entries {
            (TableEntry::Text { shown: one, .. }, TableEntry::Text { shown: next, .. }) => {
                one == next
            }
            (TableEntry::Text { .. }, TableEntry::Number { .. } | TableEntry::Missing(_))
            | (TableEntry::Number { .. } | TableEntry::Missing(_), TableEntry::Text { .. }) => {
                false
            }
            (
                TableEntry::Number { .. } | TableEntry::Missing(_),
                TableEntry::Number { .. } | TableEntry::Missing(_),
            ) => true,
        })
    };
    rows.chunk_by(same_words).flat_map(move |rows| {
        let last = rows.len() - 1;
        let kept = move |(index, _): &(usize, _)| index % every == 0 || *index == last;
        rows.iter().enumerate().filter(kept).map(|(_, row)| row)
    })
}

/// Whether a report names the machines that made its runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hosts {
    /// Runs of all machines with the same processor and version are counted together.
    #[default]
    Unnamed,
    /// The table of provenance has a column of host names.
    Named,
}

/// The provenance of the page and of its runs.
pub fn provenance(experiments: &[&ReportedExperiment], store: &str, hosts: Hosts) -> Markup {
    html! {
        section #provenance {
            h2 { "Provenance" }
            p {
                "Made from " code { (store) } " by jitai " (env!("CARGO_PKG_VERSION")) " ("
                code { (env!("JITAI_GIT_REVISION")) } "). The table lists the versions that made the \
                 runs. A revision ending in " code { "-dirty" }
                " was built with uncommitted changes."
            }
            (html_table(&makers(experiments, hosts)))
        }
    }
}

/// The versions and machines that made the runs, with the number of runs and their times.
fn makers(experiments: &[&ReportedExperiment], hosts: Hosts) -> DataTable {
    let mut makers: BTreeMap<[&str; 5], (usize, &str, &str, f64)> = BTreeMap::new();
    let mut seen = std::collections::HashSet::new();
    let jobs = experiments.iter().flat_map(|experiment| &experiment.jobs);
    for job in jobs.filter(|job| seen.insert(job.job_key)) {
        let Some(run) = job.completed() else { continue };
        let made = &run.provenance;
        let key = [
            made.code_version.as_str(),
            &made.git_revision,
            &made.backend,
            &made.processor,
            match hosts {
                Hosts::Named => &made.host,
                Hosts::Unnamed => "",
            },
        ];
        let ended = run.ended_at.as_str();
        let entry = makers.entry(key).or_insert((0, ended, ended, 0.0));
        entry.0 += 1;
        entry.1 = entry.1.min(ended);
        entry.2 = entry.2.max(ended);
        entry.3 += run.wall_seconds;
    }
    let mut columns = vec![
        ("runs", "Runs"),
        ("code_version", "jitai"),
        ("git_revision", "Git revision"),
        ("backend", "Tensor backend"),
        ("processor", "Processor"),
        ("first", "First run ended"),
        ("last", "Last run ended"),
        ("seconds", "Training time, s"),
    ];
    if hosts == Hosts::Named {
        columns.push(("host", "Host"));
    }
    let mut table = DataTable::new("Provenance", &columns);
    for ([version, revision, backend, processor, host], (runs, first, last, seconds)) in makers {
        let mut row = vec![
            TableEntry::number(runs as f64, 0),
            TableEntry::text(version),
            TableEntry::text(revision),
            TableEntry::text(backend),
            TableEntry::text(processor),
            TableEntry::text(first),
            TableEntry::text(last),
            TableEntry::number(seconds, 0),
        ];
        if hosts == Hosts::Named {
            row.push(TableEntry::text(host));
        }
        table.rows.push(row);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_break_neither_in_a_scenario_nor_before_a_percent_sign() {
        assert_eq!(
            sentences("dqn P-H-D, at 40 % error, <a>").into_string(),
            "dqn <span class=\"whole\">P-H-D,</span> at 40\u{a0}% error, &lt;a&gt;"
        );
        assert_eq!(sentences("a-name-that-is-long").into_string(), "a-name-that-is-long");
    }
}
