//! Watching: the state of an experiment while its jobs run.
//!
//! In: a store, the learning curves of running jobs beside it, and the folders of its submissions. Out: a
//! [`View`], as plain data for drawing. Reading waits for no writer and changes no file. What cannot change
//! any more, such as the curve of a completed job, is read once.

mod band;
pub mod failures;
mod view;
mod watcher;

pub use band::{Band, band};
pub use view::{ArmView, CurveChart, FailureView, RunningView, View, ViewChoice};
pub use watcher::{WatchError, Watcher};
