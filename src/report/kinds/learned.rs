//! What trials learned about the effect of a message in states, beside trials without this effect.

use super::{Drawn, Sheet, parameter, related};
use crate::analyse::declared::{ArmId, LearnedFigure, LearnedPanel, LearnedPoint, OverTrials};
use crate::analyse::{CHANCE, Interval, MonteCarloMean, Undefined};
use crate::job::{Measure, MetricUnit, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, FAINT, Line, Look, Marker, NumberFormat, PlottedPoint, Spread, arm_label,
    axes_of, draw, facets,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, between, high, in_unit, low, range, scaled};

/// Decimals of the statistic.
const DECIMALS: usize = 2;

impl Drawn for LearnedFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let drawn: Vec<&LearnedPanel> =
            self.panels.iter().filter(|panel| !panel.points.is_empty()).collect();
        let charts: Vec<Chart> = drawn.iter().map(|panel| self.chart(panel, sheet)).collect();
        if charts.is_empty() {
            return Vec::new();
        }
        let scale = sheet.style.x_scale(AxisScale::Linear);
        let x = ("day of the trial".to_owned(), NumberFormat::Plain, scale);
        let y = ("effect / standard deviation".to_owned(), NumberFormat::Plain);
        let axes = axes_of(&charts, x, y, sheet.style);
        sheet.numbered(draw(&charts, &axes, sheet.style))
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let columns = [
            ("arm", "Arm"),
            ("state", "State"),
            ("trials", "Trials"),
            ("trials_without", "Trials without effect"),
            ("statistic", "Statistic, median"),
            (".statistic_low", ""),
            (".statistic_high", ""),
            ("without", "Without effect, median"),
            ("without_range", "2.5 to 97.5 %"),
            (".without_low", ""),
            (".without_high", ""),
            ("p_value", "p, median"),
            ("rejected", "p ≤ 0.05, % of trials"),
            ("rejected_interval", "95 % interval"),
            (".rejected_low", ""),
            (".rejected_high", ""),
        ];
        let mut table = DataTable::new(title, &columns);
        table.rows = self.panels.iter().map(|panel| cells(panel, names)).collect();
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let each = |side: usize| {
            let counts = self.panels.iter().map(|panel| panel.trials[side]);
            let (least, most) = (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0));
            match least == most {
                true => counted(most, "trial"),
                false => format!("{least} to {most} trials"),
            }
        };
        format!(
            "Learned effect of a message in a state, divided by its posterior standard deviation, in {} and in {} without \
             an effect in this state: medians, and 95 % of the trials",
            each(0),
            each(1)
        )
    }

    fn finds(&self, _: Measure, names: &Names) -> Option<String> {
        let known: Vec<(&LearnedPanel, MonteCarloMean)> = self
            .panels
            .iter()
            .filter_map(|panel| Some((panel, panel.judged.share.ok()?)))
            .collect();
        let by_share = |one: &&(&LearnedPanel, MonteCarloMean),
                        other: &&(&LearnedPanel, MonteCarloMean)| {
            one.1.value.total_cmp(&other.1.value)
        };
        let few = || {
            let reason = self.panels.iter().find_map(|panel| panel.judged.share.err())?;
            let few = matches!(reason, Undefined::TooFewReferences { .. });
            few.then(|| format!("More than chance cannot be shown: {reason}"))
        };
        let Some(most) = known.iter().max_by(by_share) else { return few() };
        let least = known.iter().min_by(by_share)?;
        let sentence =
            |(panel, share): &(&LearnedPanel, MonteCarloMean)| self.sentence(panel, *share, names);
        let is_clear = |(_, share): &&(&LearnedPanel, MonteCarloMean)| {
            share.interval.is_ok_and(|interval| interval.low > CHANCE)
        };
        let clear = known.iter().filter(is_clear).count();
        Some(match known.len() {
            1 if clear == 1 => format!("More than chance (p ≤ 0.05): {}", sentence(most)),
            1 => {
                format!("Not shown to be more than the 5 % of chance: p ≤ 0.05 {}", sentence(most))
            }
            count => format!(
                "p ≤ 0.05 most often {}, and least often {}, of {}; shown to be more than the 5 % of chance in {clear}",
                sentence(most),
                sentence(least),
                counted(count, "state")
            ),
        })
    }

    fn lacks(&self) -> Option<String> {
        if self.panels.is_empty() {
            return Some("no completed trial has posteriors of these states".to_owned());
        }
        (self.lacking > 0).then(|| {
            format!("{} without posteriors of these states", counted(self.lacking, "trial"))
        })
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.panels.iter().map(|panel| &panel.name))
    }
}

impl LearnedFigure {
    /// The heading of a panel: its state, and its arm if there are several.
    fn heading(&self, panel: &LearnedPanel, names: &Names) -> String {
        match self.arms().len() {
            1 => state_in_words(&panel.state),
            _ => format!("{}, {}", state_in_words(&panel.state), names.label(&panel.name)),
        }
    }

    fn chart(&self, panel: &LearnedPanel, sheet: &Sheet<'_>) -> Chart {
        let name = sheet.names.arm(&panel.name);
        let heading = self.heading(panel, sheet.names);
        let without = Look { color: FAINT, dash: Some((2.6, 1.6)), marker: Marker::Ring };
        let line = |side: usize, label: &str, look: Look| {
            let n = panel.trials[side];
            let point = |point: &LearnedPoint| {
                let OverTrials { low, median, high } = point.over[side];
                let tip = format!(
                    "{}, {label}, day {}: {}, {}",
                    arm_label(&name),
                    shown(point.day, 0),
                    shown(median, DECIMALS),
                    counted(n, "trial")
                );
                let interval = (n > 1).then_some((low, high));
                PlottedPoint { x: point.day, y: median, interval, is_single: false, tip }
            };
            Line {
                label: label.to_owned(),
                look,
                points: panel.points.iter().map(point).collect(),
                reference: Vec::new(),
                spread: Spread::Band,
                facets: facets(&name),
            }
        };
        let lines =
            vec![line(0, "trials", sheet.looks.look(&name)), line(1, "without effect", without)];
        let description = format!("learned effect in the state {heading}");
        let note = "Medians, and 95 % of the trials.".to_owned();
        Chart { heading: Some(heading), description, lines, note }
    }

    /// In how many trials of a panel more was learned than by chance.
    fn sentence(&self, panel: &LearnedPanel, share: MonteCarloMean, names: &Names) -> String {
        let heading = self.heading(panel, names);
        if let [p] = panel.judged.p_values[..] {
            return format!("in {heading} (p {})", related(p));
        }
        let ends = share.interval.map_or_else(
            |_| String::new(),
            |Interval { low, high }| format!(", {} %", range(100.0 * low, 100.0 * high, 1)),
        );
        let all = counted(panel.trials[0], "trial");
        format!("in {heading} ({} % of {all}{ends})", shown(100.0 * share.value, 1))
    }
}

/// A state in words: `(1, −0.7, −0.1, 0)`.
pub(super) fn state_in_words(state: &[f64]) -> String {
    let numbers: Vec<String> = state.iter().map(|number| parameter(*number)).collect();
    format!("({})", numbers.join(", "))
}

fn cells(panel: &LearnedPanel, names: &Names) -> Vec<TableEntry> {
    let last = panel.points.last().ok_or(Undefined::NoSeeds);
    let over = |side: usize, rate: fn(&OverTrials) -> f64| {
        TableEntry::of(last.map(|last| rate(&last.over[side])), DECIMALS)
    };
    let rejected = panel.judged.share;
    let interval = rejected.and_then(|share| share.interval);
    let without = last.map(|last| Interval { low: last.over[1].low, high: last.over[1].high });
    vec![
        arm(&panel.name, names),
        TableEntry::text(state_in_words(&panel.state)),
        TableEntry::number(panel.trials[0] as f64, 0),
        TableEntry::number(panel.trials[1] as f64, 0),
        over(0, |all| all.median),
        over(0, |all| all.low),
        over(0, |all| all.high),
        over(1, |all| all.median),
        scaled(without, (1.0, DECIMALS)),
        low(without),
        high(without),
        TableEntry::p(panel.median_p()),
        in_unit(rejected.map(|share| share.value), MetricUnit::Share),
        between(interval, MetricUnit::Share),
        low(interval),
        high(interval),
    ]
}
