//! `jitai self-test`: whether an installed program works on this machine.
//!
//! Parts run in processes of their own: an instruction set is chosen once per process, and only a second process can
//! show whether locks hold.

use std::env;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use clap::ValueEnum;
use data_encoding::HEXLOWER;
use serde_json::{Value, json};

use crate::cli::output::TextOrJson;
use crate::cli::{Error, Exit, StoreArgument};
use crate::job::Outcome;
use crate::kernel::Isa;
use crate::key::printable;
use crate::store::{Contender, contend, results_digest, try_folder};
use crate::train::Uncontrolled;
use crate::{manifest, plan, train};

/// The jobs of the check of bits.
const MANIFEST: &str = include_str!("self_test.toml");

/// The digests of the results of the jobs of [`MANIFEST`], in their order. They change with the versions of the
/// simulation and of algorithms alone.
const DIGESTS: [&str; 6] = [
    "18b97d1c028f1848c9072242ff89a10b5d41ea9aa3ef647a4f865cd2901063d0",
    "f598ac158df3c4aec47f31e06988a8af7f4597c9b595268b7171a6e532d93469",
    "86657c0c5498059cb4422a5d0fd0d811bd6bee169a42d185d7436c72222e956f",
    "117225c581c0957b9cecbc417b10c96a2169e934a136915fe19496b7a0cd45fc",
    "0b973a4a145460119bc1d83a12da772aeb683083c50f3640f720a2ec26e84a69",
    "cf23dffe28d5c697364fac54f410d7c6725f6c139638fb9ac898cfd0d1b4ddbd",
];

/// Check in seconds that this program works on this machine
///
/// Checks that jobs have the same bits on every instruction set of the processor as on the machines of the
/// developers, that the folder of the store can hold one, and that results can be written there. Exits with 0 if all
/// checks pass, with 1 if a result differs, and with 3 if the folder cannot hold a store.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: TextOrJson,
    /// What a process of the test does
    #[arg(long, value_enum, hide = true)]
    part: Option<Part>,
    #[command(flatten)]
    store: StoreArgument,
}

/// What another process does for the test.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Prints the digests of the jobs.
    Digests,
    /// Prints what it can do with the store that the test writes to.
    Contend,
}

/// A check that was made.
struct Check {
    name: &'static str,
    /// What was found, and the fault if there is one.
    found: Result<String, String>,
    /// How a command with this fault ends.
    exit: Exit,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    match arguments.part {
        Some(Part::Digests) => return print_digests(),
        Some(Part::Contend) => {
            let Contender { sees_the_row, can_write } = contend(&arguments.store.store)?;
            writeln!(io::stdout(), "{}", json!([sees_the_row, can_write]))?;
            return Ok(Exit::Done);
        }
        None => {}
    }
    let began = Instant::now();
    let program = this_program()?;
    let checks = [instruction_set(), bits(&program), folder(&program, &arguments.store.store)];
    let seconds = began.elapsed().as_secs_f64();
    show(arguments.format, &checks, seconds)?;
    let failed = checks.iter().find(|check| check.found.is_err());
    Ok(failed.map_or(Exit::Done, |check| check.exit))
}

fn this_program() -> Result<PathBuf, Error> {
    env::current_exe()
        .map_err(|source| Error::Io { what: "find the path of this program".to_owned(), source })
}

/// The instruction set that jobs use.
fn instruction_set() -> Check {
    let names: Vec<&str> = Isa::available().into_iter().map(Isa::name).collect();
    let found = format!("{} of {}", Isa::chosen().name(), names.join(", "));
    Check { name: "instruction set", found: Ok(found), exit: Exit::System }
}

/// Whether jobs have the expected bits on every instruction set.
fn bits(program: &Path) -> Check {
    let sets: Vec<&str> = Isa::available().into_iter().map(Isa::name).collect();
    let found = sets.iter().try_for_each(|set| bits_on(program, set));
    let found = found.map(|()| format!("{} jobs on {}", DIGESTS.len(), sets.join(", ")));
    Check { name: "bits of results", found, exit: Exit::Differs }
}

/// Runs the jobs on an instruction set. The error names the job that differs.
fn bits_on(program: &Path, set: &str) -> Result<(), String> {
    let mut command = Command::new(program);
    command.args(["self-test", "--part", "digests"]).env("JITAI_SIMD", set);
    let printed = output(&mut command)?;
    let mut lines = printed.lines();
    for expected in DIGESTS {
        let line = lines.next().unwrap_or_default();
        let (digest, job) = line.split_once(' ').unwrap_or(("nothing", "the next job"));
        if digest != expected {
            return Err(format!("{job} differs on {set}: found {digest}, expected {expected}"));
        }
    }
    Ok(())
}

/// Prints the digests and names of the jobs.
fn print_digests() -> Result<Exit, Error> {
    let manifest = manifest::parse("self_test.toml", MANIFEST.as_bytes())
        .map_err(|faults| Error::Manifests(vec![faults]))?;
    for planned in plan::jobs(&manifest) {
        let digest = match train::run(&planned.job, &Uncontrolled) {
            Outcome::Completed(results) => {
                HEXLOWER.encode(&results_digest(&planned.job, &results)?)
            }
            Outcome::Failed(failure) => failure.kind.word().to_owned(),
            Outcome::Interrupted => "interrupted".to_owned(),
        };
        writeln!(io::stdout(), "{digest} {}", planned.agent)?;
    }
    Ok(Exit::Done)
}

/// Whether the folder of the store can hold one.
fn folder(program: &Path, store: &Path) -> Check {
    let folder = store.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let tried = try_folder(folder, |scratch| {
        let mut command = Command::new(program);
        let words = ["self-test", "--part", "contend", "--store"];
        command.args(words).arg(scratch).env_remove("JITAI_SIMD");
        let printed = output(&mut command)?;
        let [sees_the_row, can_write] =
            serde_json::from_str(&printed).map_err(|_| format!("it printed `{printed}`"))?;
        Ok(Contender { sees_the_row, can_write })
    });
    let shown = folder.display();
    let found = match tried {
        Ok(()) => Ok(format!("{shown}: locks between processes, and a write-ahead log")),
        Err(fault) => Err(format!("{shown}: {fault}")),
    };
    Check { name: "folder of the store", found, exit: Exit::System }
}

/// What a process of the test prints. The error is its message.
fn output(command: &mut Command) -> Result<String, String> {
    let ended = command
        .stdin(Stdio::null())
        .output()
        .map_err(|error| format!("failed to start {}: {error}", command.get_program().display()))?;
    if !ended.status.success() {
        let message = String::from_utf8_lossy(&ended.stderr).trim().to_owned();
        return Err(if message.is_empty() { ended.status.to_string() } else { message });
    }
    Ok(String::from_utf8_lossy(&ended.stdout).trim().to_owned())
}

fn show(format: TextOrJson, checks: &[Check], seconds: f64) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    let passed = checks.iter().all(|check| check.found.is_ok());
    if format == TextOrJson::Json {
        let checks = checks.iter().map(|Check { name, found, .. }| {
            let fault = found.as_ref().err();
            json!({ "check": name, "passed": fault.is_none(), "found": found.as_ref().ok(), "fault": fault })
        });
        let answer = json!({
            "version": env!("CARGO_PKG_VERSION"), "git_revision": env!("JITAI_GIT_REVISION"),
            "passed": passed, "seconds": seconds, "checks": checks.collect::<Vec<Value>>(),
        });
        return Ok(writeln!(out, "{answer}")?);
    }
    for Check { name, found, .. } in checks {
        let (word, text) = match found {
            Ok(text) => ("ok", text),
            Err(text) => ("FAILED", text),
        };
        writeln!(out, "{word:<7} {name:<21} {}", printable(text))?;
    }
    let verdict = if passed { "works on this machine" } else { "does NOT work on this machine" };
    let (version, revision) = (env!("CARGO_PKG_VERSION"), env!("JITAI_GIT_REVISION"));
    writeln!(out, "jitai {version} ({revision}) {verdict}; checked in {seconds:.1} s")?;
    Ok(())
}
