//! The state of learners, actors and environments as bytes, from which another process can resume.
//!
//! In: numbers, or their bytes. Out: the bytes, or the numbers. A [`Resumable`] is determined, to the bit,
//! by its parameters and the state that it writes here. Numbers are little-endian; sequences begin with
//! their length. The module uses no files and no checksums. Bytes from other code are rejected if
//! they do not fit, and have no defined meaning if they do.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Read, Write};
use std::ops::Range;

use crate::rng::Stream;

/// Size in bytes of the buffer for conversion.
const CHUNK: usize = 16 * 1024;
/// Maximum count of numbers that are written without a buffer.
const FEW: usize = 64;
/// Width in bytes of the widest number.
const WIDEST: usize = 8;

/// A value whose state can be saved and restored.
pub trait Resumable {
    /// Writes the complete state, except parameters.
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()>;

    /// Restores the state that a value with equal parameters saved.
    ///
    /// **Errors**: the state does not fit, or the bytes end early. The value must not be used afterwards.
    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError>;
}

/// Why a state cannot be restored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StateError {
    /// The bytes cannot be read, or end early.
    #[error("failed to read the state: {0}")]
    Read(#[from] io::Error),
    /// A part does not fit the parameters.
    #[error("its {0} do not fit the job")]
    Misfit(&'static str),
}

/// A number of a fixed width.
pub trait Number: Copy + Default {
    /// Writes the number to exactly its width in bytes.
    fn put(self, bytes: &mut [u8]);

    /// Reads a number from exactly its width in bytes.
    fn get(bytes: &[u8]) -> Self;
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Resumable for $number {
            fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
                out.one(*self)
            }

            fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
                *self = from.one()?;
                Ok(())
            }
        }

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

impl Resumable for bool {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(u8::from(*self))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        *self = from.one::<u8>()? != 0;
        Ok(())
    }
}

impl Resumable for usize {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(*self as u64)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let misfit = |_| StateError::Misfit("counts");
        *self = usize::try_from(from.one::<u64>()?).map_err(misfit)?;
        Ok(())
    }
}

macro_rules! collections {
    ($($collection:ty),*) => {$(
        /// Any number of values; restoring replaces them.
        impl<T: Resumable + Default> Resumable for $collection {
            fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
                out.one(self.len() as u64)?;
                self.iter().try_for_each(|value| value.save(out))
            }

            fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
                let count = from.count(usize::MAX, "values")?;
                let values = (0..count).map(|_| {
                    let mut value = T::default();
                    value.restore(from)?;
                    Ok(value)
                });
                *self = values.collect::<Result<_, StateError>>()?;
                Ok(())
            }
        }
    )*};
}

collections!(Vec<T>, VecDeque<T>, Box<[T]>);

macro_rules! arrays {
    ([$($generics:tt)*] $array:ty) => {
        /// A number of values that the parameters determine; restoring sets each.
        impl<$($generics)*> Resumable for $array {
            fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
                out.each(self.iter(), |out, value| value.save(out))
            }

            fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
                if from.one::<u64>()? != self.len() as u64 {
                    return Err(StateError::Misfit("counts"));
                }
                self.iter_mut().try_for_each(|value| value.restore(from))
            }
        }
    };
}

arrays!([T: Resumable] [T]);
arrays!([T: Resumable, const N: usize] [T; N]);

impl<T: Resumable + Default> Resumable for Option<T> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        self.is_some().save(out)?;
        self.iter().try_for_each(|value| value.save(out))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let mut is_some = false;
        is_some.restore(from)?;
        *self = is_some.then(T::default);
        self.iter_mut().try_for_each(|value| value.restore(from))
    }
}

/// Implements [`Resumable`] for a type by a list of its fields, which are saved and restored in this order.
///
/// Fields stand in groups: `parts` are [`Resumable`] themselves; `each` are collections whose items are [`Resumable`],
/// and whose lengths the parameters determine; `fixed` are arrays of numbers whose lengths the parameters determine;
/// `grown` are vectors of numbers of any length. Between groups, `then` names a method that completes the restored
/// part, and `check` names a method that returns whether its parts fit each other, and what does not fit otherwise.
///
/// ```text
/// resumable!([E: Engine] Agent<E> { parts engine, updates; fixed totals; grown rewards; check fits, "rewards" });
/// ```
macro_rules! resumable {
    ([$($generics:tt)*] $type:ty { $($kind:ident $($($field:tt).+),+);* }) => {
        #[allow(unused_imports, unused_variables)]
        impl<$($generics)*> $crate::state::Resumable for $type {
            fn save(&self, out: &mut $crate::state::StateWriter<'_>) -> std::io::Result<()> {
                use $crate::state::Resumable;
                $($crate::state::resumable!(@save $kind self out $($($field).+),+);)*
                Ok(())
            }

            fn restore(
                &mut self,
                from: &mut $crate::state::StateReader<'_>,
            ) -> Result<(), $crate::state::StateError> {
                use $crate::state::Resumable;
                $($crate::state::resumable!(@restore $kind self from $($($field).+),+);)*
                Ok(())
            }
        }
    };
    (@save parts $self:ident $out:ident $($($field:tt).+),+) => {
        $(Resumable::save(&$self.$($field).+, $out)?;)+
    };
    (@save each $self:ident $out:ident $($($field:tt).+),+) => {
        $(for item in $self.$($field).+.iter() {
            item.save($out)?;
        })+
    };
    (@save fixed $self:ident $out:ident $($($field:tt).+),+) => {
        $($out.many(&$self.$($field).+)?;)+
    };
    (@save grown $self:ident $out:ident $($($field:tt).+),+) => {
        $($out.many(&$self.$($field).+)?;)+
    };
    (@save then $self:ident $out:ident $method:tt) => {};
    (@save check $self:ident $out:ident $method:tt, $what:tt) => {};
    (@restore parts $self:ident $from:ident $($($field:tt).+),+) => {
        $(Resumable::restore(&mut $self.$($field).+, $from)?;)+
    };
    (@restore each $self:ident $from:ident $($($field:tt).+),+) => {
        $(for item in $self.$($field).+.iter_mut() {
            item.restore($from)?;
        })+
    };
    (@restore fixed $self:ident $from:ident $($($field:tt).+),+) => {
        $($from.fill(&mut $self.$($field).+, stringify!($($field).+))?;)+
    };
    (@restore grown $self:ident $from:ident $($($field:tt).+),+) => {
        $($self.$($field).+ = $from.many(usize::MAX, stringify!($($field).+))?;)+
    };
    (@restore then $self:ident $from:ident $method:tt) => {
        $self.$method();
    };
    (@restore check $self:ident $from:ident $method:tt, $what:tt) => {
        if !$self.$method() {
            return Err($crate::state::StateError::Misfit($what));
        }
    };
}

pub(crate) use resumable;

impl<K: Resumable + Default + Ord, V: Resumable + Default> Resumable for BTreeMap<K, V> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.each(self.iter(), |out, (key, value)| {
            key.save(out)?;
            value.save(out)
        })
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let mut pairs = Vec::<(K, V)>::new();
        pairs.restore(from)?;
        *self = pairs.into_iter().collect();
        Ok(())
    }
}

resumable!([T: Resumable] Range<T> { parts start, end });
resumable!([K: Resumable, V: Resumable] (K, V) { parts 0, 1 });

/// Writes a state.
pub struct StateWriter<'a>(&'a mut dyn Write);

impl<'a> StateWriter<'a> {
    /// A writer that writes to `out` in blocks of up to 16 KiB.
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

    /// Writes the count of numbers, then the numbers.
    pub fn many<T: Number>(&mut self, numbers: &[T]) -> io::Result<()> {
        self.one(numbers.len() as u64)?;
        self.put(numbers)
    }

    /// Writes the count of items, then each item with `write`.
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
            let slots = buffer.chunks_exact_mut(size_of::<T>());
            slots.zip(some).for_each(|(slot, number)| number.put(slot));
            self.0.write_all(&buffer[..size_of_val(some)])?;
        }
        Ok(())
    }
}

/// Reads a state.
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

    /// Fills `slots`; the stored count must be equal to their number.
    pub fn fill<T: Number>(
        &mut self,
        slots: &mut [T],
        what: &'static str,
    ) -> Result<(), StateError> {
        if self.one::<u64>()? != slots.len() as u64 {
            return Err(StateError::Misfit(what));
        }
        self.get(slots)
    }

    /// Reads at most `most` numbers.
    pub fn many<T: Number>(
        &mut self,
        most: usize,
        what: &'static str,
    ) -> Result<Vec<T>, StateError> {
        let count = self.count(most, what)?;
        let mut numbers = Vec::new();
        while numbers.len() < count {
            // Allocates in pieces as bytes arrive, because a corrupt count could be huge.
            let had = numbers.len();
            let some = (count - had).min((CHUNK / size_of::<T>()).max(had));
            numbers.try_reserve_exact(some).map_err(io::Error::from)?;
            numbers.resize(had + some, T::default());
            self.get(&mut numbers[had..])?;
        }
        Ok(numbers)
    }

    /// Reads at most `most` items.
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

    fn get<T: Number>(&mut self, slots: &mut [T]) -> Result<(), StateError> {
        if slots.len() <= FEW {
            for slot in slots {
                *slot = self.one()?;
            }
            return Ok(());
        }
        let mut buffer = [0; CHUNK];
        for some in slots.chunks_mut(CHUNK / size_of::<T>()) {
            let bytes = &mut buffer[..size_of_val(some)];
            self.0.read_exact(bytes)?;
            let numbers = bytes.chunks_exact(size_of::<T>());
            some.iter_mut().zip(numbers).for_each(|(slot, bytes)| *slot = T::get(bytes));
        }
        Ok(())
    }
}

impl Resumable for Stream {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.position())?;
        out.one(self.participants())
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.go_to(from.one()?);
        self.go_to_participant(from.one()?);
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
