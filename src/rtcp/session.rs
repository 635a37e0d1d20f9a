//! The session file: everything read at the machine on the way from the burn test to the control's
//! values.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;

use crate::error::Result;
use crate::machine::Machine;
use crate::rtcp::session_file::File;
use crate::rtcp::session_reader::Reader;
use crate::rtcp::solve::Readings;
use crate::tomlfile;
use crate::uncertainty::{Measured, Verdict};

/// A limit of the method.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Limit {
    /// The step: S1 to S4.
    pub step: &'static str,
    /// What has to stay within it.
    pub what: &'static str,
    /// What was measured.
    pub value_mm: f64,
    /// Half-width of its 95 % interval.
    pub u95_mm: f64,
    /// What the method allows.
    pub limit_mm: f64,
    /// Whether it is kept.
    pub verdict: Verdict,
}

impl Limit {
    pub(super) fn new(
        step: &'static str,
        what: &'static str,
        measured: Measured,
        limit_mm: f64,
    ) -> Self {
        let (value_mm, u95_mm) = (measured.value, measured.u95());
        let verdict = Verdict::of(value_mm.abs(), u95_mm, limit_mm);
        Self { step, what, value_mm, u95_mm, limit_mm, verdict }
    }
}

/// What the control holds now.
#[derive(Debug, Clone)]
pub struct InControl {
    /// The machine as the control has it; zero what is not told.
    pub machine: Machine,
    /// The values that are not told.
    pub untold: Vec<&'static str>,
    /// Whether it comes from a machine file, which says the sense of B as well.
    pub from_file: bool,
}

/// A session ready to be solved.
#[derive(Debug, Clone)]
pub struct Session {
    /// The machine's name.
    pub name: String,
    /// The table's sense of turning, for the machine file.
    pub c_sense: i32,
    /// The numbers to solve.
    pub readings: Readings,
    /// From the nozzle to the focus.
    pub standoff_mm: Measured,
    /// The limits of S1 and S2 that could be checked.
    pub limits: Vec<Limit>,
    /// What the control holds now, where it is known.
    pub control: Option<InControl>,
    /// What had to be assumed.
    pub warnings: Vec<String>,
    /// The files the session file names.
    pub files: Vec<PathBuf>,
}

impl Session {
    /// Reads a session file and the results it points to.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file: File = tomlfile::read(path)?;
        let mut reader = Reader::new(path);
        let named = [
            file.burn.as_ref().and_then(|b| b.result.as_ref()),
            file.rod.result.as_ref(),
            file.control.as_ref().and_then(|c| c.machine.as_ref()),
        ];
        let files = named.into_iter().flatten().map(|f| reader.beside(f)).collect();
        let session = reader.session(file)?;
        Ok(Self { warnings: reader.warnings, files, ..session })
    }
}
