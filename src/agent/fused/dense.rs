//! A linear layer with any number of outputs, for any number of rows, in a flat array of
//! parameters.

use crate::agent::layers::Layer;
use crate::agent::weights::{Tensor, Weights, WeightsError};
use crate::kernel::{Isa, LANES, Product, SumStart, transpose};

/// A linear layer: its sizes and the positions of its parameters. The outputs form adjacent parts,
/// each with padding.
#[derive(Clone, Debug)]
pub(super) struct Dense {
    parts: Vec<Part>,
    /// Start of the weights, \[inputs, width\], and of the bias, \[width\].
    weight: usize,
    bias: usize,
    inputs: usize,
    /// Outputs with padding. The weights of the padding are always 0.
    pub(super) width: usize,
}

/// Outputs that share one padding: all or some outputs of a named layer.
#[derive(Clone, Debug)]
struct Part {
    layer: Layer,
    /// Index of the first output in the named layer (`from`) and in the row of all outputs (`at`).
    from: usize,
    at: usize,
    outputs: usize,
}

pub(super) fn padded(len: usize) -> usize {
    len.next_multiple_of(LANES)
}

impl Dense {
    /// A layer split into `parts` equal parts, with parameters from position `start` on.
    pub(super) fn new(layer: Layer, parts: usize, start: usize) -> Self {
        let outputs = layer.outputs / parts;
        let (inputs, stride) = (layer.inputs, padded(outputs));
        let part = |i| Part { layer: layer.clone(), from: i * outputs, at: i * stride, outputs };
        Dense::of((0..parts).map(part).collect(), inputs, parts * stride, start)
    }

    /// Layers with the same inputs and adjacent outputs, without padding between them.
    pub(super) fn together(layers: &[Layer], start: usize) -> Self {
        let mut at = 0;
        let mut part = |layer: &Layer| {
            let part = Part { layer: layer.clone(), from: 0, at, outputs: layer.outputs };
            at += layer.outputs;
            part
        };
        let parts = layers.iter().map(&mut part).collect();
        Dense::of(parts, layers[0].inputs, padded(at), start)
    }

    fn of(parts: Vec<Part>, inputs: usize, width: usize, start: usize) -> Self {
        Dense { parts, weight: start, bias: start + inputs * width, inputs, width }
    }

    /// The position after the last parameter in the flat array.
    pub(super) fn end(&self) -> usize {
        self.bias + self.width
    }

    /// Copies weights to their positions in the flat array.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub(super) fn load(&self, weights: &Weights, flat: &mut [f32]) -> Result<(), WeightsError> {
        for Part { layer, from, at, outputs } in &self.parts {
            let weight = weights.tensor(&layer.weight(), &[layer.inputs, layer.outputs])?;
            let bias = weights.tensor(&layer.bias(), &[layer.outputs])?;
            let rows = flat[self.weight..].chunks_exact_mut(self.width);
            let named = weight.values.chunks_exact(layer.outputs);
            for (to, row) in rows.zip(named.chain([&bias.values[..]])) {
                to[*at..at + outputs].copy_from_slice(&row[*from..from + outputs]);
            }
        }
        Ok(())
    }

    /// Copies weights, or their gradient, from the flat array to arrays by name.
    pub(super) fn store(&self, flat: &[f32], weights: &mut Weights) {
        for Part { layer, from, at, outputs } in &self.parts {
            let mut insert = |name: String, shape: Vec<usize>, rows: &[f32]| {
                let numbers = shape.iter().product();
                let empty = || Tensor { shape, values: vec![0.0; numbers] };
                let tensor = weights.tensors.entry(name).or_insert_with(empty);
                let named = tensor.values.chunks_exact_mut(layer.outputs);
                for (to, row) in named.zip(rows.chunks_exact(self.width)) {
                    to[*from..from + outputs].copy_from_slice(&row[*at..at + outputs]);
                }
            };
            let (inputs, all) = (layer.inputs, layer.outputs);
            insert(layer.weight(), vec![inputs, all], &flat[self.weight..self.bias]);
            insert(layer.bias(), vec![all], &flat[self.bias..self.end()]);
        }
    }

    /// Computes the outputs for rows of inputs.
    ///
    /// **Shapes**: `left` is \[rows, inputs\] with row stride `stride`, `out` is \[rows, width\].
    pub(super) fn forward(
        &self,
        isa: Isa,
        flat: &[f32],
        (left, stride): (&[f32], usize),
        out: &mut [f32],
    ) {
        Product {
            start: SumStart::Row(&flat[self.bias..self.end()]),
            left,
            left_stride: stride,
            left_transposed: false,
            right: &flat[self.weight..self.bias],
            terms: self.inputs,
            rows: out.len() / self.width,
            width: self.width,
        }
        .write_to(isa, out);
    }

    /// Adds the gradient of the parameters to `gradient`, given the derivatives by the outputs.
    ///
    /// **Shapes**: as in [`Dense::forward`]; `ones` are \[rows\].
    pub(super) fn add_gradient(
        &self,
        isa: Isa,
        (left, stride): (&[f32], usize),
        by_outputs: &[f32],
        ones: &[f32],
        gradient: &mut [f32],
    ) {
        let terms = by_outputs.len() / self.width;
        let (weight, bias) =
            gradient[self.weight..self.end()].split_at_mut(self.bias - self.weight);
        for (left, left_stride, rows, to) in
            [(left, stride, self.inputs, weight), (ones, 1, 1, bias)]
        {
            Product {
                start: SumStart::Stored,
                left,
                left_stride,
                left_transposed: true,
                right: by_outputs,
                terms,
                rows,
                width: self.width,
            }
            .write_to(isa, to);
        }
    }

    /// Number of values that [`Dense::transpose`] writes.
    pub(super) fn transposed(&self) -> usize {
        self.width * padded(self.inputs)
    }

    /// Writes the transposed weights, \[width, padded inputs\].
    pub(super) fn transpose(&self, flat: &[f32], to: &mut [f32]) {
        let size = (self.inputs, self.width);
        transpose(&flat[self.weight..self.bias], self.width, size, to, padded(self.inputs));
    }

    /// Writes the derivatives by the inputs, \[rows, padded inputs\], or adds them to the stored
    /// ones, as `start` says.
    pub(super) fn backward(
        &self,
        isa: Isa,
        transposed: &[f32],
        by_outputs: &[f32],
        start: SumStart<'_>,
        out: &mut [f32],
    ) {
        Product {
            start,
            left: by_outputs,
            left_stride: self.width,
            left_transposed: false,
            right: transposed,
            terms: self.width,
            rows: by_outputs.len() / self.width,
            width: padded(self.inputs),
        }
        .write_to(isa, out);
    }
}
