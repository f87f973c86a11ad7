//! `[search]`: hyper-parameters drawn at random, and the races between them.

pub(super) mod declared;
pub(super) mod draw;
pub(super) mod keys;
pub(super) mod points;
pub(super) mod read;
pub(super) mod stage;
