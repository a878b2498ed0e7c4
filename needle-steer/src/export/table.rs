//! The time series by columns.

use std::io::Write;
use std::time::Duration;

use crate::series::{COLUMNS, Cell, Row};

/// Name of the column of wall-clock time.
const WALL: &str = "unix_s";

/// A column: numbers, of which those not known are none, or words.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    Numbers(Vec<Option<f64>>),
    Words(Vec<String>),
}

/// A column and its name.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Column {
    pub(super) name: &'static str,
    pub(super) values: Values,
}

/// The columns of `series.csv`, and the wall-clock time since the epoch of each row; that is not known
/// where the run does not say when it `began`.
pub(super) fn columns(rows: &[Row], began: Option<Duration>) -> Vec<Column> {
    let cells: Vec<_> = rows.iter().map(Row::cells).collect();
    let mut columns: Vec<Column> = COLUMNS
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let column = cells.iter().map(|row| &row[i]);
            let words: Option<Vec<String>> = column.clone().map(words).collect();
            let values = match words {
                Some(words) if !words.is_empty() => Values::Words(words),
                _ => Values::Numbers(column.map(number).collect()),
            };
            Column { name, values }
        })
        .collect();
    let wall = |row: &Row| began.map(|began| began.as_secs_f64() + row.t_s);
    columns.push(Column {
        name: WALL,
        values: Values::Numbers(rows.iter().map(wall).collect()),
    });
    columns
}

fn words(cell: &Cell) -> Option<String> {
    match cell {
        Cell::Words(words) => Some(words.clone()),
        Cell::Number(_) => None,
    }
}

fn number(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Number(number) if number.is_finite() => Some(*number),
        _ => None,
    }
}

/// As CSV; what is not known is an empty field.
pub(super) fn write_csv(columns: &[Column], mut writer: impl Write) -> std::io::Result<()> {
    let names: Vec<&str> = columns.iter().map(|column| column.name).collect();
    writeln!(writer, "{}", names.join(","))?;
    let rows = columns.first().map_or(0, |column| match &column.values {
        Values::Numbers(numbers) => numbers.len(),
        Values::Words(words) => words.len(),
    });
    for row in 0..rows {
        for (i, column) in columns.iter().enumerate() {
            if i > 0 {
                writer.write_all(b",")?;
            }
            match &column.values {
                Values::Numbers(numbers) => {
                    if let Some(number) = numbers[row] {
                        write!(writer, "{number}")?;
                    }
                }
                Values::Words(words) => writer.write_all(words[row].as_bytes())?,
            }
        }
        writer.write_all(b"\n")?;
    }
    writer.flush()
}
