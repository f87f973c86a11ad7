//! A GRU whose state feeds one output per action and a value: forward and backward passes through
//! whole sequences.

use crate::agent;
use crate::agent::fused::dense::{Dense, padded};
use crate::agent::fused::sequences::{Between, Room, Through};
use crate::agent::layers;
use crate::agent::{Weights, WeightsError};
use crate::env::Observations;
use crate::kernel::{Activation, GATES, GruGradient, GruStep, Isa, SumStart};

/// Positions of the network's parameters in a flat array.
#[derive(Clone, Debug)]
pub(super) struct RecurrentLayers {
    activation: Activation,
    before: Vec<Dense>,
    gru_input: Dense,
    gru_hidden: Dense,
    after: Vec<Dense>,
    /// One output per action, then the value.
    heads: Dense,
    actions: usize,
    inputs: usize,
    pub(super) units: usize,
    /// Units with padding.
    stride: usize,
}

impl RecurrentLayers {
    pub(super) fn new(layers: layers::Recurrent, activation: agent::Activation) -> Self {
        let layers::Recurrent { before, gru, after, heads } = layers;
        let first = before.first().unwrap_or(&gru[0]);
        let (inputs, units) = (first.inputs, gru[1].inputs);
        let mut end = 0;
        let mut append = |dense: &dyn Fn(usize) -> Dense| {
            let dense = dense(end);
            end = dense.end();
            dense
        };
        let hidden = |layer: &layers::Layer| {
            let layer = layer.clone();
            move |start| Dense::new(layer.clone(), 1, start)
        };
        let before = before.iter().map(|layer| append(&hidden(layer))).collect();
        let [gru_input, gru_hidden] =
            gru.map(|layer| append(&|start| Dense::new(layer.clone(), GATES, start)));
        let after = after.iter().map(|layer| append(&hidden(layer))).collect();
        let actions = heads[0].outputs;
        let heads = append(&|start| Dense::together(&heads, start));
        let activation = match activation {
            agent::Activation::Relu => Activation::Relu,
            agent::Activation::Tanh => Activation::Tanh,
        };
        let stride = padded(units);
        RecurrentLayers {
            activation,
            before,
            gru_input,
            gru_hidden,
            after,
            heads,
            actions,
            inputs,
            units,
            stride,
        }
    }

    /// Number of values in the flat array.
    pub(super) fn len(&self) -> usize {
        self.heads.end()
    }

    fn all(&self) -> impl Iterator<Item = &Dense> {
        let gru = [&self.gru_input, &self.gru_hidden];
        self.before.iter().chain(gru).chain(&self.after).chain([&self.heads])
    }

    /// Copies weights to their positions in the flat array.
    ///
    /// **Errors**: an array is missing or of another shape.
    pub(super) fn load(&self, weights: &Weights, flat: &mut [f32]) -> Result<(), WeightsError> {
        self.all().try_for_each(|layer| layer.load(weights, flat))
    }

    /// Copies weights, or their gradient, from the flat array to arrays by name.
    pub(super) fn store(&self, flat: &[f32]) -> Weights {
        let mut weights = Weights::default();
        self.all().for_each(|layer| layer.store(flat, &mut weights));
        weights
    }

    /// Empty buffers for the activations between the layers, which grow as rows need.
    pub(super) fn between(&self) -> Between {
        Between {
            before: vec![Room::default(); self.before.len()],
            after: vec![Room::default(); self.after.len()],
            transposed: vec![Room::default(); self.all().count()],
            ..Between::default()
        }
    }

    /// The outputs for the actions, and the value, in one row of the heads' outputs.
    pub(super) fn outputs<'r>(&self, row: &'r [f32]) -> (&'r [f32], f32) {
        (&row[..self.actions], row[self.actions])
    }

    /// [`RecurrentLayers::outputs`] of a row of derivatives, to be written.
    pub(super) fn outputs_mut<'r>(&self, row: &'r mut [f32]) -> (&'r mut [f32], &'r mut f32) {
        let (of_actions, rest) = row.split_at_mut(self.actions);
        (of_actions, &mut rest[0])
    }

    /// Width of a row of the heads' outputs.
    pub(super) fn width(&self) -> usize {
        self.heads.width
    }

    /// Copies the states after the last step to `memory`, \[lanes, units\].
    pub(super) fn last_states(&self, rows: usize, between: &Between, memory: &mut [f32]) {
        let states = between.states_after.known(rows * self.stride);
        let last = &states[states.len() - memory.len() / self.units * self.stride..];
        let each = memory.chunks_exact_mut(self.units).zip(last.chunks_exact(self.stride));
        each.for_each(|(memory, state)| memory.copy_from_slice(&state[..memory.len()]));
    }

    /// Computes the forward pass through sequences and leaves the heads' outputs in `between`.
    pub(super) fn forward(
        &self,
        isa: Isa,
        flat: &[f32],
        through: Through<'_>,
        between: &mut Between,
    ) {
        let rows = through.rows();
        self.write_input(through.observations, between.input.of(rows * self.inputs));
        let Between { input, before, gates, states_after, .. } = &mut *between;
        let start = (input.known(rows * self.inputs), self.inputs);
        let (left, stride) = self.activate(isa, flat, (&self.before, before), start, rows);
        let width = self.gru_input.width;
        self.gru_input.forward(isa, flat, (left, stride), gates.of(rows * width));
        states_after.of(rows * self.stride);
        self.unroll(isa, flat, through, between);
        let Between { after, states_after, heads, .. } = between;
        let start = (states_after.known(rows * self.stride), self.stride);
        let left = self.activate(isa, flat, (&self.after, after), start, rows);
        self.heads.forward(isa, flat, left, heads.of(rows * self.heads.width));
    }

    /// Writes the observations with their one-hots expanded, \[rows, inputs\].
    fn write_input(&self, observations: &Observations, out: &mut [f32]) {
        let width = observations.width();
        for (row, out) in out.chunks_exact_mut(self.inputs).enumerate() {
            let (features, one_hot) = out.split_at_mut(width);
            features.copy_from_slice(observations.row(row));
            one_hot.fill(0.0);
            if let Some(moment) = observations.moment(row) {
                one_hot[moment as usize] = 1.0;
            }
        }
    }

    /// Computes consecutive hidden layers; returns the units of the last layer with their stride,
    /// or the input if there are no layers.
    fn activate<'b>(
        &self,
        isa: Isa,
        flat: &[f32],
        (layers, rooms): (&[Dense], &'b mut [Room]),
        start: (&'b [f32], usize),
        rows: usize,
    ) -> (&'b [f32], usize) {
        let mut left = start;
        for (layer, room) in layers.iter().zip(rooms) {
            let units = room.of(rows * layer.width);
            layer.forward(isa, flat, left, units);
            self.activation.apply(isa, units);
            left = (units, layer.width);
        }
        left
    }

    /// Computes the GRU step by step.
    fn unroll(&self, isa: Isa, flat: &[f32], through: Through<'_>, between: &mut Between) {
        let Through { lanes, memory, firsts, .. } = through;
        let (rows, stride) = (through.rows(), self.stride);
        let (of_step, of_gates) = (lanes * stride, lanes * GATES * stride);
        let gates = between.gates.of(rows * GATES * stride);
        let from_state = between.from_state.of(rows * GATES * stride);
        let befores = between.states_before.of(rows * stride);
        let afters = between.states_after.of(rows * stride);
        for step in 0..rows / lanes {
            let before = &mut befores[step * of_step..][..of_step];
            if step == 0 {
                let each = before.chunks_exact_mut(stride).zip(memory.chunks_exact(self.units));
                for (before, memory) in each {
                    before[..memory.len()].copy_from_slice(memory);
                    before[memory.len()..].fill(0.0);
                }
            } else {
                before.copy_from_slice(&afters[(step - 1) * of_step..][..of_step]);
            }
            let firsts = firsts.get(step * lanes..).unwrap_or_default();
            let each = before.chunks_exact_mut(stride).zip(firsts);
            each.filter(|(_, first)| **first).for_each(|(before, _)| before.fill(0.0));
            let from_state = &mut from_state[step * of_gates..][..of_gates];
            self.gru_hidden.forward(isa, flat, (before, stride), from_state);
            let step = GruStep {
                stride,
                from_input: &mut gates[step * of_gates..][..of_gates],
                from_state,
                before,
                after: &mut afters[step * of_step..][..of_step],
            };
            step.run(isa);
        }
    }

    /// Adds the gradient of the parameters to `gradient`, given the derivatives by the heads'
    /// outputs, after [`RecurrentLayers::forward`] of the same sequences.
    pub(super) fn backward(
        &self,
        isa: Isa,
        flat: &[f32],
        through: Through<'_>,
        between: &mut Between,
        gradient: &mut [f32],
    ) {
        let rows = through.rows();
        between.ones.of(rows).fill(1.0);
        let each = self.all().zip(&mut between.transposed).skip(1);
        each.for_each(|(layer, room)| layer.transpose(flat, room.of(layer.transposed())));
        let states = self.before.len() + 2;
        let Between {
            after,
            states_after,
            ones,
            by_heads,
            by_states,
            by_active,
            by_units,
            transposed,
            ..
        } = &mut *between;
        let behind = &transposed[states..];
        // From the heads to the states.
        let pass = Pass { isa, rows, ones: ones.known(rows), activation: self.activation };
        let start = (states_after.known(rows * self.stride), self.stride);
        let by_heads = by_heads.known(rows * self.heads.width);
        let last = match (self.after.last(), after.last()) {
            (Some(layer), Some(room)) => (room.known(rows * layer.width), layer.width),
            _ => start,
        };
        self.heads.add_gradient(isa, last, by_heads, pass.ones, gradient);
        let transposed = behind[self.after.len()].known(self.heads.transposed());
        let into = by_active.of(rows * padded(last.1));
        self.heads.backward(isa, transposed, by_heads, SumStart::Zero, into);
        pass.back(&self.after, after, behind, start, [by_active, by_units], gradient, true);
        by_states.of(rows * self.stride).copy_from_slice(by_active.known(rows * self.stride));

        self.roll_up(isa, through, between);

        // From the gates to the weights of the GRU, and to the layers in front of it.
        let Between {
            input,
            before,
            states_before,
            from_state,
            ones,
            by_input,
            by_active,
            by_units,
            transposed,
            ..
        } = &mut *between;
        let (width, stride) = (self.gru_input.width, self.stride);
        let pass = Pass { isa, rows, ones: ones.known(rows), activation: self.activation };
        let states = (states_before.known(rows * stride), stride);
        let by_state = from_state.known(rows * width);
        self.gru_hidden.add_gradient(isa, states, by_state, pass.ones, gradient);
        let start = (input.known(rows * self.inputs), self.inputs);
        let last = match (self.before.last(), before.last()) {
            (Some(layer), Some(room)) => (room.known(rows * layer.width), layer.width),
            _ => start,
        };
        let by_input = by_input.known(rows * width);
        self.gru_input.add_gradient(isa, last, by_input, pass.ones, gradient);
        let weights = transposed[self.before.len()].known(self.gru_input.transposed());
        let into = by_active.of(rows * padded(last.1));
        self.gru_input.backward(isa, weights, by_input, SumStart::Zero, into);
        let rooms = [by_active, by_units];
        pass.back(&self.before, before, transposed, start, rooms, gradient, false);
    }

    /// Computes the backward pass through the steps of the GRU: from the derivatives by the state
    /// after every step to the derivatives by the contributions of input and state to the gates.
    fn roll_up(&self, isa: Isa, through: Through<'_>, between: &mut Between) {
        let Through { lanes, firsts, cuts, .. } = through;
        let (rows, stride) = (through.rows(), self.stride);
        let (of_step, of_gates) = (lanes * stride, lanes * GATES * stride);
        let by_input = between.by_input.of(rows * GATES * stride);
        let gates = between.gates.known(rows * GATES * stride);
        let from_state = between.from_state.of(rows * GATES * stride);
        let befores = between.states_before.known(rows * stride);
        let by_states = between.by_states.of(rows * stride);
        let transposed =
            between.transposed[self.before.len() + 1].known(self.gru_hidden.transposed());
        for step in (0..rows / lanes).rev() {
            let (earlier, by_after) = by_states.split_at_mut(step * of_step);
            let by_after = &mut by_after[..of_step];
            let from_state = &mut from_state[step * of_gates..][..of_gates];
            let gradient = GruGradient {
                stride,
                gates: &gates[step * of_gates..][..of_gates],
                from_state,
                before: &befores[step * of_step..][..of_step],
                by_after,
                by_input: &mut by_input[step * of_gates..][..of_gates],
            };
            gradient.run(isa);
            let Some(start) = earlier.len().checked_sub(of_step) else { continue };
            self.gru_hidden.backward(isa, transposed, from_state, SumStart::Stored, by_after);
            let by_before = earlier[start..].chunks_exact_mut(stride);
            let is_marked = |marks: &[bool], row: usize| marks.get(row).is_some_and(|mark| *mark);
            let rows = by_before.zip(by_after.chunks_exact(stride)).zip(step * lanes..);
            for ((to, by), row) in rows {
                if !is_marked(firsts, row) && !is_marked(cuts, row) {
                    to.iter_mut().zip(by).for_each(|(to, by)| *to += by);
                }
            }
        }
    }
}

/// The arguments that all hidden layers of a backward pass share.
struct Pass<'a> {
    isa: Isa,
    rows: usize,
    ones: &'a [f32],
    activation: Activation,
}

impl Pass<'_> {
    /// Computes the backward pass through hidden layers. The first of the two rooms holds the
    /// derivatives by the units of the last layer; with `to_input`, it ends up with the derivatives
    /// by the input of the first layer.
    #[allow(clippy::too_many_arguments)]
    fn back(
        &self,
        layers: &[Dense],
        units: &[Room],
        transposed: &[Room],
        start: (&[f32], usize),
        [by_active, by_units]: [&mut Room; 2],
        gradient: &mut [f32],
        to_input: bool,
    ) {
        let Pass { isa, rows, ones, activation } = *self;
        for (i, layer) in layers.iter().enumerate().rev() {
            let len = rows * layer.width;
            let by_units = by_units.of(len);
            activation.differentiate(isa, units[i].known(len), by_active.known(len), by_units);
            let left = match i.checked_sub(1) {
                Some(before) => {
                    let width = layers[before].width;
                    (units[before].known(rows * width), width)
                }
                None => start,
            };
            layer.add_gradient(isa, left, by_units, ones, gradient);
            if i > 0 || to_input {
                let transposed = transposed[i].known(layer.transposed());
                let into = by_active.of(rows * padded(left.1));
                layer.backward(isa, transposed, by_units, SumStart::Zero, into);
            }
        }
    }
}
