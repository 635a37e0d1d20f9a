//! Strict CSV tables: named columns of numbers and words, errors that name file, line and column.

mod header;

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::input::{self, Lines};
use header::Header;

/// The most rows a table may have; a guard against feeding the wrong file.
const MAX_ROWS: usize = 20_000_000;

/// The largest number a cell may hold: squares and products of what is beyond are no numbers any more.
const MOST: f64 = 1e15;
/// The largest angle, degrees: a table turned a hundred times one way.
pub(crate) const MOST_DEG: f64 = 3.6e4;
/// The highest temperature of a machine or its surroundings, °C.
const MOST_C: f64 = 2e3;

/// A CSV file held as text cells, addressed by column name.
#[derive(Debug, Clone)]
pub struct Table {
    path: PathBuf,
    names: Vec<String>,
    index: HashMap<String, usize>,
    rows: Vec<(u64, csv::StringRecord)>,
}

impl Table {
    /// Reads `path`. Every name in `required` must be a column; columns must be in `required` or
    /// `optional`, or end `optional` with a `*` pattern such as `head_*_c`, or begin with `x_`/`x-`.
    /// Lines that begin with `#` are comments; columns without a cell are none, unless they are required.
    pub fn read(path: impl AsRef<Path>, required: &[&str], optional: &[&str]) -> Result<Self> {
        let path = path.as_ref();
        Self::parse(path, input::bytes(path, input::MOST_TABLE)?, required, optional)
    }

    /// As [`Table::read`], from bytes; `path` is only the name used in messages.
    pub fn parse(
        path: impl AsRef<Path>,
        bytes: impl Into<Vec<u8>>,
        required: &[&str],
        optional: &[&str],
    ) -> Result<Self> {
        let path = path.as_ref();
        let mut text = input::utf8(path, bytes.into())?;
        // The reader ends a comment by a line feed alone.
        if !text.contains('\n') {
            text = text.replace('\r', "\n");
        }
        let mut reader = csv::ReaderBuilder::new()
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .flexible(true)
            .from_reader(text.as_bytes());
        let mut lines = Lines::new(text.as_bytes());
        let record = reader.headers().map_err(|e| csv_error(path, e))?.clone();
        let header_line = lines.line_at(record_start(text.as_bytes(), 0));
        let header = Header { path, line: header_line, required, optional };
        let mut names = header.names(&record)?;
        let mut index = header.index(&names)?;
        let mut rows = Vec::new();
        for record in reader.records() {
            let mut record = record.map_err(|e| csv_error(path, e))?;
            // A blank line may hold blanks.
            if record.len() == 1 && record[0].is_empty() {
                continue;
            }
            let start = record.position().map_or(0, |p| p.byte() as usize);
            let line = lines.line_at(record_start(text.as_bytes(), start));
            check_length(path, line, &record, names.len())?;
            record.truncate(names.len());
            if rows.len() >= MAX_ROWS {
                return Err(Error::file(
                    path,
                    format!("has more than {MAX_ROWS} rows"),
                    "split the file",
                ));
            }
            rows.push((line, record));
        }
        if rows.is_empty() {
            return Err(Error::file(
                path,
                "has a header but no rows",
                "add at least one row of data",
            ));
        }
        // What may be left out may be left empty.
        let empty = |at: usize| rows.iter().all(|(_, r)| r.get(at).is_none_or(str::is_empty));
        index.retain(|name, at| required.contains(&name.as_str()) || !empty(*at));
        names.retain(|name| index.contains_key(name));
        Ok(Self { path: path.to_owned(), names, index, rows })
    }

    /// Leaves out all rows but these, in their order.
    pub fn keep(&mut self, rows: &[usize]) {
        let mut kept = rows.iter().peekable();
        let mut row = 0..;
        self.rows.retain(|_| kept.next_if_eq(&&row.next().unwrap_or_default()).is_some());
    }

    /// Number of rows, at least one.
    pub fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The file's name, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The columns in file order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Whether the column is there.
    pub fn has(&self, name: &str) -> bool {
        self.index.contains_key(name)
    }

    /// The line of the file on which `row` stands.
    pub fn line(&self, row: usize) -> u64 {
        self.rows[row].0
    }

    /// An error about one cell.
    pub fn error(
        &self,
        row: usize,
        name: &str,
        reason: impl Into<String>,
        fix: impl Into<String>,
    ) -> Error {
        Error::field(&self.path, Some(self.line(row)), format!("column '{name}'"), reason, fix)
    }

    /// Directions must be -1, 0 or 1; says so where zeros look like the other direction.
    pub fn check_directions(
        &self,
        name: &str,
        values: &[f64],
        warnings: &mut Vec<String>,
    ) -> Result<()> {
        let count = |d: f64| values.iter().filter(|v| **v == d).count();
        if count(-1.0) == 0 && count(1.0) > 0 && 5 * count(0.0) > values.len() {
            warnings.push(format!(
                "column '{name}' has 0 and 1 and no -1: 0 means that the axis did not move; write -1 where it came down"
            ));
        }
        match values.iter().position(|v| ![-1.0, 0.0, 1.0].contains(v)) {
            None => Ok(()),
            Some(row) => Err(self.error(
                row,
                name,
                format!("is {}, not a direction", values[row]),
                "write 1 where the axis came up to its place, -1 where it came down, 0 where it did not move",
            )),
        }
    }

    /// The cell's text; empty where the column is missing.
    pub fn text(&self, row: usize, name: &str) -> &str {
        self.index.get(name).and_then(|&i| self.rows[row].1.get(i)).unwrap_or("")
    }

    /// What a row says, by column; a number is one however it is written.
    pub fn cells(&self, row: usize) -> Vec<(&str, String)> {
        let names = self.names.iter();
        names
            .map(|name| {
                let text = self.text(row, name);
                (
                    name.as_str(),
                    text.parse().map_or_else(|_| text.to_owned(), |v: f64| v.to_string()),
                )
            })
            .collect()
    }

    /// The cell as a finite number.
    pub fn number(&self, row: usize, name: &str) -> Result<f64> {
        let text = self.text(row, name);
        let shown = shortened(text);
        let value: f64 = text.parse().map_err(|_| {
            let hint = if text.contains(',') {
                "write the decimal mark as a point"
            } else {
                "write a number"
            };
            match text {
                "" => self.error(row, name, "is empty", "fill the cell in, or remove the row"),
                _ => self.error(row, name, format!("'{shown}' is not a number"), hint),
            }
        })?;
        if !value.is_finite() {
            return Err(self.error(
                row,
                name,
                format!("'{shown}' is not finite"),
                "remove the row or measure it again",
            ));
        }
        let most = match name.rsplit_once('_') {
            Some((_, "deg")) => MOST_DEG,
            Some((what, "c")) if what != "dir" => MOST_C,
            _ => MOST,
        };
        if value.abs() > most {
            return Err(self.error(
                row,
                name,
                format!("'{shown}' is beyond anything that is measured"),
                "remove the row or measure it again",
            ));
        }
        Ok(value)
    }

    /// A whole column of finite numbers.
    pub fn column(&self, name: &str) -> Result<Vec<f64>> {
        (0..self.rows()).map(|r| self.number(r, name)).collect()
    }

    /// A whole column, or `None` where the column is missing.
    pub fn optional_column(&self, name: &str) -> Result<Option<Vec<f64>>> {
        if self.has(name) { self.column(name).map(Some) } else { Ok(None) }
    }
}

/// A cell as a message shows it: nobody reads a thousand characters.
fn shortened(text: &str) -> Cow<'_, str> {
    const MOST: usize = 40;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => Cow::Owned(format!("{}…", &text[..end])),
        None => Cow::Borrowed(text),
    }
}

/// Checks that a row has as many fields as there are names; empty ones may follow.
fn check_length(path: &Path, line: u64, record: &csv::StringRecord, names: usize) -> Result<()> {
    let mut filled = record.len();
    while filled > 0 && record[filled - 1].is_empty() {
        filled -= 1;
    }
    if record.len() >= names && filled <= names {
        return Ok(());
    }
    let fields = filled.max(record.len().min(names));
    let fix = if fields > names {
        "leave out what is too much (a decimal comma parts a number in two: write a point)"
    } else {
        "complete the row (a run killed half way leaves such a line at the end)"
    };
    let reason = format!("has {fields} fields where the header has {names}");
    Err(Error::field(path, Some(line), "row", reason, fix))
}

/// Where a record begins, seen from where the one before it ended: empty lines and comments are skipped.
fn record_start(bytes: &[u8], mut at: usize) -> usize {
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'\n' | b'\r' => at += 1,
            b'#' => at += bytes[at..].iter().take_while(|&&b| b != b'\n').count(),
            _ => break,
        }
    }
    at
}

fn csv_error(path: &Path, error: csv::Error) -> Error {
    Error::file(path, format!("is not readable as CSV ({error})"), "save it as plain CSV (UTF-8)")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Table> {
        Table::parse("t.csv", text, &["a_mm"], &["b", "head_*_c"])
    }

    #[test]
    fn cells_are_found_by_name_and_comments_skipped() {
        let t = parse("# from the control\nb,a_mm,head_12_c,x_note\nup,1.5,20,hello\n").unwrap();
        assert_eq!(t.number(0, "a_mm").unwrap(), 1.5);
        assert_eq!(t.text(0, "b"), "up");
        assert_eq!(t.line(0), 3);
    }

    #[test]
    fn empty_columns_at_the_end_are_none() {
        let t = parse("\u{feff}a_mm,b,,\n1,2\n3,,,\n5,6,,,,\n").unwrap();
        assert_eq!((t.names().len(), t.rows(), t.text(2, "b")), (2, 3, "6"));
    }

    #[test]
    fn blank_lines_are_no_rows() {
        let t = parse("a_mm,b\n1,2\n \t\n  \n5,6\n\n").unwrap();
        assert_eq!((t.rows(), t.number(1, "a_mm").unwrap(), t.line(1)), (2, 5.0, 5));
    }

    #[test]
    fn rows_keep_their_lines_whatever_stands_before_them() {
        for end in ["\n", "\r\n"] {
            let lines = ["# a", "", "a_mm,b", "1,2", "", "# b", "3,\"x\n\ny\"", "5,6", ""];
            let t = parse(&lines.join(end)).unwrap();
            assert_eq!([t.line(0), t.line(1), t.line(2)], [4, 7, 10], "{end:?}");
        }
        assert_eq!(parse("a_mm\r1\r2\r").unwrap().line(1), 3);
    }

    #[test]
    fn every_error_names_file_line_and_column() {
        for (text, words) in [
            ("", "t.csv: the file is empty"),
            ("a_mm\n", "no rows"),
            ("b\n1\n", "column 'a_mm': is missing"),
            ("a_mm,c\n1,2\n", "column 'c': is not known"),
            ("a_mm;b\n1,0;2\n", "t.csv:1: header: its columns are separated by ';'"),
            ("a_mm\tb\n1\t2\n", "separated by '\\t'"),
            ("a_mm,a_mm\n1,2\n", "stands twice"),
            ("a_mm,,b\n1,2,3\n", "t.csv:1: header: its column 2 has no name"),
            ("a_mm,b\n1,2\n1\n", "t.csv:3: row: has 1 fields"),
            ("a_mm,b\n1,2,,7\n", "t.csv:2: row: has 4 fields"),
            ("# from\r\n\r\nb\r\n1\r\n", "t.csv:3: column 'a_mm': is missing"),
            ("a_mm\r\n1\r\n# so\r\n\r\n1,2\r\n", "t.csv:5: row: has 2 fields"),
        ] {
            let message = parse(text).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
        let turns = Table::parse("t.csv", "a_deg\n720\n4e4\n", &["a_deg"], &[]).unwrap();
        assert!(
            turns
                .column("a_deg")
                .unwrap_err()
                .to_string()
                .starts_with("t.csv:3: column 'a_deg': '4e4' is beyond")
        );
        let t = parse("a_mm\n1\nNaN\n").unwrap();
        assert!(
            t.column("a_mm")
                .unwrap_err()
                .to_string()
                .starts_with("t.csv:3: column 'a_mm': 'NaN' is not finite")
        );
    }
}
