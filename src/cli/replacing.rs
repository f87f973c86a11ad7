//! Confirmation of a manifest that would remove most jobs from the experiment of its name.

use std::collections::HashSet;
use std::io::{self, Write};

use crate::cli::output::counted;
use crate::cli::{Error, confirm};
use crate::job::JobKey;
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::{self};
use crate::store::Reader;

/// The option for a manifest that would remove most jobs of its experiment.
#[derive(Clone, Copy, clap::Args)]
pub(super) struct Replacing {
    /// Allow a manifest to remove more than half of the jobs of the experiment with its name
    #[arg(long)]
    replace: bool,
}

impl Replacing {
    /// Requires consent, by `--replace` or by a person, for each manifest that would remove more than
    /// half of the jobs of its experiment. Returns whether all may be registered.
    ///
    /// **Errors**: consent is missing, and there is no terminal to ask on.
    pub(super) fn permit(self, reader: &Reader, manifests: &[Manifest]) -> Result<bool, Error> {
        if self.replace {
            return Ok(true);
        }
        for manifest in manifests {
            let (before, lost) = jobs_lost(reader, manifest)?;
            if 2 * lost <= before {
                continue;
            }
            let name = printable(&manifest.name);
            let what = format!(
                "remove {lost} of {} from {name} (their results stay in the store; if this \
                 manifest is a new experiment, give it another name instead)",
                counted(before, "job")
            );
            if !confirm::asked(&what, "--replace")? {
                writeln!(io::stderr(), "{name} was not changed")?;
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// The number of jobs of a manifest's experiment in the store, and how many of them the manifest lacks.
fn jobs_lost(reader: &Reader, manifest: &Manifest) -> Result<(usize, usize), Error> {
    // If the text is unchanged, only a new release can have changed the jobs.
    if reader.manifest(&manifest.name)?.is_none_or(|text| text == manifest.source) {
        return Ok((0, 0));
    }
    let mut held: HashSet<JobKey> = HashSet::new();
    reader.jobs_of(&manifest.name, |key| {
        held.insert(key);
    })?;
    let before = held.len();
    for planned in plan::jobs(manifest) {
        held.remove(&planned.form.key());
    }
    Ok((before, held.len()))
}
