//! The summary of experiments at the end of `run`.

use std::io::{self, Write};

use crate::analyse::declared::summarise_arms;
use crate::cli::Error;
use crate::cli::output::{Format, OutputField, OutputRows};
use crate::job::JobKey;
use crate::key::printable;
use crate::plan::Swept;
use crate::record::JobRecord;
use crate::report::{self, SummaryLine, rounded};
use crate::schedule::Selection;
use crate::store::{FailedJob, Parts, Reader};

/// Prints the mean return ± standard deviation over seeds of the selected jobs, one line per arm, for
/// each manifest. Returns a completed job for use in examples, if there is one.
pub(super) fn print(reader: &Reader, selection: &Selection<'_>) -> Result<Option<JobKey>, Error> {
    let mut out = io::stdout().lock();
    let mut example = None;
    for staged in selection.staged() {
        let manifest = staged.manifest();
        let swept = Swept::of(std::slice::from_ref(manifest));
        let jobs = staged
            .jobs()
            .filter(|job| selection.keys().is_none_or(|keys| keys.contains(&job.form.key())));
        let data = reader.data_set_of(&manifest.name, jobs, |_| Parts::default(), |_| {})?;
        // jitai cannot simulate the policy of an outside program.
        let is_outside = |name: &str| {
            let mut agents = manifest.agents.iter();
            manifest.family().is_external()
                || agents.any(|agent| agent.name == name && agent.algorithm.is_external())
        };
        let completed = |job: &&JobRecord| job.completed().is_some() && !is_outside(&job.agent);
        let completed = data.jobs.iter().find(completed);
        example = example.or(completed.map(|job| job.job_key));
        let mut arms = summarise_arms(&data.jobs);
        arms.retain(|arm| !manifest.replays(&arm.name.agent));
        let (mut columns, lines) = report::summary_table(&arms, &swept);
        if lines.is_empty() {
            continue;
        }
        let experiment = printable(&manifest.name);
        let words = report::Words::of(manifest, data.description.as_deref());
        let unit = words.return_unit;
        writeln!(out, "\n{experiment}: mean return ± sd over seeds, in {unit}")?;
        let has_errors = arms.iter().any(|arm| arm.context_error.is_some());
        columns.extend(has_errors.then(|| "context error".to_owned()));
        let terminated = if words.has_optimum { "disengaged" } else { "terminated" };
        columns.extend(["seeds", "mean return ± sd", terminated].map(str::to_owned));
        let mut rows = OutputRows::new(Format::Table, &columns, &mut out)?;
        for (line, arm) in lines.iter().zip(arms.iter().filter(|arm| arm.has_ended())) {
            let error = has_errors.then_some(arm.context_error);
            rows.row(&fields(line, error))?;
        }
        rows.finish()?;
    }
    Ok(example)
}

fn fields(line: &SummaryLine, context_error: Option<Option<f64>>) -> Vec<OutputField<'static>> {
    let percent = |share: f64| OutputField::Figure(format!("{} %", rounded(100.0 * share, 1)));
    let spread = line.returns.map_or(OutputField::Empty, |returns| match returns.sd {
        Ok(sd) => OutputField::Figure(format!("{} ± {sd:.1}", rounded(returns.mean, 1))),
        Err(_) => OutputField::Figure(rounded(returns.mean, 1)),
    });
    let word = |text: &String| match text.parse::<f64>() {
        Ok(_) => OutputField::Figure(text.clone()),
        Err(_) => OutputField::text(text.clone()),
    };
    let mut fields: Vec<OutputField<'_>> = line.arm.iter().map(word).collect();
    fields.extend(context_error.map(|error| error.map_or(OutputField::Empty, percent)));
    fields.extend([
        OutputField::Figure(line.seeds.clone()),
        spread,
        line.terminated.map_or(OutputField::Empty, |share| percent(share.mean)),
    ]);
    fields
}

/// The short name of a failed job; only the agent's name if the job's content cannot be read.
pub(super) fn name_of_failed(swept: &Swept, failed: &FailedJob) -> String {
    match &failed.job {
        Some(job) => swept.name(&failed.agent, job),
        None => printable(&failed.agent),
    }
}
