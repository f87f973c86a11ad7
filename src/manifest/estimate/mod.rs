//! `[[estimate]]`: declared estimates of causal effects.

pub(super) mod declared;
pub(super) mod keys;
pub(super) mod read;
