//! The parts of the page: cards, tables, provenance.

use std::collections::BTreeMap;

use crate::report::data_table::{Cell, DataTable};
use crate::report::document::{ArmTables, ReportedExperiment, Shown};
use crate::report::escape::markup;
use crate::report::latex::is_printed;
use crate::report::scene::inline_svg;

/// Rows of a table that a page holds; all of them are in the CSV file.
const MOST_ROWS: usize = 400;

/// A finding: title, figures, what is seen, data.
pub fn figure_card(shown: &Shown<'_>) -> String {
    let figures: String = shown
        .scenes
        .iter()
        .map(|(stem, scene)| {
            let drawing = inline_svg(scene);
            let files = ["svg", "png"].map(|extension| {
                let name = extension.to_uppercase();
                format!("<a href=\"figures/{stem}.{extension}\">{name}</a>")
            });
            format!(
                "<figure>{drawing}<figcaption class=\"links\">{}</figcaption></figure>",
                files.join(" ")
            )
        })
        .collect();
    // A table of comparisons of which a side has no seed.
    let nothing = match shown.lacks_figure {
        true => {
            "<p class=\"note\">No figure: there is no comparison with completed jobs on \
             both sides.</p>"
        }
        false => "",
    };
    let size = match (shown.scenes.len(), shown.table.rows.len()) {
        (1, _) if shown.table.shown_columns().count() <= 10 => "card",
        _ => "card wide",
    };
    // Tables that are tables in papers are seen at once.
    let open = if shown.is_table { " open" } else { "" };
    let rows = shown.table.rows.len();
    format!(
        "<article class=\"{size}\" id=\"{stem}\"><h3>{title}</h3>{switches}\
         <div class=\"figures\">{figures}{nothing}</div><p class=\"seen\">{caption}</p>\
         <p class=\"links\">{links} <a href=\"sql/{stem}.sql\">SQL</a></p>\
         <details{open}><summary>Numbers ({rows} rows)</summary>{table}</details>\
         <details><summary>SQL that reads this data</summary><pre>{sql}</pre></details></article>",
        stem = shown.stem,
        title = markup(&shown.finding.title),
        switches = switches(&shown.series),
        caption = sentences(&shown.caption),
        links = table_links(&format!("tables/{}", shown.stem), &shown.table),
        table = html_table(&shown.table),
        sql = markup(shown.sql)
    )
}

/// Letters of the longest word with a hyphen that is kept on one line; scenarios have seven.
const KEPT_WHOLE: usize = 9;

/// Sentences whose lines break neither within a scenario, such as `P-H-D`, nor before a `%`.
fn sentences(text: &str) -> String {
    let word = |word: &str| match word.contains('-') && word.chars().count() <= KEPT_WHOLE {
        true => format!("<span class=\"whole\">{}</span>", markup(word)),
        false => markup(word),
    };
    let words: Vec<String> = text.split(' ').map(word).collect();
    words.join(" ").replace(" %", "&nbsp;%")
}

/// What every agent and every arm of an experiment came to.
pub fn arm_tables(tables: &ArmTables) -> String {
    let block = |(stem, table): &(String, DataTable), open: &str| {
        let caption = markup(&table.caption);
        format!(
            "<details{open}><summary>{caption} ({} rows)</summary>{}<p class=\"links\">{}</p></details>",
            table.rows.len(),
            html_table(table),
            table_links(&format!("tables/{stem}"), table)
        )
    };
    let (agents, arms) = (block(&tables.agents, " open"), block(&tables.arms, ""));
    format!(
        "<article class=\"card arms\" id=\"{}\"><h3>All arms</h3>{agents}{arms}</article>",
        tables.arms.0
    )
}

/// Boxes that show and hide series; there is nothing to choose of one.
fn switches(series: &[String]) -> String {
    if series.len() < 2 {
        return String::new();
    }
    let boxes: String = series
        .iter()
        .enumerate()
        .map(|(at, label)| {
            let label = markup(label);
            format!("<label><input type=\"checkbox\" checked data-toggle=\"{at}\">{label}</label>")
        })
        .collect();
    format!("<div class=\"switches\">{boxes}</div>")
}

/// Links to a table's files.
pub fn table_links(stem: &str, table: &DataTable) -> String {
    let mut files = vec![("csv", "CSV"), ("md", "Markdown")];
    if is_printed(table) {
        files.push(("tex", "LaTeX"));
    }
    let link =
        |(extension, name): (&str, &str)| format!("<a href=\"{stem}.{extension}\">{name}</a>");
    files.into_iter().map(link).collect::<Vec<_>>().join(" ")
}

/// A table that a reader can sort.
pub fn html_table(table: &DataTable) -> String {
    let places: Vec<usize> = table.shown_columns().collect();
    let numeric: Vec<&str> = places
        .iter()
        .map(|place| if table.is_numeric(*place) { " class=\"number\"" } else { "" })
        .collect();
    let headings = places.iter().zip(&numeric).map(|(place, class)| {
        let heading = markup(&table.columns[*place].heading);
        format!("<th scope=\"col\"{class} aria-sort=\"none\"><button type=\"button\">{heading}</button></th>")
    });
    let headings: String = headings.collect();
    let row = |row: &Vec<Cell>| {
        let cells = places.iter().zip(&numeric).map(|(place, class)| {
            let cell = &row[*place];
            let more = match cell {
                Cell::Number { value, .. } => format!(" data-value=\"{value}\""),
                Cell::Missing(reason) => format!(" title=\"{}\"", markup(reason)),
                Cell::Text(_) => String::new(),
            };
            format!("<td{class}{more}>{}</td>", markup(cell.shown()))
        });
        format!("<tr>{}</tr>", cells.collect::<String>())
    };
    // A long table is thinned evenly within what its words name; the ends of each are seen.
    let same_words = |one: &Vec<Cell>, next: &Vec<Cell>| {
        one.iter().zip(next).all(|cells| match cells {
            (Cell::Text(one), Cell::Text(next)) => one == next,
            (Cell::Text(_), _) | (_, Cell::Text(_)) => false,
            _ => true,
        })
    };
    let every = table.rows.len().div_ceil(MOST_ROWS).max(1);
    let named = table.rows.chunk_by(same_words);
    let thinned = named.flat_map(|rows| {
        let last = rows.len() - 1;
        let kept = move |(place, _): &(usize, _)| place % every == 0 || *place == last;
        rows.iter().enumerate().filter(kept).map(|(_, row)| row)
    });
    let rows: String = thinned.map(row).collect();
    let thinned = match every {
        1 => String::new(),
        every => format!(
            "<p class=\"note\">One row in {every}, and the last of each arm; all of them are in the \
             CSV file.</p>"
        ),
    };
    format!(
        "<div class=\"scroll\"><table><thead><tr>{headings}</tr></thead><tbody>{rows}</tbody></table>\
         </div>{thinned}"
    )
}

/// What made the page and the runs, and where they are.
pub fn provenance(experiments: &[&ReportedExperiment], store: &str) -> String {
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
            Cell::number(runs as f64, 0),
            Cell::text(version),
            Cell::text(revision),
            Cell::text(backend),
            Cell::text(processor),
            Cell::text(host),
            Cell::text(first),
            Cell::text(last),
            Cell::number(seconds, 0),
        ]);
    }
    format!(
        "<section id=\"provenance\"><h2>Provenance</h2><p>Made from <code>{}</code> by jitai {} \
         (<code>{}</code>), of runs that these versions made. A revision that ends in \
         <code>-dirty</code> was built with changes that are not in it.</p>{}</section>",
        markup(store),
        env!("CARGO_PKG_VERSION"),
        env!("JITAI_GIT_REVISION"),
        html_table(&table)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_break_neither_in_a_scenario_nor_before_a_percent_sign() {
        assert_eq!(
            sentences("dqn P-H-D, at 40 % error, <a>"),
            "dqn <span class=\"whole\">P-H-D,</span> at 40&nbsp;% error, &lt;a&gt;"
        );
        assert_eq!(sentences("a-name-that-is-long"), "a-name-that-is-long");
    }
}
