//! Fallible allocation of memory.
//!
//! In: an amount and its purpose. Out: reserved memory, or [`OutOfMemory`], which fails one job.
//! Any other failed allocation ends the process. The network of a job and all data that grow during
//! training are therefore reserved here first. An amount that exceeds the limit of a control group is
//! refused, because the kernel would kill the process as soon as it used the memory.

use super::control_group;

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
    permit(size_in_bytes(values, more), what)?;
    values.try_reserve(more).map_err(|_| out_of(values, more, what))
}

/// Reserves room for exactly `more` values.
pub fn reserve_exact<T>(
    values: &mut Vec<T>,
    more: usize,
    what: &'static str,
) -> Result<(), OutOfMemory> {
    permit(size_in_bytes(values, more), what)?;
    values.try_reserve_exact(more).map_err(|_| out_of(values, more, what))
}

/// Checks that `bytes` bytes can be allocated now, and frees them again. It serves callers that
/// then allocate this amount in pieces and cannot handle the failure of a single piece.
pub(super) fn require(bytes: usize, what: &'static str) -> Result<(), OutOfMemory> {
    reserve_exact(&mut Vec::<u8>::new(), bytes, what)
}

/// Checks that the control groups of the process permit `bytes` bytes.
pub(super) fn permit(bytes: usize, what: &'static str) -> Result<(), OutOfMemory> {
    match control_group::most_bytes() {
        Some(most) if bytes as u64 > most => Err(OutOfMemory { what, bytes }),
        Some(_) | None => Ok(()),
    }
}

fn size_in_bytes<T>(values: &[T], more: usize) -> usize {
    values.len().saturating_add(more).saturating_mul(size_of::<T>())
}

fn out_of<T>(values: &[T], more: usize, what: &'static str) -> OutOfMemory {
    OutOfMemory { what, bytes: size_in_bytes(values, more) }
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
