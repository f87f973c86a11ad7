//! The page: one HTML file that needs no network, no server and no script to be read.
//!
//! Figures stand in it as SVG, tables as tables; the script only adds sorting, pointing and hiding.

mod parts;

use parts::{figure_card, html_table, provenance};

use super::document::{ReportedExperiment, Section, all_jobs};
use super::escape::{file_stem, markup};
use super::scene::web_font;
use super::tables;
use crate::analyse::declared::{JobCounts, Reproduction, Subject};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// The page of these experiments.
pub(super) fn index(sections: &[Section<'_>], reproduction: &Reproduction, store: &str) -> String {
    let experiments: Vec<&ReportedExperiment> =
        sections.iter().map(|section| section.experiment).collect();
    let names: Vec<String> = experiments.iter().map(|one| markup(&one.name)).collect();
    let title = names.join(", ");
    let mut body = header(&experiments, &title, reproduction, store);
    body += &contents(sections, reproduction);
    body += "<main>";
    body += &reproduced(reproduction);
    body += &sections.iter().map(section).collect::<String>();
    body += &failures(&experiments);
    body += &provenance(&experiments, store);
    body += "</main><div id=\"tip\" role=\"tooltip\" hidden></div>";
    let policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                  font-src data:; img-src 'self' data:; base-uri 'none'; form-action 'none'";
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <link rel=\"icon\" href=\"data:,\"><title>{title}</title>\
         <style>{}{STYLE}</style></head>\n<body>{body}\n<script>{SCRIPT}</script></body></html>\n",
        web_font()
    )
}

/// A heading's place in links.
fn anchor(experiment: &ReportedExperiment) -> String {
    format!("experiment-{}", file_stem(&experiment.name))
}

fn header(
    experiments: &[&ReportedExperiment],
    title: &str,
    reproduction: &Reproduction,
    store: &str,
) -> String {
    let jobs = all_jobs(experiments);
    let state = match jobs {
        JobCounts { completed, failed: 0, open: 0 } => format!("All {completed} jobs completed"),
        JobCounts { completed, failed, open } => format!(
            "{completed} of {} jobs completed, {failed} failed, {open} not ended",
            jobs.total()
        ),
    };
    let mut tiles = vec![
        tile(
            &experiments.len().to_string(),
            if experiments.len() == 1 { "experiment" } else { "experiments" },
        ),
        tile(&jobs.completed.to_string(), "trained policies"),
    ];
    let (inside, outside) =
        [Subject::Effect, Subject::CurvePoint, Subject::HeatCell, Subject::ErrorRate].iter().fold(
            (0, 0),
            |(inside, outside), subject| {
                let (more_in, more_out, _) = reproduction.counts(*subject);
                (inside + more_in, outside + more_out)
            },
        );
    if inside + outside > 0 {
        let share = format!("{inside} / {}", inside + outside);
        tiles.push(tile(&share, "published numbers within the joint 95 % interval"));
    }
    let warning = match jobs.completed == jobs.total() {
        true => String::new(),
        false => format!("<p class=\"warning\">This report is partial: {state}.</p>"),
    };
    format!(
        "<header><p class=\"kicker\">jitai report</p><h1>{title}</h1>\
         <p class=\"lead\">{state} in <code>{}</code>. Every mean is over trained policies (seeds), \
         never over test episodes.</p>{warning}<div class=\"tiles\">{}</div></header>",
        markup(store),
        tiles.concat()
    )
}

fn tile(number: &str, words: &str) -> String {
    format!("<div class=\"tile\"><b>{number}</b><span>{words}</span></div>")
}

fn contents(sections: &[Section<'_>], reproduction: &Reproduction) -> String {
    let mut items = String::new();
    if !reproduction.comparisons.is_empty() {
        items += "<li><a href=\"#reproduction\">Reproduction</a></li>";
    }
    for Section { experiment, shown, .. } in sections {
        let entries: String = shown
            .iter()
            .map(|one| {
                let title = markup(&one.finding.title);
                format!("<li><a href=\"#{}\">{title}</a></li>", one.stem)
            })
            .collect();
        let (anchor, name) = (anchor(experiment), markup(&experiment.name));
        items += &format!("<li><a href=\"#{anchor}\">{name}</a><ul>{entries}</ul></li>");
    }
    items += "<li><a href=\"#failures\">Failed jobs</a></li>\
              <li><a href=\"#provenance\">Provenance</a></li>";
    format!(
        "<nav aria-label=\"Contents\"><details><summary>Contents</summary><ul>{items}</ul></details></nav>"
    )
}

fn reproduced(reproduction: &Reproduction) -> String {
    let sentences = super::reproduction::reproduction(reproduction);
    if sentences.is_empty() {
        return String::new();
    }
    let numbers = tables::reproduction(reproduction);
    let table = html_table(&numbers);
    format!(
        "<section id=\"reproduction\"><h2>Reproduction</h2><p class=\"lead\">{}</p>\
         <p>Uncertainty of the published numbers: of effects, what their printed p values imply for \
         two groups of three; of curve points and heat-map cells, which are printed without any, as \
         much as ours would have with three seeds, and ± 15 steps of reading for points; of error \
         rates, that of 1000 draws. 5 in 100 true agreements fall outside by chance.</p>\
         <p class=\"links\">{}</p>\
         <details><summary>All {} numbers</summary>{table}</details></section>",
        markup(&sentences.join(" ")),
        parts::table_links("reproduction", &numbers),
        reproduction.comparisons.len()
    )
}

fn section(section: &Section<'_>) -> String {
    let Section { experiment, shown, tables } = section;
    let prose = [("Question", &experiment.question), ("Hypothesis", &experiment.hypothesis)];
    let prose: String = prose
        .iter()
        .filter_map(|(heading, text)| {
            let text = markup(text.as_deref()?);
            Some(format!("<div><dt>{heading}</dt><dd>{text}</dd></div>"))
        })
        .collect();
    let counts = JobCounts::of(&experiment.jobs);
    let mut body = format!(
        "<section id=\"{}\"><h2>{}</h2><dl class=\"prose\">{prose}</dl>\
         <p class=\"state\">{} of {} jobs completed, {} failed, {} not ended.</p>",
        anchor(experiment),
        markup(&experiment.name),
        counts.completed,
        counts.total(),
        counts.failed,
        counts.open
    );
    if shown.is_empty() {
        body += "<p>The manifest declares no <code>[[analysis]]</code>.</p>";
    }
    body += "<div class=\"cards\">";
    body += &shown.iter().map(figure_card).collect::<String>();
    body += &format!(
        "</div>{}<details class=\"manifest\"><summary>Manifest</summary><pre>{}</pre></details></section>",
        parts::arm_tables(tables),
        markup(&experiment.manifest)
    );
    body
}

fn failures(experiments: &[&ReportedExperiment]) -> String {
    let jobs = experiments.iter().map(|experiment| (&experiment.name[..], &experiment.jobs[..]));
    let table = tables::failures(jobs);
    let body = match table.rows.len() {
        0 => "<p>None. Failed jobs would be listed here with their reasons.</p>".to_owned(),
        _ => html_table(&table),
    };
    format!("<section id=\"failures\"><h2>Failed jobs</h2>{body}</section>")
}
