//! `jitai export`: the public views as files, or a trained policy.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::cli::answer::{self, AnswerFormat, Failed};
use crate::cli::{Error, Exit, StoreArgument, folder, simulate};
use crate::manifest::companions;
use crate::portable::portable;
use crate::report::unused_stem;
use crate::store::{self, Reader};

/// Write the public views as files, with the meanings of their columns and the manifests; or write
/// a trained policy
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Output folder; created if it does not exist. Files of an earlier export are replaced
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// File format
    #[arg(long, value_enum, default_value = "csv", conflicts_with = "policy")]
    format: FileFormat,
    /// Export the agent that this job trained instead of the views: policy.json, weights.safetensors
    /// and policy.onnx (a prefix of the job key is enough)
    #[arg(long, value_name = "JOB KEY")]
    policy: Option<String>,
    /// Export only this experiment and its jobs; may be repeated
    #[arg(long, value_name = "NAME", conflicts_with = "policy")]
    experiment: Vec<String>,
    #[command(flatten)]
    store: StoreArgument,
}

fn failure(path: &Path) -> impl FnOnce(io::Error) -> Error {
    let what = format!("write `{}`", path.display());
    move |source| Error::Io { what, source }
}

/// Writes the policy of a completed job.
fn write_policy(key: &str, arguments: &Arguments) -> Result<Exit, Error> {
    let reader = Reader::open(&arguments.store.store)?;
    let stored = reader.weights(key).map_err(|error| simulate::refused_key("--policy", error))?;
    let policy = portable(&stored).map_err(|error| Error::Usage(format!("--policy: {error}")))?;
    let description = format!("{:#}\n", policy.description);
    folder::make(&arguments.out)?;
    // The description comes last, because it names the other files with their digests.
    for (name, bytes) in [
        ("weights.safetensors", &policy.weights[..]),
        ("policy.onnx", &policy.onnx[..]),
        ("policy.json", description.as_bytes()),
    ] {
        let path = arguments.out.join(name);
        // Renamed once complete.
        let partial = arguments.out.join(format!("{name}.partial"));
        fs::write(&partial, bytes).map_err(failure(&partial))?;
        fs::rename(&partial, &path).map_err(failure(&path))?;
        writeln!(io::stderr(), "{}", path.display())?;
    }
    Ok(Exit::Done)
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum FileFormat {
    /// Comma-separated values with a header line (RFC 4180).
    Csv,
    /// A JSON array of objects.
    Json,
    /// Apache Parquet, with types; missing in a build with `--no-default-features`.
    Parquet,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    if let Some(key) = &arguments.policy {
        return write_policy(key, arguments);
    }
    let (format, extension) = match arguments.format {
        FileFormat::Csv => (AnswerFormat::Csv, "csv"),
        FileFormat::Json => (AnswerFormat::Json, "json"),
        FileFormat::Parquet => (AnswerFormat::Parquet, "parquet"),
    };
    format.require()?;
    let reader = Reader::open(&arguments.store.store)?;
    let manifests = chosen(&reader, &arguments.experiment)?;
    folder::make(&arguments.out)?;
    for (view, sql) in store::exports(&arguments.experiment) {
        if !reader.has_view(view)? {
            let why = "an earlier version made the store; the next `jitai run` adds the view";
            writeln!(io::stderr(), "{view} left out: {why}")?;
            continue;
        }
        let path = arguments.out.join(format!("{view}.{extension}"));
        write_whole(&path, |file| {
            answer::write(&reader, &sql, format, file).map_err(|failed| match failed {
                Failed::Output(source) => failure(&path)(source),
                other => other.into(),
            })
        })?;
    }
    let path = arguments.out.join("columns.csv");
    write_whole(&path, |file| write_columns(file).map_err(|error| failure(&path)(error.into())))?;
    let folder = arguments.out.join("manifests");
    folder::make(&folder)?;
    let mut stems = Vec::new();
    for (experiment, text) in manifests {
        let stem = unused_stem(&stems, &experiment);
        let path = folder.join(format!("{stem}.toml"));
        for companion in companions(&text) {
            let what =
                format!("manifests/{stem}.toml reads {companion}, which the store does not have");
            writeln!(io::stderr(), "note: {what}; pass this file on, too")?;
        }
        stems.push(stem);
        write_whole(&path, |mut file| file.write_all(text.as_bytes()).map_err(failure(&path)))?;
    }
    Ok(Exit::Done)
}

/// The experiments to export, each with its manifest.
fn chosen(reader: &Reader, names: &[String]) -> Result<Vec<(String, String)>, Error> {
    let mut manifests = reader.manifests()?;
    if let Some(unknown) =
        names.iter().find(|name| manifests.iter().all(|(known, _)| known != *name))
    {
        let known: Vec<&str> = manifests.iter().map(|(name, _)| name.as_str()).collect();
        let known = known.join(", ");
        let what = format!("--experiment: the store has no experiment `{unknown}`; it has {known}");
        return Err(Error::Usage(what));
    }
    manifests.retain(|(name, _)| names.is_empty() || names.contains(name));
    Ok(manifests)
}

/// Writes a file under a temporary name, renames it once it is complete, and prints its name.
fn write_whole(
    path: &Path,
    write: impl FnOnce(BufWriter<File>) -> Result<(), Error>,
) -> Result<(), Error> {
    let partial = path.with_extension("partial");
    let file = File::create(&partial).map_err(failure(&partial))?;
    write(BufWriter::new(file))?;
    fs::rename(&partial, path).map_err(failure(path))?;
    writeln!(io::stderr(), "{}", path.display())?;
    Ok(())
}

/// The columns of all views: type, unit and meaning.
fn write_columns(file: BufWriter<File>) -> Result<(), csv::Error> {
    let mut out = csv::Writer::from_writer(file);
    out.write_record(["view", "column", "type", "unit", "meaning"])?;
    for column in store::columns() {
        let store::Column { view, name, kind, unit, meaning } = column;
        out.write_record([view, name, kind, unit, meaning])?;
    }
    out.flush()?;
    Ok(())
}
