//! Selections: settings in the order of a rule.

use super::{Drawn, Sheet, amount, gap, gap_ends, metric_words, spread, test_name};
use crate::analyse::declared::{Candidate, RangeEnd, Ranking};
use crate::analyse::{SeedPairing, TTest, Undefined, t_test};
use crate::job::{Measure, counted};
use crate::report::data_table::{DataTable, TableEntry};
use crate::report::figure::{seeds, settings_key, settings_label};
use crate::report::names::Names;
use crate::report::scene::Scene;
use crate::report::symbols;
use crate::report::tables::{arm, between, high, in_unit, low};

impl Drawn for Vec<Ranking> {
    fn figures(&self, _: &Sheet<'_>) -> Vec<(String, Scene)> {
        Vec::new()
    }

    fn has_figures(&self) -> bool {
        false
    }

    fn table(&self, title: &str, metric: Measure, names: &Names) -> DataTable {
        table(title, self, metric, names)
    }

    fn shows(&self, metric: Measure, _: &Names) -> String {
        let rule = self.first().map_or_else(String::new, |ranking| ranking.rule.replace('_', " "));
        let candidates = self.iter().flat_map(|ranking| &ranking.candidates);
        let counts = candidates.map(|candidate| candidate.sample.n()).filter(|n| *n > 0);
        format!(
            "Settings by the {rule} of {}, with the 95 % interval of the mean, {} each",
            metric_words(metric),
            seeds(counts)
        )
    }

    fn finds(&self, metric: Measure, names: &Names) -> Option<String> {
        // A ranking of a single setting is not a search.
        let searched: Vec<&Ranking> = self.iter().filter(|one| one.candidates.len() > 1).collect();
        let [ranking] = searched.as_slice() else {
            let count = searched.len();
            let at_end = searched.iter().filter(|one| one.at_ends().next().is_some()).count();
            let at_end = match at_end {
                0 => String::new(),
                _ => format!(
                    "; {at_end} of them have it at the end of a range, so search further there"
                ),
            };
            return (count > 0).then(|| {
                format!(
                    "The table lists the best setting of each of {count} searches first, and how far each is \
                     from it{at_end}; {BIASED}"
                )
            });
        };
        let at_end = |mut end: RangeEnd| {
            end.name = symbols::key(&end.name);
            format!("; {end}")
        };
        let best = ranking.candidates.first()?;
        let mean = amount(best.mean.ok()?, metric);
        let spread = spread(best.interval, metric);
        Some(format!(
            "{} has the highest mean with {}: {mean} (best of {} tried{spread}){}{}; {BIASED}",
            names.label(&ranking.place),
            settings_label(&best.settings),
            counted(ranking.tried(), "setting"),
            runner_up(ranking, metric).unwrap_or_default(),
            ranking.at_ends().map(at_end).collect::<String>()
        ))
    }

    fn is_table(&self) -> bool {
        true
    }
}

/// Why the mean of a search is not to be reported.
const BIASED: &str = "the mean of the best of several settings is biased upwards, so report the mean on the \
                      reporting seeds";

/// The difference between the best setting and another, with its t test.
fn behind(
    best: &Candidate,
    other: &Candidate,
) -> (Result<f64, Undefined>, Result<TTest, Undefined>) {
    let design = SeedPairing::of(&best.sample, &other.sample);
    let (one, two) = design.compared(&best.sample, &other.sample);
    let difference = one.mean().and_then(|one| Ok(one - two.mean()?));
    (difference, t_test(&best.sample, &other.sample, design))
}

/// The difference between the best setting and the next: "; 12 above the next (95 % interval −5 to 29, …)".
fn runner_up(ranking: &Ranking, metric: Measure) -> Option<String> {
    let [best, next, ..] = &ranking.candidates[..] else { return None };
    let (difference, test) = behind(best, next);
    let difference = difference.ok()?;
    let side = if difference < 0.0 { "below" } else { "above" };
    let interval = match test {
        Ok(test) => {
            let name = test_name([SeedPairing::of(&best.sample, &next.sample)]).unwrap_or_default();
            format!(" (95 % interval {}, {name}, not corrected)", gap_ends(test.interval, metric))
        }
        Err(reason) => format!(" (no interval: {reason})"),
    };
    let settings = settings_label(&next.settings);
    Some(format!("; {} {side} the next, {settings}{interval}", gap(difference.abs(), metric)))
}

fn table(title: &str, rankings: &[Ranking], metric: Measure, names: &Names) -> DataTable {
    let name = metric.title();
    let columns = [
        ("arm", "Arm"),
        ("rank", "Rank"),
        ("settings", "Settings"),
        ("seeds", "n"),
        ("mean", name.as_str()),
        ("interval", "95 % interval"),
        (".low", ""),
        (".high", ""),
        ("behind", "Behind the best"),
        ("behind_interval", "its 95 % interval"),
        (".behind_low", ""),
        (".behind_high", ""),
    ];
    let mut table = DataTable::new(title, &columns);
    for ranking in rankings {
        for (rank, candidate) in ranking.candidates.iter().enumerate() {
            let (difference, interval) = match rank {
                0 => (Ok(0.0), None),
                _ => {
                    let (difference, test) = behind(&ranking.candidates[0], candidate);
                    (difference, Some(test.map(|test| test.interval)))
                }
            };
            let of_best = || TableEntry::text("");
            table.rows.push(vec![
                arm(&ranking.place, names),
                TableEntry::number(rank as f64 + 1.0, 0),
                TableEntry::name(
                    settings_key(&candidate.settings),
                    settings_label(&candidate.settings),
                ),
                TableEntry::number(candidate.sample.n() as f64, 0),
                in_unit(candidate.mean, metric),
                between(candidate.interval, metric),
                low(candidate.interval),
                high(candidate.interval),
                in_unit(difference, metric),
                interval.map_or_else(of_best, |interval| between(interval, metric)),
                interval.map_or_else(of_best, low),
                interval.map_or_else(of_best, high),
            ]);
        }
    }
    table
}
