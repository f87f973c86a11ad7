//! Choices of action: shares by the probability of context 0, with one stack per bin.

use super::{Drawn, Sheet};
use crate::analyse::declared::{ActionPanel, ArmId, BinShares};
use crate::analyse::quantile;
use crate::job::{Measure, MetricUnit};

use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::escape::file_stem;
use crate::report::figure::{
    FAINT, INK, NOTE, Panels, Style, TEXT, arm_label, facets, fitting, rising_title, seeds, text,
};
use crate::report::names::Names;
use crate::report::scene::{
    Anchor, Color, Fill, Mark, Point, Scene, SceneShape, Stroke, Weight, rectangle, width,
};
use crate::report::tables::{arm, between, high, in_unit, low, no_interval};

impl Drawn for Vec<ActionPanel> {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let groups = groups(self, sheet);
        let of_group = groups.into_iter().flat_map(|(stem, members)| {
            let is_alone = members.len() == 1;
            members.into_iter().map(move |at| {
                let arm = sheet.names.arm(&self[at].name);
                let label = file_stem(&arm_label(&arm));
                let stem = if is_alone { stem.clone() } else { format!("{stem}-{label}") };
                (stem, action_figure(&self[at], &arm, sheet.style))
            })
        });
        of_group.collect()
    }

    fn wholes(&self, sheet: &Sheet<'_>, _: usize) -> Vec<(String, usize)> {
        groups(self, sheet).into_iter().map(|(stem, members)| (stem, members.len())).collect()
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        table(title, self, names)
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        format!(
            "Shares of the four actions in the tests by the inferred probability of context 0: means \
             over {}, with 95 % intervals in the table",
            seeds(self.iter().map(|panel| panel.seeds.0))
        )
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        let range = |bin: fn(&ActionPanel) -> usize| {
            let shares = || self.iter().filter_map(|panel| panel.tailored(bin(panel)));
            let (least, most) = (shares().reduce(f64::min)?, shares().reduce(f64::max)?);
            let [least, most] = [least, most].map(|share| shown(share * 100.0, 0));
            Some(if least == most { format!("{most} %") } else { format!("{least} to {most} %") })
        };
        let (likely, unsure) = (range(|_| 0)?, range(|panel| panel.bins.len() / 2)?);
        let bin = self.first().map(|panel| &panel.bins[panel.bins.len() / 2])?;
        Some(format!(
            "{likely} of the actions are tailored where context 1 is likely, and {unsure} where the \
             probability of context 0 is {} to {} (means, not tested)",
            shown(bin.low, 1),
            shown(bin.high, 1)
        ))
    }

    fn arms(&self) -> Vec<&ArmId> {
        self.iter().map(|panel| &panel.name).collect()
    }
}

/// Colours and meanings of the actions. No arm has these looks.
const ACTIONS: [(Color, &str); 4] = [
    (Color(200, 200, 200), "0 none"),
    (Color(240, 228, 66), "1 untailored"),
    (Color(86, 180, 233), "2 for context 0"),
    (Color(230, 159, 0), "3 for context 1"),
];

const LEFT: f64 = 30.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 26.0;
const PANEL: f64 = 112.0;
const STACK: f64 = 82.0;
const BOTTOM: f64 = 34.0;

/// The panels that a declared key puts together, with the stem of each group; all panels without such a key.
fn groups(panels: &[ActionPanel], sheet: &Sheet<'_>) -> Vec<(String, Vec<usize>)> {
    let arms = sheet.names.arms(panels.iter().map(|panel| &panel.name));
    let names: Vec<&ArmId> = arms.iter().collect();
    let groups = match sheet.style.panel {
        Some(_) => Panels::of(&names, sheet.style.panel, None),
        None => Panels::whole(&names),
    };
    let members = groups.panels.iter().map(|group| group.members.clone());
    groups.stems(sheet.stem).into_iter().zip(members).filter(|(_, all)| !all.is_empty()).collect()
}

/// The stacks of an arm.
fn action_figure(panel: &ActionPanel, arm: &ArmId, style: &Style) -> Scene {
    let whole = style.width();
    let beside = TOP + BOTTOM - if style.has_titles() { 0.0 } else { NOTE + 3.0 };
    let high = style.row(PANEL, 1, beside);
    let height = beside + high;
    let mut marks = legend(whole);
    let label = arm_label(arm);
    let of_panel = panel_marks(panel, &label, TOP, (whole, high - (PANEL - STACK)));
    marks.extend(of_panel.into_iter().map(|mark| mark.of(0)));
    let under = height - style.note() - 9.0;
    let at = (LEFT + (whole - LEFT - RIGHT) / 2.0, under);
    let title = "inferred probability of context 0";
    marks.push(fitting(at, title, (TEXT, whole - 8.0), INK).into());
    let note = format!(
        "Mean shares over {}{}.",
        seeds(std::iter::once(panel.seeds.0)),
        half_width_words(panel)
    );
    if style.has_titles() {
        let at = (whole / 2.0, height - 5.0);
        marks.push(fitting(at, note, (NOTE, whole - 8.0), FAINT).into());
    }
    let description = format!("shares of actions by the probability of context 0, {label}");
    Scene { width: whole, height, description, marks, series: vec![facets(arm)] }
}

/// The median and the largest half-width of the intervals of labelled shares. Shares near 0 have
/// short intervals and would make the estimates seem too precise.
fn half_width_words(panel: &ActionPanel) -> String {
    let shares = panel.bins.iter().filter_map(|bin| bin.shares);
    let labelled = shares.flatten().filter(|(share, _)| is_labelled(*share, STACK));
    let intervals = labelled.filter_map(|(_, interval)| interval);
    let mut halves: Vec<f64> =
        intervals.map(|interval| (interval.high - interval.low) / 2.0).collect();
    halves.sort_by(f64::total_cmp);
    let words = |half: f64| match half {
        // Such an interval covers all shares from 0 to 100 %.
        half if half >= 1.0 => "100 or more".to_owned(),
        half => shown(half * 100.0, 0),
    };
    match (quantile(&halves, 0.5), halves.last()) {
        (Ok(median), Some(most)) => format!(
            "; 95 % half-width of labelled ones: median {}, largest {} points",
            words(median),
            words(*most)
        ),
        _ => String::new(),
    }
}

/// Whether the segment of a share is high enough to hold its number.
fn is_labelled(share: f64, stack: f64) -> bool {
    share * stack > NOTE + 3.0
}

/// The colours of the actions, in smaller letters where the figure is narrow.
fn legend(whole: f64) -> Vec<Mark> {
    let length = |name: &str| 18.0 + width(name, NOTE, Weight::Regular);
    let all: f64 = ACTIONS.iter().map(|(_, name)| length(name)).sum();
    let scale = ((whole - LEFT) / all).min(1.0);
    let mut marks = Vec::new();
    let mut left = LEFT;
    for (color, name) in ACTIONS {
        let side = 8.0 * scale;
        let points = rectangle(left, 15.0 - side, side, side);
        let fill = Fill { color, opacity: 1.0 };
        marks.push(SceneShape::Area { points, fill, stroke: None }.into());
        let at = (left + 10.5 * scale, 14.5);
        marks.push(text(at, name, (NOTE * scale, Weight::Regular), INK, Anchor::Start).into());
        left += length(name) * scale;
    }
    marks
}

fn panel_marks(panel: &ActionPanel, label: &str, top: f64, (whole, high): (f64, f64)) -> Vec<Mark> {
    let plain = (NOTE, Weight::Regular);
    let size = TEXT * ((whole - LEFT - 4.0) / width(label, TEXT, Weight::SemiBold)).min(1.0);
    let heading = text((LEFT, top + 11.0), label, (size, Weight::SemiBold), INK, Anchor::Start);
    let mut marks: Vec<Mark> = vec![heading.into()];
    let slot = (whole - LEFT - RIGHT) / panel.bins.len().max(1) as f64;
    let base = top + 16.0 + high;
    let middle = (10.0, base - high / 2.0);
    marks.push(rising_title(middle, "share, %".to_owned(), high).into());
    for (share, words) in [(0.0, "0"), (0.5, "50"), (1.0, "100")] {
        let at = (LEFT - 3.0, base - share * high + 3.0);
        marks.push(text(at, words, plain, FAINT, Anchor::End).into());
    }
    for (at, bin) in panel.bins.iter().enumerate() {
        let left = LEFT + at as f64 * slot;
        marks.extend(stack(bin, label, (left + 2.0, base), (slot - 4.0, high)));
        let words = format!("{}–{}", shown(bin.low, 1), shown(bin.high, 1));
        let at = (left + slot / 2.0, base + 10.0);
        marks.push(fitting(at, words, (NOTE, slot - 2.0), FAINT).into());
    }
    marks
}

fn stack(
    bin: &BinShares,
    label: &str,
    (left, base): Point,
    (width, high): (f64, f64),
) -> Vec<Mark> {
    let mut marks: Vec<Mark> = Vec::new();
    let Some(shares) = &bin.shares else {
        let at = (left + width / 2.0, base - high / 2.0);
        let words = text(at, "no steps", (NOTE, Weight::Regular), FAINT, Anchor::Middle);
        return vec![words.into()];
    };
    let mut below = 0.0;
    for ((share, interval), (color, name)) in shares.iter().zip(ACTIONS) {
        let height = share * high;
        let top = base - below - height;
        below += height;
        if height <= 0.0 {
            continue;
        }
        let spread = interval.map_or_else(String::new, |interval| {
            format!(" ± {}", shown((interval.high - interval.low) * 50.0, 1))
        });
        let tip = format!(
            "{label}, probability {} to {}, action {name}: {}{spread} %, {}, {} test steps",
            shown(bin.low, 1),
            shown(bin.high, 1),
            shown(share * 100.0, 1),
            seeds(std::iter::once(bin.seeds)),
            bin.steps
        );
        let area = SceneShape::Area {
            points: rectangle(left, top, width, height),
            fill: Fill { color, opacity: 1.0 },
            stroke: Some(Stroke::solid(Color::WHITE, 0.5)),
        };
        marks.push(Mark::from(area).saying(tip));
        if is_labelled(*share, high) {
            let at = (left + width / 2.0, top + height / 2.0 + 3.0);
            let words = shown(share * 100.0, 0);
            marks.push(text(at, words, (NOTE, Weight::Regular), INK, Anchor::Middle).into());
        }
    }
    marks
}

fn table(title: &str, panels: &[ActionPanel], names: &Names) -> DataTable {
    let columns = [
        ("arm", "Arm"),
        ("p_low", "p from"),
        ("p_high", "to"),
        ("action", "Action"),
        ("share", "Share, %"),
        ("interval", "95 % interval, %"),
        (".low", ""),
        (".high", ""),
        ("seeds", "n"),
        ("steps", "Test steps"),
    ];
    let mut table = DataTable::new(title, &columns);
    for panel in panels {
        for bin in &panel.bins {
            for (action, (share, interval)) in bin.shares.iter().flatten().enumerate() {
                let interval = interval.ok_or(no_interval(bin.seeds));
                table.rows.push(vec![
                    arm(&panel.name, names),
                    TableEntry::number(bin.low, 1),
                    TableEntry::number(bin.high, 1),
                    TableEntry::number(action as f64, 0),
                    in_unit(Ok(*share), MetricUnit::Share),
                    between(interval, MetricUnit::Share),
                    low(interval),
                    high(interval),
                    TableEntry::number(bin.seeds as f64, 0),
                    TableEntry::number(bin.steps as f64, 0),
                ]);
            }
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Interval;

    fn panel(shares: [(f64, Option<f64>); 4]) -> ActionPanel {
        let interval = |(share, half): (f64, Option<f64>)| {
            (share, half.map(|half| Interval { low: share - half, high: share + half }))
        };
        let shares = Some(shares.map(interval));
        let name = ArmId { agent: "dqn".into(), scenario: "L-H-D".into(), settings: Vec::new() };
        let bins = vec![BinShares { low: 0.0, high: 1.0, steps: 9, seeds: 3, shares }];
        ActionPanel { name, seeds: (3, 3), bins }
    }

    #[test]
    fn the_note_states_the_intervals_of_the_shares_that_are_labelled() {
        // The segment of 0.05 is too low for a label, so its interval does not count.
        let shares = [(0.4, Some(0.3)), (0.35, Some(1.39)), (0.2, Some(0.12)), (0.05, Some(0.01))];
        assert_eq!(
            half_width_words(&panel(shares)),
            "; 95 % half-width of labelled ones: median 30, largest 100 or more points"
        );
        let two = [(0.5, Some(0.1)), (0.5, Some(0.2)), (0.0, None), (0.0, None)];
        assert_eq!(
            half_width_words(&panel(two)),
            "; 95 % half-width of labelled ones: median 15, largest 20 points"
        );
        let one_seed = [(0.5, None), (0.5, None), (0.0, None), (0.0, None)];
        assert_eq!(half_width_words(&panel(one_seed)), "");
    }
}
