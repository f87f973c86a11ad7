//! Recoveries: recovered shares of a loss.

use super::{Drawn, Sheet, test_name};
use crate::analyse::declared::{ArmId, RecoveryRow};
use crate::analyse::{Interval, Recovered, SeedPairing, Undefined};
use crate::job::{Measure, MetricUnit, counted};
use crate::report::arm_tables;
use crate::report::data_table::{DataTable, TableEntry, shown};
use crate::report::figure::{seeds, settings_label};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::tables::{arm, between, high, in_unit, low, range};

/// Maximum number of rows whose shares a caption lists individually.
const LISTED: usize = 6;

impl Drawn for Vec<RecoveryRow> {
    fn figures(&self, _: &Sheet<'_>) -> Vec<(String, Scene)> {
        Vec::new()
    }

    fn has_figures(&self) -> bool {
        false
    }

    fn table(&self, title: &str, metric: Measure, names: &Names) -> DataTable {
        let columns = [
            ("with", "With"),
            ("without", "Without"),
            ("return_with", "Return with"),
            ("return_without", "Return without"),
            ("optimum", "Optimum"),
            ("optimum_scenario", "Scenario of the optimum"),
            ("seeds_with", "n with"),
            ("seeds_without", "n without"),
            ("test", "t test"),
            ("recovered", "Recovered, %"),
            ("interval", "95 % interval, %"),
            (".low", ""),
            (".high", ""),
        ];
        let mut table = DataTable::new(title, &columns);
        for row in self {
            let [with, without] = &row.returns;
            let interval = row.recovered.and_then(|found| found.interval);
            table.rows.push(vec![
                arm(&row.with, names),
                arm(&row.without, names),
                in_unit(with.mean(), metric),
                in_unit(without.mean(), metric),
                arm_tables::optimum(row.optimum.as_ref().map(|best| best.mean_return)),
                match &row.optimum {
                    Some(best) => TableEntry::text(best.scenario.clone()),
                    None => TableEntry::Missing(Undefined::NoOptimum.to_string()),
                },
                TableEntry::number(with.n() as f64, 0),
                TableEntry::number(without.n() as f64, 0),
                TableEntry::text(if row.design == SeedPairing::Matched {
                    "paired"
                } else {
                    "unpaired"
                }),
                in_unit(row.recovered.map(|found| found.share), MetricUnit::Share),
                between(interval, MetricUnit::Share),
                low(interval),
                high(interval),
            ]);
        }
        table
    }

    fn shows(&self, _: Measure, _: &Names) -> String {
        let counts = self.iter().flat_map(|row| row.returns.iter().map(|sample| sample.n()));
        let has_interval =
            |row: &&RecoveryRow| row.recovered.is_ok_and(|found| found.interval.is_ok());
        let test = test_name(self.iter().filter(has_interval).map(|row| row.design));
        format!(
            "Share of the distance to the exact optimum that is recovered{}, {} each",
            test.map_or_else(String::new, |test| {
                format!(", with its 95 % interval (Fieller’s, {test})")
            }),
            seeds(counts.filter(|n| *n > 0))
        )
    }

    /// One sentence: the recovered shares with their intervals, and the losses.
    fn finds(&self, _: Measure, names: &Names) -> Option<String> {
        let known = self.iter().filter_map(|row| Some((row, row.recovered.ok()?)));
        let mut known: Vec<(&RecoveryRow, Recovered)> = known.collect();
        let (first, _) = known.first()?;
        let same = |row: &RecoveryRow| {
            let arm = |row: &RecoveryRow| {
                let name = |id: &ArmId| (id.agent.clone(), id.scenario.clone());
                let best = row.optimum.as_ref().map(|optimum| optimum.scenario.clone());
                (name(&row.with), name(&row.without), best)
            };
            arm(row) == arm(first)
        };
        if known.len() <= LISTED && known.iter().all(|(row, _)| same(row)) {
            let shares = known.iter().map(|(row, found)| share(row, found, names));
            let shares = shares.collect::<Vec<_>>().join(", ");
            let of = &first.optimum.as_ref()?.scenario;
            let (with, without) = (unset(&first.with, names), unset(&first.without, names));
            return Some(format!(
                "Of what {without} loses against the optimum of {of}, {with} recovers {shares}"
            ));
        }
        known.sort_by(|(_, a), (_, b)| f64::total_cmp(&a.share, &b.share));
        let ends: Vec<String> = [known.first()?, known.last()?]
            .iter()
            .map(|(row, found)| {
                format!(
                    "{} ({} against {})",
                    share(row, found, names),
                    unset(&row.with, names),
                    unset(&row.without, names)
                )
            })
            .collect();
        Some(format!(
            "Of the distance to the optimum, the arms of {} recover between {}",
            counted(known.len(), "comparison"),
            ends.join(" and "),
        ))
    }

    fn lacks(&self) -> Option<String> {
        if self.is_empty() {
            return Some("no two arms in the same environment".to_owned());
        }
        let unknown: Vec<Undefined> = self.iter().filter_map(|row| row.recovered.err()).collect();
        let reason = unknown.first()?;
        Some(format!("{} of {} ({reason})", unknown.len(), counted(self.len(), "share")))
    }

    fn is_table(&self) -> bool {
        true
    }
}

/// The name of an arm without its settings.
fn unset(name: &ArmId, names: &Names) -> String {
    names.label(&ArmId { settings: Vec::new(), ..name.clone() })
}

/// A share with its interval: "93 % (91 to 95 %) at σ=0.4"; a share below 0 is a further loss: "no
/// part (it loses a further 5 %, 1 to 9 %)".
fn share(row: &RecoveryRow, found: &Recovered, names: &Names) -> String {
    let ends = |low: f64, high: f64| format!("{} %", range(100.0 * low, 100.0 * high, 1));
    let none = |reason: Undefined| format!("no interval: {reason}");
    let share = match found.share < 0.0 {
        false => {
            let spread = found.interval.map_or_else(none, |Interval { low, high }| ends(low, high));
            format!("{} % ({spread})", shown(100.0 * found.share, 1))
        }
        true => {
            let spread =
                found.interval.map_or_else(none, |Interval { low, high }| ends(-high, -low));
            format!("no part (it loses a further {} %, {spread})", shown(-100.0 * found.share, 1))
        }
    };
    let at = match settings_label(&names.arm(&row.with).settings) {
        label if label.is_empty() => label,
        label => format!(" at {label}"),
    };
    format!("{share}{at}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::declared::ScenarioOptimum;
    use crate::analyse::{Sample, recovered};
    use crate::job::Scalar;
    use crate::job::metric::MEAN_RETURN;

    const RETURN: Measure = MEAN_RETURN.in_unit("points");

    fn row(sigma: f64, with: [f64; 2], without: [f64; 2], optimum: Option<f64>) -> RecoveryRow {
        let name = |agent: &str, scenario: &str| ArmId {
            agent: agent.into(),
            scenario: scenario.into(),
            settings: vec![("environment.sigma".into(), Scalar::Real(sigma))],
        };
        let sample = |values: [f64; 2]| Sample::new((1..).zip(values), 0, 0).unwrap();
        RecoveryRow {
            with: name("ppo-gru", "P-M-S"),
            without: name("ppo", "P-T"),
            design: SeedPairing::Matched,
            returns: [sample(with), sample(without)],
            optimum: optimum
                .map(|mean_return| ScenarioOptimum { scenario: "P-H-D".to_owned(), mean_return }),
            recovered: optimum.ok_or(Undefined::NoOptimum).and_then(|optimum| {
                recovered(&sample(with), &sample(without), optimum, SeedPairing::Matched)
            }),
        }
    }

    #[test]
    fn one_sentence_says_how_much_is_won_back() {
        // The arm of the loss has no variance. The share is 30 of 40. Its half-width is 12.7062,
        // the t with one degree of freedom, times a standard error of 1, divided by 40.
        let rows = vec![
            row(0.4, [89.0, 91.0], [60.0, 60.0], Some(100.0)),
            row(0.6, [50.0, 50.5], [50.0, 50.5], None),
        ];
        assert_eq!(
            rows.finds(RETURN, &Names::default()).unwrap(),
            "Of what ppo P-T loses against the optimum of P-H-D, ppo-gru P-M-S recovers 75.0 % (43.2 to \
             106.8 %) at σ=0.4"
        );
        assert_eq!(
            rows.lacks().unwrap(),
            "1 of 2 shares (no optimum known: it needs a completed job of a scenario that shows H and \
             D, in an environment whose optimum can be computed; where messages cost steps, it is that of \
             mean_net_return)"
        );
        let table = rows.table("", RETURN, &Names::default());
        assert_eq!(table.rows.len(), 2);
        assert!(table.markdown().contains("43.2 to 106.8"));
    }

    #[test]
    fn a_share_below_0_recovers_nothing() {
        let rows = vec![row(0.4, [49.0, 51.0], [60.0, 60.0], Some(100.0))];
        assert_eq!(
            rows.finds(RETURN, &Names::default()).unwrap(),
            "Of what ppo P-T loses against the optimum of P-H-D, ppo-gru P-M-S recovers no part (it loses \
             a further 25.0 %, −6.8 to 56.8 %) at σ=0.4"
        );
    }

    #[test]
    fn many_shares_are_summed_up_by_their_ends() {
        let rows: Vec<RecoveryRow> = (1..=8)
            .map(|i| {
                let mean = 60.0 + 5.0 * f64::from(i);
                row(f64::from(i), [mean - 1.0, mean + 1.0], [60.0, 60.0], Some(100.0))
            })
            .collect();
        let found = rows.finds(RETURN, &Names::default()).unwrap();
        let begins =
            "Of the distance to the optimum, the arms of 8 comparisons recover between 12.5 %";
        assert!(found.starts_with(begins), "{found}");
        assert!(found.contains("and 100.0 %"), "{found}");
        assert!(found.ends_with("(ppo-gru P-M-S against ppo P-T)"), "{found}");
        assert!(Vec::<RecoveryRow>::new().lacks().is_some());
    }
}
