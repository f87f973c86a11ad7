//! The state of learners, actors and environments as bytes, so that another process can go on.
//!
//! In: numbers, or the bytes that they were written as. Out: the other of the two. Whatever a
//! [`Resumable`] does next depends on its parameters and on what it writes here, to the bit. Numbers
//! are little-endian, sequences begin with their length. It knows no file and no checksum: bytes
//! that were not written by the same code are refused where they do not fit, and may else mean
//! anything.

use std::io::{self, Read, Write};

use crate::rng::Stream;

/// Bytes that are converted at a time.
const CHUNK: usize = 16 * 1024;
/// Numbers for which a buffer does not pay.
const FEW: usize = 64;
/// Bytes of the widest number.
const WIDEST: usize = 8;

/// Something whose state can be saved and restored.
pub trait Resumable {
    /// Writes everything that what comes next depends on, parameters aside.
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()>;

    /// Takes over what one with the same parameters has written.
    ///
    /// **Errors**: it was another, or the bytes end early; this one is then of no further use.
    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError>;
}

/// Why a state cannot be taken over.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateError {
    /// The bytes cannot be read, or there are too few.
    #[error("read the state: {0}")]
    Read(#[from] io::Error),
    /// Something is not as the parameters ask for.
    #[error("its {0} do not fit the job")]
    Misfit(&'static str),
}

/// A number of a fixed width.
pub trait Number: Copy + Default {
    /// Writes it into as many bytes as it takes.
    fn put(self, bytes: &mut [u8]);

    /// Reads it from as many.
    fn get(bytes: &[u8]) -> Self;
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Number for $number {
            fn put(self, bytes: &mut [u8]) {
                bytes.copy_from_slice(&self.to_le_bytes());
            }

            fn get(bytes: &[u8]) -> Self {
                let mut own = [0; size_of::<Self>()];
                own.copy_from_slice(bytes);
                Self::from_le_bytes(own)
            }
        }
    )*};
}

numbers!(u8, u16, u32, u64, f32, f64);

/// Where a state is written to.
pub struct StateWriter<'a>(&'a mut dyn Write);

impl<'a> StateWriter<'a> {
    /// A writer to `out`, which it writes to in pieces of up to 16 KiB.
    pub fn new(out: &'a mut dyn Write) -> Self {
        StateWriter(out)
    }

    /// Writes a number.
    pub fn one<T: Number>(&mut self, number: T) -> io::Result<()> {
        let mut bytes = [0; WIDEST];
        let bytes = &mut bytes[..size_of::<T>()];
        number.put(bytes);
        self.0.write_all(bytes)
    }

    /// Writes numbers, their count first.
    pub fn many<T: Number>(&mut self, numbers: &[T]) -> io::Result<()> {
        self.one(numbers.len() as u64)?;
        self.put(numbers)
    }

    /// Writes one row of numbers an item, the count of items first.
    pub fn each<T>(
        &mut self,
        items: impl ExactSizeIterator<Item = T>,
        mut write: impl FnMut(&mut Self, T) -> io::Result<()>,
    ) -> io::Result<()> {
        self.one(items.len() as u64)?;
        for item in items {
            write(self, item)?;
        }
        Ok(())
    }

    fn put<T: Number>(&mut self, numbers: &[T]) -> io::Result<()> {
        if numbers.len() <= FEW {
            return numbers.iter().try_for_each(|number| self.one(*number));
        }
        let mut buffer = [0; CHUNK];
        for some in numbers.chunks(CHUNK / size_of::<T>()) {
            let places = buffer.chunks_exact_mut(size_of::<T>());
            places.zip(some).for_each(|(place, number)| number.put(place));
            self.0.write_all(&buffer[..size_of_val(some)])?;
        }
        Ok(())
    }
}

/// Where a state is read from.
pub struct StateReader<'a>(&'a mut dyn Read);

impl<'a> StateReader<'a> {
    /// A reader of `from`.
    pub fn new(from: &'a mut dyn Read) -> Self {
        StateReader(from)
    }

    /// Reads a number.
    pub fn one<T: Number>(&mut self) -> Result<T, StateError> {
        let mut bytes = [0; WIDEST];
        let bytes = &mut bytes[..size_of::<T>()];
        self.0.read_exact(bytes)?;
        Ok(T::get(bytes))
    }

    /// Reads as many numbers as there are places, and no fewer may have been written.
    pub fn fill<T: Number>(
        &mut self,
        places: &mut [T],
        what: &'static str,
    ) -> Result<(), StateError> {
        if self.one::<u64>()? != places.len() as u64 {
            return Err(StateError::Misfit(what));
        }
        self.get(places)
    }

    /// Reads numbers, at most `most`.
    pub fn many<T: Number>(
        &mut self,
        most: usize,
        what: &'static str,
    ) -> Result<Vec<T>, StateError> {
        let count = self.count(most, what)?;
        let mut numbers = Vec::new();
        while numbers.len() < count {
            // Memory only for what is there, whatever the count says.
            let had = numbers.len();
            let some = (count - had).min((CHUNK / size_of::<T>()).max(had));
            numbers.try_reserve_exact(some).map_err(io::Error::from)?;
            numbers.resize(had + some, T::default());
            self.get(&mut numbers[had..])?;
        }
        Ok(numbers)
    }

    /// Reads items, at most `most`.
    pub fn each<T>(
        &mut self,
        most: usize,
        what: &'static str,
        mut read: impl FnMut(&mut Self) -> Result<T, StateError>,
    ) -> Result<Vec<T>, StateError> {
        let count = self.count(most, what)?;
        (0..count).map(|_| read(self)).collect()
    }

    fn count(&mut self, most: usize, what: &'static str) -> Result<usize, StateError> {
        let count = usize::try_from(self.one::<u64>()?).map_err(|_| StateError::Misfit(what))?;
        if count <= most { Ok(count) } else { Err(StateError::Misfit(what)) }
    }

    fn get<T: Number>(&mut self, places: &mut [T]) -> Result<(), StateError> {
        if places.len() <= FEW {
            for place in places {
                *place = self.one()?;
            }
            return Ok(());
        }
        let mut buffer = [0; CHUNK];
        for some in places.chunks_mut(CHUNK / size_of::<T>()) {
            let bytes = &mut buffer[..size_of_val(some)];
            self.0.read_exact(bytes)?;
            let numbers = bytes.chunks_exact(size_of::<T>());
            some.iter_mut().zip(numbers).for_each(|(place, bytes)| *place = T::get(bytes));
        }
        Ok(())
    }
}

impl Resumable for Stream {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.position())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.go_to(from.one()?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(write: impl FnOnce(&mut StateWriter<'_>) -> io::Result<()>) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&mut StateWriter::new(&mut bytes)).unwrap();
        bytes
    }

    #[test]
    fn numbers_of_every_kind_read_back_bit_by_bit() {
        let reals: Vec<f32> = (0..20_000).map(|i| f32::from_bits(i * 214_013)).collect();
        let wholes: Vec<u16> = (0..20_000).collect();
        let bytes = written(|out| {
            out.one(-0.0f64)?;
            out.many(&reals)?;
            out.many(&wholes)?;
            out.many::<u64>(&[])
        });
        assert_eq!(bytes.len(), 8 + 8 + 80_000 + 8 + 40_000 + 8);
        let mut from = &bytes[..];
        let mut from = StateReader::new(&mut from);
        assert_eq!(from.one::<f64>().unwrap().to_bits(), (-0.0f64).to_bits());
        let read: Vec<f32> = from.many(20_000, "reals").unwrap();
        assert!(read.iter().zip(&reals).all(|(a, b)| a.to_bits() == b.to_bits()));
        let mut read = vec![0u16; 20_000];
        from.fill(&mut read, "wholes").unwrap();
        assert_eq!(read, wholes);
        assert!(from.many::<u64>(0, "nothing").unwrap().is_empty());
        assert!(matches!(from.one::<u8>(), Err(StateError::Read(_))));
    }

    #[test]
    fn counts_that_lie_are_refused_without_the_memory_for_them() {
        let bytes = written(|out| out.one(u64::MAX >> 4));
        let read = |most| StateReader::new(&mut &bytes[..]).many::<f64>(most, "numbers");
        assert!(matches!(read(1000), Err(StateError::Misfit("numbers"))));
        assert!(matches!(read(usize::MAX), Err(StateError::Read(_))));
        let mut two = [0.0f32; 2];
        let three = written(|out| out.many(&[0.0f32; 3]));
        let filled = StateReader::new(&mut &three[..]).fill(&mut two, "numbers");
        assert!(matches!(filled, Err(StateError::Misfit("numbers"))));
    }
}
