//! The keys of `[data]`, and the form of its file.

use std::sync::{Arc, Mutex};

use crate::env::declared::{header, reader};
use crate::key::{Content, ContentFault, ContentForm, Kind, Parsed, Value, keys};

/// The table of manifests that has the keys, in the place of `[environment]`.
pub const DATA: &str = "data";
/// Separates the expressions of a key that has several.
pub const LIST: &str = "; ";
/// Stands for a column that the file does not have.
pub(super) const NONE: &str = "none";

/// What was read from a file, each with the values of the keys that it was read by.
#[derive(Debug, Default)]
pub(super) struct KnownLogs(pub Mutex<Vec<(Vec<Value>, Parsed)>>);

/// The most characters of the expressions of a key.
const TEXT: Kind = Kind::Text { most: 20_000 };

/// The form of a file of decisions.
pub(super) static LOG: ContentForm = ContentForm {
    what: "a CSV file with one row per decision",
    parse: |text| match header(&mut reader(text.as_bytes())) {
        Ok(_) => Ok(Arc::new(KnownLogs::default())),
        Err(faults) => Err(ContentFault::Listed(faults.list())),
    },
    canonical: None,
    shipped: &[],
    help: Some("docs/recorded.md begins with a trial of ten lines"),
    most_bytes: 1_000_000_000,
};

keys! {
    /// A trial that happened; `docs/recorded.md` describes the table.
    pub struct LogParameters {
        /// the trial: the name of a CSV file with one row per decision
        file: Content, in Kind::Content(&LOG);
        /// the column that names the person
        person: String, in TEXT;
        /// which decision of its person a row is: an expression of columns that counts decisions, or two that are the day
        /// and the decision of the day, in a list
        order: String, in TEXT;
        /// the action: an expression of columns, 0 for none
        action: String, in TEXT;
        /// the probability with which action 1 was drawn, or a list of those of all actions but 0
        probability: String, in TEXT;
        /// the outcome of the decision: an expression of columns
        outcome: String, in TEXT;
        /// whether an action other than 0 was possible: an expression of columns that is 0 or 1
        available: String = "1".to_owned(), in TEXT;
        /// whether the outcome reached the agent of the trial: an expression of columns that is 0 or 1
        reached: String = "1".to_owned(), in TEXT;
        /// the recorded state, a table of names and expressions of columns; agents and estimates read it
        state: String = NONE.to_owned(), in TEXT;
        /// the day of the calendar: an expression of columns, by which people enter in a replay
        calendar_day: String = NONE.to_owned(), in TEXT;
        /// decisions of a person per day
        decisions_per_day: u32 = 1, in Kind::Integer { min: 1, max: 100 };
        /// the unit of the outcome
        unit: String = "outcome".to_owned(), in Kind::Text { most: 100 };
        /// whether the names of people in the file go into the store; otherwise people are numbered alone
        keep_identifiers: bool = false;
    }
}
