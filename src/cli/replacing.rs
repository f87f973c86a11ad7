//! Confirmation of a manifest that would remove most jobs from the experiment of its name.

use std::io::{self, Write};

use crate::cli::{Error, StoreArgument, confirm, submissions};
use crate::key::printable;
use crate::manifest::Manifest;
use crate::schedule;
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
    /// **Errors**: consent is missing, and there is no terminal to ask on; a submission holds jobs of the experiment.
    pub(super) fn permit(
        self,
        store: &StoreArgument,
        reader: &Reader,
        manifests: &[Manifest],
    ) -> Result<bool, Error> {
        for manifest in manifests {
            let Some(what) = schedule::removal(reader, manifest)? else { continue };
            if !self.replace && !confirm::asked(&what, "--replace")? {
                writeln!(io::stderr(), "{} was not changed", printable(&manifest.name))?;
                return Ok(false);
            }
            submissions::require_closed(store, reader, &manifest.name)?;
        }
        Ok(true)
    }
}
