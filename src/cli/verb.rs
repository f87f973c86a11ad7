//! The verbs of the program, and its entry point.

use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue};
use clap::{CommandFactory, Parser, Subcommand};

use crate::cli::{
    Error, cancel, check, completions, decide, doctor, export, fit, forget, log, manual, merge,
    optimum, plan, query, report, run, schema, self_test, signals, simulate, status, submit, task,
    watch,
};
use crate::kernel::Isa;
use crate::kill_point;
use crate::manifest::nearest;

/// Reinforcement-learning experiments for just-in-time adaptive interventions.
#[derive(Parser)]
#[command(name = "jitai", version, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    Check(check::Arguments),
    Plan(plan::Arguments),
    Run(run::Arguments),
    Status(status::Arguments),
    Watch(watch::Arguments),
    Query(query::Arguments),
    Report(report::Arguments),
    Export(export::Arguments),
    Merge(merge::Arguments),
    Submit(submit::Arguments),
    Cancel(cancel::Arguments),
    #[command(hide = true)]
    Task(task::Arguments),
    Forget(forget::Arguments),
    Log(log::Arguments),
    Doctor(doctor::Arguments),
    Simulate(Box<simulate::Arguments>),
    Fit(fit::Arguments),
    Decide(decide::Arguments),
    Optimum(optimum::Arguments),
    Schema(schema::Arguments),
    SelfTest(self_test::Arguments),
    Completions(completions::Arguments),
    Manual(manual::Arguments),
}

/// The error with the nearest verb as the only suggestion for a misspelt verb.
fn naming_the_nearest(mut error: clap::Error) -> clap::Error {
    if let Some(ContextValue::String(found)) = error.get(ContextKind::InvalidSubcommand) {
        let command = Arguments::command();
        let verbs = command.get_subcommands().filter(|verb| !verb.is_hide_set());
        let verbs: Vec<&str> = verbs.map(clap::Command::get_name).collect();
        if let Some(meant) = nearest(found, verbs.iter().copied()) {
            let meant = ContextValue::Strings(vec![meant.to_owned()]);
            error.insert(ContextKind::SuggestedSubcommand, meant);
        }
    }
    error
}

/// Runs the program with the arguments of the process.
pub fn main() -> ExitCode {
    let verb = Arguments::try_parse().unwrap_or_else(|error| naming_the_nearest(error).exit()).verb;
    if let Err(error) = Isa::check_choice() {
        return Error::Usage(error.to_string()).report().into();
    }
    if let Ok(Err(error)) =
        std::env::var(kill_point::VARIABLE).map(|text| kill_point::choose(&text))
    {
        return Error::Usage(error.to_string()).report().into();
    }
    if let Err(source) = signals::survive_file_limits() {
        return Error::Io { what: "listen for signals".to_owned(), source }.report().into();
    }
    let result = match verb {
        Verb::Check(arguments) => check::run(&arguments),
        Verb::Plan(arguments) => plan::run(&arguments),
        Verb::Run(arguments) => run::run(&arguments),
        Verb::Status(arguments) => status::run(&arguments),
        Verb::Watch(arguments) => watch::run(&arguments),
        Verb::Query(arguments) => query::run(&arguments),
        Verb::Report(arguments) => report::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
        Verb::Merge(arguments) => merge::run(&arguments),
        Verb::Submit(arguments) => submit::run(&arguments),
        Verb::Cancel(arguments) => cancel::run(&arguments),
        Verb::Task(arguments) => task::run(&arguments),
        Verb::Forget(arguments) => forget::run(&arguments),
        Verb::Log(arguments) => log::run(&arguments),
        Verb::Doctor(arguments) => doctor::run(&arguments),
        Verb::Simulate(arguments) => simulate::run(&arguments),
        Verb::Fit(arguments) => fit::run(&arguments),
        Verb::Decide(arguments) => decide::run(&arguments),
        Verb::Optimum(arguments) => optimum::run(&arguments),
        Verb::Schema(arguments) => schema::run(&arguments),
        Verb::SelfTest(arguments) => self_test::run(&arguments),
        Verb::Completions(arguments) => completions::run(&arguments, &Arguments::command()),
        Verb::Manual(arguments) => manual::run(&arguments, Arguments::command()),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(error) => error.report().into(),
    }
}
