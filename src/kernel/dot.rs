//! Scalar products of rows.

use pulp::{Simd, WithSimd};

use crate::kernel::Isa;

/// The number of virtual lanes of a sum; rows are padded to a multiple of it.
pub const LANES: usize = 16;

/// out\[i, j\] = start\[j\] + Σ_p left\[i, p\] right\[j, p\].
///
/// Virtual lane p mod 16 accumulates term p by fused multiply-adds. The lanes are then added by halves (8 and
/// 8, 4 and 4, …), and the start is added last.
///
/// **Shapes**: `left` is \[rows, terms\], `right` is \[columns, terms\], `start` is \[columns\], `out` is
/// \[rows, columns\], all row-major; `terms` is a multiple of [`LANES`].
pub fn dot(isa: Isa, left: &[f32], right: &[f32], terms: usize, start: &[f32], out: &mut [f32]) {
    assert!(terms > 0 && terms.is_multiple_of(LANES), "rows are padded");
    assert_eq!(right.len(), start.len() * terms, "a row of `right` for each start");
    assert_eq!(out.len() * terms, left.len() * start.len(), "a row of `out` for each of `left`");
    isa.run(Operation { left, right, terms, start, out });
}

struct Operation<'a> {
    left: &'a [f32],
    right: &'a [f32],
    terms: usize,
    start: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Operation<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F32_LANES {
            16 => self.blocks::<S, 1, 4>(simd),
            8 => self.blocks::<S, 2, 1>(simd),
            4 => self.blocks::<S, 4, 1>(simd),
            _ => self.blocks::<S, 16, 1>(simd),
        }
    }
}

impl Operation<'_> {
    /// All rows, I at a time; V registers hold the virtual lanes.
    #[inline(always)]
    fn blocks<S: Simd, const V: usize, const I: usize>(self, simd: S) {
        let Operation { left, right, terms, start, out } = self;
        let columns = start.len();
        let rows = left.len() / terms;
        let mut row = 0;
        while row < rows {
            let take = if row + I <= rows { I } else { 1 };
            let left = &left[row * terms..(row + take) * terms];
            let out = &mut out[row * columns..(row + take) * columns];
            let mut column = 0;
            while column < columns {
                let many = if column + 4 <= columns { 4 } else { 1 };
                let right = &right[column * terms..(column + many) * terms];
                let start = &start[column..column + many];
                let out = &mut out[column..];
                match (take == I, many) {
                    (true, 4) => tile::<S, V, I, 4>(simd, left, right, start, columns, out),
                    (true, _) => tile::<S, V, I, 1>(simd, left, right, start, columns, out),
                    (false, 4) => tile::<S, V, 1, 4>(simd, left, right, start, columns, out),
                    (false, _) => tile::<S, V, 1, 1>(simd, left, right, start, columns, out),
                }
                column += many;
            }
            row += take;
        }
    }
}

/// I rows by J columns. There are no closures here: they would make the compiler spill the sums to the stack.
#[inline(always)]
#[allow(clippy::needless_range_loop, clippy::manual_memcpy)]
fn tile<S: Simd, const V: usize, const I: usize, const J: usize>(
    simd: S,
    left: &[f32],
    right: &[f32],
    start: &[f32],
    columns: usize,
    out: &mut [f32],
) {
    let terms = right.len() / J;
    let mut sums = [[[simd.splat_f32s(0.0); V]; J]; I];
    for (block, _) in left[..terms].chunks_exact(LANES).enumerate() {
        let at = block * LANES;
        for j in 0..J {
            let (right, _) = S::as_simd_f32s(&right[j * terms + at..j * terms + at + LANES]);
            for i in 0..I {
                let (left, _) = S::as_simd_f32s(&left[i * terms + at..i * terms + at + LANES]);
                for v in 0..V {
                    sums[i][j][v] = simd.mul_add_f32s(left[v], right[v], sums[i][j][v]);
                }
            }
        }
    }
    // Stores all sums first and adds them up in a second loop. A single loop would not be unrolled, and the
    // compiler would keep the sums on the stack throughout.
    let mut lanes = [[[0.0; LANES]; J]; I];
    for i in 0..I {
        for j in 0..J {
            let (registers, _) = S::as_mut_simd_f32s(&mut lanes[i][j]);
            for v in 0..V {
                registers[v] = sums[i][j][v];
            }
        }
    }
    for i in 0..I {
        for j in 0..J {
            out[i * columns + j] = by_halves(lanes[i][j]) + start[j];
        }
    }
}

/// The sum of the virtual lanes.
#[inline(always)]
fn by_halves(mut lanes: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
        half /= 2;
    }
    lanes[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::test_numbers::bits;

    #[test]
    fn sums_go_over_sixteen_lanes_and_by_halves_on_every_instruction_set() {
        for (rows, columns, terms) in [(1, 1, 16), (3, 4, 32), (9, 5, 128), (4, 6, 48)] {
            let number = |i: usize| ((i * 7919) % 1009) as f32 / 504.5 - 1.0;
            let left: Vec<f32> = (0..rows * terms).map(number).collect();
            let right: Vec<f32> = (0..columns * terms).map(|i| number(i + 5)).collect();
            let start: Vec<f32> = (0..columns).map(|i| number(i + 11)).collect();
            let mut plain = Vec::new();
            for i in 0..rows {
                for j in 0..columns {
                    let mut lanes = [0.0f32; LANES];
                    for p in 0..terms {
                        lanes[p % LANES] =
                            left[i * terms + p].mul_add(right[j * terms + p], lanes[p % LANES]);
                    }
                    for half in [8, 4, 2, 1] {
                        (0..half).for_each(|lane| lanes[lane] += lanes[lane + half]);
                    }
                    plain.push(lanes[0] + start[j]);
                }
            }
            for isa in Isa::available() {
                let mut ours = vec![0.0; rows * columns];
                dot(isa, &left, &right, terms, &start, &mut ours);
                assert_eq!(bits(&ours), bits(&plain), "{} {rows} {columns} {terms}", isa.name());
            }
        }
    }
}
