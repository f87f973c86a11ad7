//! How people differ in the effect of a message in states, and what an agent knows of it: people by their learned effects.

use super::learned::state_in_words;
use super::{Drawn, Sheet};
use crate::analyse::Undefined;
use crate::analyse::declared::{ArmId, OverTrials, ShrinkageFigure, ShrinkagePanel, TrialOfPeople};
use crate::job::{HeldDeviation, Measure, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, FAINT, Line, Look, Marker, NumberFormat, PlottedPoint, Spread, arm_label,
    axes_of, draw, facets,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, range};

/// Decimals of effects.
const DECIMALS: usize = 2;

impl Drawn for ShrinkageFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let charts: Vec<Chart> = self.panels.iter().map(|panel| self.chart(panel, sheet)).collect();
        if charts.is_empty() {
            return Vec::new();
        }
        let scale = sheet.style.x_scale(AxisScale::Linear);
        let x = ("people, by their learned effect".to_owned(), NumberFormat::Plain, scale);
        let y = ("effect of the message".to_owned(), NumberFormat::Plain);
        let axes = axes_of(&charts, x, y, sheet.style);
        sheet.numbered(draw(&charts, &axes, sheet.style))
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let columns = [
            ("arm", "Arm"),
            ("state", "State"),
            ("trials", "Trials"),
            ("common", "Common effect, median"),
            ("common_range", "2.5 to 97.5 %"),
            ("deviation", "Deviation of people, median"),
            ("deviation_range", "2.5 to 97.5 %"),
            ("held", "Trials whose deviation is held"),
            ("resolved", "Known, % of its variance, median"),
            ("resolved_range", "2.5 to 97.5 %"),
            ("people", "People of the first trial"),
            ("apart", "Apart from the common effect"),
        ];
        let mut table = DataTable::new(title, &columns);
        table.rows = self.panels.iter().map(|panel| cells(panel, names)).collect();
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        "Learned effects of a message in a state for the people of the first trial, after its last update, with 95 % of their \
         posteriors; and the common effect with 95 % of people around it"
            .to_owned()
    }

    fn finds(&self, _: Measure, names: &Names) -> Option<String> {
        let by = |one: &&ShrinkagePanel, other: &&ShrinkagePanel| {
            one.over[1].median.total_cmp(&other.over[1].median)
        };
        let most = self.panels.iter().max_by(by)?;
        let [_, deviation, resolved] = most.over;
        Some(format!(
            "People differ most in {}: by {} around {}, of whose variance {} % is known",
            self.heading(most, names),
            shown(deviation.median, DECIMALS),
            shown(most.over[0].median, DECIMALS),
            shown(100.0 * resolved.median, 0)
        ))
    }

    fn lacks(&self) -> Option<String> {
        if self.panels.is_empty() {
            return Some("no completed trial has posteriors of people in these states".to_owned());
        }
        (self.lacking > 0)
            .then(|| format!("{} without posteriors of people", counted(self.lacking, "trial")))
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.panels.iter().map(|panel| &panel.name))
    }
}

impl ShrinkageFigure {
    /// The heading of a panel: its state, and its arm if there are several.
    fn heading(&self, panel: &ShrinkagePanel, names: &Names) -> String {
        match self.arms().len() {
            1 => state_in_words(&panel.state),
            _ => format!("{}, {}", state_in_words(&panel.state), names.label(&panel.name)),
        }
    }

    fn chart(&self, panel: &ShrinkagePanel, sheet: &Sheet<'_>) -> Chart {
        let name = sheet.names.arm(&panel.name);
        let TrialOfPeople { common, deviation, people, .. } = &panel.first;
        let of_person = |(place, (person, mean, sd)): (usize, &(u32, f64, f64))| PlottedPoint {
            x: place as f64 + 1.0,
            y: *mean,
            interval: Some((mean - 1.96 * sd, mean + 1.96 * sd)),
            is_single: false,
            tip: format!(
                "{}, person {person}: {} ± {}",
                arm_label(&name),
                shown(*mean, DECIMALS),
                shown(*sd, DECIMALS)
            ),
        };
        let of_all = |x: f64| PlottedPoint {
            x,
            y: *common,
            interval: Some((common - 1.96 * deviation, common + 1.96 * deviation)),
            is_single: false,
            tip: format!(
                "common effect {} ± {}",
                shown(*common, DECIMALS),
                shown(*deviation, DECIMALS)
            ),
        };
        let line = |label: &str, look: Look, points: Vec<PlottedPoint>, spread: Spread| Line {
            label: label.to_owned(),
            look,
            points,
            reference: Vec::new(),
            spread,
            facets: facets(&name),
        };
        let faint = Look { color: FAINT, dash: Some((2.6, 1.6)), marker: Marker::Ring };
        let ends = [1.0, people.len().max(2) as f64];
        let points = people.iter().enumerate().map(of_person).collect();
        let lines = vec![
            line("in common", faint, ends.map(of_all).into(), Spread::Band),
            line("people", sheet.looks.look(&name), points, Spread::Bars),
        ];
        let heading = self.heading(panel, sheet.names);
        let description = format!("learned effects of people in the state {heading}");
        let note = "Means and 95 % of the posteriors.".to_owned();
        Chart { heading: Some(heading), description, lines, note }
    }
}

/// In how many trials an estimated deviation is held, and where.
fn held(panel: &ShrinkagePanel) -> String {
    let named = HeldDeviation::NAMED.iter().zip(panel.held).filter(|(_, trials)| *trials > 0);
    let words: Vec<String> = named.map(|((_, name), trials)| format!("{trials} {name}")).collect();
    if words.is_empty() { "none".to_owned() } else { words.join(", ") }
}

fn cells(panel: &ShrinkagePanel, names: &Names) -> Vec<TableEntry> {
    let mut cells = vec![
        arm(&panel.name, names),
        TableEntry::text(state_in_words(&panel.state)),
        TableEntry::number(panel.trials as f64, 0),
    ];
    for (OverTrials { low, median, high }, factor) in panel.over.iter().zip([1.0, 1.0, 100.0]) {
        let decimals = if factor > 1.0 { 0 } else { DECIMALS };
        if factor > 1.0 {
            cells.push(TableEntry::text(held(panel)));
        }
        cells.push(TableEntry::of(Ok::<_, Undefined>(factor * median), decimals));
        cells.push(TableEntry::text(range(factor * low, factor * high, decimals)));
    }
    cells.push(TableEntry::number(panel.first.people.len() as f64, 0));
    cells.push(TableEntry::number(panel.first.apart() as f64, 0));
    cells
}
