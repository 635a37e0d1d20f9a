//! Defaults from a file: a table a command, a key an option, as on the command line but without the dashes.
//!
//! ```toml
//! records = "records.sqlite"
//! [burn]
//! calib = "bench.toml"
//! tolerance-mm = 0.01
//! [calib.camera]
//! target = "charuco:11x7:15"
//! ```
//! The file is `$PIVOTSIGHT_CONFIG` (`none` for no defaults), else `pivotsight/config.toml` in the user's configuration folder. What the
//! command line says wins.

use std::any::TypeId;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue, ErrorKind};

use super::outfiles::OutFile;
use super::{Global, Outcome};
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
    // Help is there whatever the file holds.
    if given.iter().any(|w| ["--help", "-h", "--version", "-V"].iter().any(|help| w == help)) {
        return Ok(given);
    }
    let path = file();
    let table = read(path.as_ref())?;
    let Some(path) = path.filter(|_| !table.is_empty()) else { return Ok(given) };
    let words: Vec<String> = given.iter().map(|a| a.to_string_lossy().into_owned()).collect();
    let program = super::command();
    let (mut asked, mut after) = (vec![&program], 0);
    for (i, word) in words.iter().enumerate().skip(1) {
        let command = asked[asked.len() - 1];
        if wants_value(&words[i - 1], command, &program) {
            continue;
        }
        if let Some(command) = command.find_subcommand(word) {
            asked.push(command);
            after = i + 1;
        }
    }
    let file = File { path: &path, program: &program, words: &words, asked: &asked };
    let mut defaults = Vec::new();
    file.defaults(&table, &[&program], &mut defaults)?;
    // Without a command (none, or a misspelt one) there is no place for them.
    if after == 0 {
        return Ok(given);
    }
    let with = |defaults: &[Vec<String>]| {
        let mut all = given.clone();
        all.splice(after..after, defaults.iter().flatten().map(OsString::from));
        all
    };
    // What the command then asks for beside what is given.
    let lacks = |defaults: &[Vec<String>]| -> Vec<String> {
        let error = program.clone().try_get_matches_from(with(defaults)).err();
        let error = error.filter(|e| e.kind() == ErrorKind::MissingRequiredArgument);
        match error.as_ref().and_then(|e| e.get(ContextKind::InvalidArg)) {
            Some(ContextValue::Strings(names)) => names.clone(),
            _ => Vec::new(),
        }
    };
    // A default that needs an option which neither the line nor the file gives is for other calls.
    let (own, missing) = (lacks(&[]), lacks(&defaults));
    if missing.iter().any(|name| !own.contains(name)) {
        defaults.retain(|default| {
            let asks = lacks(std::slice::from_ref(default));
            asks.iter().all(|name| own.contains(name) || !missing.contains(name))
        });
    }
    Ok(with(&defaults))
}

/// The file, and the command line that it is read for.
struct File<'a> {
    path: &'a Path,
    program: &'a clap::Command,
    words: &'a [String],
    /// The program, the command, and a command of that.
    asked: &'a [&'a clap::Command],
}

impl File<'_> {
    /// Checks the table of the last of `commands`, and gathers what the command line wants of it and does not say itself.
    fn defaults(
        &self,
        table: &toml::Table,
        commands: &[&clap::Command],
        defaults: &mut Vec<Vec<String>>,
    ) -> Result<()> {
        let command = commands[commands.len() - 1];
        let names = |c: &[&clap::Command]| -> Vec<String> {
            c.iter().map(|c| c.get_name().to_owned()).collect()
        };
        let wanted = names(self.asked).starts_with(&names(commands));
        for (key, value) in table {
            match (value, command.find_subcommand(key)) {
                (toml::Value::Table(inner), Some(next)) => {
                    self.defaults(inner, &[commands, &[next]].concat(), defaults)?;
                }
                (toml::Value::Table(_), None) if commands.len() == 1 => {
                    let known = command.get_subcommands().map(clap::Command::get_name);
                    let fix = nearest(key, known).map_or_else(
                        || "see pivotsight --help".into(),
                        |name| format!("did you mean '{name}'?"),
                    );
                    return Err(Error::field(self.path, None, key, "is not a command", fix));
                }
                _ => {
                    let (option, flags) = self.option(key, value, commands)?;
                    // What only the outer command knows is none of the inner one's.
                    let known = option.is_global_set() || commands.len() == self.asked.len();
                    let said = is_given(self.words, &option) || self.excludes(command, &option);
                    if wanted && known && !said {
                        defaults.push(flags);
                    }
                }
            }
        }
        Ok(())
    }

    /// Whether the command line has an option of the command that does not go with another.
    fn excludes(&self, command: &clap::Command, option: &clap::Arg) -> bool {
        let one_of = |a: &clap::Arg, b: &clap::Arg| {
            let has = |g: &clap::ArgGroup, a: &clap::Arg| g.get_args().any(|id| id == a.get_id());
            command.get_groups().any(|g| has(g, a) && has(g, b) && !g.clone().is_multiple())
        };
        let not_with = |a: &clap::Arg, b: &clap::Arg| {
            let conflicts = command.get_arg_conflicts_with(a);
            conflicts.iter().any(|c| c.get_id() == b.get_id()) || one_of(a, b)
        };
        let own = |id: &clap::Id| command.get_arguments().any(|a| a.get_id() == id);
        own(option.get_id())
            && command
                .get_arguments()
                .filter(|a| a.get_long().is_some() && is_given(self.words, a))
                .any(|a| not_with(a, option) || not_with(option, a))
    }

    /// The option of the last of `commands` that a key names, and its words: `--option=value`; lists repeat the option, `true` is the bare flag.
    fn option(
        &self,
        key: &str,
        value: &toml::Value,
        commands: &[&clap::Command],
    ) -> Result<(clap::Arg, Vec<String>)> {
        let command = commands[commands.len() - 1];
        let place: Vec<&str> = commands[1..].iter().map(|c| c.get_name()).chain([key]).collect();
        let wrong = |reason: String, fix: String| {
            Err(Error::field(self.path, None, place.join("."), reason, fix))
        };
        let known =
            |c: &clap::Command| c.get_arguments().find(|a| a.get_long() == Some(key)).cloned();
        let Some(option) = known(command).or_else(|| known(self.program)) else {
            let long = |c: &clap::Command| -> Vec<String> {
                c.get_arguments().filter_map(|a| a.get_long().map(str::to_owned)).collect()
            };
            let all = [long(command), long(self.program)].concat();
            let inner: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
            let fix = match nearest(&key.replace('_', "-"), all) {
                Some(name) => format!("did you mean '{name}'?"),
                None if commands.len() > 1 && !inner.is_empty() => {
                    let name = command.get_name();
                    format!(
                        "options of its commands stand in tables of their own: [{name}.{}]",
                        inner.join(&format!("], [{name}."))
                    )
                }
                None => {
                    "correct the key; options are written without the dashes before them".into()
                }
            };
            return wrong(format!("'{}' has no option --{key}", command.get_name()), fix);
        };
        if !option.get_action().takes_values() {
            return match value {
                toml::Value::Boolean(true) => Ok((option, vec![format!("--{key}")])),
                toml::Value::Boolean(false) => Ok((option, Vec::new())),
                _ => wrong(format!("cannot be {value}"), "write true or false".into()),
            };
        }
        let parser = option.get_value_parser().type_id();
        let is_path = parser == TypeId::of::<PathBuf>() || parser == TypeId::of::<OutFile>();
        // As in the other files, paths are seen from the file's folder.
        let beside = |text: &String| {
            let folder = self.path.parent().unwrap_or(Path::new(""));
            folder.join(text).to_str().map_or_else(|| text.clone(), str::to_owned)
        };
        let word = |value: &toml::Value| match value {
            toml::Value::String(text) if is_path => Some(format!("--{key}={}", beside(text))),
            toml::Value::String(text) => Some(format!("--{key}={text}")),
            toml::Value::Integer(i) if !is_path => Some(format!("--{key}={i}")),
            toml::Value::Float(x) if !is_path && x.is_finite() => Some(format!("--{key}={x}")),
            _ => None,
        };
        let words: Option<Vec<String>> = match value {
            toml::Value::Array(items) => items.iter().map(word).collect(),
            one => word(one).map(|w| vec![w]),
        };
        // The command line's own judgement; what else the command needs is not here.
        let judged = words.map(|words| {
            let line =
                commands.iter().map(|c| c.get_name()).chain(words.iter().map(String::as_str));
            (self.program.clone().try_get_matches_from(line).err(), words)
        });
        let needs_more = |e: &clap::Error| {
            matches!(
                e.kind(),
                ErrorKind::MissingRequiredArgument
                    | ErrorKind::MissingSubcommand
                    | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
            )
        };
        match judged {
            Some((error, words)) if error.as_ref().is_none_or(needs_more) => Ok((option, words)),
            other => {
                let fix = expected(&option, is_path, other.and_then(|o| o.0));
                wrong(format!("cannot be {value}"), fix)
            }
        }
    }
}

/// What an option takes, in words.
fn expected(option: &clap::Arg, is_path: bool, error: Option<clap::Error>) -> String {
    let of = option.get_value_parser().type_id();
    let choices: Vec<String> =
        option.get_possible_values().iter().map(|v| v.get_name().to_owned()).collect();
    if error.as_ref().is_some_and(|e| e.kind() == ErrorKind::ArgumentConflict) {
        return "give one value, not a list".into();
    }
    if !choices.is_empty() {
        return format!("give one of: {}", choices.join(", "));
    }
    if is_path {
        return "give the name of a file or folder in quotes".into();
    }
    if of == TypeId::of::<f64>() {
        return "give a number".into();
    }
    if [TypeId::of::<usize>(), TypeId::of::<u32>(), TypeId::of::<u64>()].iter().any(|t| of == *t) {
        return "give a whole number, not negative".into();
    }
    let reason = error.as_ref().and_then(std::error::Error::source).map(ToString::to_string);
    reason.unwrap_or_else(|| {
        let help = option.get_help().map(ToString::to_string).unwrap_or_default();
        format!("give what the command line takes: {help}")
    })
}

/// Whether a word of the command line is an option whose value is the next word.
fn wants_value(word: &str, command: &clap::Command, program: &clap::Command) -> bool {
    let is_it = |a: &&clap::Arg| match word.strip_prefix("--") {
        Some(long) => a.get_long() == Some(long),
        None => {
            let letters = word.strip_prefix('-');
            a.get_short().is_some_and(|short| letters.is_some_and(|l| l.ends_with(short)))
        }
    };
    let option = command.get_arguments().chain(program.get_arguments()).find(is_it);
    option.is_some_and(|a| a.get_action().takes_values())
}

/// Whether the command line has the option, by its long name or its letter.
fn is_given(words: &[String], option: &clap::Arg) -> bool {
    let flag = format!("--{}", option.get_long().unwrap_or_default());
    let letter = |w: &str| {
        let letters = w.strip_prefix('-').filter(|l| l.chars().all(char::is_alphabetic));
        option.get_short().zip(letters).is_some_and(|(short, letters)| letters.contains(short))
    };
    words.iter().any(|w| {
        letter(w) || *w == flag || w.strip_prefix(&flag).is_some_and(|rest| rest.starts_with('='))
    })
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
