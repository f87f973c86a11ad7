//! The race of a search in the report: which arm left when and why, the winner as a table for other manifests, its
//! return on fresh seeds, and what a grid would have cost. [`super::race_figure`] draws it.

use super::data_table::{DataTable, TableEntry};
use super::kinds::{amount, ends, gap, gap_ends};
use super::race_context::{RaceContext, end, known, mean_of};
use super::race_figure::{caption, race_figure};
use super::scene::Scene;
use super::shrinkage::shrinkage;
use super::tables::{high, low, no_interval};
use crate::analyse::{Interval, Undefined, mean_interval, paired_t_test};
use crate::job::{Measure, counted};
use crate::key::{Parameter, printable, shortened};
use crate::manifest::{Leaving, Manifest, Search};
use crate::plan::{Cost, Entrant, RaceOutcome, Races, Reference, Rung};
use crate::store::{Reader, StoreError};

/// The races of an experiment.
#[derive(Clone, Debug)]
pub struct ReportedRace {
    /// Where each race stands, what its winner reached, and what it cost.
    pub sentences: Vec<String>,
    /// The figure of each race that has a complete arm, with the agent's name.
    pub figures: Vec<(String, Scene)>,
    /// What the figures show.
    pub caption: String,
    /// One row per arm, winners first.
    pub table: DataTable,
    /// The winners as tables `[[agent]]`; `None` without a winner.
    pub winners: Option<String>,
}

/// The races of a manifest with the results of a store; `None` if it has no search.
///
/// **Errors**: the store cannot be read.
pub fn race(
    reader: &Reader,
    manifest: &Manifest,
    return_unit: &'static str,
) -> Result<Option<ReportedRace>, StoreError> {
    let races = Races::of(manifest, |keys, metric| reader.scores(keys, metric))?;
    let (Some(races), Some(search)) = (races, &manifest.search) else { return Ok(None) };
    Ok(Some(reported(&races, manifest, search, return_unit)))
}

/// The races, in words and numbers.
fn reported(
    races: &Races,
    manifest: &Manifest,
    search: &Search,
    return_unit: &'static str,
) -> ReportedRace {
    let metric = search.metric.in_unit(return_unit);
    let mut table = empty_table(search, metric);
    let (mut sentences, mut figures, mut winners) = (Vec::new(), Vec::new(), Vec::new());
    for race in &races.races {
        let context = RaceContext { race, manifest, search, metric, references: &races.references };
        let cost = context.cost();
        sentences.extend(context.sentences(&cost));
        figures.extend(race_figure(&context).map(|scene| (race.agent.clone(), scene)));
        winners.extend(context.winner(cost));
        table.rows.extend(context.rows());
    }
    let winners = (!winners.is_empty()).then(|| winners.join("\n"));
    ReportedRace { sentences, figures, caption: caption(metric), table, winners }
}

fn empty_table(search: &Search, metric: Measure) -> DataTable {
    let means: Vec<String> = search.rungs.iter().map(|seeds| format!(".mean_{seeds}")).collect();
    let columns = [
        ("agent", "Agent"),
        ("arm", "Arm"),
        ("settings", "Settings"),
        ("rung", "Last rung"),
        ("seeds", "n"),
        ("mean", "Mean"),
        ("behind", "Behind the best"),
        ("interval", "Interval"),
        (".low", ""),
        (".high", ""),
        ("end", "End"),
    ];
    // What the figure draws: the mean at each rung, by its number of seeds.
    let of_rungs = means.iter().map(|name| (name.as_str(), ""));
    let columns: Vec<(&str, &str)> = columns.into_iter().chain(of_rungs).collect();
    let level = match search.leaving {
        Leaving::Share(_) => "at 95 %, without correction".to_owned(),
        Leaving::Evidence(level) => format!(
            "at the level {level} divided by {} comparisons: of every arm with the best, at every rung",
            search.comparisons()
        ),
    };
    let caption = format!(
        "The race: for each arm, its last rung with the number of seeds, and the mean over these seeds of the {}; how \
         far it was behind the best arm of the rung, with the paired interval {level}; and why it left",
        metric.title()
    );
    DataTable::new(caption, &columns)
}

impl RaceContext<'_> {
    /// Where the race stands, its winner, and its cost.
    fn sentences(&self, cost: &str) -> Vec<String> {
        let agent = printable(&self.race.agent);
        let Some((arm, raced, fresh)) = self.won() else {
            let state = self.race.state(self.search);
            return vec![format!("{agent}: {state}."), format!("{cost}.")];
        };
        let mut sentences = vec![
            format!(
                "{agent}: arm {} of {} has won ({}).",
                arm + 1,
                self.race.settings.len(),
                self.settings(arm)
            ),
            format!("{}.", self.on_race_seeds(&raced)),
        ];
        sentences.extend(self.on_fresh_seeds(&raced, &fresh).into_iter().map(|line| line + "."));
        sentences.push(format!("{cost}."));
        sentences
    }

    /// The winner as a table for other manifests, with its numbers in comments.
    fn winner(&self, cost: String) -> Option<String> {
        let (arm, raced, fresh) = self.won()?;
        let (experiment, agent) = (&self.manifest.name, &self.race.agent);
        let mut lines = vec![
            format!("Race of experiment `{experiment}`: {agent}"),
            format!(
                "Best of {} drawn, by the mean of {}",
                counted(self.race.settings.len(), "setting"),
                self.metric.title()
            ),
            self.on_race_seeds(&raced),
        ];
        lines.extend(self.on_fresh_seeds(&raced, &fresh));
        lines.push(cost);
        let mut out = String::new();
        for line in lines {
            out += &format!("# {}\n", printable(&shortened(&line)));
        }
        let declared = self.manifest.agents.iter().find(|one| one.name == *agent)?;
        let value = |parameter: Parameter| {
            let mut settings = self.race.settings[arm].iter();
            settings.find(|(drawn, _)| *drawn == parameter).map(|(_, value)| value.clone())
        };
        Some(out + &declared.chosen(value))
    }

    /// The winner's mean in the race, which is the best of several and therefore too high.
    fn on_race_seeds(&self, raced: &[f64]) -> String {
        let arms = self.race.settings.len();
        format!("On the seeds of the race, the best of {arms}: {}", self.mean(raced))
    }

    /// What the winner reached on fresh seeds, its shrinkage, and its difference to agents without draws.
    fn on_fresh_seeds(&self, raced: &[f64], fresh: &[(usize, f64)]) -> Vec<String> {
        let of = self.search.fresh_count();
        if fresh.is_empty() {
            return vec![format!("On fresh seeds: none of {of} completed")];
        }
        let values: Vec<f64> = fresh.iter().map(|(_, value)| *value).collect();
        let missing = if values.len() < of { format!(" of {of}") } else { String::new() };
        let mut lines = vec![format!("On fresh seeds: {}{missing}", self.mean(&values))];
        let interval = mean_interval(&values);
        let new = (mean_of(&values), interval);
        lines.extend(shrinkage(mean_of(raced), new, "fresh", self.metric));
        lines.extend(self.references.iter().map(|one| self.against(one, fresh)));
        lines
    }

    /// The paired difference of the winner to an agent without draws.
    fn against(&self, reference: &Reference, fresh: &[(usize, f64)]) -> String {
        let others = known(&reference.fresh);
        let other = |seed: usize| others.iter().find(|(known, _)| *known == seed);
        let pairs: Vec<(f64, f64)> =
            fresh.iter().filter_map(|(seed, value)| Some((*value, other(*seed)?.1))).collect();
        let name = printable(&reference.agent);
        match paired_t_test(&pairs) {
            Ok(test) => format!(
                "On {} shared with {name}, winner minus {name}: {} (95 % interval {}, paired)",
                counted(pairs.len(), "fresh seed"),
                gap(test.difference, self.metric),
                gap_ends(test.interval, self.metric)
            ),
            Err(reason) => format!("Winner minus {name} on fresh seeds: {reason}"),
        }
    }

    /// The mean of values with its interval and their number.
    fn mean(&self, values: &[f64]) -> String {
        let mean = mean_of(values).map(|mean| amount(mean, self.metric));
        let interval = mean_interval(values);
        let interval =
            interval.map(|interval| format!(" (95 % interval {})", ends(interval, self.metric)));
        let mean = mean.unwrap_or_else(|reason: Undefined| reason.to_string());
        format!("{mean}{}, n = {}", interval.unwrap_or_default(), values.len())
    }

    /// One row per arm.
    fn rows(&self) -> Vec<Vec<TableEntry>> {
        self.race.arms().into_iter().map(|arm| self.row(arm)).collect()
    }

    fn row(&self, (rung, of, entrant): (usize, &Rung, &Entrant)) -> Vec<TableEntry> {
        let mean = entrant.mean().ok_or("not complete");
        let course = self.race.course(entrant.arm);
        let lead = entrant.lead;
        let none = if mean.is_ok() { "the best" } else { "not complete" };
        let no_interval = no_interval(entrant.values.len());
        let interval = match lead.and_then(|lead| lead.interval) {
            Some((low, high)) => Ok(Interval { low, high }),
            None => Err(no_interval),
        };
        let of_rung = |rung: usize| {
            let known = course.iter().find(|(at, _)| *at == rung);
            TableEntry::of(known.and_then(|(_, one)| one.mean()).ok_or("not in the rung"), 1)
        };
        let row = vec![
            TableEntry::text(&self.race.agent),
            TableEntry::number(entrant.arm as f64 + 1.0, 0),
            TableEntry::text(self.settings(entrant.arm)),
            TableEntry::number(rung as f64 + 1.0, 0),
            TableEntry::number(of.seeds as f64, 0),
            TableEntry::of(mean, 1),
            TableEntry::of(lead.map(|lead| lead.mean).ok_or(none), 1),
            match (lead, interval) {
                (None, _) => TableEntry::Missing(none.to_owned()),
                (_, Ok(interval)) => TableEntry::text(ends(interval, self.metric)),
                (_, Err(reason)) => TableEntry::Missing(reason.to_string()),
            },
            low(interval),
            high(interval),
            TableEntry::text(end(entrant.fate, of.entrants.len())),
        ];
        row.into_iter().chain((0..self.search.rungs.len()).map(of_rung)).collect()
    }

    /// What the race costs beside a grid of its settings.
    fn cost(&self) -> String {
        let Cost { jobs, work, grid_jobs, grid_work } = self.race.cost(self.manifest);
        let share = 100.0 * work as f64 / (grid_work as f64).max(1.0);
        let [jobs, grid_jobs] = [jobs, grid_jobs].map(|jobs| counted(jobs, "job"));
        let has = match self.race.outcome {
            RaceOutcome::Running => format!("So far, the race has {jobs}"),
            RaceOutcome::Won { .. } | RaceOutcome::Lost => format!("The race took {jobs}"),
        };
        format!(
            "{has} and {share:.0} % of the work of a grid of its settings with all of its seeds, which has {grid_jobs}"
        )
    }
}
