//! Names of the metrics that `evaluation.first_episodes` asks for.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

/// Prefix of the name of a metric of the first episodes, before their number.
const FIRST_RETURN: &str = "mean_return_first_";

/// The metric for the mean undiscounted return, in steps walked, of the first `episodes` training episodes;
/// of the first test episodes if the agent does not train.
pub fn first_return(episodes: u32) -> &'static str {
    static NAMES: RwLock<BTreeMap<u32, &'static str>> = RwLock::new(BTreeMap::new());
    let known = NAMES.read().unwrap_or_else(PoisonError::into_inner).get(&episodes).copied();
    known.unwrap_or_else(|| {
        let mut names = NAMES.write().unwrap_or_else(PoisonError::into_inner);
        // Leaks one name per distinct number in manifests.
        names.entry(episodes).or_insert_with(|| format!("{FIRST_RETURN}{episodes}").leak())
    })
}

/// The number of first episodes in the name of a metric; `None` for other metrics.
pub fn first_episodes(metric: &str) -> Option<u32> {
    let digits = metric.strip_prefix(FIRST_RETURN)?;
    let episodes = digits.parse().ok().filter(|episodes| *episodes > 0)?;
    (first_return(episodes) == metric).then_some(episodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_how_many_episodes() {
        assert_eq!(first_return(140), "mean_return_first_140");
        assert_eq!(first_episodes(first_return(140)), Some(140));
        for name in
            ["mean_return", "mean_return_first_", "mean_return_first_0", "mean_return_first_07"]
        {
            assert_eq!(first_episodes(name), None, "{name}");
        }
    }
}
