//! The progress of a training.

/// The progress of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingProgress {
    /// Training episodes finished.
    pub episode: u32,
    /// Total number of training episodes.
    pub episodes: u32,
    /// Mean return of the last 100 episodes, or fewer at the start, in the unit of the environment.
    pub recent_return: f64,
}
