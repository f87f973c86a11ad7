//! `jitai fit`: the coefficients of a model's people, from a pilot.

use std::fs::{self, File};
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::cli::counting::Counting;
use crate::cli::{Error, Exit, folder, signals};
use crate::env::declared::{EffectSource, Pilot, PilotError};
use crate::fit::{Check, DrawnFrom, Fit, Fitting, Standing, draws, files, notes, page};
use crate::key::quoted;
use crate::text::Source;

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
    if arguments.bootstrap && pilot.pooled {
        let says = "--bootstrap draws people, and with `pooled = true` all people are the same";
        return Err(Error::Usage(says.to_owned()));
    }
    let fitted = counted("fits done", &stop, |fitting| Fit::new(&pilot, fitting));
    let Some(fitted) = fitted else { return Ok(Exit::Interrupted) };
    if !pilot.draws.is_empty() && fitted.is_complete.iter().all(|complete| !complete) {
        say_notes(&pilot, &fitted)?;
        let says = "nobody has estimates of all coefficients, and no file was written: use fewer features, \
                    `method = \"map\"`, or `pooled = true` in [fit]";
        return Err(Error::Usage(says.to_owned()));
    }
    let simulations = (arguments.seed, arguments.simulations);
    let check = counted("pilots simulated", &stop, |fitting| {
        Check::new(&pilot, &fitted, simulations, fitting)
    });
    let Some(check) = check else { return Ok(Exit::Interrupted) };
    let environment = environment(arguments, &pilot, &fitted);
    let mut all = files(&pilot, &fitted);
    let from = if arguments.bootstrap { DrawnFrom::People } else { DrawnFrom::Estimates };
    if let Some(number) = arguments.draws {
        all.extend(draws(&pilot, &fitted, number, from, arguments.seed));
    }
    all.extend(page(&pilot, &fitted, &check, &environment));
    folder::make(&arguments.out)?;
    for file in all {
        file.write(&arguments.out).map_err(|source| Error::Io {
            what: format!("write `{}`", arguments.out.join(&file.name).display()),
            source,
        })?;
    }
    say_notes(&pilot, &fitted)?;
    if let Standing::NotFitted(why) = Standing::of(&pilot, &fitted, &check) {
        why.iter().try_for_each(|why| writeln!(io::stderr(), "warning: not fitted: {why}"))?;
    }
    write!(io::stdout(), "{environment}")?;
    Ok(Exit::Done)
}

/// Runs a part of the work and shows its progress.
fn counted<T>(what: &'static str, stop: &AtomicBool, run: impl FnOnce(&mut Fitting<'_>) -> T) -> T {
    let mut counting: Option<Counting> = None;
    let mut progress =
        |done, of| counting.get_or_insert_with(|| Counting::new(of, what)).advance(done, of);
    run(&mut Fitting { stop, progress: &mut progress })
}

/// Reads the model and the data; `None` if it was stopped.
fn pilot(arguments: &Arguments, stop: &AtomicBool) -> Result<Option<Pilot>, Error> {
    let unreadable = |path: &Path| {
        let what = format!("read `{}`", path.display());
        move |source| Error::Io { what, source }
    };
    let text = fs::read_to_string(&arguments.model).map_err(unreadable(&arguments.model))?;
    let text = text.trim_start_matches('\u{feff}').replace("\r\n", "\n");
    let data = File::open(&arguments.data).map_err(unreadable(&arguments.data))?;
    let should_stop = || stop.load(Ordering::Relaxed);
    match Pilot::read(&text, BufReader::with_capacity(1 << 20, data), &should_stop) {
        Ok(pilot) => Ok(Some(pilot)),
        Err(PilotError::Stopped) => Ok(None),
        Err(PilotError::Model(faults)) => {
            let name = arguments.model.display().to_string();
            Err(Error::Manifests(vec![faults.of(&name, Source::new(&text))]))
        }
        Err(PilotError::Data(faults)) => {
            Err(Error::Usage(faults.text(&arguments.data.display().to_string())))
        }
    }
}

/// What was read, and what the data do not say, on standard error.
fn say_notes(pilot: &Pilot, fitted: &Fit) -> Result<(), Error> {
    let mut out = io::stderr().lock();
    for note in &pilot.notes {
        writeln!(out, "note: {note}")?;
    }
    for draw in &pilot.draws {
        let [value, features] = draw.without;
        let rows = draw.decisions.len();
        writeln!(
            out,
            "note: {}: {rows} rows used; {value} without a value and {features} without a feature left out",
            draw.name
        )?;
    }
    for (draw, says, people) in notes(pilot, fitted) {
        let few: Vec<&str> = people.iter().take(5).map(String::as_str).collect();
        let more = match people.len().saturating_sub(few.len()) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        writeln!(out, "note: {draw}: {says}: {}{more}", few.join(", "))?;
    }
    if pilot.effect != EffectSource::Fitted {
        let names: Vec<&str> = pilot.imputed.iter().map(|one| one.name.as_str()).collect();
        writeln!(out, "note: imputed, not estimated: {}", names.join(", "))?;
    }
    Ok(())
}

/// The section of a manifest that simulates the people.
fn environment(arguments: &Arguments, pilot: &Pilot, fitted: &Fit) -> String {
    let path = |path: &Path| quoted(&path.display().to_string());
    let mut text =
        format!("[environment]\nfamily = \"declared\"\nmodel = {}\n", path(&arguments.model));
    if !pilot.columns.is_empty() {
        text += &format!("people = {}\n", path(&arguments.out.join("people.csv")));
    }
    if !pilot.replayed().is_empty() {
        text += &format!("replay = {}\n", path(&arguments.out.join("residuals.csv")));
    }
    if !fitted.parameters.is_empty() {
        let all = fitted.parameters.iter().map(|(name, value)| format!("{name} = {value:?}"));
        text += &format!("parameters = {{ {} }}\n", all.collect::<Vec<_>>().join(", "));
    }
    text
}
