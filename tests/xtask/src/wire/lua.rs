//! Generator of `protocol/r4.lua`: the dissector beside this file, with the types as tables.

use r4_protocol::{
    VERSION,
    frame::{Check, MAX_FRAME},
};

use super::{
    Input,
    codec::checksum,
    model::{Field, Kind, Shape},
};

const TEMPLATE: &str = include_str!("dissector.lua");

/// Returns the whole file.
pub(super) fn file(input: &Input) -> Result<String, String> {
    let mut types = format!("local VERSION = {VERSION}\nlocal CHECKSUMS = {{\n");
    for check in [Check::Short, Check::Long] {
        let checksum = checksum(check);
        types += &format!(
            "  {{ bytes = {}, reflected = {}, initial = {}, final = {} }}, -- {}\n",
            checksum.bytes,
            checksum.hex(checksum.reflected),
            checksum.hex(checksum.initial),
            checksum.hex(checksum.final_xor),
            checksum.name
        );
    }
    types += "}\n\nlocal TYPES = {\n";
    for named in &input.model.0 {
        let text = match &named.kind {
            Kind::Struct(of) => format!("  {} = {{ fields = {} }},\n", named.name, fields(of)),
            Kind::Enum(variants) => {
                let variants = variants.iter().map(|variant| {
                    format!("    {{ name = \"{}\", fields = {} }},\n", variant.name, fields(&variant.fields))
                });
                format!("  {} = {{ variants = {{\n{}  }} }},\n", named.name, variants.collect::<String>())
            }
        };
        types += &text;
    }
    types.push('}');
    Ok(TEMPLATE.replace("--@TYPES@", &types).replace("--@MAX_FRAME@", &MAX_FRAME.to_string()))
}

fn fields(fields: &[Field]) -> String {
    let field = |field: &Field| format!("{{ \"{}\", {} }}", field.name.unwrap_or("value"), shape(&field.shape));
    let all: Vec<String> = fields.iter().map(field).collect();
    if all.is_empty() { "{}".into() } else { format!("{{ {} }}", all.join(", ")) }
}

fn shape(of: &Shape) -> String {
    match of {
        Shape::Unsigned(_) => "\"unsigned\"".into(),
        Shape::Signed(_) => "\"signed\"".into(),
        Shape::Text { .. } => "\"string\"".into(),
        Shape::Option(of) => format!("{{ option = {} }}", shape(of)),
        Shape::List { of, .. } => format!("{{ list = {} }}", shape(of)),
        Shape::Array { of, length } => format!("{{ list = {}, length = {length} }}", shape(of)),
        Shape::Result { ok, refusal } => format!("{{ result = {{ {}, {} }} }}", shape(ok), shape(refusal)),
        Shape::Bool | Shape::U8 | Shape::I8 | Shape::F32 | Shape::Named(_) => format!("\"{}\"", of.text()),
    }
}
