//! The abilities of a reading connection: additional functions, rejected statements, and memory limits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use rusqlite::Connection;
use rusqlite::functions::{Aggregate, Context, FunctionFlags};
use rusqlite::hooks::{AuthAction, AuthContext, Authorization};
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;

/// Adds `sqrt` and `stddev`, which SQLite lacks.
pub(super) fn add_functions(connection: &Connection) -> rusqlite::Result<()> {
    let flags = FunctionFlags::SQLITE_UTF8
        | FunctionFlags::SQLITE_DETERMINISTIC
        | FunctionFlags::SQLITE_INNOCUOUS;
    // As in the sqlite3 shell, the result is NULL if there is no real root.
    connection.create_scalar_function("sqrt", 1, flags, |context| {
        Ok(number(context).map(f64::sqrt).filter(|root| !root.is_nan()))
    })?;
    connection.create_aggregate_function("stddev", 1, flags, StandardDeviation)
}

/// The only argument of a function, if it is a number.
fn number(context: &Context<'_>) -> Option<f64> {
    match context.get_raw(0) {
        ValueRef::Integer(whole) => Some(whole as f64),
        ValueRef::Real(real) => Some(real),
        ValueRef::Null | ValueRef::Text(_) | ValueRef::Blob(_) => None,
    }
}

/// The standard deviation (n - 1) of the numbers; NULL for fewer than two, as in PostgreSQL.
///
/// **Source**: Welford, "Note on a method for calculating corrected sums of squares and products",
/// 1962.
struct StandardDeviation;

/// The count of numbers, their mean, and the sum of squares about the mean.
#[derive(Default)]
struct Squares {
    n: f64,
    mean: f64,
    sum: f64,
}

impl Aggregate<Squares, Option<f64>> for StandardDeviation {
    fn init(&self, _: &mut Context<'_>) -> rusqlite::Result<Squares> {
        Ok(Squares::default())
    }

    fn step(&self, context: &mut Context<'_>, squares: &mut Squares) -> rusqlite::Result<()> {
        if let Some(number) = number(context) {
            squares.n += 1.0;
            let apart = number - squares.mean;
            squares.mean += apart / squares.n;
            squares.sum += apart * (number - squares.mean);
        }
        Ok(())
    }

    fn finalize(
        &self,
        _: &mut Context<'_>,
        squares: Option<Squares>,
    ) -> rusqlite::Result<Option<f64>> {
        let squares = squares.filter(|squares| squares.n > 1.0);
        Ok(squares.map(|squares| (squares.sum / (squares.n - 1.0)).sqrt()))
    }
}

/// Makes the connection reject every statement that does more than read the store, and statements that would
/// exhaust the memory.
pub(super) fn allow_reading_only(connection: &mut Connection) -> rusqlite::Result<()> {
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, LONGEST_VALUE)?;
    connection.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0)?;
    // The limit applies to all connections of the process together; large sorts go to a file long before.
    connection.pragma_update(None, "hard_heap_limit", MOST_MEMORY)?;
    connection.authorizer(Some(authorize))
}

/// Makes the connection of a diagnosand read its table alone, with one value for the same rows at any time, and gives up a
/// statement after a number of steps.
pub(super) fn allow_diagnosands_only(connection: &mut Connection) -> rusqlite::Result<()> {
    allow_reading_only(connection)?;
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, LONGEST_OF_DIAGNOSAND)?;
    connection.authorizer(Some(authorize_diagnosand))
}

/// Interrupts the statements of the connection after [`MOST_STEPS`] steps of SQLite, which are counted from where the number
/// that this returns is set to 0.
pub(super) fn limit_steps(connection: &mut Connection) -> rusqlite::Result<Arc<AtomicU32>> {
    let rounds = Arc::new(AtomicU32::new(0));
    let counted = rounds.clone();
    let is_over = move || counted.fetch_add(1, Ordering::Relaxed) >= MOST_STEPS / STEPS_OF_ROUND;
    connection.progress_handler(STEPS_OF_ROUND as i32, Some(is_over))?;
    Ok(rounds)
}

/// The maximum number of steps of SQLite's virtual machine for a diagnosand; a second or two.
pub(super) const MOST_STEPS: u32 = 100_000_000;
/// The steps between two counts.
const STEPS_OF_ROUND: u32 = 10_000;

/// The maximum number of bytes of a value in a diagnosand.
const LONGEST_OF_DIAGNOSAND: i32 = 1 << 20;

/// The maximum number of bytes of a value, a row or the SQL itself; the weights of the largest network take
/// 80 MB.
const LONGEST_VALUE: i32 = 128 << 20;
/// The maximum number of bytes that SQLite may allocate.
const MOST_MEMORY: i64 = 768 << 20;

fn authorize(context: AuthContext<'_>) -> Authorization {
    let allowed = match context.action {
        AuthAction::Select | AuthAction::Read { .. } | AuthAction::Recursive => true,
        AuthAction::Function { function_name } => !ACTING_FUNCTIONS.contains(&function_name),
        AuthAction::Pragma { pragma_name, .. } => DESCRIBING_PRAGMAS.contains(&pragma_name),
        _ => false,
    };
    if allowed { Authorization::Allow } else { Authorization::Deny }
}

fn authorize_diagnosand(context: AuthContext<'_>) -> Authorization {
    match context.action {
        AuthAction::Recursive => Authorization::Deny,
        AuthAction::Function { function_name }
            if CHANGING_FUNCTIONS.contains(&function_name.to_ascii_lowercase().as_str()) =>
        {
            Authorization::Deny
        }
        _ => authorize(context),
    }
}

/// Functions of SQLite whose values are others at another time.
const CHANGING_FUNCTIONS: &[&str] = &[
    "random",
    "randomblob",
    "date",
    "time",
    "datetime",
    "julianday",
    "unixepoch",
    "strftime",
    "timediff",
    "current_date",
    "current_time",
    "current_timestamp",
];

/// Functions of SQLite or its usual extensions that reach outside the store.
const ACTING_FUNCTIONS: &[&str] =
    &["load_extension", "readfile", "writefile", "edit", "fts3_tokenizer"];

/// Pragmas that describe tables and change nothing, for any argument.
const DESCRIBING_PRAGMAS: &[&str] =
    &["table_info", "table_xinfo", "table_list", "index_list", "index_info", "foreign_key_list"];
