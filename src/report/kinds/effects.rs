//! Estimates of single jobs with their intervals, beside published ones.

use super::forest::{Across, ForestRow, ForestWords, MOST_ROWS, axis_around_zero, ends, forest};
use super::{Drawn, Sheet, parameter, per_moderator, related, unit_of_outcome};
use crate::analyse::Interval;
use crate::analyse::declared::{ArmId, EffectRow, EffectsFigure};
use crate::job::{Effect, Estimator, Measure, counted, distinct};
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{Axis, AxisScale, Marker, NumberFormat, facets, labels, round_range};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, range};

/// Decimals of estimates.
const DECIMALS: usize = 4;

impl Drawn for EffectsFigure {
    fn figures(&self, sheet: &Sheet<'_>) -> Vec<(String, Scene)> {
        let quantities = distinct(self.rows.iter().map(|row| quantity(row, sheet.metric)));
        let figures = quantities.into_iter().flat_map(|title| self.figures_of(title, sheet));
        sheet.numbered(figures.collect())
    }

    fn wholes(&self, sheet: &Sheet<'_>, panels: usize) -> Vec<(String, usize)> {
        // Figures differ in their numbers of rows, and stay apart.
        (0..panels).map(|_| (sheet.stem.to_owned(), 1)).collect()
    }

    fn table(&self, title: &str, _: Measure, names: &Names) -> DataTable {
        let of_policies = |row: &&EffectRow| row.declaration.estimator == Estimator::Value;
        let of_values = self.rows.iter().filter(of_policies).count();
        let heading = match of_values {
            0 => "Effect",
            all if all == self.rows.len() => "Value",
            _ => "Effect or value",
        };
        // Readers see the column where there are values alone.
        let size = ["effective_sample_size", ".effective_sample_size"][usize::from(of_values == 0)];
        let mut columns = vec![
            ("arm", "Arm"),
            ("seed", "Seed"),
            ("estimate", "Estimate"),
            ("estimator", "Estimator"),
            ("term", "Term"),
            ("value", heading),
            ("standard_error", "SE"),
            ("interval", "95 % interval"),
            (".low", ""),
            (".high", ""),
            ("p", "p"),
            ("decisions", "Decisions"),
            (size, "Effective sample size"),
            ("published", "Published"),
            ("published_standard_error", "Published SE"),
            ("published_p", "Published p"),
        ];
        let mut rows: Vec<Vec<TableEntry>> =
            self.rows.iter().map(|row| cells(row, names)).collect();
        if self.rows.iter().any(|row| row.of_trial.is_some()) {
            let place =
                columns.iter().position(|(name, _)| *name == "published").unwrap_or(columns.len());
            columns.insert(place, ("trial_mean", "Mean of the trial"));
            rows.iter_mut().zip(&self.rows).for_each(|(cells, row)| {
                let none = "not a value of the trial's outcome".to_owned();
                cells.insert(place, TableEntry::of(row.of_trial.ok_or(none), DECIMALS));
            });
        }
        let mut table = DataTable::new(title, &columns);
        table.rows = rows;
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let names = distinct(self.rows.iter().map(|row| row.declaration.name.as_str()));
        let beside = match self.rows.iter().any(|row| row.published.is_some()) {
            true => ", beside the published numbers",
            false => "",
        };
        let terms = match self.rows.iter().any(|row| row.declaration.estimator == Estimator::Value)
        {
            true => "; of the three terms of a value, doubly_robust mostly varies least",
            false => "",
        };
        format!("Estimates of {} with 95 % intervals{beside}{terms}", names.join(", "))
    }

    fn finds(&self, _: Measure, _: &Names) -> Option<String> {
        let published = |row: &&EffectRow| row.published.is_some() && row.effect.is_ok();
        let compared: Vec<&EffectRow> = self.rows.iter().filter(published).collect();
        if !compared.is_empty() {
            let same = compared.iter().filter(|row| row.is_published()).count();
            return Some(format!(
                "{same} of {} are the published ones to their last digit",
                counted(compared.len(), "number")
            ));
        }
        let row = self.rows.iter().find(|row| row.effect.is_ok())?;
        let effect = row.effect.as_ref().ok()?;
        let p = row.p().map_or_else(|_| String::new(), |p| format!(", p {}", related(p)));
        let ends = range(effect.low, effect.high, DECIMALS);
        let (name, value) = (&row.declaration.name, shown(effect.value, DECIMALS));
        Some(format!("{name}, {}: {value} ({ends}){p}", row.term))
    }

    fn lacks(&self) -> Option<String> {
        (self.lacking > 0)
            .then(|| format!("the estimates of {}", counted(self.lacking, "completed job")))
    }

    fn arms(&self) -> Vec<&ArmId> {
        distinct(self.rows.iter().map(|row| &row.name))
    }

    fn is_table(&self) -> bool {
        true
    }
}

impl EffectsFigure {
    /// The figures of the rows with a quantity, which is the title of their axis.
    fn figures_of(&self, title: String, sheet: &Sheet<'_>) -> Vec<Scene> {
        let rows = self.rows.iter().filter(|row| quantity(row, sheet.metric) == title);
        let rows: Vec<&EffectRow> = rows.collect();
        // Axes without any number would be an empty figure.
        if rows.iter().all(|row| row.effect.is_err()) {
            return Vec::new();
        }
        let known = distinct(rows.iter().map(|row| &row.name));
        let short = labels(&sheet.names.arms(known.iter().copied()).iter().collect::<Vec<_>>());
        let has_seeds = rows.iter().any(|row| row.seed != rows[0].seed);
        let draw = |row: &&EffectRow| {
            let arms = known.iter().zip(&short).filter(|_| known.len() > 1);
            let arm = arms.filter(|(name, _)| **name == &row.name).map(|(_, label)| label.clone());
            let seed = has_seeds.then(|| format!("seed {}", row.seed));
            let parts = arm.chain(seed).chain([row.label()]);
            forest_row(row, parts.collect::<Vec<_>>().join(", "), sheet.names)
        };
        let drawn: Vec<ForestRow> = rows.iter().map(draw).collect();
        let axis = match ends(&drawn, None) {
            // Nobody asks whether a value is 0, which can be far from all of them.
            Some((low, high)) if rows[0].is_value() => {
                let range = round_range(low, high);
                Axis::new(title.clone(), range, AxisScale::Linear, NumberFormat::Plain)
            }
            _ => axis_around_zero(&drawn, title.clone(), NumberFormat::Plain),
        };
        let across = Across::of(axis, &drawn, sheet.style);
        let is_published = rows.iter().any(|row| row.published.is_some());
        let diamonds = if is_published { " Diamonds: published." } else { "" };
        let words = ForestWords {
            heading: String::new(),
            note: format!("Estimates with 95 % intervals.{diamonds}"),
            description: format!("estimates with their intervals: {title}"),
        };
        let all: Vec<&ForestRow> = drawn.iter().collect();
        all.chunks(MOST_ROWS).map(|part| forest(part, &words, &across, sheet.style)).collect()
    }
}

/// What a row is an estimate of, with its unit. Rows of one quantity share an axis.
fn quantity(row: &EffectRow, metric: Measure) -> String {
    let unit = unit_of_outcome(&row.declaration.outcome, metric);
    match row.declaration.estimator {
        Estimator::Wcls => format!("effect, {unit}{}", per_moderator(&row.term)),
        Estimator::Emee => format!("log relative risk{}", per_moderator(&row.term)),
        Estimator::Value if row.is_value() => format!("value per decision, {unit}"),
        Estimator::Value => format!("difference of values per decision, {unit}"),
    }
}

impl EffectRow {
    /// The estimate and its term.
    fn label(&self) -> String {
        format!("{}: {}", self.declaration.name, self.term)
    }

    /// Whether it is the value of a policy, and no difference of two.
    fn is_value(&self) -> bool {
        self.declaration.is_value()
    }

    /// The p value of the hypothesis that there is no effect, or the reason for its absence.
    fn p(&self) -> Result<f64, String> {
        match self.is_value() {
            true => Err("a value of a policy is not tested against 0".to_owned()),
            false => self.number(|effect| effect.p_value),
        }
    }

    fn number(&self, of: fn(&Effect) -> f64) -> Result<f64, String> {
        self.effect.as_ref().map(of).map_err(Clone::clone)
    }

    /// Whether the estimate rounds to the published number.
    fn is_published(&self) -> bool {
        match (&self.effect, &self.published) {
            (Ok(effect), Some(published)) => {
                (effect.value - published.value).abs() <= published.rounding * (1.0 + 1e-9)
            }
            _ => false,
        }
    }
}

fn forest_row(row: &EffectRow, label: String, names: &Names) -> ForestRow {
    let effect = row.effect.as_ref().ok();
    let p = row.p().map_or_else(|_| String::new(), |p| format!(", p {}", related(p)));
    let words = effect.map(|effect| shown(effect.value, DECIMALS) + &p);
    let ends = effect.map(|effect| range(effect.low, effect.high, DECIMALS)).unwrap_or_default();
    let words = words.unwrap_or_else(|| "–".to_owned());
    let published = row.published.as_ref().map(|published| {
        (published.value, format!("{label}: published {}", parameter(published.value)))
    });
    ForestRow {
        tip: format!("{label}: {words}, 95 % interval {ends}"),
        label,
        words,
        value: effect.map(|effect| effect.value),
        interval: effect.map(|effect| Interval { low: effect.low, high: effect.high }),
        marker: Marker::Disc,
        published,
        facets: facets(&names.arm(&row.name)),
    }
}

fn cells(row: &EffectRow, names: &Names) -> Vec<TableEntry> {
    let of = |number: fn(&Effect) -> f64, decimals| TableEntry::of(row.number(number), decimals);
    let published = |number: Option<f64>| {
        TableEntry::published(
            number.map(|number| TableEntry::Number { value: number, shown: parameter(number) }),
        )
    };
    let of_publication = row.published.as_ref();
    let size = row.effect.clone().and_then(|effect| {
        effect
            .effective_sample_size
            .ok_or_else(|| "an effect has no effective sample size".to_owned())
    });
    vec![
        arm(&row.name, names),
        TableEntry::number(row.seed as f64, 0),
        TableEntry::text(&row.declaration.name),
        TableEntry::text(row.declaration.estimator.word()),
        TableEntry::text(&row.term),
        of(|effect| effect.value, DECIMALS),
        of(|effect| effect.standard_error, DECIMALS),
        match &row.effect {
            Ok(effect) => TableEntry::text(range(effect.low, effect.high, DECIMALS)),
            Err(why) => TableEntry::Missing(why.clone()),
        },
        of(|effect| effect.low, DECIMALS),
        of(|effect| effect.high, DECIMALS),
        TableEntry::p(row.p()),
        of(|effect| effect.decisions as f64, 0),
        TableEntry::of(size, 0),
        published(of_publication.map(|one| one.value)),
        published(of_publication.and_then(|one| one.standard_error)),
        published(of_publication.and_then(|one| one.p)),
    ]
}
