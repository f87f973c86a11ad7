//! Both directions compared with plain loops.

use super::{OUTPUTS, Shallow, ShallowGradient};
use crate::kernel::test_numbers::{bits, numbers};
use crate::kernel::{Isa, LANES};

/// Sizes and numbers of a network and its rows.
struct Case {
    inputs: usize,
    units: usize,
    rows: usize,
    /// Entries of the one-hot; 0 without.
    entries: usize,
    /// The number of consecutive rows with the same moment.
    run: usize,
}

impl Case {
    fn all() -> impl Iterator<Item = Case> {
        // Every width of tiles, every remainder, and a single row.
        let sizes: &[_] = if cfg!(miri) {
            &[(3, 16, 9)]
        } else {
            &[
                (1, 16, 1),
                (2, 48, 7),
                (3, 128, 50),
                (3, 128, 64),
                (4, 16, 43),
                (5, 32, 24),
                (6, 64, 17),
            ]
        };
        // Without a one-hot; and with moments that change every row, every few rows, and never.
        let moments = [(0, 1), (50, 1), (5, 9), (3, 100)];
        sizes.iter().flat_map(move |&(inputs, units, rows)| {
            moments.map(|(entries, run)| Case { inputs, units, rows, entries, run })
        })
    }

    fn moments(&self) -> Vec<u32> {
        let of_row = |row: usize| ((row / self.run * 7 + 2) % self.entries) as u32;
        let rows = if self.entries == 0 { 0 } else { self.rows };
        (0..rows).map(of_row).collect()
    }

    fn name(&self) -> String {
        let Case { inputs, units, rows, entries, run } = self;
        format!("{inputs} + {entries} inputs, {units} units, {rows} rows in runs of {run}")
    }
}

/// The hidden units, \[rows, units\], computed one operation at a time.
fn hidden(network: &Shallow<'_>, inputs: usize) -> Vec<f32> {
    let units = network.bias.len();
    let mut all = Vec::new();
    for row in 0..network.rows {
        for unit in 0..units {
            let mut hidden = network.bias[unit];
            if let Some(moment) = network.moments.get(row) {
                hidden += network.weight[(inputs + *moment as usize) * units + unit];
            }
            for k in 0..inputs {
                let weight = network.weight[k * units + unit];
                hidden = network.inputs[row * inputs + k].mul_add(weight, hidden);
            }
            all.push(hidden.max(0.0));
        }
    }
    all
}

fn outputs(network: &Shallow<'_>, hidden: &[f32], start: &[f32]) -> Vec<f32> {
    let units = network.bias.len();
    let mut out = Vec::new();
    for hidden in hidden.chunks(units) {
        for (head, start) in network.head.chunks(units).zip(start) {
            let mut lanes = [0.0f32; LANES];
            for (unit, (hidden, head)) in hidden.iter().zip(head).enumerate() {
                lanes[unit % LANES] = hidden.mul_add(*head, lanes[unit % LANES]);
            }
            let mut half = LANES;
            while half > 1 {
                half /= 2;
                (0..half).for_each(|lane| lanes[lane] += lanes[lane + half]);
            }
            out.push(lanes[0] + start);
        }
    }
    out
}

fn differentiate(
    network: &Shallow<'_>,
    hidden: &[f32],
    by_outputs: &[f32],
    gradient: ShallowGradient<'_>,
) {
    let units = network.bias.len();
    let inputs = network.inputs.len() / network.rows;
    for row in 0..network.rows {
        for unit in 0..units {
            let hidden = hidden[row * units + unit];
            let mut by_hidden = 0.0f32;
            for j in 0..OUTPUTS {
                let (by_output, head) = (by_outputs[row * OUTPUTS + j], j * units + unit);
                by_hidden = by_output.mul_add(network.head[head], by_hidden);
                gradient.head[head] = by_output.mul_add(hidden, gradient.head[head]);
            }
            by_hidden = if hidden > 0.0 { by_hidden } else { 0.0 };
            gradient.bias[unit] += by_hidden;
            for k in 0..inputs {
                let by_weight = &mut gradient.weight[k * units + unit];
                *by_weight = network.inputs[row * inputs + k].mul_add(by_hidden, *by_weight);
            }
            if let Some(moment) = network.moments.get(row) {
                gradient.weight[(inputs + *moment as usize) * units + unit] += by_hidden;
            }
        }
    }
}

#[test]
fn both_directions_are_the_plain_loops_to_the_bit_on_every_instruction_set() {
    for case in Case::all() {
        let Case { inputs, units, rows, entries, .. } = case;
        let (moments, name) = (case.moments(), case.name());
        let weight = numbers((inputs + entries) * units, 1);
        let (bias, head) = (numbers(units, 2), numbers(OUTPUTS * units, 3));
        let (given, by_outputs) = (numbers(rows * inputs, 4), numbers(rows * OUTPUTS, 5));
        let start = numbers(OUTPUTS, 6);
        let network = Shallow {
            weight: &weight,
            bias: &bias,
            head: &head,
            inputs: &given,
            moments: &moments,
            rows,
        };
        // A gradient is added to previous values.
        let before = [weight.len(), units, head.len()].map(|len| numbers(len, 7));
        let hidden = hidden(&network, inputs);
        let expected = outputs(&network, &hidden, &start);
        let [mut weight, mut bias, mut head] = before.clone();
        let gradient = ShallowGradient { weight: &mut weight, bias: &mut bias, head: &mut head };
        differentiate(&network, &hidden, &by_outputs, gradient);
        for isa in Isa::available() {
            let mut out = vec![0.0; rows * OUTPUTS];
            network.forward(isa, &start, &mut out);
            assert_eq!(bits(&out), bits(&expected), "{}: {name}", isa.name());
            let [mut by_weight, mut by_bias, mut by_head] = before.clone();
            let gradient =
                ShallowGradient { weight: &mut by_weight, bias: &mut by_bias, head: &mut by_head };
            network.backward(isa, &by_outputs, gradient);
            for (ours, plain) in [(by_weight, &weight), (by_bias, &bias), (by_head, &head)] {
                assert_eq!(bits(&ours), bits(plain), "{}: {name}", isa.name());
            }
        }
    }
}
