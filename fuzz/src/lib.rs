//! The targets, which `tests/bad_input.rs` runs as well.

#[path = "../../tests/bad_input/targets.rs"]
pub mod targets;
