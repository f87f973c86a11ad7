//! The profile of a cluster: a small TOML file that says where and how tasks run.
//!
//! In: a file. Out: a [`Profile`], or every fault of the file at once, each at its line and column. Keys
//! are declared by [`Tasks`] and by the engine; reading, schema and messages follow from the declarations.
//! Any other key is an option of the engine and is passed on under its name.

use std::fs;
use std::path::Path;

use serde_json::{Map, Value as Json, json};
use toml::de::{DeTable, DeValue};

use super::engine::{Declaration, KeyForm, text, text_or_number};
use super::engines::EngineKind;
use super::order::{Order, Tasks};
use crate::key::{Key, Keyed, Value};
use crate::keys;
use crate::manifest::{Node, single, unexpected, value_schema};
use crate::text::{Document, Fault, FaultList, Faults, Source, Span, document, nearest};

/// Maximum size of a profile, in bytes.
const MOST_BYTES: usize = 1_000_000;

keys! {
    /// The key that decides which other keys there are.
    struct Choice {
        /// scheduler that runs the tasks
        engine: EngineKind;
    }
}

/// Where and how the tasks of a submission run.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// The engine that runs the tasks.
    pub engine: EngineKind,
    /// How tasks run.
    pub tasks: Tasks,
    /// Values of the keys that only the engine has, in the order of its declaration.
    pub settings: Vec<Value>,
    /// Options of the engine, in the order of the file; `None` as the value of a switch.
    pub options: Vec<(String, Option<String>)>,
}

/// The forms of the keys of every engine.
const FORMS: &[KeyForm] = &[
    KeyForm {
        key: "scratch",
        expected: "a folder, in which only variables such as $USER are special",
        read: |value| text(value).filter(|text| is_scratch(text)).map(Value::Text),
        schema: || json!({ "type": "string", "pattern": "^[/$]" }),
    },
    KeyForm {
        key: "folder",
        expected: "an absolute path",
        read: |value| text(value).filter(|path| path.starts_with('/')).map(Value::Text),
        schema: || json!({ "type": "string", "pattern": "^/" }),
    },
    KeyForm {
        key: "setup",
        expected: "a list of lines of shell",
        read: |value| {
            let lines = value.as_array()?.iter().map(|line| text(line.get_ref()));
            lines.collect::<Option<_>>().map(Value::Words)
        },
        schema: || json!({ "type": "array", "items": { "type": "string" } }),
    },
];

/// Whether the text, apart from variables, means the same folder inside double quotes of a shell.
fn is_scratch(text: &str) -> bool {
    text.starts_with(['/', '$'])
        && !text.contains("$(")
        && !text.chars().any(|c| "\"`\\\n".contains(c) || c.is_control())
}

impl Default for Profile {
    fn default() -> Profile {
        Profile::of(EngineKind::ALL[0])
    }
}

impl Profile {
    /// The default profile for an engine.
    pub fn of(engine: EngineKind) -> Profile {
        let values = |keys| -> Vec<Value> { values(keys, |_| None) };
        let tasks = Tasks::from_values(&values(Tasks::KEYS)).expect("every key has a default");
        let settings = values(engine.declaration().keys);
        Profile { engine, tasks, settings, options: Vec::new() }
    }

    /// The shared folder for submissions, if they are not beside the store.
    pub fn folder(&self) -> Option<&Path> {
        Some(Path::new(&self.tasks.folder)).filter(|folder| !folder.as_os_str().is_empty())
    }

    /// The engine's script of an array `name` of `chunks` tasks, which run `program` on the submission in
    /// `folder`; both paths are absolute.
    pub fn script(&self, name: &str, chunks: u32, folder: &Path, program: &Path) -> String {
        let Profile { engine, tasks, settings, options } = self;
        let script = engine.declaration().script;
        script(&Order { name, chunks, folder, program, tasks, settings, options })
    }

    /// Reads and validates the profile at `path`.
    ///
    /// **Errors**: every fault of the file, as shown to authors.
    pub fn load(path: &Path) -> Result<Profile, Faults> {
        let label = path.display().to_string();
        let whole = |message: String| Faults::of_file(&label, Fault::whole(message));
        if !path.is_file() {
            return Err(whole("no such file, or not a regular file".to_owned()));
        }
        let bytes = fs::read(path).map_err(|error| whole(format!("cannot be read: {error}")))?;
        if bytes.len() > MOST_BYTES {
            return Err(whole(format!("the file is larger than {MOST_BYTES} bytes")));
        }
        let text =
            String::from_utf8(bytes).map_err(|error| whole(format!("not UTF-8: {error}")))?;
        Profile::parse(&label, &text)
    }

    /// Validates the text of a profile; messages call the file `label`.
    ///
    /// **Errors**: every fault of the text.
    pub fn parse(label: &str, text: &str) -> Result<Profile, Faults> {
        let Document { root, repeats, syntax, .. } = document(text);
        let mut faults = syntax;
        faults.append(repeats);
        let profile = read(text, root.get_ref(), &mut faults);
        if faults.is_empty() { Ok(profile) } else { Err(faults.of(label, Source::new(text))) }
    }
}

/// The values of keys: what `found` returns, or else the default.
fn values(keys: &[Key], mut found: impl FnMut(&Key) -> Option<Value>) -> Vec<Value> {
    let value = |key: &Key| found(key).or_else(|| key.default()).expect("the key has a default");
    keys.iter().map(value).collect()
}

/// The profile of a text and its tree; `faults` has those of the notation.
fn read(text: &str, root: &DeTable<'_>, faults: &mut FaultList) -> Profile {
    let [engine] = Choice::KEYS else { unreachable!("the engine is the only choice") };
    let node = root.get(engine.name);
    if node.is_none() && faults.is_empty() {
        let (name, first) = (engine.name, EngineKind::WORDS[0]);
        let fault = Fault::whole(format!("`{name}` is missing"));
        faults.add(fault.help(format!("write {name} = \"{first}\"")));
    }
    let chosen = node.and_then(|node| single(text, engine.name, engine.kind, node, faults));
    let chosen = chosen.and_then(|word| Choice::from_values(&[word]));
    let mut profile = chosen.map_or_else(Profile::default, |choice| Profile::of(choice.engine));
    let declaration = profile.engine.declaration();
    let mut found = |key: &Key| {
        let node = root.get(key.name)?;
        let Some(form) = form(declaration, key) else {
            return single(text, key.name, key.kind, node, faults);
        };
        let value = (form.read)(node.get_ref());
        if value.is_none() {
            faults.add(unexpected(text, key.name, form.expected, node));
        }
        value
    };
    let tasks = values(Tasks::KEYS, &mut found);
    profile.tasks = Tasks::from_values(&tasks).expect("a value that a key admits fits its field");
    profile.settings = values(declaration.keys, &mut found);
    let ours: Vec<&str> = keys(declaration).map(|key| key.name).collect();
    for (name, node) in root.iter() {
        let (key, name) = (Span::from(name.span()), name.get_ref().as_ref());
        if !ours.contains(&name) {
            match option(declaration, &ours, (name, key), node) {
                Ok(value) => profile.options.extend(value.map(|value| (name.to_owned(), value))),
                Err(fault) => faults.add(fault),
            }
        }
    }
    profile
}

/// The keys of a profile for an engine.
pub(super) fn keys(declaration: &Declaration) -> impl Iterator<Item = &'static Key> {
    [Choice::KEYS, Tasks::KEYS, declaration.keys].into_iter().flatten()
}

fn form(declaration: &Declaration, key: &Key) -> Option<&'static KeyForm> {
    FORMS.iter().chain(declaration.forms).find(|form| form.key == key.name)
}

/// The value of an option that is passed on to the engine: `Some(None)` for a switch, `None` for a switch
/// that is off.
fn option(
    declaration: &Declaration,
    ours: &[&str],
    (name, key): (&str, Span),
    node: &Node<'_>,
) -> Result<Option<Option<String>>, Fault> {
    if let Some((_, instead)) = declaration.reserved.iter().find(|(reserved, _)| *reserved == name)
    {
        let fault = Fault::at(key, format!("`{name}` is set by jitai"));
        return Err(if instead.is_empty() { fault } else { fault.help(*instead) });
    }
    let is_option = name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    // Options have hyphens where keys have underscores.
    let is_misspelt = match name.contains('-') {
        true => ours.contains(&name.replace('-', "_").as_str()),
        false => nearest(name, ours.iter().copied()).is_some(),
    };
    if !is_option || is_misspelt {
        let fault = Fault::at(key, format!("unknown key `{name}`"));
        return Err(fault.one_of("a profile's", ours, name));
    }
    let expected =
        |expected: &str| Fault::at(node.span().into(), format!("`{name}`: expected {expected}"));
    let value = match node.get_ref() {
        DeValue::Boolean(true) => None,
        DeValue::Boolean(false) => return Ok(None),
        other => match text_or_number(other) {
            Some(text) if text.contains(['\n', '\0']) => return Err(expected("text on one line")),
            Some(text) => Some(text),
            None => return Err(expected("text, a whole number, true or false")),
        },
    };
    match (declaration.expected)(name, value.as_deref()) {
        Some(words) => Err(expected(words)),
        None => Ok(Some(value)),
    }
}

/// The JSON Schema of profiles, in draft 2020-12, for completion and validation in editors.
pub fn schema() -> Json {
    let (mut properties, mut programs) = (Map::new(), Vec::new());
    for declaration in EngineKind::ALL.map(EngineKind::declaration) {
        programs.push(declaration.program);
        for key in keys(declaration) {
            let form = form(declaration, key);
            let mut property = form.map_or_else(|| value_schema(key.kind), |form| (form.schema)());
            property["description"] = key.doc().into();
            // A default outside the range stands for an absent key.
            if let Some(default) = key.default().filter(|default| key.kind.admits(default)) {
                property["default"] = json!(default);
            }
            properties.insert(key.name.to_owned(), property);
        }
        properties.extend(
            declaration.reserved.iter().map(|(name, _)| ((*name).to_owned(), false.into())),
        );
    }
    let programs = programs.join(" or ");
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "jitai cluster profile",
        "description": "Where and how the tasks of `jitai submit` run.",
        "type": "object",
        "required": Choice::KEYS.iter().map(|key| key.name).collect::<Vec<_>>(),
        "properties": properties,
        "additionalProperties": {
            "description": format!("any other option of {programs}, under its own name"),
            "type": ["string", "integer", "boolean"],
        },
    })
}
