//! Reads decisions in the terms of a model.

use std::io::Read;

use crate::env::declared::pilot::assembly::Assembly;
use crate::env::declared::pilot::calendar::Calendar;
use crate::env::declared::pilot::plan::FitPlan;
use crate::env::declared::pilot::sources::Sources;
use crate::env::declared::pilot::terms::{Pilot, PilotError};
use crate::env::declared::pilot::{file, section};
use crate::env::declared::read;
use crate::text::FaultList;

impl Pilot {
    /// Reads a model with `[fit]` and its data. `stop` is asked now and then.
    ///
    /// **Errors**: every fault of the model, or else every fault of the data.
    pub fn read(text: &str, data: impl Read, stop: &dyn Fn() -> bool) -> Result<Pilot, PilotError> {
        let (model, section) = match (read::read(text), section::read(text)) {
            (Ok(model), Ok(section)) => (model, section),
            (Err(mut faults), section) => {
                section.err().into_iter().for_each(|more| faults.append(more));
                return Err(PilotError::Model(faults));
            }
            (_, Err(faults)) => return Err(PilotError::Model(faults)),
        };
        let mut reader = file::reader(data);
        let header = file::header(&mut reader).map_err(PilotError::Data)?;
        let mut faults = FaultList::default();
        let sources = Sources::new(&model, &section, &header, &mut faults);
        let plan = FitPlan::new(&model, &section, &sources, &mut faults);
        if !faults.is_empty() {
            return Err(header.lacks_names().map_or(PilotError::Model(faults), PilotError::Data));
        }
        let person = sources.person.unwrap_or(0);
        let used = sources.columns();
        let table =
            file::rows(&mut reader, header, person, &used, stop).map_err(PilotError::Data)?;
        if stop() {
            return Err(PilotError::Stopped);
        }
        let calendar = Calendar::new(&table, &sources.order, model.decisions_per_day);
        let calendar = calendar.map_err(PilotError::Data)?;
        let mut assembly = Assembly::new(&model, &section, &sources, plan, &table, calendar);
        let pilot = assembly.pilot();
        if stop() {
            return Err(PilotError::Stopped);
        }
        if assembly.faults.is_empty() { Ok(pilot) } else { Err(PilotError::Data(assembly.faults)) }
    }
}
