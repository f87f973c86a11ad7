//! Tables that belong to no kind of analysis, and entries that all tables use.

use super::data_table::{DataTable, TableEntry, shown, shown_ends};
use super::figure::{NumberFormat, arm_key, settings_key};
use super::names::Names;
use super::words::unit_numbers;
use crate::analyse::declared::{ArmId, Comparison, Reproduction, varying};
use crate::analyse::{Interval, Undefined, Verdict};
use crate::job::{MetricUnit, Scalar};
use crate::record::{JobRecord, JobStatus};

/// The name of an arm.
pub fn arm(name: &ArmId, names: &Names) -> TableEntry {
    TableEntry::name(arm_key(name), names.label(name))
}

/// A number in its displayed unit.
pub fn in_unit(value: Result<f64, Undefined>, unit: impl Into<MetricUnit>) -> TableEntry {
    match (value, unit_numbers(unit)) {
        (Ok(value), (NumberFormat::Percent, decimals)) => {
            TableEntry::Number { value, shown: shown(value * 100.0, decimals) }
        }
        (value, (_, decimals)) => TableEntry::of(value, decimals.max(1)),
    }
}

/// An interval in displayed form.
pub fn between(interval: Result<Interval, Undefined>, unit: impl Into<MetricUnit>) -> TableEntry {
    match unit_numbers(unit) {
        (NumberFormat::Percent, decimals) => scaled(interval, (100.0, decimals)),
        (NumberFormat::Plain, decimals) => scaled(interval, (1.0, decimals.max(1))),
    }
}

/// The ends of an interval, times a factor.
pub fn scaled(
    interval: Result<Interval, Undefined>,
    (factor, decimals): (f64, usize),
) -> TableEntry {
    match interval {
        Ok(Interval { low, high }) => {
            TableEntry::text(range(factor * low, factor * high, decimals))
        }
        Err(reason) => TableEntry::Missing(reason.to_string()),
    }
}

/// The ends of an interval: "1.5 to 2.5".
pub fn range(low: f64, high: f64, decimals: usize) -> String {
    shown_ends(low, high, decimals).join(" to ")
}

/// The lower end of an interval.
pub fn low(interval: Result<Interval, Undefined>) -> TableEntry {
    TableEntry::of(interval.map(|interval| interval.low), 1)
}

/// The upper end of an interval.
pub fn high(interval: Result<Interval, Undefined>) -> TableEntry {
    TableEntry::of(interval.map(|interval| interval.high), 1)
}

/// The reason why the mean of this many seeds has no confidence interval.
pub fn no_interval(seeds: usize) -> Undefined {
    match seeds {
        0 => Undefined::NoSeeds,
        1 => Undefined::TooFewSeeds { have: 1, need: 2 },
        _ => Undefined::NoVariance,
    }
}

/// All published numbers, with ours beside them.
pub fn reproduction(reproduction: &Reproduction) -> DataTable {
    let columns = [
        ("subject", "Subject"),
        ("competitor", "Published for"),
        ("agent", "Agent"),
        ("scenario", "Scenario"),
        ("settings", "At"),
        ("published", "Published"),
        ("published_standard_error", "SE"),
        (".published_p", ""),
        ("ours", "Ours"),
        ("our_standard_error", "SE"),
        ("seeds", "n"),
        ("difference", "Ours − published"),
        ("joint_interval", "Joint 95 % interval"),
        (".joint_low", ""),
        (".joint_high", ""),
        ("verdict", "Verdict"),
        ("equivalence_bound", "Equivalent within ±"),
        (".margin", ""),
        ("equivalent", "Equivalent within the margin"),
    ];
    let mut table = DataTable::new("Published numbers beside ours", &columns);
    table.rows = reproduction.comparisons.iter().map(comparison).collect();
    table
}

fn comparison(one: &Comparison) -> Vec<TableEntry> {
    let settings = one.settings.iter().map(|(name, value)| format!("{name}={value}"));
    let is_rate = one.is_rate();
    let decimals = if is_rate { 4 } else { 1 };
    let interval = one.agreement.as_ref().map(|agreement| agreement.interval).map_err(|e| *e);
    vec![
        TableEntry::text(&one.subject),
        match one.competitor.as_str() {
            "" => TableEntry::Missing("ours".to_owned()),
            name => TableEntry::text(name),
        },
        TableEntry::text(&one.agent),
        TableEntry::text(&one.scenario),
        TableEntry::text(settings.collect::<Vec<_>>().join(" ")),
        TableEntry::number(one.published, decimals),
        TableEntry::of(one.published_error, decimals),
        one.published_p
            .map_or_else(|| TableEntry::Missing("none".to_owned()), |p| TableEntry::number(p, 5)),
        TableEntry::of(one.ours, decimals),
        TableEntry::of(one.our_error, decimals),
        TableEntry::number(one.seeds as f64, 0),
        TableEntry::of(one.agreement.as_ref().map(|agreement| agreement.difference), decimals),
        scaled(interval, (1.0, decimals)),
        low(interval),
        high(interval),
        TableEntry::text(match &one.agreement {
            Ok(agreement) => match (agreement.verdict, one.competitor.is_empty()) {
                (Verdict::Inside, true) => "inside".to_owned(),
                (Verdict::Outside, true) => "outside".to_owned(),
                (Verdict::Inside, false) => "no difference shown".to_owned(),
                (Verdict::Outside, false) if agreement.difference > 0.0 => {
                    "ours is higher".to_owned()
                }
                (Verdict::Outside, false) => "ours is lower".to_owned(),
            },
            Err(reason) => reason.to_string(),
        }),
        TableEntry::of(
            one.agreement.as_ref().map(|one| one.equivalence_bound).map_err(|e| *e),
            decimals,
        ),
        match one.margin {
            Some(margin) => TableEntry::number(margin, decimals),
            None => TableEntry::Missing("no margin declared".to_owned()),
        },
        match (one.margin, one.is_equivalent()) {
            (None, _) => TableEntry::Missing("no margin declared".to_owned()),
            (Some(_), Some(true)) => TableEntry::text("yes"),
            (Some(_), Some(false)) => TableEntry::text("not shown"),
            (Some(_), None) => TableEntry::Missing("not compared".to_owned()),
        },
    ]
}

/// The jobs that failed, with their reasons.
pub fn failures<'j>(experiments: impl Iterator<Item = (&'j str, &'j [JobRecord])>) -> DataTable {
    let columns = [
        ("experiment", "Experiment"),
        ("agent", "Agent"),
        ("scenario", "Scenario"),
        ("settings", "Settings"),
        ("seed", "Seed"),
        ("kind", "Failure"),
        ("reason", "Reason"),
        ("episode", "After episode"),
        ("job_key", "Job key"),
    ];
    let mut table = DataTable::new("Failed jobs", &columns);
    for (experiment, jobs) in experiments {
        let told_by = varying(&jobs.iter().collect::<Vec<_>>());
        for job in jobs {
            table.rows.extend(failed(experiment, job, &told_by));
        }
    }
    table
}

fn failed(experiment: &str, job: &JobRecord, told_by: &[String]) -> Option<Vec<TableEntry>> {
    let JobStatus::Failed(failure) = &job.status else { return None };
    let setting = |name: &String| Some((name.clone(), job.setting(name)?.clone()));
    let settings: Vec<(String, Scalar)> = told_by.iter().filter_map(setting).collect();
    Some(vec![
        TableEntry::text(experiment),
        TableEntry::text(&*job.agent),
        TableEntry::text(&job.scenario),
        TableEntry::text(settings_key(&settings)),
        TableEntry::number(job.seed as f64, 0),
        TableEntry::text(failure.kind.word()),
        TableEntry::text(&failure.message),
        TableEntry::number(f64::from(failure.episode), 0),
        TableEntry::text(job.job_key.to_string()),
    ])
}
