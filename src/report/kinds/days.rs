//! The days of single people: a panel per variable over their decisions, with the actions marked.

use super::{Drawn, Sheet};
use crate::analyse::declared::{ArmId, DaysFigure, PersonDays};
use crate::job::{Measure, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry};
use crate::report::escape::file_stem;
use crate::report::figure::{
    Axis, AxisScale, COLORS, FAINT, GRID, INK, NOTE, NumberFormat, TEXT, arm_label, facets,
    fitting, round_range, text,
};
use crate::report::names::Names;
use crate::report::scene::{
    Anchor, Color, Fill, Mark, Point, Scene, SceneShape, Stroke, Weight, rectangle, width,
};
use crate::report::tables::arm;

impl Drawn for DaysFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let figure = |figure: &PersonDays| {
            let label = file_stem(&arm_label(&sheet.names.arm(&figure.name)));
            let stem = match self.arms().len() {
                1 => format!("{}-{}", sheet.stem, figure.person),
                _ => format!("{}-{label}-{}", sheet.stem, figure.person),
            };
            (stem, days_figure(figure, sheet))
        };
        self.people.iter().filter(|one| !one.variables.is_empty()).map(figure).collect()
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let columns = [
            ("arm", "Arm"),
            ("seed", "Seed"),
            ("person", "Person"),
            ("decision", "Decision"),
            ("action", "Action"),
            ("variable", "Variable"),
            ("value", "Value"),
        ];
        let mut table = DataTable::new(title, &columns);
        for figure in &self.people {
            for (name, numbers) in &figure.variables {
                for ((step, action), number) in figure.actions.iter().zip(numbers) {
                    let shown = |number: f64| match number.is_finite() {
                        true => TableEntry::text(format!("{number}")),
                        false => TableEntry::text(String::new()),
                    };
                    table.rows.push(vec![
                        arm(&figure.name, names),
                        TableEntry::text(figure.seed.to_string()),
                        TableEntry::text(figure.person.to_string()),
                        TableEntry::text(step.to_string()),
                        shown(*action),
                        TableEntry::text(name.clone()),
                        shown(*number),
                    ]);
                }
            }
        }
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let count = distinct(self.people.iter().map(|figure| figure.person)).len();
        format!("Recorded variables of {} over decisions, with the actions taken", people(count))
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        None
    }

    fn lacks(&self) -> Option<String> {
        let listed =
            |numbers: &[u32]| numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
        let mut missing = Vec::new();
        match (self.people.is_empty(), self.absent.is_empty()) {
            (true, true) => missing.push("no completed job has recorded decisions".to_owned()),
            (_, false) => missing.push(format!("no decisions of person {}", listed(&self.absent))),
            _ => {}
        }
        if !self.unknown.is_empty() {
            let names: Vec<String> = self.unknown.iter().map(|name| format!("`{name}`")).collect();
            missing.push(format!("{} is not recorded", names.join(", ")));
        }
        if self.left_out > 0 {
            let left_out = counted(self.left_out, "recorded variable");
            missing.push(format!("{left_out}, which `variables` can name"));
        }
        if self.beyond > 0 {
            missing.push(format!("{} of other arms, whom `where` can choose", people(self.beyond)));
        }
        (!missing.is_empty()).then(|| missing.join("; "))
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.people.iter().map(|figure| &figure.name))
    }
}

/// A number of people in words.
fn people(count: usize) -> String {
    if count == 1 { "1 person".to_owned() } else { format!("{count} people") }
}

const LEFT: f64 = 46.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 20.0;
/// The height of a panel with its name above it, and of the name.
const PANEL: f64 = 52.0;
const NAME: f64 = 14.0;
/// The height of the strip of actions, and of what stands below the panels.
const STRIP: f64 = 18.0;
const BOTTOM: f64 = 40.0;

/// The least width of a decision that has a tip.
const LEAST_SLOT: f64 = 0.5;

fn days_figure(figure: &PersonDays, sheet: &Sheet<'_>) -> Scene {
    let whole = sheet.style.width();
    let rows = figure.variables.len();
    let beside = TOP + STRIP + BOTTOM;
    let row = sheet.style.row(PANEL, rows, beside);
    let height = beside + row * rows as f64;
    let name = sheet.names.arm(&figure.name);
    let color = sheet.looks.look(&name).color;
    let label = format!("{}, person {}", arm_label(&name), figure.person);
    let step = |one: Option<&(u32, f64)>| one.map_or(0.0, |(step, _)| f64::from(*step));
    let (first, last) = (step(figure.actions.first()), step(figure.actions.last()));
    let x = Axis::new("decision".to_owned(), (first, last), AxisScale::Linear, NumberFormat::Plain);
    let across = whole - LEFT - RIGHT;
    let at = |step: u32| LEFT + x.share(f64::from(step)) * across;
    let mut marks: Vec<Mark> = Vec::new();
    let bold = TEXT * ((whole - 8.0) / width(&label, TEXT, Weight::SemiBold)).min(1.0);
    marks.push(
        text((LEFT, 11.0), label.as_str(), (bold, Weight::SemiBold), INK, Anchor::Start).into(),
    );
    let bottom = TOP + row * rows as f64;
    // Lines through all panels, so that what an action changes stands beside it.
    for (step, _) in figure.actions.iter().filter(|(_, action)| *action > 0.0) {
        let points = vec![(at(*step), TOP + NAME), (at(*step), bottom)];
        marks.push(SceneShape::Line { points, stroke: Stroke::solid(GRID, 0.7) }.into());
    }
    for (index, (name, numbers)) in figure.variables.iter().enumerate() {
        let top = TOP + row * index as f64;
        marks.push(
            text(
                (LEFT, top + NAME - 4.0),
                axis(name, numbers).title().as_str(),
                (NOTE, Weight::Regular),
                INK,
                Anchor::Start,
            )
            .into(),
        );
        marks.extend(
            panel(figure, (name, numbers), (top + NAME, row - NAME - 4.0), whole)
                .into_iter()
                .map(|mark| mark.of(0)),
        );
        let points: Vec<(u32, f64)> =
            figure.actions.iter().map(|(step, _)| *step).zip(numbers.iter().copied()).collect();
        let y = axis(name, numbers);
        let place = |(step, number): (u32, f64)| -> Point {
            (at(step), top + NAME + (1.0 - y.share(number)) * (row - NAME - 4.0))
        };
        let is_stepped = is_stepped(numbers);
        // A missing number parts the line.
        for part in points.split(|(_, number)| !number.is_finite()).filter(|part| !part.is_empty())
        {
            let mut drawn: Vec<Point> = Vec::new();
            for one in part {
                let next = place(*one);
                // Categories and counts hold until the next decision.
                drawn.extend(drawn.last().filter(|_| is_stepped).map(|last| (next.0, last.1)));
                drawn.push(next);
            }
            let shape = match drawn.len() {
                1 => SceneShape::Circle {
                    centre: drawn[0],
                    radius: 1.2,
                    fill: Fill { color, opacity: 1.0 },
                    stroke: None,
                },
                _ => SceneShape::Line { points: drawn, stroke: Stroke::solid(color, 1.1) },
            };
            marks.push(Mark::from(shape).of(0));
        }
    }
    marks.extend(strip(figure, bottom, &at));
    marks.extend(below(&x, bottom + STRIP, (across, whole)));
    if sheet.style.has_titles() {
        let withheld = match figure.actions.iter().any(|(_, action)| action.is_nan()) {
            true => "; short: none could be sent",
            false => "",
        };
        let note =
            format!("A mark for each decision with an action{withheld}. Seed {}.", figure.seed);
        let under = (whole / 2.0, height - 5.0);
        marks.push(fitting(under, note, (NOTE, whole - 8.0), FAINT).into());
    }
    marks.extend(legend(figure, whole));
    let description = format!(
        "{} over {}, {label}",
        counted(rows, "variable"),
        counted(figure.actions.len(), "decision")
    );
    Scene { width: whole, height, description, marks, series: vec![facets(&name)] }
}

/// The axis of a variable. Its title has the number that labels count from, if there is one.
fn axis(name: &str, numbers: &[f64]) -> Axis {
    let known = || numbers.iter().copied().filter(|number| number.is_finite());
    let (low, high) = (known().fold(f64::MAX, f64::min), known().fold(f64::MIN, f64::max));
    Axis::new(name.to_owned(), round_range(low, high), AxisScale::Linear, NumberFormat::Plain)
}

/// Whether all numbers are whole and few are distinct, as of categories.
fn is_stepped(numbers: &[f64]) -> bool {
    const MOST: usize = 6;
    let known = numbers.iter().copied().filter(|number| number.is_finite());
    known.clone().all(|number| number.fract() == 0.0)
        && distinct(known.map(f64::to_bits)).len() <= MOST
}

/// The colours of the actions, if there are several.
fn legend(figure: &PersonDays, whole: f64) -> Vec<Mark> {
    let taken = figure.actions.iter().map(|(_, action)| *action).filter(|action| *action > 0.0);
    let mut actions: Vec<usize> = distinct(taken.map(|action| action as usize));
    actions.sort_unstable();
    if actions.len() < 2 {
        return Vec::new();
    }
    let mut marks = Vec::new();
    let mut right = whole - RIGHT;
    for action in actions.into_iter().rev() {
        let words = format!("action {action}");
        let size = (NOTE, Weight::Regular);
        marks.push(text((right, 11.0), words.as_str(), size, color_of(action), Anchor::End).into());
        right -= width(&words, NOTE, Weight::Regular) + 6.0;
    }
    marks
}

/// The colour of an action above 0.
fn color_of(action: usize) -> Color {
    COLORS[(action - 1) % COLORS.len()]
}

/// The ends of a panel's axis, and areas that say the numbers.
fn panel(
    figure: &PersonDays,
    (name, numbers): (&str, &[f64]),
    (top, high): (f64, f64),
    whole: f64,
) -> Vec<Mark> {
    let mut marks = Vec::new();
    for tick in axis(name, numbers).ticks(3) {
        let level = top + (1.0 - tick.share) * high;
        let points = vec![(LEFT, level), (whole - RIGHT, level)];
        marks.push(SceneShape::Line { points, stroke: Stroke::solid(GRID, 0.6) }.into());
        let at = (LEFT - 4.0, level + NOTE * 0.35);
        let plain = (NOTE, Weight::Regular);
        marks.push(text(at, tick.label, plain, FAINT, Anchor::End).into());
    }
    let count = figure.actions.len();
    let slot = (whole - LEFT - RIGHT) / count as f64;
    // Nobody can point at less.
    if slot < LEAST_SLOT {
        return marks;
    }
    for (index, ((step, action), number)) in figure.actions.iter().zip(numbers).enumerate() {
        let points = rectangle(LEFT + index as f64 * slot, top, slot, high);
        let fill = Fill { color: GRID, opacity: 0.0 };
        let taken = if action.is_finite() {
            format!("action {action}")
        } else {
            "none could be sent".to_owned()
        };
        let tip = format!("{name}, decision {step}: {number}, {taken}");
        marks.push(Mark::from(SceneShape::Area { points, fill, stroke: None }).saying(tip));
    }
    marks
}

/// A mark for each decision with an action, in the colour of the action, and a short one where none could be sent.
fn strip(figure: &PersonDays, top: f64, at: &dyn Fn(u32) -> f64) -> Vec<Mark> {
    let middle = top + STRIP / 2.0;
    let mut marks = vec![
        text(
            (LEFT - 4.0, middle + NOTE * 0.35),
            "action",
            (NOTE, Weight::Regular),
            FAINT,
            Anchor::End,
        )
        .into(),
    ];
    for (step, action) in &figure.actions {
        let (half, color, wide) = match action {
            action if action.is_nan() => (1.5, FAINT, 0.6),
            action if *action > 0.0 => (5.0, color_of(*action as usize), 1.3),
            _ => continue,
        };
        let points = vec![(at(*step), middle - half), (at(*step), middle + half)];
        let line = SceneShape::Line { points, stroke: Stroke::solid(color, wide) };
        let tip = match action.is_nan() {
            true => format!("decision {step}: no message could be sent"),
            false => format!("decision {step}: action {action}"),
        };
        marks.push(Mark::from(line).saying(tip).of(0));
    }
    marks
}

/// The horizontal axis.
fn below(x: &Axis, top: f64, (across, whole): (f64, f64)) -> Vec<Mark> {
    let points = vec![(LEFT, top), (whole - RIGHT, top)];
    let mut marks: Vec<Mark> =
        vec![SceneShape::Line { points, stroke: Stroke::solid(FAINT, 0.8) }.into()];
    for tick in x.ticks_along(across, (across / 37.0) as usize) {
        let at = (LEFT + tick.share * across, top + 3.0 + NOTE);
        marks.push(text(at, tick.label, (NOTE, Weight::Regular), FAINT, Anchor::Middle).into());
    }
    let at = (LEFT + across / 2.0, top + 5.0 + 2.0 * NOTE);
    marks.push(fitting(at, x.title(), (NOTE, across), INK).into());
    marks
}
