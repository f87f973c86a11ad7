//! The registry of families: every family that a manifest can name, in one list.

use crate::env::family::Family;
use crate::env::{declared, oralytics, outside, step_count};

/// The families that come with the library, in the order of the documentation.
static BUILT_IN: [&Family; 4] =
    [&step_count::FAMILY, &declared::FAMILY, &oralytics::FAMILY, &outside::FAMILY];

impl Family {
    /// Every family.
    pub fn all() -> &'static [&'static Family] {
        &BUILT_IN
    }

    /// The family of manifests and jobs that name none.
    pub fn first() -> &'static Family {
        BUILT_IN[0]
    }

    /// The family of this name.
    pub fn named(name: &str) -> Option<&'static Family> {
        Family::all().iter().copied().find(|family| family.name == name)
    }
}
