//! Values and lists as a manifest writes them, and changes of its text.

pub(super) mod edits;
pub(super) mod written;
