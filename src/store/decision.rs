//! Recorded decisions as rows: their ids and insertion.

use std::sync::LazyLock;

use rusqlite::types::Null;
use rusqlite::{CachedStatement, Connection, Error};

use crate::job::{Decision, Phase, Results};

use super::tables::RUN;

/// The number of steps per row.
const STEPS: usize = 10;
/// The number of bits per step.
const BITS: usize = 5;
/// The number of real values per step.
const NUMBERS: usize = 5;
/// The number of columns of the table.
const COLUMNS: usize = 3 + STEPS * NUMBERS;

// The lowest bits of the parts of a row id; the bits below the episode are the step.
const PHASE: u32 = 38;
const EPISODE: u32 = 14;

static INSERT: LazyLock<String> = LazyLock::new(|| {
    format!("INSERT INTO recorded_decision VALUES ({})", ["?"; COLUMNS].join(", "))
});

/// The names of the states that rows can hold. Decisions with other states are rows of
/// [`family`](super::family).
pub(super) const STATE: [&str; 5] =
    ["context", "probability", "likely_context", "habituation", "disengagement"];

/// Whether the decisions of a run are rows of this table. An outside environment may use the same names for other
/// numbers; its actions have no strata.
pub(super) fn packs(results: &Results) -> bool {
    results.state_names == STATE && results.actions.iter().all(|choice| choice.stratum.is_some())
}

/// Inserts the decisions of a run in progress, which must be sorted by phase, episode and step, and whose states
/// must have the names of [`STATE`].
///
/// **Errors**: a number is not finite, or an episode or step exceeds its bits in the row id.
pub(super) fn insert(
    connection: &Connection,
    run: i64,
    decisions: &[Decision],
) -> rusqlite::Result<()> {
    let mut insert = connection.prepare_cached(&INSERT)?;
    blocks(decisions).try_for_each(|steps| insert_steps(&mut insert, run, steps))
}

/// The consecutive steps of an episode that make a row.
pub(super) fn blocks(decisions: &[Decision]) -> impl Iterator<Item = &[Decision]> {
    decisions
        .chunk_by(|one, next| (one.phase, one.episode) == (next.phase, next.episode))
        .flat_map(|episode| episode.chunks(STEPS))
}

/// Inserts consecutive steps of an episode as one row.
fn insert_steps(
    insert: &mut CachedStatement<'_>,
    run: i64,
    steps: &[Decision],
) -> rusqlite::Result<()> {
    let mut bits = 0_i64;
    for (index, decision) in steps.iter().enumerate() {
        let &[context, probability, likely, habituation, disengagement] = &*decision.state else {
            let error = format!("a decision does not have the state {STATE:?}: {decision:?}");
            return Err(Error::ToSqlConversionFailure(error.into()));
        };
        let step = u8::from(context != 0.0)
            | u8::from(likely != 0.0) << 1
            | u8::from(decision.available) << 2
            | decision.action << 3;
        bits |= i64::from(step) << (BITS * index);
        let numbers = [
            probability,
            habituation,
            disengagement,
            decision.action_probability(),
            decision.reward,
        ];
        if !numbers.iter().all(|number| number.is_finite()) {
            let error = format!("a decision has a number that is not finite: {decision:?}");
            return Err(Error::ToSqlConversionFailure(error.into()));
        }
        for (number, column) in numbers.into_iter().zip(4 + NUMBERS * index..) {
            insert.raw_bind_parameter(column, number)?;
        }
    }
    // Clears the values that the statement still has from the previous row.
    (4 + NUMBERS * steps.len()..=COLUMNS)
        .try_for_each(|column| insert.raw_bind_parameter(column, Null))?;
    insert.raw_bind_parameter(1, row_id(run, &steps[0])?)?;
    insert.raw_bind_parameter(2, steps.len())?;
    insert.raw_bind_parameter(3, bits)?;
    insert.raw_execute()?;
    Ok(())
}

/// The row id of steps that start with this decision.
pub(super) fn row_id(run: i64, first: &Decision) -> rusqlite::Result<i64> {
    let Decision { phase, episode, step, .. } = *first;
    if run >> (63 - RUN) != 0 || episode >> (PHASE - EPISODE) != 0 || step >> EPISODE != 0 {
        return Err(Error::IntegralValueOutOfRange(0, episode.into()));
    }
    let phase = match phase {
        Phase::Train => 0,
        Phase::Test => 1,
    };
    Ok(run << RUN | phase << PHASE | i64::from(episode) << EPISODE | i64::from(step))
}
