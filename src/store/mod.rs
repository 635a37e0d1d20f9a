//! Records: every measurement in one SQLite file, with what it takes to trust or repeat it.
//!
//! Several programs may write at once (ten seconds of patience). Files of older versions are
//! brought up to date when they are opened; files of newer versions are refused.

pub mod drift;
pub mod keep;
mod select;

pub use select::{Filter, Selected, select};

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, OpenFlags, Row, TransactionBehavior, params};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::{Error, Result, missing};
use crate::output::check_writable;

/// Steps from each version of the file to the next; `PRAGMA user_version` counts the steps taken.
const MIGRATIONS: [&str; 2] = [
    "CREATE TABLE records (
        id INTEGER PRIMARY KEY,
        time_utc TEXT NOT NULL,
        command TEXT NOT NULL,
        input TEXT NOT NULL,
        input_sha256 TEXT,
        calib TEXT,
        calib_sha256 TEXT,
        options TEXT NOT NULL,
        version TEXT NOT NULL,
        verdict TEXT,
        result TEXT NOT NULL
     ) STRICT;
     CREATE INDEX records_time ON records (time_utc);",
    // Which batch a record came from, so that a resumed batch is not recorded twice.
    "ALTER TABLE records ADD COLUMN batch TEXT;
     CREATE UNIQUE INDEX records_batch ON records (batch, input) WHERE batch IS NOT NULL;",
];

/// One measurement as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Record {
    /// When, UTC.
    pub time_utc: String,
    /// The command that measured.
    pub command: String,
    /// The picture or file.
    pub input: String,
    /// Its SHA-256, where it is a file.
    pub input_sha256: Option<String>,
    /// The calibration file.
    pub calib: Option<String>,
    /// Its SHA-256.
    pub calib_sha256: Option<String>,
    /// The command line.
    pub options: String,
    /// The program's version.
    pub version: String,
    /// `pass`, `fail` or `undecided`, where a limit applied.
    pub verdict: Option<String>,
    /// The batch it belongs to.
    pub batch: Option<String>,
    /// The whole result.
    pub result: Value,
}

/// An open records file.
pub struct Store {
    path: PathBuf,
    connection: Connection,
}

impl Store {
    /// Opens or creates the file and brings it up to date.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::connect(path.as_ref())
    }

    /// Whether records can be kept there, as far as that can be told before there are any: nothing is left behind.
    pub fn check(path: &Path) -> Result<()> {
        check_writable(path)?;
        if path.exists() { Self::open(path).map(drop) } else { Ok(()) }
    }

    /// As [`Store::open`], but a missing file is an error.
    pub fn open_existing(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        // An empty file is none yet; reading is no reason to make one.
        if !path.is_file() || path.metadata().is_ok_and(|m| m.len() == 0) {
            let fix = if path.exists() { "correct the path".into() } else { missing(path) };
            let fix = format!("measure with --records FILE first, or: {fix}");
            return Err(Error::file(path, "there are no records", fix));
        }
        // One of today's format is only read: it may be write-protected.
        match Self::to_read(path) {
            Ok(Some(store)) => Ok(store),
            _ => Self::connect(path),
        }
    }

    fn to_read(path: &Path) -> rusqlite::Result<Option<Self>> {
        let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
        connection.busy_timeout(Duration::from_secs(10))?;
        let version: u32 = connection.pragma_query_value(None, "user_version", |r| r.get(0))?;
        let current = version as usize == MIGRATIONS.len();
        Ok(current.then(|| Self { path: path.to_owned(), connection }))
    }

    fn connect(path: &Path) -> Result<Self> {
        let failed = |e| sqlite(path, e);
        let mut connection = Connection::open(path).map_err(failed)?;
        connection.busy_timeout(Duration::from_secs(10)).map_err(failed)?;
        // Two programs may open an old file at the same moment: one migrates, the other waits and finds it done.
        let transaction =
            connection.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failed)?;
        let version: u32 =
            transaction.pragma_query_value(None, "user_version", |r| r.get(0)).map_err(failed)?;
        let version = version as usize;
        if version > MIGRATIONS.len() {
            return Err(Error::file(
                path,
                format!("was written by a newer version (format {version})"),
                "update this program",
            ));
        }
        let tables: u32 = transaction
            .query_row("SELECT count(*) FROM sqlite_master", [], |r| r.get(0))
            .map_err(failed)?;
        if (version == 0) != (tables == 0) {
            return Err(Error::file(
                path,
                "is another program's database",
                "give a file made by --records, or a new name",
            ));
        }
        for step in &MIGRATIONS[version..] {
            transaction.execute_batch(step).map_err(failed)?;
        }
        transaction.pragma_update(None, "user_version", MIGRATIONS.len() as u32).map_err(failed)?;
        transaction.commit().map_err(failed)?;
        Ok(Self { path: path.to_owned(), connection })
    }

    /// Adds records, all or none. One whose batch and input are there already is left out; returns how many were new.
    pub fn add(&mut self, records: impl IntoIterator<Item = Result<Record>>) -> Result<usize> {
        let failed = |e| sqlite(&self.path, e);
        let transaction = self
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)
            .map_err(failed)?;
        let mut new = 0;
        {
            let mut insert = transaction
                .prepare(
                    "INSERT OR IGNORE INTO records (time_utc, command, input, input_sha256, calib, calib_sha256,
                     options, version, verdict, batch, result) VALUES (?,?,?,?,?,?,?,?,?,?,?)",
                )
                .map_err(failed)?;
            for record in records {
                let r = record?;
                new += insert
                    .execute(params![
                        r.time_utc,
                        r.command,
                        r.input,
                        r.input_sha256,
                        r.calib,
                        r.calib_sha256,
                        r.options,
                        r.version,
                        r.verdict,
                        r.batch,
                        r.result.to_string()
                    ])
                    .map_err(failed)?;
            }
        }
        transaction.commit().map_err(failed)?;
        Ok(new)
    }

    /// How many records there are of each command.
    pub fn commands(&self) -> Result<Vec<(String, usize)>> {
        let failed = |e| sqlite(&self.path, e);
        let text = "SELECT command, count(*) FROM records GROUP BY command ORDER BY command";
        let mut query = self.connection.prepare(text).map_err(failed)?;
        let rows = query.query_map([], |r| Ok((r.get(0)?, r.get::<_, u32>(1)? as usize)));
        rows.map_err(failed)?.collect::<rusqlite::Result<_>>().map_err(failed)
    }

    /// Reads records, oldest first.
    pub fn read(&self, filter: &Filter) -> Result<Vec<Record>> {
        let failed = |e| sqlite(&self.path, e);
        let mut query = self
            .connection
            .prepare(
                "SELECT * FROM (SELECT * FROM records
                   WHERE (?1 IS NULL OR command = ?1) AND (?2 IS NULL OR instr(input, ?2) > 0)
                     AND (?3 IS NULL OR verdict = ?3) AND (?4 IS NULL OR time_utc >= ?4)
                     AND (?5 IS NULL OR time_utc < ?5)
                   ORDER BY time_utc DESC, id DESC LIMIT ?6) ORDER BY time_utc, id",
            )
            .map_err(failed)?;
        let last = filter.last.map_or(-1, |n| n as i64);
        let rows = query
            .query_map(
                params![
                    filter.command,
                    filter.input,
                    filter.verdict,
                    filter.since,
                    filter.until,
                    last
                ],
                from_row,
            )
            .map_err(failed)?;
        rows.collect::<rusqlite::Result<_>>().map_err(failed)
    }
}

fn from_row(row: &Row<'_>) -> rusqlite::Result<Record> {
    let result: String = row.get("result")?;
    Ok(Record {
        time_utc: row.get("time_utc")?,
        command: row.get("command")?,
        input: row.get("input")?,
        input_sha256: row.get("input_sha256")?,
        calib: row.get("calib")?,
        calib_sha256: row.get("calib_sha256")?,
        options: row.get("options")?,
        version: row.get("version")?,
        verdict: row.get("verdict")?,
        batch: row.get("batch")?,
        result: serde_json::from_str(&result).unwrap_or(Value::Null),
    })
}

fn sqlite(path: &Path, error: rusqlite::Error) -> Error {
    let fix = match error.sqlite_error_code() {
        Some(rusqlite::ErrorCode::NotADatabase) => "give a file made by --records",
        Some(rusqlite::ErrorCode::DatabaseCorrupt) => {
            "its end is missing or it was overwritten: fetch a copy of it, or begin a new file"
        }
        Some(rusqlite::ErrorCode::ReadOnly | rusqlite::ErrorCode::CannotOpen) => {
            "ask for the rights to it and its folder, or give another name"
        }
        Some(rusqlite::ErrorCode::DatabaseBusy) => "another program holds it; try again",
        _ => "check the folder and the free space",
    };
    Error::file(path, format!("the records cannot be used ({error})"), fix)
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn record(time_utc: &str, result: Value) -> Record {
        Record {
            time_utc: time_utc.into(),
            command: "burn".into(),
            input: "a.png".into(),
            input_sha256: None,
            calib: None,
            calib_sha256: None,
            options: String::new(),
            version: "0".into(),
            verdict: Some("pass".into()),
            batch: None,
            result,
        }
    }

    #[test]
    fn a_file_of_the_first_version_is_brought_up_to_date_and_a_newer_one_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.sqlite");
        let old = Connection::open(&path).unwrap();
        old.execute_batch(MIGRATIONS[0]).unwrap();
        old.execute_batch("PRAGMA user_version = 1; INSERT INTO records (time_utc, command, input, options, version, result)
            VALUES ('2025-01-01T00:00:00Z', 'burn', 'old.png', '', '0', '{}')").unwrap();
        drop(old);
        let mut store = Store::open(&path).unwrap();
        store.add([Ok(record("2026-01-01T00:00:00Z", Value::Null))]).unwrap();
        let all = store.read(&Filter::default()).unwrap();
        assert_eq!(all.iter().map(|r| r.input.as_str()).collect::<Vec<_>>(), ["old.png", "a.png"]);
        store.connection.pragma_update(None, "user_version", 99).unwrap();
        assert!(Store::open(&path).err().unwrap().to_string().contains("newer version"));
        // What is no records file stays as it is.
        let path = dir.path().join("foreign.sqlite");
        Connection::open(&path).unwrap().execute_batch("CREATE TABLE parts (id)").unwrap();
        let before = std::fs::read(&path).unwrap();
        assert!(Store::open(&path).err().unwrap().to_string().contains("another program's"));
        assert_eq!(std::fs::read(&path).unwrap(), before);
        let path = dir.path().join("empty.sqlite");
        std::fs::write(&path, "").unwrap();
        assert!(Store::open_existing(&path).err().unwrap().to_string().contains("no records"));
        assert_eq!(path.metadata().unwrap().len(), 0);
    }

    #[test]
    fn a_batch_is_recorded_once_and_filters_select() {
        let dir = tempfile::tempdir().unwrap();
        let mut store = Store::open(dir.path().join("r.sqlite")).unwrap();
        let of_batch =
            Record { batch: Some("b".into()), ..record("2026-01-02T00:00:00Z", Value::Null) };
        for _ in 0..2 {
            store.add([Ok(of_batch.clone())]).unwrap();
        }
        store
            .add([Ok(Record { verdict: None, ..record("2026-01-03T00:00:00Z", Value::Null) })])
            .unwrap();
        let count = |f: Filter| store.read(&f).unwrap().len();
        assert_eq!(count(Filter::default()), 2);
        assert_eq!(count(Filter { since: Some("2026-01-03".into()), ..Default::default() }), 1);
        assert_eq!(count(Filter { verdict: Some("pass".into()), ..Default::default() }), 1);
        assert_eq!(count(Filter { last: Some(1), ..Default::default() }), 1);
        assert_eq!(count(Filter { command: Some("rod".into()), ..Default::default() }), 0);
    }

    #[test]
    fn two_writers_at_once_lose_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.sqlite");
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..10 {
                        let mut store = Store::open(&path).unwrap();
                        store.add([Ok(record("2026-01-01T00:00:00Z", Value::Null))]).unwrap();
                    }
                });
            }
        });
        assert_eq!(Store::open(&path).unwrap().read(&Filter::default()).unwrap().len(), 40);
    }
}
