//! Matrix transposition.

/// The number of rows and columns moved at a time, so that both blocks stay in cache.
const BLOCK: usize = 16;
/// The number of rows of a block that are read in parallel.
const SIDE: usize = 4;

/// Copies `from`, \[rows, columns\] with row stride `from_stride`, transposed into `to`, \[columns, rows\]
/// with row stride `to_stride`.
pub fn transpose(
    from: &[f32],
    from_stride: usize,
    (rows, columns): (usize, usize),
    to: &mut [f32],
    to_stride: usize,
) {
    assert!(rows == 0 || from.len() >= (rows - 1) * from_stride + columns, "every row");
    assert!(columns == 0 || to.len() >= (columns - 1) * to_stride + rows, "room for every column");
    for first_row in (0..rows).step_by(BLOCK) {
        for first_column in (0..columns).step_by(BLOCK) {
            let last_column = columns.min(first_column + BLOCK);
            let of_row = |row: usize| &from[row * from_stride..][first_column..last_column];
            let to = &mut to[first_column * to_stride..];
            let end = rows.min(first_row + BLOCK);
            let mut row = first_row;
            while row + SIDE <= end {
                let side: [&[f32]; SIDE] = std::array::from_fn(|i| of_row(row + i));
                for (column, to) in to.chunks_mut(to_stride).take(side[0].len()).enumerate() {
                    to[row..row + SIDE].copy_from_slice(&side.map(|line| line[column]));
                }
                row += SIDE;
            }
            while row < end {
                for (to, from) in to.chunks_mut(to_stride).zip(of_row(row)) {
                    to[row] = *from;
                }
                row += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_become_columns() {
        for (rows, columns) in [(1, 1), (3, 5), (7, 5), (16, 16), (17, 40), (22, 19)] {
            let (from_stride, to_stride) = (columns + 2, rows + 3);
            let all = (rows - 1) * from_stride + columns;
            let from: Vec<f32> = (0..all).map(|i| i as f32).collect();
            let mut to = vec![-1.0; (columns - 1) * to_stride + rows];
            transpose(&from, from_stride, (rows, columns), &mut to, to_stride);
            for row in 0..rows {
                for column in 0..columns {
                    assert_eq!(to[column * to_stride + row], from[row * from_stride + column]);
                }
            }
            assert_eq!(to.iter().filter(|v| **v == -1.0).count(), (columns - 1) * 3);
        }
    }
}
