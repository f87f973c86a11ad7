//! What every transaction of the store has in common: how it commits, and its clock.

use rusqlite::Transaction;

use crate::kill_point::{self, KillPoint};

/// Commits; every transaction that writes to a store ends here.
pub(super) fn commit(transaction: Transaction<'_>) -> rusqlite::Result<()> {
    kill_point::pass(KillPoint::BeforeCommit);
    transaction.commit()?;
    kill_point::pass(KillPoint::AfterCommit);
    Ok(())
}

/// SQL for the present instant, as the tables keep it.
pub(super) const NOW: &str = "strftime('%Y-%m-%dT%H:%M:%fZ', 'now')";
