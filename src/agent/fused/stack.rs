//! A stack of hidden layers with its heads, in a flat array of parameters.

use std::ops::Range;

use crate::agent;
use crate::agent::fused::dense::padded;
use crate::agent::layers::{self, Layer};
use crate::agent::weights::{Tensor, Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{
    Activation, Aligned, Isa, MOST_INPUTS, OUTPUTS, Product, Shallow, ShallowGradient, SumStart,
    dot, transpose,
};

/// Maximum number of rows computed at a time, so that the values between two layers stay in the
/// nearest caches.
pub(super) const BLOCK: usize = 64;

/// A hidden layer: its sizes and the positions of its parameters.
#[derive(Clone, Debug)]
struct Hidden {
    /// Start of the weights, \[inputs, stride\]. The last inputs are the entries of the one-hot.
    weight: usize,
    /// Start of the bias, \[stride\].
    bias: usize,
    units: usize,
    /// Units with padding. The weights of the padding are always 0.
    stride: usize,
}

/// The positions of a stack's parameters in a flat array. All heads form one matrix, \[outputs,
/// stride\], so that its rows align with rows of hidden units.
#[derive(Clone, Debug)]
pub(super) struct StackLayout {
    /// Names and sizes.
    layers: layers::Stack,
    activation: Activation,
    hidden: Vec<Hidden>,
    head_weight: usize,
    head_bias: usize,
    outputs: usize,
    range: Range<usize>,
}

/// Buffers for the values between the layers, for [`BLOCK`] rows.
#[derive(Clone, Debug)]
pub(super) struct Workspace {
    /// Activations of each hidden layer, \[rows, stride\].
    hidden: Vec<Aligned>,
    /// \[rows, outputs\].
    pub(super) outputs: Vec<f32>,
    /// Derivatives of the loss by the outputs, \[rows, outputs\].
    pub(super) by_outputs: Vec<f32>,
    /// Derivatives by a hidden layer's units before the activation, \[rows, stride\].
    by_units: Aligned,
    /// Derivatives by the activations, \[rows, stride\].
    by_active: Aligned,
    /// The transposed weights of each hidden layer but the first, \[units, stride of the layer
    /// before\].
    transposed: Vec<Aligned>,
}

/// The row ranges of observations, at most [`BLOCK`] rows each.
pub(super) fn blocks(rows: usize) -> impl Iterator<Item = Range<usize>> {
    (0..rows).step_by(BLOCK).map(move |start| start..rows.min(start + BLOCK))
}

impl StackLayout {
    /// A stack with parameters from position `start` on.
    pub(super) fn new(layers: layers::Stack, activation: agent::Activation, start: usize) -> Self {
        let mut end = start;
        let mut take = |len: usize| {
            let start = end;
            end += padded(len);
            start
        };
        let hidden: Vec<Hidden> = layers
            .hidden
            .iter()
            .map(|layer| {
                let stride = padded(layer.outputs);
                let weight = take(layer.inputs * stride);
                Hidden { weight, bias: take(stride), units: layer.outputs, stride }
            })
            .collect();
        let outputs = layers.heads.iter().map(|head| head.outputs).sum();
        let last = hidden.last().expect("a network has at least one hidden layer").stride;
        let (head_weight, head_bias) = (take(outputs * last), take(outputs));
        let activation = match activation {
            agent::Activation::Relu => Activation::Relu,
            agent::Activation::Tanh => Activation::Tanh,
        };
        let range = start..end;
        StackLayout { layers, activation, hidden, head_weight, head_bias, outputs, range }
    }

    /// The position after the last parameter in the flat array.
    pub(super) fn end(&self) -> usize {
        self.range.end
    }

    /// Number of outputs of all heads.
    pub(super) fn outputs(&self) -> usize {
        self.outputs
    }

    pub(super) fn workspace(&self) -> Workspace {
        let widest = self.hidden.iter().map(|hidden| hidden.stride).max().unwrap_or(0);
        let pairs = self.hidden.windows(2);
        Workspace {
            hidden: self.hidden.iter().map(|h| Aligned::zeros(BLOCK * h.stride)).collect(),
            outputs: vec![0.0; BLOCK * self.outputs],
            by_outputs: vec![0.0; BLOCK * self.outputs],
            by_units: Aligned::zeros(BLOCK * widest),
            by_active: Aligned::zeros(BLOCK * widest),
            transposed: pairs.map(|p| Aligned::zeros(p[1].units * p[0].stride)).collect(),
        }
    }

    /// Copies weights to their positions in the flat array.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub(super) fn load(&self, weights: &Weights, flat: &mut [f32]) -> Result<(), WeightsError> {
        let named = |layer: &Layer| -> Result<_, WeightsError> {
            let weight = weights.tensor(&layer.weight(), &[layer.inputs, layer.outputs])?;
            Ok((&weight.values, &weights.tensor(&layer.bias(), &[layer.outputs])?.values))
        };
        for (layer, hidden) in self.layers.hidden.iter().zip(&self.hidden) {
            let (weight, bias) = named(layer)?;
            for (input, row) in weight.chunks_exact(layer.outputs).enumerate() {
                let at = hidden.weight + input * hidden.stride;
                flat[at..at + row.len()].copy_from_slice(row);
            }
            flat[hidden.bias..hidden.bias + bias.len()].copy_from_slice(bias);
        }
        let mut first = 0;
        let stride = self.head_stride();
        for head in &self.layers.heads {
            let (weight, bias) = named(head)?;
            let to = &mut flat[self.head_weight + first * stride..];
            transpose(weight, head.outputs, (head.inputs, head.outputs), to, stride);
            let at = self.head_bias + first;
            flat[at..at + bias.len()].copy_from_slice(bias);
            first += head.outputs;
        }
        Ok(())
    }

    /// Copies weights, or their gradient, from the flat array to arrays by name.
    pub(super) fn store(&self, flat: &[f32], weights: &mut Weights) {
        let mut insert = |layer: &Layer, weight: Vec<f32>, bias: &[f32]| {
            let shape = vec![layer.inputs, layer.outputs];
            weights.tensors.insert(layer.weight(), Tensor { shape, values: weight });
            let bias = Tensor { shape: vec![layer.outputs], values: bias.to_vec() };
            weights.tensors.insert(layer.bias(), bias);
        };
        for (layer, hidden) in self.layers.hidden.iter().zip(&self.hidden) {
            let rows = flat[hidden.weight..].chunks(hidden.stride).take(layer.inputs);
            let weight = rows.flat_map(|row| &row[..layer.outputs]).copied().collect();
            insert(layer, weight, &flat[hidden.bias..hidden.bias + layer.outputs]);
        }
        let mut first = 0;
        let stride = self.head_stride();
        for head in &self.layers.heads {
            let mut weight = vec![0.0; head.inputs * head.outputs];
            let from = &flat[self.head_weight + first * stride..];
            transpose(from, stride, (head.outputs, head.inputs), &mut weight, head.outputs);
            let at = self.head_bias + first;
            insert(head, weight, &flat[at..at + head.outputs]);
            first += head.outputs;
        }
    }

    fn head_stride(&self) -> usize {
        self.hidden[self.hidden.len() - 1].stride
    }

    /// Computes the outputs of at most [`BLOCK`] observations.
    pub(super) fn forward(
        &self,
        isa: Isa,
        flat: &[f32],
        (observations, rows): (&Observations, Range<usize>),
        workspace: &mut Workspace,
    ) {
        match self.shallow(flat, (observations, rows.clone())) {
            Some(network) => {
                let start = &flat[self.head_bias..self.head_bias + self.outputs];
                network.forward(isa, start, &mut workspace.outputs[..rows.len() * self.outputs]);
            }
            None => self.forward_layers(isa, flat, (observations, rows), workspace),
        }
    }

    /// Computes the values that [`StackLayout::backward`] needs for at most [`BLOCK`] observations whose
    /// outputs are already known.
    pub(super) fn remember(
        &self,
        isa: Isa,
        flat: &[f32],
        (observations, rows): (&Observations, Range<usize>),
        workspace: &mut Workspace,
    ) {
        if self.shallow(flat, (observations, rows.clone())).is_none() {
            self.forward_layers(isa, flat, (observations, rows), workspace);
        }
    }

    /// The stack for the fused kernels of one hidden layer, if these kernels support it.
    fn shallow<'a>(
        &self,
        flat: &'a [f32],
        (observations, rows): (&'a Observations, Range<usize>),
    ) -> Option<Shallow<'a>> {
        let [layer] = self.hidden.as_slice() else {
            return None;
        };
        let width = observations.width();
        let fits = self.activation == Activation::Relu
            && self.outputs == OUTPUTS
            && (1..=MOST_INPUTS).contains(&width);
        fits.then(|| Shallow {
            weight: &flat[layer.weight..layer.bias],
            bias: &flat[layer.bias..layer.bias + layer.stride],
            head: &flat[self.head_weight..self.head_bias],
            inputs: &observations.features()[rows.start * width..rows.end * width],
            moments: observations.moments().get(rows.clone()).unwrap_or_default(),
            rows: rows.len(),
        })
    }

    /// [`StackLayout::forward`] layer by layer, for any stack.
    fn forward_layers(
        &self,
        isa: Isa,
        flat: &[f32],
        (observations, rows): (&Observations, Range<usize>),
        workspace: &mut Workspace,
    ) {
        let count = rows.len();
        for (i, layer) in self.hidden.iter().enumerate() {
            let (before, from) = workspace.hidden.split_at_mut(i);
            let units = &mut from[0][..count * layer.stride];
            let bias = &flat[layer.bias..layer.bias + layer.stride];
            let mut start = SumStart::Row(bias);
            let (left, stride, terms) = match before.last() {
                None => {
                    if observations.one_hot() > 0 {
                        self.start_with_one_hots(flat, (observations, rows.clone()), units);
                        start = SumStart::Stored;
                    }
                    let width = observations.width();
                    (&observations.features()[rows.start * width..], width, width)
                }
                Some(left) => (&left[..], self.hidden[i - 1].stride, self.hidden[i - 1].units),
            };
            Product {
                start,
                left,
                left_stride: stride,
                left_transposed: false,
                right: &flat[layer.weight..],
                terms,
                rows: count,
                width: layer.stride,
            }
            .write_to(isa, units);
            self.activation.apply(isa, units);
        }
        let stride = self.head_stride();
        let last = &workspace.hidden[self.hidden.len() - 1][..count * stride];
        let weight = &flat[self.head_weight..self.head_weight + self.outputs * stride];
        let bias = &flat[self.head_bias..self.head_bias + self.outputs];
        dot(isa, last, weight, stride, bias, &mut workspace.outputs[..count * self.outputs]);
    }

    /// Initialises the first layer's units with the bias plus the weights of the active one-hot
    /// entries.
    fn start_with_one_hots(
        &self,
        flat: &[f32],
        (observations, rows): (&Observations, Range<usize>),
        units: &mut [f32],
    ) {
        let layer = &self.hidden[0];
        let bias = &flat[layer.bias..layer.bias + layer.stride];
        let moments = &observations.moments()[rows];
        for (units, moment) in units.chunks_exact_mut(layer.stride).zip(moments) {
            let entry = layer.weight + (observations.width() + *moment as usize) * layer.stride;
            let weights = &flat[entry..entry + layer.stride];
            let sums = bias.iter().zip(weights).map(|(bias, weight)| bias + weight);
            units.iter_mut().zip(sums).for_each(|(unit, sum)| *unit = sum);
        }
    }

    /// Prepares the workspace for [`StackLayout::backward`] with these parameters.
    pub(super) fn prepare(&self, flat: &[f32], workspace: &mut Workspace) {
        for (pair, transposed) in self.hidden.windows(2).zip(&mut workspace.transposed) {
            let (previous, layer) = (&pair[0], &pair[1]);
            let from = &flat[layer.weight..];
            let size = (previous.units, layer.units);
            transpose(from, layer.stride, size, transposed, previous.stride);
        }
    }

    /// Adds the gradient of the parameters to `gradient`, given the derivatives by the outputs,
    /// after [`StackLayout::forward`] or [`StackLayout::remember`] of the same observations.
    pub(super) fn backward(
        &self,
        isa: Isa,
        flat: &[f32],
        (observations, rows): (&Observations, Range<usize>),
        workspace: &mut Workspace,
        gradient: &mut [f32],
    ) {
        let Some(network) = self.shallow(flat, (observations, rows.clone())) else {
            return self.backward_layers(isa, flat, (observations, rows), workspace, gradient);
        };
        let by_outputs = &workspace.by_outputs[..rows.len() * self.outputs];
        self.add_head_biases(by_outputs, gradient);
        let layer = &self.hidden[0];
        let (below, head) = gradient.split_at_mut(self.head_weight);
        let (below, bias) = below.split_at_mut(layer.bias);
        let gradient = ShallowGradient {
            weight: &mut below[layer.weight..],
            bias: &mut bias[..layer.stride],
            head: &mut head[..self.outputs * layer.stride],
        };
        network.backward(isa, by_outputs, gradient);
    }

    /// Adds the gradient by the heads' biases.
    fn add_head_biases(&self, by_outputs: &[f32], gradient: &mut [f32]) {
        let bias = &mut gradient[self.head_bias..self.head_bias + self.outputs];
        // One output for a value; four for the advantages or logits of four actions, five with a value.
        match self.outputs {
            1 => add_rows::<1>(by_outputs, bias),
            4 => add_rows::<4>(by_outputs, bias),
            5 => add_rows::<5>(by_outputs, bias),
            outputs => by_outputs.chunks_exact(outputs).for_each(|row| {
                bias.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            }),
        }
    }

    /// [`StackLayout::backward`] layer by layer, for any stack, after [`StackLayout::forward_layers`].
    fn backward_layers(
        &self,
        isa: Isa,
        flat: &[f32],
        (observations, rows): (&Observations, Range<usize>),
        workspace: &mut Workspace,
        gradient: &mut [f32],
    ) {
        let count = rows.len();
        self.backward_heads(isa, flat, count, workspace, gradient);
        let Workspace { by_units, by_active, .. } = workspace;
        for (i, layer) in self.hidden.iter().enumerate().rev() {
            let derivatives = &by_units[..count * layer.stride];
            let bias = &mut gradient[layer.bias..layer.bias + layer.stride];
            sums_of_columns(isa, derivatives, count, bias);
            let Some(before) = i.checked_sub(1) else {
                let width = observations.width();
                let features = &observations.features()[rows.start * width..];
                let to = &mut gradient[layer.weight..];
                outer(isa, (features, width, width), derivatives, count, to);
                let moments = observations.moments().get(rows.clone()).unwrap_or_default();
                for (row, moment) in derivatives.chunks_exact(layer.stride).zip(moments) {
                    let entry = (width + *moment as usize) * layer.stride;
                    let to = &mut to[entry..entry + layer.stride];
                    to.iter_mut().zip(row).for_each(|(sum, by_unit)| *sum += by_unit);
                }
                continue;
            };
            let previous = &self.hidden[before];
            let units = &workspace.hidden[before];
            let to = &mut gradient[layer.weight..];
            outer(isa, (units, previous.stride, previous.units), derivatives, count, to);
            let into = &mut by_active[..count * previous.stride];
            Product {
                start: SumStart::Zero,
                left: derivatives,
                left_stride: layer.stride,
                left_transposed: false,
                right: &workspace.transposed[before],
                terms: layer.units,
                rows: count,
                width: previous.stride,
            }
            .write_to(isa, into);
            let active = &units[..into.len()];
            self.activation.differentiate(isa, active, into, &mut by_units[..into.len()]);
        }
    }

    /// The heads' part of [`StackLayout::backward`], down to the derivatives by the units of the last
    /// hidden layer.
    fn backward_heads(
        &self,
        isa: Isa,
        flat: &[f32],
        count: usize,
        workspace: &mut Workspace,
        gradient: &mut [f32],
    ) {
        let stride = self.head_stride();
        let last = &workspace.hidden[self.hidden.len() - 1][..count * stride];
        let by_outputs = &workspace.by_outputs[..count * self.outputs];
        let to = &mut gradient[self.head_weight..self.head_weight + self.outputs * stride];
        outer(isa, (by_outputs, self.outputs, self.outputs), last, count, to);
        self.add_head_biases(by_outputs, gradient);
        let Workspace { by_units, by_active, .. } = workspace;
        let into = &mut by_active[..count * stride];
        Product {
            start: SumStart::Zero,
            left: by_outputs,
            left_stride: self.outputs,
            left_transposed: false,
            right: &flat[self.head_weight..],
            terms: self.outputs,
            rows: count,
            width: stride,
        }
        .write_to(isa, into);
        self.activation.differentiate(isa, last, into, &mut by_units[..into.len()]);
    }
}

/// to\[i, j\] += Σ_row left\[row, i\] right\[row, j\]. The rows of `left` have `columns` entries
/// and row stride `stride`.
fn outer(
    isa: Isa,
    (left, stride, columns): (&[f32], usize, usize),
    right: &[f32],
    count: usize,
    to: &mut [f32],
) {
    Product {
        start: SumStart::Stored,
        left,
        left_stride: stride,
        left_transposed: true,
        right,
        terms: count,
        rows: columns,
        width: right.len() / count,
    }
    .write_to(isa, to);
}

/// to\[j\] += Σ_row rows\[row, j\], with the sums held in registers.
fn add_rows<const N: usize>(rows: &[f32], to: &mut [f32]) {
    let to: &mut [f32; N] = to.try_into().expect("a bias for every output");
    let mut sums = *to;
    for row in rows.as_chunks::<N>().0 {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    *to = sums;
}

/// to\[j\] += Σ_row values\[row, j\] over at most [`BLOCK`] rows.
fn sums_of_columns(isa: Isa, values: &[f32], count: usize, to: &mut [f32]) {
    outer(isa, (&[1.0; BLOCK][..count], 1, 1), values, count, to);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{Reinforce, Shape};
    use crate::rng::{Purpose, Stream};

    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|value| value.to_bits()).collect()
    }

    #[test]
    fn one_layer_in_one_go_is_that_layer_by_layer_to_the_bit() {
        let mut stream = Stream::new(3, Purpose::Replay);
        let mut uniform = move || 2.0 * stream.unit() as f32 - 1.0;
        for (units, width, one_hot, rows) in [
            (128, 3, 0, 64),
            (128, 3, 5, 50),
            (128, 3, 1, 50),
            (5, 1, 0, 1),
            (33, 6, 2, 7),
            (16, 4, 0, 9),
            (20, 2, 0, 5),
            (128, 5, 0, 6),
        ] {
            let parameters = Reinforce { layers: vec![units], ..Reinforce::default() };
            let layers = layers::policy(&parameters, Shape::of_four(width + one_hot));
            let weights = layers::draw(
                std::slice::from_ref(&layers),
                &mut Stream::new(1, Purpose::InitialWeights),
            );
            let stack = StackLayout::new(layers, parameters.activation, 0);
            let mut flat = Aligned::zeros(stack.end());
            stack.load(&weights, &mut flat).unwrap();
            let mut observations = Observations::new(width, one_hot);
            for row in 0..rows {
                let features: Vec<f32> = (0..width).map(|_| uniform()).collect();
                let moment = (one_hot > 0).then_some(row as u32 % one_hot.max(1) as u32);
                observations.push(&features, moment);
            }
            for isa in Isa::available() {
                let given = (&observations, 0..rows);
                assert!(stack.shallow(&flat, given.clone()).is_some());
                let (mut at_once, mut by_layers) = (stack.workspace(), stack.workspace());
                stack.forward(isa, &flat, given.clone(), &mut at_once);
                stack.forward_layers(isa, &flat, given.clone(), &mut by_layers);
                assert_eq!(bits(&at_once.outputs), bits(&by_layers.outputs));
                at_once.by_outputs.iter_mut().for_each(|derivative| *derivative = uniform());
                by_layers.by_outputs.clone_from(&at_once.by_outputs);
                let mut gradients = [Aligned::zeros(flat.len()), Aligned::zeros(flat.len())];
                let [first, second] = &mut gradients;
                stack.backward(isa, &flat, given.clone(), &mut at_once, first);
                stack.backward_layers(isa, &flat, given, &mut by_layers, second);
                assert_eq!(bits(first), bits(second), "{units} {width} {one_hot} {rows}");
            }
        }
    }
}
