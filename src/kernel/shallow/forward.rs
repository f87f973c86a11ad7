//! The outputs: registers hold rows if there are enough rows, and units otherwise.
//!
//! Both ways compute the same sums in the same order: per virtual lane, then by halves.

use pulp::{Simd, WithSimd, bytemuck};

use super::network::{MOST_INPUTS, OUTPUTS, Shallow};
use crate::kernel::{Isa, LANES};

/// The virtual lanes, ordered so that the halves to be added follow each other.
const BY_HALVES: [usize; LANES] = [0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15];
/// How often the virtual lanes can be halved.
const HALVINGS: usize = LANES.ilog2() as usize;

impl Shallow<'_> {
    /// Writes the outputs plus `start`, \[outputs\], to `out`, \[rows, outputs\], row-major.
    pub fn forward(self, isa: Isa, start: &[f32], out: &mut [f32]) {
        self.check();
        assert_eq!(out.len(), self.rows * OUTPUTS, "outputs for every row");
        match self.inputs.len() / self.rows {
            1 => isa.run(Forward::<1> { network: self, start, out }),
            2 => isa.run(Forward::<2> { network: self, start, out }),
            3 => isa.run(Forward::<3> { network: self, start, out }),
            4 => isa.run(Forward::<4> { network: self, start, out }),
            5 => isa.run(Forward::<5> { network: self, start, out }),
            6 => isa.run(Forward::<6> { network: self, start, out }),
            inputs => panic!("{inputs} inputs are more than {MOST_INPUTS}"),
        }
    }
}

/// Writes the outputs plus `start`.
struct Forward<'a, const K: usize> {
    network: Shallow<'a>,
    /// \[outputs\]
    start: &'a [f32],
    /// \[rows, outputs\], row-major.
    out: &'a mut [f32],
}

impl<const K: usize> WithSimd for Forward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // The parameters of `by_rows` are registers of rows per tile; the parameters of `by_units`
        // are registers per set of virtual lanes, and rows per tile.
        match S::F32_LANES {
            16 => {
                let row = self.by_rows::<S, 3>(simd, 0);
                let row = self.by_rows::<S, 1>(simd, row);
                self.by_units::<S, 1, 4>(simd, row);
            }
            8 => {
                let row = self.by_rows::<S, 2>(simd, 0);
                let row = self.by_rows::<S, 1>(simd, row);
                self.by_units::<S, 2, 1>(simd, row);
            }
            4 => {
                let row = self.by_rows::<S, 4>(simd, 0);
                let row = self.by_rows::<S, 1>(simd, row);
                self.by_units::<S, 4, 1>(simd, row);
            }
            _ => self.by_units::<S, 16, 1>(simd, 0),
        }
    }
}

impl<const K: usize> Forward<'_, K> {
    /// Computes the rows from `row` in full tiles of R registers, if all rows share one moment; returns the
    /// first row that remains.
    #[inline(always)]
    fn by_rows<S: Simd, const R: usize>(&mut self, simd: S, mut row: usize) -> usize {
        let Shallow { moments, rows, .. } = self.network;
        let full = |row: usize| row + R * S::F32_LANES <= rows;
        if !full(row) || moments.iter().any(|moment| *moment != moments[0]) {
            return row;
        }
        let mut waiting = [[[simd.splat_f32s(0.0); R]; OUTPUTS]; HALVINGS + 1];
        while full(row) {
            if moments.is_empty() {
                self.tall_tile::<S, R, false>(simd, row, &mut waiting);
            } else {
                self.tall_tile::<S, R, true>(simd, row, &mut waiting);
            }
            row += R * S::F32_LANES;
        }
        row
    }

    /// Computes all rows from `row`.
    #[inline(always)]
    fn by_units<S: Simd, const V: usize, const R: usize>(&mut self, simd: S, mut row: usize) {
        while row + R <= self.network.rows {
            self.wide_tile::<S, V, R>(simd, row);
            row += R;
        }
        if R > 2 {
            while row + 2 <= self.network.rows {
                self.wide_tile::<S, V, 2>(simd, row);
                row += 2;
            }
        }
        while row < self.network.rows {
            self.wide_tile::<S, V, 1>(simd, row);
            row += 1;
        }
    }

    /// R registers of rows with one moment. The tile computes one virtual lane after the other, so that sums
    /// across lanes are sums of registers. `MOMENTS` is whether there are moments. `waiting` is scratch
    /// space: slot i holds the sum of 2^i lanes until the other half is complete, and the last slot
    /// receives the total.
    ///
    /// There are no closures around the sums, and they are stored one register at a time. Closures and
    /// assignments of whole arrays would make the compiler spill the sums to the stack.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn tall_tile<S: Simd, const R: usize, const MOMENTS: bool>(
        &mut self,
        simd: S,
        row: usize,
        waiting: &mut [[[S::f32s; R]; OUTPUTS]; HALVINGS + 1],
    ) {
        let Shallow { weight, bias, head, inputs, moments, .. } = self.network;
        let units = bias.len();
        let zero = simd.splat_f32s(0.0);
        let (mut factors, mut weights, mut heads) = ([[zero; R]; K], [bias; K], [bias; OUTPUTS]);
        let inputs = &inputs.as_chunks::<K>().0[row..row + R * S::F32_LANES];
        for k in 0..K {
            let column: &mut [f32] = bytemuck::cast_slice_mut(&mut factors[k]);
            column.iter_mut().zip(inputs).for_each(|(factor, inputs)| *factor = inputs[k]);
            weights[k] = &weight[k * units..][..units];
        }
        for j in 0..OUTPUTS {
            heads[j] = &head[j * units..][..units];
        }
        let entries = if MOMENTS { (K + moments[0] as usize) * units } else { 0 };
        let entries = &weight[entries..][..units];
        for (at, lane) in BY_HALVES.into_iter().enumerate() {
            let mut sums = [[zero; R]; OUTPUTS];
            let mut unit = lane;
            while unit < units {
                let mut start = simd.splat_f32s(bias[unit]);
                if MOMENTS {
                    start = simd.add_f32s(start, simd.splat_f32s(entries[unit]));
                }
                let mut hidden = [start; R];
                for k in 0..K {
                    let weight = simd.splat_f32s(weights[k][unit]);
                    for r in 0..R {
                        hidden[r] = simd.mul_add_f32s(factors[k][r], weight, hidden[r]);
                    }
                }
                // NaN may or may not become 0 here; such a training fails either way.
                for r in 0..R {
                    hidden[r] = simd.max_f32s(hidden[r], zero);
                }
                for j in 0..OUTPUTS {
                    let head = simd.splat_f32s(heads[j][unit]);
                    for r in 0..R {
                        sums[j][r] = simd.mul_add_f32s(hidden[r], head, sums[j][r]);
                    }
                }
                unit += LANES;
            }
            // Adds a completed half to the half that waits for it.
            let whole = at.trailing_ones() as usize;
            for half in &waiting[..whole] {
                for j in 0..OUTPUTS {
                    for r in 0..R {
                        sums[j][r] = simd.add_f32s(half[j][r], sums[j][r]);
                    }
                }
            }
            for j in 0..OUTPUTS {
                for r in 0..R {
                    waiting[whole][j][r] = sums[j][r];
                }
            }
        }
        let out = &mut self.out.as_chunks_mut::<OUTPUTS>().0[row..row + R * S::F32_LANES];
        for j in 0..OUTPUTS {
            let (sums, start): (&[f32], f32) =
                (bytemuck::cast_slice(&waiting[HALVINGS][j]), self.start[j]);
            out.iter_mut().zip(sums).for_each(|(out, sum)| out[j] = sum + start);
        }
    }

    /// R rows. There are no closures here: they would make the compiler spill the sums to the stack.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, clippy::manual_memcpy)]
    fn wide_tile<S: Simd, const V: usize, const R: usize>(&mut self, simd: S, row: usize) {
        let Shallow { weight, bias, head, inputs, moments, .. } = self.network;
        let units = bias.len();
        let zero = simd.splat_f32s(0.0);
        // Every row of weights as registers, so that all rows share the index of a unit.
        let (start, _) = S::as_simd_f32s(bias);
        let (mut weights, mut heads) = ([start; K], [start; OUTPUTS]);
        for k in 0..K {
            weights[k] = S::as_simd_f32s(&weight[k * units..(k + 1) * units]).0;
        }
        for j in 0..OUTPUTS {
            heads[j] = S::as_simd_f32s(&head[j * units..(j + 1) * units]).0;
        }
        let (mut entries, mut factors) = ([start; R], [[zero; K]; R]);
        for r in 0..R {
            if !moments.is_empty() {
                let at = (K + moments[row + r] as usize) * units;
                entries[r] = S::as_simd_f32s(&weight[at..at + units]).0;
            }
            for k in 0..K {
                factors[r][k] = simd.splat_f32s(inputs[(row + r) * K + k]);
            }
        }
        let mut sums = [[[zero; V]; OUTPUTS]; R];
        for block in 0..start.len() / V {
            for v in 0..V {
                let unit = block * V + v;
                let mut hidden = [start[unit]; R];
                if !moments.is_empty() {
                    for r in 0..R {
                        hidden[r] = simd.add_f32s(hidden[r], entries[r][unit]);
                    }
                }
                for k in 0..K {
                    let weight = weights[k][unit];
                    for r in 0..R {
                        hidden[r] = simd.mul_add_f32s(factors[r][k], weight, hidden[r]);
                    }
                }
                for r in 0..R {
                    hidden[r] = simd.max_f32s(hidden[r], zero);
                }
                for j in 0..OUTPUTS {
                    let head = heads[j][unit];
                    for r in 0..R {
                        sums[r][j][v] = simd.mul_add_f32s(hidden[r], head, sums[r][j][v]);
                    }
                }
            }
        }
        // Stores all sums first and adds them up in a second step. A single loop would not be unrolled, and
        // the compiler would keep the sums on the stack throughout.
        let mut lanes = [[[0.0; LANES]; OUTPUTS]; R];
        for r in 0..R {
            for j in 0..OUTPUTS {
                let (registers, _) = S::as_mut_simd_f32s(&mut lanes[r][j]);
                for v in 0..V {
                    registers[v] = sums[r][j][v];
                }
            }
        }
        let out = self.out[row * OUTPUTS..(row + R) * OUTPUTS].chunks_exact_mut(OUTPUTS);
        for (out, lanes) in out.zip(&lanes) {
            let sums = all_by_halves(lanes);
            for j in 0..OUTPUTS {
                out[j] = sums[j] + self.start[j];
            }
        }
    }
}

/// The sums of the virtual lanes of every output: by halves, for all outputs at once.
#[inline(always)]
#[allow(clippy::needless_range_loop)]
fn all_by_halves(lanes: &[[f32; LANES]; OUTPUTS]) -> [f32; OUTPUTS] {
    let mut four = [[0.0; 4]; OUTPUTS];
    for j in 0..OUTPUTS {
        let mut eight = [0.0; 8];
        for l in 0..8 {
            eight[l] = lanes[j][l] + lanes[j][l + 8];
        }
        for l in 0..4 {
            four[j][l] = eight[l] + eight[l + 4];
        }
    }
    let mut sums = [0.0; OUTPUTS];
    for j in 0..OUTPUTS {
        sums[j] = (four[j][0] + four[j][2]) + (four[j][1] + four[j][3]);
    }
    sums
}
