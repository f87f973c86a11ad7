//! A page without a store: sections with words, tables and figures that another module made.

use maud::{Markup, PreEscaped, html};

use super::data_table::DataTable;
use super::document::{ReportFigure, ReportFile, write_figure, write_table};
use super::figure::{
    AxisScale, COLORS, Chart, Line, Look, Marker, NumberFormat, PlottedPoint, Spread, Style,
    axes_of, draw,
};
use super::page::{parts::html_table, whole};
use super::scene::{Color, Facets, Scene, inline_svg, svg};

/// A page.
pub struct PlainPage {
    /// What made it.
    pub kicker: String,
    /// Its title.
    pub title: String,
    /// Its first sentence.
    pub lead: String,
    /// Its sections.
    pub sections: Vec<PlainSection>,
}

/// A section of a page.
#[derive(Default)]
pub struct PlainSection {
    /// Its heading.
    pub heading: String,
    /// What a reader must not overlook.
    pub warnings: Vec<String>,
    /// Its sentences.
    pub words: Vec<String>,
    /// Its figures.
    pub figures: Vec<PlainFigure>,
    /// Its tables, by the stems of their files.
    pub tables: Vec<(String, DataTable)>,
    /// A text as it is.
    pub listing: Option<String>,
}

/// A figure: one number with intervals beside another along an axis.
pub struct PlainFigure {
    /// The name of its file.
    pub stem: String,
    /// What it shows.
    pub caption: String,
    /// The titles of the axes.
    pub axes: [String; 2],
    /// Its lines.
    pub lines: Vec<PlainLine>,
}

/// Points of a figure that a line joins.
pub struct PlainLine {
    /// Its label.
    pub label: String,
    /// Its points.
    pub points: Vec<PlainPoint>,
    /// Whether it is what was observed.
    pub is_observed: bool,
}

/// A point of a line.
#[derive(Clone, Copy)]
pub struct PlainPoint {
    /// Along the axis.
    pub x: f64,
    /// Its number.
    pub y: f64,
    /// The interval of its number.
    pub interval: Option<(f64, f64)>,
}

/// The files of a page: `index.html`, and its figures and tables.
pub fn plain_page(page: &PlainPage) -> Vec<ReportFile> {
    let mut files = Vec::new();
    let mut bodies = Vec::new();
    for section in &page.sections {
        let scenes: Vec<(&PlainFigure, Vec<Scene>)> =
            section.figures.iter().map(|figure| (figure, scenes(figure))).collect();
        for (figure, scenes) in &scenes {
            scenes.iter().for_each(|scene| write_figure(&figure.stem, scene, &mut files));
        }
        for (stem, table) in &section.tables {
            write_table(&format!("tables/{stem}"), table, &mut files);
        }
        bodies.push(body(section, &scenes));
    }
    let markup = html! {
        header {
            p.kicker { (page.kicker) }
            h1 { (page.title) }
            p.lead { (page.lead) }
        }
        main { @for body in &bodies { (body) } }
    };
    let bytes = whole(&page.title, &markup).into_bytes();
    files.insert(0, ReportFile { name: "index.html".to_owned(), bytes });
    files
}

/// The figures of a page.
pub fn plain_figures(page: &PlainPage) -> Vec<ReportFigure> {
    let figure = |one: &PlainFigure| {
        let figure = |scene: &Scene| ReportFigure {
            experiment: page.title.clone(),
            analysis: "fit".to_owned(),
            name: one.stem.clone(),
            svg: svg(scene),
            caption: one.caption.clone(),
        };
        scenes(one).iter().map(figure).collect::<Vec<ReportFigure>>()
    };
    page.sections.iter().flat_map(|section| &section.figures).flat_map(figure).collect()
}

fn body(section: &PlainSection, scenes: &[(&PlainFigure, Vec<Scene>)]) -> Markup {
    html! {
        section {
            h2 { (section.heading) }
            @for warning in &section.warnings { p.warning { (warning) } }
            @for words in &section.words { p { (words) } }
            @if let Some(listing) = &section.listing { pre { (listing) } }
            @for (figure, scenes) in scenes {
                article.card {
                    div.figures {
                        @for scene in scenes {
                            figure { (PreEscaped(inline_svg(scene, &|_| String::new()))) }
                        }
                    }
                    p.seen { (figure.caption) }
                }
            }
            @for (stem, table) in &section.tables {
                article.card.wide id=(stem) {
                    h3 { (table.caption) }
                    (html_table(table))
                }
            }
        }
    }
}

fn scenes(figure: &PlainFigure) -> Vec<Scene> {
    let line = |line: &PlainLine| {
        let color = if line.is_observed { COLORS[1] } else { Color(120, 120, 120) };
        let marker = if line.is_observed { Marker::Disc } else { Marker::Ring };
        let point = |PlainPoint { x, y, interval }: &PlainPoint| PlottedPoint {
            x: *x,
            y: *y,
            interval: *interval,
            ..PlottedPoint::default()
        };
        let has_interval = line.points.iter().any(|point| point.interval.is_some());
        Line {
            label: line.label.clone(),
            look: Look { color, dash: None, marker },
            points: line.points.iter().filter(|point| point.y.is_finite()).map(point).collect(),
            reference: Vec::new(),
            spread: if has_interval { Spread::Bars } else { Spread::Points },
            facets: Facets::new(),
        }
    };
    let chart = Chart {
        heading: None,
        description: figure.caption.clone(),
        lines: figure.lines.iter().map(line).collect(),
        note: String::new(),
    };
    let charts = [chart];
    let [x, y] = figure.axes.clone();
    let style = Style::of(&crate::manifest::FigureKeys::default());
    let axes = axes_of(
        &charts,
        (x, NumberFormat::Plain, AxisScale::Linear),
        (y, NumberFormat::Plain),
        &style,
    );
    draw(&charts, &axes, &style)
}
