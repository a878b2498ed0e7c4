//! A table of typed columns in SI units, read from text.

use std::path::{Path, PathBuf};

use nalgebra::{Point3, Vector3};
use rosbridge::log::FileKind;

use super::column::{self, Header, Quantity};
use super::text::{Separator, Text};

/// A table that cannot be used: what, where, and what was expected.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file cannot be read.
    #[error("{}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file holds no table.
    #[error("{}: {}, not a table; {}", file.display(), kind.name(), kind.remedy())]
    Kind {
        /// The file.
        file: PathBuf,
        /// What it is.
        kind: FileKind,
    },
    /// A line, a column or a value.
    #[error("{}:{line}: {problem}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What was found and what was expected; a column by its name in the file.
        problem: String,
    },
    /// Columns that are missing.
    #[error(
        "{}: the columns {missing} are missing; docs/LOGS.md lists them", file.display()
    )]
    Columns {
        /// The file.
        file: PathBuf,
        /// Their names.
        missing: String,
    },
}

/// A table of a recording: columns by quantity, numbers in SI units.
#[derive(Clone, Debug)]
pub(super) struct Table {
    file: PathBuf,
    known: &'static [Quantity],
    columns: Vec<Column>,
    lines: Vec<usize>,
}

#[derive(Clone, Debug)]
struct Column {
    /// As the file has it.
    header: String,
    quantity: Quantity,
    cells: Cells,
}

#[derive(Clone, Debug)]
enum Cells {
    Numbers(Vec<Option<f64>>),
    Points(Vec<Vec<Point3<f64>>>),
}

/// What to do with a table that holds a recording in a form of its own.
fn of_many(header: &[String]) -> Option<&'static str> {
    let has = |name: &str| header.iter().any(|cell| cell == name);
    if has("Timestamp nanosec") || has("AuroraTip x") {
        Some(
            "a recording of topics, several streams side by side: write the settled steps as a table of its own, one \
             row a step (docs/REAL_NEEDLES.md, \"From a recording to a table\")",
        )
    } else if has("trial") {
        Some(
            "several insertions (column `trial`): write a table for each of them (docs/REAL_NEEDLES.md, \"From a \
             recording to a table\")",
        )
    } else {
        None
    }
}

impl Table {
    /// Reads a table of a recording; see [`Table::read_of`].
    pub(super) fn read(file: &Path) -> Result<Self, TableError> {
        Self::read_of(file, &column::KNOWN)
    }

    /// Reads a table of columns that are `known`. Unknown columns, cells that are no numbers and columns that say the same
    /// twice are refused; empty cells are unknown values.
    pub(super) fn read_of(file: &Path, known: &'static [Quantity]) -> Result<Self, TableError> {
        if file.is_dir() {
            let kind = FileKind::Folder;
            return Err(TableError::Kind {
                file: file.to_owned(),
                kind,
            });
        }
        let bytes = std::fs::read(file).map_err(|source| TableError::Read {
            file: file.to_owned(),
            source,
        })?;
        match FileKind::of(&bytes[..bytes.len().min(16)]) {
            FileKind::Text => {}
            kind => {
                return Err(TableError::Kind {
                    file: file.to_owned(),
                    kind,
                });
            }
        }
        let text = Text::read(&bytes, known).map_err(|p| value(file, p.line, p.text))?;
        if let Some(problem) = of_many(&text.header.cells) {
            return Err(value(file, text.header.number, problem.to_owned()));
        }
        let mut table = Self {
            file: file.to_owned(),
            known,
            columns: Vec::new(),
            lines: text.rows.iter().map(|row| row.number).collect(),
        };
        let mut decimals = Decimals::of(text.separator);
        for (k, header) in text.header.cells.iter().enumerate() {
            let at_header = |problem| value(file, text.header.number, problem);
            let Header::Known(quantity, factor) =
                column::understand(header, known).map_err(at_header)?
            else {
                continue;
            };
            if let Some(other) = table.columns.iter().find(|c| c.quantity == quantity) {
                return Err(at_header(format!(
                    "columns `{}` and `{header}` say the same; remove one",
                    other.header
                )));
            }
            let mut cells = Cells::of(quantity);
            for row in &text.rows {
                let cell = row.cells.get(k).map_or("", String::as_str);
                let unknown = quantity.is_optional() && is_unknown(cell);
                let cell = if unknown { "" } else { cell };
                cells
                    .push(cell, factor, &mut decimals, row.number)
                    .map_err(|problem| match problem {
                        Wrong::Number(found) => {
                            format!(
                                "expected a finite number, found `{found}`; {}",
                                quantity.remedy()
                            )
                        }
                        Wrong::Other(problem) => problem,
                    })
                    .map_err(|problem| value(file, row.number, format!("{header}: {problem}")))?;
            }
            table.columns.push(Column {
                header: header.clone(),
                quantity,
                cells,
            });
        }
        Ok(table)
    }

    /// Refuses a table without the columns named.
    pub(super) fn require(&self, names: &[&str]) -> Result<(), TableError> {
        let missing: Vec<String> = self
            .known
            .iter()
            .filter(|quantity| names.contains(&quantity.name) && !self.has(quantity.name))
            .map(|quantity| quantity.header())
            .collect();
        if missing.is_empty() {
            return Ok(());
        }
        Err(TableError::Columns {
            file: self.file.clone(),
            missing: missing.join(", "),
        })
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.column(name).is_some()
    }

    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// The rows in order.
    pub(super) fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.lines.len()).map(|index| Row { table: self, index })
    }

    fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|c| c.quantity.name == name)
    }
}

/// One row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<'a> {
    table: &'a Table,
    index: usize,
}

impl Row<'_> {
    /// Line in the file, from 1.
    pub(super) fn line(&self) -> usize {
        self.table.lines[self.index]
    }

    /// A number in SI units; none where the column is missing or the cell empty.
    pub(super) fn optional(&self, name: &str) -> Option<f64> {
        match &self.table.column(name)?.cells {
            Cells::Numbers(numbers) => numbers.get(self.index).copied().flatten(),
            Cells::Points(_) => None,
        }
    }

    /// A number in SI units that must be there.
    pub(super) fn number(&self, name: &str) -> Result<f64, TableError> {
        self.optional(name).ok_or_else(|| {
            self.problem(
                name,
                "expected a finite number, found an empty cell; complete the row or remove it",
            )
        })
    }

    /// Three numbers of which all must be there.
    pub(super) fn vector(&self, names: [&str; 3]) -> Result<Vector3<f64>, TableError> {
        let [x, y, z] = names;
        Ok(Vector3::new(
            self.number(x)?,
            self.number(y)?,
            self.number(z)?,
        ))
    }

    /// A list of points \[m\]; empty where there is none.
    pub(super) fn points(&self, name: &str) -> &[Point3<f64>] {
        match self.table.column(name).map(|column| &column.cells) {
            Some(Cells::Points(lists)) => lists.get(self.index).map_or(&[], Vec::as_slice),
            _ => &[],
        }
    }

    /// An error about a column of this row, named as the file names it.
    pub(super) fn problem(&self, name: &str, problem: &str) -> TableError {
        let header = self.table.column(name).map_or(name, |c| c.header.as_str());
        value(
            &self.table.file,
            self.line(),
            format!("{header}: {problem}"),
        )
    }
}

fn value(file: &Path, line: usize, problem: String) -> TableError {
    TableError::Value {
        file: file.to_owned(),
        line,
        problem,
    }
}

impl Cells {
    const fn of(quantity: Quantity) -> Self {
        if quantity.is_list {
            Self::Points(Vec::new())
        } else {
            Self::Numbers(Vec::new())
        }
    }

    fn push(
        &mut self,
        cell: &str,
        factor: f64,
        decimals: &mut Decimals,
        line: usize,
    ) -> Result<(), Wrong> {
        match self {
            Self::Numbers(numbers) if cell.is_empty() => numbers.push(None),
            Self::Numbers(numbers) => numbers.push(Some(decimals.number(cell, line)? * factor)),
            Self::Points(lists) => lists.push(points(cell, factor, decimals, line)?),
        }
        Ok(())
    }
}

/// What other programs write for no value.
fn is_unknown(cell: &str) -> bool {
    const WORDS: [&str; 6] = ["nan", "na", "n/a", "null", "none", "-"];
    WORDS.contains(&cell.to_lowercase().as_str())
}

/// What is wrong with a cell.
enum Wrong {
    /// It is no finite number.
    Number(String),
    /// In words.
    Other(String),
}

/// Points as `x y z;x y z;...`.
fn points(
    cell: &str,
    factor: f64,
    decimals: &mut Decimals,
    line: usize,
) -> Result<Vec<Point3<f64>>, Wrong> {
    cell.split(';')
        .filter(|point| !point.trim().is_empty())
        .map(|point| {
            let numbers: Vec<f64> = point
                .split_whitespace()
                .map(|number| decimals.number(number, line))
                .collect::<Result<_, _>>()?;
            match numbers.as_slice() {
                &[x, y, z] => Ok(Point3::new(x, y, z) * factor),
                _ => Err(Wrong::Other(format!(
                    "expected `x y z;x y z`, found `{point}`"
                ))),
            }
        })
        .collect()
}

/// Decimal points or decimal commas: one kind in a file.
#[derive(Debug)]
struct Decimals {
    /// Whether commas may stand in numbers at all.
    commas: bool,
    /// The first number with each kind, and its line.
    point: Option<(String, usize)>,
    comma: Option<(String, usize)>,
}

impl Decimals {
    fn of(separator: Separator) -> Self {
        Self {
            commas: separator != Separator::Character(','),
            point: None,
            comma: None,
        }
    }

    fn number(&mut self, cell: &str, line: usize) -> Result<f64, Wrong> {
        let comma = self.commas && cell.contains(',');
        // The minus sign of typesetters, and the exponent that Fortran writes.
        let mut text = cell.replace('\u{2212}', "-");
        if text.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c)) {
            text = text.replacen(['d', 'D'], "e", 1);
        }
        if comma {
            text = text.replacen(',', ".", 1);
        }
        let number = text
            .parse::<f64>()
            .ok()
            .filter(|number| number.is_finite())
            .ok_or_else(|| Wrong::Number(cell.to_owned()))?;
        if comma {
            self.comma.get_or_insert_with(|| (cell.to_owned(), line));
        } else if cell.contains('.') {
            self.point.get_or_insert_with(|| (cell.to_owned(), line));
        }
        match (&self.point, &self.comma) {
            (Some((point, at)), Some((comma, other))) => Err(Wrong::Other(format!(
                "a file has decimal points or decimal commas, found `{point}` in line {at} and `{comma}` in line {other}"
            ))),
            _ => Ok(number),
        }
    }
}
