//! The files that a manifest reads.

use std::fs;
use std::path::Path;

use toml_edit::{DocumentMut, Item, Value};

use super::section::Section;
use crate::key::{Content, Kind, Rows};

/// The keys whose values can name files: section and key.
fn file_keys() -> impl Iterator<Item = (&'static str, &'static str)> {
    Section::all().into_iter().flat_map(|section| {
        let names_file = |kind: Kind| matches!(kind, Kind::Rows(_) | Kind::Content(_));
        let keys = section.keys().iter().filter(move |key| names_file(key.kind));
        keys.map(move |key| (section.name(), key.name))
    })
}

/// The name of a file in a value of such a key; `None` for texts of files, and for none.
fn file_name(text: &str) -> Option<&str> {
    let is_name = !Rows::is_csv(text) && !Rows::is_none(text) && !Content::is_word_for_none(text);
    is_name.then_some(text)
}

/// The names of the files beside a manifest that its text reads: published numbers, and the files of people and
/// trials. Empty for a text that is not TOML.
pub fn companions(text: &str) -> Vec<String> {
    let Ok(manifest) = toml::from_str::<toml::Table>(text) else { return Vec::new() };
    let published = manifest.get("published").and_then(toml::Value::as_str);
    let mut names: Vec<String> = published.map(str::to_owned).into_iter().collect();
    for (section, key) in file_keys() {
        let value = manifest.get(section).and_then(|section| section.get(key));
        let texts = match value {
            Some(toml::Value::Array(list)) => list.iter().filter_map(toml::Value::as_str).collect(),
            Some(toml::Value::String(text)) => vec![text.as_str()],
            Some(_) | None => Vec::new(),
        };
        names.extend(texts.into_iter().filter_map(file_name).map(str::to_owned));
    }
    names
}

/// The text of a manifest of this folder with the texts of its files in the place of their names, except published
/// numbers. Its jobs are the same.
///
/// **Errors**: a file cannot be read; the name and the reason.
pub fn self_contained(text: &str, folder: &Path) -> Result<String, String> {
    let Ok(mut manifest) = text.parse::<DocumentMut>() else { return Ok(text.to_owned()) };
    let mut has_files = false;
    for (section, key) in file_keys() {
        let item = manifest.get_mut(section).and_then(|section| section.get_mut(key));
        let Some(Item::Value(value)) = item else { continue };
        let values = match value {
            Value::Array(list) => list.iter_mut().collect(),
            other => vec![other],
        };
        for value in values {
            let Some(name) = value.as_str().and_then(file_name) else { continue };
            let path = folder.join(name);
            let unreadable = |error: std::io::Error| format!("{}: {error}", path.display());
            let text = fs::read_to_string(&path).map_err(unreadable)?;
            // A line break says that this is a text.
            *value = format!("{}\n", text.trim_start_matches('\u{feff}').trim_end()).into();
            has_files = true;
        }
    }
    Ok(if has_files { manifest.to_string() } else { text.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_numbers_and_rows_are_files_and_inline_rows_are_not() {
        let text = "published = \"numbers.toml\"\npopulation.rows = \"people.csv\"\n";
        assert_eq!(companions(text), ["numbers.toml", "people.csv"]);
        assert!(companions("[population]\nrows = { delta_d = [0.1, 0.2] }\n").is_empty());
        assert!(companions("name = ").is_empty());
        let trial =
            "[trial]\nentry = \"stays.csv\"\n[environment]\npeople = [\"a.csv\", \"none\"]\n";
        assert_eq!(companions(trial), ["stays.csv", "a.csv"]);
    }

    #[test]
    fn files_stand_in_a_text_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("people.csv"), "delta_d\r\n0.1\r\n0.2\r\n").unwrap();
        let text = "format = 1\n# A comment.\npopulation.rows = \"people.csv\"\n";
        let whole = self_contained(text, folder.path()).unwrap();
        let read: toml::Table = toml::from_str(&whole).unwrap();
        let rows = read["population"]["rows"].as_str().unwrap();
        assert!(rows.starts_with("delta_d") && rows.ends_with("0.2\n"), "{rows:?}");
        assert!(whole.contains("# A comment."));
        let inline = "population.rows = [{ delta_d = 0.1 }]\n";
        assert_eq!(self_contained(inline, folder.path()).unwrap(), inline);
        let missing = self_contained("population.rows = \"other.csv\"", folder.path());
        assert!(missing.unwrap_err().contains("other.csv"));
    }
}
