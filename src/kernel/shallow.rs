//! Networks with one hidden layer of rectified linear units and four outputs, without storing the
//! hidden units.
//!
//! The results are those of [`crate::kernel::Product`], the activation and [`crate::kernel::dot`]
//! one after the other, to the bit.

use pulp::{Simd, WithSimd};

use crate::kernel::{Isa, LANES};

/// Outputs of such a network.
pub const OUTPUTS: usize = 4;
/// Most inputs of such a network, its one-hot aside.
pub const MOST_INPUTS: usize = 6;

/// The parameters of a network, and what it is given.
#[derive(Clone, Copy, Debug)]
pub struct Shallow<'a> {
    /// \[inputs and entries of the one-hot, units\], row by row.
    pub weight: &'a [f32],
    /// \[units\]; a multiple of [`LANES`].
    pub bias: &'a [f32],
    /// \[outputs, units\], row by row.
    pub head: &'a [f32],
    /// \[rows, inputs\], row by row; at least one and at most [`MOST_INPUTS`] inputs.
    pub inputs: &'a [f32],
    /// \[rows\]: which entry of the one-hot is 1; empty where there is none.
    pub moments: &'a [u32],
    /// How many rows there are.
    pub rows: usize,
}

/// The gradient by the parameters, laid out as they are; it is added to.
#[derive(Debug)]
pub struct ShallowGradient<'a> {
    /// See [`Shallow::weight`].
    pub weight: &'a mut [f32],
    /// See [`Shallow::bias`].
    pub bias: &'a mut [f32],
    /// See [`Shallow::head`].
    pub head: &'a mut [f32],
}

impl Shallow<'_> {
    fn check(&self) {
        assert!(self.rows > 0, "at least one row");
        assert_eq!(self.bias.len() % LANES, 0, "rows are padded");
        assert_eq!(self.head.len(), OUTPUTS * self.bias.len(), "a row for every output");
        assert_eq!(self.inputs.len() % self.rows, 0, "as many inputs in every row");
        assert!([0, self.rows].contains(&self.moments.len()), "a moment for every row, or none");
    }

    /// Writes the outputs, \[rows, outputs\], row by row, with `start`, \[outputs\], added.
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

    /// Adds the gradient that the derivatives by the outputs make: \[rows, outputs\], row by row.
    pub fn backward(self, isa: Isa, by_outputs: &[f32], gradient: ShallowGradient<'_>) {
        self.check();
        assert_eq!(by_outputs.len(), self.rows * OUTPUTS, "derivatives for every row");
        match self.inputs.len() / self.rows {
            1 => isa.run(Backward::<1> { network: self, by_outputs, gradient }),
            2 => isa.run(Backward::<2> { network: self, by_outputs, gradient }),
            3 => isa.run(Backward::<3> { network: self, by_outputs, gradient }),
            4 => isa.run(Backward::<4> { network: self, by_outputs, gradient }),
            5 => isa.run(Backward::<5> { network: self, by_outputs, gradient }),
            6 => isa.run(Backward::<6> { network: self, by_outputs, gradient }),
            inputs => panic!("{inputs} inputs are more than {MOST_INPUTS}"),
        }
    }
}

struct Forward<'a, const K: usize> {
    network: Shallow<'a>,
    start: &'a [f32],
    out: &'a mut [f32],
}

impl<const K: usize> WithSimd for Forward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // Registers of the virtual lanes, and rows at a time.
        match S::F32_LANES {
            16 => self.blocks::<S, 1, 4>(simd),
            8 => self.blocks::<S, 2, 1>(simd),
            4 => self.blocks::<S, 4, 1>(simd),
            _ => self.blocks::<S, 16, 1>(simd),
        }
    }
}

impl<const K: usize> Forward<'_, K> {
    #[inline(always)]
    fn blocks<S: Simd, const V: usize, const R: usize>(&mut self, simd: S) {
        let mut row = 0;
        while row + R <= self.network.rows {
            self.tile::<S, V, R>(simd, row);
            row += R;
        }
        while row < self.network.rows {
            self.tile::<S, V, 1>(simd, row);
            row += 1;
        }
    }

    /// R rows. Nothing in it is a closure: the compiler would put the sums into memory.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, clippy::manual_memcpy)]
    fn tile<S: Simd, const V: usize, const R: usize>(&mut self, simd: S, row: usize) {
        let Shallow { weight, bias, head, inputs, moments, .. } = self.network;
        let units = bias.len();
        let zero = simd.splat_f32s(0.0);
        // Registers of every row of weights, so that a unit is one index for all.
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
                    let positive = simd.greater_than_f32s(hidden[r], zero);
                    hidden[r] = simd.select_f32s(positive, hidden[r], zero);
                }
                for j in 0..OUTPUTS {
                    let head = heads[j][unit];
                    for r in 0..R {
                        sums[r][j][v] = simd.mul_add_f32s(hidden[r], head, sums[r][j][v]);
                    }
                }
            }
        }
        // First all to memory, then the adding up: as one loop it would not be unrolled, and the sums
        // would be in memory from the start.
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

/// The sums of the virtual lanes of every output: by halves, each half of all outputs at once.
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

struct Backward<'a, const K: usize> {
    network: Shallow<'a>,
    by_outputs: &'a [f32],
    gradient: ShallowGradient<'a>,
}

impl<const K: usize> WithSimd for Backward<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let units = self.network.bias.len();
        let mut unit = 0;
        while unit < units {
            self.column(simd, unit);
            unit += S::F32_LANES;
        }
    }
}

impl<const K: usize> Backward<'_, K> {
    /// One register of units, over all rows.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn column<S: Simd>(&mut self, simd: S, unit: usize) {
        let Shallow { weight, bias, head, inputs, moments, rows } = self.network;
        let units = bias.len();
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let (mut weights, mut by_weights) = ([zero; K], [zero; K]);
        for k in 0..K {
            weights[k] = load(simd, weight, k * units + unit);
            by_weights[k] = load(simd, self.gradient.weight, k * units + unit);
        }
        let (mut heads, mut by_heads) = ([zero; OUTPUTS], [zero; OUTPUTS]);
        for j in 0..OUTPUTS {
            heads[j] = load(simd, head, j * units + unit);
            by_heads[j] = load(simd, self.gradient.head, j * units + unit);
        }
        let start = load(simd, bias, unit);
        let mut by_start = load(simd, self.gradient.bias, unit);
        let inputs = inputs.chunks_exact(K).take(rows);
        for (row, (inputs, by_outputs)) in
            inputs.zip(self.by_outputs.chunks_exact(OUTPUTS)).enumerate()
        {
            let mut hidden = start;
            let mut entry = 0;
            if !moments.is_empty() {
                entry = (K + moments[row] as usize) * units + unit;
                hidden = simd.add_f32s(hidden, load(simd, weight, entry));
            }
            for k in 0..K {
                hidden = simd.mul_add_f32s(simd.splat_f32s(inputs[k]), weights[k], hidden);
            }
            let positive = simd.greater_than_f32s(hidden, zero);
            hidden = simd.select_f32s(positive, hidden, zero);
            let mut by_hidden = zero;
            for j in 0..OUTPUTS {
                let by_output = simd.splat_f32s(by_outputs[j]);
                by_hidden = simd.mul_add_f32s(by_output, heads[j], by_hidden);
                by_heads[j] = simd.mul_add_f32s(by_output, hidden, by_heads[j]);
            }
            by_hidden = simd.select_f32s(positive, by_hidden, zero);
            by_start = simd.mul_add_f32s(one, by_hidden, by_start);
            for k in 0..K {
                let input = simd.splat_f32s(inputs[k]);
                by_weights[k] = simd.mul_add_f32s(input, by_hidden, by_weights[k]);
            }
            if !moments.is_empty() {
                let sum = simd.add_f32s(load(simd, self.gradient.weight, entry), by_hidden);
                store::<S>(sum, self.gradient.weight, entry);
            }
        }
        for k in 0..K {
            store::<S>(by_weights[k], self.gradient.weight, k * units + unit);
        }
        for j in 0..OUTPUTS {
            store::<S>(by_heads[j], self.gradient.head, j * units + unit);
        }
        store::<S>(by_start, self.gradient.bias, unit);
    }
}

/// The register that starts at a position.
#[inline(always)]
fn load<S: Simd>(_: S, values: &[f32], at: usize) -> S::f32s {
    let (registers, _) = S::as_simd_f32s(&values[at..at + S::F32_LANES]);
    registers[0]
}

/// Puts a register at a position.
#[inline(always)]
fn store<S: Simd>(register: S::f32s, values: &mut [f32], at: usize) {
    let (registers, _) = S::as_mut_simd_f32s(&mut values[at..at + S::F32_LANES]);
    registers[0] = register;
}
