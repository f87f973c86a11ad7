//! `jitai plan`: shows which jobs would run, and why.

use std::io::{self, Write};
use std::num::NonZeroUsize;

use crate::cli::check::ManifestArguments;
use crate::cli::output::{Format, OutputField, OutputRows};
use crate::cli::workers::workers;
use crate::cli::{Error, Exit, StoreArgument, counts};
use crate::key::{Parameter, printable, shortened};
use crate::manifest::Manifest;
use crate::plan::{self, Filter, Shard, Swept};
use crate::schedule::{self, Preview, Selection, Speeds, Survey, Surveyed};
use crate::store::{Reader, StoreError};

/// Show what would run: jobs completed, pending and failed, and the estimated time
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// List the jobs
    #[arg(long)]
    jobs: bool,
    /// Print the resolved manifests instead, with presets merged and every default written out
    #[arg(long, conflicts_with_all = ["jobs", "filter", "format"])]
    resolved: bool,
    /// Show only the jobs with these parameters, such as agent=dqn,gamma=0.9|0.99
    ///
    /// Commas separate conditions, and bars separate alternatives. A value that contains one of them stands in
    /// double quotes, which the shell must not remove: --filter 'agent="a,b"'. In quotes, \" and \\
    /// stand for a quote and a backslash.
    #[arg(long, value_name = "NAME=VALUE,...")]
    filter: Option<Filter>,
    /// Show only one shard of the jobs, such as 3/40, as for `run`
    #[arg(long, value_name = "I/N", conflicts_with = "resolved")]
    shard: Option<Shard>,
    /// Number of workers for the estimated time [default: one per core, as for `run`]
    #[arg(long, value_name = "N", value_parser = workers)]
    workers: Option<NonZeroUsize>,
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let manifests = arguments.manifests.load(&arguments.store)?;
    if arguments.resolved {
        for manifest in &manifests {
            write!(io::stdout(), "{}", manifest.resolved())?;
        }
        return Ok(Exit::Done);
    }
    let reader = match Reader::open(&arguments.store.store) {
        Ok(reader) => Some(reader),
        Err(StoreError::Missing { .. } | StoreError::Empty { .. }) => None,
        Err(error) => return Err(error.into()),
    };
    let lines = manifests.iter().filter_map(|one| Some((&one.name, plan::race_line(one)?)));
    let lines = lines.map(|(name, line)| format!("search {}: {line}", printable(name)));
    let races: Vec<String> =
        lines.chain(schedule::race_notes(&manifests, reader.as_ref())?).collect();
    let mut selection = Selection::new(&manifests, arguments.filter.as_ref())?;
    selection = selection.at_stage(reader.as_ref())?;
    if let Some(shard) = arguments.shard {
        selection = selection.shard(shard);
    }
    let survey = Survey::of(&selection, reader.as_ref());
    if arguments.jobs {
        list_jobs(survey, &manifests, arguments.format)?;
    } else {
        let speeds = reader.as_ref().map_or(Ok(Speeds::default()), Speeds::of)?;
        let workers = arguments.workers.unwrap_or_else(schedule::one_per_core);
        list_experiments(&Preview::of(survey, &manifests, speeds, workers)?, arguments.format)?;
        races.iter().try_for_each(|note| writeln!(io::stderr(), "{note}"))?;
    }
    Ok(Exit::Done)
}

fn list_experiments(preview: &Preview<'_>, format: Format) -> io::Result<()> {
    let columns = counts::COLUMNS.map(str::to_owned);
    let mut rows = OutputRows::new(format, &columns, io::stdout().lock())?;
    for (name, counts, left) in preview.experiments() {
        rows.row(&counts::fields(name, counts, left))?;
    }
    rows.finish()?;
    preview.notes().iter().try_for_each(|note| writeln!(io::stderr(), "{note}"))
}

fn list_jobs(mut survey: Survey<'_>, manifests: &[Manifest], format: Format) -> Result<(), Error> {
    let columns =
        ["experiment", "job_key", "agent", "scenario", "sigma", "seed", "swept", "state", "reason"];
    let mut rows = OutputRows::new(format, &columns.map(str::to_owned), io::stdout().lock())?;
    let swept = Swept::of(manifests);
    for (index, manifest) in manifests.iter().enumerate() {
        survey.walk(index, |surveyed| {
            let reason = surveyed.reason()?;
            let Surveyed { key, planned, state, .. } = surveyed;
            let row = rows.row(&[
                OutputField::text(&manifest.name),
                OutputField::text(key.to_string()),
                OutputField::text(&*planned.agent),
                OutputField::text(planned.job.scenario.to_string()),
                planned
                    .job
                    .number(Parameter::Environment("sigma"))
                    .map_or(OutputField::Empty, OutputField::Real),
                OutputField::Integer(planned.job.seed as i64),
                match format {
                    Format::Json => OutputField::Nested(swept.object(&planned.agent, &planned.job)),
                    Format::Csv => OutputField::text(swept.words(&planned.agent, &planned.job)),
                    Format::Table => {
                        OutputField::text(shortened(&swept.words(&planned.agent, &planned.job)))
                    }
                },
                OutputField::text(state.name()),
                reason.map_or(OutputField::Empty, |reason| OutputField::text(reason.to_string())),
            ]);
            row.map_err(Error::from)
        })?;
    }
    Ok(rows.finish()?)
}
