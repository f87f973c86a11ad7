//! The files that a manifest reads.

use std::borrow::Cow;
use std::collections::HashSet;
use std::fs;

use toml_edit::{DocumentMut, Item, TableLike, Value};

use crate::env::recorded::{DATA, FAMILY};
use crate::key::{Content, Key, Kind, Rows, SectionName, Value as KeyValue};
use crate::manifest::declared::Manifest;
use crate::manifest::section::Section;

/// The keys whose values can name files: section and key.
fn file_keys() -> impl Iterator<Item = (&'static str, &'static Key)> {
    let all = Section::all().into_iter().flat_map(|section| {
        let names_file = |kind: Kind| matches!(kind, Kind::Rows(_) | Kind::Content(_));
        let keys = section.keys().iter().filter(move |key| names_file(key.kind));
        // A recorded trial can be written as an environment, too.
        let data = section.header() == format!("[{DATA}]");
        let tables = [Some(section.name()), data.then_some(DATA)].into_iter().flatten();
        tables.flat_map(move |table| keys.clone().map(move |key| (table, key)))
    });
    // A key of several families is one.
    let mut seen = HashSet::new();
    all.filter(move |(section, key)| seen.insert((*section, key.name)))
}

/// The name of a file or a job in a value of such a key; `None` for texts of files, and for none.
fn named(text: &str) -> Option<&str> {
    let is_name = !Rows::is_csv(text) && !Rows::is_none(text) && !Content::is_word_for_none(text);
    is_name.then_some(text)
}

/// Whether a value of a key names a job.
fn is_run(key: &Key, name: &str) -> bool {
    matches!(key.kind, Kind::Content(form) if form.run(name).is_some())
}

/// The text that comes with the program under a name, which is a value of a key.
fn shipped(key: &Key, name: &str) -> Option<&'static str> {
    match key.kind {
        Kind::Content(form) => form.shipped(name),
        _ => None,
    }
}

/// The values of a key in a section, or in each of its tables.
fn values_mut<'m>(
    manifest: &'m mut DocumentMut,
    section: &str,
    key: &str,
) -> impl Iterator<Item = &'m mut Value> {
    let tables: Vec<&mut dyn TableLike> = match manifest.get_mut(section) {
        Some(Item::ArrayOfTables(tables)) => {
            tables.iter_mut().map(|table| table as &mut dyn TableLike).collect()
        }
        Some(Item::Value(Value::Array(list))) => {
            let tables = list.iter_mut().filter_map(Value::as_inline_table_mut);
            tables.map(|table| table as &mut dyn TableLike).collect()
        }
        Some(table) => table.as_table_like_mut().into_iter().collect(),
        None => Vec::new(),
    };
    let values = tables.into_iter().filter_map(move |table| table.get_mut(key)?.as_value_mut());
    values.flat_map(|value| match value {
        Value::Array(list) => list.iter_mut().collect::<Vec<_>>(),
        other => vec![other],
    })
}

/// The names of the files beside a manifest that its text reads: published numbers, and the files of people and
/// trials. Empty for a text that is not TOML.
pub fn companions(text: &str) -> Vec<String> {
    let Ok(mut manifest) = text.parse::<DocumentMut>() else { return Vec::new() };
    let published = manifest.get("published").and_then(Item::as_str);
    let mut names: Vec<String> = published.map(str::to_owned).into_iter().collect();
    for (section, key) in file_keys() {
        let values = values_mut(&mut manifest, section, key.name);
        let named = values.filter_map(|value| named(value.as_str()?));
        let files = named.filter(|name| !is_run(key, name) && shipped(key, name).is_none());
        names.extend(files.map(str::to_owned));
    }
    names
}

/// The key of a recorded trial's file.
const FILE: &str = "file";

/// The text of a recorded trial as jobs know it, where a key of a section names it.
fn recorded<'m>(of: &'m Manifest, section: &str, key: &Key) -> Option<&'m str> {
    let is_file = [DATA, SectionName::Environment.word()].contains(&section) && key.name == FILE;
    let values = &of.sections[SectionName::Environment].get(FILE)?;
    match values.first()? {
        KeyValue::Content(file) if is_file && of.family() == &FAMILY => file.text(),
        _ => None,
    }
}

/// The text of a manifest for readers and stores: an inline recorded trial is replaced by the text that jobs know, without
/// the names of people.
pub fn kept_text(of: &Manifest) -> Cow<'_, str> {
    let whole = || Cow::Borrowed(of.source.as_str());
    if of.family() != &FAMILY {
        return whole();
    }
    let Ok(mut manifest) = of.source.parse::<DocumentMut>() else { return whole() };
    let mut has_text = false;
    for (section, key) in file_keys() {
        let Some(text) = recorded(of, section, key) else { continue };
        for value in values_mut(&mut manifest, section, key.name) {
            if value.as_str().is_some_and(|own| Rows::is_csv(own) && own != text) {
                *value = text.into();
                has_text = true;
            }
        }
    }
    if has_text { Cow::Owned(manifest.to_string()) } else { whole() }
}

/// The text of a manifest with the texts of its files, except published numbers, and of the policies of jobs in the
/// place of their names. Its jobs are the same.
///
/// **Errors**: a file cannot be read; the name and the reason.
pub fn self_contained(of: &Manifest) -> Result<String, String> {
    let text = kept_text(of);
    let Ok(mut manifest) = text.parse::<DocumentMut>() else { return Ok(text.into_owned()) };
    let mut has_files = false;
    for (section, key) in file_keys() {
        for value in values_mut(&mut manifest, section, key.name) {
            let Some(name) = value.as_str().and_then(named) else { continue };
            let path = of.folder().join(name);
            let unreadable = |error: std::io::Error| format!("{}: {error}", path.display());
            let run = of.named_runs.iter().find(|(run, _)| is_run(key, name) && run == name);
            let known = run.map(|(_, text)| text.as_str()).or_else(|| shipped(key, name));
            let text = match known.or_else(|| recorded(of, section, key)) {
                Some(text) => text.to_owned(),
                None => fs::read_to_string(&path).map_err(unreadable)?,
            };
            // A line break says that this is a text.
            *value = format!("{}\n", text.trim_start_matches('\u{feff}').trim_end()).into();
            has_files = true;
        }
    }
    Ok(if has_files { manifest.to_string() } else { text.into_owned() })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::key::Parameter;
    use crate::manifest::load::parse_from;
    use crate::manifest::{Runs, parse};
    use crate::plan;

    const VALID: &str = "format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"C\"]\nseeds = 1\n\
                         environment.sigma = 0.4\n";

    #[test]
    fn published_numbers_and_rows_are_files_and_inline_rows_are_not() {
        let text = "published = \"numbers.toml\"\npopulation.rows = \"people.csv\"\n";
        assert_eq!(companions(text), ["numbers.toml", "people.csv"]);
        assert!(companions("[population]\nrows = { delta_d = [0.1, 0.2] }\n").is_empty());
        assert!(companions("name = ").is_empty());
        let trial =
            "[trial]\nentry = \"stays.csv\"\n[environment]\npeople = [\"a.csv\", \"none\"]\n";
        assert_eq!(companions(trial), ["stays.csv", "a.csv"]);
        assert_eq!(companions("[data]\nfile = \"log.csv\"\nperson = \"id\"\n"), ["log.csv"]);
        let agents = "[[agent]]\nprior_from = [\"pilot/policy.json\", \"run:3f\", \"none\"]\n[[agent]]\nx = 1\n";
        assert_eq!(companions(agents), ["pilot/policy.json"]);
    }

    #[test]
    fn files_stand_in_a_text_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("people.csv"), "delta_d\r\n0.1\r\n0.2\r\n").unwrap();
        let text = "format = 1\n# A comment.\npopulation.rows = \"people.csv\"\n";
        let written = |text: &str| Manifest {
            source: text.to_owned(),
            path: folder.path().join("m.toml").display().to_string(),
            named_runs: vec![("run:3f".to_owned(), "{\"posterior\": 1}".to_owned())],
            ..parse("t", VALID.as_bytes()).unwrap()
        };
        let whole = self_contained(&written(text)).unwrap();
        let read: toml::Table = toml::from_str(&whole).unwrap();
        let rows = read["population"]["rows"].as_str().unwrap();
        assert!(rows.starts_with("delta_d") && rows.ends_with("0.2\n"), "{rows:?}");
        assert!(whole.contains("# A comment."));
        let inline = "population.rows = [{ delta_d = 0.1 }]\n";
        assert_eq!(self_contained(&written(inline)).unwrap(), inline);
        let missing = self_contained(&written("population.rows = \"other.csv\""));
        assert!(missing.unwrap_err().contains("other.csv"));
        let agents = "[[agent]]\nprior_from = \"none\"\n[[agent]]\nprior_from = [\"run:3f\", \"people.csv\"]\n";
        let whole: toml::Table =
            toml::from_str(&self_contained(&written(agents)).unwrap()).unwrap();
        let priors = |agent: usize| whole["agent"][agent]["prior_from"].clone();
        assert_eq!(priors(0).as_str(), Some("none"));
        assert_eq!(priors(1)[0].as_str(), Some("{\"posterior\": 1}\n"));
        assert_eq!(priors(1)[1].as_str(), Some("delta_d\r\n0.1\r\n0.2\n"));
    }

    #[test]
    fn a_posterior_of_a_job_is_part_of_a_text_of_its_own() {
        let text = format!(
            "{VALID}[[agent]]\nname = \"a\"\nalgorithm = \"linear_thompson\"\nprior_from = [\"run:3f\", \"none\"]\n"
        );
        let policy = |key: &str| {
            assert_eq!(key, "3f");
            let (mean, precision) = ([[0.25, 0.5]; 4], [[[4.0, 1.0], [1.0, 2.0]]; 4]);
            let posterior = json!({
                "features": "linear", "action_centring": false, "mean": mean, "precision": precision,
            });
            Ok(json!({ "features": ["C"], "actions": 4, "posterior": posterior }).to_string())
        };
        let read = parse_from("t", text.as_bytes(), Runs(Some(&policy))).unwrap();
        let frozen = parse("t", self_contained(&read).unwrap().as_bytes()).unwrap();
        let keys =
            |manifest: &Manifest| plan::jobs(manifest).map(|one| one.job.key()).collect::<Vec<_>>();
        assert_eq!(keys(&frozen), keys(&read));
        let resolved = parse("t", read.resolved().as_bytes()).unwrap();
        assert_eq!(keys(&resolved), keys(&read));
        // The winner of a search over stored jobs has the text as well.
        let bandit = read.agents.iter().find(|agent| agent.name == "a").unwrap();
        let stored = |key| match key {
            Parameter::Agent("prior_from") => {
                let Some([KeyValue::Content(prior), _]) = bandit.parameters.get("prior_from")
                else {
                    panic!()
                };
                let key = Section::Agent(bandit.algorithm).find("prior_from").unwrap().1;
                key.kind.value(&json!(prior.name()))
            }
            _ => None,
        };
        let text = VALID.replace("extends = \"paper\"\n", "") + &bandit.chosen(stored);
        let chosen = parse("t", text.as_bytes()).unwrap();
        assert!(keys(&read).contains(&keys(&chosen)[0]));
        // Without a store, the value has no text.
        let fault = parse("t", read.source.as_bytes()).unwrap_err().to_string();
        assert!(
            fault.contains("`run:3f` names a job of a store, and no store is read here"),
            "{fault}"
        );
    }
}
