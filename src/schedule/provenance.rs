//! The provenance of runs: this process and its machine.

use std::fs;

use crate::agent;
use crate::job::Provenance;
use crate::store::{self, Command};

/// The provenance of runs made by this process.
pub fn of_this_process() -> Provenance {
    Provenance {
        code_version: env!("CARGO_PKG_VERSION").to_owned(),
        git_revision: env!("JITAI_GIT_REVISION").to_owned(),
        backend: agent::backend_name().to_owned(),
        host: store::host_name(),
        processor: processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
    }
}

/// The command of this process with these words, for the list of commands that changed a store.
pub fn command(words: String) -> Command {
    let folder = std::env::current_dir().unwrap_or_default().display().to_string();
    let Provenance { host, code_version, git_revision, .. } = of_this_process();
    Command { words, folder, host, code_version, git_revision }
}

fn processor() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}
