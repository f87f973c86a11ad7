//! The page: one HTML file that is readable without network, server or script.
//!
//! Figures are inline SVG, tables are HTML tables. The script only adds sorting, tooltips and hiding.

pub mod parts;

use maud::{DOCTYPE, Markup, PreEscaped, Render, html};
use parts::{figure_card, html_table, provenance};

pub use parts::Hosts;

use super::scene::web_font;
use super::section::{ReportSection, ReportedExperiment, all_jobs};
use super::tables;
use crate::analyse::declared::{JobCounts, Reproduction};
use crate::job::counted;

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// The content security policy: the page loads only its own content and images beside it.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                      font-src data:; img-src 'self' data:; base-uri 'none'; form-action 'none'";

/// The page of these experiments.
pub fn index(
    sections: &[ReportSection<'_>],
    reproduction: &Reproduction,
    store: &str,
    hosts: Hosts,
) -> String {
    let experiments: Vec<&ReportedExperiment> =
        sections.iter().map(|section| section.experiment).collect();
    let names: Vec<&str> = experiments.iter().map(|one| one.name.as_str()).collect();
    let title = names.join(", ");
    let body = html! {
        (header(&experiments, &title, reproduction, store))
        (contents(sections, reproduction))
        main {
            (reproduced(reproduction))
            @for one in sections { (section(one)) }
            (failures(&experiments))
            (provenance(&experiments, store, hosts))
        }
    };
    whole(&title, &body)
}

/// A page with this title and body.
pub fn whole(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(web_font(&body.0))) (PreEscaped(STYLE)) }
            }
            body {
                (body)
                div #tip role="tooltip" hidden {}
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

/// Anchors of the page that belong to no experiment.
pub(super) const ANCHORS: [&str; 4] = ["tip", "reproduction", "failures", "provenance"];

fn header(
    experiments: &[&ReportedExperiment],
    title: &str,
    reproduction: &Reproduction,
    store: &str,
) -> Markup {
    let jobs = all_jobs(experiments);
    let state = match jobs {
        JobCounts { completed: 1, failed: 0, open: 0 } => "The job is completed".to_owned(),
        JobCounts { completed, failed: 0, open: 0 } => format!("All {completed} jobs completed"),
        JobCounts { completed, failed, open } => format!(
            "{completed} of {} completed, {failed} failed, {open} unfinished",
            counted(jobs.total(), "job")
        ),
    };
    let subjects = reproduction.subjects();
    let (inside, outside) = subjects.iter().fold((0, 0), |(inside, outside), subject| {
        let (more_in, more_out, _) = reproduction.counts(subject);
        (inside + more_in, outside + more_out)
    });
    let number = experiments.len();
    html! {
        header {
            p.kicker { "jitai report" }
            h1 { (title) }
            p.lead {
                (state) " in " code { (store) }
                ". Every mean is over seeds, with one policy each, and never over episodes."
            }
            p.note {
                "Links to CSV, Markdown, LaTeX, SVG, PDF and PNG files point into the folder of this page; \
                 share the whole folder to keep them. Everything else is in this file."
            }
            @if jobs.completed != jobs.total() {
                p.warning { "This report is partial: " (state) "." }
            }
            div.tiles {
                (tile(number, if number == 1 { "experiment" } else { "experiments" }))
                (tile(jobs.completed, if jobs.completed == 1 { "completed job" } else { "completed jobs" }))
                @if inside + outside > 0 {
                    (tile(
                        format_args!("{inside} / {}", inside + outside),
                        "published numbers within the joint 95 % interval",
                    ))
                }
            }
        }
    }
}

fn tile(number: impl Render, words: &str) -> Markup {
    html! { div.tile { b { (number) } span { (words) } } }
}

fn contents(sections: &[ReportSection<'_>], reproduction: &Reproduction) -> Markup {
    html! {
        nav aria-label="Contents" {
            details {
                summary { "Contents" }
                ul {
                    @if !reproduction.comparisons.is_empty() {
                        li { a href="#reproduction" { "Reproduction" } }
                    }
                    @for ReportSection { experiment, anchor, shown, race, .. } in sections {
                        li {
                            a href={ "#" (anchor) } { (experiment.name) }
                            ul {
                                @if let Some(race) = race {
                                    li { a href={ "#" (race.stem) } { "The race" } }
                                }
                                @for one in shown {
                                    li { a href={ "#" (one.stem) } { (one.finding.title) } }
                                }
                            }
                        }
                    }
                    li { a href="#failures" { "Failed jobs" } }
                    li { a href="#provenance" { "Provenance" } }
                }
            }
        }
    }
}

fn reproduced(reproduction: &Reproduction) -> Markup {
    let sentences = super::reproduction::reproduction(reproduction);
    if sentences.is_empty() {
        return html! {};
    }
    let numbers = tables::reproduction(reproduction);
    html! {
        section #reproduction {
            h2 { "Reproduction" }
            p.lead { (sentences.join(" ")) }
            p {
                "The uncertainty of a published number follows from its standard deviation, from its p \
                 value, or, for a rate, from the number of draws. A number that is published without \
                 uncertainty gets that of our runs with the published number of seeds, plus the error of \
                 reading it off a figure. By chance, 5 % of true \
                 agreements fall outside the interval. An interval that includes 0 does not show that two \
                 numbers agree: the table has beside each the margin within which they are equivalent by \
                 two one-sided tests at 5 %."
            }
            p.links { (parts::table_links("reproduction", &numbers)) }
            details {
                summary { "All " (reproduction.comparisons.len()) " numbers" }
                (html_table(&numbers))
            }
        }
    }
}

fn section(section: &ReportSection<'_>) -> Markup {
    let ReportSection { experiment, anchor, shown, race, tables, legend } = section;
    let prose = [("Question", &experiment.question), ("Hypothesis", &experiment.hypothesis)];
    let counts = JobCounts::of(&experiment.jobs);
    html! {
        section id=(anchor) {
            h2 { (experiment.name) }
            dl.prose {
                @for (heading, text) in prose {
                    @if let Some(text) = text { div { dt { (heading) } dd { (text) } } }
                }
            }
            p.state {
                (counts.completed) " of " (counts.total()) " jobs completed, "
                (counts.failed) " failed, " (counts.open) " unfinished."
            }
            @if let Some(said) = experiment.failed_estimates() { p.state { (said) "." } }
            @for said in &experiment.mixed_programs { p.state { (said) "." } }
            @if shown.is_empty() && race.is_none() {
                p {
                    "There are no figures, because the manifest declares no " code { "[[analysis]]" }
                    ". The tables below have the results of every arm and agent."
                }
            }
            @if let Some(race) = race { (parts::race_card(race)) }
            (parts::switches(legend))
            div.cards { @for one in shown { (figure_card(one, legend)) } }
            (parts::arm_tables(tables))
            details.manifest { summary { "Manifest" } pre { (experiment.manifest) } }
        }
    }
}

fn failures(experiments: &[&ReportedExperiment]) -> Markup {
    let jobs = experiments.iter().map(|experiment| (&experiment.name[..], &experiment.jobs[..]));
    let table = tables::failures(jobs);
    html! {
        section #failures {
            h2 { "Failed jobs" }
            @if table.rows.is_empty() {
                p { "No job failed." }
            } @else {
                (html_table(&table))
            }
        }
    }
}
