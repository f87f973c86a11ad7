//! `jitai check`: validates manifests and reports every fault at once.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cli::output::shell_word;
use crate::cli::{Error, Exit, StoreArgument, trial};
use crate::manifest::{self, Faults, Manifest, Overridden, Override, Published, Runs};
use crate::plan::{self, Factors};
use crate::report::{check_diagnosands, splits, undrawn};

/// Validate manifests and report every fault at once, each with line, column and remedy
#[derive(clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    manifests: ManifestArguments,
    /// Start the programs of outside environments and check that they keep the contract: equal seeds give equal
    /// episodes, lanes are independent, values lie inside their bounds. Roll a trial of each model with actions at
    /// random: numbers that are missing or explode are faults, and every variable is shown with its range. With --format
    /// json, the output is an object of `faults` and `trials`
    #[arg(long = "try")]
    tries: bool,
    /// Output format of the faults
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Text for reading, on standard error.
    Text,
    /// A JSON array of objects, on standard output.
    Json,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let (mut valid, mut faulty) = (Vec::new(), Vec::new());
    let posterior = |key: &str| arguments.store.posterior(key);
    for path in &arguments.manifests.paths {
        match manifest::load_with(path, &arguments.manifests.set, Runs(Some(&posterior))) {
            Ok(read) => {
                let published = Published::of(&read.manifest).map(drop);
                match published.and_then(|()| check_diagnosands(&read.manifest)) {
                    Ok(()) => valid.push((path, read)),
                    Err(faults) => faulty.push(faults),
                }
            }
            Err(faults) => faulty.extend(Published::faults_with(faults, path)),
        }
    }
    if faulty.is_empty() {
        check_names(valid.iter().map(|(_, read)| &read.manifest))?;
    }
    match arguments.format {
        Format::Json => {
            let all: Vec<_> = faulty
                .iter()
                .flat_map(|faults| match json!(faults) {
                    serde_json::Value::Array(list) => list,
                    other => vec![other],
                })
                .collect();
            let all = serde_json::Value::Array(all);
            let mut is_sound = faulty.is_empty();
            let shown = match arguments.tries {
                false => all,
                true => {
                    let manifests = valid.iter().map(|(_, read)| &read.manifest);
                    let trials =
                        manifests.flat_map(|one| trial::as_json(one, &trial::of_manifest(one)));
                    let trials: Vec<_> = trials.collect();
                    is_sound &= trials.iter().all(|trial| trial.get("fault").is_none());
                    json!({ "faults": all, "trials": trials })
                }
            };
            writeln!(io::stdout(), "{shown:#}")?;
            Ok(if is_sound { Exit::Done } else { Exit::Usage })
        }
        Format::Text => {
            let shown = valid.iter().try_for_each(|(path, read)| show(path, read));
            // Faults are reported even if nobody reads the output to its end.
            if !faulty.is_empty() {
                return Err(Error::Manifests(faulty));
            }
            shown?;
            if arguments.tries {
                let tried = valid.iter().map(|(_, Overridden { manifest, .. })| {
                    trial::show(manifest, &trial::of_manifest(manifest))
                });
                let faults = tried.collect::<io::Result<Vec<_>>>()?.concat();
                if !faults.is_empty() {
                    return Err(Error::Usage(faults.join("\n")));
                }
            }
            Ok(Exit::Done)
        }
    }
}

/// Prints that a manifest is valid, the number of its jobs as a product of factors, and hints.
fn show(path: &Path, read: &Overridden) -> io::Result<()> {
    let Overridden { manifest, left_out } = read;
    hint(path, left_out)?;
    let mut out = io::stdout().lock();
    let mut lines = match plan::race_line(manifest) {
        Some(line) => vec![line],
        None => Factors::lines(manifest),
    }
    .into_iter();
    writeln!(out, "{}: ok, {}", path.display(), lines.next().unwrap_or_default())?;
    lines.try_for_each(|line| writeln!(out, "  {line}"))?;
    let hints: Vec<String> = manifest::hints(manifest)
        .into_iter()
        .chain(splits(manifest))
        .chain(boxes(manifest))
        .collect();
    hint(path, &hints)
}

/// A hint on the letters that figures show as boxes.
fn boxes(manifest: &Manifest) -> Option<String> {
    let agents = manifest.agents.iter().map(|agent| agent.label.as_ref().unwrap_or(&agent.name));
    let analyses = manifest.analyses.iter().flat_map(|one| one.title.iter().chain([&one.name]));
    let texts = agents.chain(analyses).chain([&manifest.name]);
    let letters = undrawn(texts.map(String::as_str));
    let shown: Vec<String> =
        letters.iter().map(|letter| format!("{} (U+{:04X})", letter, u32::from(*letter))).collect();
    (!shown.is_empty()).then(|| {
        format!(
            "figures as PDF and PNG show a box for {}; their font has Latin, Greek and Cyrillic letters; give the \
             agent a `label`, or the analysis a `title`, of these",
            shown.join(", ")
        )
    })
}

/// Writes hints on a manifest to standard error.
fn hint(path: &Path, hints: &[String]) -> io::Result<()> {
    let path = path.display();
    hints.iter().try_for_each(|hint| writeln!(io::stderr(), "{path}: hint: {hint}"))
}

/// Manifests with overrides of their keys.
#[derive(clap::Args)]
pub(super) struct ManifestArguments {
    /// Manifests (TOML files)
    #[arg(required = true, value_name = "MANIFEST")]
    pub(super) paths: Vec<PathBuf>,
    /// Override a key for this command, such as agent.gamma=0.9 or seeds=5; repeatable
    ///
    /// KEY is a top-level key, `environment.KEY`, `population.KEY`, `evaluation.KEY`, `agent.KEY` for every agent that
    /// has the key, `agent.NAME.KEY` for one agent, or KEY alone if only one section has it. VALUE is
    /// TOML; quotes around words may be left out.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<Override>,
}

impl ManifestArguments {
    /// Loads the manifests, or returns all their faults.
    pub(super) fn load(&self, store: &StoreArgument) -> Result<Vec<Manifest>, Error> {
        load_all(&self.paths, &self.set, store)
    }

    /// The arguments, quoted for a shell.
    pub(super) fn words(&self) -> impl Iterator<Item = String> {
        let set =
            self.set.iter().flat_map(|set| ["--set".to_owned(), shell_word(&set.to_string())]);
        self.paths.iter().map(|path| shell_word(&path.to_string_lossy())).chain(set)
    }
}

/// Loads manifests, or returns all their faults.
pub(super) fn load_all<P: AsRef<Path>>(
    paths: &[P],
    set: &[Override],
    store: &StoreArgument,
) -> Result<Vec<Manifest>, Error> {
    let posterior = |key: &str| store.posterior(key);
    let mut manifests = Vec::new();
    let mut faulty: Vec<Faults> = Vec::new();
    for path in paths {
        match manifest::load_with(path.as_ref(), set, Runs(Some(&posterior))) {
            Ok(Overridden { manifest, left_out }) => {
                // The manifest is valid, whether or not somebody reads the hints.
                let _ = hint(path.as_ref(), &left_out);
                manifests.push(manifest);
            }
            Err(faults) => faulty.push(faults),
        }
    }
    if !faulty.is_empty() {
        return Err(Error::Manifests(faulty));
    }
    check_names(&manifests)?;
    Ok(manifests)
}

fn check_names<'a>(manifests: impl IntoIterator<Item = &'a Manifest>) -> Result<(), Error> {
    manifest::same_name(manifests).map_or(Ok(()), |message| Err(Error::Usage(message)))
}
