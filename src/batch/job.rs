//! The job file: which measurement, which calibration, which limits.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::burns;
use super::input::{Item, Kind};
use super::keys::Keys;
use super::limits::{self, Limit, Limits};
use super::run::{Measured, Overlay};
use crate::camera::Calibration;
use crate::error::{Error, Result};
use crate::frame::Picture;
use crate::measure::{burn, circles, rod};
use crate::uncertainty::Verdict;
use crate::{draw, hash, input, tomlfile, units};

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
    /// Whether pictures of what was measured are drawn.
    #[serde(default)]
    pub overlay: bool,
    /// Limits by key of the result.
    #[serde(default)]
    pub limits: Limits,
    /// The job file; relative paths begin at its folder.
    #[serde(skip)]
    file: PathBuf,
}

/// Which measurement, with its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Method {
    /// `pivotsight burn`.
    Burn(burn::Options),
    /// `pivotsight circles`.
    Circles(circles::Options),
    /// `pivotsight rod`: each item is a table of captures.
    Rod(rod::Options),
}

/// A job with its calibration read, ready to measure.
pub struct Prepared<'j> {
    job: &'j Job,
    calibration: Calibration,
    calib_sha256: String,
    /// A picture of each size, where one scale is taken for all.
    sizes: Mutex<BTreeMap<(usize, usize), String>>,
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
        job.file = path.to_owned();
        Ok(job)
    }

    /// What the job is fed with.
    pub fn kind(&self) -> Kind {
        match self.measure {
            Method::Burn(_) => Kind::Burns,
            Method::Circles(_) => Kind::Pictures,
            Method::Rod(_) => Kind::Tables,
        }
    }

    /// The command that measures one picture the same way.
    pub fn command(&self) -> &'static str {
        match self.measure {
            Method::Burn(_) => "burn",
            Method::Circles(_) => "circles",
            Method::Rod(_) => "rod",
        }
    }

    /// The calibration file.
    pub fn calib_path(&self) -> PathBuf {
        self.file.parent().unwrap_or(Path::new("")).join(&self.calib)
    }

    /// Checks the measurement's options and reads the calibration.
    pub fn prepare(&self) -> Result<Prepared<'_>> {
        match &self.measure {
            Method::Burn(options) => burn::check(options),
            Method::Circles(options) => circles::check(options),
            Method::Rod(options) => rod::check(options),
        }
        .map_err(|e| e.in_file(&self.file, None))?;
        self.check_limits()?;
        let path = self.calib_path();
        Ok(Prepared {
            job: self,
            calibration: Calibration::read(&path)?,
            calib_sha256: hash::of_file(&path)?,
            sizes: Mutex::default(),
        })
    }
}

impl Job {
    /// A key that no result has is found before anything is measured.
    fn check_limits(&self) -> Result<()> {
        if self.limits.is_empty() {
            return Ok(());
        }
        let keys = match &self.measure {
            Method::Burn(_) => Keys::of::<burn::Report>(),
            Method::Circles(_) => Keys::of::<circles::Report>(),
            Method::Rod(_) => Keys::of::<rod::Report>(),
        };
        let wrong = |key: &String, reason: String, fix: String| {
            Err(Error::field(&self.file, None, format!("limits.{key}"), reason, fix))
        };
        for key in self.limits.keys() {
            if !keys.has(key) || key.starts_with("budget.") {
                let fix = match keys.nearest(key) {
                    Some(near) => format!("did you mean '{near}'?"),
                    None => format!("`pivotsight schema {}` lists them", self.command()),
                };
                return wrong(key, format!("is no number of a {} result", self.command()), fix);
            }
            let mut parts = key.split('.');
            if let (Method::Circles(o), Some(list), Some(Ok(i))) =
                (&self.measure, parts.next(), parts.next().map(str::parse::<usize>))
            {
                let circles = o.expect_mm.len();
                let most =
                    if list == "pairs" { circles * circles.saturating_sub(1) / 2 } else { circles };
                if i >= most {
                    return wrong(
                        key,
                        format!("{circles} circles are expected, so {list} has {most}"),
                        "count from 0".into(),
                    );
                }
            }
        }
        Ok(())
    }
}

impl Prepared<'_> {
    /// The calibration file's SHA-256.
    pub fn calib_sha256(&self) -> &str {
        &self.calib_sha256
    }

    /// What is doubtful about the options, and about the calibration for the pictures seen so far.
    pub fn doubts(&self) -> Vec<String> {
        let options = match &self.job.measure {
            Method::Burn(options) => burn::doubts(options).collect(),
            _ => Vec::new(),
        };
        let sizes = self.sizes.lock().unwrap_or_else(PoisonError::into_inner);
        let mixed = units::sizes(sizes.iter().map(|(size, name)| (name.as_str(), *size)));
        options.into_iter().chain(self.calibration.doubts()).chain(mixed).collect()
    }

    /// Reads a picture, and remembers its size where the calibration does not know it.
    fn picture(&self, item: &Item, bytes: &[u8]) -> Result<Picture> {
        let picture = Picture::decode(&item.path, bytes)?;
        if item.calib.is_none() && self.calibration.lens_size().is_none() {
            let mut sizes = self.sizes.lock().unwrap_or_else(PoisonError::into_inner);
            sizes.entry(picture.size()).or_insert_with(|| item.name.clone());
        }
        Ok(picture)
    }

    /// Measures one item and judges it.
    pub fn measure(&self, item: &Item) -> Measured {
        let (mut sha256, mut overlays) = (None, Vec::new());
        let report = input::bytes(&item.path, input::MOST_PICTURE).and_then(|bytes| {
            sha256 = Some(hash::of_bytes(&bytes));
            self.report(item, &bytes, &mut overlays)
        });
        let result = report.and_then(|report| self.judged(item, report));
        Measured { sha256, result, overlays }
    }

    /// The measurement's own report. Overlays, where the job asks for them, are of what was measured or refused.
    fn report(&self, item: &Item, bytes: &[u8], overlays: &mut Vec<Overlay>) -> Result<Value> {
        let own = item.calib.as_ref().map(Calibration::read).transpose()?;
        let calibration = own.as_ref().unwrap_or(&self.calibration);
        let (name, wanted) = (&item.name, self.job.overlay);
        let mut add = |png: Option<Vec<u8>>| {
            overlays.extend(png.map(|png| (overlay_stem(name) + ".png", png)));
        };
        let report = match &self.job.measure {
            Method::Burn(options) => {
                let picture = self.picture(item, bytes)?;
                let options = burns::at_height(options, &item.burnt);
                let measured = burn::measure(&picture, calibration, &options, name);
                if wanted {
                    add(match &measured {
                        Ok(measured) => Some(draw::burn(&picture, calibration, measured, name)?),
                        Err(why) => draw::refused(&picture, calibration, options.channel, why),
                    });
                }
                let mut report = measured?.report;
                report.warnings.extend(item.doubt.clone());
                serde_json::to_value(report)
            }
            Method::Circles(options) => {
                let picture = self.picture(item, bytes)?;
                let measured = circles::measure(&picture, calibration, options, name);
                if wanted {
                    add(match &measured {
                        Ok(measured) => Some(draw::circles(&picture, calibration, measured, name)?),
                        Err(why) => draw::refused(&picture, calibration, options.channel, why),
                    });
                }
                serde_json::to_value(measured?.report)
            }
            Method::Rod(options) => {
                let mut warnings = Vec::new();
                let captures = rod::read_captures(&item.path, &mut warnings)?;
                let measured = rod::measure(&captures, calibration, options);
                if wanted {
                    let channel = options.channel;
                    let drawn: Vec<_> = match &measured {
                        Ok(measured) => {
                            draw::rod_captures(&captures, calibration, measured, channel)?
                                .into_iter()
                                .enumerate()
                                .collect()
                        }
                        Err(why) => draw::rod_refused(&captures, calibration, channel, why),
                    };
                    let name = |i: usize| format!("{}-{}.png", overlay_stem(name), i + 1);
                    overlays.extend(drawn.into_iter().map(|(i, png)| (name(i), png)));
                }
                let mut report = measured?.report;
                report.warnings.splice(..0, warnings);
                serde_json::to_value(report)
            }
        };
        report.map_err(|e| {
            Error::measure(
                name,
                format!("the report cannot be written as JSON: {e}"),
                "report this",
            )
        })
    }

    /// The report's keys with the verdicts of the job's limits.
    fn judged(&self, item: &Item, report: Value) -> Result<Map<String, Value>> {
        let Value::Object(mut result) = report else { return Ok(Map::new()) };
        // A list whose order changes from row to row is no column.
        result.shift_remove("budget");
        if !self.job.limits.is_empty() {
            let judged = limits::judge(&self.job.limits, &result).map_err(|key| {
                Error::measure(
                    &item.name,
                    format!("the result has no number '{key}' to hold against its limit"),
                    "correct the key under [limits]",
                )
            })?;
            let own = result.get("verdict").and_then(|v| serde_json::from_value(v.clone()).ok());
            let verdict = Verdict::worst(judged.iter().map(|j| j.verdict).chain(own));
            result.insert("limits".into(), serde_json::to_value(judged).unwrap_or_default());
            result.insert("verdict".into(), serde_json::to_value(verdict).unwrap_or_default());
        }
        Ok(result)
    }
}

/// How an item's overlays are called: as the item, and where it lies in another folder also by its whole path.
fn overlay_stem(name: &str) -> String {
    match Path::new(name).file_name().map(|file| file.to_string_lossy()) {
        Some(file) if file != name => format!("{file}-{}", &hash::of_bytes(name.as_bytes())[..8]),
        _ => name.to_owned(),
    }
}
