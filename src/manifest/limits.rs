//! Limits on the size of a manifest.

/// Maximum number of jobs that a manifest may declare, including excluded ones.
pub const MOST_JOBS: u64 = 10_000_000;

/// Maximum number of comparisons per manifest: of cells with exclusions, of agents with the values of
/// conditions, and of analyses with the values of agents.
pub(super) const MOST_COMPARISONS: u64 = 50_000_000;
