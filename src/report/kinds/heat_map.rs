//! Heat maps over two parameters: numbers on colours.

use crate::report::symbols;
use std::collections::BTreeMap;

use super::{Drawn, Sheet, amount, gap, gap_ends, is_rate, metric_words, parameter};
use crate::analyse::Interval;
use crate::analyse::declared::{ArmId, HeatFigure, HeatTile, PeakLead, Scale, heat_range};
use crate::job::Measure;
use crate::report::data_table::{DataTable, TableEntry, exponential, shown, shown_ends, signed};
use crate::report::escape::file_stem;
use crate::report::figure::{
    FAINT, INK, LINE, NOTE, Panels, Style, TEXT, facets, fitting, heading_lines, rising_title,
    seeds, text,
};
use crate::report::names::Names;
use crate::report::scene::{
    Anchor, Color, Fill, Mark, Scene, SceneShape, Stroke, Weight, rectangle, width,
};
use crate::report::tables::{between, high, in_unit as entry_in_unit, low};
use crate::report::words::unit_numbers;

impl Drawn for Vec<HeatFigure> {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let whole = heat_range(self);
        let scales = scales(self);
        let figure = |figure: &HeatFigure| {
            let range = scales.get(figure.agent.as_str()).copied().unwrap_or(whole);
            let range = (range, scales.is_empty());
            let panel = file_stem(&named(figure, sheet.names).join(" "));
            (format!("{}-{panel}", sheet.stem), heat_figure(figure, sheet, range))
        };
        // Every map is already a panel. A declared key only groups the maps that share its value.
        let arms = sheet.names.arms(self.iter().map(|map| &map.name));
        let names: Vec<&ArmId> = arms.iter().collect();
        let ordered = match sheet.style.panel {
            Some(_) => Panels::of(&names, sheet.style.panel, None).panels,
            None => return self.iter().map(figure).collect(),
        };
        ordered.iter().flat_map(|panel| &panel.members).map(|at| figure(&self[*at])).collect()
    }

    fn table(&self, title: &str, metric: Measure, names: &Names) -> DataTable {
        table(title, self, metric, names)
    }

    fn shows(&self, metric: Measure, _: &Names) -> String {
        let is_difference = self.first().is_some_and(|map| map.scale == Scale::Difference);
        let counts = self.iter().flat_map(|map| &map.tiles).map(|tile| tile.seeds);
        format!(
            "{} of {}{}, {} per tile",
            if is_difference { "Difference" } else { "Mean" },
            metric_words(metric),
            interval_words(if is_difference { Scale::Difference } else { Scale::Mean }, metric),
            seeds(counts.filter(|n| *n > 0))
        )
    }

    fn finds(&self, metric: Measure, names: &Names) -> Option<String> {
        let tiles = || {
            let all = self.iter().flat_map(|map| map.tiles.iter().map(move |tile| (map, tile)));
            all.filter_map(|(map, tile)| Some((map, tile, tile.value.ok()?)))
        };
        let (map, tile, most) = tiles().max_by(|one, other| one.2.total_cmp(&other.2))?;
        let least = tiles().map(|(_, _, value)| value).fold(most, f64::min);
        let amount = match map.scale {
            Scale::Mean => amount,
            Scale::Difference => gap,
        };
        let (all, least, most) = (tiles().count(), amount(least, metric), amount(most, metric));
        if least == most {
            return Some(match all {
                1 => format!("The only tile has {most}"),
                _ => format!("Every tile has {most}"),
            });
        }
        let tied = tiles().filter(|(_, _, value)| amount(*value, metric) == most).count();
        let [agent, subject] = named(map, names);
        let [x, y] = axes(map);
        let largest = match tied {
            1 => format!(
                "at {x} = {} and {y} = {} of {agent} {}",
                parameter(tile.x),
                parameter(tile.y),
                subject.replace(" - ", " − ")
            ),
            tied => format!("in {tied} of {all} tiles"),
        };
        let range = format!("Values range from {least} to {most}; the largest is {largest}");
        if map.scale == Scale::Mean {
            let lead = map.lead.as_ref().filter(|_| tied == 1).map(|lead| ahead(map, lead, metric));
            let clear = self.iter().filter(|map| map.lead.as_ref().is_some_and(PeakLead::is_clear));
            let maps = match self.len() {
                1 => String::new(),
                all => format!(
                    ". The largest mean is clearly ahead of every neighbour in {} of {all} maps",
                    clear.count()
                ),
            };
            return Some(match lead {
                Some(lead) => range + &lead + &maps,
                None => range,
            });
        }
        let which = match (tied, tile.interval) {
            (1, Ok(_)) if tile.is_beyond_zero() => ", and its interval excludes 0".to_owned(),
            (1, Ok(_)) => ", and its interval includes 0".to_owned(),
            (1, Err(reason)) => format!(", without an interval ({reason})"),
            _ => String::new(),
        };
        let beyond = beyond_zero(tiles().map(|(_, tile, _)| tile));
        Some(format!(
            "{range}{which}; {beyond} (t tests, paired by seed where both sides share their seeds, not \
             corrected)"
        ))
    }
}

/// How many intervals of tiles exclude 0.
fn beyond_zero<'t>(tiles: impl Iterator<Item = &'t HeatTile> + Clone) -> String {
    let tested = tiles.clone().filter(|tile| tile.interval.is_ok()).count();
    match tiles.filter(|tile| tile.is_beyond_zero()).count() {
        0 => format!("none of {tested} intervals excludes 0"),
        1 => format!("1 of {tested} intervals excludes 0"),
        beyond => format!("{beyond} of {tested} intervals exclude 0"),
    }
}

/// The names of both axes.
fn axes(map: &HeatFigure) -> [String; 2] {
    symbols::beside([&map.x.0, &map.y.0])
}

/// The title of an axis beside the other one.
fn axis_title(axis: &str, other: &str) -> String {
    match symbols::beside([axis, other]) {
        [name, _] if name == symbols::short(axis) => symbols::quantity(axis),
        [name, _] => name,
    }
}

/// The lead of the largest mean, as a clause.
fn ahead(map: &HeatFigure, lead: &PeakLead, metric: Measure) -> String {
    let PeakLead {
        tiles: [_, closest],
        difference,
        interval,
        is_paired,
        neighbours,
        tested,
        behind,
    } = lead;
    let tile = &map.tiles[*closest];
    let [x, y] = axes(map);
    let test = if *is_paired { "t interval paired by seed" } else { "t interval" };
    let interval = match interval {
        Ok(interval) => format!("{}, {test}", gap_ends(*interval, metric)),
        Err(reason) => format!("no interval: {reason}"),
    };
    format!(
        ". It is {} ({interval}) ahead of the closest of its {neighbours} neighbours, at {x} = {} and {y} = {}, and {behind} \
         of the {tested} intervals exclude 0; the same seeds chose the tile, which makes its lead too large on average",
        gap(*difference, metric),
        parameter(tile.x),
        parameter(tile.y),
    )
}

/// Space on the left beside the rows' values.
const LEFT: f64 = 26.0;
const TOP: f64 = 26.0;
const RIGHT: f64 = 8.0;
/// Space for numbers, title, and two lines of notes.
const BOTTOM: f64 = 60.0;
const TILE_HEIGHT: f64 = 44.0;
/// Colour of the edges of tiles and of the colour bar.
const EDGE: Color = Color(170, 170, 170);
/// The smallest letters of a number without an exponent, as a share of the usual size.
const LEAST_LETTERS: f64 = 0.65;
/// Height of three lines of numbers.
const LEAST_TILE: f64 = 36.0;

/// The agent and the subject of a map as they are displayed.
fn named(map: &HeatFigure, names: &Names) -> [String; 2] {
    [names.agent(&map.agent), names.subject(&map.subject, map.agent.is_empty())]
}

/// How tiles write their interval.
fn interval_words(scale: Scale, metric: Measure) -> &'static str {
    match is_rate(metric) && scale == Scale::Mean {
        true => " with its 95 % interval",
        false => " ± half of the 95 % interval",
    }
}

/// The colour ranges of the agents, if one range for all would hide the values of an agent; else empty.
fn scales(figures: &[HeatFigure]) -> BTreeMap<&str, (f64, f64)> {
    /// Colours do not distinguish values within a smaller part of the range.
    const LEAST: f64 = 0.25;
    let mut of_agents: BTreeMap<&str, Vec<HeatFigure>> = BTreeMap::new();
    for figure in figures {
        of_agents.entry(&figure.agent).or_default().push(figure.clone());
    }
    let ranges: BTreeMap<&str, (f64, f64)> =
        of_agents.into_iter().map(|(agent, figures)| (agent, heat_range(&figures))).collect();
    // Differences are coloured by their distance from 0, means by their position in the range.
    let is_difference = figures.first().is_some_and(|map| map.scale == Scale::Difference);
    let span = |(low, high): (f64, f64)| match is_difference {
        true => low.abs().max(high.abs()),
        false => high - low,
    };
    // An agent without two values has no range yet.
    let known = || ranges.values().copied().filter(|range| is_difference || range.0 < range.1);
    let whole = span(heat_range(figures));
    let is_hidden = known().count() > 1
        && known().any(|range| span(range) > 0.0 && span(range) < LEAST * whole);
    if is_hidden { ranges } else { BTreeMap::new() }
}

/// A map of one agent, with its colour range, and whether all maps of the analysis share it.
fn heat_figure(
    figure: &HeatFigure,
    &Sheet { metric, style, names, .. }: &Sheet<'_>,
    (range, is_shared): ((f64, f64), bool),
) -> Scene {
    let (columns, rows) = (&figure.x.1, &figure.y.1);
    let first = left(figure);
    // The explanation of colours is also shown in print, because no caption contains it.
    let bottom = BOTTOM - if style.has_titles() { 0.0 } else { NOTE + 3.0 };
    let tile_height = style.row(TILE_HEIGHT, rows.len(), TOP + bottom).max(LEAST_TILE);
    let heading = heading(figure, names, style.width() - first - RIGHT);
    let over = TOP + LINE * (heading.len() - 1) as f64;
    let height = over + bottom + tile_height * rows.len() as f64;
    let tile_width = (style.width() - first - RIGHT) / columns.len().max(1) as f64;
    let named = named(figure, names);
    let letters = letters(figure, metric, tile_width);
    let mut marks: Vec<Mark> = Vec::new();
    for tile in &figure.tiles {
        let index =
            |list: &[f64], value: f64| list.iter().position(|one| *one == value).unwrap_or(0);
        let left = first + index(columns, tile.x) as f64 * tile_width;
        // Small values are at the bottom, as on an axis.
        let top = over + (rows.len() - 1 - index(rows, tile.y)) as f64 * tile_height;
        let color = match tile.value {
            Ok(value) => color(value, range, figure.scale),
            Err(_) => Color(240, 240, 240),
        };
        marks.extend(tile_marks(
            tile,
            (figure, metric, &named),
            (color, letters),
            (left, top, (tile_width, tile_height)),
        ));
    }
    let facets = facets(&names.arm(&figure.name));
    let mut marks: Vec<Mark> = marks.into_iter().map(|mark| mark.of(0)).collect();
    let across = (first, tile_width, tile_height);
    let sizes = (over, height);
    marks.extend(frame((figure, metric, style), &heading, (range, is_shared), across, sizes));
    let title = metric.title();
    let description = format!("{title}: {} of {} over two parameters", named[1], named[0]);
    Scene { width: style.width(), height, description, marks, series: vec![facets] }
}

/// The size of the letters of values, at which every value fits that needs no exponent.
fn letters(figure: &HeatFigure, metric: Measure, tile_width: f64) -> f64 {
    let largest = TEXT + 1.0;
    let values = figure.tiles.iter().filter_map(|tile| tile.value.ok());
    let sizes = values.map(|value| {
        narrowed(&in_unit(value, metric), (largest, Weight::SemiBold), tile_width - 3.0)
    });
    sizes.filter(|size| *size >= LEAST_LETTERS * largest).fold(largest, f64::min)
}

/// The left edge of the tiles, right of the rows' values.
fn left(figure: &HeatFigure) -> f64 {
    /// Maximum width of the values, which are smaller if they need more.
    const MOST: f64 = 70.0;
    let wide = |value: &f64| width(&parameter(*value), TEXT, Weight::Regular);
    LEFT + figure.y.1.iter().map(wide).fold(20.0, f64::max).min(MOST)
}

/// The colour of a value. Means range from near white for the smallest to dark blue for the
/// largest. Differences are white at 0, vermillion below and blue above.
fn color(value: f64, (least, most): (f64, f64), scale: Scale) -> Color {
    let blue = Color(0, 92, 160);
    match scale {
        Scale::Mean => {
            // Halves, because the difference of very large numbers overflows.
            let (part, whole) = (value / 2.0 - least / 2.0, most / 2.0 - least / 2.0);
            Color::WHITE.towards(blue, 0.12 + 0.88 * share(part, whole))
        }
        Scale::Difference => {
            let far = least.abs().max(most.abs());
            let end = if value < 0.0 { Color(213, 94, 0) } else { blue };
            Color::WHITE.towards(end, share(value.abs(), far))
        }
    }
}

/// The factor from a metric to its displayed unit.
fn factor(metric: Measure) -> f64 {
    unit_numbers(metric).0.factor()
}

/// A value in the displayed unit of its metric.
fn in_unit(value: f64, metric: Measure) -> String {
    shown(value * factor(metric), unit_numbers(metric).1)
}

/// The numbers at the ends of the colour bar; `None` if no tile has a value.
fn ends_of_bar(scale: Scale, (least, most): (f64, f64)) -> Option<(f64, f64)> {
    let far = least.abs().max(most.abs());
    (least <= most).then_some(match scale {
        Scale::Mean => (least, most),
        Scale::Difference => (-far, far),
    })
}

/// The colours with the numbers that they stand for, above the note.
fn color_bar(
    scale: Scale,
    (range, is_shared): ((f64, f64), bool),
    metric: Measure,
    (whole, height): (f64, f64),
) -> Vec<Mark> {
    const STEPS: usize = 48;
    const HIGH: f64 = 7.0;
    const ROOM: f64 = 4.0;
    let Some((low, high)) = ends_of_bar(scale, range) else { return Vec::new() };
    let plain = (NOTE, Weight::Regular);
    let (unit, decimals) = (factor(metric), unit_numbers(metric).1);
    let [least, most] = shown_ends(low * unit, high * unit, decimals);
    let of = if is_shared { "colours of all maps" } else { "colours of this agent" };
    let used = width(of, NOTE, Weight::Regular)
        + width(&least, NOTE, Weight::Regular)
        + width(&most, NOTE, Weight::Regular);
    let long = (whole - 8.0 - used - 3.0 * ROOM).clamp(30.0, 110.0);
    let left = (whole - used - long - 3.0 * ROOM) / 2.0;
    let base = height - 16.0;
    let mut at = left;
    let mut marks: Vec<Mark> = vec![text((at, base), of, plain, FAINT, Anchor::Start).into()];
    at += width(of, NOTE, Weight::Regular) + ROOM;
    marks.push(text((at, base), &least, plain, FAINT, Anchor::Start).into());
    at += width(&least, NOTE, Weight::Regular) + ROOM;
    let (top, step) = (base - HIGH, long / STEPS as f64);
    for index in 0..STEPS {
        let share = (index as f64 + 0.5) / STEPS as f64;
        let fill =
            Fill { color: color((1.0 - share) * low + share * high, range, scale), opacity: 1.0 };
        // Neighbours overlap, so that no seam is visible between them.
        let wide = if index + 1 < STEPS { step + 0.4 } else { step };
        let points = rectangle(at + index as f64 * step, top, wide, HIGH);
        marks.push(SceneShape::Area { points, fill, stroke: None }.into());
    }
    let rim = Some(Stroke::solid(EDGE, 0.6));
    let fill = Fill { color: Color::WHITE, opacity: 0.0 };
    let points = rectangle(at, top, long, HIGH);
    marks.push(SceneShape::Area { points, fill, stroke: rim }.into());
    marks.push(text((at + long + ROOM, base), &most, plain, FAINT, Anchor::Start).into());
    marks
}

fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
}

fn tile_marks(
    tile: &HeatTile,
    (figure, metric, named): (&HeatFigure, Measure, &[String; 2]),
    (color, letters): (Color, f64),
    (left, top, (width, height)): (f64, f64, (f64, f64)),
) -> Vec<Mark> {
    let ink = if color.lightness() < 0.55 { Color::WHITE } else { INK };
    let middle = left + width / 2.0;
    let line = |at: f64, words: String, size: f64, weight| -> Mark {
        let size = narrowed(&words, (size, weight), width - 3.0);
        text((middle, top + at), words, (size, weight), ink, Anchor::Middle).into()
    };
    let fill = Fill { color, opacity: 1.0 };
    let rim = Some(Stroke::solid(EDGE, 0.6));
    let area = SceneShape::Area { points: rectangle(left, top, width, height), fill, stroke: rim };
    let in_unit = |value: f64| in_unit(value, metric);
    // A number that needs much smaller letters has an exponent.
    let short = |value: f64, sign: &str, letters: (f64, Weight)| {
        let words = format!("{sign}{}", in_unit(value));
        match narrowed(&words, letters, width - 3.0) < LEAST_LETTERS * letters.0 {
            true => format!("{sign}{}", signed(&exponential(value * factor(metric), 2))),
            false => words,
        }
    };
    let mut marks = Vec::new();
    let value = match tile.value {
        Ok(value) => in_unit(value),
        Err(reason) => reason.to_string(),
    };
    let spread = tile.interval.ok().map(|interval| (interval.high - interval.low) / 2.0);
    // The interval of a rate is not symmetric.
    let between = tile.interval.ok().filter(|_| is_rate(metric) && figure.scale == Scale::Mean);
    let between = between.map(|Interval { low, high }| {
        let [low, high] = shown_ends(low * factor(metric), high * factor(metric), 0);
        format!("{low}–{high}")
    });
    let published = tile.published.map(|value| format!("publ. {}", in_unit(value)));
    let spread_words = match &between {
        Some(between) => format!(", {between}"),
        None => spread.map_or_else(String::new, |half| format!(" ± {}", in_unit(half))),
    };
    let shown = format!("{value}{spread_words}");
    let tip = tip(tile, figure, named, &shown, published.as_deref());
    marks.push(Mark::from(area).saying(tip));
    let first = height / 2.0 - if published.is_some() { 7.0 } else { 2.0 };
    match tile.value {
        Ok(value) => {
            let bold = Weight::SemiBold;
            let words = short(value, "", (TEXT + 1.0, bold));
            marks.push(line(first, words, letters, bold));
        }
        Err(_) => marks.push(line(first, "–".to_owned(), TEXT + 1.0, Weight::Regular)),
    }
    let under = match (between, spread) {
        (Some(between), _) => Some(between),
        (None, Some(half)) => Some(short(half, "± ", (NOTE, Weight::Regular))),
        (None, None) => (tile.seeds == 1).then(|| "n = 1".to_owned()),
    };
    if let Some(words) = under {
        marks.push(line(first + 11.0, words, NOTE, Weight::Regular));
    }
    if let Some(words) = published {
        marks.push(line(first + 22.0, words, NOTE, Weight::Regular));
    }
    marks
}

/// What a tile says when the pointer is over it. `shown` has its value and interval.
fn tip(
    tile: &HeatTile,
    figure: &HeatFigure,
    [agent, subject]: &[String; 2],
    shown: &str,
    published: Option<&str>,
) -> String {
    let [x, y] = axes(figure);
    format!(
        "{agent} {subject}, {x} = {}, {y} = {}: {shown} (95 %), {}{}",
        parameter(tile.x),
        parameter(tile.y),
        seeds(std::iter::once(tile.seeds)),
        published.map_or_else(String::new, |words| format!("; {words}"))
    )
}

/// The lines of the heading, none wider than `room` unless it has a single word.
fn heading(figure: &HeatFigure, names: &Names, room: f64) -> Vec<String> {
    let [agent, subject] = named(figure, names);
    let subject = subject.replace(" - ", " − ");
    let heading = if agent.is_empty() { subject } else { format!("{agent}, {subject}") };
    heading_lines(&heading, room)
}

/// The heading, the values and names of the parameters, and the note.
fn frame(
    (figure, metric, style): (&HeatFigure, Measure, &Style),
    heading: &[String],
    (range, is_shared): ((f64, f64), bool),
    (left, tile_width, tile_height): (f64, f64, f64),
    (over, height): (f64, f64),
) -> Vec<Mark> {
    let plain = (TEXT, Weight::Regular);
    let (columns, rows) = (&figure.x.1, &figure.y.1);
    let bottom = over + tile_height * rows.len() as f64;
    let line = |(line, words): (usize, &String)| -> Mark {
        let room = tile_width * columns.len() as f64;
        let bold = (narrowed(words, (TEXT + 1.0, Weight::SemiBold), room), Weight::SemiBold);
        text((left, 17.0 + LINE * line as f64), words, bold, INK, Anchor::Start).into()
    };
    let mut marks: Vec<Mark> = heading.iter().enumerate().map(line).collect();
    for (at, value) in columns.iter().enumerate() {
        let at = (left + (at as f64 + 0.5) * tile_width, bottom + 13.0);
        marks.push(fitting(at, parameter(*value), (TEXT, tile_width - 3.0), FAINT).into());
    }
    for (at, value) in rows.iter().rev().enumerate() {
        let at = (left - 5.0, over + (at as f64 + 0.5) * tile_height + 3.0);
        let words = parameter(*value);
        let size = narrowed(&words, plain, left - LEFT + 3.0);
        marks.push(text(at, words, (size, Weight::Regular), FAINT, Anchor::End).into());
    }
    let at = (left + tile_width * columns.len() as f64 / 2.0, bottom + 27.0);
    marks.push(text(at, axis_title(&figure.x.0, &figure.y.0), plain, INK, Anchor::Middle).into());
    let title = rising_title(
        (12.0, (over + bottom) / 2.0),
        axis_title(&figure.y.0, &figure.x.0),
        bottom - over + 30.0,
    );
    marks.push(title.into());
    let note = format!(
        "{}{}{}, {}.",
        if figure.scale == Scale::Difference { "Difference in " } else { "" },
        metric.title(),
        interval_words(figure.scale, metric),
        seeds(figure.tiles.iter().map(|tile| tile.seeds).filter(|n| *n > 0))
    );
    marks.extend(color_bar(figure.scale, (range, is_shared), metric, (style.width(), height)));
    if style.has_titles() {
        let at = (style.width() / 2.0, height - 5.0);
        marks.push(fitting(at, note, (NOTE, style.width() - 8.0), FAINT).into());
    }
    marks
}

/// The size of letters, smaller if the words would be wider than `room`.
fn narrowed(words: &str, (size, weight): (f64, Weight), room: f64) -> f64 {
    size * (room / width(words, size, weight)).min(1.0)
}

fn table(title: &str, figures: &[HeatFigure], metric: Measure, names: &Names) -> DataTable {
    let name = metric.title();
    let [x, y] = figures.first().map(axes).unwrap_or_default();
    let columns = [
        ("agent", "Agent"),
        ("subject", "Subject"),
        ("y", y.as_str()),
        ("x", x.as_str()),
        ("seeds", "n"),
        ("value", name.as_str()),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("published", "Published"),
    ];
    let mut table = DataTable::new(title, &columns);
    for figure in figures {
        let [agent, subject] = named(figure, names);
        for tile in &figure.tiles {
            table.rows.push(vec![
                TableEntry::name(&figure.agent, &agent),
                TableEntry::name(&figure.subject, &subject),
                TableEntry::Number { value: tile.y, shown: parameter(tile.y) },
                TableEntry::Number { value: tile.x, shown: parameter(tile.x) },
                TableEntry::number(tile.seeds as f64, 0),
                entry_in_unit(tile.value, metric),
                between(tile.interval, metric),
                low(tile.interval),
                high(tile.interval),
                TableEntry::published(tile.published.map(|value| entry_in_unit(Ok(value), metric))),
            ]);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::metric::MEAN_RETURN;
    use crate::manifest::FigureKeys;
    use crate::report::figure::Looks;

    fn map(values: &[f64], unit: f64) -> HeatFigure {
        let tile = |(x, value): (usize, &f64)| HeatTile {
            x: unit * (x + 1) as f64,
            y: unit,
            value: Ok(*value),
            interval: Ok(Interval {
                low: value - value.abs() / 2.0,
                high: value + value.abs() / 2.0,
            }),
            seeds: 3,
            published: None,
        };
        let tiles: Vec<HeatTile> = values.iter().enumerate().map(tile).collect();
        HeatFigure {
            name: ArmId { agent: "a".into(), scenario: "P".into(), settings: Vec::new() },
            agent: "a".into(),
            subject: "P".into(),
            scale: Scale::Mean,
            x: ("environment.sigma".into(), tiles.iter().map(|tile| tile.x).collect()),
            y: ("environment.delta_d".into(), vec![unit]),
            tiles,
            lead: None,
        }
    }

    const RETURN: Measure = MEAN_RETURN.in_unit("points");

    #[test]
    fn numbers_of_every_size_fit_their_tiles_and_differ() {
        let style = Style::of(&FigureKeys::default());
        let values =
            [-1e7, 0.3, 0.000_02, 1_690_988.0, 123_456_789_012.0, 1e300, 1e-300, 0.0, 7.0, 7.5];
        for unit in [1e-300, 0.1, 1e6, 0.300_000_000_000_000_04] {
            let map = map(&values, unit);
            let range = heat_range(std::slice::from_ref(&map));
            let (names, looks) = (&Names::default(), &Looks::default());
            let sheet = Sheet { stem: "", metric: RETURN, names, looks, style: &style };
            let scene = heat_figure(&map, &sheet, (range, true));
            let room = (scene.width - left(&map) - RIGHT) / values.len() as f64;
            let mut numbers = Vec::new();
            for mark in &scene.marks {
                let SceneShape::Text { at, text, size, weight, anchor, .. } = &mark.shape else {
                    continue;
                };
                let wide = width(text, *size, *weight);
                if mark.series.is_some() {
                    assert!(wide <= room, "{text}");
                    numbers.push(text.clone());
                }
                assert!(*anchor != Anchor::End || at.0 - wide >= LEFT - 10.0, "{text}");
            }
            for words in
                ["−1e7", "0.3", "2e-5", "1.69e6", "1.23e11", "1e300", "1e-300", "0", "± 0.1"]
            {
                assert!(
                    numbers.iter().any(|number| number.starts_with(words)),
                    "{words} {numbers:?}"
                );
            }
        }
    }

    #[test]
    fn the_largest_mean_is_beside_its_closest_neighbour() {
        let t = crate::analyse::paired_t_test(&[(3.0, 2.0), (5.0, 3.0), (7.0, 3.5)]).unwrap();
        let (difference, interval) = (t.difference, Ok(t.interval));
        let lead = PeakLead {
            tiles: [1, 0],
            difference,
            interval,
            is_paired: true,
            neighbours: 2,
            tested: 2,
            behind: 1,
        };
        let map = HeatFigure { lead: Some(lead), ..map(&[100.0, 300.0, 200.0], 1.0) };
        let found = vec![map].finds(RETURN, &Names::default()).unwrap();
        let expected = "the largest is at σ = 2 and δ_d = 1 of a P. It is 2 (−1 to 5, t interval paired by seed) \
                        ahead of the closest of its 2 neighbours, at σ = 1 and δ_d = 1, and 1 of the 2 intervals \
                        exclude 0; the same seeds chose the tile, which makes its lead too large on average";
        assert!(found.ends_with(expected), "{found}");
    }

    #[test]
    fn colours_of_huge_and_of_equal_numbers_are_between_the_ends() {
        let range = (-1.7e308, 1.7e308);
        let [pale, dark] = [range.0, range.1].map(|value| color(value, range, Scale::Mean));
        assert!(pale.lightness() > 0.9 && dark.lightness() < 0.5);
        assert_eq!(color(5.0, (5.0, 5.0), Scale::Mean), pale);
        assert_eq!(color(0.0, (0.0, 0.0), Scale::Difference), Color::WHITE);
    }

    #[test]
    fn a_colour_is_the_same_number_in_all_maps_and_the_bar_states_which() {
        let range = (-19.0, 839.0);
        let (half, whole) = (419.5, 839.0);
        assert_eq!(color(whole, range, Scale::Difference), Color(0, 92, 160));
        assert_ne!(color(half, range, Scale::Difference), color(whole, range, Scale::Difference));
        let words = |scale, range| -> Vec<String> {
            let marks = color_bar(scale, (range, true), RETURN, (321.0, 200.0));
            let texts = marks.into_iter().filter_map(|mark| match mark.shape {
                SceneShape::Text { text, .. } => Some(text),
                SceneShape::Area { .. } | SceneShape::Circle { .. } | SceneShape::Line { .. } => {
                    None
                }
            });
            texts.collect()
        };
        assert_eq!(words(Scale::Difference, range), ["colours of all maps", "−839", "839"]);
        assert_eq!(words(Scale::Mean, (100.0, 300.0)), ["colours of all maps", "100", "300"]);
        assert!(words(Scale::Mean, heat_range(&[])).is_empty());
    }

    #[test]
    fn an_agent_whose_values_the_others_would_hide_has_colours_of_its_own() {
        let figure =
            |agent: &str, values: &[f64]| HeatFigure { agent: agent.into(), ..map(values, 1.0) };
        let far = [figure("a", &[1000.0, 3000.0]), figure("b", &[10.0, 20.0])];
        let found = scales(&far);
        assert_eq!((found["a"], found["b"]), ((1000.0, 3000.0), (10.0, 20.0)));
        assert!(
            scales(&[figure("a", &[1000.0, 3000.0]), figure("b", &[1500.0, 2500.0])]).is_empty()
        );
        assert!(scales(&far[..1]).is_empty());
    }
}
