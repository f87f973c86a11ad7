//! What this process and machine are, for the provenance of runs.

use std::fs;

use crate::agent;
use crate::record::Provenance;

/// The provenance of runs made by this process.
pub(super) fn of_this_process() -> Provenance {
    Provenance {
        code_version: env!("CARGO_PKG_VERSION").to_owned(),
        git_revision: env!("JITAI_GIT_REVISION").to_owned(),
        backend: agent::backend_name().to_owned(),
        host: first_line("/proc/sys/kernel/hostname")
            .or_else(|| std::env::var("HOSTNAME").ok())
            .unwrap_or_else(|| "unknown".to_owned()),
        processor: processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
    }
}

fn first_line(path: &str) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    text.lines().next().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty())
}

fn processor() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}
