//! Values as a manifest writes them.

use std::fmt::Display;

use crate::job::Condition;

/// A list.
pub(in crate::manifest) fn list(items: &[impl Display]) -> String {
    let items: Vec<String> = items.iter().map(ToString::to_string).collect();
    format!("[{}]", items.join(", "))
}

/// A text as a basic string of TOML.
pub(in crate::manifest) fn quoted(text: &(impl Display + ?Sized)) -> String {
    crate::key::quoted(&text.to_string())
}

/// A condition: `scenario = ["P-T"]`.
pub(in crate::manifest) fn condition(condition: &Condition) -> String {
    format!("{} = {}", condition.name(), list(&condition.values))
}

/// A percentage as a share, without the noise of its division.
pub(in crate::manifest) fn share(percent: f64) -> String {
    let share = format!("{:.11e}", percent / 100.0);
    share.parse().map_or(share, |share: f64| format!("{share:?}"))
}
