//! The direction of the data flow, held: which module may import which.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// What each module may import; the order is that of the data flow.
const TABLE: &[(&str, &[&str])] = &[
    ("rng", &[]),
    ("kernel", &[]),
    ("kill_point", &[]),
    ("env", &["rng", "kernel"]),
    // The optimal policy is tried with a stream of its own.
    ("optimum", &["rng", "kernel", "env"]),
    ("agent", &["rng", "kernel", "env", "optimum"]),
    // A manifest declares environments and agents; it neither simulates nor trains.
    ("manifest", &["env", "agent"]),
    ("plan", &["env", "agent", "manifest"]),
    ("record", &["manifest", "plan"]),
    ("train", &["rng", "env", "agent", "plan", "record"]),
    ("store", &["kill_point", "manifest", "plan", "record"]),
    ("schedule", &["kill_point", "manifest", "plan", "record", "train", "store"]),
    // The bootstrap draws from a stream of its own.
    ("analyse", &["rng", "env", "manifest", "record"]),
    ("report", &["env", "optimum", "manifest", "plan", "record", "store", "analyse"]),
    (
        "cli",
        &[
            "rng",
            "kernel",
            "kill_point",
            "env",
            "optimum",
            "agent",
            "manifest",
            "plan",
            "record",
            "train",
            "store",
            "schedule",
            "analyse",
            "report",
        ],
    ),
];

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// The modules that a text names behind `crate::`, comments and string literals included.
fn imports(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (at, _) in text.match_indices("crate::") {
        let rest = &text[at + "crate::".len()..];
        if let Some(group) = rest.strip_prefix('{') {
            let group = group.split('}').next().unwrap_or_default();
            found.extend(group.split(',').map(|part| first_word(part.trim())));
        } else {
            found.insert(first_word(rest));
        }
    }
    found.remove("");
    found
}

fn first_word(text: &str) -> String {
    text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

#[test]
fn no_module_imports_against_the_flow() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let table: BTreeMap<&str, BTreeSet<&str>> =
        TABLE.iter().map(|(name, may)| (*name, may.iter().copied().collect())).collect();
    let mut files = Vec::new();
    sources(&source, &mut files);
    let mut seen = BTreeSet::new();
    let mut faults = Vec::new();
    for file in files {
        let relative = file.strip_prefix(&source).unwrap();
        let module = relative.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs");
        if module == "lib" || module == "main" {
            continue;
        }
        seen.insert(module.to_owned());
        let Some(may) = table.get(module) else {
            faults.push(format!("{}: `{module}` is not in the table", relative.display()));
            continue;
        };
        for import in imports(&fs::read_to_string(&file).unwrap()) {
            if import != module && !may.contains(import.as_str()) {
                faults.push(format!("{}: imports `{import}`", relative.display()));
            }
        }
    }
    assert!(faults.is_empty(), "against the flow:\n{}", faults.join("\n"));
    let declared: BTreeSet<String> = TABLE.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(seen, declared, "the table lists the modules that there are");
}

#[test]
fn the_table_itself_has_no_cycle() {
    // Every module may import only modules that stand before it.
    for (position, (module, may)) in TABLE.iter().enumerate() {
        for import in *may {
            let at = TABLE.iter().position(|(name, _)| name == import).unwrap();
            assert!(at < position, "`{module}` imports `{import}`, which does not stand before it");
        }
    }
}

#[test]
fn imports_are_found_in_every_form() {
    let text =
        "use crate::plan::Job; fn f(x: crate::env::Action) {} use crate::{rng, store::Store};";
    let expected = ["env", "plan", "rng", "store"].map(str::to_owned);
    assert_eq!(imports(text), BTreeSet::from(expected));
}
