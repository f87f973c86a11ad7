//! The shrinkage of the winner of a race: how much less it earns on fresh seeds.

use super::kinds::{gap, gap_ends};
use crate::analyse::{Interval, Undefined};
use crate::job::Measure;

/// How much the mean of a search exceeds the mean on new seeds, which has this interval, in words; `None` if one of
/// them is undefined. Where the new mean is higher, there is no shrinkage, and the words say so.
///
/// The mean of a search is the best of several and therefore no unbiased estimate. It counts as a fixed number, and the
/// interval shows the uncertainty of the new mean alone.
pub(super) fn shrinkage(
    search: Result<f64, Undefined>,
    (new, interval): (Result<f64, Undefined>, Result<Interval, Undefined>),
    seeds: &str,
    metric: Measure,
) -> Option<String> {
    let (search, new) = (search.ok()?, new.ok()?);
    let is_higher = new > search;
    let interval = interval.map(|Interval { low, high }| {
        let interval = match is_higher {
            true => Interval { low: low - search, high: high - search },
            false => Interval { low: search - high, high: search - low },
        };
        format!(" (95 % interval {})", gap_ends(interval, metric))
    });
    let difference = gap((search - new).abs(), metric) + &interval.unwrap_or_default();
    Some(match is_higher {
        true => format!("No shrinkage: the {seeds} mean is higher by {difference}"),
        false => format!("Expected shrinkage on new seeds, by the {seeds} mean: {difference}"),
    })
}
