//! `--store`: the store of a command, which records commands that change it.

use std::path::PathBuf;

use clap::Args;

use crate::cli::output::shell_word;
use crate::portable::posterior_in;
use crate::schedule;
use crate::store::{Command, Store, StoreError};

const DEFAULT_STORE: &str = "jitai.sqlite";

/// The store of a command.
#[derive(Args, Clone)]
pub(super) struct StoreArgument {
    /// The store: a SQLite file
    #[arg(long, value_name = "FILE", env = "JITAI_STORE", default_value = DEFAULT_STORE)]
    pub(super) store: PathBuf,
}

impl StoreArgument {
    /// Opens the store for a command that changes it, and that it records.
    pub(super) fn open(&self) -> Result<Store, StoreError> {
        Ok(Store::open(&self.store)?.changed_by(this_command()))
    }

    /// The description of the policy of a completed bandit in the store, for keys that take a posterior.
    pub(super) fn posterior(&self, key: &str) -> Result<String, String> {
        posterior_in(&self.store, key)
    }

    /// The option `--store` for a suggested command; empty if the command would use this store by
    /// default.
    pub(super) fn as_option(&self) -> String {
        let usual = std::env::var_os("JITAI_STORE").unwrap_or_else(|| DEFAULT_STORE.into());
        if self.store.as_os_str() == usual {
            return String::new();
        }
        format!(" --store {}", shell_word(&self.store.display().to_string()))
    }
}

/// The command of this process.
pub(super) fn this_command() -> Command {
    let words = std::env::args_os().skip(1).map(|word| shell_word(&word.to_string_lossy()));
    let words = std::iter::once("jitai".to_owned()).chain(words).collect::<Vec<_>>().join(" ");
    schedule::command(words)
}
