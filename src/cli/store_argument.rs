//! `--store`: the store of a command.

use std::path::PathBuf;

use clap::Args;

use crate::cli::output::shell_word;

const DEFAULT_STORE: &str = "jitai.sqlite";

/// The store of a command.
#[derive(Args)]
pub(super) struct StoreArgument {
    /// The store: a SQLite file
    #[arg(long, value_name = "FILE", env = "JITAI_STORE", default_value = DEFAULT_STORE)]
    pub(super) store: PathBuf,
}

impl StoreArgument {
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
