//! `jitai report`: tables, figures and one page, from the store.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::cli::counting::Counting;
use crate::cli::{Error, Exit, StoreArgument, check, folder};
use crate::manifest::Published;
use crate::report::{AssembleError, ReportFile, Work, assemble, report};
use crate::store::Reader;

/// Write tables, figures and a page about the results that there are
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Manifests (TOML files)
    #[arg(required = true, value_name = "MANIFEST")]
    manifests: Vec<PathBuf>,
    /// Folder to write to; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    store: StoreArgument,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let manifests = check::load_all(&arguments.manifests)?;
    // Their faults come before a folder is made.
    for manifest in &manifests {
        Published::of(manifest).map_err(|faults| Error::Manifests(vec![faults]))?;
    }
    let reader = Reader::open(&arguments.store.store)?;
    folder::make(&arguments.out)?;
    let mut shown: Option<(Work, Counting)> = None;
    let experiments = assemble(&reader, &manifests, |work, done, of| {
        let is_other = shown.as_ref().is_none_or(|(shown, _)| *shown != work);
        if is_other || done == 1 {
            let what = match work {
                Work::Jobs => "jobs read",
                Work::Optima => "optima",
            };
            shown = Some((work, Counting::new(of, what)));
        }
        shown.iter_mut().for_each(|(_, shown)| shown.one_more());
    })
    .map_err(|error| match error {
        AssembleError::Published(faults) => Error::Manifests(vec![faults]),
        AssembleError::Store(error) => error.into(),
    })?;
    drop(shown);
    let store = arguments.store.store.file_name().unwrap_or_default().to_string_lossy();
    let files = report(&experiments, &store);
    files.iter().try_for_each(|file| write(&arguments.out, file))?;
    writeln!(io::stdout(), "{}", arguments.out.join("index.html").display())?;
    Ok(Exit::Done)
}

/// Writes a file of the report, under another name until it is whole.
fn write(folder: &Path, file: &ReportFile) -> Result<(), Error> {
    let path = folder.join(&file.name);
    let failure = |source| Error::Io { what: format!("write `{}`", path.display()), source };
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(failure)?;
    }
    let mut partial = path.clone().into_os_string();
    partial.push(".partial");
    fs::write(&partial, &file.bytes).map_err(failure)?;
    fs::rename(&partial, &path).map_err(failure)
}
