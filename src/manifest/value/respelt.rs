//! Tables with misspelt keys, read as their author meant them once the spelling has been reported.

use std::borrow::Cow;

use toml::Spanned;
use toml::de::DeTable;

use crate::text::near;

/// The table with each misspelt key under the name that was probably meant, if the table lacks that name.
pub(in crate::manifest) fn respelt<'r, 't>(
    table: &'r DeTable<'t>,
    known: &[&str],
) -> Cow<'r, DeTable<'t>> {
    let meant = |found: &str| {
        let is_known = known.contains(&found);
        let meant = (!is_known).then(|| near(found, known.iter().copied())).flatten();
        meant.filter(|meant| !table.contains_key(*meant))
    };
    if table.keys().all(|key| meant(key.get_ref()).is_none()) {
        return Cow::Borrowed(table);
    }
    let mut respelt = DeTable::new();
    for (key, node) in table {
        let name = meant(key.get_ref()).map(|meant| Cow::Owned(meant.to_owned()));
        let key = Spanned::new(key.span(), name.unwrap_or_else(|| key.get_ref().clone()));
        // The first of two keys that mean the same one counts.
        if !respelt.contains_key(key.get_ref().as_ref()) {
            respelt.insert(key, node.clone());
        }
    }
    Cow::Owned(respelt)
}
