//! What changed in the manifests of experiments.

use std::collections::HashMap;
use std::io::{self, Write};

use serde_json::{Value, json};

use crate::cli::Error;
use crate::cli::output::counted;
use crate::key::printable;
use crate::store::{Reader, UsedManifest};

/// Maximum number of lines shown of the latest change.
const SHOWN: usize = 8;

/// The changes of every experiment's manifest.
pub(super) struct Changes(Vec<(String, Vec<Change>)>);

/// A replacement of one text of a manifest by another.
struct Change {
    at: String,
    /// Lines that only the earlier text has, in its order, without indentation and blank lines.
    removed: Vec<String>,
    /// Lines that only the later text has, likewise.
    added: Vec<String>,
}

impl Changes {
    pub(super) fn read(reader: &Reader) -> Result<Changes, Error> {
        let mut changes = Vec::new();
        for (experiment, _) in reader.manifests()? {
            let used = reader.used_manifests(&experiment)?;
            changes.push((experiment, changes_of(&used)));
        }
        Ok(Changes(changes))
    }

    /// The changes of an experiment as JSON, the earliest first.
    pub(super) fn described(&self, experiment: &str) -> Value {
        let ours = self.0.iter().filter(|(name, _)| name == experiment);
        ours.flat_map(|(_, changes)| changes)
            .map(|Change { at, removed, added }| json!({"at": at, "removed": removed, "added": added}))
            .collect()
    }

    /// Prints the latest change of every experiment whose manifest changed.
    pub(super) fn list(&self) -> io::Result<()> {
        let mut out = io::stdout().lock();
        for (experiment, changes) in &self.0 {
            let Some(Change { at, removed, added }) = changes.last() else { continue };
            let times = match changes.len() {
                1 => String::new(),
                more => format!(" (the latest of {more} changes)"),
            };
            writeln!(out, "\nthe manifest of {} changed at {at}{times}:", printable(experiment))?;
            let removed = removed.iter().map(|line| ('-', line));
            let lines: Vec<_> = removed.chain(added.iter().map(|line| ('+', line))).collect();
            for (sign, line) in lines.iter().take(SHOWN) {
                writeln!(out, "  {sign} {}", printable(line))?;
            }
            if let Some(more) = lines.len().checked_sub(SHOWN).filter(|more| *more > 0) {
                writeln!(
                    out,
                    "  and {} more; the view `manifest` has both texts",
                    counted(more, "line")
                )?;
            }
            if lines.is_empty() {
                writeln!(out, "  only the order or the spacing of its lines")?;
            }
        }
        Ok(())
    }
}

/// The changes between texts that are in the order of their replacement. The change to the current text is
/// the last one.
fn changes_of(used: &[UsedManifest]) -> Vec<Change> {
    let successor = |index: usize| {
        let is_next = |after: &&UsedManifest| Some(&after.from) == used[index].until.as_ref();
        used[index + 1..].iter().chain(&used[..index]).find(is_next)
    };
    let mut pairs: Vec<(&UsedManifest, &UsedManifest)> = used
        .iter()
        .enumerate()
        // A text that came with a merge may have no successor here.
        .filter_map(|(index, before)| Some((before, successor(index)?)))
        .filter(|(before, after)| after.text != before.text)
        .collect();
    pairs.sort_by_key(|(_, after)| after.until.is_none());
    pairs.into_iter().map(|(before, after)| Change::between(before, after)).collect()
}

impl Change {
    fn between(before: &UsedManifest, after: &UsedManifest) -> Change {
        let at = before.until.clone().unwrap_or_default();
        Change {
            at,
            removed: only(&before.text, &after.text),
            added: only(&after.text, &before.text),
        }
    }
}

/// The lines of `text` that `other` lacks, counting repeated lines.
fn only(text: &str, other: &str) -> Vec<String> {
    let mut others: HashMap<&str, usize> = HashMap::new();
    for line in lines(other) {
        *others.entry(line).or_default() += 1;
    }
    let mut only = Vec::new();
    for line in lines(text) {
        match others.get_mut(line) {
            Some(left @ 1..) => *left -= 1,
            _ => only.push(line.to_owned()),
        }
    }
    only
}

/// The lines of a text without indentation; blank lines are left out.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.lines().map(str::trim).filter(|line| !line.is_empty())
}
