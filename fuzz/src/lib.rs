//! The targets, which `tests/alone/bad_input.rs` runs as well.

#[path = "../../tests/alone/bad_input/targets.rs"]
pub mod targets;
