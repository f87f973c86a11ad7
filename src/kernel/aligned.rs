//! Arrays that start on a cache line.

use std::ops::{Deref, DerefMut};

/// The size in bytes of a cache line and of the widest register.
pub const LINE: usize = 64;

/// An array of f32 aligned to a cache line, so that no register load crosses a line.
#[derive(Debug)]
pub struct Aligned {
    values: Vec<f32>,
    start: usize,
    len: usize,
}

impl Aligned {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let values = vec![0.0; len + LINE / size_of::<f32>()];
        let start = values.as_ptr().align_offset(LINE).min(values.len() - len);
        Aligned { values, start, len }
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        let mut copy = Aligned::zeros(self.len);
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for Aligned {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.values[self.start..self.start + self.len]
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values[self.start..self.start + self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_start_a_cache_line_and_keep_their_values_when_cloned() {
        for len in [0, 1, 16, 1000] {
            let mut array = Aligned::zeros(len);
            assert_eq!(array.len(), len);
            array.iter_mut().enumerate().for_each(|(i, v)| *v = i as f32);
            let copy = array.clone();
            assert_eq!(copy[..], array[..]);
            assert_eq!(copy.as_ptr() as usize % LINE, 0);
        }
    }
}
