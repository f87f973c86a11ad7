//! The races of searches in a store: how far they have come, and which jobs they want next.

use crate::job::{JobKey, MetricName, Score};
use crate::key::printable;
use crate::manifest::Manifest;
use crate::plan::{self, Race, Races, Staged};
use crate::store::{Reader, StoreError};

/// The manifests at the stage that their races have come to in the store; `reader` is `None` if there is no store yet.
///
/// **Errors**: the store fails.
pub(super) fn at_stage<'m>(
    manifests: &'m [Manifest],
    reader: Option<&Reader>,
) -> Result<Vec<Staged<'m>>, StoreError> {
    plan::at_stage(manifests, |keys, metric| scores(reader, keys, metric))
}

/// The races of a manifest, as far as they have come in the store; `None` if it has no search.
///
/// **Errors**: the store fails.
pub fn races(manifest: &Manifest, reader: Option<&Reader>) -> Result<Option<Races>, StoreError> {
    Races::of(manifest, |keys, metric| scores(reader, keys, metric))
}

/// Where the races of manifests stand, a sentence for each.
///
/// **Errors**: the store fails.
pub fn race_notes(
    manifests: &[Manifest],
    reader: Option<&Reader>,
) -> Result<Vec<String>, StoreError> {
    let mut notes = Vec::new();
    for manifest in manifests {
        let name = printable(&manifest.name);
        let lines = race_lines(manifest, reader)?.into_iter();
        notes.extend(lines.map(|line| format!("search {name}, agent {line}")));
    }
    Ok(notes)
}

/// Where the races of a manifest stand, a line for each: its agent and its state.
///
/// **Errors**: the store fails.
pub fn race_lines(manifest: &Manifest, reader: Option<&Reader>) -> Result<Vec<String>, StoreError> {
    let races = races(manifest, reader)?;
    let (Some(races), Some(search)) = (races, &manifest.search) else { return Ok(Vec::new()) };
    let line = |race: &Race| format!("{}: {}", printable(&race.agent), race.state(search));
    Ok(races.races.iter().map(line).collect())
}

/// Whether all jobs that the races of manifests will ever want have ended.
///
/// **Errors**: the store fails.
pub fn races_ended(manifests: &[Manifest], reader: &Reader) -> Result<bool, StoreError> {
    for manifest in manifests {
        if races(manifest, Some(reader))?.is_some_and(|races| !races.have_ended()) {
            return Ok(false);
        }
    }
    Ok(true)
}

fn scores(
    reader: Option<&Reader>,
    keys: &[JobKey],
    metric: MetricName,
) -> Result<Vec<Score>, StoreError> {
    match reader {
        Some(reader) => reader.scores(keys, metric),
        None => Ok(vec![Score::Open; keys.len()]),
    }
}
