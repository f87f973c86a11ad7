//! The tables of an experiment's arms and agents.

use super::data_table::{DataTable, TableEntry};
use super::names::Names;
use super::tables::{self, between, high, in_unit, low};
use crate::analyse::declared::{AgentSummary, ArmSummary, share_of_optimum};
use crate::analyse::{Aggregate, Interval, Undefined};
use crate::job::MetricUnit;
use crate::report::environment_words::Words;

/// The number of values from which on an inter-quartile mean leaves any out.
const FOUR: usize = 4;

/// One row per arm: four summaries of its returns, the behaviour of its policies, and their share
/// of the optimum. `unknown_optima` holds the reasons for unknown optima.
pub fn arms(
    rows: &[ArmSummary],
    names: &Names,
    unknown_optima: &[String],
    words: &Words,
) -> DataTable {
    let has_lost = rows.iter().any(|row| row.returns.lost().ended() > 0);
    let rate = words.terminated.text();
    let columns = [
        ("arm", "Arm"),
        ("seeds", "n"),
        (if has_lost { "lost" } else { ".lost" }, "Lost"),
        ("mean_return", "Mean return"),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("interquartile_mean", "IQM"),
        ("interquartile_interval", "95 % interval"),
        (".interquartile_low", ""),
        (".interquartile_high", ""),
        ("lower_quartile_return", "Lower quartile"),
        (&*rate, words.terminated_heading()),
        ("messages_per_episode", "Messages"),
        (if words.has_optimum { "optimum" } else { ".optimum" }, "Optimum"),
        (
            if words.has_optimum { "share_of_optimum" } else { ".share_of_optimum" },
            "Share of optimum, %",
        ),
        (".share_low", ""),
        (".share_high", ""),
    ];
    let Words { return_unit, terminated, has_optimum } = words;
    let caption = format!(
        "Arms: means over seeds of the return ({return_unit}), its lower quartile over evaluated episodes, the \
         share of {}, and the messages sent per episode; IQM: inter-quartile mean of the return, the mean \
         of fewer than four values",
        terminated.in_unit(return_unit).quantity()
    );
    let of_optima = "; the optimum and its share are of the return minus the cost of messages";
    let of_optima = if *has_optimum { of_optima } else { "" };
    let unknown: String = unknown_optima.iter().map(|reason| format!("; {reason}")).collect();
    let caption = format!("{caption}{of_optima}{unknown}");
    let mut table = DataTable::new(caption, &columns);
    table.rows = rows.iter().map(|row| arm(row, names)).collect();
    table
}

fn arm(row: &ArmSummary, names: &Names) -> Vec<TableEntry> {
    let (mean, interval) = (row.returns.mean(), row.returns.interval());
    let (interquartile, net) = (row.interquartile(), row.net_returns.interval());
    let middle = interval_of(interquartile);
    let share = |value| share(value, row.optimum);
    vec![
        tables::arm(&row.name, names),
        TableEntry::number(row.returns.n() as f64, 0),
        TableEntry::number(f64::from(row.returns.lost().ended()), 0),
        in_unit(mean, MetricUnit::Return),
        between(interval, MetricUnit::Return),
        low(interval),
        high(interval),
        called_mean(
            in_unit(interquartile.map(|middle| middle.value), MetricUnit::Return),
            row.returns.n(),
        ),
        between(middle, MetricUnit::Return),
        low(middle),
        high(middle),
        in_unit(row.lower_quartiles.mean(), MetricUnit::Return),
        in_unit(row.terminated.mean(), MetricUnit::Share),
        TableEntry::of(row.messages.mean(), 1),
        optimum(row.optimum),
        share(row.net_returns.mean()),
        share(net.map(|interval| interval.low)),
        share(net.map(|interval| interval.high)),
    ]
}

/// An inter-quartile mean of this many values; of fewer than four it is called what it is, the mean.
fn called_mean(entry: TableEntry, values: usize) -> TableEntry {
    match entry {
        TableEntry::Number { value, shown } if values < FOUR => {
            TableEntry::Number { value, shown: format!("{shown} (mean)") }
        }
        entry => entry,
    }
}

/// One row per agent and scenario: inter-quartile means over all their arms.
pub fn agents(rows: &[AgentSummary], names: &Names, words: &Words) -> DataTable {
    let columns = [
        ("agent", "Agent"),
        ("scenario", "Scenario"),
        ("arms", "Arms"),
        ("runs", "n"),
        ("interquartile_mean", "IQM of the return"),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        (
            if words.has_optimum { "share_of_optimum" } else { ".share_of_optimum" },
            "IQM of the share of the optimum, %",
        ),
        (if words.has_optimum { "share_interval" } else { ".share_interval" }, "its 95 % interval"),
        (".share_low", ""),
        (".share_high", ""),
    ];
    let caption = format!(
        "Agents: inter-quartile means (IQM) of the return ({}) over arms and seeds; t intervals with the \
         error by which the mean varies between resamples of the seeds, each with its values in all arms",
        words.return_unit
    );
    let mut table = DataTable::new(caption, &columns);
    for row in rows {
        let (returns, shares) = (interval_of(row.returns), row.shares.map(interval_of));
        let of_shares = |entry: &dyn Fn(Result<Interval, Undefined>) -> TableEntry| {
            shares.map_or_else(unknown, entry)
        };
        table.rows.push(vec![
            TableEntry::name(&row.agent, names.agent(&row.agent)),
            TableEntry::text(&row.scenario),
            TableEntry::number(row.arms as f64, 0),
            TableEntry::number(row.runs as f64, 0),
            called_mean(in_unit(row.returns.map(|all| all.value), MetricUnit::Return), row.runs),
            between(returns, MetricUnit::Return),
            low(returns),
            high(returns),
            called_mean(
                row.shares.map_or_else(unknown, |shares| {
                    in_unit(shares.map(|all| all.value), MetricUnit::Share)
                }),
                row.shared,
            ),
            of_shares(&|interval| between(interval, MetricUnit::Share)),
            of_shares(&|interval| in_unit(interval.map(|it| it.low), MetricUnit::Share)),
            of_shares(&|interval| in_unit(interval.map(|it| it.high), MetricUnit::Share)),
        ]);
    }
    table
}

/// The optimum, if it is known.
pub fn optimum(optimum: Option<f64>) -> TableEntry {
    optimum.map_or_else(unknown, |value| TableEntry::number(value, 1))
}

/// A net return as a share of the optimum.
pub fn share(value: Result<f64, Undefined>, optimum: Option<f64>) -> TableEntry {
    match value.map(|value| share_of_optimum(value, optimum)) {
        Ok(Some(share)) => in_unit(Ok(share), MetricUnit::Share),
        Err(reason) if share_of_optimum(0.0, optimum).is_some() => {
            in_unit(Err(reason), MetricUnit::Share)
        }
        Ok(None) | Err(_) => unknown(),
    }
}

fn unknown() -> TableEntry {
    TableEntry::Missing("no optimum computed".to_owned())
}

fn interval_of(aggregate: Result<Aggregate, Undefined>) -> Result<Interval, Undefined> {
    aggregate.and_then(|aggregate| aggregate.interval)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Sample;
    use crate::analyse::declared::ArmId;
    use crate::job::metric::DISENGAGEMENT_RATE;

    const WORDS: Words =
        Words { return_unit: "points", terminated: DISENGAGEMENT_RATE, has_optimum: true };

    fn row(values: &[f64], failed: u32) -> ArmSummary {
        let values = (1..).zip(values.iter().copied());
        let returns = Sample::new(values, failed, 0).unwrap();
        ArmSummary {
            name: ArmId { agent: "dqn".into(), scenario: "P-H-D".into(), settings: Vec::new() },
            lower_quartiles: returns.clone(),
            net_returns: returns.clone(),
            terminated: returns.clone(),
            messages: returns.clone(),
            returns,
            ..ArmSummary::default()
        }
    }

    #[test]
    fn lost_seeds_have_a_column_where_there_are_any() {
        let has_column = |table: &DataTable| table.markdown().contains("| Lost |");
        let whole = arms(&[row(&[1.0, 2.0], 0)], &Names::default(), &[], &WORDS);
        assert!(!has_column(&whole));
        // One seed failed, and one value is NaN.
        let lost =
            arms(&[row(&[1.0, 2.0], 0), row(&[1.0, f64::NAN], 1)], &Names::default(), &[], &WORDS);
        assert!(has_column(&lost));
        assert_eq!([lost.rows[0][2].shown(), lost.rows[1][2].shown()], ["0", "2"]);
        assert_eq!(lost.columns[2].name, "lost");
    }

    #[test]
    fn the_inter_quartile_mean_of_few_values_is_called_mean() {
        for (n, is_mean) in [(3, true), (4, false)] {
            let values: Vec<f64> = (0..n).map(f64::from).collect();
            assert_eq!(
                arms(&[row(&values, 0)], &Names::default(), &[], &WORDS)
                    .markdown()
                    .contains("(mean)"),
                is_mean
            );
        }
    }
}
