//! One name, one thing: how many names of types stand for several types.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use syn::{Ident, Item, Visibility};

use crate::imports::sources;

/// The most names that may stand for several types.
const MOST: usize = 20;

/// The arguments of every verb are called `Arguments`.
#[test]
fn a_name_of_a_type_stands_for_one_type() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    sources(&root, &mut paths);
    let mut types: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for path in paths {
        let file = syn::parse_file(&fs::read_to_string(&path).unwrap()).unwrap();
        for name in file.items.iter().filter_map(type_of_others) {
            let place = path.strip_prefix(&root).unwrap().display().to_string();
            types.entry(name.to_string()).or_default().push(place);
        }
    }
    assert!(types.len() > 400, "{} types", types.len());
    types.retain(|name, files| files.len() > 1 && name != "Arguments");
    assert!(types.len() <= MOST, "{} names stand for several types: {types:#?}", types.len());
}

/// The name of a type that other files can name.
fn type_of_others(item: &Item) -> Option<&Ident> {
    let (visibility, name) = match item {
        Item::Struct(item) => (&item.vis, &item.ident),
        Item::Enum(item) => (&item.vis, &item.ident),
        Item::Trait(item) => (&item.vis, &item.ident),
        Item::Type(item) => (&item.vis, &item.ident),
        _ => return None,
    };
    (!matches!(visibility, Visibility::Inherited)).then_some(name)
}
