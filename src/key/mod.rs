//! Keys: the parameters that a manifest can set, each declared once.
//!
//! [`keys!`](crate::keys) declares a struct together with the table of its keys: name, type, range,
//! default, meaning and the value of earlier jobs. Validation, the JSON Schema, the reference in
//! `docs/manifest.md`, filters, the view `parameter` and the canonical form of a job all read this table.
//!
//! In: declarations. Out: tables of [`Key`]s, typed structs, canonical text. A [`Constraint`] relates
//! several keys. It contains no particular key, manifest or job.

mod canonical;
mod constraint;
mod content;
mod declare;
mod distribution;
mod free;
mod normal;
mod number_range;
mod parameter;
mod rows;
mod value;

pub use crate::text::{DIRECTION, hidden, printable, quoted};
pub use canonical::{CanonicalError, canonical_object, read_object};
pub use constraint::{Assignment, Constraint, Size, Violation};
pub use content::{
    Canonical, Content, ContentFault, ContentForm, MOST_BYTES, Parsed, digest, shortened,
};
pub use declare::{FixedKind, Key, KeyType, Keyed, SettingError, json_object};
pub(crate) use declare::{choices, keys};
pub use distribution::{Distribution, DistributionError};
pub use free::{WithFreeKeys, free_key, free_keys, free_values, interned};
pub use number_range::NumberRange;
pub use parameter::{Parameter, PerSection, SectionName};
pub use rows::{Column, MOST_ROWS, Rows, RowsError, read_csv};
pub use value::{Kind, Value};
