//! The page's frame: style, tables, embedded pictures. Nothing is loaded from anywhere.

use std::path::Path;

use crate::error::{Error, Result};
use crate::input;
use crate::output::escape;

const STYLE: &str = "
@page { size: A4; margin: 15mm }
body { font: 11pt/1.4 system-ui, sans-serif; max-width: 180mm; margin: 10mm auto; padding: 0 4mm; color: #1a1a1a; background: #fff }
h1 { font-size: 18pt; margin: 0 } h2 { font-size: 13pt; margin: 8mm 0 2mm; break-after: avoid }
header p { color: #555; margin: 1mm 0 4mm }
.verdict { font-size: 13pt; padding: 3mm 4mm; border-left: 3mm solid; background: #f4f4f4; print-color-adjust: exact }
.pass { border-color: #009e73 } .fail, .not-measured { border-color: #d55e00 } .undecided { border-color: #e69f00 } .measured, .computed { border-color: #0072b2 }
table { border-collapse: collapse; width: 100%; font-size: 9.5pt; font-variant-numeric: tabular-nums }
th, td { text-align: right; padding: 1mm 2mm; border-bottom: 0.2mm solid #ccc; overflow-wrap: break-word }
td:first-child { overflow-wrap: anywhere; min-width: 22mm } td.words { overflow-wrap: anywhere; text-align: left } .wide { font-size: 7.5pt } .wide th, .wide td { padding: 0.7mm 1mm }
th:first-child, td:first-child, .facts td { text-align: left } .facts td:first-child { width: 40mm }
table + table { margin-top: 4mm }
thead { display: table-header-group } tr, figure { break-inside: avoid }
td.fail { color: #b34700; font-weight: bold; border-color: #ccc } td.pass { color: #00704f; border-color: #ccc } td.undecided { color: #8a5f00; border-color: #ccc }
figure { margin: 4mm 0; text-align: center } figure img, figure svg { max-width: 100%; height: auto; max-height: 120mm }
.pictures { display: grid; grid-template-columns: 1fr 1fr; gap: 0 4mm } .pictures > :only-child { grid-column: span 2 }
figcaption { font-size: 9pt; color: #555 }
";

/// Tables with more columns are set in smaller type.
const WIDE: usize = 7;

/// Longer cells are words, which may break anywhere rather than widen the table.
const LONG: usize = 32;

/// Pictures two abreast; one alone takes the whole width.
pub fn pictures(figures: &str) -> String {
    if figures.is_empty() {
        String::new()
    } else {
        format!("<div class=\"pictures\">{figures}</div>\n")
    }
}

/// The whole page.
pub fn document(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
        escape(title)
    )
}

/// A table; cells that are verdicts get their colour.
pub fn table(head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let wide = if head.len() > WIDE { " class=\"wide\"" } else { "" };
    table_of(&format!("<table{wide}>\n"), head, rows)
}

/// A table of names and words.
pub fn facts(rows: impl Iterator<Item = Vec<String>>) -> String {
    table_of("<table class=\"facts\">\n", &[], rows)
}

fn table_of(open: &str, head: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut text = String::from(open);
    if head.iter().any(|h| !h.is_empty()) {
        text += "<thead><tr>";
        head.iter().for_each(|h| text += &format!("<th>{}</th>", escape(h)));
        text += "</tr></thead>\n";
    }
    text += "<tbody>\n";
    for row in rows {
        text += "<tr>";
        for cell in row {
            let class = match cell.as_str() {
                word @ ("pass" | "fail" | "undecided") => format!(" class=\"{word}\""),
                words if words.len() > LONG => " class=\"words\"".to_owned(),
                _ => String::new(),
            };
            text += &format!("<td{class}>{}</td>", escape(&cell));
        }
        text += "</tr>\n";
    }
    text + "</tbody>\n</table>\n"
}

/// A picture file inside the page.
pub fn embed(path: &Path) -> Result<String> {
    let bytes = input::bytes(path, input::MOST_PICTURE)?;
    let kind = match bytes.as_slice() {
        [0x89, b'P', b'N', b'G', ..] => "png",
        [0xff, 0xd8, ..] => "jpeg",
        text if text.trim_ascii_start().starts_with(b"<svg")
            || text.trim_ascii_start().starts_with(b"<?xml") =>
        {
            "svg+xml"
        }
        _ => {
            return Err(Error::file(
                path,
                "is not PNG, JPEG or SVG",
                "give a picture a browser can show",
            ));
        }
    };
    let name = escape(&path.file_name().unwrap_or_default().to_string_lossy());
    Ok(format!(
        "<figure><img alt=\"{name}\" src=\"data:image/{kind};base64,{}\"><figcaption>{name}</figcaption></figure>\n",
        base64(&bytes)
    ))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let bits =
            chunk.iter().fold(0u32, |bits, b| bits << 8 | u32::from(*b)) << (8 * (3 - chunk.len()));
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i)) as usize & 63];
            text.push(if i <= chunk.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (text, code) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg==")]
        {
            assert_eq!(super::base64(text.as_bytes()), code);
        }
    }
}
