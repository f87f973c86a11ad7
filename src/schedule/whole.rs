//! Manifests from their registration to their stored runs, in one call.

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;

use super::checkpoint::CheckpointFolder;
use super::event::Event;
use super::selection::Selection;
use super::sweep::{Context, Options, SweepError, Tally};
use crate::manifest::Manifest;
use crate::plan::{self, JobKey};
use crate::store::{Experiment, Reader, Registered, Store, StoreError};
use crate::train;

/// Registers a manifest with its jobs, or with those of them that are in `part`, until that is done
/// or `stop` is set; `None` if it was stopped.
///
/// **Errors**: the store fails.
pub fn register(
    store: &mut Store,
    manifest: &Manifest,
    part: Option<&HashSet<JobKey>>,
    stop: &AtomicBool,
) -> Result<Option<Registered>, StoreError> {
    let experiment = Experiment {
        name: &manifest.name,
        question: manifest.question.as_deref(),
        hypothesis: manifest.hypothesis.as_deref(),
        manifest: &manifest.source,
    };
    let jobs = plan::jobs(manifest).map(|planned| (planned.agent, planned.job));
    match part {
        None => store.register_until(stop, &experiment, jobs),
        Some(part) => store.register_part_until(stop, &experiment, jobs, part),
    }
}

/// Registers manifests and runs all of their jobs that have no completed run yet. A later call
/// continues what another call or process left unfinished.
///
/// **Errors**: the store fails, or no worker can be started.
pub fn run_manifests(
    store: &mut Store,
    manifests: &[Manifest],
    options: Options,
    mut hear: impl FnMut(Event<'_>),
) -> Result<Tally, SweepError> {
    let stop = AtomicBool::new(false);
    for manifest in manifests {
        register(store, manifest, None, &stop)?;
    }
    CheckpointFolder::beside(store.path()).clear(&Reader::open(store.path())?)?;
    store.clear_crash_marks()?;
    let queue = Selection::new(manifests, None).expect("no filter refuses").queue();
    let session = store.begin_session(&super::of_this_process())?;
    let context = Context { options, train: &train::run, stop: &stop };
    let swept = super::run(store, session, queue, context, &mut hear);
    let ended = store.end_session(session);
    let tally = swept?;
    ended?;
    Ok(tally)
}
