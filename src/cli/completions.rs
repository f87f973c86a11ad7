//! `jitai completions`: completions of commands, options and paths for shells.

use std::io::{self, Write};

use clap::{Arg, Command, ValueHint};
use clap_complete::Shell;

use crate::cli::{Error, Exit};

/// Print the completions of commands and options for a shell
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The shell
    shell: Shell,
}

/// Prints the completions of `command`, the whole program.
pub(super) fn run(arguments: &Arguments, command: &Command) -> Result<Exit, Error> {
    let verbs: Vec<Command> =
        command.get_subcommands().filter(|verb| !verb.is_hide_set()).map(shown).collect();
    let mut command = Command::new("jitai").version(env!("CARGO_PKG_VERSION")).subcommands(&verbs);
    // The generator panics if it cannot write, as to a closed pipe.
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "jitai", &mut script);
    if arguments.shell == Shell::Bash {
        script = with_paths(&String::from_utf8_lossy(&script), &verbs).into_bytes();
    }
    io::stdout().write_all(&script)?;
    Ok(Exit::Done)
}

/// What a verb shows of itself. Options that take a path say so, and others offer no files: the generator for
/// bash divides names with blanks unless it knows that they are files.
fn shown(verb: &Command) -> Command {
    let arguments = verb.get_arguments().filter(|argument| !argument.is_hide_set());
    let arguments = arguments.map(|argument| {
        let hint = match argument.get_value_hint() {
            ValueHint::AnyPath => ValueHint::FilePath,
            ValueHint::Unknown => ValueHint::Other,
            known => known,
        };
        argument.clone().value_hint(hint)
    });
    let about = verb.get_about().cloned().unwrap_or_default();
    let name: &'static str = verb.get_name().to_owned().leak();
    Command::new(name).about(about).args(arguments)
}

/// The script for bash that also offers the files which verbs take without an option: the generator offers
/// options alone.
fn with_paths(script: &str, verbs: &[Command]) -> String {
    let options = "COMPREPLY=( $(compgen -W \"${opts}\" -- \"${cur}\") )\n";
    let mut parts = script.split("\n        jitai__subcmd__");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let verb = verbs.iter().find(|verb| {
            part.starts_with(&format!("{})", verb.get_name().replace('-', "__subcmd__")))
        });
        let paths = |argument: &&Arg| argument.get_value_hint() == ValueHint::FilePath;
        let taken = verb.and_then(|verb| verb.get_positionals().find(paths));
        out.push_str("\n        jitai__subcmd__");
        let (Some(argument), Some((first, rest))) = (taken, part.rsplit_once(options)) else {
            out.push_str(part);
            continue;
        };
        let named = |name: &clap::builder::Str| name == "MANIFEST";
        let only = match argument.get_value_names().is_some_and(|names| names.iter().any(named)) {
            true => " -X '!*.toml'",
            false => "",
        };
        // Bash completes the file of `--store=FILE` itself.
        let files = format!(
            "[[ \"${{prev}}\" == \"=\" ]] && return 0
            local IFS=$'\\n'
            COMPREPLY=( $(compgen -f{only} -- \"${{cur}}\"; compgen -d -- \"${{cur}}\") )
            compopt -o filenames 2>/dev/null\n"
        );
        out.push_str(&first.replace(" || ${COMP_CWORD} -eq 2 ]]", " ]]"));
        out.push_str(&files);
        out.push_str(rest);
    }
    out
}
