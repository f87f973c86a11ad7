//! The files that a manifest reads.

/// The names of the files beside a manifest that its text reads: published numbers, and the rows of a
/// population. Empty for a text that is not TOML.
pub fn companions(text: &str) -> Vec<String> {
    let Ok(manifest) = toml::from_str::<toml::Table>(text) else { return Vec::new() };
    let rows = manifest.get("population").and_then(|population| population.get("rows"));
    let names = [manifest.get("published"), rows].into_iter().flatten();
    names.filter_map(|name| name.as_str().map(str::to_owned)).collect()
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
    }
}
