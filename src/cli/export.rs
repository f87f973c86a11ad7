//! `jitai export`: the public views as files, or a trained policy.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::cli::answer::{self, AnswerFormat, Failed};
use crate::cli::output::no_experiment;
use crate::cli::{Error, Exit, StoreArgument, after_study, export_data, folder, simulate};
use crate::key::digest;
use crate::manifest::companions;
use crate::plan::Filter;
use crate::portable::portable;
use crate::report::{defused, unused_stem};
use crate::store::{self, Reader};

/// Write the public views as files, with the meanings of their columns and the manifests; or write
/// a trained policy
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Output folder; created if it does not exist. Files of an earlier export are replaced
    #[arg(long, value_name = "DIR", value_hint = clap::ValueHint::DirPath)]
    out: PathBuf,
    /// File format
    #[arg(long, value_enum, default_value = "csv", conflicts_with = "policy")]
    format: FileFormat,
    /// Export the agent that this job trained instead of the views: policy.json, and weights.safetensors
    /// and policy.onnx of a network (a prefix of the job key is enough)
    #[arg(long, value_name = "JOB KEY")]
    policy: Option<String>,
    /// Export the decisions of this job instead, as a recorded trial: trial.csv, and trial.toml, a manifest with [data] that
    /// reads them back and replays a bandit on them (a prefix of the job key is enough)
    #[arg(long, value_name = "JOB KEY", conflicts_with_all = ["policy", "format", "experiment", "after_study"])]
    data: Option<String>,
    /// Export a trial of this manifest instead, for standard errors that account for an agent that learned from everybody:
    /// its decisions and updates, and analysis.py, which gives them to the Python package lifejacket
    #[arg(long, value_name = "MANIFEST", conflicts_with_all = ["policy", "format", "experiment"])]
    after_study: Option<PathBuf>,
    /// The trial to export, such as agent=thompson,seed=1, if the manifest has several
    #[arg(long, value_name = "NAME=VALUE,...", requires = "after_study")]
    filter: Option<Filter>,
    /// The estimate whose standard errors are computed, if the manifest has several
    #[arg(long, value_name = "NAME", requires = "after_study")]
    estimate: Option<String>,
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
    let files = policy.files.into_iter();
    for (name, bytes) in files.chain([("policy.json", description.into_bytes())]) {
        let path = arguments.out.join(name);
        folder::write(&path, &bytes)?;
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
    if let Some(key) = &arguments.data {
        return export_data::write(&Reader::open(&arguments.store.store)?, key, &arguments.out);
    }
    if let Some(manifest) = &arguments.after_study {
        let (filter, estimate) = (arguments.filter.as_ref(), arguments.estimate.as_deref());
        return after_study::write(manifest, filter, estimate, &arguments.out);
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
    for (view, sql) in reader.exports(&arguments.experiment)? {
        let path = arguments.out.join(format!("{view}.{extension}"));
        let Some(sql) = sql else {
            let why = "an earlier version made the store; the next `jitai run` adds the view";
            writeln!(io::stderr(), "{view} left out: {why}")?;
            remove(&path)?;
            continue;
        };
        write_whole(&path, |file| {
            answer::write(&reader, &sql, format, file).map_err(|failed| match failed {
                Failed::Output(source) => failure(&path)(source),
                other => other.into(),
            })
        })?;
    }
    let path = arguments.out.join("columns.csv");
    write_whole(&path, |file| write_columns(file).map_err(|error| failure(&path)(error.into())))?;
    write_manifests(&arguments.out.join("manifests"), manifests)?;
    Ok(Exit::Done)
}

/// Writes the manifests of experiments, and the list of their files. Removes the manifests of an earlier
/// export that this one does not have.
fn write_manifests(folder: &Path, manifests: Vec<(String, String)>) -> Result<(), Error> {
    folder::make(folder)?;
    let mut stems = Vec::new();
    let mut listed = Vec::new();
    for (experiment, text) in manifests {
        let stem = unused_stem(&stems, &experiment);
        for companion in companions(&text) {
            let what =
                format!("manifests/{stem}.toml reads {companion}, which the store does not have");
            writeln!(io::stderr(), "note: {what}; pass this file on, too")?;
        }
        let name = format!("{stem}.toml");
        stems.push(stem);
        let path = folder.join(&name);
        write_whole(&path, |mut file| {
            file.write_all(text.as_bytes()).and_then(|()| file.flush()).map_err(failure(&path))
        })?;
        listed.push([name, defused(&experiment).into_owned(), digest(text.as_bytes())]);
    }
    let index = folder.join(INDEX);
    remove_earlier(&index, &listed)?;
    write_whole(&index, |file| {
        let mut out = csv::Writer::from_writer(file);
        let header = out.write_record(["file", "experiment", "sha256"]);
        header
            .and_then(|()| listed.iter().try_for_each(|row| out.write_record(row)))
            .and_then(|()| Ok(out.flush()?))
            .map_err(|error| failure(&index)(error.into()))
    })
}

/// The list of the manifests of an export, for the next export: file, experiment, and SHA-256 of the file.
const INDEX: &str = ".index.csv";

/// Removes the files that an earlier export listed and this one does not have, unless somebody has changed
/// them since.
fn remove_earlier(index: &Path, listed: &[[String; 3]]) -> Result<(), Error> {
    let Ok(mut earlier) = csv::Reader::from_path(index) else { return Ok(()) };
    // A damaged line names no file to remove.
    for row in earlier.deserialize::<[String; 3]>().flatten() {
        let [name, _, sha256] = row;
        let is_name = Path::new(&name).file_name().is_some_and(|last| last == name.as_str());
        if !is_name || listed.iter().any(|[ours, ..]| *ours == name) {
            continue;
        }
        let path = index.with_file_name(name);
        match fs::read(&path) {
            Ok(bytes) if digest(&bytes) == sha256 => remove(&path)?,
            Ok(_) => {
                let what = "of an earlier export was changed since, and is kept";
                writeln!(io::stderr(), "note: {} {what}", path.display())?;
            }
            Err(_) => {}
        }
    }
    Ok(())
}

/// Removes a file of an earlier export, if there is one.
fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => {
            let what = format!("remove `{}`, which an earlier export wrote", path.display());
            Err(Error::Io { what, source })
        }
        Ok(()) => Ok(writeln!(io::stderr(), "{} removed", path.display())?),
    }
}

/// The experiments to export, each with its manifest.
fn chosen(reader: &Reader, names: &[String]) -> Result<Vec<(String, String)>, Error> {
    let mut manifests = reader.manifests()?;
    if let Some(unknown) =
        names.iter().find(|name| manifests.iter().all(|(known, _)| known != *name))
    {
        let known: Vec<&str> = manifests.iter().map(|(name, _)| name.as_str()).collect();
        let what = format!("--experiment: {}", no_experiment("the store", unknown, &known));
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
    if let Err(error) = write(BufWriter::new(file)) {
        // The error takes precedence; the next export overwrites a leftover file.
        let _ = fs::remove_file(&partial);
        return Err(error);
    }
    fs::rename(&partial, path).map_err(failure(path))?;
    writeln!(io::stderr(), "{}", path.display())?;
    Ok(())
}

/// The columns of all views: type, unit and meaning.
fn write_columns(file: BufWriter<File>) -> Result<(), csv::Error> {
    let mut out = csv::Writer::from_writer(file);
    out.write_record(["view", "column", "type", "unit", "meaning"])?;
    for column in store::columns() {
        let store::ViewColumn { view, name, kind, unit, meaning } = column;
        out.write_record([view, name, kind, unit, meaning])?;
    }
    out.flush()?;
    Ok(())
}
