//! Generator of `docs/protocol.md`: the template beside this file, with values from the code.
//!
//! | in the template | becomes |
//! | --- | --- |
//! | `{{const NAME}}` | the value of a constant of the protocol |
//! | `{{const FILE NAME}}` | the value of a constant of another file |
//! | `{{doc PATH}}` | the comment of a module, type, variant or constant |
//! | `{{type NAME}}` | a table of its fields, or of its variants and theirs |
//! | `{{types}}` | the tables of all types that were not asked for by name |
//! | `{{variant NAME VARIANT}}` | the number of a variant |
//! | `{{vector DIRECTION NAME}}` | a golden frame, taken apart |
//! | `{{causes}}`, `{{parameters}}`, `{{channel_kinds}}` | tables of those |
//! | `{{schema_hash}}`, `{{crc short NAME}}`, `{{crc long NAME}}`, `{{short_of}}` | what their names say |

use std::{collections::BTreeSet, fmt::Write};

use r4_protocol::{Cause, ChannelKind, Parameter, SCHEMA_HASH, frame::Check};

use super::{
    Input,
    codec::{checksum, payload},
    constants::Value,
    json::{hex, one_line, short_of, variant_of},
    model::{Field, Kind, Named},
    source::Source,
};

const TEMPLATE: &str = include_str!("page.md");

/// Returns the whole page.
///
/// # Errors
/// A placeholder of the template that has no value.
pub(super) fn file(input: &Input) -> Result<String, String> {
    let mut page = String::new();
    let mut shown = BTreeSet::new();
    let mut rest = TEMPLATE;
    while let Some((before, after)) = rest.split_once("{{") {
        let (asked, after) = after.split_once("}}").ok_or("the template has a {{ without its }}")?;
        page.push_str(before);
        let words: Vec<&str> = asked.split_whitespace().collect();
        let text =
            put(input, &words, &mut shown).map_err(|problem| format!("{{{{{asked}}}}} in page.md: {problem}"))?;
        page.push_str(&text);
        rest = after;
    }
    Ok(page + rest)
}

fn put(input: &Input, words: &[&str], shown: &mut BTreeSet<String>) -> Result<String, String> {
    match words {
        ["const", name] => Value::of(name, &input.source).map(|value| value.to_string()),
        ["const", file, name] => {
            let source = Source::read(&input.root.join(file))?;
            Value::of(name, &source).map(|value| value.to_string())
        }
        // An item's comment becomes part of a paragraph, so it must be one line.
        ["doc", path] if path.starts_with(char::is_uppercase) => input.source.doc(path).map(one_line),
        ["doc", module] => input.source.doc(module).map(lower_headings),
        ["type", name] => {
            shown.insert((*name).into());
            input.model.get(name).map(table)
        }
        ["types"] => {
            let left = input.model.0.iter().filter(|named| !shown.contains(named.name));
            Ok(left.map(section).collect::<Vec<_>>().join("\n"))
        }
        ["variant", name, variant] => number(input, name, variant),
        ["vector", direction, name] => vector(input, direction, name),
        ["causes"] => Ok(causes(input)),
        ["parameters"] => {
            shown.insert("Parameter".into());
            parameters(input)
        }
        ["channel_kinds"] => {
            shown.insert("ChannelKind".into());
            channel_kinds(input)
        }
        ["schema_hash"] => Ok(format!("{SCHEMA_HASH:#018x}")),
        ["short_of"] => short_of(input).map(|all| format!("`{}`", all.join("`, `"))),
        ["crc", which @ ("short" | "long"), what] => {
            let checksum = checksum(if *which == "short" { Check::Short } else { Check::Long });
            match *what {
                "name" => Ok(checksum.name.into()),
                "bytes" => Ok(checksum.bytes.to_string()),
                "polynomial" => Ok(checksum.hex(checksum.polynomial)),
                "reflected" => Ok(checksum.hex(checksum.reflected)),
                "initial" => Ok(checksum.hex(checksum.initial)),
                "final" => Ok(checksum.hex(checksum.final_xor)),
                "check" => Ok(checksum.hex(checksum.check)),
                other => Err(format!("the checksum has no {other}")),
            }
        }
        _ => Err("the template may not ask for this".into()),
    }
}

/// Moves the headings of a comment below those of the page.
fn lower_headings(doc: &str) -> String {
    doc.lines()
        .map(|line| if line.starts_with("# ") { format!("###{}", &line[1..]) } else { line.into() })
        .collect::<Vec<_>>()
        .join("\n")
}

fn number(input: &Input, name: &str, variant: &str) -> Result<String, String> {
    let Kind::Enum(variants) = &input.model.get(name)?.kind else { return Err(format!("{name} is no enum")) };
    let place = variants.iter().position(|known| known.name == variant);
    place.map(|place| place.to_string()).ok_or_else(|| format!("{name} has no {variant}"))
}

fn section(named: &Named) -> String {
    format!("### {}\n\n{}\n\n{}", named.name, named.doc, table(named))
}

/// Returns a table of fields, or of variants with their fields.
fn table(named: &Named) -> String {
    let mut text = String::new();
    match &named.kind {
        Kind::Struct(fields) => {
            text.push_str("| field | type | meaning |\n| --- | --- | --- |\n");
            for field in fields {
                let name = field.name.map_or_else(|| "its only one".into(), |name| format!("`{name}`"));
                line(&mut text, &[&name, &field.shape.text(), &meaning(field)]);
            }
        }
        Kind::Enum(variants) if variants.iter().all(|variant| variant.fields.is_empty()) => {
            text.push_str("| number | variant | meaning |\n| ---: | --- | --- |\n");
            for (number, variant) in variants.iter().enumerate() {
                line(&mut text, &[&number.to_string(), variant.name, &one_line(&variant.doc)]);
            }
        }
        Kind::Enum(variants) => {
            text.push_str(
                "| number | variant, its fields in their order | type | meaning |\n| ---: | --- | --- | --- |\n",
            );
            for (number, variant) in variants.iter().enumerate() {
                let of = match &variant.fields[..] {
                    [field @ Field { name: None, .. }] => field.shape.text(),
                    _ => String::new(),
                };
                let name = format!("**{}**", variant.name);
                line(&mut text, &[&number.to_string(), &name, &of, &one_line(&variant.doc)]);
                for field in &variant.fields {
                    if let Some(name) = field.name {
                        line(&mut text, &["", &format!("`{name}`"), &field.shape.text(), &meaning(field)]);
                    }
                }
            }
        }
    }
    text
}

fn line(text: &mut String, cells: &[&str]) {
    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
    writeln!(text, "| {} |", cells.join(" | ")).expect("a string takes it");
}

/// Returns the meaning of a field, with the unit from its name.
fn meaning(field: &Field) -> String {
    let text = one_line(&field.doc);
    field.unit().map_or_else(|| text.clone(), |unit| format!("{text} [{unit}]"))
}

fn vector(input: &Input, direction: &str, name: &str) -> Result<String, String> {
    let vector =
        input.golden.iter().find(|vector| (vector.direction.as_str(), vector.name.as_str()) == (direction, name));
    let vector = vector.ok_or("there is no such golden frame")?;
    let short = payload(&vector.frame, Check::Short).map(|message| (Check::Short, message));
    let (check, message) =
        short.or_else(|_| payload(&vector.frame, Check::Long).map(|message| (Check::Long, message)))?;
    let spaced = |bytes: &[u8]| bytes.iter().map(|byte| hex(&[*byte])).collect::<Vec<_>>().join(" ");
    let checksum = checksum(check);
    Ok(format!(
        "message   {}\nchecksum  {}\nframe     {}",
        spaced(&message),
        checksum.hex(checksum.of(&message)),
        spaced(&vector.frame)
    ))
}

fn causes(input: &Input) -> String {
    let mut text = String::from("| bit | cause | when | what to do |\n| ---: | --- | --- | --- |\n");
    for cause in Cause::ALL {
        let doc = input.source.doc(&format!("Cause::{cause:?}")).unwrap_or_default();
        line(&mut text, &[&(cause as u8).to_string(), &format!("{cause:?}"), &one_line(doc), cause.advice()]);
    }
    text
}

fn parameters(input: &Input) -> Result<String, String> {
    let Kind::Enum(variants) = &input.model.get("Parameter")?.kind else { return Err("no enum".into()) };
    let mut text = String::from("| number | variant | name | of what, and its unit |\n| ---: | --- | --- | --- |\n");
    for (number, variant) in variants.iter().enumerate() {
        let parameter: Parameter = variant_of(number)?;
        line(
            &mut text,
            &[&number.to_string(), variant.name, &format!("`{}`", parameter.name()), &one_line(&variant.doc)],
        );
    }
    Ok(text)
}

fn channel_kinds(input: &Input) -> Result<String, String> {
    let Kind::Enum(variants) = &input.model.get("ChannelKind")?.kind else { return Err("no enum".into()) };
    let mut text = String::from(
        "| number | variant | written | what it is | measures together |\n| ---: | --- | --- | --- | --- |\n",
    );
    for (number, variant) in variants.iter().enumerate() {
        let kind: ChannelKind = variant_of(number)?;
        let quantities: Vec<String> =
            kind.quantities().iter().map(|quantity| format!("`{}` [{}]", quantity.field, quantity.unit)).collect();
        let name = format!("`{}0`", kind.name());
        line(&mut text, &[&number.to_string(), variant.name, &name, &one_line(&variant.doc), &quantities.join(", ")]);
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_template_may_not_ask_for_is_named() {
        let input = Input::read(&crate::root()).expect("the sources are read");
        let mut shown = BTreeSet::new();
        for words in [&["nonsense"][..], &["const", "NO_SUCH"], &["type", "NoSuch"], &["variant", "Request", "Fly"]] {
            assert!(put(&input, words, &mut shown).is_err(), "{words:?}");
        }
        assert_eq!(put(&input, &["variant", "Request", "Arm"], &mut shown).as_deref(), Ok("3"));
        assert_eq!(
            put(&input, &["const", "firmware/core/src/telemetry.rs", "MAX_SUBSCRIPTIONS"], &mut shown)
                .map(|text| text.parse::<u32>().is_ok()),
            Ok(true)
        );
    }
}
