//! Defaults from a file: a table a command, a key an option, as on the command line but without the dashes.
//!
//! ```toml
//! records = "records.sqlite"
//! [burn]
//! calib = "bench.toml"
//! tolerance-mm = 0.01
//! ```
//! The file is `$PIVOTSIGHT_CONFIG` (`none` for no defaults), else `pivotsight/config.toml` in the user's configuration folder. What the
//! command line says wins.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::CommandFactory;

use super::{Cli, Global, Outcome};
use crate::error::{Error, Result, nearest};
use crate::output::Document;
use crate::tomlfile;

/// The environment variable that names the file.
const VARIABLE: &str = "PIVOTSIGHT_CONFIG";

/// Show the file with the defaults, and what it sets
#[derive(Debug, clap::Args)]
pub struct Args {}

/// What is printed.
#[derive(serde::Serialize, schemars::JsonSchema)]
pub struct Output<'t> {
    /// The file's tables and keys.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    defaults: &'t toml::Table,
}

/// Runs the command.
pub fn run(_: &Args, _: &Global) -> Result<Outcome> {
    let path = file();
    let table = read(path.as_ref())?;
    let json = super::result("config", &path, &[], &Output { defaults: &table });
    let name =
        path.as_ref().map_or_else(|| format!("none: {}", why_none()), |p| p.display().to_string());
    let text = if table.is_empty() {
        format!("file: {name}\nno defaults are set there\n")
    } else {
        format!("file: {name}\n\n{}", toml::to_string(&table).unwrap_or_default())
    };
    Ok(Outcome::good(Document::single(json, text)))
}

/// The command line with the defaults put in front of the user's own options.
pub fn arguments(given: Vec<OsString>) -> Result<Vec<OsString>> {
    let path = file();
    let table = read(path.as_ref())?;
    let Some(path) = path.filter(|_| !table.is_empty()) else { return Ok(given) };
    let program = Cli::command();
    let words: Vec<String> = given.iter().map(|a| a.to_string_lossy().into_owned()).collect();
    let names: Vec<&str> = program.get_subcommands().map(clap::Command::get_name).collect();
    let mut defaults = Vec::new();
    let mut place = None;
    for (key, value) in &table {
        let wrong = |reason: &str, fix: &str| Err(Error::field(&path, None, key, reason, fix));
        match value {
            toml::Value::Table(options) => {
                let Some(command) = program.find_subcommand(key) else {
                    return wrong("is not a command", "see pivotsight --help");
                };
                let here = words.iter().skip(1).position(|w| names.contains(&w.as_str()));
                let here = here.map(|i| i + 1).filter(|&i| words[i] == *key);
                place = place.or(here);
                for (option, value) in options {
                    let flags = option_words(&path, command, option, value)?;
                    if here.is_some() && !is_given(&words, option) {
                        defaults.extend(flags);
                    }
                }
            }
            value => {
                let flags = option_words(&path, &program, key, value)?;
                if !is_given(&words, key) {
                    defaults.extend(flags);
                }
            }
        }
    }
    let after = match place
        .or_else(|| words.iter().skip(1).position(|w| names.contains(&w.as_str())).map(|i| i + 1))
    {
        Some(i) => i + 1,
        None => return Ok(given), // --help, --version or a misspelt command
    };
    let mut all = given;
    all.splice(after..after, defaults.into_iter().map(OsString::from));
    Ok(all)
}

fn is_given(words: &[String], option: &str) -> bool {
    let flag = format!("--{option}");
    words
        .iter()
        .any(|w| *w == flag || w.strip_prefix(&flag).is_some_and(|rest| rest.starts_with('=')))
}

/// `--option=value`; lists repeat the option, `true` is the bare flag.
fn option_words(
    path: &std::path::Path,
    command: &clap::Command,
    option: &str,
    value: &toml::Value,
) -> Result<Vec<String>> {
    let wrong = |reason: &str, fix: &str| Err(Error::field(path, None, option, reason, fix));
    let program = Cli::command();
    let of = |c: &clap::Command| c.get_arguments().find(|a| a.get_long() == Some(option)).cloned();
    let Some(known) = of(command).or_else(|| of(&program)) else {
        let long = |c: &clap::Command| -> Vec<String> {
            c.get_arguments().filter_map(|a| a.get_long().map(str::to_owned)).collect()
        };
        let fix = match nearest(&option.replace('_', "-"), [long(command), long(&program)].concat())
        {
            Some(name) => format!("did you mean '{name}'?"),
            None => "correct the key; options are written without the dashes before them".into(),
        };
        return wrong(&format!("'{}' has no option --{option}", command.get_name()), &fix);
    };
    let takes_value = known.get_action().takes_values();
    let word = |value: &toml::Value| match value {
        toml::Value::String(text) => Some(format!("--{option}={text}")),
        toml::Value::Integer(i) => Some(format!("--{option}={i}")),
        toml::Value::Float(x) => Some(format!("--{option}={x}")),
        _ => None,
    };
    let words = match value {
        toml::Value::Boolean(on) if !takes_value => {
            return Ok(if *on { vec![format!("--{option}")] } else { Vec::new() });
        }
        toml::Value::Array(items) => items.iter().map(word).collect(),
        one => word(one).map(|w| vec![w]),
    };
    match words.filter(|_| takes_value) {
        Some(words) => Ok(words),
        None => wrong("cannot have this value", "give what the command line takes"),
    }
}

/// What an environment variable names; an empty one is as none.
fn variable(name: &str) -> Option<PathBuf> {
    std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from)
}

fn why_none() -> &'static str {
    match variable(VARIABLE) {
        Some(_) => "PIVOTSIGHT_CONFIG says so",
        None => "no home folder is known",
    }
}

fn file() -> Option<PathBuf> {
    if let Some(path) = variable(VARIABLE) {
        return Some(path).filter(|p| p.as_os_str() != "none");
    }
    let folder = variable("XDG_CONFIG_HOME")
        .or_else(|| variable("APPDATA"))
        .or_else(|| variable("HOME").map(|home| home.join(".config")))?;
    Some(folder.join("pivotsight/config.toml"))
}

fn read(path: Option<&PathBuf>) -> Result<toml::Table> {
    match path {
        // Naming a file that does not exist is a mistake; having no defaults is not.
        Some(path) if path.exists() || variable(VARIABLE).is_some() => tomlfile::read(path),
        _ => Ok(toml::Table::new()),
    }
}
