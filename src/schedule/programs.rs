//! The files of outside programs: whether a program has changed since jobs ran with it, under the same `version`.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::job::{Job, counted};
use crate::key::{digest, printable};

/// The largest file that is read. A larger one is data, and no program.
const LARGEST: u64 = 16 << 20;

/// The words of the job's commands that are files in a folder, each with the SHA-256 of the file.
pub(super) fn files(job: &Job, folder: &Path) -> BTreeMap<String, String> {
    let known = |word: String| {
        let path = folder.join(&word);
        // A pipe or a device might never end.
        let about = fs::metadata(&path).ok().filter(|about| about.is_file())?;
        let bytes = if about.len() <= LARGEST { fs::read(path).ok()? } else { return None };
        Some((word, digest(&bytes)))
    };
    job.programs().into_iter().filter_map(known).collect()
}

/// Files that have changed, each with the number of completed jobs that ran with it as it was before.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChangedPrograms(BTreeMap<String, usize>);

impl ChangedPrograms {
    /// Adds a completed job, whose files were these `then` and are these `now`.
    pub(super) fn add(&mut self, then: &BTreeMap<String, String>, now: &BTreeMap<String, String>) {
        let changed = then.iter().filter(|(word, was)| now.get(*word).is_some_and(|is| is != *was));
        changed.for_each(|(word, _)| *self.0.entry(word.clone()).or_default() += 1);
    }

    /// A warning about each file.
    pub fn notes(&self) -> impl Iterator<Item = String> {
        self.0.iter().map(|(file, jobs)| {
            format!(
                "{} has changed since {} ran with it, under the same `version`; their results stay as they are: to run \
                 them again with the file of today, raise `version` in the manifest, and run it with --replace",
                printable(file),
                counted(*jobs, "completed job"),
            )
        })
    }
}
