//! The races of the searches in a store.

use std::io::{self, Write};

use serde_json::{Value, json};

use crate::cli::Error;
use crate::cli::output::{Format, OutputField, OutputRows};
use crate::manifest::Search;
use crate::plan::{Race, RaceOutcome};
use crate::schedule;
use crate::store::Reader;

/// The races of every experiment that is a search.
pub(super) struct SearchRaces(Vec<(String, Search, Vec<Race>)>);

impl SearchRaces {
    pub(super) fn read(reader: &Reader) -> Result<SearchRaces, Error> {
        let mut searches = Vec::new();
        for (experiment, text) in reader.manifests()? {
            // The manifest of a large sweep takes long to read.
            if !text.contains("search") {
                continue;
            }
            let Some(manifest) = schedule::stored_manifest(reader, &text) else { continue };
            let races = schedule::races(&manifest, Some(reader))?;
            if let (Some(races), Some(search)) = (races, manifest.search) {
                searches.push((experiment, search, races.races));
            }
        }
        Ok(SearchRaces(searches))
    }

    /// The races of an experiment as JSON.
    pub(super) fn described(&self, experiment: &str) -> Value {
        let ours = self.0.iter().filter(|(name, ..)| name == experiment);
        let races =
            ours.flat_map(|(_, search, races)| races.iter().map(move |race| (search, race)));
        races.map(|(search, race)| described(search, race)).collect()
    }

    /// Lists where the races stand.
    pub(super) fn list(&self) -> Result<(), Error> {
        if self.0.is_empty() {
            return Ok(());
        }
        let mut out = io::stdout().lock();
        writeln!(out, "\nraces:")?;
        let columns = ["experiment", "agent", "state"].map(str::to_owned);
        let mut rows = OutputRows::new(Format::Table, &columns, &mut out)?;
        for (experiment, search, races) in &self.0 {
            for race in races {
                let state = race.state(search);
                rows.row(&[experiment, &race.agent, &state].map(OutputField::text))?;
            }
        }
        Ok(rows.finish()?)
    }
}

fn described(search: &Search, race: &Race) -> Value {
    let winner = match race.outcome {
        RaceOutcome::Won { arm, .. } => Some(arm + 1),
        RaceOutcome::Running | RaceOutcome::Lost => None,
    };
    json!({
        "agent": race.agent,
        "rung": race.rungs.len(),
        "rungs": search.rungs.len(),
        "arms": race.settings.len(),
        "arms_left": race.arms_left(),
        "arms_open": race.rungs.last().map_or(0, |rung| rung.open),
        "winner": winner,
        "fresh_seeds_open": race.open_fresh_seeds(),
        "state": race.state(search),
    })
}
