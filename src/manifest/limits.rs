//! How much one manifest may ask for.

/// Most jobs that one manifest may declare, excluded ones among them.
pub const MOST_JOBS: u64 = 10_000_000;

/// Most comparisons of a cell with an exclusion, of an agent with a value of a condition, or of an
/// analysis with what agents have, that one manifest may ask for.
pub(super) const MOST_COMPARISONS: u64 = 50_000_000;
