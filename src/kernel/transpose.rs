//! Transposition.

/// Rows and columns moved at a time, so that what is read and written stays in cache.
const BLOCK: usize = 16;

/// Copies `from`, \[rows, columns\] in rows `from_stride` apart, into `to`, \[columns, rows\] in rows
/// `to_stride` apart.
pub fn transpose(
    from: &[f32],
    from_stride: usize,
    (rows, columns): (usize, usize),
    to: &mut [f32],
    to_stride: usize,
) {
    for first_row in (0..rows).step_by(BLOCK) {
        for first_column in (0..columns).step_by(BLOCK) {
            for column in first_column..(first_column + BLOCK).min(columns) {
                let last = (first_row + BLOCK).min(rows);
                let to = &mut to[column * to_stride + first_row..column * to_stride + last];
                let from = from[first_row * from_stride + column..].iter().step_by(from_stride);
                to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_columns() {
        for (rows, columns) in [(1, 1), (3, 5), (16, 16), (17, 40)] {
            let (from_stride, to_stride) = (columns + 2, rows + 3);
            let from: Vec<f32> = (0..rows * from_stride).map(|i| i as f32).collect();
            let mut to = vec![-1.0; columns * to_stride];
            transpose(&from, from_stride, (rows, columns), &mut to, to_stride);
            for row in 0..rows {
                for column in 0..columns {
                    assert_eq!(to[column * to_stride + row], from[row * from_stride + column]);
                }
            }
            assert_eq!(to.iter().filter(|v| **v == -1.0).count(), columns * 3);
        }
    }
}
