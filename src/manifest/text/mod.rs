//! The text of a manifest, its TOML tree, what is wrong with it, and values as a manifest writes them.

pub(super) mod document;
pub(super) mod edits;
pub(super) mod fault;
pub(super) mod source;
pub(super) mod written;
