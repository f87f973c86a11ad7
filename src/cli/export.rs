//! `jitai export`: the public views as files.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::cli::answer::{self, AnswerFormat, Failed};
use crate::cli::{Error, Exit, StoreArgument, folder};
use crate::store::Reader;

/// The public views with the order of their rows.
const VIEWS: [(&str, &str); 8] = [
    ("run_summary", "experiment, job_key, agent, attempt"),
    ("parameter", "job_key, name"),
    ("metric", "job_key, name"),
    ("learning_curve", "job_key, metric, episode"),
    ("evaluation_episode", "job_key, episode"),
    ("action_choice", "job_key, p_low, context, action"),
    ("arm_summary", "experiment, job_key, agent"),
    ("decision", "job_key, phase, episode, step"),
];

/// Write the public views as files, one a view
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Folder to write to; made if it is not there, and files of an earlier export are replaced
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The format of the files
    #[arg(long, value_enum, default_value = "csv")]
    format: FileFormat,
    #[command(flatten)]
    store: StoreArgument,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum FileFormat {
    /// Comma-separated values with a header line (RFC 4180).
    Csv,
    /// An array of objects.
    Json,
    /// Apache Parquet; a build with the feature `parquet` writes it.
    Parquet,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let (format, extension) = match arguments.format {
        FileFormat::Csv => (AnswerFormat::Csv, "csv"),
        FileFormat::Json => (AnswerFormat::Json, "json"),
        FileFormat::Parquet => (AnswerFormat::Parquet, "parquet"),
    };
    format.require()?;
    let reader = Reader::open(&arguments.store.store)?;
    let failure = |path: &Path| {
        let what = format!("write `{}`", path.display());
        move |source| Error::Io { what, source }
    };
    folder::make(&arguments.out)?;
    for (view, order) in VIEWS {
        if !reader.has_view(view)? {
            let what = "left out: the store is of an earlier version, and the next run adds it";
            writeln!(io::stderr(), "{view} {what}")?;
            continue;
        }
        let path = arguments.out.join(format!("{view}.{extension}"));
        // Under another name until it is whole.
        let partial = path.with_extension("partial");
        let file = File::create(&partial).map_err(failure(&partial))?;
        let sql = format!("SELECT * FROM {view} ORDER BY {order}");
        answer::write(&reader, &sql, format, BufWriter::new(file)).map_err(
            |failed| match failed {
                Failed::Output(source) => failure(&partial)(source),
                other => other.into(),
            },
        )?;
        fs::rename(&partial, &path).map_err(failure(&path))?;
        writeln!(io::stderr(), "{}", path.display())?;
    }
    Ok(Exit::Done)
}
