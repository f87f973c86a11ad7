//! Keys whose names a user chooses: the parameters of outside programs and of models.
//!
//! In: names of the form `parameters.<name>`. Out: keys, which stay in memory until the process ends, so that
//! sweeps, filters, views and labels treat them like declared keys.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use super::declare::Key;
use super::value::{Kind, Value};

/// Prefix of the keys of a program's parameters.
const PREFIX: &str = "parameters.";

/// Maximum length of a parameter's name, in characters.
const LONGEST_NAME: usize = 64;

/// Maximum number of parameters of a program.
const MOST_PARAMETERS: usize = 100;

/// The keys of programs' parameters, by their names including the prefix.
static KEYS: Mutex<BTreeMap<&'static str, &'static Key>> = Mutex::new(BTreeMap::new());

/// The key of an outside program's parameter: `parameters.<name>`. `None` unless `name` is a letter
/// or underscore followed by letters, digits and underscores.
pub fn free_key(name: &str) -> Option<&'static Key> {
    let own = name.strip_prefix(PREFIX)?;
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let begins = own.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if !begins || !own.chars().all(is_word) || own.len() > LONGEST_NAME {
        return None;
    }
    let mut keys = KEYS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(key) = keys.get(name) {
        return Some(key);
    }
    let name: &'static str = Box::leak(name.into());
    let key: &'static Key = Box::leak(Box::new(Key {
        name,
        kind: Kind::Scalar,
        written_doc: " a parameter of an outside program or of a model",
        default: None,
        before: None,
        earlier: None,
    }));
    keys.insert(name, key);
    Some(key)
}

/// A text of the author's that stays in memory until the process ends, such as a unit.
pub fn interned(text: &str) -> &'static str {
    static TEXTS: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut texts = TEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = texts.get(text) {
        return known;
    }
    let text: &'static str = Box::leak(text.into());
    texts.insert(text);
    text
}

/// The free keys with these names, each once, in alphabetical order. `None` if a name is not of the form of
/// [`free_key`], or if there are too many.
pub fn free_keys<'n>(names: impl IntoIterator<Item = &'n str>) -> Option<Vec<&'static Key>> {
    let names: BTreeSet<&str> = names.into_iter().collect();
    if names.len() > MOST_PARAMETERS { None } else { names.into_iter().map(free_key).collect() }
}

/// The values of free keys among others, by the names that the user gave them.
pub fn free_values<'v>(
    keys: &'static [Key],
    values: &'v [Value],
) -> impl Iterator<Item = (&'static str, &'v Value)> {
    let named = keys.iter().zip(values);
    named.filter_map(|(key, value)| Some((key.name.strip_prefix(PREFIX)?, value)))
}

/// Declarations of `T` with free keys beside their own, one for each set of names. They stay in memory until the
/// process ends.
pub struct WithFreeKeys<T: 'static>(Mutex<BTreeMap<Vec<&'static str>, &'static T>>);

impl<T> WithFreeKeys<T> {
    /// No declarations.
    pub const fn none() -> Self {
        WithFreeKeys(Mutex::new(BTreeMap::new()))
    }

    /// The declaration with these free keys, which `make` makes from all keys: `own`, then the free ones.
    pub fn of(
        &self,
        own: &[Key],
        free: &[&'static Key],
        make: impl FnOnce(&'static [Key]) -> T,
    ) -> &'static T {
        let names = free.iter().map(|key| key.name).collect();
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        made.entry(names).or_insert_with(|| {
            let keys: Vec<Key> = own.iter().chain(free.iter().copied()).copied().collect();
            Box::leak(Box::new(make(Vec::leak(keys))))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_parameters_are_words() {
        for name in ["parameters.", "parameters.9", "parameters.a-b", "parameters.a.b", "rate"] {
            assert!(free_key(name).is_none(), "{name}");
        }
        assert!(free_key(&format!("parameters.{}", "x".repeat(65))).is_none());
        assert_eq!(free_key("parameters._x9").unwrap().name, "parameters._x9");
    }
}
