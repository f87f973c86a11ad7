//! Memory that may not be there, asked for so that the answer can be no.
//!
//! In: how much more is wanted, and for what. Out: room for it, or [`OutOfMemory`], with which one
//! job fails. What is asked for in any other way ends the process when there is none; so what grows
//! while a job trains, and its network, is asked for here first.

/// Memory that a training needs and that is not there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no memory for {what}: it needs at least {bytes} bytes")]
pub struct OutOfMemory {
    /// What it is for.
    pub what: &'static str,
    /// Bytes that this would take, with what it has.
    pub bytes: usize,
}

/// Room for so many more values, and for twice as many as there are if it has to grow.
pub fn reserve<T>(values: &mut Vec<T>, more: usize, what: &'static str) -> Result<(), OutOfMemory> {
    values.try_reserve(more).map_err(|_| out_of(values, more, what))
}

/// Room for so many more values.
pub fn reserve_exact<T>(
    values: &mut Vec<T>,
    more: usize,
    what: &'static str,
) -> Result<(), OutOfMemory> {
    values.try_reserve_exact(more).map_err(|_| out_of(values, more, what))
}

/// Fails unless so many bytes could be had now. They are given back: it is for whoever asks for
/// them soon, in pieces, and could not go on without one.
pub(super) fn require(bytes: usize, what: &'static str) -> Result<(), OutOfMemory> {
    reserve_exact(&mut Vec::<u8>::new(), bytes, what)
}

fn out_of<T>(values: &[T], more: usize, what: &'static str) -> OutOfMemory {
    OutOfMemory { what, bytes: values.len().saturating_add(more).saturating_mul(size_of::<T>()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_any_machine_has_is_refused_and_said() {
        let mut values = vec![1_u32];
        let refused = reserve(&mut values, usize::MAX / 8, "points").unwrap_err();
        assert_eq!(refused, OutOfMemory { what: "points", bytes: (usize::MAX / 8 + 1) * 4 });
        assert_eq!(values, [1]);
        assert!(require(usize::MAX / 4, "a network").is_err());
        assert_eq!(require(1 << 20, "a network"), Ok(()));
    }
}
