//! Fallible allocation of memory.
//!
//! In: an amount and its purpose. Out: reserved memory, or [`OutOfMemory`], which fails one job.
//! Any other failed allocation ends the process. The network of a job and all data that grow during
//! training are therefore reserved here first.

/// Memory that a training needs and cannot allocate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("out of memory for {what}, which needs at least {bytes} bytes")]
pub struct OutOfMemory {
    /// What the memory is for.
    pub what: &'static str,
    /// Bytes needed in total, including those already allocated.
    pub bytes: usize,
}

/// Reserves room for `more` values. A vector that has to grow at least doubles its capacity.
pub fn reserve<T>(values: &mut Vec<T>, more: usize, what: &'static str) -> Result<(), OutOfMemory> {
    values.try_reserve(more).map_err(|_| out_of(values, more, what))
}

/// Reserves room for exactly `more` values.
pub fn reserve_exact<T>(
    values: &mut Vec<T>,
    more: usize,
    what: &'static str,
) -> Result<(), OutOfMemory> {
    values.try_reserve_exact(more).map_err(|_| out_of(values, more, what))
}

/// Checks that `bytes` bytes can be allocated now, and frees them again. It serves callers that
/// then allocate this amount in pieces and cannot handle the failure of a single piece.
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
