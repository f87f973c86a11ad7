//! Places at which the process kills itself when it is told to: for tests that look at what is left.
//!
//! In: the text of [`VARIABLE`], such as `before-commit:3`. The process then ends by SIGKILL as it
//! passes the place for the third time, where no signal from outside could be aimed so well. It does
//! not know what is written at these places. Unless one is chosen, passing costs the look at one
//! variable of the process.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use signal_hook::consts::SIGKILL;
use signal_hook::low_level::raise;

/// The environment variable that chooses a place: its name, a colon, and how often it is passed.
pub const VARIABLE: &str = "JITAI_KILL_AT";

/// A place where the process can be killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KillPoint {
    /// A transaction of the store is about to be committed.
    BeforeCommit,
    /// A transaction of the store has been committed.
    AfterCommit,
    /// A checkpoint is on the disk, under the name of an unfinished one.
    CheckpointWritten,
    /// A checkpoint has its name; earlier ones are still there.
    CheckpointRenamed,
    /// Ends of runs are stored; the checkpoints of their jobs are still there.
    EndsStored,
}

impl KillPoint {
    /// Every place.
    pub const ALL: [KillPoint; 5] = [
        KillPoint::BeforeCommit,
        KillPoint::AfterCommit,
        KillPoint::CheckpointWritten,
        KillPoint::CheckpointRenamed,
        KillPoint::EndsStored,
    ];

    /// Its name, as [`VARIABLE`] takes it.
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

/// A text that chooses no place.
#[derive(Debug, thiserror::Error)]
#[error("{VARIABLE} is `{0}`; expected a place and a number from 1, such as before-commit:3")]
pub struct KillPointError(String);

/// The chosen place.
#[derive(Debug)]
struct Chosen {
    point: KillPoint,
    /// How often it is still to be passed.
    left: AtomicU64,
}

static CHOSEN: OnceLock<Chosen> = OnceLock::new();

/// Chooses the place at which this process ends; only the first choice counts.
///
/// **Errors**: the text names no place, or no number from 1.
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

/// Ends the process if this is the place and the time.
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
        let told = choose("before-commit:-1").unwrap_err().to_string();
        assert!(told.starts_with("JITAI_KILL_AT is `before-commit:-1`; expected"), "{told}");
    }
}
