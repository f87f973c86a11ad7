//! Keys: the parameters that a manifest can set, each declared once.
//!
//! [`keys!`](crate::keys) declares a struct together with the table of its keys: name, type, range,
//! default, meaning and the value of earlier jobs. Validation, the JSON Schema, the reference in
//! `docs/manifest.md`, filters, the view `parameter` and the canonical form of a job all read
//! that table.
//!
//! In: declarations. Out: tables of [`Key`]s, typed structs, canonical text. It knows no particular
//! key, no manifest and no job.

mod canonical;
mod declare;
mod parameter;
mod value;

pub use canonical::{CanonicalError, canonical_object, read_object};
pub use declare::{FixedKind, Key, KeyType, Keyed, SettingError, json_object};
pub use parameter::Parameter;
pub use value::{Kind, Value};
