//! The best settings of a search, as tables for other manifests, with their results on held-out seeds.
//!
//! In: the rankings of a selection. Out: TOML with the numbers in comments. Held-out seeds are read
//! from the whole store, because another experiment runs them.

use super::kinds::{amount, ends, gap, gap_ends};
use crate::analyse::declared::{Arm, ArmId, Candidate, Finding, FindingContent, Ranking, is_at};
use crate::analyse::{Interval, Sample, Undefined};
use crate::job::{Job, Measure, PlannedJob, counted};
use crate::key::{printable, shortened};
use crate::manifest::{Analysis, AnalysisKind, Manifest};
use crate::plan::{self};
use crate::record::{JobRecord, JobStatus, SharedSettings};
use crate::store::{Parts, Reader, StoreError};

/// The best settings that each analysis of the manifest chose; `None` unless it is a selection with
/// a winner. `findings` has one finding per analysis of the manifest.
pub fn winners(
    reader: &Reader,
    manifest: &Manifest,
    return_unit: &'static str,
    findings: &[Finding],
) -> Result<Vec<Option<String>>, StoreError> {
    let of_one = |(analysis, finding): (&Analysis, &Finding)| {
        let (AnalysisKind::Selection(selection), FindingContent::Selection(rankings)) =
            (&analysis.kind, &finding.content)
        else {
            return Ok(None);
        };
        let reporting_seeds = &selection.reporting_seeds;
        let search = Search { reader, manifest, return_unit, analysis, reporting_seeds };
        let chosen = rankings.iter().filter_map(|ranking| Some((ranking, ranking.winner()?)));
        let tables = chosen.map(|(ranking, winner)| search.table(ranking, winner));
        let tables: Vec<String> =
            tables.filter_map(Result::transpose).collect::<Result<_, StoreError>>()?;
        Ok((!tables.is_empty()).then(|| tables.join("\n")))
    };
    manifest.analyses.iter().zip(findings).map(of_one).collect()
}

/// A selection of a manifest.
struct Search<'s> {
    reader: &'s Reader,
    manifest: &'s Manifest,
    return_unit: &'static str,
    analysis: &'s Analysis,
    reporting_seeds: &'s [u64],
}

impl Search<'_> {
    /// The winner of a ranking as TOML; `None` if the manifest has no such job.
    fn table(&self, ranking: &Ranking, winner: &Candidate) -> Result<Option<String>, StoreError> {
        let settings = [&ranking.place.settings[..], &winner.settings].concat();
        let name = ArmId { settings, ..ranking.place.clone() };
        // The name lacks keys that the analysis fixes.
        let conditions: Vec<_> = self.analysis.of_jobs().collect();
        let mut shared = SharedSettings::default();
        let is_winner = |planned: &PlannedJob| {
            let (key, status) = (planned.form.key(), JobStatus::Pending);
            let record = JobRecord::sharing(&mut shared, planned, key, status);
            is_at(&record, &name) && conditions.iter().all(|condition| condition.is_met_by(&record))
        };
        let agent = self.manifest.agents.iter().find(|agent| agent.name == name.agent);
        let (Some(agent), Some(planned)) = (agent, plan::jobs(self.manifest).find(is_winner))
        else {
            return Ok(None);
        };
        let held_out = self.held_out(&planned)?;
        let mut out = String::new();
        for line in self.comments(ranking, winner, &held_out) {
            out += &format!("# {}\n", printable(&shortened(&line)));
        }
        Ok(Some(out + &agent.chosen(|parameter| planned.job.value(parameter))))
    }

    /// The metric of the job on the reporting seeds, whichever experiment ran them.
    fn held_out(&self, winner: &PlannedJob) -> Result<Sample, StoreError> {
        let planned = self.reporting_seeds.iter().map(|seed| {
            let job = Job { seed: *seed, ..winner.job.clone() };
            PlannedJob { agent: winner.agent.clone(), form: job.form(), job }
        });
        let parts = Parts { returns: true, ..Parts::default() };
        let mut data = self.reader.data_set_of(&self.manifest.name, planned, |_| parts, |_| {})?;
        if let Some(range) = self.analysis.participants {
            self.reader.read_participants(&mut data.jobs, &[range])?;
            data.jobs = data.jobs.iter().map(|job| job.among(range)).collect();
        }
        let arm = Arm { name: ArmId::default(), jobs: data.jobs.iter().collect() };
        Ok(arm.sample(self.analysis.metric))
    }

    fn comments(&self, ranking: &Ranking, winner: &Candidate, held_out: &Sample) -> Vec<String> {
        let metric = self.analysis.metric.in_unit(self.return_unit);
        let ArmId { agent, scenario, settings } = &ranking.place;
        let written = |settings: &mut dyn Iterator<Item = &(String, crate::job::Scalar)>| {
            settings.map(|(key, value)| format!(", {key} = {value}")).collect::<String>()
        };
        let (experiment, name) = (&self.manifest.name, &self.analysis.name);
        let around = written(&mut settings.iter());
        let mut lines = vec![
            format!("Search `{name}` of experiment `{experiment}`: {agent}, {scenario}{around}"),
            format!(
                "Best of {} tried, by the {} of {}",
                counted(ranking.tried(), "setting"),
                ranking.rule.replace('_', " "),
                metric.title()
            ),
            format!("On the seeds of the search: {}", mean(&winner.sample, metric)),
        ];
        lines.extend(ranking.at_ends().map(|end| format!("At the end of its range: {end}")));
        // Keys outside the agent belong elsewhere in the other manifest.
        let others = |(key, _): &&(String, _)| !key.starts_with("agent.");
        let others = written(&mut winner.settings.iter().filter(others));
        if let Some(others) = others.strip_prefix(", ") {
            lines.push(format!("Chosen as well, outside this table: {others}"));
        }
        let reporting = self.reporting_seeds.len();
        if held_out.n() == 0 {
            lines.push(format!(
                "On held-out seeds: none of {reporting} completed with this environment and evaluation; run them, because the best of several means is too high"
            ));
            return lines;
        }
        let of = match held_out.n() {
            all if all == reporting => String::new(),
            _ => format!(" of {reporting}"),
        };
        lines.push(format!("On held-out seeds: {}{of}", mean(held_out, metric)));
        let new = (held_out.mean(), held_out.interval());
        lines.extend(shrinkage(winner.sample.mean(), new, "held-out", metric));
        lines
    }
}

/// How much the mean of a search exceeds the mean on new seeds, which has this interval, in words; `None` if one of
/// them is undefined. Where the new mean is higher, there is no shrinkage, and the words say so.
///
/// The mean of a search is the best of several and therefore no unbiased estimate. It counts as a fixed number, and the
/// interval shows the uncertainty of the new mean alone.
pub(super) fn shrinkage(
    search: Result<f64, Undefined>,
    (new, interval): (Result<f64, Undefined>, Result<Interval, Undefined>),
    seeds: &str,
    metric: Measure,
) -> Option<String> {
    let (search, new) = (search.ok()?, new.ok()?);
    let is_higher = new > search;
    let interval = interval.map(|Interval { low, high }| {
        let interval = match is_higher {
            true => Interval { low: low - search, high: high - search },
            false => Interval { low: search - high, high: search - low },
        };
        format!(" (95 % interval {})", gap_ends(interval, metric))
    });
    let difference = gap((search - new).abs(), metric) + &interval.unwrap_or_default();
    Some(match is_higher {
        true => format!("No shrinkage: the {seeds} mean is higher by {difference}"),
        false => format!("Expected shrinkage on new seeds, by the {seeds} mean: {difference}"),
    })
}

/// The mean of a sample with its interval and its number of seeds.
fn mean(sample: &Sample, metric: Measure) -> String {
    let shown = sample.mean().map_or_else(|reason| reason.to_string(), |it| amount(it, metric));
    let interval = sample.interval().map(|interval| between(interval, metric));
    format!("{shown}{}, n = {}", interval.unwrap_or_default(), sample.n())
}

fn between(interval: Interval, metric: Measure) -> String {
    format!(" (95 % interval {})", ends(interval, metric))
}
