//! A fit from beginning to end: estimates, their check, and the files of a folder.

use std::io::Read;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::env::declared::{EffectSource, FittedDraw, Pilot, PilotError};
use crate::fit::check::Check;
use crate::fit::draws::{DrawnFrom, draws};
use crate::fit::estimate::{Fit, Fitting};
use crate::fit::output::{files, filled_rows, notes};
use crate::fit::page::{Standing, page};
use crate::key::quoted;
use crate::report::{PlainPage, ReportFile, plain_page};
use crate::text::{Faults, Source};

/// Why a pilot cannot be read.
#[derive(Debug)]
pub enum NoPilot {
    /// It was stopped.
    Stopped,
    /// The model has faults.
    Model(Faults),
    /// The data have faults; all of them, with their lines.
    Data(String),
}

/// Reads a model with a section `[fit]`, and the decisions of its pilot from CSV. Each comes with its name for messages.
///
/// **Errors**: [`NoPilot`].
pub fn read(
    (name, text): (&str, &str),
    (data_name, data): (&str, impl Read),
    stop: &AtomicBool,
) -> Result<Pilot, NoPilot> {
    let text = text.trim_start_matches('\u{feff}').replace("\r\n", "\n");
    let pilot = Pilot::read(&text, data, &|| stop.load(Ordering::Relaxed));
    pilot.map_err(|why| match why {
        PilotError::Stopped => NoPilot::Stopped,
        PilotError::Model(faults) => NoPilot::Model(faults.of(name, Source::new(&text))),
        PilotError::Data(faults) => NoPilot::Data(faults.text(data_name)),
    })
}

/// What a fit does besides its estimates.
#[derive(Clone, Copy, Debug)]
pub struct FitRequest {
    /// The number of simulated pilots with which the data are compared.
    pub simulations: u32,
    /// The number of files of drawn people.
    pub draws: u32,
    /// Where drawn people come from.
    pub from: DrawnFrom,
    /// The seed of simulated pilots and of drawn people.
    pub seed: u64,
}

/// A pilot with its fit, and how they compare.
#[derive(Debug)]
pub struct Fitted {
    /// The pilot.
    pub pilot: Pilot,
    /// Its people.
    pub fit: Fit,
    /// The model against its data.
    pub check: Check,
    request: FitRequest,
}

/// Why there is no fit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoFit {
    /// It was stopped.
    Stopped,
    /// People of a pooled fit are all the same, and cannot be drawn.
    Alike,
    /// Nobody has estimates of all coefficients; what the data do not say.
    Nobody(Vec<String>),
}

impl std::fmt::Display for NoFit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            NoFit::Stopped => "stopped",
            NoFit::Alike => {
                "a bootstrap draws people, and with `pooled = true` all people are the same"
            }
            NoFit::Nobody(_) => {
                "nobody has estimates of all coefficients, and no file was written: use fewer features, `method = \"map\"`, \
                 or `pooled = true` in [fit]"
            }
        })
    }
}

impl Fitted {
    /// Fits a pilot, and simulates it with the people of the fit. `progress` receives what is done, how many, and of how many.
    ///
    /// **Errors**: [`NoFit`].
    pub fn new(
        pilot: Pilot,
        request: FitRequest,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(&'static str, usize, usize),
    ) -> Result<Fitted, NoFit> {
        if request.draws > 0 && request.from == DrawnFrom::People && pilot.pooled {
            return Err(NoFit::Alike);
        }
        let mut fits = |done, of| progress("fits done", done, of);
        let fit = Fit::new(&pilot, &mut Fitting { stop, progress: &mut fits });
        let fit = fit.ok_or(NoFit::Stopped)?;
        if !pilot.draws.is_empty() && fit.is_complete.iter().all(|complete| !complete) {
            return Err(NoFit::Nobody(said(&pilot, &fit)));
        }
        let mut simulated = |done, of| progress("pilots simulated", done, of);
        let fitting = &mut Fitting { stop, progress: &mut simulated };
        let check = Check::new(&pilot, &fit, (request.seed, request.simulations), fitting);
        let check = check.ok_or(NoFit::Stopped)?;
        Ok(Fitted { pilot, fit, check, request })
    }

    /// Whether the model may be called fitted.
    pub fn standing(&self) -> Standing {
        Standing::of(&self.pilot, &self.fit, &self.check)
    }

    /// What was read, and what the data do not say.
    pub fn notes(&self) -> Vec<String> {
        said(&self.pilot, &self.fit)
    }

    /// The section of a manifest that simulates these people, as TOML: with this path of the model, and the files of a fit by
    /// their names.
    pub fn environment(&self, model: &str, path: impl Fn(&str) -> String) -> String {
        let mut text = format!("[environment]\nfamily = \"declared\"\nmodel = {}\n", quoted(model));
        if !self.pilot.columns.is_empty() {
            text += &format!("people = {}\n", quoted(&path("people.csv")));
        }
        if !self.pilot.replayed().is_empty() {
            text += &format!("replay = {}\n", quoted(&path("residuals.csv")));
        }
        if !self.fit.parameters.is_empty() {
            let all = self.fit.parameters.iter().map(|(name, value)| format!("{name} = {value:?}"));
            text += &format!("parameters = {{ {} }}\n", all.collect::<Vec<_>>().join(", "));
        }
        text
    }

    /// The page, with this section of a manifest.
    pub fn page(&self, environment: &str) -> PlainPage {
        page(&self.pilot, &self.fit, &self.check, environment)
    }

    /// All files, in the order in which they are written.
    pub fn files(&self, environment: &str) -> Vec<ReportFile> {
        let FitRequest { draws: number, from, seed, .. } = self.request;
        let mut all = files(&self.pilot, &self.fit);
        all.extend(draws(&self.pilot, &self.fit, number, from, seed));
        all.extend(plain_page(&self.page(environment)));
        all
    }
}

/// What was read, and what the data do not say.
fn said(pilot: &Pilot, fit: &Fit) -> Vec<String> {
    let mut all = pilot.notes.clone();
    all.extend(pilot.draws.iter().map(FittedDraw::counts));
    all.extend(notes(pilot, fit).into_iter().map(|(draw, says, people)| {
        let few: Vec<&str> = people.iter().take(5).map(String::as_str).collect();
        let more = match people.len().saturating_sub(few.len()) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        format!("{draw}: {says}: {}{more}", few.join(", "))
    }));
    if !pilot.replayed().is_empty() {
        let filled = filled_rows(pilot, fit);
        if filled > 0 {
            all.push(format!(
                "{filled} rows of residuals.csv have something of the same decision of another day, where a row or a number is missing"
            ));
        }
    }
    if pilot.effect != EffectSource::Fitted {
        let names: Vec<&str> = pilot.imputed.iter().map(|one| one.name.as_str()).collect();
        all.push(format!("imputed, not estimated: {}", names.join(", ")));
    }
    all
}
