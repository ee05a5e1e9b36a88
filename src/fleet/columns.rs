//! Results as a table in Parquet: a row a log, followed by a row an outage and a row a loss of that log.

use std::fs::File;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::{Field, Row};
use parquet::schema::parser::parse_message_type;

use crate::replay::losses::LossRow;
use crate::replay::runner::ReferenceKind;
use crate::replay::sweep::SweepRow;

use super::{FleetError, LogFailure, LogOutcome, NaturalLoss, OutageRow, Provenance, Shard, Unusable};

/// Rows that are written together, and held in memory until then.
const ROWS_A_GROUP: usize = 8192;
/// A file of results is smaller; its description is read at once, bytes.
const MOST_DESCRIPTION: u64 = 64 << 20;

const SCHEMA: &str = "message evaluation {
    required int64 log_index;
    required binary log (utf8);
    required binary kind (utf8);
    optional binary estimator (utf8);
    optional double start_s;
    optional double length_s;
    optional double distance_m;
    optional double start_error_m;
    optional double horizontal_error_end_m;
    optional double horizontal_error_max_m;
    optional double drift_percent;
    optional double altitude_rmse_m;
    optional double sigma_end_m;
    optional double own_error_m;
    optional binary reference (utf8);
    optional binary identity (utf8);
    optional binary format (utf8);
    optional binary autopilot (utf8);
    optional double duration_s;
    optional binary failure (utf8);
    optional binary why (utf8);
}";
const COLUMNS: usize = 21;
/// The first column of what a log's own row tells.
const OF_LOGS: usize = 15;

/// What stands in one place of the table.
#[derive(Clone, Debug, Default, PartialEq)]
enum Cell {
    #[default]
    Null,
    Whole(i64),
    Number(f64),
    Text(String),
}

type Cells = [Cell; COLUMNS];

impl From<Option<f64>> for Cell {
    fn from(value: Option<f64>) -> Self {
        value.map_or(Cell::Null, Cell::Number)
    }
}

impl From<Option<&str>> for Cell {
    fn from(value: Option<&str>) -> Self {
        value.map_or(Cell::Null, |text| Cell::Text(text.to_owned()))
    }
}

impl Cell {
    fn of(field: Field) -> Self {
        match field {
            Field::Long(v) => Cell::Whole(v),
            Field::Double(v) => Cell::Number(v),
            Field::Str(v) => Cell::Text(v),
            _ => Cell::Null,
        }
    }

    fn number(&self) -> Option<f64> {
        if let Cell::Number(v) = self { Some(*v) } else { None }
    }

    fn text(&self) -> Option<&str> {
        if let Cell::Text(v) = self { Some(v) } else { None }
    }

    fn owned(&self) -> Option<String> {
        self.text().map(str::to_owned)
    }
}

fn begin(of: &LogOutcome, kind: &str) -> Cells {
    let mut cells = Cells::default();
    cells[0] = Cell::Whole(of.index as i64);
    cells[1] = Cell::Text(of.log.clone());
    cells[2] = Cell::Text(kind.to_owned());
    cells
}

fn rows_of(outcome: &LogOutcome) -> Vec<Cells> {
    let mut rows = Vec::with_capacity(1 + outcome.rows.len() + outcome.losses.len());
    let mut log = begin(outcome, "log");
    log[OF_LOGS] = Cell::Text(outcome.identity.clone());
    log[OF_LOGS + 1] = outcome.format.as_deref().into();
    log[OF_LOGS + 2] = outcome.autopilot.as_deref().into();
    log[OF_LOGS + 3] = outcome.duration_s.into();
    log[OF_LOGS + 4] = outcome.failure.as_ref().map(|f| f.kind.label()).into();
    log[OF_LOGS + 5] = outcome.failure.as_ref().map(|f| f.why.as_str()).into();
    rows.push(log);
    for OutageRow { estimator, row, .. } in &outcome.rows {
        let mut cells = begin(outcome, "outage");
        cells[3] = Cell::Text(estimator.clone());
        let numbers = [
            Some(row.start_s),
            Some(row.length_s),
            row.distance_m,
            row.start_error_m,
            row.horizontal_error_end_m,
            row.horizontal_error_max_m,
            row.drift_percent,
            row.altitude_rmse_m,
            row.sigma_end_m,
        ];
        for (cell, number) in cells[4..13].iter_mut().zip(numbers) {
            *cell = number.into();
        }
        rows.push(cells);
    }
    for NaturalLoss { estimator, row, .. } in &outcome.losses {
        let mut cells = begin(outcome, "loss");
        cells[3] = Cell::Text(estimator.clone());
        cells[4] = Some(row.start_s).into();
        cells[5] = Some(row.length_s).into();
        cells[8] = row.error_m.into();
        cells[12] = row.sigma_m.into();
        cells[13] = row.own_error_m.into();
        cells[14] = Some(row.reference.label()).into();
        rows.push(cells);
    }
    rows
}

/// Takes a row; `None` where it cannot be one of the table. A log's row begins an outcome, which `done` is given when it is whole.
fn take(cells: &Cells, open: &mut Option<LogOutcome>, mut done: impl FnMut(LogOutcome)) -> Option<()> {
    let (Cell::Whole(index), Some(log), Some(kind)) = (&cells[0], cells[1].text(), cells[2].text()) else {
        return None;
    };
    if kind == "log" {
        let kind = cells[OF_LOGS + 4].text().map(|label| Unusable::of(label).ok_or(())).transpose().ok()?;
        let why = || cells[OF_LOGS + 5].owned().unwrap_or_default();
        let next = LogOutcome {
            index: u64::try_from(*index).ok()?,
            log: log.to_owned(),
            identity: cells[OF_LOGS].owned()?,
            format: cells[OF_LOGS + 1].owned(),
            autopilot: cells[OF_LOGS + 2].owned(),
            duration_s: cells[OF_LOGS + 3].number(),
            failure: kind.map(|kind| LogFailure { kind, why: why() }),
            ..LogOutcome::default()
        };
        if let Some(whole) = open.replace(next) {
            done(whole);
        }
        return Some(());
    }
    let of = open.as_mut().filter(|of| of.log == log)?;
    let (estimator, log) = (cells[3].owned()?, log.to_owned());
    let (start_s, length_s) = (cells[4].number()?, cells[5].number()?);
    match kind {
        "outage" => {
            let row = SweepRow {
                length_s,
                start_s,
                distance_m: cells[6].number(),
                start_error_m: cells[7].number(),
                horizontal_error_end_m: cells[8].number(),
                horizontal_error_max_m: cells[9].number(),
                drift_percent: cells[10].number(),
                altitude_rmse_m: cells[11].number(),
                sigma_end_m: cells[12].number(),
            };
            of.rows.push(OutageRow { log, estimator, row });
        }
        "loss" => {
            let row = LossRow {
                start_s,
                length_s,
                reference: ReferenceKind::of(cells[14].text()?)?,
                error_m: cells[8].number(),
                sigma_m: cells[12].number(),
                own_error_m: cells[13].number(),
            };
            of.losses.push(NaturalLoss { log, estimator, row });
        }
        _ => return None,
    }
    Some(())
}

/// Writes outcomes, in whatever order they are given.
pub struct ResultsWriter<W: Write + Send> {
    writer: SerializedFileWriter<W>,
    waiting: Vec<Cells>,
}

fn failed(e: &ParquetError) -> FleetError {
    FleetError::Io(std::io::Error::other(e.to_string()))
}

impl<W: Write + Send> ResultsWriter<W> {
    /// A table of this shard, whose description tells what it belongs to.
    ///
    /// # Errors
    /// What writing says.
    pub fn new(to: W, batch: &Provenance, shard: Shard) -> Result<Self, FleetError> {
        let told = told(batch, shard);
        let told = told.into_iter().map(|(key, value)| KeyValue::new(key.to_owned(), value)).collect();
        let properties = WriterProperties::builder()
            .set_created_by(concat!("holdover ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(told))
            .build();
        let schema = Arc::new(parse_message_type(SCHEMA).map_err(|e| failed(&e))?);
        let writer = SerializedFileWriter::new(to, schema, Arc::new(properties)).map_err(|e| failed(&e))?;
        Ok(Self { writer, waiting: Vec::with_capacity(ROWS_A_GROUP) })
    }

    /// Adds what came of a log.
    ///
    /// # Errors
    /// What writing says.
    pub fn add(&mut self, outcome: &LogOutcome) -> Result<(), FleetError> {
        self.waiting.extend(rows_of(outcome));
        if self.waiting.len() >= ROWS_A_GROUP { self.write_group() } else { Ok(()) }
    }

    fn write_group(&mut self) -> Result<(), FleetError> {
        let write = || -> Result<(), ParquetError> {
            let mut group = self.writer.next_row_group()?;
            let mut i = 0;
            while let Some(mut column) = group.next_column()? {
                write_column(column.untyped(), self.waiting.iter().map(|row| &row[i]))?;
                column.close()?;
                i += 1;
            }
            group.close()?;
            Ok(())
        };
        let mut write = write;
        write().map_err(|e| failed(&e))?;
        self.waiting.clear();
        Ok(())
    }

    /// Ends the table, and gives back what it was written to.
    ///
    /// # Errors
    /// What writing says.
    pub fn finish(mut self) -> Result<W, FleetError> {
        if !self.waiting.is_empty() {
            self.write_group()?;
        }
        self.writer.into_inner().map_err(|e| failed(&e))
    }
}

fn write_column<'a>(
    column: &mut ColumnWriter<'_>,
    cells: impl Iterator<Item = &'a Cell> + Clone,
) -> Result<(), ParquetError> {
    let levels: Vec<i16> = cells.clone().map(|c| i16::from(*c != Cell::Null)).collect();
    match column {
        ColumnWriter::Int64ColumnWriter(to) => {
            let values: Vec<i64> =
                cells.filter_map(|c| if let Cell::Whole(v) = c { Some(*v) } else { None }).collect();
            to.write_batch(&values, Some(&levels), None)?;
        }
        ColumnWriter::DoubleColumnWriter(to) => {
            let values: Vec<f64> = cells.filter_map(Cell::number).collect();
            to.write_batch(&values, Some(&levels), None)?;
        }
        ColumnWriter::ByteArrayColumnWriter(to) => {
            let values: Vec<ByteArray> = cells.filter_map(Cell::text).map(ByteArray::from).collect();
            to.write_batch(&values, Some(&levels), None)?;
        }
        _ => return Err(ParquetError::General("a column of another type".into())),
    }
    Ok(())
}

/// What the description of a file tells.
fn told(batch: &Provenance, shard: Shard) -> [(&'static str, String); 6] {
    let lengths: Vec<String> = batch.lengths_s.iter().map(f64::to_string).collect();
    [
        ("evaluation.key", batch.key.clone()),
        ("evaluation.lengths_s", lengths.join(",")),
        ("evaluation.program", batch.program.clone()),
        ("evaluation.logs", batch.logs.to_string()),
        ("evaluation.list", batch.list.clone()),
        ("evaluation.shard", shard.to_string()),
    ]
}

/// What those pairs tell, or which is missing or wrong.
fn belonging(pairs: &[KeyValue]) -> Result<(Provenance, Shard), String> {
    let told = |key: &str| {
        let value = pairs.iter().find(|p| p.key == key).and_then(|p| p.value.clone());
        value.ok_or_else(|| format!("{key} is missing"))
    };
    let bad = |key: &str| format!("{key} cannot be read");
    let lengths: Option<Vec<f64>> =
        told("evaluation.lengths_s")?.split(',').map(|l| l.parse().ok()).collect();
    let batch = Provenance {
        key: told("evaluation.key")?,
        lengths_s: lengths.ok_or_else(|| bad("evaluation.lengths_s"))?,
        program: told("evaluation.program")?,
        logs: told("evaluation.logs")?.parse().map_err(|_| bad("evaluation.logs"))?,
        list: told("evaluation.list")?,
    };
    let shard = told("evaluation.shard")?.parse().map_err(|_| bad("evaluation.shard"))?;
    Ok((batch, shard))
}

/// Reads a table.
pub struct ResultsReader {
    file: SerializedFileReader<File>,
    path: PathBuf,
    /// What the results belong to.
    pub batch: Provenance,
    /// Which shard's they are.
    pub shard: Shard,
}

impl ResultsReader {
    /// Opens a file of results.
    ///
    /// # Errors
    /// [`FleetError::Io`]; [`FleetError::NotResults`] where it is something else, or damaged.
    pub fn open(path: &Path) -> Result<Self, FleetError> {
        let file = File::open(path).map_err(|e| crate::files::named(path, &e))?;
        let wrong = |why: String| FleetError::NotResults { path: path.to_owned(), why };
        if file.metadata()?.len() > MOST_DESCRIPTION * 64 {
            return Err(wrong("it is larger than any".into()));
        }
        let file = guarded(path, || SerializedFileReader::new(file))?;
        let metadata = file.metadata().file_metadata();
        let pairs = metadata.key_value_metadata().map(Vec::as_slice).unwrap_or_default();
        let (batch, shard) = belonging(pairs).map_err(wrong)?;
        let schema = parse_message_type(SCHEMA).map_err(|e| wrong(e.to_string()))?;
        if metadata.schema() != &schema {
            return Err(wrong("its columns are others".into()));
        }
        Ok(Self { file, path: path.to_owned(), batch, shard })
    }

    /// Gives every outcome to `to`.
    ///
    /// # Errors
    /// [`FleetError::NotResults`] where the file is damaged; what `to` says.
    pub fn each(&self, mut to: impl FnMut(LogOutcome) -> Result<(), FleetError>) -> Result<(), FleetError> {
        let wrong = |why: String| FleetError::NotResults { path: self.path.clone(), why };
        let mut rows = guarded(&self.path, || self.file.get_row_iter(None))?;
        let mut open = None;
        // One that ends in a panic is not asked again.
        while let Some(row) = guarded(&self.path, || rows.next().transpose())? {
            let mut whole = None;
            take(&cells(row), &mut open, |outcome| whole = Some(outcome))
                .ok_or_else(|| wrong("a row that none of ours is".into()))?;
            whole.map_or(Ok(()), &mut to)?;
        }
        open.map_or(Ok(()), to)
    }
}

/// The schema was compared, so that every column is in its place.
fn cells(row: Row) -> Cells {
    let mut cells = Cells::default();
    for (cell, (_, field)) in cells.iter_mut().zip(row.into_columns()) {
        *cell = Cell::of(field);
    }
    cells
}

/// Does what reads a file that anybody may have written: where the library gives up on it, it is damaged.
fn guarded<T>(path: &Path, read: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, FleetError> {
    let wrong = |why: String| FleetError::NotResults { path: path.to_owned(), why };
    match catch_unwind(AssertUnwindSafe(read)) {
        Ok(done) => done.map_err(|e| wrong(e.to_string())),
        Err(_) => Err(wrong("it is damaged".into())),
    }
}
