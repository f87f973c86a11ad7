//! `jitai fit`: the coefficients of a model's people, from a pilot.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::cli::counting::Counting;
use crate::cli::{Error, Exit, folder, signals};
use crate::env::declared::Pilot;
use crate::fit::{DrawnFrom, FitRequest, Fitted, NoFit, NoPilot, Standing, read};

/// Estimate the people of a model from the decisions of a pilot
///
/// The section [fit] of the model says which columns of the data are which variables; the model computes all others itself.
/// Writes the people, the residuals, a prior of a bandit and all estimates into a folder, and prints the [environment] of a
/// manifest that simulates these people.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The model, a TOML file with a section [fit]
    #[arg(value_name = "MODEL", value_hint = clap::ValueHint::FilePath)]
    model: PathBuf,
    /// The decisions: a CSV file with a row for each decision of a person
    #[arg(long, value_name = "CSV", value_hint = clap::ValueHint::FilePath)]
    data: PathBuf,
    /// Output folder; created if it does not exist
    #[arg(long, value_name = "DIR", value_hint = clap::ValueHint::DirPath)]
    out: PathBuf,
    /// Number of simulated pilots with which the page compares the data
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(20..=100_000))]
    simulations: u32,
    /// Also write N files of people whose coefficients are as uncertain as their estimates, draw-1.csv to draw-N.csv
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    draws: Option<u32>,
    /// Draw whole people of the pilot with replacement instead
    #[arg(long, requires = "draws")]
    bootstrap: bool,
    /// Seed of simulated pilots and of drawn people
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let stop = signals::stop_flag()?;
    signals::end_in_time(std::sync::Arc::clone(&stop), || {})?;
    let Some(pilot) = pilot(arguments, &stop)? else { return Ok(Exit::Interrupted) };
    let request = FitRequest {
        simulations: arguments.simulations,
        draws: arguments.draws.unwrap_or(0),
        from: if arguments.bootstrap { DrawnFrom::People } else { DrawnFrom::Estimates },
        seed: arguments.seed,
    };
    let mut shown: Option<(&str, Counting)> = None;
    let mut progress = |what, done, of| {
        if shown.as_ref().is_none_or(|(known, _)| *known != what) {
            shown = Some((what, Counting::new(of, what)));
        }
        shown.iter_mut().for_each(|(_, counting)| counting.advance(done, of));
    };
    let fitted = Fitted::new(pilot, request, &stop, &mut progress);
    drop(shown);
    let fitted = match fitted {
        Ok(fitted) => fitted,
        Err(NoFit::Stopped) => return Ok(Exit::Interrupted),
        Err(why) => {
            if let NoFit::Nobody(notes) = &why {
                say("note", notes)?;
            }
            return Err(Error::Usage(why.to_string()));
        }
    };
    let path = |name: &str| arguments.out.join(name).display().to_string();
    let environment = fitted.environment(&arguments.model.display().to_string(), path);
    folder::make(&arguments.out)?;
    for file in fitted.files(&environment) {
        folder::write(&arguments.out.join(&file.name), &file.bytes)?;
    }
    say("note", &fitted.notes())?;
    if let Standing::NotFitted(why) = fitted.standing() {
        say("warning: not fitted", &why)?;
    }
    write!(io::stdout(), "{environment}")?;
    Ok(Exit::Done)
}

/// Lines on standard error.
fn say(what: &str, lines: &[String]) -> io::Result<()> {
    lines.iter().try_for_each(|line| writeln!(io::stderr(), "{what}: {line}"))
}

/// Reads the model and the data; `None` if it was stopped.
fn pilot(arguments: &Arguments, stop: &AtomicBool) -> Result<Option<Pilot>, Error> {
    let unreadable = |path: &Path| {
        let what = format!("read `{}`", path.display());
        move |source| Error::Io { what, source }
    };
    let text = fs::read_to_string(&arguments.model).map_err(unreadable(&arguments.model))?;
    let data = File::open(&arguments.data).map_err(unreadable(&arguments.data))?;
    let [model, name] = [&arguments.model, &arguments.data].map(|path| path.display().to_string());
    match read((&model, &text), (&name, data), stop) {
        Ok(pilot) => Ok(Some(pilot)),
        Err(NoPilot::Stopped) => Ok(None),
        Err(NoPilot::Model(faults)) => Err(Error::Manifests(vec![faults])),
        Err(NoPilot::Data(says)) => Err(Error::Usage(says)),
    }
}
