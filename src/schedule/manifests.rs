//! Manifests and the experiments of a store: registration, and the manifest that a store keeps.

use std::collections::HashSet;
use std::fs;
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::job::{JobKey, counted};
use crate::key::printable;
use crate::manifest::{self, Manifest, Runs};
use crate::plan::{self, Staged};
use crate::portable::posterior_in;
use crate::store::{Experiment, Reader, Registered, Store, StoreError};

/// Registers a manifest with its jobs up to the stage of its races, or only with those in `part`. Returns `None` if
/// `stop` was set before the registration was complete.
///
/// **Errors**: the store fails.
pub(super) fn register_experiment(
    store: &mut Store,
    manifest: &Staged<'_>,
    part: Option<&HashSet<JobKey>>,
    stop: &AtomicBool,
) -> Result<Option<Registered>, StoreError> {
    let text = manifest::kept_text(manifest);
    let experiment = Experiment {
        name: &manifest.name,
        question: manifest.question.as_deref(),
        hypothesis: manifest.hypothesis.as_deref(),
        manifest: &text,
    };
    let jobs = manifest.jobs().map(|planned| (planned.agent, planned.form));
    let registered = store.register_until(stop, &experiment, jobs, part)?;
    let declared = manifest.agents.iter().flat_map(|agent| {
        manifest.estimates_of(&agent.name).into_iter().map(|one| (agent.name.as_str(), one))
    });
    store.declare_estimates(&manifest.name, declared)?;
    Ok(registered)
}

/// The manifest of an experiment in a store, from its text; `None` if this release cannot read it. The files that it
/// names are read beside a file with the same text that a command of the store names, or else in the working folder.
pub fn stored_manifest(reader: &Reader, text: &str) -> Option<Manifest> {
    let policy = |key: &str| posterior_in(reader.path(), key);
    let path = match manifest::companions(text).is_empty() {
        true => None,
        false => path_of(reader, text),
    };
    let label = path.as_deref().unwrap_or(Path::new("manifest.toml")).to_string_lossy();
    let read = manifest::parse_with(&label, text, &[], Runs(Some(&policy)));
    read.ok().map(|read| read.manifest)
}

/// The path of a manifest with this text, from the commands that changed the store; the latest command first.
fn path_of(reader: &Reader, text: &str) -> Option<PathBuf> {
    let log = reader.log().unwrap_or_default();
    let mut paths = log.iter().rev().flat_map(|(_, command)| {
        // A path with spaces stands between quotes.
        let quoted = command.words.split(['\'', '"']);
        let words = quoted.flat_map(|words| iter::once(words).chain(words.split_whitespace()));
        let manifests = words.filter(|word| word.ends_with(".toml"));
        manifests.map(|path| Path::new(&command.folder).join(path))
    });
    paths.find(|path| fs::read_to_string(path).is_ok_and(|found| found == text))
}

/// The warning that a registration dropped jobs of the experiment; `None` if it dropped no job.
pub(super) fn dropped_note(manifest: &Manifest, registered: &Registered) -> Option<String> {
    let (name, jobs) = (printable(&manifest.name), counted(registered.dropped, "job"));
    (registered.dropped > 0).then(|| match manifest.search {
        // A race that goes back to an earlier rung, because it has more arms, is no new experiment.
        Some(_) => format!(
            "the race of {name} does not need {jobs} at its present rung; their results stay in the store"
        ),
        None => format!(
            "{name} no longer has {jobs} that it had before; their results stay in the store; if this manifest is a \
             new experiment, give it another name"
        ),
    })
}

/// What the registration of a manifest would remove: `None` unless it would remove more than half of the jobs
/// of the experiment of its name.
///
/// **Errors**: the store fails.
pub fn removal(reader: &Reader, manifest: &Manifest) -> Result<Option<String>, StoreError> {
    // If the text is unchanged, only a new release can have changed the jobs.
    if reader.manifest(&manifest.name)?.is_none_or(|text| text == manifest::kept_text(manifest)) {
        return Ok(None);
    }
    let mut held: HashSet<JobKey> = HashSet::new();
    reader.jobs_of(&manifest.name, |key| {
        held.insert(key);
    })?;
    let before = held.len();
    for planned in plan::jobs(manifest) {
        held.remove(&planned.form.key());
    }
    let lost = held.len();
    Ok((2 * lost > before).then(|| {
        format!(
            "remove {lost} of {} from {} (their results stay in the store; if this manifest is a new \
             experiment, give it another name instead)",
            counted(before, "job"),
            printable(&manifest.name),
        )
    }))
}
