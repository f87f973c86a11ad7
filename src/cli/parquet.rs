//! Parquet: an answer as typed columns.
//!
//! In: the declared types of the columns, and the rows of an answer, in which SQLite types every value.
//! Out: a file with one row group. A column of whole numbers is INT64, and a column of numbers is DOUBLE. A
//! column that contains text is a string column, with numbers written as in CSV. So is a column without
//! values whose type is not declared. Every column may contain nulls.

use std::collections::HashMap;
use std::io::{self, Write};
use std::sync::Arc;

use ::parquet::basic::{Compression, LogicalType, Repetition, Type as PhysicalType};
use ::parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use ::parquet::schema::types::{Type, TypePtr};

use crate::cli::output::as_sql;
use crate::store::{ColumnType, SqlValue};

/// Number of rows per call of the encoder.
const BATCH: usize = 8192;

/// The columns of an answer.
pub(super) struct Columns(Vec<Column>);

struct Column {
    name: String,
    /// For each row, 1 if it has a value and 0 if it is null.
    levels: Vec<i16>,
    values: Values,
}

/// The values of a column, without its nulls.
enum Values {
    /// The column has no declared type, and no value so far.
    None,
    Integers(Vec<i64>),
    Reals(Vec<f64>),
    Texts(Texts),
}

/// Texts, each stored once, because the job keys in the views repeat often.
#[derive(Default)]
struct Texts {
    rows: Vec<usize>,
    different: Vec<ByteArray>,
    indices: HashMap<String, usize>,
}

impl Texts {
    /// Numbers as texts.
    fn of(numbers: &[impl ToString]) -> Texts {
        let mut texts = Texts::default();
        numbers.iter().for_each(|number| texts.push(&number.to_string()));
        texts
    }

    fn push(&mut self, text: &str) {
        let index = match self.indices.get(text) {
            Some(index) => *index,
            None => {
                let index = self.different.len();
                self.different.push(ByteArray::from(text));
                self.indices.insert(text.to_owned(), index);
                index
            }
        };
        self.rows.push(index);
    }
}

impl Values {
    /// No values of a declared type.
    fn declared(kind: ColumnType) -> Values {
        match kind {
            ColumnType::Integer => Values::Integers(Vec::new()),
            ColumnType::Real => Values::Reals(Vec::new()),
            ColumnType::Text => Values::Texts(Texts::default()),
            ColumnType::Several | ColumnType::Undeclared => Values::None,
        }
    }

    fn push(&mut self, value: &SqlValue<'_>) {
        match value {
            SqlValue::Null => {}
            SqlValue::Integer(number) => match self {
                Values::None => *self = Values::Integers(vec![*number]),
                Values::Integers(numbers) => numbers.push(*number),
                Values::Reals(numbers) => numbers.push(*number as f64),
                Values::Texts(texts) => texts.push(&number.to_string()),
            },
            SqlValue::Real(number) => match self {
                Values::None => *self = Values::Reals(vec![*number]),
                Values::Integers(wholes) => {
                    let wholes = wholes.iter().map(|whole| *whole as f64);
                    *self = Values::Reals(wholes.chain([*number]).collect());
                }
                Values::Reals(numbers) => numbers.push(*number),
                Values::Texts(texts) => texts.push(&number.to_string()),
            },
            SqlValue::Text(text) => self.push_text(text),
            SqlValue::Blob(bytes) => self.push_text(&as_sql(bytes)),
        }
    }

    /// Adds a text, and converts earlier numbers to texts.
    fn push_text(&mut self, text: &str) {
        let mut texts = match self {
            Values::Texts(texts) => return texts.push(text),
            Values::None => Texts::default(),
            Values::Integers(numbers) => Texts::of(numbers),
            Values::Reals(numbers) => Texts::of(numbers),
        };
        texts.push(text);
        *self = Values::Texts(texts);
    }
}

impl Column {
    fn field(&self) -> Result<TypePtr, ParquetError> {
        let (physical, logical) = match &self.values {
            Values::Integers(_) => (PhysicalType::INT64, None),
            Values::Reals(_) => (PhysicalType::DOUBLE, None),
            Values::Texts(_) | Values::None => {
                (PhysicalType::BYTE_ARRAY, Some(LogicalType::String))
            }
        };
        Type::primitive_type_builder(&self.name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(logical)
            .build()
            .map(Arc::new)
    }

    fn write(&self, mut writer: SerializedColumnWriter<'_>) -> Result<(), ParquetError> {
        match &self.values {
            Values::None => self.batches::<ByteArrayType>(&mut writer, |_| Vec::new())?,
            Values::Integers(numbers) => {
                self.batches::<Int64Type>(&mut writer, |range| numbers[range].to_vec())?;
            }
            Values::Reals(numbers) => {
                self.batches::<DoubleType>(&mut writer, |range| numbers[range].to_vec())?;
            }
            Values::Texts(texts) => self.batches::<ByteArrayType>(&mut writer, |range| {
                texts.rows[range].iter().map(|index| texts.different[*index].clone()).collect()
            })?,
        }
        writer.close()
    }

    /// Writes the column in batches; `values` returns the values of a range, counted without nulls.
    fn batches<T: DataType>(
        &self,
        writer: &mut SerializedColumnWriter<'_>,
        values: impl Fn(std::ops::Range<usize>) -> Vec<T::T>,
    ) -> Result<(), ParquetError> {
        let mut done = 0;
        for levels in self.levels.chunks(BATCH) {
            let end = done + levels.iter().filter(|level| **level == 1).count();
            writer.typed::<T>().write_batch(&values(done..end), Some(levels), None)?;
            done = end;
        }
        Ok(())
    }
}

impl Columns {
    /// Columns of these names, which differ, and of these declared types, without rows.
    pub(super) fn new(names: &[&str], types: &[ColumnType]) -> Columns {
        let column = |(name, kind): (&&str, &ColumnType)| Column {
            name: (*name).to_owned(),
            levels: Vec::new(),
            values: Values::declared(*kind),
        };
        Columns(names.iter().zip(types).map(column).collect())
    }

    /// Adds a row, one value per column.
    pub(super) fn row(&mut self, values: &[SqlValue<'_>]) {
        for (column, value) in self.0.iter_mut().zip(values) {
            column.levels.push(i16::from(*value != SqlValue::Null));
            column.values.push(value);
        }
    }

    /// Writes the rows as a file.
    pub(super) fn write(self, mut out: impl Write) -> io::Result<()> {
        out.write_all(&self.encode().map_err(io::Error::other)?)?;
        out.flush()
    }

    fn encode(self) -> Result<Vec<u8>, ParquetError> {
        let fields: Vec<TypePtr> = self.0.iter().map(Column::field).collect::<Result<_, _>>()?;
        let schema = Type::group_type_builder("answer").with_fields(fields).build()?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by(concat!("jitai ", env!("CARGO_PKG_VERSION")).to_owned())
            .build();
        let mut file =
            SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties))?;
        let mut group = file.next_row_group()?;
        for column in &self.0 {
            let writer = group.next_column()?.expect("a writer for each field");
            column.write(writer)?;
        }
        group.close()?;
        file.into_inner()
    }
}

#[cfg(test)]
mod tests {
    use ::parquet::file::reader::{FileReader, SerializedFileReader};
    use ::parquet::record::Field;

    use super::*;

    /// The physical types and the rows of a file.
    fn read(columns: Columns) -> (Vec<PhysicalType>, Vec<Vec<Field>>) {
        let mut bytes = Vec::new();
        columns.write(&mut bytes).unwrap();
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&bytes).unwrap();
        let reader = SerializedFileReader::new(file).unwrap();
        let schema = reader.metadata().file_metadata().schema_descr_ptr();
        let types = schema.columns().iter().map(|column| column.physical_type()).collect();
        let rows = reader.get_row_iter(None).unwrap().map(Result::unwrap);
        let fields = |row: ::parquet::record::Row| {
            row.get_column_iter().map(|(_, field)| field.clone()).collect()
        };
        (types, rows.map(fields).collect())
    }

    #[test]
    fn a_column_has_the_narrowest_type_that_holds_its_values() {
        let mut columns =
            Columns::new(&["whole", "number", "mixed", "empty"], &[ColumnType::Undeclared; 4]);
        columns.row(&[
            SqlValue::Integer(-3),
            SqlValue::Integer(1),
            SqlValue::Real(0.5),
            SqlValue::Null,
        ]);
        columns.row(&[SqlValue::Null, SqlValue::Real(2.5), SqlValue::Text("[1]"), SqlValue::Null]);
        let (types, rows) = read(columns);
        let text = PhysicalType::BYTE_ARRAY;
        assert_eq!(types, [PhysicalType::INT64, PhysicalType::DOUBLE, text, text]);
        let string = |text: &str| Field::Str(text.to_owned());
        assert_eq!(
            rows,
            [
                vec![Field::Long(-3), Field::Double(1.0), string("0.5"), Field::Null],
                vec![Field::Null, Field::Double(2.5), string("[1]"), Field::Null],
            ]
        );
    }

    #[test]
    fn many_rows_with_nulls_among_them_come_back_as_they_were() {
        let mut columns = Columns::new(&["n", "word"], &[ColumnType::Undeclared; 2]);
        let rows = 2 * BATCH as i64 + 7;
        for row in 0..rows {
            let word = format!("word {}", row % 3);
            let number = if row % 5 == 0 { SqlValue::Null } else { SqlValue::Integer(row) };
            columns.row(&[number, SqlValue::Text(&word)]);
        }
        let (_, found) = read(columns);
        assert_eq!(found.len() as i64, rows);
        for (row, fields) in (0..).zip(found) {
            let number = if row % 5 == 0 { Field::Null } else { Field::Long(row) };
            assert_eq!(fields, [number, Field::Str(format!("word {}", row % 3))]);
        }
    }

    #[test]
    fn a_column_without_values_has_its_declared_type_and_values_widen_it() {
        use ColumnType::{Integer, Real, Several, Text};
        let names = ["whole", "number", "text", "several"];
        let types = [Integer, Real, Text, Several];
        let [text, long, double] =
            [PhysicalType::BYTE_ARRAY, PhysicalType::INT64, PhysicalType::DOUBLE];
        let mut columns = Columns::new(&names, &types);
        assert_eq!(read(Columns::new(&names, &types)).0, [long, double, text, text]);
        columns.row(&[SqlValue::Null; 4]);
        assert_eq!(read(columns).0, [long, double, text, text]);
        let mut columns = Columns::new(&names, &types);
        columns.row(&[
            SqlValue::Real(0.5),
            SqlValue::Integer(2),
            SqlValue::Integer(3),
            SqlValue::Real(1.5),
        ]);
        let (types, rows) = read(columns);
        assert_eq!(types, [double, double, text, double]);
        let three = Field::Str("3".to_owned());
        assert_eq!(rows, [[Field::Double(0.5), Field::Double(2.0), three, Field::Double(1.5)]]);
    }
}
