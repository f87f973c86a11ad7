//! Saves and restores the state of Adam.

use std::io;

use crate::kernel::Adam;
use crate::state::{Resumable, StateError, StateReader, StateWriter};

impl Resumable for Adam {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        let (moments, powers) = self.state();
        moments.into_iter().try_for_each(|moments| out.many(moments))?;
        powers.into_iter().try_for_each(|powers| out.many(&powers))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let (moments, powers) = self.state_mut();
        moments.into_iter().try_for_each(|moments| from.fill(moments, "moments"))?;
        powers.into_iter().try_for_each(|powers| from.fill(powers, "powers of beta"))
    }
}
