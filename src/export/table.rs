//! A table in a file: comma-separated values, or Parquet.

use std::fmt;
use std::io;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as PhysicalType};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use super::rows::{Column, ColumnKind, RowValue};
use crate::files::{OutputFile, Overwrite, READABLE};

/// How a table is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableFormat {
    /// Comma-separated values; what is not known is empty.
    Csv,
    /// Parquet, compressed with Snappy; what is not known is null.
    Parquet,
}

impl TableFormat {
    /// How a file's name ends.
    pub const fn extension(self) -> &'static str {
        match self {
            TableFormat::Csv => "csv",
            TableFormat::Parquet => "parquet",
        }
    }
}

/// Rows that are written together, and held in memory until then.
const ROWS_A_GROUP: usize = 8192;

/// A table that is being written.
pub struct TableFile {
    columns: &'static [Column],
    to: Writer,
}

enum Writer {
    Csv(Box<csv::Writer<OutputFile>>),
    Parquet { file: Box<SerializedFileWriter<OutputFile>>, waiting: Vec<Vec<RowValue>> },
}

impl fmt::Debug for TableFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TableFile").field("columns", &self.columns.len()).finish_non_exhaustive()
    }
}

fn failed(e: ParquetError) -> io::Error {
    match e {
        ParquetError::External(e) => io::Error::other(e),
        e => io::Error::other(e.to_string()),
    }
}

impl TableFile {
    /// Begins a table at `path`.
    ///
    /// # Errors
    /// What is in its place, or the system's word.
    pub fn create(
        path: &Path,
        format: TableFormat,
        columns: &'static [Column],
        force: bool,
    ) -> io::Result<Self> {
        let file = OutputFile::create(path, Overwrite::forced(force), READABLE)?;
        let to = match format {
            TableFormat::Csv => {
                let mut file = csv::Writer::from_writer(file);
                file.write_record(columns.iter().map(|c| c.0))?;
                Writer::Csv(Box::new(file))
            }
            TableFormat::Parquet => {
                let properties = WriterProperties::builder()
                    .set_created_by(concat!("holdover ", env!("CARGO_PKG_VERSION")).to_owned())
                    .set_compression(Compression::SNAPPY)
                    .build();
                let schema = schema(columns).map_err(failed)?;
                let file = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties));
                Writer::Parquet { file: Box::new(file.map_err(failed)?), waiting: Vec::new() }
            }
        };
        Ok(Self { columns, to })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// What writing says.
    pub(super) fn row(&mut self, row: &[RowValue]) -> io::Result<()> {
        match &mut self.to {
            Writer::Csv(file) => Ok(file.write_record(row.iter().map(text))?),
            Writer::Parquet { file, waiting } => {
                waiting.push(row.to_vec());
                if waiting.len() >= ROWS_A_GROUP {
                    write_group(file, waiting).map_err(failed)
                } else {
                    Ok(())
                }
            }
        }
    }

    /// Puts the whole table in its place.
    ///
    /// # Errors
    /// What writing says.
    pub fn finish(self) -> io::Result<()> {
        match self.to {
            Writer::Csv(file) => file.into_inner().map_err(|e| e.into_error())?.finish(),
            Writer::Parquet { mut file, mut waiting } => {
                if !waiting.is_empty() {
                    write_group(&mut file, &mut waiting).map_err(failed)?;
                }
                file.into_inner().map_err(failed)?.finish()
            }
        }
    }
}

fn text(value: &RowValue) -> String {
    match value {
        RowValue::Unknown => String::new(),
        RowValue::Number(v) => format!("{v:.6}"),
        RowValue::Count(v) => v.to_string(),
        RowValue::Words(v) => v.clone(),
    }
}

fn schema(columns: &[Column]) -> Result<Type, ParquetError> {
    let fields = columns.iter().map(|(name, kind)| {
        let (physical, logical) = match kind {
            ColumnKind::Number => (PhysicalType::DOUBLE, None),
            ColumnKind::Count => (PhysicalType::INT64, None),
            ColumnKind::Words => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let field = Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(logical);
        Ok(Arc::new(field.build()?))
    });
    Type::group_type_builder("flight").with_fields(fields.collect::<Result<_, ParquetError>>()?).build()
}

fn write_group(
    file: &mut SerializedFileWriter<OutputFile>,
    rows: &mut Vec<Vec<RowValue>>,
) -> Result<(), ParquetError> {
    let mut group = file.next_row_group()?;
    let mut i = 0;
    while let Some(mut column) = group.next_column()? {
        let cells = rows.iter().filter_map(|row| row.get(i));
        let levels: Vec<i16> = cells.clone().map(|c| i16::from(*c != RowValue::Unknown)).collect();
        match column.untyped() {
            ColumnWriter::DoubleColumnWriter(to) => {
                let values: Vec<f64> =
                    cells.filter_map(|c| if let RowValue::Number(v) = c { Some(*v) } else { None }).collect();
                to.write_batch(&values, Some(&levels), None)?;
            }
            ColumnWriter::Int64ColumnWriter(to) => {
                let values: Vec<i64> = cells
                    .filter_map(|c| if let RowValue::Count(v) = c { i64::try_from(*v).ok() } else { None })
                    .collect();
                to.write_batch(&values, Some(&levels), None)?;
            }
            ColumnWriter::ByteArrayColumnWriter(to) => {
                let values: Vec<ByteArray> = cells
                    .filter_map(|c| if let RowValue::Words(v) = c { Some(v.as_str().into()) } else { None })
                    .collect();
                to.write_batch(&values, Some(&levels), None)?;
            }
            _ => return Err(ParquetError::General("a column of another type".into())),
        }
        column.close()?;
        i += 1;
    }
    group.close()?;
    rows.clear();
    Ok(())
}
