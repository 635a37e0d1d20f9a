//! What a command hands out: files written whole or not at all, and results as JSON, JSON lines, CSV or a table.

mod files;

use serde_json::Value;

pub use files::*;

/// How a result is printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Lines for people.
    Table,
    /// One JSON object.
    Json,
    /// One JSON object a line.
    Jsonl,
    /// Comma-separated values with a header.
    Csv,
}

/// A result in every form it can be printed in.
#[derive(Debug, Clone)]
pub struct Document {
    /// The whole result as one object.
    pub json: Value,
    /// The same as rows, for JSON lines and CSV; one row where the result is one thing.
    pub rows: Vec<Value>,
    /// The same for people.
    pub table: String,
}

impl Document {
    /// A document whose rows are its one object.
    pub fn single(json: Value, table: String) -> Self {
        Self { rows: vec![json.clone()], json, table }
    }

    /// The text in the asked format, ending in a newline.
    pub fn text(&self, format: Format) -> String {
        match format {
            Format::Table => with_newline(self.table.clone()),
            Format::Json => {
                with_newline(serde_json::to_string_pretty(&self.json).unwrap_or_default())
            }
            Format::Jsonl => self.rows.iter().map(|r| format!("{r}\n")).collect(),
            Format::Csv => csv_text(&self.rows),
        }
    }
}

fn with_newline(mut text: String) -> String {
    if !text.is_empty() && !text.ends_with('\n') {
        text.push('\n');
    }
    text
}

/// Rows as CSV: nested keys joined with `.`, list items by number; a column wherever any row has it.
pub fn csv_text(rows: &[Value]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let flat: Vec<Vec<(String, &Value)>> = rows.iter().map(flatten).collect();
    let mut names: Vec<&str> = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for (name, _) in flat.iter().flatten() {
        if seen.insert(name.as_str()) {
            names.push(name);
        }
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Writing to memory cannot fail.
    let _ = writer.write_record(&names);
    for cells in &flat {
        let _ = writer.write_record(csv_record(&names, cells));
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

/// A row's cells as CSV text in the order of the columns; empty where the row has none.
pub fn csv_record<N: AsRef<str>>(names: &[N], cells: &[(String, &Value)]) -> Vec<String> {
    let by_name: std::collections::HashMap<&str, &Value> =
        cells.iter().map(|(n, v)| (n.as_str(), *v)).collect();
    let text = |name: &N| match by_name.get(name.as_ref()) {
        None | Some(Value::Null) => String::new(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    };
    names.iter().map(text).collect()
}

/// The leaves of a JSON value with their paths: keys joined with `.`, list items by number.
pub fn flatten(value: &Value) -> Vec<(String, &Value)> {
    fn walk<'v>(prefix: &str, value: &'v Value, cells: &mut Vec<(String, &'v Value)>) {
        let join =
            |key: &str| if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") };
        match value {
            Value::Object(map) => map.iter().for_each(|(k, v)| walk(&join(k), v, cells)),
            Value::Array(list) => {
                list.iter().enumerate().for_each(|(i, v)| walk(&join(&i.to_string()), v, cells));
            }
            leaf => cells.push((prefix.to_owned(), leaf)),
        }
    }
    let mut cells = Vec::new();
    walk("", value, &mut cells);
    cells
}

/// Text for XML and HTML, in elements and attributes. Control characters, which XML does not know, become blanks.
pub fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            c if c.is_control() && c != '\n' => safe.push(' '),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn csv_has_a_column_for_every_key_of_any_row() {
        let rows =
            [serde_json::json!({"a": 1, "p": {"q": [2.5, null]}}), serde_json::json!({"b": "x,y"})];
        assert_eq!(csv_text(&rows), "a,p.q.0,p.q.1,b\n1,2.5,,\n,,,\"x,y\"\n");
    }
}
