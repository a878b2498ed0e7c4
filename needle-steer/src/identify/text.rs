//! Tables as programs write them: separators, comments, line ends, byte-order marks, quotes.

use super::column::{self, Header, Quantity};

/// A row's cells and the line they stand in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Line {
    /// Counted from 1.
    pub(super) number: usize,
    pub(super) cells: Vec<String>,
}

/// A table of text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Text {
    pub(super) header: Line,
    pub(super) rows: Vec<Line>,
    pub(super) separator: Separator,
}

/// A problem and its line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Problem {
    pub(super) line: usize,
    pub(super) text: String,
}

/// What stands between cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Character(char),
    /// Any number of blanks and tabs.
    Blanks,
}

/// Lines before the names of the columns in which other programs may speak of themselves.
const PREAMBLE: usize = 50;
/// Names that are known make a line the header behind such lines, from so many on.
const CLEARLY_HEADER: usize = 4;

const SEPARATORS: [Separator; 5] = [
    Separator::Character('\t'),
    Separator::Character(';'),
    Separator::Character('|'),
    Separator::Character(','),
    Separator::Blanks,
];

impl Text {
    /// Reads a table whose columns are among those that are `known`.
    pub(super) fn read(bytes: &[u8], known: &[Quantity]) -> Result<Self, Problem> {
        let text = decoded(bytes)?;
        let mut chosen = None;
        let mut header = None;
        let mut commented = None;
        let mut rows = Vec::new();
        let preamble = preamble(&text, known);
        for (k, line) in lines(&text).enumerate() {
            let (number, line) = (k + 1, line.trim());
            if let Some(mark) = line.strip_prefix("sep=") {
                chosen = mark.chars().next().map(Separator::Character);
                continue;
            }
            if let Some(comment) = comment(line) {
                if header.is_none() {
                    commented = Some((number, comment));
                }
                continue;
            }
            if line.is_empty() || k < preamble {
                continue;
            }
            let failed = |text| Problem { line: number, text };
            let Some((_, separator)) = &header else {
                let separator = chosen.unwrap_or_else(|| best_separator(line, known));
                let cells = split(line, separator).map_err(failed)?;
                // numpy.savetxt writes the header as a comment.
                let numbers = cells.iter().all(|cell| is_number(cell));
                if let (true, Some((at, comment))) = (numbers, commented) {
                    let names = split(comment, separator).map_err(failed)?;
                    if names.len() == cells.len() && recognised(&names, known) > 0 {
                        header = Some((line_of(at, names), separator));
                        rows.push(line_of(number, cells));
                        continue;
                    }
                }
                if numbers {
                    return Err(failed(
                        "expected the names of the columns, found numbers; docs/LOGS.md lists the names"
                            .to_owned(),
                    ));
                }
                header = Some((line_of(number, cells), separator));
                continue;
            };
            rows.push(line_of(number, split(line, *separator).map_err(failed)?));
        }
        let (header, separator) = header.ok_or_else(|| Problem {
            line: 1,
            text: "expected the names of the columns, found nothing; docs/LOGS.md lists them"
                .to_owned(),
        })?;
        let mut table = Self {
            header,
            rows,
            separator,
        };
        table.check_widths()?;
        Ok(table)
    }

    /// Drops cells behind a separator at the end of all lines; every row must then be as wide as
    /// the header.
    fn check_widths(&mut self) -> Result<(), Problem> {
        let mut width = self.header.cells.len();
        if width > 1 && self.header.cells.last().is_some_and(String::is_empty) {
            self.header.cells.pop();
            width -= 1;
        }
        for row in &mut self.rows {
            if row.cells.len() == width + 1 && row.cells.last().is_some_and(String::is_empty) {
                row.cells.pop();
            }
            let found = row.cells.len();
            if found != width {
                let hint = match self.separator {
                    _ if found == 1 && width > 2 => {
                        "; separate its cells as those of the header, or remove the line"
                    }
                    Separator::Character(',') if found > width => {
                        "; decimal commas need `;` or a tab between cells, and `points_m` may need quotes"
                    }
                    Separator::Character(';') if found > width => {
                        "; `points_m` needs quotes where `;` separates cells"
                    }
                    _ => "; complete the row or remove it",
                };
                return Err(Problem {
                    line: row.number,
                    text: format!("expected {width} cells as in the header, found {found}{hint}"),
                });
            }
        }
        Ok(())
    }
}

/// Lines before the header, where the first line is none and a later one clearly is.
fn preamble(text: &str, known: &[Quantity]) -> usize {
    let known = |line: &str| {
        let cells = split(line.trim(), best_separator(line.trim(), known));
        cells.map_or(0, |cells| recognised(&cells, known))
    };
    let mut first = lines(text).take(PREAMBLE).enumerate();
    let header = first.find(|(_, line)| comment(line.trim()).is_none() && known(line) > 0);
    match header {
        Some((k, line)) if known(line) >= CLEARLY_HEADER => k,
        _ => 0,
    }
}

const fn line_of(number: usize, cells: Vec<String>) -> Line {
    Line { number, cells }
}

/// UTF-8, or UTF-16 as spreadsheets write "Unicode text"; without a byte-order mark, and without
/// the mark that old systems end a file with.
fn decoded(bytes: &[u8]) -> Result<String, Problem> {
    let pairs = |rest: &[u8], join: fn([u8; 2]) -> u16| {
        let units = rest.as_chunks().0.iter().map(|pair| join(*pair));
        char::decode_utf16(units)
            .map(|unit| unit.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect()
    };
    let text: String = match bytes {
        [0xff, 0xfe, rest @ ..] => pairs(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => pairs(rest, u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [first, 0, ..] if *first != 0 => pairs(bytes, u16::from_le_bytes),
        [0, first, ..] if *first != 0 => pairs(bytes, u16::from_be_bytes),
        _ => String::from_utf8_lossy(bytes).into_owned(),
    };
    let text = text.trim_end_matches('\u{1a}').to_owned();
    if let Some(at) = text.find('\0') {
        return Err(Problem {
            line: lines(&text[..at]).count().max(1),
            text: "expected text, found a zero byte; is this a binary file?".to_owned(),
        });
    }
    Ok(text)
}

/// Lines that end with LF, CRLF or CR alone.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.split('\n').flat_map(|line| {
        // CR before LF belongs to it; CR inside ends a line of its own.
        line.strip_suffix('\r').unwrap_or(line).split('\r')
    })
}

fn comment(line: &str) -> Option<&str> {
    let line = line.trim_start_matches('"');
    ["#", "%", "//"]
        .into_iter()
        .find_map(|mark| line.strip_prefix(mark))
        .map(str::trim)
}

/// The separator that gives most columns that are known, then most columns.
fn best_separator(header: &str, known: &[Quantity]) -> Separator {
    let rated = SEPARATORS.map(|separator| {
        let cells = split(header, separator).unwrap_or_default();
        (recognised(&cells, known), cells.len(), separator)
    });
    // The first of equals: blanks only where nothing else separates.
    let mut best = rated[0];
    for one in rated {
        if (one.0, one.1) > (best.0, best.1)
            && (one.0 > best.0 || best.1 == 1 || one.2 != Separator::Blanks)
        {
            best = one;
        }
    }
    best.2
}

fn recognised(cells: &[String], known: &[Quantity]) -> usize {
    cells
        .iter()
        .filter(|cell| matches!(column::understand(cell, known), Ok(Header::Known(..))))
        .count()
}

fn is_number(cell: &str) -> bool {
    cell.replace(',', ".").parse::<f64>().is_ok()
}

/// The cells of a line; quotes around a cell protect separators, doubled ones are one.
fn split(line: &str, separator: Separator) -> Result<Vec<String>, String> {
    let mut cells = Vec::new();
    let mut letters = line.chars().peekable();
    loop {
        while letters
            .next_if(|c| *c == ' ' || (separator == Separator::Blanks && *c == '\t'))
            .is_some()
        {}
        let mut cell = String::new();
        if letters.next_if_eq(&'"').is_some() {
            loop {
                match letters.next() {
                    Some('"') if letters.next_if_eq(&'"').is_none() => break,
                    Some(letter) => cell.push(letter),
                    None => return Err("expected a closing quote in this line".to_owned()),
                }
            }
        }
        let mut ended = true;
        for letter in letters.by_ref() {
            let separates = match separator {
                Separator::Character(mark) => letter == mark,
                Separator::Blanks => letter == ' ' || letter == '\t',
            };
            if separates {
                ended = false;
                break;
            }
            cell.push(letter);
        }
        let kept = cell.trim();
        cells.push(kept.to_owned());
        if ended {
            return Ok(cells);
        }
        // Blanks at the end of a line begin no further cell.
        if separator == Separator::Blanks && letters.clone().all(char::is_whitespace) {
            return Ok(cells);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(text: &str) -> Vec<Vec<String>> {
        let table = Text::read(text.as_bytes(), &column::KNOWN).unwrap();
        table.rows.into_iter().map(|row| row.cells).collect()
    }

    #[test]
    fn every_usual_separator_gives_the_same_cells() {
        let expected = [["0", "1.5"], ["1", "2.5"]];
        for text in [
            "t_s,tip_x_m\n0,1.5\n1,2.5\n",
            "t_s;tip_x_m\n0;1.5\n1;2.5",
            "t_s\ttip_x_m\n0\t1.5\n1\t2.5\n",
            "t_s  tip_x_m\n0   1.5 \n 1 \t 2.5\n",
            "sep=;\nt_s;tip_x_m\n0;1.5\n1;2.5\n",
            "t_s,tip_x_m,\n0,1.5,\n1,2.5,\n",
            "\u{feff}t_s,tip_x_m\n# a note\n0,1.5\n\n1,2.5\n",
            "# t_s tip_x_m\n0 1.5\n1 2.5\n",
            "\"t_s\",\"tip_x_m\"\n\"0\",\"1.5\"\n1,2.5\n",
            "t_s,tip_x_m\r0,1.5\r1,2.5\r",
            "t_s|tip_x_m\n0|1.5\n1|2.5\n",
            "t_s,tip_x_m\n0,1.5\n1,2.5\n\u{1a}",
        ] {
            assert_eq!(cells(text), expected, "{text:?}");
        }
        let bare = "t_s\ttip_x_m\n0\t1.5\n1\t2.5\n".encode_utf16();
        let bare: Vec<u8> = bare.flat_map(u16::to_be_bytes).collect();
        assert_eq!(
            Text::read(&bare, &column::KNOWN).unwrap().rows[1].cells,
            expected[1]
        );
        let utf16: Vec<u8> = "\u{feff}t_s\ttip_x_m\r\n0\t1.5\r\n1\t2.5\r\n"
            .encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect();
        let table = Text::read(&utf16, &column::KNOWN).unwrap();
        assert_eq!(table.rows[1].cells, expected[1]);
    }

    #[test]
    fn lines_are_counted_as_editors_count_them() {
        for end in ["\n", "\r\n", "\r"] {
            let text = ["# note", "t_s,tip_x_m", "", "0,1", "1,2"].join(end);
            let table = Text::read(text.as_bytes(), &column::KNOWN).unwrap();
            let numbers: Vec<usize> = table.rows.iter().map(|row| row.number).collect();
            assert_eq!((table.header.number, numbers), (2, vec![4, 5]), "{end:?}");
        }
    }

    #[test]
    fn what_a_program_says_before_the_header_is_passed_over() {
        let header = "t_s,tip_x_m,tip_y_m,tip_z_m";
        let text = format!("Made by LabRecorder, v2\nDate: 2026-01-05\n\n{header}\n0,1,2,3\n");
        let table = Text::read(text.as_bytes(), &column::KNOWN).unwrap();
        assert_eq!((table.header.number, table.rows[0].number), (4, 5));
        // Names of which few are known are the header, and are told.
        let table = Text::read(b"time,tip_x_m\n0,1\n", &column::KNOWN).unwrap();
        assert_eq!(table.header.cells, ["time", "tip_x_m"]);
    }

    #[test]
    fn quotes_protect_separators() {
        let text = "t_s;points_m\n0;\"1 2 3;4 5 6\"\n1;\"a \"\"b\"\"\"\n";
        assert_eq!(cells(text), [["0", "1 2 3;4 5 6"], ["1", "a \"b\""]]);
    }

    #[test]
    fn malformed_tables_are_refused_with_their_line() {
        for (text, line, expected) in [
            ("", 1, "found nothing"),
            ("0,1\n1,2\n", 1, "found numbers"),
            (
                "t_s,tip_x_m\n0,1\n1\n",
                3,
                "expected 2 cells as in the header, found 1",
            ),
            ("t_s,tip_x_m\n0,1,5,0\n", 2, "decimal commas need `;`"),
            ("t_s;points_m\n0;1 2 3;4 5 6\n", 2, "needs quotes"),
            ("t_s,tip_x_m\n0,\"1\n", 2, "closing quote"),
            ("t_s,tip_x_m\n0,1\n\0\0\n", 3, "binary"),
            (
                "t_s;tip_x_m;tip_y_m\n0,1,2\n",
                2,
                "separate its cells as those of the header",
            ),
        ] {
            let problem = Text::read(text.as_bytes(), &column::KNOWN).unwrap_err();
            assert_eq!(problem.line, line, "{text:?}: {problem:?}");
            assert!(problem.text.contains(expected), "{problem:?}");
        }
    }
}
