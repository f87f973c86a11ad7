//! Points at which the process can kill itself, for tests of recovery.
//!
//! In: the value of [`VARIABLE`], such as `before-commit:3`. The process kills itself with SIGKILL when it
//! passes the point for the third time, which no signal from outside could time as precisely. The
//! module does not depend on the data written at these points. If no point is chosen, passing one
//! costs a single check.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use signal_hook::consts::SIGKILL;
use signal_hook::low_level::raise;

/// The environment variable that chooses a point: its name, a colon, and the number of the pass.
pub const VARIABLE: &str = "JITAI_KILL_AT";

/// A point at which the process can be killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KillPoint {
    /// A transaction of the store is about to be committed.
    BeforeCommit,
    /// A transaction of the store has been committed.
    AfterCommit,
    /// A checkpoint is on the disk under its temporary name.
    CheckpointWritten,
    /// A checkpoint has its final name; earlier checkpoints still exist.
    CheckpointRenamed,
    /// Ends of runs are stored; the checkpoints of their jobs still exist.
    EndsStored,
}

impl KillPoint {
    /// Every point.
    pub const ALL: [KillPoint; 5] = [
        KillPoint::BeforeCommit,
        KillPoint::AfterCommit,
        KillPoint::CheckpointWritten,
        KillPoint::CheckpointRenamed,
        KillPoint::EndsStored,
    ];

    /// The name of the point in [`VARIABLE`].
    pub fn name(self) -> &'static str {
        match self {
            KillPoint::BeforeCommit => "before-commit",
            KillPoint::AfterCommit => "after-commit",
            KillPoint::CheckpointWritten => "checkpoint-written",
            KillPoint::CheckpointRenamed => "checkpoint-renamed",
            KillPoint::EndsStored => "ends-stored",
        }
    }
}

/// A value that does not choose a point.
#[derive(Debug, thiserror::Error)]
#[error("{VARIABLE} is `{0}`; expected a place and a number from 1, such as before-commit:3")]
pub struct KillPointError(String);

/// The chosen point.
#[derive(Debug)]
struct Chosen {
    point: KillPoint,
    /// Number of passes until the process is killed.
    left: AtomicU64,
}

static CHOSEN: OnceLock<Chosen> = OnceLock::new();

/// Chooses the point at which this process kills itself; only the first choice counts.
///
/// **Errors**: the text does not name a point, or its number is below 1.
pub fn choose(text: &str) -> Result<(), KillPointError> {
    let (point, passes) = parse(text).ok_or_else(|| KillPointError(text.to_owned()))?;
    CHOSEN.get_or_init(|| Chosen { point, left: AtomicU64::new(passes) });
    Ok(())
}

fn parse(text: &str) -> Option<(KillPoint, u64)> {
    let (name, passes) = text.split_once(':')?;
    let point = KillPoint::ALL.into_iter().find(|point| point.name() == name)?;
    let passes = passes.parse().ok().filter(|passes| *passes > 0)?;
    Some((point, passes))
}

/// Kills the process at the chosen pass of the chosen point.
pub(crate) fn pass(point: KillPoint) {
    let Some(chosen) = CHOSEN.get().filter(|chosen| chosen.point == point) else { return };
    if chosen.left.fetch_sub(1, Ordering::Relaxed) == 1 {
        raise(SIGKILL).expect("a process may kill itself");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_a_name_and_how_often_it_is_passed() {
        for point in KillPoint::ALL {
            assert_eq!(parse(&format!("{}:12", point.name())), Some((point, 12)));
        }
        for text in ["", "before-commit", "before-commit:", "before-commit:0", "commit:1", ":1"] {
            assert_eq!(parse(text), None, "{text}");
        }
        let message = choose("before-commit:-1").unwrap_err().to_string();
        assert!(message.starts_with("JITAI_KILL_AT is `before-commit:-1`; expected"), "{message}");
    }
}
