//! The direction of the data flow: which modules each module may import, and no cycles between files.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

/// The permitted imports of each module, in the order of the data flow.
const TABLE: &[(&str, &[&str])] = &[
    ("rng", &[]),
    ("kernel", &[]),
    ("kill_point", &[]),
    // It starts programs and exchanges lines with them; `train` knows the job that a line belongs to.
    ("external", &[]),
    ("text", &[]),
    ("key", &["text"]),
    ("state", &["rng"]),
    // The program of an environment of the user's simulates its lanes.
    ("env", &["rng", "kernel", "external", "text", "key", "state"]),
    // The optimal policy is simulated with a random stream of its own.
    ("optimum", &["rng", "key", "env"]),
    ("agent", &["rng", "kernel", "key", "state", "env", "optimum"]),
    ("job", &["key", "env", "agent"]),
    // A checkpoint keeps its sums.
    ("estimate", &["state", "job"]),
    ("record", &["key", "job"]),
    ("train", &["rng", "external", "key", "state", "env", "agent", "job", "estimate"]),
    // A manifest declares environments and agents; it neither simulates nor trains.
    // The settings of a search have a random stream of their own.
    ("manifest", &["rng", "text", "key", "env", "agent", "job"]),
    // The race of a search compares arms by Student's t.
    ("plan", &["text", "key", "env", "agent", "job", "estimate", "manifest"]),
    ("store", &["text", "kill_point", "key", "job", "record"]),
    ("portable", &["key", "env", "agent", "job", "store"]),
    (
        "schedule",
        &[
            "kill_point",
            "text",
            "key",
            "agent",
            "job",
            "estimate",
            "manifest",
            "plan",
            "train",
            "store",
            "portable",
        ],
    ),
    (
        "cluster",
        &["external", "text", "key", "job", "manifest", "plan", "train", "store", "schedule"],
    ),
    ("watch", &["text", "key", "job", "manifest", "plan", "store", "schedule", "cluster"]),
    // The bootstrap has a random stream of its own.
    ("analyse", &["rng", "key", "env", "job", "estimate", "manifest", "record"]),
    (
        "report",
        &["text", "key", "env", "optimum", "job", "manifest", "plan", "record", "store", "analyse"],
    ),
    // What a model's people are, from a pilot's decisions; its files are those of a report.
    ("fit", &["rng", "kernel", "text", "key", "env", "estimate", "analyse", "report"]),
    (
        "cli",
        &[
            "rng",
            "kernel",
            "kill_point",
            "text",
            "key",
            "state",
            "env",
            "optimum",
            "agent",
            "job",
            "estimate",
            "record",
            "train",
            "manifest",
            "plan",
            "store",
            "portable",
            "schedule",
            "cluster",
            "watch",
            "analyse",
            "report",
            "fit",
        ],
    ),
];

/// The files outside `env` and `optimum` that name what only the family `step_count` has, except in their tests.
const OF_STEP_COUNT: &[&str] = &[
    // Its rules, and the kind of analysis that only an inferred context has.
    "agent/registry/rule.rs",
    "agent/rule.rs",
    "analyse/declared/curve.rs",
    "analyse/declared/inference_error.rs",
    "analyse/declared/reproduction.rs",
    "manifest/analysis/axis.rs",
    "manifest/analysis/read.rs",
    "manifest/hints.rs",
    "report/kinds/inference_error.rs",
    // The commands that simulate it without a job.
    "cli/optimum.rs",
    "cli/replay.rs",
    "cli/setting.rs",
    "cli/simulate.rs",
    "cli/steps.rs",
    // Names that other programs read: a metric, columns of the store, keys of JSON and CSV.
    "analyse/declared/summary.rs",
    "cli/plan.rs",
    "cli/progress.rs",
    "cli/status.rs",
    "cli/summary.rs",
    "job/metric.rs",
    "record/job.rs",
    "report/environment_words.rs",
    "schedule/event_log.rs",
    "store/data_query.rs",
    "store/decision.rs",
    "store/doctor.rs",
    "store/participant.rs",
    "store/sample.rs",
    "store/tables.rs",
    // A Greek letter, the crate's example and its facade.
    "lib.rs",
    "report/letters.rs",
];

/// Words of the family `step_count`, in lower case.
const WORDS_OF_STEP_COUNT: [&str; 6] =
    ["sigma", "habituation", "disengage", "physicalactivity", "steps walked", "steps_walked"];

/// The path of a module below the crate: `["manifest", "read"]`.
type ModulePath = Vec<String>;

/// A path as written in the source: `["crate", "plan", "Job"]`.
type Written = Vec<String>;

/// The paths and names in a file of the library.
#[derive(Debug, Default)]
struct File {
    /// Paths that the file names, in `use` and elsewhere, except in tests.
    named: Vec<Written>,
    /// Re-exported names, each with its path: `pub use read::load` is `load` with its path.
    passed_on: BTreeMap<String, Written>,
    /// Names that the file defines.
    defined: BTreeSet<String>,
}

impl File {
    fn read(text: &str) -> File {
        let mut file = File::default();
        file.visit_file(&syn::parse_file(text).expect("the library compiles"));
        file
    }

    /// Collects the leaves of a `use`, including nested groups.
    fn leaves(&mut self, tree: &UseTree, before: &[String], passes_on: bool) {
        let mut path = before.to_vec();
        match tree {
            UseTree::Path(part) => {
                path.push(part.ident.to_string());
                self.leaves(&part.tree, &path, passes_on);
            }
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.leaves(tree, before, passes_on));
            }
            UseTree::Name(name) => self.leaf(path, name.ident.to_string(), None, passes_on),
            UseTree::Rename(name) => {
                let known_as = Some(name.rename.to_string());
                self.leaf(path, name.ident.to_string(), known_as, passes_on);
            }
            UseTree::Glob(_) => self.named.push(path),
        }
    }

    fn leaf(&mut self, mut path: Written, name: String, known_as: Option<String>, passes_on: bool) {
        if name != "self" {
            path.push(name.clone());
        }
        if passes_on {
            self.passed_on.insert(known_as.unwrap_or(name), path);
        } else {
            self.named.push(path);
        }
    }
}

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    })
}

impl<'a> Visit<'a> for File {
    fn visit_item(&mut self, item: &'a Item) {
        let (attributes, name) = match item {
            Item::Const(item) => (&item.attrs, Some(&item.ident)),
            Item::Enum(item) => (&item.attrs, Some(&item.ident)),
            Item::Fn(item) => (&item.attrs, Some(&item.sig.ident)),
            Item::Mod(item) => (&item.attrs, None),
            Item::Static(item) => (&item.attrs, Some(&item.ident)),
            Item::Struct(item) => (&item.attrs, Some(&item.ident)),
            Item::Trait(item) => (&item.attrs, Some(&item.ident)),
            Item::Type(item) => (&item.attrs, Some(&item.ident)),
            Item::Use(item) => (&item.attrs, None),
            _ => return visit::visit_item(self, item),
        };
        if is_test(attributes) {
            return;
        }
        self.defined.extend(name.map(ToString::to_string));
        visit::visit_item(self, item);
    }

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        let passes_on = !matches!(item.vis, Visibility::Inherited);
        self.leaves(&item.tree, &[], passes_on);
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        let parts: Written = path.segments.iter().map(|part| part.ident.to_string()).collect();
        if parts.len() > 1 {
            self.named.push(parts);
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'a syn::Macro) {
        // Paths in the arguments of macros that take lists of expressions, such as `format!`.
        let list = syn::punctuated::Punctuated::<syn::Expr, syn::Token![,]>::parse_terminated;
        if let Ok(arguments) = called.parse_body_with(list) {
            arguments.iter().for_each(|argument| visit::visit_expr(self, argument));
        }
        visit::visit_macro(self, called);
    }
}

/// The files of a library by their modules.
#[derive(Debug)]
struct Library(BTreeMap<ModulePath, File>);

impl Library {
    fn of(sources: impl IntoIterator<Item = (ModulePath, String)>) -> Library {
        let read = |(module, text): (ModulePath, String)| (module, File::read(&text));
        Library(sources.into_iter().map(read).collect())
    }

    /// The files under `src`, including unit tests but without the program.
    fn of_this_crate() -> Library {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let mut files = Vec::new();
        sources(&source, &mut files);
        Library::of(files.iter().filter_map(|file| {
            let relative = file.strip_prefix(&source).unwrap().with_extension("");
            let mut module: ModulePath =
                relative.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            module.pop_if(|last| last == "mod" || last == "lib");
            let is_test = module.last().is_some_and(|last| last.ends_with("tests"));
            let text = fs::read_to_string(file).unwrap();
            (module != ["main"] && !is_test).then_some((module, text))
        }))
    }

    /// The file to which a path in a file leads; `None` if the path leads out of the library.
    fn target(&self, from: &ModulePath, written: &[String]) -> Option<ModulePath> {
        self.resolve(from, written, 0)
    }

    fn resolve(&self, from: &ModulePath, written: &[String], depth: usize) -> Option<ModulePath> {
        assert!(depth < 20, "{written:?} in {from:?} leads to itself");
        let mut rest = written;
        let mut module = match rest.first()?.as_str() {
            "crate" => Vec::new(),
            "self" => from.clone(),
            "super" => {
                let mut module = from.clone();
                while rest.first().is_some_and(|part| part == "super") {
                    module.pop();
                    rest = &rest[1..];
                }
                return self.descend(module, rest, depth);
            }
            child => {
                let mut module = from.clone();
                module.push(child.to_owned());
                if !self.0.contains_key(&module) {
                    return None;
                }
                module
            }
        };
        rest = &rest[1..];
        self.descend(std::mem::take(&mut module), rest, depth)
    }

    /// Follows a path from a module down to the file that defines the named item.
    fn descend(
        &self,
        mut module: ModulePath,
        mut rest: &[String],
        depth: usize,
    ) -> Option<ModulePath> {
        while let Some(part) = rest.first() {
            let mut child = module.clone();
            child.push(part.clone());
            let is_item = self.0.get(&module).is_some_and(|file| file.defined.contains(part));
            if is_item || !self.0.contains_key(&child) {
                break;
            }
            module = child;
            rest = &rest[1..];
        }
        let file = self.0.get(&module)?;
        match rest.first().and_then(|item| file.passed_on.get(item)) {
            Some(written) => {
                // A name from outside the library belongs to the file that re-exports it.
                self.resolve(&module, written, depth + 1).or(Some(module))
            }
            None => Some(module),
        }
    }

    /// The files on which each file depends. A re-export from the same top-level module is not a
    /// dependency; a re-export from another module is. Re-exports in the root of the crate do not
    /// count.
    fn edges(&self) -> BTreeMap<ModulePath, BTreeSet<ModulePath>> {
        let edges = |(from, file): (&ModulePath, &File)| {
            let named = file.named.iter().filter_map(|written| self.target(from, written));
            let passed_on =
                file.passed_on.values().filter_map(|written| self.target(from, written));
            let imported =
                passed_on.filter(|target| !from.is_empty() && target.first() != from.first());
            (from.clone(), named.chain(imported).filter(|target| target != from).collect())
        };
        self.0.iter().map(edges).collect()
    }

    /// Cycles: each lists the files that depend on each other.
    fn circles(&self) -> Vec<String> {
        let edges = self.edges();
        let reach = |from: &ModulePath| {
            let mut reached = BTreeSet::new();
            let mut ahead: Vec<&ModulePath> = edges[from].iter().collect();
            while let Some(next) = ahead.pop() {
                if reached.insert(next.clone()) {
                    ahead.extend(&edges[next]);
                }
            }
            reached
        };
        let reached: BTreeMap<&ModulePath, _> =
            edges.keys().map(|file| (file, reach(file))).collect();
        let mut circles = BTreeSet::new();
        for (file, ahead) in &reached {
            if ahead.contains(*file) {
                let together: Vec<String> = ahead
                    .iter()
                    .filter(|other| reached[*other].contains(*file))
                    .map(|other| other.join("::"))
                    .collect();
                circles.insert(together.join(", "));
            }
        }
        circles.into_iter().collect()
    }
}

pub(crate) fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

#[test]
fn what_only_one_family_has_is_named_in_few_places() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let names_it = |file: &&PathBuf| {
        let text = fs::read_to_string(file).unwrap().to_lowercase();
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        WORDS_OF_STEP_COUNT.iter().any(|word| code.contains(word))
    };
    let found: BTreeSet<String> = files
        .iter()
        .filter(names_it)
        .map(|file| file.strip_prefix(&root).unwrap().display().to_string())
        .filter(|name| !name.starts_with("env/") && !name.starts_with("optimum/"))
        .filter(|name| !name.ends_with("tests.rs"))
        .collect();
    let listed: BTreeSet<String> = OF_STEP_COUNT.iter().map(|name| (*name).to_owned()).collect();
    assert_eq!(found, listed, "only what belongs to a family may name its words");
}

#[test]
fn no_module_imports_against_the_flow() {
    let table: BTreeMap<&str, BTreeSet<&str>> =
        TABLE.iter().map(|(name, may)| (*name, may.iter().copied().collect())).collect();
    let mut seen = BTreeSet::new();
    let mut faults = Vec::new();
    let library = Library::of_this_crate();
    for (file, targets) in library.edges() {
        let Some(module) = file.first() else { continue };
        seen.insert(module.clone());
        let Some(may) = table.get(module.as_str()) else {
            faults.push(format!("{}: `{module}` is not in the table", file.join("::")));
            continue;
        };
        for target in targets.iter().filter_map(|target| target.first()) {
            if target != module && !may.contains(target.as_str()) {
                faults.push(format!("{}: imports `{target}`", file.join("::")));
            }
        }
    }
    assert!(faults.is_empty(), "against the flow:\n{}", faults.join("\n"));
    let declared: BTreeSet<String> = TABLE.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(seen, declared, "the table lists every module");
}

#[test]
fn no_file_needs_itself_by_way_of_others() {
    let circles = Library::of_this_crate().circles();
    assert!(circles.is_empty(), "circles between files:\n{}", circles.join("\n"));
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

/// A library of files with these modules and texts.
fn library(files: &[(&str, &str)]) -> Library {
    Library::of(files.iter().map(|(module, text)| {
        let module = module.split("::").filter(|part| !part.is_empty());
        (module.map(str::to_owned).collect(), (*text).to_owned())
    }))
}

#[test]
fn imports_are_found_in_every_form() {
    let files = |text| {
        library(&[
            ("", "mod a; mod b; mod c;"),
            ("a", "mod x; mod y; pub use x::Thing;"),
            ("a::x", "pub struct Thing; pub fn make() {}"),
            ("a::y", text),
            ("b", "pub struct B;"),
            ("c", "pub struct C; pub mod inner { pub struct D; }"),
        ])
    };
    for (text, expected) in [
        ("use crate::b::B;", "b"),
        ("use crate::{c::{C as Other}, b};", "b, c"),
        ("use super::super::b::B;", "b"),
        ("use super::x::make;", "a::x"),
        ("use super::Thing;", "a::x"),
        ("use crate::a::{self, Thing};", "a, a::x"),
        ("fn f(_: crate::b::B) { super::x::make() }", "a::x, b"),
        ("fn f() { println!(\"{:?}\", crate::c::C); }", "c"),
        ("use crate::c::inner::D; use std::fmt;", "c"),
        ("pub(super) use crate::b::B;", "b"),
        ("pub use crate::{b::B as Other, c};", "b, c"),
        ("pub use super::x::make;", ""),
        ("#[cfg(test)] mod tests { use crate::b::B; }", ""),
    ] {
        let edges = files(text).edges();
        let found = edges[&vec!["a".to_owned(), "y".to_owned()]].iter();
        let found: Vec<String> = found.map(|module| module.join("::")).collect();
        assert_eq!(found.join(", "), expected, "{text}");
    }
}

#[test]
fn circles_are_found_through_modules_that_pass_names_on() {
    let circular = library(&[
        ("", "mod a;"),
        ("a", "mod x; mod y; mod z; pub use x::X; pub use y::Y;"),
        ("a::x", "use super::Y; pub struct X;"),
        ("a::y", "pub struct Y; fn f(_: super::z::Z) {}"),
        ("a::z", "use crate::a::X; pub struct Z;"),
    ]);
    assert_eq!(circular.circles(), ["a::x, a::y, a::z"]);
    let straight = library(&[
        ("", "mod a;"),
        ("a", "mod x; mod y; pub use x::X; pub use y::Y;"),
        ("a::x", "use super::Y; pub struct X;"),
        ("a::y", "pub struct Y; #[cfg(test)] mod tests { use super::super::X; }"),
    ]);
    assert!(straight.circles().is_empty());
}
