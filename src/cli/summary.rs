//! The summary of experiments that `run` ends with.

use std::collections::{HashMap, HashSet};
use std::io::{self, Write};

use crate::analyse::{self, Arm, ArmSummary, Fate};
use crate::cli::Error;
use crate::cli::output::{Cell, Format, Rows, printable};
use crate::env;
use crate::manifest::Manifest;
use crate::plan::{self, JobKey, PlannedJob, Swept};
use crate::record::RunSummary;
use crate::report::{self, Line};
use crate::store::{FailedJob, Reader};

/// Prints mean return ± standard deviation over seeds, an arm a line, for each manifest; returns a
/// completed job, if there is any, for examples. `failed` are the failed jobs of the store.
pub(super) fn print(
    reader: &Reader,
    manifests: &[Manifest],
    failed: &[FailedJob],
) -> Result<Option<JobKey>, Error> {
    let mut out = io::stdout().lock();
    let mut example = None;
    let failed: HashSet<JobKey> = failed.iter().map(|job| job.job_key).collect();
    for manifest in manifests {
        let runs = reader.run_summaries(&manifest.name)?;
        example = example.or(runs.first().map(|run| run.job_key));
        let arms = summarise(manifest, &runs, &failed);
        if arms.is_empty() {
            continue;
        }
        let experiment = printable(&manifest.name);
        writeln!(out, "\n{experiment}: mean return ± sd over seeds, in steps walked")?;
        let (mut columns, lines) = report::summary_table(&arms);
        columns.extend(
            ["context error", "seeds", "mean return ± sd", "disengaged"].map(str::to_owned),
        );
        let mut rows = Rows::new(Format::Table, &columns, &mut out)?;
        for (line, summary) in lines.iter().zip(&arms) {
            rows.row(&cells(line, env::inference_error(summary.arm.sigma)))?;
        }
        rows.finish()?;
    }
    Ok(example)
}

/// The arms that a manifest declares, with what has become of their seeds.
fn summarise(
    manifest: &Manifest,
    runs: &[RunSummary],
    failed: &HashSet<JobKey>,
) -> Vec<ArmSummary> {
    let swept = Swept::of(std::slice::from_ref(manifest));
    let runs: HashMap<JobKey, &RunSummary> = runs.iter().map(|run| (run.job_key, run)).collect();
    analyse::summarise(plan::jobs(manifest).map(|PlannedJob { agent, job, form }| {
        let key = form.key();
        let fate = match runs.get(&key) {
            Some(run) => Fate::Completed(run),
            None if failed.contains(&key) => Fate::Failed,
            None => Fate::Open,
        };
        let arm = Arm {
            swept: swept.texts(&agent, &job),
            agent: agent.to_string(),
            scenario: job.scenario.to_string(),
            sigma: job.environment.sigma,
        };
        (arm, fate)
    }))
}

fn cells(line: &Line, context_error: f64) -> Vec<Cell<'static>> {
    let (spread, disengaged) = match line.means {
        Some(means) => {
            let spread = match means.sd_return {
                Some(sd) => format!("{:.1} ± {sd:.1}", means.mean_return),
                None => format!("{:.1}", means.mean_return),
            };
            let share = format!("{:.1} %", 100.0 * means.disengagement_rate);
            (Cell::Figure(spread), Cell::Figure(share))
        }
        None => (Cell::Empty, Cell::Empty),
    };
    let word = |text: &String| match text.parse::<f64>() {
        Ok(_) => Cell::Figure(text.clone()),
        Err(_) => Cell::text(text.clone()),
    };
    let mut cells: Vec<Cell<'_>> = line.arm.iter().map(word).collect();
    cells.extend([
        Cell::Figure(format!("{:.1} %", 100.0 * context_error)),
        Cell::Figure(line.seeds.clone()),
        spread,
        disengaged,
    ]);
    cells
}

/// A failed job as people tell it from others; its agent alone if its content is not readable.
pub(super) fn name_of_failed(swept: &Swept, failed: &FailedJob) -> String {
    match &failed.job {
        Some(job) => swept.name(&failed.agent, job),
        None => printable(&failed.agent),
    }
}
