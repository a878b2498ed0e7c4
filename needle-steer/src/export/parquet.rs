//! The table as Parquet: a column of optional doubles or of texts each, one row group.

use std::io::Write;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::table::{Column, Values};

/// Writes the columns.
pub(super) fn write(columns: &[Column], file: impl Write + Send) -> Result<(), ParquetError> {
    let fields: Vec<_> = columns.iter().map(field).collect::<Result<_, _>>()?;
    let schema = Type::group_type_builder("run")
        .with_fields(fields)
        .build()?;
    let properties = Arc::new(WriterProperties::builder().build());
    let mut out = SerializedFileWriter::new(file, Arc::new(schema), properties)?;
    let mut rows = out.next_row_group()?;
    for column in columns {
        let Some(mut writer) = rows.next_column()? else {
            break;
        };
        match &column.values {
            Values::Numbers(numbers) => {
                let levels: Vec<i16> = numbers.iter().map(|n| i16::from(n.is_some())).collect();
                let known: Vec<f64> = numbers.iter().copied().flatten().collect();
                writer
                    .typed::<DoubleType>()
                    .write_batch(&known, Some(&levels), None)?;
            }
            Values::Words(words) => {
                let words: Vec<ByteArray> = words.iter().map(|w| w.as_str().into()).collect();
                writer
                    .typed::<ByteArrayType>()
                    .write_batch(&words, None, None)?;
            }
        }
        writer.close()?;
    }
    rows.close()?;
    out.close()?;
    Ok(())
}

fn field(column: &Column) -> Result<Arc<Type>, ParquetError> {
    let built = match &column.values {
        Values::Numbers(_) => Type::primitive_type_builder(column.name, Physical::DOUBLE)
            .with_repetition(Repetition::OPTIONAL)
            .build(),
        Values::Words(_) => Type::primitive_type_builder(column.name, Physical::BYTE_ARRAY)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(Some(LogicalType::String))
            .build(),
    };
    built.map(Arc::new)
}
