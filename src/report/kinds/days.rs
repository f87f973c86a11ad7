//! The days of single people: a panel per variable over their decisions, with the actions marked.

use super::{Drawn, Sheet};
use crate::analyse::declared::{ArmId, DaysFigure};
use crate::job::{Measure, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry};
use crate::report::escape::file_stem;
use crate::report::figure::{
    Axis, AxisScale, COLORS, FAINT, GRID, INK, NOTE, NumberFormat, TEXT, arm_label, facets,
    fitting, round_range, text,
};
use crate::report::names::Names;
use crate::report::scene::{
    Anchor, Fill, Mark, Point, Scene, SceneShape, Stroke, Weight, rectangle, width,
};
use crate::report::tables::arm;

impl Drawn for Vec<DaysFigure> {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let figure = |figure: &DaysFigure| {
            let label = file_stem(&arm_label(&sheet.names.arm(&figure.name)));
            let stem = match distinct(self.iter().map(|one| &one.name)).len() {
                1 => format!("{}-{}", sheet.stem, figure.person),
                _ => format!("{}-{label}-{}", sheet.stem, figure.person),
            };
            (stem, days_figure(figure, sheet))
        };
        self.iter().filter(|one| !one.variables.is_empty()).map(figure).collect()
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
        for figure in self {
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
        let people = distinct(self.iter().map(|figure| figure.person)).len();
        let word = if people == 1 { "person" } else { "people" };
        format!("Recorded variables of {people} {word} over decisions, with the actions taken")
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        None
    }

    fn lacks(&self) -> Option<String> {
        self.is_empty().then(|| "no completed job has decisions of these people".to_owned())
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.iter().map(|figure| &figure.name))
    }
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

fn days_figure(figure: &DaysFigure, sheet: &Sheet<'_>) -> Scene {
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
                name.as_str(),
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
        let y = axis(numbers);
        let place = |(step, number): (u32, f64)| -> Point {
            (at(step), top + NAME + (1.0 - y.share(number)) * (row - NAME - 4.0))
        };
        // A missing number parts the line.
        for part in points.split(|(_, number)| !number.is_finite()).filter(|part| !part.is_empty())
        {
            let drawn: Vec<Point> = part.iter().map(|one| place(*one)).collect();
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
        let note = format!("A mark for each decision with an action; seed {}.", figure.seed);
        let under = (whole / 2.0, height - 5.0);
        marks.push(fitting(under, note, (NOTE, whole - 8.0), FAINT).into());
    }
    let description = format!(
        "{} over {}, {label}",
        counted(rows, "variable"),
        counted(figure.actions.len(), "decision")
    );
    Scene { width: whole, height, description, marks, series: vec![facets(&name)] }
}

fn axis(numbers: &[f64]) -> Axis {
    let known = || numbers.iter().copied().filter(|number| number.is_finite());
    let (low, high) = (known().fold(f64::MAX, f64::min), known().fold(f64::MIN, f64::max));
    Axis::new(String::new(), round_range(low, high), AxisScale::Linear, NumberFormat::Plain)
}

/// The ends of a panel's axis, and areas that say the numbers.
fn panel(
    figure: &DaysFigure,
    (name, numbers): (&str, &[f64]),
    (top, high): (f64, f64),
    whole: f64,
) -> Vec<Mark> {
    let mut marks = Vec::new();
    for tick in axis(numbers).ticks(2) {
        let level = top + (1.0 - tick.share) * high;
        let points = vec![(LEFT, level), (whole - RIGHT, level)];
        marks.push(SceneShape::Line { points, stroke: Stroke::solid(GRID, 0.6) }.into());
        let at = (LEFT - 4.0, level + NOTE * 0.35);
        let plain = (NOTE, Weight::Regular);
        marks.push(text(at, tick.label, plain, FAINT, Anchor::End).into());
    }
    let count = figure.actions.len();
    let slot = (whole - LEFT - RIGHT) / count as f64;
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

/// A mark for each decision with an action, in the colour of the action, and a faint one where none could be chosen.
fn strip(figure: &DaysFigure, top: f64, at: &dyn Fn(u32) -> f64) -> Vec<Mark> {
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
            action if *action > 0.0 => (5.0, COLORS[(*action as usize - 1) % COLORS.len()], 1.3),
            _ => continue,
        };
        let points = vec![(at(*step), middle - half), (at(*step), middle + half)];
        let line = SceneShape::Line { points, stroke: Stroke::solid(color, wide) };
        let tip = match action.is_nan() {
            true => format!("decision {step}: no action could be chosen"),
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
