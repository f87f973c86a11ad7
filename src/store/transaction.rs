//! Common parts of all transactions: the commit and the clock.

use rusqlite::Transaction;

use crate::kill_point::{self, KillPoint};

/// Commits; every transaction that writes to a store calls this.
pub(super) fn commit(transaction: Transaction<'_>) -> rusqlite::Result<()> {
    kill_point::pass(KillPoint::BeforeCommit);
    transaction.commit()?;
    kill_point::pass(KillPoint::AfterCommit);
    Ok(())
}

/// SQL for the current time, in the format of the tables.
pub(super) const NOW: &str = "strftime('%Y-%m-%dT%H:%M:%fZ', 'now')";
