//! The value of a key: a single one, a list or a range, a table or a file; its reading and its JSON Schema.

pub(super) mod free;
pub(super) mod people;
pub(super) mod range;
pub(super) mod respelt;
pub(super) mod schema;
pub(super) mod sweep;
