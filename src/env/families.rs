//! The registry of families: every family that a manifest can name, in one list.

use crate::env::family::Family;
use crate::env::{declared, outside, recorded, retired, step_count};

/// The families that come with the library, in the order of the documentation.
static BUILT_IN: [&Family; 4] =
    [&step_count::FAMILY, &declared::FAMILY, &recorded::FAMILY, &outside::FAMILY];

/// The families of stored jobs that this release no longer simulates, each with what takes its place.
static RETIRED: [(&Family, &str); 1] = [(
    &retired::ORALYTICS,
    "its test beds are models: family = \"declared\" with model = \"oralytics_v2\" or \"oralytics_v4\"; docs/oralytics.md says \
     which parameters stand for its keys",
)];

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

    /// A family of this name that is no longer simulated, with what takes its place.
    pub fn retired(name: &str) -> Option<(&'static Family, &'static str)> {
        RETIRED.into_iter().find(|(family, _)| family.name == name)
    }
}
