//! `[[analysis]]`: the declared analyses, the kinds of analyses and their keys, and published numbers to compare
//! with.

pub(super) mod axis;
pub(super) mod declared;
pub(super) mod figure_keys;
pub(super) mod forms;
pub(super) mod jobs;
pub mod kind;
pub(super) mod participants;
pub(super) mod published;
pub(super) mod read;
pub(super) mod sides;
