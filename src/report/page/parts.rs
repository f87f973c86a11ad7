//! The parts of the page: cards, tables, provenance.

use std::collections::BTreeMap;

use maud::{Markup, PreEscaped, html};

use crate::report::data_table::{DataTable, Entry};
use crate::report::latex::is_printed;
use crate::report::scene::inline_svg;
use crate::report::section::{ArmTables, ReportedExperiment, Shown};

/// Rows of a table that a page holds; all of them are in the CSV file.
const MOST_ROWS: usize = 400;

/// A finding: title, figures, what is seen, data.
pub fn figure_card(shown: &Shown<'_>) -> Markup {
    let size = match shown.scenes.len() {
        1 if shown.table.shown_columns().count() <= 10 => "card",
        _ => "card wide",
    };
    html! {
        article class=(size) id=(shown.stem) {
            h3 { (shown.finding.title) }
            (switches(&shown.series))
            div.figures {
                @for (stem, scene) in &shown.scenes {
                    figure {
                        (PreEscaped(inline_svg(scene)))
                        figcaption.links {
                            (links(&format!("figures/{stem}"), &[("svg", "SVG"), ("png", "PNG")]))
                        }
                    }
                }
                @if shown.lacks_figure {
                    p.note {
                        "No figure: there is no comparison with completed jobs on both sides."
                    }
                }
            }
            p.seen { (sentences(&shown.caption)) }
            p.links {
                (table_links(&format!("tables/{}", shown.stem), &shown.table)) " "
                (links(&format!("sql/{}", shown.stem), &[("sql", "SQL")]))
            }
            details open[shown.is_table] {
                summary { "Numbers (" (shown.table.rows.len()) " rows)" }
                (html_table(&shown.table))
            }
            details { summary { "SQL that reads this data" } pre { (shown.sql) } }
        }
    }
}

/// Letters of the longest word with a hyphen that is kept on one line; scenarios have seven.
const KEPT_WHOLE: usize = 9;

/// Sentences whose lines break neither within a scenario, such as `P-H-D`, nor before a `%`.
fn sentences(text: &str) -> Markup {
    let is_whole = |word: &str| word.contains('-') && word.chars().count() <= KEPT_WHOLE;
    html! {
        @for (place, word) in text.replace(" %", "\u{a0}%").split(' ').enumerate() {
            @if place > 0 { " " }
            @if is_whole(word) { span.whole { (word) } } @else { (word) }
        }
    }
}

/// What every agent and every arm of an experiment came to.
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

/// Boxes that show and hide series; there is nothing to choose of one.
fn switches(series: &[String]) -> Markup {
    html! {
        @if series.len() > 1 {
            div.switches {
                @for (place, label) in series.iter().enumerate() {
                    label { input type="checkbox" checked data-toggle=(place); (label) }
                }
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
        @for (place, (extension, name)) in files.iter().enumerate() {
            @if place > 0 { " " }
            a href={ (stem) "." (extension) } { (name) }
        }
    }
}

/// A table that a reader can sort.
pub fn html_table(table: &DataTable) -> Markup {
    let columns: Vec<(usize, Option<&str>)> = table
        .shown_columns()
        .map(|place| (place, table.is_numeric(place).then_some("number")))
        .collect();
    let every = table.rows.len().div_ceil(MOST_ROWS).max(1);
    html! {
        div.scroll {
            table {
                thead {
                    tr {
                        @for (place, class) in &columns {
                            th scope="col" class=[class] aria-sort="none" {
                                button type="button" { (table.columns[*place].heading) }
                            }
                        }
                    }
                }
                tbody {
                    @for row in thinned(&table.rows, every) {
                        tr { @for (place, class) in &columns { (html_entry(&row[*place], *class)) } }
                    }
                }
            }
        }
        @if every > 1 {
            p.note {
                "One row in " (every) ", and the last of each arm; all of them are in the CSV file."
            }
        }
    }
}

fn html_entry(entry: &Entry, class: Option<&str>) -> Markup {
    let (value, reason) = match entry {
        Entry::Number { value, .. } => (Some(*value), None),
        Entry::Missing(reason) => (None, Some(reason)),
        Entry::Text(_) => (None, None),
    };
    html! { td class=[class] data-value=[value] title=[reason] { (entry.shown()) } }
}

/// One row in `every`, spread evenly over each run of rows with the same words, and the last of
/// each run.
fn thinned(rows: &[Vec<Entry>], every: usize) -> impl Iterator<Item = &Vec<Entry>> {
    let same_words = |one: &Vec<Entry>, next: &Vec<Entry>| {
        one.iter().zip(next).all(|entries| match entries {
            (Entry::Text(one), Entry::Text(next)) => one == next,
            (Entry::Text(_), Entry::Number { .. } | Entry::Missing(_))
            | (Entry::Number { .. } | Entry::Missing(_), Entry::Text(_)) => false,
            (
                Entry::Number { .. } | Entry::Missing(_),
                Entry::Number { .. } | Entry::Missing(_),
            ) => true,
        })
    };
    rows.chunk_by(same_words).flat_map(move |rows| {
        let last = rows.len() - 1;
        let kept = move |(place, _): &(usize, _)| place % every == 0 || *place == last;
        rows.iter().enumerate().filter(kept).map(|(_, row)| row)
    })
}

/// What made the page and the runs, and where they are.
pub fn provenance(experiments: &[&ReportedExperiment], store: &str) -> Markup {
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
            &made.host,
        ];
        let ended = run.ended_at.as_str();
        let entry = makers.entry(key).or_insert((0, ended, ended, 0.0));
        entry.0 += 1;
        entry.1 = entry.1.min(ended);
        entry.2 = entry.2.max(ended);
        entry.3 += run.wall_seconds;
    }
    let columns = [
        ("runs", "Runs"),
        ("code_version", "jitai"),
        ("git_revision", "Git revision"),
        ("backend", "Tensor backend of the build"),
        ("processor", "Processor"),
        ("host", "Host"),
        ("first", "First ended"),
        ("last", "Last ended"),
        ("seconds", "Seconds of work"),
    ];
    let mut table = DataTable::new("Provenance", &columns);
    for ([version, revision, backend, processor, host], (runs, first, last, seconds)) in makers {
        table.rows.push(vec![
            Entry::number(runs as f64, 0),
            Entry::text(version),
            Entry::text(revision),
            Entry::text(backend),
            Entry::text(processor),
            Entry::text(host),
            Entry::text(first),
            Entry::text(last),
            Entry::number(seconds, 0),
        ]);
    }
    html! {
        section #provenance {
            h2 { "Provenance" }
            p {
                "Made from " code { (store) } " by jitai " (env!("CARGO_PKG_VERSION")) " ("
                code { (env!("JITAI_GIT_REVISION")) } "), of runs that these versions made. \
                 A revision that ends in " code { "-dirty" }
                " was built with changes that are not in it."
            }
            (html_table(&table))
        }
    }
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
