//! Confirmation before something is removed.

use std::io::{self, IsTerminal, Write};

use crate::cli::Error;

/// Asks on a terminal whether to do something; elsewhere, the user must give the option `flag`.
///
/// **Errors**: there is no terminal to ask on.
pub(super) fn asked(what: &str, flag: &str) -> Result<bool, Error> {
    if !(io::stdin().is_terminal() && io::stderr().is_terminal()) {
        return Err(Error::Usage(format!("add {flag} to {what}")));
    }
    write!(io::stderr(), "{what}? [y/N] ")?;
    let mut answer = String::new();
    io::stdin().read_line(&mut answer)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}
