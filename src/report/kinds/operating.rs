//! Operating characteristics of estimates: power, coverage and bias over trials.

use super::{Drawn, Sheet, parameter, per_moderator, unit_of_outcome};
use crate::analyse::declared::{ArmId, FEW_TRIALS, OperatingFigure, OperatingRow, Sought, Term};
use crate::analyse::{Along, Crossing, Interval, LEVEL, MonteCarloMean, Undefined};
use crate::job::{Measure, MetricUnit, counted, distinct};
use crate::manifest::Find;
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{
    AxisScale, Chart, Line, NumberFormat, Panels, PlottedPoint, Spread, arm_label, axes_of, draw,
    facets,
};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::symbols;
use crate::report::tables::{arm, between, high, in_unit, low, range, scaled};

/// The columns of the table, before those of diagnosands.
pub(in crate::report) const COLUMNS: [(&str, &str); 41] = [
    ("arm", "Arm"),
    ("estimate", "Estimate"),
    ("term", "Term"),
    ("x", "x"),
    ("trials", "Trials"),
    ("failed", "Failed"),
    ("truth", "True effect"),
    (".truth_low", ""),
    (".truth_high", ""),
    ("bias", "Bias"),
    ("bias_interval", "95 % interval"),
    (".bias_low", ""),
    (".bias_high", ""),
    ("empirical_error", "SD of estimates"),
    (".empirical_error_low", ""),
    (".empirical_error_high", ""),
    ("mean_error", "Mean SE"),
    (".mean_error_low", ""),
    (".mean_error_high", ""),
    ("coverage", "Coverage, %"),
    ("coverage_interval", "95 % interval"),
    (".coverage_low", ""),
    (".coverage_high", ""),
    ("power", "Power, %"),
    ("power_interval", "95 % interval"),
    (".power_low", ""),
    (".power_high", ""),
    ("rmse", "RMSE"),
    (".rmse_low", ""),
    (".rmse_high", ""),
    ("mean_length", "Mean length"),
    (".mean_length_low", ""),
    (".mean_length_high", ""),
    ("type_s", "Type S, %"),
    ("type_s_interval", "95 % interval"),
    (".type_s_low", ""),
    (".type_s_high", ""),
    ("exaggeration", "Exaggeration"),
    ("exaggeration_interval", "95 % interval"),
    (".exaggeration_low", ""),
    (".exaggeration_high", ""),
];

/// What a figure shows of the rows, over the axis.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shown {
    Power,
    Coverage,
    Bias,
}

impl Shown {
    fn word(self) -> &'static str {
        match self {
            Shown::Power => "power",
            Shown::Coverage => "coverage",
            Shown::Bias => "bias",
        }
    }

    fn of(self, row: &OperatingRow) -> Result<MonteCarloMean, Undefined> {
        match self {
            Shown::Power => row.operating.power,
            Shown::Coverage => row.operating.coverage,
            Shown::Bias => row.operating.bias,
        }
    }
}

impl Drawn for OperatingFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let Some(axis) = &self.axis else { return Vec::new() };
        let terms = self.terms();
        let of_term = |(number, term): (usize, &&Term)| {
            // One estimate with one term needs no number.
            let stem = match terms.len() {
                1 => sheet.stem.to_owned(),
                _ => format!("{}-{}", sheet.stem, number + 1),
            };
            let mut scenes = Vec::new();
            for group in [&[Shown::Power, Shown::Coverage][..], &[Shown::Bias]] {
                let charts = group.iter().map(|what| (*what, self.chart(*what, term, sheet)));
                let has_points =
                    |chart: &Chart| chart.lines.iter().any(|line| !line.points.is_empty());
                let (kinds, charts): (Vec<Shown>, Vec<Chart>) =
                    charts.filter(|(_, chart)| has_points(chart)).unzip();
                if charts.is_empty() {
                    continue;
                }
                let scale = sheet.style.x_scale(AxisScale::Linear);
                let (title, numbers) = match group[0] {
                    Shown::Bias => {
                        let unit = unit_of_outcome(&term.outcome, sheet.metric);
                        let title = format!("bias, {unit}{}", per_moderator(&term.term));
                        (title, NumberFormat::Plain)
                    }
                    _ => ("share of trials, %".to_owned(), NumberFormat::Percent),
                };
                let x = (symbols::quantity(axis), NumberFormat::Plain, scale);
                let axes = axes_of(&charts, x, (title, numbers), sheet.style);
                let stems = kinds.iter().map(|what| format!("{stem}-{}", what.word()));
                scenes.extend(stems.zip(draw(&charts, &axes, sheet.style)));
            }
            scenes
        };
        terms.iter().enumerate().flat_map(of_term).collect()
    }

    fn has_figures(&self) -> bool {
        self.axis.is_some()
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let axis = self.axis.as_deref().map(symbols::short);
        let x = match axis.as_deref() {
            Some(axis) => ("x", axis),
            None => (".x", "x"),
        };
        let known = COLUMNS.map(|column| if column.0 == "x" { x } else { column });
        let own = self.rows.iter().map(|row| &row.diagnosands).max_by_key(|all| all.len());
        let own = own.into_iter().flatten().flat_map(|(name, _)| {
            let end = |end: &str| (format!(".{name}_{end}"), String::new());
            let interval = (format!("{name}_interval"), "95 % interval".to_owned());
            [(name.clone(), name.clone()), interval, end("low"), end("high")]
        });
        let own: Vec<(String, String)> = own.collect();
        let own = own.iter().map(|(name, heading)| (name.as_str(), heading.as_str()));
        let columns: Vec<(&str, &str)> = known.into_iter().chain(own).collect();
        let mut table = DataTable::new(title, &columns);
        let decimals = self.decimals();
        table.rows = self.rows.iter().map(|row| cells(row, decimals, names)).collect();
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let terms = self.terms();
        let mut names: Vec<&str> = terms.iter().map(|term| term.estimate.as_str()).collect();
        names.dedup();
        let trials = self.rows.iter().map(|row| row.operating.trials);
        let (least, most) = (trials.clone().min().unwrap_or(0), trials.max().unwrap_or(0));
        let trials = match least == most {
            true => counted(most, "trial"),
            false => format!("{least} to {most} trials"),
        };
        format!(
            "Operating characteristics of {} over {trials} per arm; 95 % Monte Carlo intervals",
            names.join(", ")
        )
    }

    fn finds(&self, _: Measure, names: &Names) -> Option<String> {
        let mut found: Vec<String> = match &self.sought {
            None => self.covers().into_iter().collect(),
            Some((find, sought)) => {
                sought.iter().map(|one| self.reaches(one, *find, names)).collect()
            }
        };
        let wide = self.rows.iter().filter_map(|row| Some((row.operating.excess()?, &row.term)));
        found.extend(wide.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(times, term)| {
            format!(
                "The mean SE of {} is up to {} times the SD of estimates: these standard errors have no use here",
                term.estimate,
                shown(times, 0)
            )
        }));
        (!found.is_empty()).then(|| found.join(". "))
    }

    fn lacks(&self) -> Option<String> {
        if self.rows.is_empty() {
            return Some("no completed job has an estimate; `jitai run` computes them".to_owned());
        }
        let failed: usize = self.rows.iter().map(|row| row.failures().count()).sum();
        let reason = self.rows.iter().find_map(|row| row.failures().next());
        let failed = reason
            .map(|reason| format!("{}, the first because {reason}", counted(failed, "estimate")));
        let lacking: usize = self.rows.iter().map(|row| row.lacking).sum();
        let lacking = (lacking > 0)
            .then(|| format!("{} that `jitai run` computes", counted(lacking, "estimate")));
        let all: Vec<String> = failed.into_iter().chain(lacking).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.rows.iter().map(|row| &row.name))
    }

    fn is_table(&self) -> bool {
        self.axis.is_none()
    }
}

impl OperatingFigure {
    /// The terms, in order.
    fn terms(&self) -> Vec<&Term> {
        let mut terms: Vec<&Term> = self.rows.iter().map(|row| &row.term).collect();
        terms.dedup();
        terms
    }

    /// Decimals that show the standard errors with three digits.
    fn decimals(&self) -> usize {
        let errors = self.rows.iter().filter_map(|row| row.operating.mean_error.ok());
        let least = errors.map(|error| error.value).filter(|error| *error > 0.0);
        decimals_of(least.fold(f64::INFINITY, f64::min))
    }

    fn chart(&self, what: Shown, term: &Term, sheet: &Sheet<'_>) -> Chart {
        let arms = sheet.names.arms(self.arms());
        let known = self.arms();
        let names: Vec<&ArmId> = arms.iter().collect();
        let panels = Panels::whole(&names);
        let looks = panels.looks(sheet.looks, &names);
        let xs = self.rows.iter().filter_map(|row| row.x);
        let ends =
            xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let level = match what {
            Shown::Power => self.sought.as_ref().map(|(find, _)| find.power),
            Shown::Coverage => Some(LEVEL),
            Shown::Bias => Some(0.0),
        };
        let mut lines: Vec<Line> = Vec::new();
        for (at, arm) in known.iter().enumerate() {
            let rows = self.rows.iter().filter(|row| row.name == **arm && row.term == *term);
            let name = arm_label(&arms[at]);
            let draw = |row: &OperatingRow| {
                let (x, found) = (row.x?, what.of(row).ok()?);
                let interval = found.interval.ok().map(|ends| (ends.low, ends.high));
                let value = match what {
                    Shown::Bias => shown(found.value, self.decimals()),
                    _ => format!("{} %", shown(100.0 * found.value, 1)),
                };
                let tip = format!(
                    "{name}, {} = {}: {} {value}, {}",
                    symbols::short(self.axis.as_deref().unwrap_or_default()),
                    parameter(x),
                    what.word(),
                    counted(row.operating.trials, "trial"),
                );
                Some(PlottedPoint { x, y: found.value, interval, is_single: false, tip })
            };
            let points: Vec<PlottedPoint> = rows.filter_map(draw).collect();
            // The level stands once, in the look of the first line with points.
            let is_drawn = lines.iter().any(|line| !line.reference.is_empty());
            let level = level.filter(|_| !is_drawn && !points.is_empty());
            lines.push(Line {
                label: panels.labels[at].clone(),
                look: looks.look(&panels.arms[at]),
                points,
                reference: level.map_or_else(Vec::new, |y| vec![(ends.0, y), (ends.1, y)]),
                spread: Spread::Bars,
                facets: facets(&arms[at]),
            });
        }
        let note = match level {
            Some(_) if what == Shown::Bias => " Thin: no bias.".to_owned(),
            Some(level) => format!(" Thin: {} %.", shown(100.0 * level, 0)),
            None => String::new(),
        };
        let term = match self.terms().len() {
            1 => String::new(),
            _ => format!(" of {}: {}", term.estimate, term.term),
        };
        let heading = format!("{}{term}", what.word());
        let description = format!("{heading} over trials");
        let note = format!("95 % Monte Carlo intervals.{note}");
        Chart { heading: Some(heading), description, lines, note }
    }

    /// Whether intervals hold the truth as often as they should, for each estimate.
    fn covers(&self) -> Option<String> {
        let mut names: Vec<&str> = self.rows.iter().map(|row| row.term.estimate.as_str()).collect();
        names.dedup();
        let describe = |name: &&str| {
            let rows = self.rows.iter().filter(|row| row.term.estimate == **name);
            let said = coverage_of(&rows.collect::<Vec<_>>())?;
            Some(if names.len() == 1 { said } else { format!("{name}: {said}") })
        };
        let all: Vec<String> = names.iter().filter_map(describe).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }

    /// Where a line reaches a power, beside what the formula says.
    fn reaches(&self, sought: &Sought, find: Find, names: &Names) -> String {
        let terms = self.terms().len() > 1;
        let of_term = match terms {
            true => format!(", {} of {}", sought.term.term, sought.term.estimate),
            false => String::new(),
        };
        let who = names.label(&sought.name) + &of_term;
        let goal = format!("a power of {} %", shown(100.0 * find.power, 0));
        let along = if find.effect.is_some() { Along::Effect } else { Along::People };
        let key = find.effect.map(|key| symbols::short(&key.to_string()));
        let (point, points) = match &key {
            None => ("number of people".to_owned(), "numbers of people".to_owned()),
            Some(key) => (format!("value of {key}"), format!("values of {key}")),
        };
        let value = |value: f64| match &key {
            None => format!("{} people", shown(value, 0)),
            Some(key) => format!("{key} = {}", parameter(value)),
        };
        let at =
            |(x, power): (f64, f64)| format!("{} % with {}", shown(100.0 * power, 1), value(x));
        let found = match sought.simulated {
            _ if sought.trials < FEW_TRIALS => format!(
                "{who} has {} per {point}, too few for {goal}: declare {FEW_TRIALS} or more seeds",
                counted(sought.trials, "trial")
            ),
            Some(found) => match along {
                Along::People => {
                    let ends = interval(found, people, "fewer than simulated");
                    format!("{who} reaches {goal} with {} people ({ends})", people(found.at))
                }
                Along::Effect => {
                    let three = |number: f64| parameter(with_three_digits(number));
                    let ends = interval(found, three, "less than simulated");
                    let effect = sought.truth.map_or_else(String::new, |truth| {
                        let effect = |number: f64| shown(number, self.decimals());
                        let ends = interval(truth, effect, "less than simulated");
                        format!(", a true effect of {} ({ends})", effect(truth.at))
                    });
                    format!(
                        "{who} reaches {goal} with {} ({ends}){effect}",
                        value(with_three_digits(found.at))
                    )
                }
            },
            None if sought.ends[0].1 >= find.power => {
                format!("{who} has more than {goal} already: {}", at(sought.ends[0]))
            }
            None => format!(
                "{who} does not reach {goal} between the simulated {points}: {} and {}",
                at(sought.ends[0]),
                at(sought.ends[1])
            ),
        };
        let formula = sought.formula.map(|formula| match along {
            Along::People => shown(formula, 0),
            Along::Effect => format!("an effect of {}", shown(formula, self.decimals())),
        });
        let formula = formula.map_or_else(String::new, |formula| {
            let outside = if sought.differs(along) { ", outside this interval" } else { "" };
            format!("; the formula of Liao et al. (2016) gives {formula}{outside}")
        });
        found + &self.before(sought, find, value) + &formula
    }

    /// A first simulated value whose power falls below what is sought before it rises to it: a clause, or nothing.
    fn before(&self, sought: &Sought, find: Find, value: impl Fn(f64) -> String) -> String {
        let (first, power) = sought.ends[0];
        if sought.simulated.is_none() || sought.trials < FEW_TRIALS || power < find.power {
            return String::new();
        }
        let is_first = |row: &&OperatingRow| {
            (&row.name, &row.term, row.x) == (&sought.name, &sought.term, Some(first))
        };
        let truth = self.rows.iter().find(is_first).and_then(|row| row.operating.truth.ok());
        let is_opposite = truth.zip(sought.truth).is_some_and(|(one, at)| one.value * at.at < 0.0);
        let why = match is_opposite {
            true => "where the true effect has the other sign",
            false => "and less in between",
        };
        format!("; with {} the power is {} % already, {why}", value(first), shown(100.0 * power, 1))
    }
}

/// The interval of what is found, in words.
fn interval(found: Crossing, number: impl Fn(f64) -> String, less: &str) -> String {
    let least = found.low.map_or(less.to_owned(), &number);
    let most = found.high.map_or("more than simulated".to_owned(), &number);
    format!("95 % interval {least} to {most}")
}

/// Decimals that show a size with three digits.
fn decimals_of(size: f64) -> usize {
    if size.is_finite() { (2.0 - size.log10().floor()).clamp(0.0, 9.0) as usize } else { 2 }
}

/// A number with three digits.
fn with_three_digits(number: f64) -> f64 {
    let scale = 10_f64.powf(2.0 - number.abs().log10().floor());
    if scale.is_finite() && scale > 0.0 { (number * scale).round() / scale } else { number }
}

/// Whether the intervals of some rows hold the truth as often as they should.
fn coverage_of(rows: &[&OperatingRow]) -> Option<String> {
    let known: Vec<MonteCarloMean> =
        rows.iter().filter_map(|row| row.operating.coverage.ok()).collect();
    let share = |of: &MonteCarloMean| {
        let ends = of.interval.map_or_else(
            |_| String::new(),
            |Interval { low, high }| format!(" ({} %)", range(100.0 * low, 100.0 * high, 1)),
        );
        format!("{} %{ends}", shown(100.0 * of.value, 1))
    };
    match known.as_slice() {
        [] => None,
        [one] => {
            Some(format!("95 % intervals hold the true effect in {} of the trials", share(one)))
        }
        all => {
            let nominal =
                |one: &&MonteCarloMean| one.interval.is_ok_and(|ends| ends.contains(LEVEL));
            let least = all.iter().min_by(|a, b| a.value.total_cmp(&b.value))?;
            Some(format!(
                "{} of {} coverages agree with 95 %; the least is {}",
                all.iter().filter(nominal).count(),
                all.len(),
                share(least)
            ))
        }
    }
}

/// A number of people that suffices.
fn people(number: f64) -> String {
    shown(number.ceil(), 0)
}

fn cells(row: &OperatingRow, decimals: usize, names: &Names) -> Vec<TableEntry> {
    let of = &row.operating;
    let ends = |value: Result<MonteCarloMean, Undefined>| value.and_then(|value| value.interval);
    let plain = |value: Result<MonteCarloMean, Undefined>| {
        TableEntry::of(value.map(|value| value.value), decimals)
    };
    let mut cells = vec![
        arm(&row.name, names),
        TableEntry::text(row.term.estimate.clone()),
        TableEntry::text(row.term.term.clone()),
        match row.x {
            Some(value) => TableEntry::Number { value, shown: parameter(value) },
            None => TableEntry::Missing("the arm lacks the parameter".to_owned()),
        },
        TableEntry::number(of.trials as f64, 0),
        TableEntry::number(row.failures().count() as f64, 0),
    ];
    let with_ends = |cells: &mut Vec<TableEntry>, value, entries: Vec<TableEntry>| {
        cells.extend(entries);
        cells.extend([low(ends(value)), high(ends(value))]);
    };
    with_ends(&mut cells, of.truth, vec![plain(of.truth)]);
    with_ends(&mut cells, of.bias, vec![plain(of.bias), scaled(ends(of.bias), (1.0, decimals))]);
    for value in [of.empirical_error, of.mean_error] {
        with_ends(&mut cells, value, vec![plain(value)]);
    }
    let share = |value: Result<MonteCarloMean, Undefined>| {
        let share = in_unit(value.map(|share| share.value), MetricUnit::Share);
        vec![share, between(ends(value), MetricUnit::Share)]
    };
    for value in [of.coverage, of.power] {
        with_ends(&mut cells, value, share(value));
    }
    for value in [of.root_mean_square_error, of.mean_length] {
        with_ends(&mut cells, value, vec![plain(value)]);
    }
    with_ends(&mut cells, of.type_s, share(of.type_s));
    let times = TableEntry::of(of.exaggeration.map(|times| times.value), 2);
    let times = vec![times, scaled(ends(of.exaggeration), (1.0, 2))];
    with_ends(&mut cells, of.exaggeration, times);
    for (_, own) in &row.diagnosands {
        match own {
            Ok(value) => {
                // The size of the user's numbers is not that of the estimates.
                let decimals = value.interval.map_or(decimals, |of| decimals_of(of.high - of.low));
                let entries = vec![
                    TableEntry::number(value.value, decimals),
                    scaled(value.interval, (1.0, decimals)),
                ];
                with_ends(&mut cells, Ok(*value), entries);
            }
            Err(why) => cells.extend([why; 4].map(|why| TableEntry::Missing(why.clone()))),
        }
    }
    cells
}
