//! Writes flat tables as Apache Parquet: optional columns, plain encoding, no compression.
//!
//! The format's own library takes longer to compile than the rest of the program to write these few
//! structures (<https://parquet.apache.org/docs/file-format/>), so they are written here.

use std::io::{self, Write};

const MAGIC: &[u8; 4] = b"PAR1";
/// Rows held in memory before they are written as one row group.
pub const ROWS_PER_GROUP: usize = 65_536;

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `true` or `false`.
    Boolean,
    /// Whole numbers.
    Integer,
    /// Numbers.
    Double,
    /// UTF-8 text.
    Text,
}

/// One cell; `None` in a row is a null.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// For a [`Kind::Boolean`] column.
    Boolean(bool),
    /// For a [`Kind::Integer`] column.
    Integer(i64),
    /// For a [`Kind::Double`] column.
    Double(f64),
    /// For a [`Kind::Text`] column.
    Text(String),
}

/// A Parquet file being written.
pub struct Writer<W: Write> {
    sink: W,
    offset: u64,
    columns: Vec<(String, Kind)>,
    pending: Vec<Vec<Option<Cell>>>,
    groups: Vec<Group>,
}

struct Group {
    rows: usize,
    chunks: Vec<Chunk>,
}

struct Chunk {
    offset: u64,
    bytes: usize,
}

impl<W: Write> Writer<W> {
    /// Starts a file with these columns.
    pub fn new(mut sink: W, columns: Vec<(String, Kind)>) -> io::Result<Self> {
        sink.write_all(MAGIC)?;
        let pending = vec![Vec::new(); columns.len()];
        Ok(Self { sink, offset: MAGIC.len() as u64, columns, pending, groups: Vec::new() })
    }

    /// Adds a row, a cell for each column; a cell of another kind than its column's becomes null.
    pub fn row(&mut self, cells: impl IntoIterator<Item = Option<Cell>>) -> io::Result<()> {
        let mut cells = cells.into_iter();
        for ((_, kind), column) in self.columns.iter().zip(&mut self.pending) {
            column.push(cells.next().flatten().filter(|c| c.kind() == *kind));
        }
        if self.pending.first().is_some_and(|c| c.len() >= ROWS_PER_GROUP) {
            self.flush_group()?;
        }
        Ok(())
    }

    /// Writes what is pending and the footer, and hands the sink back.
    pub fn finish(mut self) -> io::Result<W> {
        self.flush_group()?;
        let footer = self.footer();
        self.sink.write_all(&footer)?;
        self.sink.write_all(&(footer.len() as u32).to_le_bytes())?;
        self.sink.write_all(MAGIC)?;
        Ok(self.sink)
    }

    fn flush_group(&mut self) -> io::Result<()> {
        let rows = self.pending.first().map_or(0, Vec::len);
        if rows == 0 {
            return Ok(());
        }
        let mut chunks = Vec::new();
        for column in &mut self.pending {
            let page = page(column);
            self.sink.write_all(&page)?;
            chunks.push(Chunk { offset: self.offset, bytes: page.len() });
            self.offset += page.len() as u64;
            column.clear();
        }
        self.groups.push(Group { rows, chunks });
        Ok(())
    }

    /// `FileMetaData`.
    fn footer(&self) -> Vec<u8> {
        let mut t = Thrift::default();
        t.int(1, I32, 1);
        t.list(2, STRUCT, self.columns.len() + 1);
        t.open();
        t.text(4, "rows");
        t.int(5, I32, self.columns.len() as i64);
        t.close();
        for (name, kind) in &self.columns {
            t.open();
            t.int(1, I32, kind.physical());
            t.int(3, I32, 1); // optional
            t.text(4, name);
            if *kind == Kind::Text {
                t.int(6, I32, 0); // UTF8
            }
            t.close();
        }
        t.int(3, I64, self.groups.iter().map(|g| g.rows as i64).sum());
        t.list(4, STRUCT, self.groups.len());
        for group in &self.groups {
            t.open();
            t.list(1, STRUCT, group.chunks.len());
            for ((name, kind), chunk) in self.columns.iter().zip(&group.chunks) {
                t.open();
                t.int(2, I64, chunk.offset as i64);
                t.field(3, STRUCT);
                t.open();
                t.int(1, I32, kind.physical());
                t.list(2, I32, 2);
                t.zigzag(0); // PLAIN
                t.zigzag(3); // RLE
                t.list(3, BINARY, 1);
                t.bytes(name.as_bytes());
                t.int(4, I32, 0); // uncompressed
                t.int(5, I64, group.rows as i64);
                t.int(6, I64, chunk.bytes as i64);
                t.int(7, I64, chunk.bytes as i64);
                t.int(9, I64, chunk.offset as i64);
                t.close();
                t.close();
            }
            t.int(2, I64, group.chunks.iter().map(|c| c.bytes as i64).sum());
            t.int(3, I64, group.rows as i64);
            t.close();
        }
        t.text(6, concat!("pivotsight ", env!("CARGO_PKG_VERSION")));
        t.out.push(0);
        t.out
    }
}

impl Kind {
    fn physical(self) -> i64 {
        match self {
            Self::Boolean => 0,
            Self::Integer => 2,
            Self::Double => 5,
            Self::Text => 6,
        }
    }
}

impl Cell {
    fn kind(&self) -> Kind {
        match self {
            Self::Boolean(_) => Kind::Boolean,
            Self::Integer(_) => Kind::Integer,
            Self::Double(_) => Kind::Double,
            Self::Text(_) => Kind::Text,
        }
    }
}

/// A data page with its header: which cells are there, then those that are.
fn page(column: &[Option<Cell>]) -> Vec<u8> {
    let mut levels = Vec::new();
    varint(&mut levels, ((column.len().div_ceil(8) as u64) << 1) | 1);
    bits(&mut levels, column.iter().map(Option::is_some));
    let mut data = (levels.len() as u32).to_le_bytes().to_vec();
    data.extend(levels);
    let present = || column.iter().flatten();
    bits(
        &mut data,
        present().filter_map(|c| if let Cell::Boolean(b) = c { Some(*b) } else { None }),
    );
    for cell in present() {
        match cell {
            Cell::Boolean(_) => {}
            Cell::Integer(i) => data.extend(i.to_le_bytes()),
            Cell::Double(x) => data.extend(x.to_le_bytes()),
            Cell::Text(text) => {
                data.extend((text.len() as u32).to_le_bytes());
                data.extend(text.as_bytes());
            }
        }
    }
    let mut t = Thrift::default();
    t.int(1, I32, 0); // data page
    t.int(2, I32, data.len() as i64);
    t.int(3, I32, data.len() as i64);
    t.field(5, STRUCT);
    t.open();
    t.int(1, I32, column.len() as i64);
    t.int(2, I32, 0); // PLAIN
    t.int(3, I32, 3); // RLE
    t.int(4, I32, 3);
    t.close();
    t.out.push(0);
    t.out.extend(data);
    t.out
}

/// Packs bits eight to a byte, the first in the lowest bit.
fn bits(out: &mut Vec<u8>, values: impl Iterator<Item = bool>) {
    for (i, bit) in values.enumerate() {
        if i % 8 == 0 {
            out.push(0);
        }
        if let Some(last) = out.last_mut() {
            *last |= u8::from(bit) << (i % 8);
        }
    }
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

const I32: u8 = 5;
const I64: u8 = 6;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const STRUCT: u8 = 12;

/// Thrift's compact protocol, as much of it as a footer needs.
#[derive(Default)]
struct Thrift {
    out: Vec<u8>,
    last: u8,
    outer: Vec<u8>,
}

impl Thrift {
    fn field(&mut self, id: u8, kind: u8) {
        self.out.push((id - self.last) << 4 | kind);
        self.last = id;
    }

    fn open(&mut self) {
        self.outer.push(std::mem::take(&mut self.last));
    }

    fn close(&mut self) {
        self.out.push(0);
        self.last = self.outer.pop().unwrap_or(0);
    }

    fn int(&mut self, id: u8, kind: u8, value: i64) {
        self.field(id, kind);
        self.zigzag(value);
    }

    fn text(&mut self, id: u8, value: &str) {
        self.field(id, BINARY);
        self.bytes(value.as_bytes());
    }

    fn list(&mut self, id: u8, kind: u8, len: usize) {
        self.field(id, LIST);
        if len < 15 {
            self.out.push((len as u8) << 4 | kind);
        } else {
            self.out.push(0xf0 | kind);
            varint(&mut self.out, len as u64);
        }
    }

    fn zigzag(&mut self, value: i64) {
        varint(&mut self.out, ((value << 1) ^ (value >> 63)) as u64);
    }

    fn bytes(&mut self, value: &[u8]) {
        varint(&mut self.out, value.len() as u64);
        self.out.extend(value);
    }
}
