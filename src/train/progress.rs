//! How far a training has come.

/// How far a training has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainingProgress {
    /// Training episodes finished.
    pub episode: u32,
    /// Training episodes in all.
    pub episodes: u32,
    /// Mean return of the last hundred episodes or fewer, in steps walked.
    pub recent_return: f64,
}
