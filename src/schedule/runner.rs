//! Runs the jobs of manifests: from registration to stored runs, of searches one stage after the other.

use std::fs::File;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use super::ending::{Cause, End};
use super::estimates::Estimated;
use super::event::{Event, EventSink};
use super::manifests::{dropped_note, register_experiment};
use super::selection::Selection;
use super::survey::Remaining;
use super::sweep::{Context, Options, SweepError};
use crate::store::{Reader, RetryFailed, Store, StoreError};
use crate::train;

/// The caller of [`run_manifests`]: it is told what happens, on the thread that owns the store. A closure that takes
/// events hears nothing else.
pub trait Caller: EventSink {
    /// A sentence for the user.
    fn note(&mut self, _note: &str) {}

    /// The jobs of a stage are about to run. `before` has the numbers of jobs before the first one of the stage.
    ///
    /// **Errors**: the store fails.
    fn begin(
        &mut self,
        _stage: (&Selection<'_>, &Remaining),
        _before: &End,
        _reader: &Reader,
    ) -> Result<(), StoreError> {
        Ok(())
    }

    /// Receives the file into which the process must write a byte when it crashes. A process that ends without writing
    /// this byte counts as killed.
    fn mark_crash(&mut self, _mark: File) {}

    /// The jobs of a stage have ended; `estimated` says how estimates of completed jobs came about, if there were any.
    fn end(&mut self, _estimated: Option<&Estimated>) {}
}

impl<F: FnMut(Event<'_>)> Caller for F {}

/// How a run of manifests ended.
pub struct EndedRun<'a> {
    /// The numbers of jobs, and why it ended.
    pub end: End,
    /// The jobs, at the stage to which the races came.
    pub selection: Selection<'a>,
}

/// Registers the manifests of a selection with its jobs, and says which jobs that drops; returns early if `stop` is set.
///
/// **Errors**: the store fails.
pub fn register(
    store: &mut Store,
    selection: &Selection<'_>,
    stop: &AtomicBool,
    mut note: impl FnMut(&str),
) -> Result<ControlFlow<()>, StoreError> {
    for manifest in selection.staged() {
        match register_experiment(store, manifest, selection.keys(), stop)? {
            Some(registered) => {
                dropped_note(manifest, &registered).iter().for_each(|text| note(text))
            }
            None => return Ok(ControlFlow::Break(())),
        }
    }
    Ok(ControlFlow::Continue(()))
}

/// Registers the manifests of a selection, runs its jobs that have no completed run, and adds the estimates that
/// completed jobs lack, until all have ended or `stop` is set. After a stop, running jobs write a checkpoint, from which a
/// later call resumes them. The jobs of a search are those that its races want; when they have ended, the next ones are
/// registered and run. `None` if `stop` was set before the first job.
///
/// **Errors**: the store fails, or no worker can be started.
pub fn run_manifests<'a>(
    store: &mut Store,
    selection: &Selection<'a>,
    mut options: Options,
    stop: &AtomicBool,
    caller: &mut dyn Caller,
) -> Result<Option<EndedRun<'a>>, SweepError> {
    let mut selection = selection.at_stage(Some(&store.reader()?))?;
    let mut ran = 0;
    loop {
        let Some(end) = run_stage(store, &selection, options, stop, caller)? else {
            return Ok(None);
        };
        let mut end = end.after(ran);
        let next = selection.at_stage(Some(&store.reader()?))?;
        let goes_on = !next.is_at_stage_of(&selection);
        if goes_on {
            end = end.before_next_stage(options.on_failure);
        }
        if !goes_on || end.cause() != Cause::NothingLeft {
            return Ok(Some(EndedRun { end, selection }));
        }
        // A job that failed is not retried at the next stage.
        options.retry_failed = RetryFailed::No;
        (ran, selection) = (end.ran(), next);
    }
}

/// Registers and runs the jobs of one stage; `None` if `stop` was set before the first one.
fn run_stage(
    store: &mut Store,
    selection: &Selection<'_>,
    options: Options,
    stop: &AtomicBool,
    caller: &mut dyn Caller,
) -> Result<Option<End>, SweepError> {
    if register(store, selection, stop, |note| caller.note(note))?.is_break() {
        return Ok(None);
    }
    let remaining = Remaining::of(store, selection, options.retry_failed)?;
    remaining.changed.notes().for_each(|note| caller.note(&note));
    let mut end = End::before(&remaining);
    caller.begin((selection, &remaining), &end, &store.reader()?)?;
    let lacks_estimates = !remaining.lacking.is_empty();
    if lacks_estimates || !remaining.queue.is_empty() {
        let filter = selection.filter().map(ToString::to_string);
        let session = store.begin_filtered_session(&super::of_this_process(), filter.as_deref())?;
        caller.mark_crash(store.crash_mark(session)?);
        let queue = [remaining.lacking, remaining.queue].concat();
        let context = Context { options, train: &train::run, stop, curves: None };
        let swept = super::run(store, session, queue, context, caller);
        let ended = store.end_session(session);
        end = end.ran_to(swept?);
        ended?;
    }
    caller.end(Some(end.estimated()).filter(|_| lacks_estimates));
    Ok(Some(end.because(stop.load(Ordering::Relaxed), options.on_failure)))
}
