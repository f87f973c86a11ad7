//! The profile of a cluster: a small TOML file that says where and how tasks run.
//!
//! In: a file. Out: a [`Profile`], or every fault of the file at once, each at its line and column. One
//! table declares the keys; reading, schema and messages follow from it. A key outside the table is an
//! option of the engine and is passed on under its name.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value as Json, json};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::engine::EngineKind;
use super::sbatch;
use crate::manifest::{Document, Fault, FaultList, Faults, Source, Span, document, nearest};

/// Maximum size of a profile, in bytes.
const MOST_BYTES: usize = 1_000_000;

/// Maximum number of cores per task; equal to the maximum number of workers of a sweep.
const MOST_CPUS: i64 = 1024;

/// Minimum of the keys that are times in minutes.
const LEAST_MINUTES: f64 = 0.00001;

/// Maximum time between two hand-ins, in minutes.
const MOST_HAND_IN_MINUTES: f64 = 10.0;

/// Where and how the tasks of a submission run.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// The engine that runs the tasks.
    pub engine: EngineKind,
    /// The partition; `None` for the cluster's default.
    pub partition: Option<String>,
    /// The account that is charged; `None` for the user's default.
    pub account: Option<String>,
    /// Maximum time of a task before it is stopped and queued again, in the engine's notation.
    pub time_limit: Option<String>,
    /// Cores per task; also the number of workers of its sweep.
    pub cpus_per_task: u32,
    /// Memory per task, such as `4G`.
    pub memory: Option<String>,
    /// Maximum number of tasks that run at the same time.
    pub max_running: Option<u32>,
    /// Estimated time of a task, in minutes.
    pub chunk_minutes: f64,
    /// Maximum time between two hand-ins of a task, in minutes.
    pub hand_in_minutes: f64,
    /// The node-local folder for a task's store. The node expands variables such as `$TMPDIR`.
    pub scratch: String,
    /// The shared folder for submissions, if they are not beside the store.
    pub folder: Option<PathBuf>,
    /// Shell commands that each task runs first.
    pub setup: Vec<String>,
    /// Options of the engine, in the order of the file; `None` as the value of a switch.
    pub options: Vec<(String, Option<String>)>,
}

/// The type of a key's value.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Engine,
    Word,
    Time,
    Memory,
    Count { most: i64 },
    Minutes { most: f64 },
    Scratch,
    Folder,
    Lines,
}

/// A key of the profile.
pub(super) struct Key {
    pub(super) name: &'static str,
    kind: Kind,
    default: Option<Default>,
    pub(super) doc: &'static str,
}

#[derive(Clone, Copy)]
enum Default {
    Integer(i64),
    Text(&'static str),
}

pub(super) const KEYS: &[Key] = &[
    Key { name: "engine", kind: Kind::Engine, default: None, doc: "scheduler that runs the tasks" },
    Key {
        name: "partition",
        kind: Kind::Word,
        default: None,
        doc: "partition of the tasks; the cluster's default if absent",
    },
    Key {
        name: "account",
        kind: Kind::Word,
        default: None,
        doc: "account that is charged; the user's default if absent",
    },
    Key {
        name: "time_limit",
        kind: Kind::Time,
        default: None,
        doc: "maximum time of a task, in minutes or in Slurm's format (`2:00:00`, `1-12`); a task \
              that reaches it is checkpointed and queued again",
    },
    Key {
        name: "cpus_per_task",
        kind: Kind::Count { most: MOST_CPUS },
        default: Some(Default::Integer(1)),
        doc: "cores per task, and jobs that a task trains at the same time",
    },
    Key {
        name: "memory",
        kind: Kind::Memory,
        default: None,
        doc: "memory of a task, in MB or with the suffix K, M, G or T",
    },
    Key {
        name: "max_running",
        kind: Kind::Count { most: 1_000_000 },
        default: None,
        doc: "maximum number of tasks that run at the same time",
    },
    Key {
        name: "chunk_minutes",
        kind: Kind::Minutes { most: 100_000.0 },
        default: Some(Default::Integer(15)),
        doc: "estimated time of the jobs of a task, in minutes",
    },
    Key {
        name: "hand_in_minutes",
        kind: Kind::Minutes { most: MOST_HAND_IN_MINUTES },
        default: Some(Default::Integer(9)),
        doc: "maximum time between two hand-ins of finished jobs and checkpoints, in minutes",
    },
    Key {
        name: "scratch",
        kind: Kind::Scratch,
        default: Some(Default::Text(DEFAULT_SCRATCH)),
        doc: "node-local folder for a task's store; variables are expanded on the node",
    },
    Key {
        name: "folder",
        kind: Kind::Folder,
        default: None,
        doc: "folder for submissions, on a disk that login node and compute nodes share; beside \
              the store if absent",
    },
    Key {
        name: "setup",
        kind: Kind::Lines,
        default: None,
        doc: "lines of shell that each task runs first, such as `module load`",
    },
];

const DEFAULT_SCRATCH: &str = "${TMPDIR:-/tmp}";

impl Profile {
    /// The default profile for an engine.
    pub fn of(engine: EngineKind) -> Profile {
        Profile {
            engine,
            partition: None,
            account: None,
            time_limit: None,
            cpus_per_task: 1,
            memory: None,
            max_running: None,
            chunk_minutes: 15.0,
            hand_in_minutes: 9.0,
            scratch: DEFAULT_SCRATCH.to_owned(),
            folder: None,
            setup: Vec::new(),
            options: Vec::new(),
        }
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
        let well_formed = faults.is_empty();
        let profile = read(root.get_ref(), &mut faults, well_formed);
        if faults.is_empty() { Ok(profile) } else { Err(faults.of(label, Source::new(text))) }
    }
}

fn read(root: &DeTable<'_>, faults: &mut FaultList, well_formed: bool) -> Profile {
    let mut profile = Profile::of(EngineKind::Slurm);
    let mut engine = None;
    for (name, value) in root.iter() {
        let key = Span::from(name.span());
        let name = name.get_ref().as_ref();
        let taken = match KEYS.iter().find(|key| key.name == name) {
            None => option(&mut profile, name, key, value),
            Some(Key { kind: Kind::Engine, .. }) => value
                .get_ref()
                .as_str()
                .and_then(EngineKind::named)
                .map(|found| {
                    engine = Some(found);
                })
                .ok_or_else(|| wrong(value, "engine", &expected(Kind::Engine))),
            Some(key) => take(&mut profile, key.name, key.kind, value),
        };
        if let Err(fault) = taken {
            faults.add(fault);
        }
    }
    if engine.is_none() && !root.iter().any(|(name, _)| name.get_ref() == "engine") && well_formed {
        faults.add(Fault::whole("`engine` is missing").help("write engine = \"slurm\""));
    }
    profile
}

/// The value that a key expects, as messages state it.
fn expected(kind: Kind) -> String {
    match kind {
        Kind::Engine => {
            let names: Vec<_> =
                EngineKind::ALL.iter().map(|e| format!("\"{}\"", e.name())).collect();
            names.join(" or ")
        }
        Kind::Word => "a word without blanks".to_owned(),
        Kind::Time => "minutes, or a text such as \"2:00:00\" or \"1-12\"".to_owned(),
        Kind::Memory => "MB, or a text such as \"4G\"".to_owned(),
        Kind::Count { most } => format!("a whole number from 1 to {most}"),
        Kind::Minutes { most } => format!("a number of minutes from {LEAST_MINUTES} to {most}"),
        Kind::Scratch => "a folder, in which only variables such as $USER are special".to_owned(),
        Kind::Folder => "an absolute path".to_owned(),
        Kind::Lines => "a list of lines of shell".to_owned(),
    }
}

fn wrong(value: &Spanned<DeValue<'_>>, name: &str, expected: &str) -> Fault {
    Fault::at(value.span().into(), format!("`{name}`: expected {expected}"))
}

/// Stores the value of a key in the profile.
fn take(
    profile: &mut Profile,
    name: &'static str,
    kind: Kind,
    value: &Spanned<DeValue<'_>>,
) -> Result<(), Fault> {
    let text = || value.get_ref().as_str().map(str::to_owned);
    let integer = || integer(value.get_ref());
    let is_word = |text: &String| {
        !text.is_empty() && text.chars().all(|c| c.is_ascii_graphic() && !"'\"\\`$#".contains(c))
    };
    let taken = match kind {
        Kind::Engine => None,
        Kind::Word => text().filter(is_word).map(|word| match name {
            "partition" => profile.partition = Some(word),
            _ => profile.account = Some(word),
        }),
        Kind::Time => text()
            .filter(|text| is_time(text))
            .or_else(|| {
                integer().filter(|minutes| *minutes >= 1).map(|minutes| minutes.to_string())
            })
            .map(|time| profile.time_limit = Some(time)),
        Kind::Memory => text()
            .filter(|text| is_memory(text))
            .or_else(|| integer().filter(|megabytes| *megabytes >= 1).map(|mb| mb.to_string()))
            .map(|memory| profile.memory = Some(memory)),
        Kind::Count { most } => {
            integer().filter(|count| (1..=most).contains(count)).map(|count| match name {
                "cpus_per_task" => profile.cpus_per_task = count as u32,
                _ => profile.max_running = Some(count as u32),
            })
        }
        Kind::Minutes { most } => number(value.get_ref())
            .filter(|minutes| (LEAST_MINUTES..=most).contains(minutes))
            .map(|minutes| match name {
                "chunk_minutes" => profile.chunk_minutes = minutes,
                _ => profile.hand_in_minutes = minutes,
            }),
        Kind::Scratch => text().filter(|text| is_scratch(text)).map(|text| profile.scratch = text),
        Kind::Folder => text()
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
            .map(|path| profile.folder = Some(path)),
        Kind::Lines => lines(value.get_ref()).map(|lines| profile.setup = lines),
    };
    taken.ok_or_else(|| wrong(value, name, &expected(kind)))
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    value.as_float().map_or_else(|| integer(value).map(|n| n as f64), |f| f.as_str().parse().ok())
}

fn lines(value: &DeValue<'_>) -> Option<Vec<String>> {
    let line = |line: &Spanned<DeValue<'_>>| line.get_ref().as_str().map(str::to_owned);
    value.as_array()?.iter().map(line).collect()
}

/// Whether sbatch reads the text as a time: `minutes`, `minutes:seconds`, `hours:minutes:seconds`,
/// `days-hours` and so on.
pub(super) fn is_time(text: &str) -> bool {
    let (days, clock) = match text.split_once('-') {
        Some((days, clock)) => (Some(days), clock),
        None => (None, text),
    };
    let is_number =
        |part: &str| (1..=6).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_digit());
    let parts: Vec<&str> = clock.split(':').collect();
    days.is_none_or(is_number)
        && parts.len() <= 3
        && parts.iter().all(|part| is_number(part))
        && text.bytes().any(|b| (b'1'..=b'9').contains(&b))
}

pub(super) fn is_memory(text: &str) -> bool {
    let digits = text.strip_suffix(['K', 'M', 'G', 'T']).unwrap_or(text);
    digits.parse::<u64>().is_ok_and(|number| number > 0)
}

/// Whether the text, apart from variables, means the same folder inside double quotes of a shell.
fn is_scratch(text: &str) -> bool {
    (text.starts_with('/') || text.starts_with('$'))
        && !text.contains("$(")
        && !text.chars().any(|c| "\"`\\\n".contains(c) || c.is_control())
}

/// Reads an option of the engine that this program passes on.
fn option(
    profile: &mut Profile,
    name: &str,
    key: Span,
    value: &Spanned<DeValue<'_>>,
) -> Result<(), Fault> {
    let ours: Vec<&str> = KEYS.iter().map(|key| key.name).collect();
    let known = sbatch::OPTIONS.contains(&name);
    if let Some((_, instead)) = sbatch::RESERVED.iter().find(|(reserved, _)| *reserved == name) {
        let fault = Fault::at(key, format!("`{name}` is set by jitai"));
        return Err(if instead.is_empty() { fault } else { fault.help(*instead) });
    }
    let is_option = !name.is_empty()
        && name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
    let words = || ours.iter().copied().chain(sbatch::OPTIONS.iter().copied());
    let misspelt = !known && nearest(name, words()).is_some();
    if !is_option || misspelt {
        let fault = Fault::at(key, format!("unknown key `{name}`"));
        return Err(fault.one_of("a profile's", &ours, name).nearest(name, words()));
    }
    let value_of = match value.get_ref() {
        DeValue::Boolean(true) => None,
        DeValue::Boolean(false) => return Ok(()),
        other => match other.as_str() {
            Some(text) if !text.contains(['\n', '\0']) => Some(text.to_owned()),
            Some(_) => return Err(wrong(value, name, "text on one line")),
            None => match integer(other) {
                Some(number) => Some(number.to_string()),
                None => return Err(wrong(value, name, "text, a whole number, true or false")),
            },
        },
    };
    if name == "signal" && value_of.as_ref().is_none_or(|v| !v.starts_with("B:TERM@")) {
        return Err(wrong(value, name, "\"B:TERM@SECONDS\", the signal on which tasks checkpoint"));
    }
    profile.options.push((name.to_owned(), value_of));
    Ok(())
}

/// The JSON Schema of profiles, in draft 2020-12, for completion and validation in editors.
pub fn schema() -> Json {
    let mut properties = Map::new();
    for key in KEYS {
        let mut property = match key.kind {
            Kind::Engine => {
                json!({ "enum": EngineKind::ALL.iter().map(|e| e.name()).collect::<Vec<_>>() })
            }
            Kind::Word => json!({ "type": "string", "pattern": "^[!-~]+$" }),
            Kind::Time => json!({ "anyOf": [
                { "type": "integer", "minimum": 1 },
                { "type": "string", "pattern": "^([0-9]{1,6}-)?[0-9]{1,6}(:[0-9]{1,6}){0,2}$" },
            ]}),
            Kind::Memory => json!({ "anyOf": [
                { "type": "integer", "minimum": 1 },
                { "type": "string", "pattern": "^[0-9]+[KMGT]?$" },
            ]}),
            Kind::Count { most } => json!({ "type": "integer", "minimum": 1, "maximum": most }),
            Kind::Minutes { most } => {
                json!({ "type": "number", "minimum": LEAST_MINUTES, "maximum": most })
            }
            Kind::Scratch => json!({ "type": "string", "pattern": "^[/$]" }),
            Kind::Folder => json!({ "type": "string", "pattern": "^/" }),
            Kind::Lines => json!({ "type": "array", "items": { "type": "string" } }),
        };
        property["description"] = key.doc.into();
        match key.default {
            Some(Default::Integer(value)) => property["default"] = value.into(),
            Some(Default::Text(value)) => property["default"] = value.into(),
            None => {}
        }
        properties.insert(key.name.to_owned(), property);
    }
    for (name, _) in sbatch::RESERVED {
        properties.insert((*name).to_owned(), false.into());
    }
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "jitai cluster profile",
        "description": "Where and how the tasks of `jitai submit` run.",
        "type": "object",
        "required": ["engine"],
        "properties": properties,
        "additionalProperties": {
            "description": "any other option of sbatch, under its own name",
            "type": ["string", "integer", "boolean"],
        },
    })
}
