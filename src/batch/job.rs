//! The job file: which measurement, which calibration, which limits.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::input::{Item, Kind};
use super::limits::{self, Limit, Limits};
use super::run::Measured;
use crate::camera::Calibration;
use crate::error::{Error, Result};
use crate::frame::Picture;
use crate::measure::{burn, circles};
use crate::{hash, tomlfile};

/// A job as its file states it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Of the file's format: 1.
    schema: u32,
    /// The measurement.
    pub measure: Method,
    /// The calibration file, seen from the job file's folder.
    pub calib: PathBuf,
    /// Limits by key of the result.
    #[serde(default)]
    pub limits: Limits,
    /// Where relative paths begin: the job file's folder.
    #[serde(skip)]
    base: PathBuf,
}

/// Which measurement, with its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Method {
    /// `pivotsight burn`.
    Burn(burn::Options),
    /// `pivotsight circles`.
    Circles(circles::Options),
}

/// A job with its calibration read, ready to measure.
pub struct Prepared<'j> {
    job: &'j Job,
    calibration: Calibration,
    calib_sha256: String,
}

impl Job {
    /// Reads and checks a job file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut job: Self = tomlfile::read(path)?;
        let wrong = |field: &str, reason: String, fix: &str| {
            Err(Error::field(path, None, field, reason, fix))
        };
        if job.schema != 1 {
            return wrong(
                "schema",
                format!("is {}, this program reads 1", job.schema),
                "use a matching version",
            );
        }
        for (key, limit) in &job.limits {
            let bounds = [limit.min, limit.max];
            if bounds.iter().all(Option::is_none) {
                return wrong(
                    &format!("limits.{key}"),
                    "has no bound".into(),
                    "give min, max or both",
                );
            }
            if bounds.iter().flatten().any(|b| !b.is_finite())
                || matches!(limit, Limit { min: Some(a), max: Some(b) } if a > b)
            {
                return wrong(
                    &format!("limits.{key}"),
                    "no value can keep it".into(),
                    "give finite bounds with min <= max",
                );
            }
        }
        job.base = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok(job)
    }

    /// What the job is fed with.
    pub fn kind(&self) -> Kind {
        Kind::Pictures
    }

    /// The command that measures one picture the same way.
    pub fn command(&self) -> &'static str {
        match self.measure {
            Method::Burn(_) => "burn",
            Method::Circles(_) => "circles",
        }
    }

    /// The calibration file.
    pub fn calib_path(&self) -> PathBuf {
        self.base.join(&self.calib)
    }

    /// Checks the measurement's options and reads the calibration.
    pub fn prepare(&self) -> Result<Prepared<'_>> {
        match &self.measure {
            Method::Burn(options) => burn::check(options)?,
            Method::Circles(options) => circles::check(options)?,
        }
        let path = self.calib_path();
        Ok(Prepared {
            job: self,
            calibration: Calibration::read(&path)?,
            calib_sha256: hash::of_file(&path)?,
        })
    }
}

impl Prepared<'_> {
    /// The calibration file's SHA-256.
    pub fn calib_sha256(&self) -> &str {
        &self.calib_sha256
    }

    /// Measures one item and judges it.
    pub fn measure(&self, item: &Item) -> Measured {
        let bytes = match std::fs::read(&item.path) {
            Ok(bytes) => bytes,
            Err(e) => {
                return Measured { sha256: None, result: Err(Error::io(&item.path, "read", e)) };
            }
        };
        Measured { sha256: Some(hash::of_bytes(&bytes)), result: self.result(item, &bytes) }
    }

    fn result(&self, item: &Item, bytes: &[u8]) -> Result<Map<String, Value>> {
        let own = item.calib.as_ref().map(Calibration::read).transpose()?;
        let calibration = own.as_ref().unwrap_or(&self.calibration);
        let picture = Picture::decode(&item.path, bytes)?;
        let name = &item.name;
        let report = match &self.job.measure {
            Method::Burn(options) => {
                serde_json::to_value(burn::measure(&picture, calibration, options, name)?.report)
            }
            Method::Circles(options) => {
                serde_json::to_value(circles::measure(&picture, calibration, options, name)?.report)
            }
        };
        let Ok(Value::Object(mut result)) = report else { return Ok(Map::new()) };
        if !self.job.limits.is_empty() {
            let judged = limits::judge(&self.job.limits, &result).map_err(|key| {
                Error::measure(
                    &item.name,
                    format!("the result has no number '{key}' to hold against its limit"),
                    "correct the key under [limits]",
                )
            })?;
            let own = result.get("verdict").and_then(|v| serde_json::from_value(v.clone()).ok());
            let verdict = limits::worst(judged.iter().map(|j| j.verdict).chain(own));
            result.insert("limits".into(), serde_json::to_value(judged).unwrap_or_default());
            result.insert("verdict".into(), serde_json::to_value(verdict).unwrap_or_default());
        }
        Ok(result)
    }
}
